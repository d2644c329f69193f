"""First screen: failures, the verdict in a sentence, one viewpoint in three images; all scores."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

from inim.report.document import AlgorithmResult, ReportDocument
from inim.report.images import ReportImages, is_wide
from inim.report.labels import (
    PREVIEW_WORDS,
    REFERENCE,
    TRUTH,
    ScoreKind,
    check_finding,
    difference_sentence,
    disagreements,
    full_command,
    is_number,
    named,
    number,
    per_cent,
    precise,
    score,
    score_keys,
    shares_of_possible,
    unequal_algorithms,
)
from inim.report.page import element, figure, lead, radio, table, text
from inim.report.sections import ReportSection
from inim.scores.document_parts import Precision
from inim.scores.metrics import HEADLINE, HEADLINE_TO_SCENE, MAIN, Metric, all_metrics

_FAILURES_ON_TOP = 3
_MOST_DIGITS = 3
_FEW_DIGITS = 2
#: Comparisons of a view: the reader chooses one. Key, label and kind of score.
_COMPARISONS: tuple[tuple[str, str, ScoreKind], ...] = (
    ("relic-reference", "relic, to the reference", "relic to reference"),
    ("relic-truth", "relic, to the ground truth", "relic"),
    ("whole-reference", "whole image, to the reference", "reference"),
    ("whole-truth", "whole image, to the ground truth", "scene"),
)
_TO_TRUTH: dict[ScoreKind, ScoreKind] = {"relic to reference": "relic", "reference": "scene"}
#: Marks a score above the noise floor.
_MARK = "<sup>1</sup>"
_OF_EIA = {
    f"EIA {MAIN.label}": (
        f"{MAIN.label} of the elemental image array to the ground-truth EIA, without optics"
    ),
    "Unlit": "Share of the panel pixels with light in the ground-truth EIA that are black here",
}
_OF_SOURCES = {
    "Wrong source": "Share of the panel pixels that show another pixel than the exact one",
    "Holes": "Share of the lensed panel pixels that show nothing",
}
_SECONDS = {"Seconds": "Time to generate the EIA, once, compiled; inim bench measures precisely"}
_NO_SCENE = (
    "There is no ground truth: the surfaces that a picture hides are unknown. Algorithms are "
    "compared with what the picture determines; see the "
)
_NOTE = (
    "± and [ ] are 95 % intervals. The reference is the ground-truth EIA seen through the same "
    "lenses: a score to it measures the loss of the algorithm alone. A score to the ground truth "
    "includes the loss of the display. "
)
_ABOVE_FLOOR = (
    "¹ Above the noise floor: it is closer than two halves of the ground truth's samples. "
)


def overview(data: ReportDocument, images: ReportImages) -> str:
    """The verdict in a sentence, above the images of the centre viewpoint."""
    parts = [failures(data), _sentence(data), _hero(data, images)]
    if data.picture is not None:
        link = element("a", "glossary", href="#meaning")
        parts.append(element("p", text(_NO_SCENE), link, ".", class_="lead"))
    if command := full_command(data):
        words = text(PREVIEW_WORDS), " ", element("code", text(command))
        parts.insert(0, element("p", *words, class_="preview"))
    return "".join(parts)


def failures(data: ReportDocument) -> str:
    """The first failed checks, to be read without scrolling."""
    failed = data.verdict.failures
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


def ranking(data: ReportDocument) -> list[tuple[str, float]]:
    """Algorithms with their mean headline scores, the best first."""
    means = [(name, data.mean(name, HEADLINE)) for name in data.algorithms]
    ranked = [(name, mean) for name, mean in means if mean is not None]
    return sorted(ranked, key=lambda item: -item[1])


def verdict_sentence(data: ReportDocument) -> str:
    """The best algorithm, and the next, in a sentence; empty without scores or with doubts."""
    if data.verdict.doubts:
        return ""
    if shares := shares_of_possible(data):
        (best, share), *others = shares.items()
        words = f"{best} reaches {per_cent(share, 0)} of what is possible"
        return words + "".join(f"; the next, {n}, {per_cent(s, 0)}" for n, s in others[:1]) + "."
    scores = [f"{name} {number(mean, _FEW_DIGITS)}" for name, mean in ranking(data)[:2]]
    if not scores:
        return ""
    words = f"Mean {MAIN.label} to the reference: {', '.join(scores)}."
    return f"{words} {difference_sentence(data)}".rstrip()


def _sentence(data: ReportDocument) -> str:
    words = verdict_sentence(data)
    meaning = f"Mean {MAIN.label} on the relic to the reference view"
    if shares_of_possible(data):
        meaning = "Least possible view error, of optimal, over the algorithm's; root mean squares"
    return element("p", text(words), class_="sentence", title=meaning) if words else ""


def scores_section(data: ReportDocument, images: ReportImages) -> str:  # noqa: ARG001
    """The table of scores, with a choice of metric and comparison."""
    link = element("a", "Glossary", href="#meaning")
    scores = _scores(data, _metrics(data))
    above_floor = _ABOVE_FLOOR if _MARK in scores else ""
    note = element("p", text(named(data, _NOTE) + above_floor), link, class_="note")
    others = [lead(line, "note") for line in (*unequal_algorithms(data), *disagreements(data))]
    metrics = _metrics(data)
    first = _COMPARISONS[0]
    compare = [
        radio("comparison", key, named(data, label), key == first[0])
        for key, label, _ in _COMPARISONS
    ]
    choices = [element("fieldset", element("legend", "Compare"), *compare)]
    if len(metrics) > 1:
        buttons = [radio("metric", f"m{i}", m.label, i == 0) for i, m in enumerate(metrics)]
        choices.append(element("fieldset", element("legend", "Metric"), *buttons))
    controls = element("div", *choices, class_="score-choice")
    return "".join([element("div", controls, scores, class_="score-box"), note, *others])


def _metrics(data: ReportDocument) -> list[Metric]:
    """Metrics of the report that are installed here, the main one first."""
    views = [view for result in data.algorithms.values() for view in result.views.values()]
    keys = {key for view in views for key in view}
    listed = [metric for metric in all_metrics() if metric.key in keys]
    return sorted(listed, key=lambda metric: metric.key != MAIN.key)


def _scores(data: ReportDocument, metrics: Sequence[Metric]) -> str:
    names, best = data.viewpoint_names, data.best_algorithm
    heads = [text("Algorithm"), *map(text, names)]
    measured = (_OF_EIA if data.picture is None else _OF_SOURCES) | _SECONDS
    heads += [element("abbr", text(head), title=meaning) for head, meaning in measured.items()]
    several = len(data.algorithms) > 1
    rows = [
        _algorithm_row(data, name, result, metrics, several and name == best)
        for name, result in data.algorithms.items()
    ]
    reference, floor = data.reference, data.noise_floor
    own = {name: reference.views[name] for name in names}
    to_truth = named(data, "to the ground truth")
    rows.append(_reference_row(REFERENCE, to_truth, own, reference.precision, metrics))
    if floor is not None:
        noise = {name: floor.views[name] for name in names}
        itself = "ground truth to itself"
        rows.append(_reference_row("Noise floor", itself, noise, {}, metrics, floor.eia))
    return table("One viewpoint per column", heads, rows, "scores")


def _score_cell(
    scores: Mapping[str, Any],
    precision: Precision,
    view: str,
    metrics: Sequence[Metric],
    *,
    to_itself: bool,
    floor: Mapping[str, Any] = MappingProxyType({}),
) -> str:
    """All scores of a view, of which the style sheet displays the chosen one.

    `to_itself`: the scores are against the ground truth only, whatever comparison is chosen.
    An SSIM above that of the noise `floor` is marked.
    """
    parts = []
    for i, metric in enumerate(metrics):
        keys = score_keys(metric)
        for comparison, _, kind in _COMPARISONS:
            if kind not in keys:
                continue
            key = keys[_TO_TRUTH.get(kind, kind) if to_itself else kind]
            value, digits = scores.get(key), min(metric.digits, _MOST_DIGITS)
            words = score(scores, key)
            if is_number(value) and (score_precision := precision.get(view, {}).get(key)):
                words = precise(value, score_precision.interval, digits)
            elif is_number(value):
                words = number(value, digits)
            limit = floor.get(keys[_TO_TRUTH.get(kind, kind)]) if metric == MAIN else None
            mark = _MARK * (is_number(value) and is_number(limit) and value > limit)
            parts.append(element("span", text(words), mark, class_=f"{comparison} m{i}"))
    return "".join(parts)


def _algorithm_row(
    data: ReportDocument,
    name: str,
    result: AlgorithmResult,
    metrics: Sequence[Metric],
    is_best: bool,
) -> list[str]:
    label = text(name) + (element("small", "best mean") if is_best else "")
    floors = {} if data.noise_floor is None else data.noise_floor.views
    cells = [
        _score_cell(
            result.views.get(view, {}), result.precision, view, metrics,
            to_itself=False, floor=floors.get(view, {}),
        )
        for view in data.viewpoint_names
    ]  # fmt: skip
    if data.picture is None:
        last = [number(result.eia.get(MAIN.key), _MOST_DIGITS), per_cent(result.unlit_fraction, 1)]
    else:
        last = [per_cent(result.wrong_source, 2), per_cent(result.eia["hole_fraction"], 1)]
    return [label, *cells, *map(text, [*last, number(result.seconds, 2)])]


def _reference_row(
    label: str,
    against: str,
    views: Mapping[str, Mapping[str, Any]],
    precision: Precision,
    metrics: Sequence[Metric],
    eia: Mapping[str, Any] | None = None,
) -> list[str]:
    cells = [
        _score_cell(own, precision, view, metrics, to_itself=True) for view, own in views.items()
    ]
    of_eia = number(eia.get(MAIN.key), _MOST_DIGITS) if eia else ""
    head = element("em", text(label)) + " " + element("span", text(against), class_="aside")
    return [head, *cells, of_eia, "", ""]


def _hero(data: ReportDocument, images: ReportImages) -> str:
    """One viewpoint: ground truth, reference view, and view of the best algorithm."""
    view, best = data.main_viewpoint, data.best_algorithm
    if view is None:
        return ""
    truth = images.read("truth", f"{view}.png")
    shots = [_shot(images, truth, view, named(data, TRUTH), f"viewpoint {view}, without a display")]
    own = number(data.reference.views[view].get(HEADLINE_TO_SCENE), _MOST_DIGITS)
    reference = f"the ground-truth EIA on this display, {MAIN.label} {own} to the ground truth"
    reference_view = images.read("views", "reference", f"{view}.png")
    shots.append(_shot(images, reference_view, view, REFERENCE, named(data, reference)))
    if best is not None:
        best_view = images.read("views", best, f"{view}.png")
        scores = data.algorithms[best].views.get(view, {})
        words = f"{MAIN.label} {number(scores.get(HEADLINE), _MOST_DIGITS)} to the reference"
        words += ", best on average" * (len(data.algorithms) > 1)
        shots.append(_shot(images, best_view, view, best, words))
    return element("div", *shots, class_="hero wide" if is_wide(truth) else "hero")


def _shot(images: ReportImages, pixels: Any, view: str, name: str, remark: str) -> str:
    return figure(images.embed(pixels, f"{name}, viewpoint {view}"), name, remark)


SECTIONS = (
    ReportSection(10, "overview", "Overview", overview),
    ReportSection(30, "scores", "Scores", scores_section),
)
