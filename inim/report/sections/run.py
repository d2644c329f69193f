"""The record of the run: checks, timings, skipped work, warnings, how to reproduce it, glossary."""

from inim.report.document import ReportDocument
from inim.report.images import ReportImages
from inim.report.labels import (
    NBSP,
    REFERENCE,
    TRUE_EIA,
    TRUTH,
    check_interval,
    check_limit,
    check_value,
    named,
    number,
    per_cent,
    relation,
    suggested_criteria,
)
from inim.report.page import bullets, element, how_to_reproduce, lead, mark, table, text, text_table
from inim.report.sections import ReportSection
from inim.scores.document_parts import Check, Checks
from inim.scores.metrics import RELIC_MARGIN_PX, all_metrics

_TOTAL, _RENDER = "total", "mitsuba_render"
_EXACT = "Skipping did not change any score."
_NO_CRITERIA = (
    "No quality criteria are set. These checks only verify that all images exist, are finite and "
    "are not black. To set criteria, give inim.min_ssim_to_reference, the minimum SSIM on the "
    "relic to the reference, or compare with an accepted run by --baseline."
)
_SUGGESTION = "This run would just pass with:"
_SAMPLES = (
    "Sampling stopped when the intervals of the headline scores were as narrow as set by "
    "inim.score_error. With more samples, scores would change within their intervals. No other "
    "skipped step changes a score."
)
_SKIPPED = {"step": "Step", "performed": "Performed", "skipped": "Skipped", "why": "Reason"}
_OF_SCENE = (
    (TRUTH, "The scene as rendered from a viewpoint, without a display."),
    (TRUE_EIA, "The EIA of the scene, path traced through the centre of every lens."),
    (
        REFERENCE,
        "The view of the ground-truth EIA through this display's lenses. The difference between "
        "reference and ground truth is the loss of the display, not of an algorithm. A warning "
        "lists algorithms that score above the reference by more than the noise.",
    ),
    (
        "Noise floor",
        "The score of one half of the ground truth's samples against the other half. For plain "
        "scores, such as the EIA's, ignore differences smaller than 1 minus the noise floor. For "
        "noise-corrected scores, ± and [ ] are 95 % intervals.",
    ),
    (
        "Unlit",
        "Share of the panel pixels with light in the ground-truth EIA that an algorithm leaves "
        "black: holes, where something should be.",
    ),
)
_OF_PICTURE = (
    (
        "Warped picture",
        "The view from the eye by the picture's own depth, without a display and its blur. It "
        "takes the place of the ground truth; the relic is the area that it covers.",
    ),
    ("Exact EIA", "The EIA of the exact first hits on the picture, with four rays per pixel."),
    ("Reference", "The view of the exact EIA through this display's lenses."),
    (
        "Wrong source",
        "Share of the panel pixels that show another pixel of the picture than the first on their "
        "ray, by rational arithmetic; of up to 2,000 pixels, drawn at random.",
    ),
)
_MEANINGS = (
    (
        "SSIM to reference",
        "Structural similarity of a reconstructed view and the reference view: 1 is identical. It "
        "measures the loss of the algorithm. On the relic it is the headline score: the best "
        "algorithm has the highest mean over the viewpoints.",
    ),
    (
        "SSIM to ground truth",
        "Structural similarity of a reconstructed view and the ground-truth view. It includes the "
        "loss of the display.",
    ),
    (
        "On the relic",
        "Restricted to the relic's pixels in the ground-truth view, plus a margin of "
        f"{RELIC_MARGIN_PX} pixels. The region is the same for all algorithms. An empty "
        "background raises every score and can change the order of the algorithms.",
    ),
    (
        "Noise-corrected",
        "Sampling noise lowers the similarity of two images. Scores without noise are estimated "
        "from independent parts of the samples; ± and [ ] are 95 % intervals. report.json also "
        "has the plain scores of the noisy images.",
    ),
    ("PSNR", "Peak signal-to-noise ratio in dB, higher is better; ∞ for identical images."),
    ("FLIP", "Visible difference when alternating between two images; 0 is none."),
    (
        "Across scenes",
        "Do not compare scores of different scenes: with the same algorithm, a smooth relic "
        "scores higher than a detailed one. Compare algorithms within one report.",
    ),
)


