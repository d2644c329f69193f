"""How all reports write numbers and scores, and the rule by which a check counts as passed.

A number is written the same way in the page, the Markdown and the JUnit file, and whatever is
missing, of another type or not a number shows as "–" and passes nothing. What is shown of scores
follows the metrics that `inim.metrics` knows.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypeGuard

from inim.metrics import Metric, all_metrics, find
from inim.metrics.headline import HEADLINE, MAIN

ScoreKind = Literal["scene", "ceiling", "relic", "relic to ceiling", "eia"]

#: The scene itself; the true EIA through the lenses; and that EIA, on the panel.
TRUTH, CEILING, TRUE_EIA = "Ground truth", "Ceiling", "True EIA"

MISSING = "–"
INFINITE = "∞"
NBSP = "\u00a0"
_DIGITS = 4  # of a number that is no metric's
_MOST_DIGITS = 12
_RELATIONS = {">=": "≥", "<=": "≤", "==": "=", "!=": "≠", "within": "within ±"}

# What XML 1.0 cannot hold at all, and HTML and Markdown should not: controls, lone surrogates.
_UNPRINTABLE = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def plain(value: object) -> str:
    """`value` as text that every format can hold: unprintable characters become U+FFFD."""
    return _UNPRINTABLE.sub("\ufffd", str(value))


def part(data: Any, *keys: str) -> Mapping[str, Any]:
    """The mapping under nested `keys`, empty when it is missing or not a mapping."""
    for key in keys:
        data = data.get(key) if isinstance(data, Mapping) else None
    return data if isinstance(data, Mapping) else {}


def items(data: Any, key: str) -> Sequence[Any]:
    """The list under `key`, empty when it is missing or not a list."""
    found = data.get(key) if isinstance(data, Mapping) else None
    return found if isinstance(found, (list, tuple)) else ()


def viewpoint_names(data: Mapping[str, Any]) -> list[str]:
    """The names of the viewpoints, in the order of the report."""
    return [str(v["name"]) for v in items(data, "viewpoints") if "name" in part(v)]


def is_number(value: object) -> TypeGuard[float]:
    """Whether `value` is a number that can be compared: neither missing nor NaN."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return False
    return not math.isnan(value)


def number(value: object, digits: int) -> str:
    """`value` with fixed digits and a true minus sign; "–" where there is none."""
    if not is_number(value):
        return MISSING
    shown = INFINITE if math.isinf(value) else f"{abs(value):.{digits}f}"
    return f"−{shown}" if value < 0 else shown


def short(value: object) -> str:
    """Any scalar, numbers with at most four significant digits."""
    if value is None:
        return MISSING
    if isinstance(value, bool):
        return "yes" if value else "no"
    if not isinstance(value, float):
        return plain(value)
    return f"{value:.4g}".replace("-", "−") if math.isfinite(value) else number(value, 0)


def mm(value: object) -> str:
    """A length with four significant digits."""
    return f"{short(value)}{NBSP}mm" if is_number(value) else MISSING


def per_cent(share: object, digits: int) -> str:
    """A share of one in per cent."""
    return f"{number(100 * share, digits)}{NBSP}%" if is_number(share) else MISSING


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

    Parameters
    ----------
    scores : mapping
        By key.
    kind : {"scene", "ceiling", "relic", "relic to ceiling", "eia"}
        A view's to the scene or to the ceiling, of the whole or on the relic; an EIA's to the
        true one.
    """
    found = []
    for metric in all_metrics():
        if (kind.startswith("relic") and not metric.on_relic) or (
            kind == "eia" and not metric.of_eia
        ):
            continue
        keys = {
            "ceiling": metric.to_ceiling_key,
            "relic": metric.on_relic_key,
            "relic to ceiling": metric.on_relic_to_ceiling_key,
        }
        shown = score(scores, keys.get(kind, metric.key))
        unit = f"{NBSP}{metric.unit}" if metric.unit and shown != MISSING else ""
        found.append((metric.label, shown + unit))
    return found


def _may_be_infinite(metric: Metric | None) -> bool:
    return metric is not None and any(map(math.isinf, metric.range))


def relation(check: Mapping[str, Any]) -> str:
    """The sign between a check's value and its limit."""
    sign = str(check.get("relation", ""))
    return _RELATIONS.get(sign, sign)


