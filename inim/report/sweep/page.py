"""The report of a sweep: one page over all rows of its table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from inim.report.files import write_text
from inim.report.markup import element, plot, text
from inim.report.page import Section, badge, data_note, how_to_reproduce, render_page, timestamp
from inim.report.sweep.plots import draw_pareto, time_column
from inim.report.sweep.results import Contest, contests_of, names_of
from inim.report.sweep.tables import best_displays, cost_table, failures, matrix
from inim.report.wording import MISSING

__all__ = ["PAGE", "render_sweep", "write_page"]

PAGE = "sweep.html"

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


def write_page(path: Path, rows: Sequence[Mapping[str, Any]], about: Mapping[str, str]) -> None:
    """Write the page, whole or not at all; parameters as of `render_sweep`."""
    write_text(path, render_sweep(rows, about))


def render_sweep(rows: Sequence[Mapping[str, Any]], about: Mapping[str, str]) -> str:
    """The whole page.

    Parameters
    ----------
    rows : sequence of mapping
        Of the table; see README, Sweeps.
    about : mapping of str to str
        `title`, `command`, `created`, `inim_version`.
    """
    contests = contests_of(rows)
    title = about.get("title", "Sweep")
    query = element("p", "All rows lie beside this page in sweep.parquet; for example:")
    query += element("pre", element("code", text(_QUERY)), tabindex=0)
    return render_page(
        title,
        _facts(contests, about),
        [
            Section("failures", "What failed", failures(rows)),
            Section("scores", "Scores", _matrices(contests)),
            Section("pareto", "Time against error", _pareto(contests)),
            Section("displays", "Best display for a relic", _best(contests)),
            Section("cost", "What it took", cost_table(contests)),
            how_to_reproduce(about, query),
        ],
        window_title=f"{title} – inim sweep",
        footer=data_note(about, "sweep.parquet"),
        verdict_badge=_badge(rows, contests),
        style=_STYLE,
    )


def _facts(contests: Sequence[Contest], about: Mapping[str, str]) -> list[str]:
    counts = [
        f"{len(names_of(contests, field))} {field}{'s' * (len(names_of(contests, field)) != 1)}"
        for field in ("scene", "display", "algorithm")
    ]
    words = [" × ".join(counts), f"inim {about.get('inim_version', MISSING)}"]
    return [*map(text, words), timestamp(about)]


def _badge(rows: Sequence[Mapping[str, Any]], contests: Sequence[Contest]) -> str:
    good = all(row["status"] == "ok" and row.get("passed") for row in rows)
    done = sum(not contest.failed for contest in contests)
    words = f"{done} of {len(contests)} results, {len(rows)} rows"
    return badge("passed" if good else "failed", text(words))


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
    return words + plot(svg.encode(), "Time against error")


def _best(contests: Sequence[Contest]) -> str:
    if not any(not c.failed for c in contests):
        return ""
    return element("p", text(_BEST), class_="lead") + best_displays(contests)