def check_list(verdict: Checks) -> str:
    """Every check with its numbers, the failed ones first."""
    if not verdict.checks:
        return element("p", "No checks.")
    rows = [_check_row(check) for check in sorted(verdict.checks, key=lambda check: check.passed)]
    heads = ["Check", "Value", "Relation", "Limit", "Verdict", "Interval of the value"]
    if not any(row[-1] for row in rows):
        heads, rows = heads[:-1], [row[:-1] for row in rows]
    return table("All checks, failed ones first", heads, rows, "checks")


def _no_criteria(data: ReportDocument) -> str:
    """Limits of the checks, with suggested criteria; empty if criteria exist."""
    if data.verdict.word != "ran clean":
        return ""
    criteria = suggested_criteria(data)
    if not criteria:
        return lead(_NO_CRITERIA)
    words = lead(f"{_NO_CRITERIA} {_SUGGESTION}")
    line = f"-D 'inim.min_ssim_to_reference={criteria}'"
    return words + element("pre", element("code", text(line)), tabindex=0)


def _checks(data: ReportDocument, _images: ReportImages) -> str:
    return _no_criteria(data) + check_list(data.verdict)


def _reproduce(data: ReportDocument, _images: ReportImages) -> str:
    return how_to_reproduce(data).body


def _check_row(check: Check) -> list[str]:
    word = "passed" if check.passed else "failed"
    name = text(check.name)
    if check.detail:
        name += element("small", text(check.detail))
    badge = element("span", mark(word), word, class_=f"badge {word}")
    value, limit = check_value(check), check_limit(check)
    interval = text(check_interval(check))
    return [name, text(value), text(relation(check)), text(limit), badge, interval]


def _timings(data: ReportDocument, _images: ReportImages) -> str:
    """Time of each stage, and the renderer's share."""
    timings = data.timings
    stages = {k: v for k, v in timings.items() if k not in (_TOTAL, _RENDER)}
    total = timings[_TOTAL]
    rows = [_stage_row(name, seconds, total) for name, seconds in stages.items()]
    listed = table("Wall-clock time", ["Stage", "Seconds", "Share of the total"], rows, "timings")
    words = f"{number(total, 2)}{NBSP}s in total"
    render = timings[_RENDER]
    if total > 0:
        share = per_cent(render / total, 0)
        words += f", of which the renderer took {number(render, 2)}{NBSP}s ({share})"
    return lead(f"{words}.") + listed


def _stage_row(name: str, seconds: float, total: float) -> list[str]:
    share = seconds / total if total > 0 else None
    width = min(100 * (share or 0.0), 100.0)
    bar = element("div", class_="bar", style=f"width:{width:.1f}%", aria_hidden="true")
    words = element("span", text(per_cent(share, 1)))
    label = text(name.replace("_", " "))
    return [label, text(number(seconds, 2)), element("div", words, bar, class_="share")]


def _skipped_steps_section(data: ReportDocument, _images: ReportImages) -> str:
    """The section; empty without any step."""
    rows = [[getattr(row, key) for key in _SKIPPED] for row in data.skipped]
    if not rows:
        return ""
    words = _SAMPLES if any(row.step == "samples" for row in data.skipped) else _EXACT
    caption = "Performed and skipped steps"
    listed = text_table(caption, list(_SKIPPED.values()), rows, "skips")
    return lead(words) + listed


def _meanings(data: ReportDocument) -> str:
    """The glossary, with a word on each metric of another package."""
    others = [
        (metric.label, f"{metric.better.capitalize()} is better. {metric.reference}")
        for metric in all_metrics()
        if not any(metric.label in term for term, _ in _MEANINGS)
    ]
    pairs = [*(_OF_SCENE if data.picture is None else _OF_PICTURE), *_MEANINGS, *others]
    pairs = [(named(data, term), named(data, meaning)) for term, meaning in pairs]
    entries = [element("div", element("dt", text(k)), element("dd", text(v))) for k, v in pairs]
    return element("dl", *entries, class_="meanings")


SECTIONS = (
    ReportSection(100, "checks", "Checks", _checks, is_folded=True),
    ReportSection(110, "timings", "Timings", _timings, is_folded=True),
    ReportSection(120, "skipped", "Skipped steps", _skipped_steps_section, is_folded=True),
    ReportSection(130, "warnings", "Warnings", lambda data, _: bullets(data.warnings, "cautions")),
    ReportSection(140, "reproduce", "Reproduce", _reproduce, is_folded=True),
    ReportSection(150, "meaning", "Glossary", lambda data, _: _meanings(data), is_folded=True),
)
