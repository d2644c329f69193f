"""Labels of all reports: numbers, scores and checks.

A number has the same form in the page, the Markdown and the JUnit file; missing and invalid
values appear as "–". The scores follow
the metrics in `inim.metrics`.
"""

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypeGuard

from inim.generators.registry import is_optimal
from inim.report.document import ReportDocument
from inim.scores.document_parts import Check
from inim.scores.metrics import HEADLINE, Metric, all_metrics, find, preferred_algorithm, psnr

ScoreKind = Literal["scene", "reference", "relic", "relic to reference", "eia"]


#: Ground-truth view; reference view; ground-truth EIA.
TRUTH, REFERENCE, TRUE_EIA = "Ground truth", "Reference", "Ground-truth EIA"
# What takes the place of the ground truth without a scene.
_OF_PICTURE = {
    "Ground-truth EIA": "Exact EIA",
    "ground-truth EIA": "exact EIA",
    "Ground truth": "Warped picture",
    "ground truth": "warped picture",
}

MISSING = "–"
INFINITE = "∞"
NBSP = "\u00a0"
_DIGITS = 4  # of a number that is no metric's
_MOST_DIGITS = 12
_RELATIONS = {">=": "≥", "<=": "≤", "within": "within ±"}

# What XML 1.0 cannot hold at all, and HTML and Markdown should not: controls, also of the direction
# of text, and lone surrogates.
_UNPRINTABLE = re.compile(
    "[^\t\n\r\x20-\x7e\xa0-\u2027\u202f-\u2065\u206a-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]"
)


def plain(value: object) -> str:
    """`value` as text that every format can hold: unprintable characters become U+FFFD."""
    return _UNPRINTABLE.sub("\ufffd", str(value))


def named(data: ReportDocument, words: str) -> str:
    """Words of our own on the ground truth; of a picture, on what takes its place."""
    for scene, picture in _OF_PICTURE.items() if data.picture is not None else ():
        words = words.replace(scene, picture)
    return words


def is_number(value: float | None) -> TypeGuard[float]:
    """True for a number that can be compared: neither missing nor NaN."""
    return value is not None and not math.isnan(value)


def number(value: float | None, digits: int) -> str:
    """`value` with fixed digits and a true minus sign; "–" where there is none."""
    if not is_number(value):
        return MISSING
    number_text = INFINITE if math.isinf(value) else f"{abs(value):.{digits}f}"
    return f"−{number_text}" if value < 0 else number_text


def last_digits(half_width: float, digits: int) -> int:
    """Half of an interval in units of the last of some digits, rounded up."""
    units: float = 10**digits
    return math.ceil(half_width * units - 1e-9)


def short(value: object) -> str:
    """Any scalar, numbers with at most four significant digits."""
    if value is None:
        return MISSING
    if isinstance(value, bool):
        return "yes" if value else "no"
    if not isinstance(value, float):
        return plain(value)
    return f"{value:.4g}".replace("-", "−") if math.isfinite(value) else number(value, 0)


def aligned(columns: Sequence[Sequence[str]]) -> list[str]:
    """Lines of columns of text, the first one aligned to the left and the others to the right."""
    widths = [max(map(len, column)) for column in columns]
    return [
        "  ".join(c.rjust(w) if i else c.ljust(w) for i, (c, w) in enumerate(cells)).rstrip()
        for cells in (zip(row, widths, strict=True) for row in zip(*columns, strict=True))
    ]


def mm(value: float | None) -> str:
    """A length with four significant digits."""
    return f"{short(value)}{NBSP}mm" if is_number(value) else MISSING


def per_cent(share: float | None, digits: int) -> str:
    """A share of one in per cent."""
    return f"{number(100 * share, digits)}{NBSP}%" if is_number(share) else MISSING


def shares_of_possible(data: ReportDocument) -> dict[str, float]:
    """Share of what is possible that each algorithm reaches, the best first.

    The least possible error of the views, that of `optimal`, divided by the algorithm's: root mean
    squares, from the mean PSNR of whole views to the ground truth. Empty without `optimal`.
    """
    psnr_db = {name: data.mean(name, psnr.metric.key) for name in data.algorithms}
    optima = [psnr_db.pop(name) for name in data.algorithms if is_optimal(name)]
    if not optima:
        return {}
    best = optima[0]
    shares = {
        name: 10 ** ((value - best) / 20)
        for name, value in psnr_db.items()
        if best is not None and value is not None
    }
    return dict(sorted(shares.items(), key=lambda item: -item[1]))


