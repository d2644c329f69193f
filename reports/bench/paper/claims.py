"""What the paper claims about time and steps, and what was measured: reproduced or not, and why.

Each is tried in three readings of the print. Eq. 5 counts in scene pixels P_I: taken for the
picture's own pixels, or for P_I of Eq. 3 whatever the picture has (`step_pixel=scene`). And with
these the search may keep to the ray, against the print of Eq. 7 to 10 but in its spirit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from reports.bench.paper.plain_python import PLAIN_PYTHON
from reports.bench.paper.scaling import PowerLaw, power_law

#: The paper's algorithm in all readings, the default first.
READINGS = (
    "wang2024",
    "wang2024:step_pixel=scene",
    "wang2024:matching=ray:step_pixel=scene",
)
# "More than twice as fast".
_TWICE = 2.0
# What the exact generator, compiled, has to be against plain Python.
_THOUSAND = 1000.0
_RIVALS = ("gu2020", "li2012")


def claims(
    experiments: Sequence[Mapping[str, Any]],
    same: Mapping[str, Any],
    steps: Sequence[Mapping[str, Any]] = (),
) -> list[dict[str, Any]]:
    """Each claim with what was found.

    Parameters
    ----------
    experiments, same, steps :
        See `reports.bench.paper.experiments.bench_paper`.

    Returns
    -------
    list of dict
        ``claim``, ``source``, ``found`` (a sentence), ``holds`` and ``why`` (empty where it holds).
    """
    points = {c["name"]: c for c in same["algorithms"]}
    found: list[dict[str, Any] | None] = []
    for reading in READINGS:
        found += [_twice(points, reading, rival) for rival in _RIVALS]
        found.append(_speed(experiments, reading))
        found += [_slow_growth(experiments, reading, *growth) for growth in _GROWTHS]
        found.append(_order(points, reading))
    found += [*_step_bounds(steps), _thousand(points)]
    return [claim for claim in found if claim]


def _claim(claim: str, source: str, found: str, *, holds: bool, why: str = "") -> dict[str, Any]:
    return {
        "claim": claim, "source": source, "found": found, "holds": holds,
        "why": "" if holds else why,
    }  # fmt: skip


def _twice(points: Mapping[str, Any], mine: str, rival: str) -> dict[str, Any] | None:
    """Time of a rival over that of `wang2024`, both in plain Python."""
    ratio = _ratio(points, rival + PLAIN_PYTHON, mine + PLAIN_PYTHON)
    if ratio is None:
        return None
    compiled = _ratio(points, rival, mine)
    also = "" if compiled is None else f"; {compiled:.3g} times compiled, on all threads"
    return _claim(
        f"{mine} is more than twice as fast as {rival}",
        "paper, abstract",
        f"{rival} takes {ratio:.3g} times as long as {mine} in plain Python{also}",
        holds=ratio > _TWICE,
        why=(_ALONG if "matching=ray" in mine else _MATRIX) + _ONE_CODE,
    )


_MATRIX = (
    "As printed (Eq. 7 to 10) wang2024 searches all z_len x z_len entries of the matrix for each "
    "pixel, although the ray crosses only its diagonal: its work grows with the square of the "
    "samples along a ray, that of gu2020 with their number, that of li2012 with the picture's "
    "covered pixels."
)
_ALONG = (
    "Every sample of a template is compared, while a reverse search ends at the first hit; a "
    "template is short near the lens's centre, a reverse search is not."
)
_ONE_CODE = " The count of operations, not the language, decides; both forms run the same lines."


def _speed(experiments: Sequence[Mapping[str, Any]], mine: str) -> dict[str, Any] | None:
    """Whether it is the fastest for every size of one elemental image, in plain Python."""
    own = _series(experiments, "elemental_pixels", mine + PLAIN_PYTHON)
    ratios: dict[str, list[float]] = {}
    for rival in _RIVALS:
        theirs = _series(experiments, "elemental_pixels", rival + PLAIN_PYTHON)
        if own and len(theirs) == len(own):
            ratios[rival] = [b["min_ms"] / a["min_ms"] for a, b in zip(own, theirs, strict=True)]
    if not ratios:
        return None
    shown = ", ".join(
        f"{rival} takes {min(r):.3g} to {max(r):.3g} times as long" for rival, r in ratios.items()
    )
    sizes = f"{own[0]['elemental_pixels']:,} to {own[-1]['elemental_pixels']:,}"
    return _claim(
        f"{mine} is the fastest, whatever the number of pixels of an elemental image",
        "paper, Fig. 13",
        f"from {sizes} pixels of one elemental image, {shown}, in plain Python",
        holds=min(min(r) for r in ratios.values()) > 1,
        why=_WHY_NOT_FASTEST,
    )


_WHY_NOT_FASTEST = (
    "Each pixel of the elemental image has a template of its own, so that the work grows with "
    "their number, as that of a reverse search. Forward mapping sends the picture's pixels "
    "through the lens once, however many pixels the panel has under it."
)


# What time grows with; the claim's words and figure; why it is not so, in general.
_GROWTHS = (
    (
        "scene_pixels",
        "grows slowly with the scene's pixels, more slowly than that of its rivals",
        "Fig. 12",
        "A finer picture means more samples along each ray (Eq. 5 and 6: one per picture pixel of "
        "sideways travel), and the matrix holds their square, which is proportional to the "
        "picture's pixels. Reverse search in steps of P_I does not depend on the picture at all, "
        "unless rays end earlier.",
    ),
    (
        "lenses",
        "grows more slowly with the number of elemental images than that of its rivals",
        "Fig. 14",
        "Elemental images share their templates, but each of their pixels is searched: all three "
        "take as many times longer as there are elemental images. What is done once for all of "
        "them weighs more where they are few, and lowers a power.",
    ),
)


_ALIKE = "In steps of P_I templates depend on the picture as little as reverse search does."


def _slow_growth(
    experiments: Sequence[Mapping[str, Any]],
    mine: str,
    size: str,
    words: str,
    figure: str,
    why: str,
) -> dict[str, Any] | None:
    """By which powers time grows with a size, in plain Python."""
    laws: dict[str, PowerLaw] = {}
    for name in (mine, *_RIVALS):
        law = power_law(_series(experiments, size, name + PLAIN_PYTHON), size)
        if law is not None:
            laws[name] = law
    if mine not in laws or len(laws) < 2:
        return None
    below = {name: laws[mine].is_below(law) for name, law in laws.items() if name != mine}
    shown = ", ".join(f"{name} {law.power:.2f} ± {law.error:.2f}" for name, law in laws.items())
    beaten = [name for name, one in below.items() if one]
    if size == "scene_pixels" and "step_pixel=scene" in mine:
        why = _ALIKE
    but = f" It does grow more slowly than that of {', '.join(beaten)}." if beaten else ""
    return _claim(
        f"the time of {mine} {words}",
        f"paper, {figure}",
        f"time grows with the {size.replace('_', ' ')} to the power of {shown} (1: linear, 0: "
        "flat)",
        holds=all(below.values()),
        why=why + but,
    )


def _order(points: Mapping[str, Any], mine: str) -> dict[str, Any] | None:
    """The order of the middle view's SSIM."""
    named = [n for n in (mine, "gu2020", "li2012") if n in points]
    if len(named) < 2 or (mine not in points and mine != READINGS[0]):
        return None
    values = [points[name]["middle_view_ssim"] for name in named]
    shown = ", ".join(f"{n} {v:.3f}" for n, v in zip(named, values, strict=True))
    return _claim(
        f"the middle view's SSIM is best for {mine} (0.78), then gu2020 (0.74), then li2012 (0.67)",
        "paper, middle view of its own scenes: only the order can be compared",
        f"here, on the two spheres: {shown}",
        holds=values == sorted(values, reverse=True),
        why=_WHY_NOT_ORDER,
    )


