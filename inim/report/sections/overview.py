"""First screen: all scores, the failures, and one viewpoint as ground truth, reference and best
view.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from inim.documents.parts import Precision
from inim.documents.picture import PictureDocument
from inim.documents.report import AlgorithmResult, ReportDocument
from inim.metrics.headline import HEADLINE, HEADLINE_TO_SCENE, HEADLINE_WORDS, MAIN
from inim.report.images import ReportImages, is_wide
from inim.report.labels import (
    PREVIEW_WORDS,
    REFERENCE,
    TRUTH,
    check_finding,
    disagreements,
    full_command,
    number,
    score,
)
from inim.report.page import element, figure, lead, table, text
from inim.report.sections import ReportSection

_FAILURES_ON_TOP = 3
_NOTE = (
    "The large number is the SSIM on the relic to the reference view: the ground-truth EIA seen "
    "through the same lenses. It measures the loss of the algorithm alone; ± is its 95 % interval. "
    "The small numbers are the SSIM on the relic to the ground truth, which includes the loss of "
    "the display, and both scores for the whole image. "
)


def overview(data: ReportDocument, images: ReportImages) -> str:
    """The table of scores above the images of the centre viewpoint."""
    link = element("a", "Meaning of the numbers", href="#meaning")
    note = element("p", text(_NOTE), link, class_="note")
    others = [lead(line, "note") for line in disagreements(data)]
    parts = [failures(data), _scores(data), note, *others, _hero(data, images)]
    if command := full_command(data):
        words = text(PREVIEW_WORDS), " ", element("code", text(command))
        parts.insert(0, element("p", *words, class_="preview"))
    return "".join(parts)


def failures(data: ReportDocument | PictureDocument) -> str:
    """The first failed checks, to be read without scrolling."""
    failed = [check for check in data.verdict.checks if not check.passed]
    if not failed:
        return ""
    lines = [
        element("li", element("b", text(c.name)), " ", text(check_finding(c)))
        for c in failed[:_FAILURES_ON_TOP]
    ]
    if len(failed) > _FAILURES_ON_TOP:
        more = f"and {len(failed) - _FAILURES_ON_TOP} more failed checks"
        lines.append(element("li", element("a", text(more), href="#checks")))
    return element("ul", *lines, class_="failures", aria_label="Failed checks")


def _scores(data: ReportDocument) -> str:
    names, best = data.viewpoint_names, data.best_algorithm
    heads = ["Algorithm", *names, f"EIA {MAIN.label}", "Holes", "Seconds"]
    several = len(data.algorithms) > 1
    rows = [
        _algorithm_row(name, result, names, several and name == best)
        for name, result in data.algorithms.items()
    ]
    reference, floor = data.reference, data.noise_floor
    own = {name: reference.views[name] for name in names}
    rows.append(_reference_row(REFERENCE, "to ground truth", own, reference.precision))
    noise = {name: floor.views[name] for name in names}
    rows.append(_reference_row("Noise floor", "ground truth to itself", noise, {}, floor.eia))
    return table(f"{HEADLINE_WORDS}, per viewpoint", [text(h) for h in heads], rows, "scores")


def _algorithm_row(
    name: str, result: AlgorithmResult, names: Sequence[str], is_best: bool
) -> list[str]:
    views = [result.views.get(viewpoint, {}) for viewpoint in names]
    label = text(name) + (element("small", "best mean") if is_best else "")
    cells = [
        element("span", text(score(scores, HEADLINE)))
        + _noise(result.precision, view, HEADLINE)
        + element("small", text(f"{score(scores, HEADLINE_TO_SCENE)} ground truth"))
        + element("small", text(f"{score(scores, MAIN.to_reference_key)} whole"))
        + element("small", text(f"{score(scores, MAIN.key)} whole, ground truth"))
        for view, scores in zip(names, views, strict=True)
    ]
    eia = result.eia
    last = [score(eia, MAIN.key), score(eia, "hole_fraction"), number(result.seconds, 2)]
    return [label, *cells, *map(text, last)]


def _reference_row(
    label: str,
    against: str,
    views: Mapping[str, Mapping[str, Any]],
    precision: Precision,
    eia: Mapping[str, Any] | None = None,
) -> list[str]:
    cells = [
        element("span", text(score(own, HEADLINE_TO_SCENE)))
        + _noise(precision, view, HEADLINE_TO_SCENE)
        + element("small", text(f"{score(own, MAIN.key)} whole"))
        for view, own in views.items()
    ]
    of_eia = score(eia, MAIN.key) if eia else ""
    head = element("em", text(label)) + " " + element("span", text(against), class_="aside")
    return [head, *cells, text(of_eia), "", ""]


def _noise(precision: Precision, view: str, key: str) -> str:
    score_precision = precision.get(view, {}).get(key)
    half = None if score_precision is None else score_precision.half_width
    return "" if half is None else element("small", text(f"± {number(half, MAIN.digits)}"))


def _hero(data: ReportDocument, images: ReportImages) -> str:
    """One viewpoint: ground truth, reference view, and view of the best algorithm."""
    names, best = data.viewpoint_names, data.best_algorithm
    if not names:
        return ""
    view = "centre" if "centre" in names else names[0]
    truth = images.read("truth", f"{view}.png")
    shots = [_shot(images, truth, view, TRUTH, f"viewpoint {view}, without a display")]
    own = score(data.reference.views[view], HEADLINE_TO_SCENE)
    reference = f"{MAIN.label} {own} on the relic to the ground truth"
    reference_view = images.read("views", "reference", f"{view}.png")
    shots.append(_shot(images, reference_view, view, REFERENCE, reference))
    if best is not None:
        best_view = images.read("views", best, f"{view}.png")
        scores = data.algorithms[best].views.get(view, {})
        words = f"{MAIN.label} {score(scores, HEADLINE)} on the relic to the reference"
        words += ", best on average" * (len(data.algorithms) > 1)
        shots.append(_shot(images, best_view, view, best, words))
    return element("div", *shots, class_="hero wide" if is_wide(truth) else "hero")


def _shot(images: ReportImages, pixels: Any, view: str, name: str, remark: str) -> str:
    return figure(images.embed(pixels, f"{name}, viewpoint {view}"), name, remark)


SECTIONS = (ReportSection(10, "overview", "Scores", overview),)
