"""The tables of a sweep's page: scores by scene and algorithm, displays by relic, failures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from inim.metrics import all_metrics
from inim.report.markup import element, table, text
from inim.report.sweep.results import Contest, names_of, settings_of, varied_settings
from inim.report.wording import MAIN, MISSING, number

__all__ = ["best_displays", "cost_table", "failures", "matrix"]

# Columns of the references' scores by the metric that ranks.
_CEILING, _FLOOR = f"ceiling_{MAIN.key}", f"noise_floor_{MAIN.key}"


def matrix(display: str, settings: str, contests: Sequence[Contest]) -> str:
    """Scene by algorithm on one display: SSIM to the ceiling, and to the scene below it."""
    algorithms = names_of(contests, "algorithm")
    heads = ["Scene", *algorithms, "Ceiling", "Noise floor"]
    rows = []
    for scene in names_of(contests, "scene"):
        own = {c.algorithm: c for c in contests if c.scene == scene}
        best = _best(own.values(), MAIN.to_ceiling_key)
        cells = [_cell(own.get(name), best) for name in algorithms]
        rows.append([text(scene), *cells, *_reference(list(own.values()))])
    caption = f"Display {display}, {settings}" if settings else f"Display {display}"
    return table(caption, _texts(heads), rows, "scores")


def _best(contests: Any, key: str) -> float | None:
    known = [c.scores[key] for c in contests if not c.failed and c.scores[key] is not None]
    return max(known, default=None)


def _cell(contest: Contest | None, best: float | None) -> str:
    if contest is None:
        return MISSING
    if contest.failed:
        return element("a", "failed", href="#failures")
    value = contest.scores[MAIN.to_ceiling_key]
    is_best = value is not None and value == best
    small = f"{'best · ' if is_best else ''}{number(contest.scores[MAIN.key], 4)} scene"
    shown = element("span", text(number(value, 4)), class_="best" if is_best else None)
    return shown + element("small", text(small))


def _reference(contests: Sequence[Contest]) -> list[str]:
    """The ceiling against the scene, and the truth against itself; alike for all algorithms."""
    done = [c for c in contests if not c.failed]
    if not done:
        return [MISSING, MISSING]
    return [text(number(done[0].scores[k], 4)) for k in (_CEILING, _FLOOR)]


def best_displays(contests: Sequence[Contest]) -> str:
    """For each relic, its displays by what a viewer gets from the best algorithm on each."""
    several = len(names_of(contests, "settings")) > 1
    others = [metric for metric in all_metrics() if metric != MAIN]
    rows = []
    for scene in names_of(contests, "scene"):
        found = _ranking([c for c in contests if c.scene == scene and not c.failed])
        for place, contest in enumerate(found):
            shown = contest.display + (f" ({contest.settings})" if several else "")
            rows.append(
                [
                    text(scene) if place == 0 else "",
                    element("b", text(shown)) if place == 0 else text(shown),
                    text(contest.algorithm),
                    *(text(number(contest.scores[key], 4)) for key in (MAIN.key, _CEILING)),
                    *(text(number(contest.scores[m.key], m.digits)) for m in others),
                ]
            )
    heads = ["Relic", "Display", "Best algorithm on it", f"{MAIN.label} to scene", "Its ceiling"]
    heads += [metric.label for metric in others]
    return table("Displays by relic, the best first", _texts(heads), rows, "sweep")


def _ranking(contests: Sequence[Contest]) -> list[Contest]:
    """The best contest of each display, in falling order."""
    known = [(c.scores[MAIN.key], c) for c in contests]
    falling = sorted(((v, c) for v, c in known if v is not None), key=lambda pair: -pair[0])
    best: dict[tuple[str, str], Contest] = {}
    for _, contest in falling:
        best.setdefault((contest.display, contest.settings), contest)
    return list(best.values())


def cost_table(contests: Sequence[Contest]) -> str:
    """Seconds a validation took, by scene and display."""
    displays = names_of(contests, "display")
    rows = []
    for scene in names_of(contests, "scene"):
        cells = []
        for display in displays:
            own = [c for c in contests if (c.scene, c.display) == (scene, display)]
            spent = {c.settings: c.scores["unit_seconds"] for c in own}
            known = [v for v in spent.values() if v is not None]
            cells.append(text(number(sum(known), 1) if known else MISSING))
        rows.append([text(scene), *cells])
    caption = "Seconds of the validations the rows come from, beside whatever ran at the same time"
    return table(caption, _texts(["Scene", *displays]), rows, "sweep")


def failures(rows: Sequence[Mapping[str, Any]]) -> str:
    """Each unit that failed and why, and each check that did not pass; empty where all is well."""
    found: dict[tuple[str, str], None] = {}
    varied = varied_settings(rows)
    for row in rows:
        words = [row["scene"], row["display"], settings_of(row, varied)]
        if row["status"] == "ok":
            words.append(row["algorithm"])
        error = row["error"] if row["status"] != "ok" else row.get("failed_checks")
        if error:
            found[" · ".join(str(word) for word in words if word), str(error)] = None
    lines = [element("li", element("b", text(what)), " ", text(why)) for what, why in found]
    return element("ul", *lines, class_="failures") if lines else ""


def _texts(words: Sequence[str]) -> list[str]:
    return [text(word) for word in words]
