"""The paper's claims about time and depth steps, compared with the measurements.

Each claim is checked for three readings of the equations. The scene pixel P_I of Eq. 5 is either
the picture's pixel or P_I of Eq. 3 for every picture (`step_pixel=scene`). In the third reading
the search also stays on the ray, which deviates from Eq. 7 to 10 as printed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from reports.bench.paper.plain_python import PLAIN_PYTHON
from reports.bench.paper.scaling import power_law

#: The paper's algorithm in all readings; the first is the default.
READINGS = (
    "wang2024",
    "wang2024:step_pixel=scene",
    "wang2024:matching=ray:step_pixel=scene",
)
# The paper's claim "more than twice as fast".
_PAPER_SPEEDUP = 2.0
# This project's claim on `template`, compiled, against the paper's algorithm in plain Python.
_TEMPLATE_SPEEDUP = 1000.0
_RIVALS = ("gu2020", "li2012")


def claims(
    experiments: Sequence[Mapping[str, Any]],
    same: Mapping[str, Any],
    steps: Sequence[Mapping[str, Any]],
) -> list[dict[str, Any]]:
    """Check each claim against the measurements of `reports.bench.paper.experiments.bench_paper`.

    `found` is the measurement in words; `why` is the reason if the claim does not hold. Only
    methods that took part are compared.
    """
    points = {c["name"]: c for c in same["algorithms"]}
    rivals = [name for name in _RIVALS if name + PLAIN_PYTHON in points]
    checked = []
    for reading in (name for name in READINGS if name + PLAIN_PYTHON in points):
        checked += [_speedup(points, reading, rival) for rival in rivals]
        checked.append(_fastest(experiments, reading, rivals))
        checked += [_slow_growth(experiments, reading, rivals, *growth) for growth in _GROWTHS]
        checked.append(_order(points, reading, rivals))
    return [*checked, *_step_bounds(steps), _template_speedup(points)]


def _claim(
    claim: str, source: str, measurement: str, *, holds: bool, why: str = ""
) -> dict[str, Any]:
    return {
        "claim": claim, "source": source, "found": measurement, "holds": holds,
        "why": "" if holds else why,
    }  # fmt: skip


def _speedup(points: Mapping[str, Any], reading: str, rival: str) -> dict[str, Any]:
    """Time of a rival relative to that of `wang2024`, both in plain Python."""
    ratio, compiled = (
        points[rival + form]["median_ms"] / points[reading + form]["median_ms"]
        for form in (PLAIN_PYTHON, "")
    )
    return _claim(
        f"{reading} is more than twice as fast as {rival}",
        "paper, abstract",
        f"{rival} takes {ratio:.3g} times as long as {reading} in plain Python; {compiled:.3g} "
        "times compiled, on all threads",
        holds=ratio > _PAPER_SPEEDUP,
        why=(_RAY_SEARCH if "matching=ray" in reading else _MATRIX_SEARCH) + _EQUAL_CODE,
    )


_MATRIX_SEARCH = (
    "As printed (Eq. 7 to 10), wang2024 searches all z_len x z_len entries of the matrix for each "
    "pixel, although the ray crosses only its diagonal. Its work grows with the square of the "
    "number of samples along a ray. The work of gu2020 grows with this number, and that of li2012 "
    "with the picture's covered pixels."
)
_RAY_SEARCH = (
    "wang2024 compares every sample of a template, while a reverse search ends at the first hit. "
    "A template is short near the lens's centre; a reverse search is not."
)
_EQUAL_CODE = (
    " The reason is the number of operations, not the language: both forms run the same code."
)


def _fastest(
    experiments: Sequence[Mapping[str, Any]], reading: str, rivals: Sequence[str]
) -> dict[str, Any]:
    """Times of the rivals for every size of one elemental image, in plain Python."""
    sizes, *times = (_series(experiments, "elemental_pixels", name) for name in (reading, *rivals))
    ratios = {
        rival: [other["min_ms"] / own["min_ms"] for own, other in zip(sizes, series, strict=True)]
        for rival, series in zip(rivals, times, strict=True)
    }
    ranges = ", ".join(
        f"{rival} takes {min(r):.3g} to {max(r):.3g} times as long" for rival, r in ratios.items()
    )
    first, last = (sizes[end]["elemental_pixels"] for end in (0, -1))
    return _claim(
        f"{reading} is the fastest for any number of pixels of an elemental image",
        "paper, Fig. 13",
        f"from {first:,} to {last:,} pixels of one elemental image, {ranges}, in plain Python",
        holds=min(map(min, ratios.values())) > 1,
        why=_WHY_NOT_FASTEST,
    )


_WHY_NOT_FASTEST = (
    "Each pixel of the elemental image has a separate template. The work grows with their number, "
    "as for a reverse search. Forward mapping projects the picture's pixels through the lens "
    "once, for any number of panel pixels under the lens."
)


# Size, claim, figure, and the general reason if the claim does not hold.
_GROWTHS = (
    (
        "scene_pixels",
        "grows slowly with the scene's pixels, more slowly than that of its rivals",
        "Fig. 12",
        "A finer picture gives more samples along each ray (Eq. 5 and 6: one per picture pixel of "
        "sideways travel). The matrix has the square of this number, which is proportional to the "
        "number of picture pixels. A reverse search in steps of P_I does not depend on the "
        "picture, unless rays end earlier.",
    ),
    (
        "lenses",
        "grows more slowly with the number of elemental images than that of its rivals",
        "Fig. 14",
        "Elemental images share their templates, but each of their pixels is searched. The times "
        "of all three algorithms are proportional to the number of elemental images, plus work "
        "that is done once. This constant lowers the fitted power of small arrays.",
    ),
)


_SCENE_STEPS = (
    "With steps of P_I, templates depend on the picture as little as a reverse search does."
)


def _slow_growth(
    experiments: Sequence[Mapping[str, Any]],
    reading: str,
    rivals: Sequence[str],
    size: str,
    growth: str,
    figure: str,
    why: str,
) -> dict[str, Any]:
    """Powers with which time grows with a size, in plain Python."""
    law, *others = laws = [
        power_law(_series(experiments, size, name), size) for name in (reading, *rivals)
    ]
    named = zip((reading, *rivals), laws, strict=True)
    powers = ", ".join(f"{name} {law.power:.2f} ± {law.error:.2f}" for name, law in named)
    slower = [n for n, other in zip(rivals, others, strict=True) if law.is_below(other)]
    if size == "scene_pixels" and "step_pixel=scene" in reading:
        why = _SCENE_STEPS
    but = f" The time does grow more slowly than that of {', '.join(slower)}." if slower else ""
    return _claim(
        f"the time of {reading} {growth}",
        f"paper, {figure}",
        f"time grows with the {size.replace('_', ' ')} to the power of {powers} (1: linear, 0: "
        "constant)",
        holds=len(slower) == len(rivals),
        why=why + but,
    )


def _order(points: Mapping[str, Any], reading: str, rivals: Sequence[str]) -> dict[str, Any]:
    """Order of the algorithms by the middle view's SSIM."""
    values = {name: points[name]["middle_view_ssim"] for name in (reading, *rivals)}
    return _claim(
        f"the middle view's SSIM is best for {reading} (0.78), then gu2020 (0.74), then li2012 "
        "(0.67)",
        "paper, middle view of its own scenes: only the order can be compared",
        f"on the two spheres: {', '.join(f'{n} {v:.3f}' for n, v in values.items())}",
        holds=[*values.values()] == sorted(values.values(), reverse=True),
        why=_WHY_NOT_ORDER,
    )