def usual_terms(terms: Mapping[str, str]) -> str:
    """The most frequent rays and colours of algorithms (`AlgorithmResult.terms`)."""
    return max(terms.values(), key=[*terms.values()].count, default="")


def unequal_terms(terms: Mapping[str, str]) -> list[str]:
    """Line on algorithms with other rays or colours than the usual ones; none if all are equal."""
    usual = usual_terms(terms)
    unequal = [f"{name} ({text})" for name, text in terms.items() if text != usual]
    return [f"unequal: {', '.join(unequal)}; all others have {usual}"] * bool(unequal)


def unequal_algorithms(data: ReportDocument) -> list[str]:
    """`unequal_terms` of a report's generators."""
    return unequal_terms({n: result.terms for n, result in data.algorithms.items() if result.terms})


def short_names(algorithms: Sequence[str]) -> dict[str, str]:
    """Short names by algorithm: without the options that all of them have."""
    options = [name.split(":")[1:] for name in algorithms]
    common = set(options[0]).intersection(*options) if options else set()
    return {
        name: ":".join(part for part in name.split(":") if part not in common)
        for name in algorithms
    }


def score(scores: Mapping[str, Any], key: str) -> str:
    """One of `scores` with the digits of its metric; ``hole_fraction`` in per cent.

    An infinite score, such as the PSNR of identical images, is null in JSON.
    """
    if key not in scores:
        return MISSING
    if key == "hole_fraction":
        return per_cent(scores[key], 2)
    metric = find(key)
    if scores[key] is None and _may_be_infinite(metric):
        return INFINITE
    return number(scores[key], metric.digits if metric else _DIGITS)


def metric_scores(scores: Mapping[str, Any], kind: ScoreKind = "scene") -> list[tuple[str, str]]:
    """Label and score, with its unit, of every metric that has scores of a kind.

    * `kind`, {"scene", "reference", "relic", "relic to reference", "eia"}: a view's to the scene or
      to the reference, of the whole or on the relic; an EIA's to the true one.
    """
    texts = []
    for metric in all_metrics():
        if key := score_keys(metric).get(kind):
            score_text = score(scores, key)
            unit = f"{NBSP}{metric.unit}" if metric.unit and score_text != MISSING else ""
            texts.append((metric.label, score_text + unit))
    return texts


def score_keys(metric: Metric) -> dict[ScoreKind, str]:
    """Names of a metric's scores by kind, as far as it has them."""
    keys: dict[ScoreKind, str] = {"reference": metric.to_reference_key, "scene": metric.key}
    if metric.has_relic_score:
        keys["relic to reference"] = metric.on_relic_to_reference_key
        keys["relic"] = metric.on_relic_key
    return keys | ({"eia": metric.key} if metric.has_eia_score else {})


def _may_be_infinite(metric: Metric | None) -> bool:
    return metric is not None and any(map(math.isinf, metric.range))


def relation(check: Check) -> str:
    """The sign between a check's value and its limit."""
    return _RELATIONS[check.relation]


def check_value(check: Check) -> str:
    """A check's value, with the digits of its metric, or more where those mislead."""
    if check.value is None and _may_be_infinite(_metric_of(check)):
        return INFINITE
    return _check_number(check, check.value)


def check_limit(check: Check) -> str:
    """Limit of a check, with as many digits as its value."""
    return _check_number(check, check.limit)


def _check_number(check: Check, value: float | None) -> str:
    """Number of a check.

    The digits increase until a failed value differs from its limit, and a small limit from zero.
    """
    if check.unit is not None:  # a comparison, in units of its own
        unit = plain(check.unit)
        return short(value) + (f"{NBSP}{unit}" if unit else "")
    digits = _digits(check)
    while digits < _MOST_DIGITS and _misleads(check, value, digits):
        digits += 1
    return number(value, digits)


def _misleads(check: Check, displayed: float | None, digits: int) -> bool:
    """True if these digits make a value equal to its limit, or zero."""
    value, limit = check.value, check.limit
    if displayed and number(abs(displayed), digits) == number(0, digits):
        return True
    if not (is_number(value) and is_number(limit)) or value == limit:
        return False
    return number(value, digits) == number(limit, digits)


def check_finding(check: Check) -> str:
    """A check's value and its limit."""
    return f"{check_value(check)}, required {relation(check)} {check_limit(check)}"