_WHY_NOT_ORDER = (
    "The best match anywhere in the matrix may lie off the ray and behind a nearer surface, which "
    "the first hit of a reverse search does not. Scene, view and reference differ from the "
    "paper's, so this contradicts its order, not its figures."
)


def _step_bounds(steps: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """2 g P_I / P <= Step_z <= g P_I: the lower one, then the upper one."""
    if not steps:
        return []
    least = "; ".join(
        f"{s['display']}: {s['least_mm']:.4g} mm, bound {s['lower_mm']:.4g} mm" for s in steps
    )
    most = "; ".join(
        f"{s['display']}: {s['most_mm']:,.0f} mm, bound {s['upper_mm']:.4g} mm, beyond it "
        f"{s['beyond']} of {s['columns']} columns of pixels, of which {s['endless']} without a step"
        for s in steps
    )
    one = steps[0]
    return [
        _claim(
            "Step_z is at least 2 g P_I / P",
            "paper, text on Eq. 5",
            f"smallest step, {least}",
            holds=all(s["least_mm"] >= s["lower_mm"] for s in steps),
            why="An elemental image reaches beyond half a pitch from its lens's centre.",
        ),
        _claim(
            "Step_z is at most g P_I",
            "paper, text on Eq. 5",
            f"largest step, with the distance from the lens's centre counted in panel pixels, "
            f"{most}. In millimetres the bound is {one['upper_in_mm']:.4g} mm, below the lower one",
            holds=not any(s["beyond"] for s in steps),
            why=_WHY_NOT_BELOW,
        ),
    ]


_WHY_NOT_BELOW = (
    "g P_I is a length only where |x0 - x| is counted in panel pixels and is 1 at least; with P_I "
    "of Eq. 3 it is |D|. Pixel centres lie whole pixels from their lens's centre where a lens has "
    "an odd number of pixels, and the one under the centre has no step at all (Eq. 5 divides by "
    "zero). Where the number is even, or not whole, the innermost are nearer than a pixel."
)


def _thousand(points: Mapping[str, Any]) -> dict[str, Any] | None:
    """Compiled exact templates against the paper's algorithm as the paper ran it."""
    slow, fast = points.get(f"wang2024{PLAIN_PYTHON}"), points.get("template")
    if not (slow and fast):
        return None
    ratio = slow["median_ms"] / fast["median_ms"]
    lower = fast["eia_psnr_db"] > slow["eia_psnr_db"] and (
        fast["wrong_source"] < slow["wrong_source"]
    )
    holds = ratio >= _THOUSAND and lower
    return {
        "claim": "template is at least 1000 times as fast as wang2024 in plain Python, at lower "
        "error on the same input",
        "source": "this project",
        "found": f"{ratio:,.0f} times as fast; pixels of a wrong source "
        f"{100 * fast['wrong_source']:.2f} % against {100 * slow['wrong_source']:.2f} %, EIA PSNR "
        f"{fast['eia_psnr_db']:.2f} dB against {slow['eia_psnr_db']:.2f} dB",
        "holds": holds,
        "why": "" if holds else "See the row of the table above.",
    }


def _ratio(points: Mapping[str, Any], above: str, below: str) -> float | None:
    if above not in points or below not in points:
        return None
    return float(points[above]["median_ms"] / points[below]["median_ms"])


def _series(experiments: Sequence[Mapping[str, Any]], size: str, name: str) -> list[dict[str, Any]]:
    """The points of one method over one size."""
    return [
        {size: point[size], "min_ms": method["min_ms"]}
        for experiment in experiments
        if experiment["size"] == size
        for point in experiment["points"]
        for method in point["algorithms"]
        if method["name"] == name
    ]
