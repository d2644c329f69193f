"""The page of a sweep: one HTML file in the report's dress, that needs nothing else."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from importlib import resources
from typing import Any

from inim.report.markup import element, mark, section, text, void
from inim.report.sweep.plots import draw_pareto, time_column
from inim.report.sweep.summary import Contest, contests_of, names_of
from inim.report.sweep.tables import best_displays, cost_table, failures, matrix
from inim.report.wording import MISSING, plain

__all__ = ["render_page"]

_POLICY = (
    "default-src 'none'; img-src data:; style-src 'unsafe-inline'; "
    "base-uri 'none'; form-action 'none'"
)
_STYLE = """
.plot img { max-width: 1160px; }
.scores { margin-bottom: 28px; }
.scores td .best { color: var(--good); }
.sweep table { width: auto; min-width: min(100%, 760px); }
.sweep th, .sweep td { white-space: nowrap; }
.sweep td:nth-child(n+4), .sweep th:nth-child(n+4) { text-align: right; }
#cost .sweep td, #cost .sweep th:not(:first-child) { text-align: right; }
.lead { max-width: 90ch; }
"""
_SCORES = (
    "Each number is a mean over the viewpoints. Large: SSIM to the ceiling, what the algorithm "
    "keeps of what this display can show. Small: SSIM to the scene, "
    "what the viewer gets. Rows are not to be compared with one another: scores depend on what a "
    "scene shows. No digit beyond the noise floor's distance from 1 means anything."
)
_PARETO = (
    "Down and left is better; a point is the mean over the scenes. Coloured: no other is as fast "
    "and as good. Grey: another is both. "
)
_TIMES = {
    "yardsticks": "Times are ratios to one gather per display pixel, taken in the same process.",
    "seconds": "Seconds were taken once and cold, beside whatever else ran; put time = true into "
    "the study for ratios that can be trusted.",
}
_BEST = (
    "What a viewer gets of a relic from the best algorithm on each display: the mean SSIM to the "
    "scene, beside the ceiling, which only noise takes an algorithm above. Each display's views "
    "have as many pixels as it has lenses to fill them, so a display is judged at its own "
    "resolution: FLIP, which weighs differences as an eye does, stands beside."
)
_QUERY = """SELECT scene, display, algorithm, avg(ssim_to_ceiling) AS kept
FROM 'sweep.parquet' WHERE status = 'ok'
GROUP BY ALL ORDER BY scene, display, kept DESC;"""


def render_page(rows: Sequence[Mapping[str, Any]], about: Mapping[str, str]) -> str:
    """The whole page.

    Parameters
    ----------
    rows : sequence of mapping
        Of the table.
    about : mapping of str to str
        `title`, `command`, `created`, `inim_version`.
    """
    contests = contests_of(rows)
    parts = [
        ("failures", "What failed", failures(rows)),
        ("scores", "Scores", _matrices(contests)),
        ("pareto", "Time against error", _pareto(contests)),
        ("displays", "Best display for a relic", _best(contests)),
        ("cost", "What it took", cost_table(contests)),
        ("reproduce", "How to reproduce", _reproduce(about)),
    ]
    shown = [one for one in parts if one[2]]
    links = [f'<a href="#{anchor}">{text(title)}</a>' for anchor, title, _ in shown]
    header = element(
        "header",
        element("div", element("h1", text(about.get("title", "Sweep"))), _facts(contests, about)),
        _badge(rows, contests),
        element("nav", *links, aria_label="Sections"),
    )
    main = "\n".join(section(*one) for one in shown)
    return (
        f'<!doctype html>\n<html lang="en">\n{_head(about)}\n<body>\n{header}\n'
        f"<main>\n{main}\n</main>\n{_footer(about)}\n</body>\n</html>\n"
    )


def _head(about: Mapping[str, str]) -> str:
    style = resources.files("inim.report").joinpath("report.css").read_text("utf-8")
    return (
        '<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{text(_POLICY)}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<title>{text(about.get('title', 'Sweep'))} – inim sweep</title>\n"
        f"<style>\n{style}{_STYLE}</style>\n</head>"
    )


def _facts(contests: Sequence[Contest], about: Mapping[str, str]) -> str:
    counts = [
        f"{len(names_of(contests, field))} {field}{'s' * (len(names_of(contests, field)) != 1)}"
        for field in ("scene", "display", "algorithm")
    ]
    created = plain(about.get("created", MISSING)).replace("T", " ").replace("+00:00", " UTC")
    words = [" × ".join(counts), f"inim {about.get('inim_version', MISSING)}"]
    time = element("time", text(created))
    return element("p", " · ".join([*map(text, words), time]), class_="facts")


def _badge(rows: Sequence[Mapping[str, Any]], contests: Sequence[Contest]) -> str:
    """The verdict in a word and a sign, and only then a colour."""
    good = all(row["status"] == "ok" and row.get("passed") for row in rows)
    verdict = "passed" if good else "failed"
    done = sum(not contest.failed for contest in contests)
    words = f"{done} of {len(contests)} results, {len(rows)} rows"
    word = element("strong", mark(verdict), text(verdict.capitalize()))
    return element("p", word, element("span", text(words)), class_=f"verdict {verdict}")


def _matrices(contests: Sequence[Contest]) -> str:
    found = []
    for display in names_of(contests, "display"):
        for settings in names_of(contests, "settings"):
            own = [c for c in contests if (c.display, c.settings) == (display, settings)]
            found += [matrix(display, settings, own)] if own else []
    return element("p", text(_SCORES), class_="lead") + "".join(found)


def _pareto(contests: Sequence[Contest]) -> str:
    svg = draw_pareto(contests)
    if svg is None:
        return ""
    words = element("p", text(_PARETO + _TIMES[time_column(contests)]), class_="lead")
    source = f"data:image/svg+xml;base64,{base64.b64encode(svg.encode()).decode()}"
    picture = void("img", src=source, alt="Time against error")
    return words + element("figure", picture, class_="plot")


def _best(contests: Sequence[Contest]) -> str:
    if not any(not c.failed for c in contests):
        return ""
    return element("p", text(_BEST), class_="lead") + best_displays(contests)


def _reproduce(about: Mapping[str, str]) -> str:
    command = element("pre", element("code", text(about.get("command", MISSING))))
    words = element("p", "All rows lie beside this page in sweep.parquet; for example:")
    return command + words + element("pre", element("code", text(_QUERY)))


def _footer(about: Mapping[str, str]) -> str:
    words = f"inim {text(about.get('inim_version', MISSING))} · data in sweep.parquet"
    return element("footer", element("p", words))