def check_interval(check: Check) -> str:
    """Confidence interval of a check's value; empty if its noise is unknown."""
    low, high = check.interval or (None, None)
    if not (is_number(low) and is_number(high)):
        return ""
    if check.unit is not None:
        return f"{short(float(low))} to {short(float(high))}"
    return " to ".join(number(end, _digits(check)) for end in (low, high))


def check_sentence(check: Check) -> str:
    """A check's value and limit in one line, with its interval and its own detail."""
    interval, finding = check_interval(check), check_finding(check)
    low, high = (end or 0.0 for end in check.interval or (0.0, 0.0))
    # The limit of a change is often the half width of its interval.
    if interval and check.relation == "within" and math.isclose(high - low, 2 * check.limit):
        finding += ", its uncertainty"
    elif interval:
        finding += f" (interval {interval})"
    return f"{finding}. {check.detail}" if check.detail else finding


def _metric_of(check: Check) -> Metric | None:
    """The metric that a check names."""
    name = check.name.lower()
    return next((m for m in all_metrics() if m.label.lower() in name), None)


def _digits(check: Check) -> int:
    metric = _metric_of(check)
    return metric.digits if metric else _DIGITS


def verdict_words(document: ReportDocument) -> str:
    """The verdict, and a note if no criteria are set or the report is a preview."""
    word = document.verdict.word
    words = f"{word}; no criteria set" if word == "ran clean" else word
    if document.regression is not None:
        words += f"; against the baseline: {document.regression.verdict}"
    return f"preview, {words}" if full_command(document) else words


#: Above a preview's scores, before the command that makes the full report.
PREVIEW_WORDS = (
    "This preview uses few samples, so its scores are rough and it cannot be a baseline. For the "
    "full report, run:"
)


def full_command(document: ReportDocument) -> str:
    """The command line for the full report, if this one is a preview; empty otherwise."""
    if document.preview is None:
        return ""
    return plain(document.preview.full_command)


def disagreements(report: ReportDocument) -> list[str]:
    """Sentences on metrics that prefer another algorithm than the headline score does."""
    best, sentences = report.best_algorithm, []
    for metric in all_metrics():
        keys = score_keys(metric)
        key = keys.get("relic to reference", keys["reference"])
        if best is None or key == HEADLINE:
            continue
        means = {
            name: mean for name in report.algorithms if (mean := report.mean(name, key)) is not None
        }
        other = preferred_algorithm(metric, means, best)
        if other == best:
            continue
        better, worse = (
            f"{number(means[name], metric.digits)}{NBSP}{metric.unit}".rstrip(NBSP)
            for name in (other, best)
        )
        sentences.append(
            f"{metric.label} disagrees: it prefers {other} to {best}, with {better} against "
            f"{worse} to the reference."
        )
    return sentences


def difference_sentence(report: ReportDocument) -> str:
    """Difference of the best algorithm to the next one, with its interval; empty if unknown."""
    best = report.best_algorithm
    means = {n: m for n in report.algorithms if (m := report.mean(n, HEADLINE)) is not None}
    others = sorted(means.keys() - {best}, key=lambda name: -means[name])
    between = report.mean_difference(others[0]) if others else None
    if between is None:
        return ""
    value, low, high = (number(part, 3) for part in between)
    if between[1] > 0:
        return f"{best} is better than {others[0]} by {value} [{low}, {high}]."
    return f"{best} and {others[0]} do not differ significantly: {value} [{low}, {high}]."


def precise(value: float, interval: Sequence[float | None] | None, digits: int) -> str:
    """A score with its 95 % interval: ``0.985 ± 0.004``, or ``0.987 [0.985, 1.000]``.

    The short form is for intervals that are symmetric to the last digit.
    """
    low, high = (None, None) if interval is None else interval
    if not (is_number(low) and is_number(high) and math.isfinite(high - low)):
        return number(value, digits)
    if abs(high + low - 2 * value) <= 10.0**-digits:
        half = last_digits((high - low) / 2, digits) / 10**digits
        return f"{number(value, digits)} ± {number(half, digits)}"
    return f"{number(value, digits)} [{number(low, digits)}, {number(high, digits)}]"


def suggested_criteria(report: ReportDocument) -> str:
    """A value of `inim.min_ssim_to_reference` that this run would just pass; empty without scores.

    A preview's scores suggest none.
    """
    if full_command(report):
        return ""
    limits = report.passing_limits().items()
    return ", ".join(f"{name}:{limit:.2f}" for name, limit in limits if not is_optimal(name))