def checks(data: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Every check of the verdict, in the order of the report."""
    return [part(check) for check in items(part(data, "verdict"), "checks")]


def check_value(check: Mapping[str, Any], key: str = "value") -> str:
    """A check's value (or limit), with the digits of its metric, or more where those mislead.

    "0.9000 ≥ 0.9000, failed" helps nobody, nor does a limit of 0.000001 printed as "0.0000".
    """
    if key == "value" and _is_infinite(check):
        return INFINITE
    if check.get("unit") is not None:  # of a comparison, in units of its own
        unit = plain(check["unit"])
        return short(check.get(key)) + (f"{NBSP}{unit}" if unit else "")
    digits = _digits(check)
    while digits < _MOST_DIGITS and _misleads(check, key, digits):
        digits += 1
    return number(check.get(key), digits)


def _misleads(check: Mapping[str, Any], key: str, digits: int) -> bool:
    """Whether so few digits make a value the same as its limit, or zero."""
    value, limit, shown = check.get("value"), check.get("limit"), check.get(key)
    if is_number(shown) and shown != 0 and number(abs(shown), digits) == number(0, digits):
        return True
    if not (is_number(value) and is_number(limit)) or value == limit:
        return False
    return number(value, digits) == number(limit, digits)


def check_finding(check: Mapping[str, Any]) -> str:
    """A check's value and its limit."""
    return f"{check_value(check)}, required {relation(check)} {check_value(check, 'limit')}"


def check_interval(check: Mapping[str, Any]) -> str:
    """The confidence interval of a check's value; empty where its noise is not known."""
    ends = items(check, "interval")
    if len(ends) != 2 or not all(map(is_number, ends)):
        return ""
    if check.get("unit") is not None:
        return f"{short(float(ends[0]))} to {short(float(ends[1]))}"
    return " to ".join(number(end, _digits(check)) for end in ends)


def check_sentence(check: Mapping[str, Any]) -> str:
    """A check's value and limit in one line, with its interval and its own detail."""
    interval, detail = check_interval(check), str(check.get("detail") or "")
    finding = check_finding(check) + (f" (interval {interval})" if interval else "")
    return f"{finding}. {detail}" if detail else finding


def check_passed(check: Mapping[str, Any]) -> bool:
    """Whether a check counts as passed: it is marked so, and it compared two numbers."""
    value_is_known = is_number(check.get("value")) or _is_infinite(check)
    return check.get("passed") is True and value_is_known and is_number(check.get("limit"))


def _metric_of(check: Mapping[str, Any]) -> Metric | None:
    """The metric that a check names."""
    name = str(check.get("name", "")).lower()
    return next((m for m in all_metrics() if m.label.lower() in name), None)


def _digits(check: Mapping[str, Any]) -> int:
    metric = _metric_of(check)
    return metric.digits if metric else _DIGITS


def _is_infinite(check: Mapping[str, Any]) -> bool:
    return check.get("value", MISSING) is None and _may_be_infinite(_metric_of(check))


def verdict(data: Mapping[str, Any]) -> str:
    """The verdict in a word or two.

    Returns
    -------
    {"passed", "ran clean", "failed", "no verdict"}
        "ran clean" where all checks passed, but none is of quality; "no verdict" where nothing was
        checked.
    """
    if part(data, "verdict").get("passed") is not True:
        return "failed"
    if not checks(data):
        return "no verdict"
    if not all(map(check_passed, checks(data))):
        return "failed"
    # Of quality: against a limit that somebody set, or a baseline.
    judged = any("criterion" in check or "kind" in check for check in checks(data))
    return "passed" if judged else "ran clean"


def verdict_words(data: Mapping[str, Any]) -> str:
    """The same, and that nobody said how good is good enough, where that is so."""
    found = verdict(data)
    words = f"{found}; no criteria set" if found == "ran clean" else found
    return f"preview, {words}" if full_command(data) else words


#: Above a preview's scores, before the command that makes the full report.
PREVIEW_WORDS = "A preview, by few samples: its scores are rough, and no baseline. The full report:"


def full_command(data: Mapping[str, Any]) -> str:
    """The command line that makes the full report, of a preview; empty where it is none."""
    return plain(part(data, "preview").get("full_command", ""))


def headlines(data: Mapping[str, Any], algorithm: str) -> list[float]:
    """The headline scores of an algorithm's views, as far as there are any."""
    views = part(data, "algorithms", algorithm, "views")
    values = [part(views, name).get(HEADLINE) for name in viewpoint_names(data)]
    return [float(value) for value in values if is_number(value) and math.isfinite(value)]


def best_algorithm(data: Mapping[str, Any]) -> str | None:
    """The algorithm with the best mean headline score; the first one named on a tie.

    One that lacks any of the scores is never the best while another has them all; None without any
    score.
    """

    def rank(algorithm: str) -> tuple[int, float]:
        known = headlines(data, algorithm)
        return len(known), sum(known) / len(known) if known else 0.0

    best = max(part(data, "algorithms"), key=rank, default=None)
    return best if best is not None and rank(best)[0] else None


def disagreements(data: Mapping[str, Any]) -> list[str]:
    """Sentences on metrics that prefer another algorithm than the headline score does.

    By means over the views, to the ceiling, on the relic where a metric knows it; a difference
    below the metric's tolerance is none.
    """
    best, sentences = best_algorithm(data), []
    for metric in all_metrics():
        key = metric.on_relic_to_ceiling_key if metric.on_relic else metric.to_ceiling_key
        if best is None or key == HEADLINE:
            continue
        means = {
            name: sum(values) / len(values)
            for name in part(data, "algorithms")
            if (values := _views_scores(data, name, key))
        }
        sign = 1 if metric.better == "higher" else -1
        other = max(means, key=lambda name: sign * means[name], default=best)
        if best not in means or sign * (means[other] - means[best]) <= metric.tolerance:
            continue
        better, worse = (
            f"{number(means[name], metric.digits)}{NBSP}{metric.unit}".rstrip(NBSP)
            for name in (other, best)
        )
        sentences.append(
            f"{metric.label} disagrees: it finds {other} better than {best}, {better} against "
            f"{worse} to the ceiling."
        )
    return sentences


def _views_scores(data: Mapping[str, Any], algorithm: str, key: str) -> list[float]:
    """A score of all views; empty where one has none."""
    views = [part(data, "algorithms", algorithm, "views", v) for v in viewpoint_names(data)]
    values = [view.get(key) for view in views]
    known = [float(value) for value in values if is_number(value)]
    return known if len(known) == len(values) else []


def by_noise(run: Mapping[str, Any], view: str, key: str) -> float | None:
    """Half the width of a score's interval, from its algorithm's or the ceiling's data."""
    ends = items(part(run, "precision", view, key), "interval")
    if len(ends) != 2 or not all(map(is_number, ends)) or not all(map(math.isfinite, ends)):
        return None
    return (float(ends[1]) - float(ends[0])) / 2


def suggested_criteria(data: Mapping[str, Any]) -> str:
    """A value of `inim.min_ssim_to_ceiling` that this run would just pass; empty without scores.

    Of each algorithm its worst view's headline, less what noise and the smallest change that counts
    may take from it, rounded down to a hundredth. A preview's scores suggest none.
    """
    if full_command(data):
        return ""
    limits = []
    for name in part(data, "algorithms"):
        run, found = part(data, "algorithms", name), headlines(data, name)
        if found and len(found) == len(viewpoint_names(data)):
            noise = max(by_noise(run, v, HEADLINE) or 0.0 for v in viewpoint_names(data))
            least = math.floor(100 * (min(found) - noise - MAIN.tolerance)) / 100
            limits.append(f"{name}:{max(least, 0.0):.2f}")
    return ", ".join(limits)