_WHY_NOT_ORDER = (
    "The best match in the matrix may be off the ray and behind a nearer surface. The first hit of "
    "a reverse search is not. Scene, view and reference differ from the paper's. The measurement "
    "contradicts the paper's order, not its numbers."
)


def _step_bounds(steps: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Lower and upper bound of 2 g P_I / P <= Step_z <= g P_I."""
    least = "; ".join(
        f"{s['display']}: {s['least_mm']:.4g} mm, bound {s['lower_mm']:.4g} mm" for s in steps
    )
    most = "; ".join(
        f"{s['display']}: {s['most_mm']:,.0f} mm, bound {s['upper_mm']:.4g} mm, exceeded in "
        f"{s['beyond']} of {s['columns']} columns of pixels, {s['endless']} of them without a step"
        for s in steps
    )
    return [
        _claim(
            "Step_z is at least 2 g P_I / P",
            "paper, text on Eq. 5",
            f"smallest step, {least}",
            holds=all(s["least_mm"] >= s["lower_mm"] for s in steps),
            why="An elemental image extends beyond half a pitch from its lens's centre.",
        ),
        _claim(
            "Step_z is at most g P_I",
            "paper, text on Eq. 5",
            f"largest step, with the distance from the lens's centre counted in panel pixels, "
            f"{most}. In millimetres the upper bound is {steps[0]['upper_in_mm']:.4g} mm, below "
            "the lower bound",
            holds=not any(s["beyond"] for s in steps),
            why=_WHY_NOT_BELOW,
        ),
    ]


_WHY_NOT_BELOW = (
    "g P_I is a length only if |x0 - x| is in panel pixels and at least 1; with P_I of Eq. 3 it is "
    "|D|. If a lens has an odd number of pixels, their centres are whole pixels away from the "
    "lens's centre, and the pixel under the centre has no step (Eq. 5 divides by zero). If the "
    "number is even or not whole, the innermost pixels are nearer than one pixel."
)


def _template_speedup(points: Mapping[str, Any]) -> dict[str, Any]:
    """Speed and error of compiled `template` against the paper's algorithm in plain Python."""
    slow, fast = points[f"wang2024{PLAIN_PYTHON}"], points["template"]
    ratio = slow["median_ms"] / fast["median_ms"]
    is_better = fast["eia_psnr_db"] > slow["eia_psnr_db"] and (
        fast["wrong_source"] < slow["wrong_source"]
    )
    return _claim(
        "template is at least 1000 times as fast as wang2024 in plain Python, with a lower error "
        "on the same input",
        "this project",
        f"{ratio:,.0f} times as fast; pixels with a wrong source "
        f"{100 * fast['wrong_source']:.2f} % against {100 * slow['wrong_source']:.2f} %, EIA PSNR "
        f"{fast['eia_psnr_db']:.2f} dB against {slow['eia_psnr_db']:.2f} dB",
        holds=ratio >= _TEMPLATE_SPEEDUP and is_better,
        why="The table of the common input lists both algorithms.",
    )


def _series(experiments: Sequence[Mapping[str, Any]], size: str, name: str) -> list[dict[str, Any]]:
    """Points of one method in plain Python, over one size."""
    return [
        {size: point[size], "min_ms": method["min_ms"]}
        for experiment in experiments
        if experiment["size"] == size
        for point in experiment["points"]
        for method in point["algorithms"]
        if method["name"] == name + PLAIN_PYTHON
    ]
