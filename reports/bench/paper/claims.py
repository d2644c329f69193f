"""Verdicts on the paper's claims, with intervals.

A claim is compared for each reading, in each form of the algorithms. It is "yes" only if the whole
interval is on its side under all conditions (pictures, sizes and rivals), "no" if no interval
reaches its side, and otherwise depends on the conditions.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.special import bdtr

from reports.bench.paper.experiments import COMPILED, GU, LI, LOOPS, NUMPY, TEMPLATE
from reports.bench.paper.inputs import COVERED, WAVES
from reports.bench.paper.readings import READINGS, RECOMMENDED
from reports.bench.paper.scaling import power_law

#: Comparisons: form of the reading, and form of its rivals.
FORMS = {
    LOOPS: (LOOPS, LOOPS),
    NUMPY: (NUMPY, NUMPY),
    "NumPy, rivals as loops": (NUMPY, LOOPS),
    COMPILED: (COMPILED, COMPILED),
}
RIVALS = (GU, LI)
#: One minus the confidence of the interval of a median.
LEVEL = 0.05
# The paper's claim "more than twice as fast".
_PAPER_SPEEDUP = 2.0
#: Ends of an interval.
Interval = tuple[float, float]


def median_interval(values: Sequence[float]) -> Interval:
    """Interval of the median with a confidence of ``1 - LEVEL``; the range of few values.

    Source: David and Nagaraja, Order Statistics, 2003, section 7.1.
    """
    ordered, count = sorted(values), len(values)
    outside = [k for k in range(count // 2) if 2 * bdtr(k, count, 0.5) <= LEVEL]
    dropped = max(outside, default=0)
    return ordered[dropped], ordered[-1 - dropped]


def ratio_interval(times: Sequence[float], others: Sequence[float]) -> Interval:
    """Interval of the median ratio of two methods' times in the same rounds."""
    return median_interval([a / b for a, b in zip(times, others, strict=True)])


def verdict(intervals: Mapping[str, Interval], limit: float) -> dict[str, Any]:
    """Verdict on ``value > limit`` under all conditions, with the conditions if they differ."""
    sides: dict[str, list[str]] = {"yes": [], "no": [], "open": []}
    for condition, (low, high) in intervals.items():
        sides["yes" if low > limit else "no" if high <= limit else "open"].append(condition)
    used = {side: conditions for side, conditions in sides.items() if conditions}
    word = next(iter(used)) if len(used) == 1 else "depends"
    text = "; ".join(f"{side}: {', '.join(names)}" for side, names in used.items())
    return {
        "verdict": "depends" if word == "open" else word,
        "condition": "" if word in ("yes", "no") else text,
        "low": min(low for low, _ in intervals.values()),
        "high": max(high for _, high in intervals.values()),
    }


def claims(inputs: Mapping[str, Any], figures: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Compare each claim with the measurements, by reading and form."""
    covered = {name: result for name, result in inputs.items() if name in COVERED}
    checked = []
    for reading in READINGS:
        for form, (own, other) in FORMS.items():
            for claim, source, intervals, limit in _timed(covered, figures, reading, own, other):
                head = {"claim": claim, "source": source, "reading": reading, "form": form}
                checked.append(head | verdict(intervals, limit))
        order = {name: _order(result["quality"], reading) for name, result in covered.items()}
        checked.append({
            "claim": "SSIM of the middle view: above gu2020, and gu2020 above li2012",
            "source": "Fig. 8 to 11 (0.78, 0.74, 0.67)", "reading": reading, "form": "",
        } | verdict(order, 0.0))  # fmt: skip
    return [*checked, *_template(covered)]


def _timed(
    covered: Mapping[str, Any], figures: Mapping[str, Any], reading: str, own: str, other: str
) -> Iterator[tuple[str, str, dict[str, Interval], float]]:
    """Claims on time, with their sources, intervals by condition, and limits."""
    rivals = [rival for rival in RIVALS if rival != LI or other != NUMPY]
    for rival in rivals:
        ratios = {
            name: ratio_interval(result["times"][rival][other], result["times"][reading][own])
            for name, result in covered.items()
        }
        yield f"more than twice as fast as {rival}", "abstract", ratios, _PAPER_SPEEDUP
    by_size = {
        f"{rival} at {p['size']:,}": ratio_interval(
            p["times"][rival][other], p["times"][reading][own]
        )
        for rival in rivals
        for p in figures["Fig. 13"][WAVES]
    }
    yield "the fastest for any number of pixels of an elemental image", "Fig. 13", by_size, 1.0
    for figure, size in (("Fig. 12", "scene pixels"), ("Fig. 14", "elemental images")):
        points = figures[figure][WAVES]
        slower = {rival: _excess_power(points, rival, other, reading, own) for rival in rivals}
        yield f"time grows more slowly with {size} than that of the rivals", figure, slower, 0.0


def _excess_power(
    points: Sequence[Mapping[str, Any]], rival: str, other: str, reading: str, own: str
) -> Interval:
    """Exponent with which a rival's time of one EIA grows with a size, minus that of a reading."""
    sizes, pixels = ([p[key] for p in points] for key in ("size", "pixels"))

    def powers(name: str, form: str) -> list[float]:
        rounds = zip(*(p["times"][name][form] for p in points), strict=True)
        return [power_law(sizes, np.multiply(us, pixels)) for us in rounds]

    pairs = zip(powers(rival, other), powers(reading, own), strict=True)
    return median_interval([a - b for a, b in pairs])


def _order(quality: Mapping[str, Any], reading: str) -> Interval:
    """Smaller difference of the paper's order: of the reading to gu2020, of gu2020 to li2012."""
    differences = quality["differences"]
    ends = [differences[reading][GU][1:], differences[GU][LI][1:]]
    return min(low for low, _ in ends), min(high for _, high in ends)


def _template(covered: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Speed and error of `template` against the recommended reading, both compiled."""
    ratios, gains = {}, {}
    for name, result in covered.items():
        times, psnr = result["times"], result["quality"]["psnr"]
        ratios[name] = ratio_interval(times[RECOMMENDED][COMPILED], times[TEMPLATE][COMPILED])
        gains[name] = (psnr[TEMPLATE] - psnr[RECOMMENDED],) * 2
    head = {"source": "this project", "reading": RECOMMENDED, "form": "both compiled"}
    yield head | {"claim": "template is faster"} | verdict(ratios, 1.0)
    yield head | {"claim": "template has the higher EIA PSNR, dB"} | verdict(gains, 0.0)
