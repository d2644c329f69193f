"""Lens models against their oracle, against each other, and under symmetries.

The oracle traces the same optics by other methods in 64-bit mantissas. It also gives the
sensitivity of each landing point to the ray's own digits, so that the limits hold for grazing rays.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import fields
from functools import lru_cache
from typing import Any

import numpy as np

from inim.apps.stress.oracles.lenses import Landing, LensRays, land
from inim.apps.stress.pictures import scaled
from inim.apps.stress.relation import (
    EPS,
    EPS32,
    LENS_MODELS,
    Deviation,
    difference,
    excess,
    is_true,
    relation,
)
from inim.display import Display
from inim.display.lens import (
    check_lens_model,
    lens_model,
    trace_to_panel,
    white_exposure,
)
from inim.display.lens.array import lens_array
from inim.generators.accuracy_limits import LANDING_PIXELS, WIDEST_PANEL_PIXELS
from inim.system.errors import DisplayError

_ANALYTIC = ("pinhole", "thin", "thick")
_COVERS = "display.lens display.layouts"
# Largest rounding error of a landing point, in ulps of the largest coordinate on the ray's path and
# in eps of the ray's numbers, which grazing rays amplify.
_BAND = 32.0
_NOTHING: dict[str, object] = {}
_SHEET: dict[str, object] = {
    "lattice": "lenticular", "lens_rows": 1, "panel_columns": 150, "panel_rows": 120,
    "rotation_deg": 10.0, "depth_min_mm": -5.0, "depth_max_mm": 5.0,
}  # fmt: skip
_GLUED = "0.4 1.41, 3.42184 1.52"
#: Lenses of each kind. Those with gaps between their lenses have no relief.
_KINDS: dict[str, dict[str, object]] = {
    "sphere": _NOTHING,
    "weak lens": {"focal_length_mm": 30.0, "gap_mm": 31.0},
    "steep lens": {"focal_length_mm": 2.0, "gap_mm": 2.2},
    "g near f": {"gap_mm": 3.0 * (1 + 2.0**-30), "depth_min_mm": 5.0, "depth_max_mm": 20.0},
    "virtual": {"gap_mm": 2.7},
    "thin sheet": {"lens_thickness_mm": 0.3},
    "high index": {"refractive_index": 1.9},
    "low index": {"refractive_index": 1.3, "focal_length_mm": 4.0},
    "paraboloid": {"conic": -1.0},
    "conic and asphere": {"conic": -0.6, "asphere_a4": 0.004, "asphere_a6": -0.002},
    "fourth order": {"asphere_a4": 0.01},
    "shifted by half a pitch": {"shift_x_mm": 0.5, "shift_y_mm": -0.21},
    "turned by 45 degrees": {"rotation_deg": 45.0},
    "tilted": {"tilt_x_deg": 2.0, "tilt_y_deg": -1.0},
    "misaligned": {"rotation_deg": 3.0, "tilt_x_deg": 10.0, "shift_y_mm": 0.31},
    "rows apart": {"pitch_y_mm": 1.2},
    "even numbers": {"lens_columns": 8, "lens_rows": 6},
    "round": {"aperture": "round", "fill_factor": 0.9},
    "dark between": {"fill_factor": 0.8, "pitch_y_mm": 1.1},
    "clear between": {"fill_factor": 0.7, "between_lenses": "clear", "layers": "0.5 1.52"},
    "clear about discs": {"aperture": "round", "between_lenses": "clear", "rotation_deg": 5.0},
    "hexagonal": {"lattice": "hexagonal"},
    "hexagonal, even, turned": {"lattice": "hexagonal", "lens_rows": 8, "rotation_deg": 20.0},
    "hexagonal, round": {"lattice": "hexagonal", "aperture": "round", "shift_x_mm": 0.2},
    "lenticular": _SHEET,
    "lenticular, filled": {**_SHEET, "fill_factor": 0.8, "shift_x_mm": 0.3},
    "layers": {"layers": "0.5 1.52, 0.1 1.41"},
    "tilted behind layers": {"layers": "0.5 1.52", "tilt_x_deg": 3.0, "rotation_deg": 7.0},
    "one lens": {"lens_columns": 1, "lens_rows": 1},
}  # fmt: skip


def _display(**changes: object) -> Display:
    """Nine by nine lenses like those of the nominal display."""
    values: dict[str, object] = {
        "pitch_mm": 1.0, "focal_length_mm": 3.0, "gap_mm": 3.3, "pixel_pitch_mm": 1 / 17,
        "lens_columns": 9, "lens_rows": 9,
    }  # fmt: skip
    return Display(**(values | changes))


def _rays(display: Display, count: int, slope: float = 0.15, seed: int = 0) -> LensRays:
    """Random rays over the inner lenses, with sideways travel `slope` in random directions.

    Their numbers are exact in float32. All errors are therefore errors of the computation.
    """
    rng = np.random.default_rng(seed)
    rows, columns = display.layout.grid
    inner = (max(columns - 4, 1), max(rows - 4, 1) if not display.layout.of_cylinders else 5)
    x, y = ((rng.random(count) - 0.5) * n * display.pitch_mm for n in inner)
    turn = rng.uniform(0, 2 * math.pi, count)
    slopes = slope * rng.uniform(0.3, 1.0, count) if slope else np.zeros(count)
    return _float32(x, y, slopes * np.cos(turn), slopes * np.sin(turn))


def _float32(*values: Any) -> LensRays:
    return LensRays(*(np.asarray(v, np.float32) for v in np.broadcast_arrays(*values)))


def _sensitive(
    display: Display, model: str, rays: LensRays, eps: float, index: float | None
) -> tuple[Landing, np.ndarray, np.ndarray]:
    """Oracle's landing, and its change in position and weight for an eps of the ray's numbers."""
    numbers = [np.asarray(getattr(rays, f.name), np.longdouble) for f in fields(LensRays)]
    varied = [
        [v * (1 + np.longdouble(eps)) if i == k else v for i, v in enumerate(numbers)]
        for k in (None, *range(4))
    ]
    landings = land(
        display, model, LensRays(*map(np.concatenate, zip(*varied, strict=True))), index
    )
    values = {f.name: getattr(landings, f.name).reshape(5, -1) for f in fields(Landing)}
    landing = Landing(**{name: value[0] for name, value in values.items()})
    with np.errstate(invalid="ignore"):
        moved = np.hypot(values["x"][1:] - landing.x, values["y"][1:] - landing.y).sum(axis=0)
        dimmed = np.abs(values["weight"][1:] - landing.weight).sum(axis=0)
    return landing, moved, dimmed


def _compare(
    case: str, display: Display, model: str, rays: LensRays, dtype: Any, *,
    index: float | None = None, in_pixels: bool = False, position: float | None = None,
) -> Deviation:  # fmt: skip
    """Deviation of landing points and weights from the oracle's.

    In multiples of the rounding errors, or in panel pixels. A ray that is lit in only one of the
    two deviates infinitely, except next to a border between lenses and to total reflection.
    """
    eps = float(np.finfo(dtype).eps)
    truth, moved, dimmed = _sensitive(display, model, rays, eps, index)
    x, y, weight = (
        np.asarray(a, np.longdouble)
        for a in trace_to_panel(
            display, model, rays.x, rays.y, rays.sx, rays.sy, dtype=dtype, index=index
        )
    )
    with np.errstate(invalid="ignore", over="ignore"):
        lit = (weight > 0) & (truth.weight > 0)
        error = np.where(lit, np.hypot(x - truth.x, y - truth.y), 0)
        sideways = np.hypot(rays.sx.astype(float), rays.sy.astype(float)) * display.gap_mm
        start = np.hypot(rays.x.astype(float), rays.y.astype(float))
        end = np.nan_to_num(np.hypot(truth.x, truth.y).astype(float))
        ulp = eps * np.maximum.reduce([start, end, sideways, start * 0 + display.pitch_mm])
        lost = lit & ~np.isfinite(moved)
        band = ulp + np.nan_to_num(moved, posinf=0)
        doubtful = (truth.edge * display.pitch_mm <= _BAND * band) | lost
        doubtful |= truth.reflection <= _BAND * eps
        far = error / (display.pixel_pitch_mm if in_pixels else band)
        dim = np.where(lit, np.abs(weight - truth.weight), 0) / (4 * eps + dimmed)
    far = np.where(lit & ~np.isfinite(far), np.inf, far)
    if not in_pixels:
        far = np.maximum(far, np.where(lit, dim, 0))
    far = np.where((weight > 0) != (truth.weight > 0), np.inf, far)
    slope = float(np.hypot(rays.sx.astype(float), rays.sy.astype(float)).max(initial=0.0))
    declared = lens_model(model)
    warned = slope > 1.001 * declared.steepest_slope
    warned |= display.refractive_index < declared.least_index
    warned |= max(display.eia_shape) > WIDEST_PANEL_PIXELS
    wrong = np.where(doubtful, 0, far)
    return Deviation(
        case, float(wrong.max(initial=0.0)), len(x), int((wrong > _BAND).sum()), position, 0.0,
        warned,
    )  # fmt: skip


def _sides(model: str, changes: dict[str, object]) -> Iterator[tuple[str, Display]]:
    for side in ("viewer", "panel") if model == "thick" else ("viewer",):
        display = _display(**{**changes, "curved_side": side})
        try:
            check_lens_model(model, display)
        except DisplayError:
            continue
        yield f"bulge to the {side}", display


@relation(
    "panel points of lenses", covers=_COVERS, limit=_BAND, unit="rounding errors",
    source="roundings of a refraction, and the ray's own digits", subjects=_ANALYTIC,
)  # fmt: skip
def _points(model: str, effort: int) -> Iterator[Deviation]:
    """Every kind of lens sends rays where the oracle does, with its share of light."""
    for seed, (name, changes) in enumerate(_KINDS.items()):
        for side, display in _sides(model, changes):
            for slope in (0.15, 0.5, 1.5)[: 1 + effort]:
                rays = _rays(display, 15 * effort, slope, seed)
                for dtype in (np.float64, np.float32)[: 1 + effort // 2]:
                    case = f"{name}, {side}, {slope:g}, {np.dtype(dtype).name}"
                    yield _compare(case, display, model, rays, dtype)
    glass = _display(refractive_index=1.6)
    for index in (1.58, 1.63):
        yield _compare(
            f"colour of index {index:g}", glass, model, _rays(glass, 20), np.float64, index=index
        )
    for side, display in _sides(model, {"layers": _GLUED}):
        yield _compare(f"glued, {side}", display, model, _rays(display, 20), np.float64)
    display = _display()
    for shift, slope in ((0.0, 0.0), (0.0, 0.1), (0.5, 0.1)):
        at = np.arange(-2.0, 3.0) + shift
        for towards in (-np.inf, np.inf) if shift else (0.0, -np.inf, np.inf):
            x = np.nextafter(at.astype(np.float32), np.float32(towards)) if towards else at
            rays = _float32(x, 0.25, slope, 0.0)
            yield _compare(f"centre + {shift:g}", display, model, rays, np.float64)


@relation(
    "grazing rays", covers=_COVERS, limit=_BAND, unit="rounding errors",
    source="roundings of a refraction, and the ray's own digits", subjects=_ANALYTIC,
)  # fmt: skip
def _grazing(model: str, effort: int) -> Iterator[Deviation]:
    """Steep rays, and rays near total reflection, pass or are lost as in the oracle."""
    for side, display in _sides(model, {}):
        for slope in (2.0, 3.0, 10.0, 100.0, 1e4, 1e6):
            rays = _rays(display, 20 * effort, slope, 7)
            yield _compare(f"{side}, slope {slope:g}", display, model, rays, np.float64)
    if model != "thick":
        return
    for name in ("sphere", "steep lens", "hexagonal", "lenticular"):
        for side, display in _sides(model, _KINDS[name]):
            for slope in (0.6, 1.0):
                yield _many(f"{name}, {side}, {slope:g}", display, _rays(display, 200, slope, 3))
    # Light along the array never reaches the panel. A ray through the flat face and the vertex of a
    # bulge behind it leaves as flat as it came; beside the vertex it is bent down or reflected.
    slopes = np.array([1e5, 1e7, 1e8, 1e10])
    for side, display in _sides(model, {}):
        places = np.zeros(4)
        if side.endswith("panel"):
            index, thickness = display.refractive_index, lens_array(display).thickness
            sine = slopes / np.hypot(slopes, 1) / index
            places = slopes * thickness / index - thickness * sine / np.sqrt(1 - sine**2)
        x, _, weight = trace_to_panel(display, model, places, 0.0, slopes, 0.0)
        yield is_true(f"{side}: light", np.isfinite(weight) & (weight >= 0) & (weight <= 1))
        if side.endswith("panel"):
            far = 2e6 * display.gap_mm
            yield is_true(f"{side}: along the array", (weight > 0) & (np.abs(x) < far))
    radius = 3.0 * 0.4917
    display = _display(
        curved_side="panel", pitch_mm=1.405 * radius, lens_thickness_mm=1.5, pixel_pitch_mm=0.08
    )
    rim = radius / 1.4917  # parallel light beyond R / n is totally reflected
    for ulps in (-1000, -10, 10, 1000):
        height = rim * (1 + ulps * EPS32)
        rays = _float32([height, -height, 0, 0], [0, 0, height, -height], 0, 0)
        yield _compare(f"R / n {ulps:+d} ulp", display, model, rays, np.float64)
        weight = trace_to_panel(display, model, rays.x, rays.y, 0, 0)[2]
        lit = rays.x.astype(float) ** 2 + rays.y.astype(float) ** 2 < rim**2
        yield is_true(f"lit within R / n {ulps:+d} ulp", (weight > 0) == lit, 4)
    heights = np.random.default_rng(1).uniform(0.9, 1.04, 20 * effort) * rim
    rays = _float32(heights, 0, 0, 0)
    yield _compare("about R / n", display, model, rays, np.float64)


def _many(case: str, display: Display, rays: LensRays) -> Deviation:
    """Deviation of many rays in millionths of a millimetre, far from borders and reflection."""
    truth = land(display, "thick", rays)
    x, y, weight = trace_to_panel(display, "thick", rays.x, rays.y, rays.sx, rays.sy)
    certain = (truth.edge > 1e-6) & ~(truth.reflection < 1e-6)
    with np.errstate(invalid="ignore"):
        far = np.hypot(x - truth.x, y - truth.y) / (1 + np.hypot(truth.x, truth.y) ** 2) * 1e6
        far = np.maximum(far, np.abs(weight - truth.weight) * 1e6)
    far = np.where((weight > 0) & (truth.weight > 0), np.nan_to_num(far, nan=np.inf), 0)
    far = np.where((weight > 0) != (truth.weight > 0), np.inf, far)[certain]
    return Deviation(case, float(far.max(initial=0)), len(far))


def _grows(
    model: str, positions: Any, make: Callable[[float], Display], slope: Callable[[float], float],
    count: int = 20,
) -> Iterator[Deviation]:  # fmt: skip
    for position in positions:
        for _, display in _sides(model, {}):
            other = make(position).replace(curved_side=display.curved_side)
            try:
                check_lens_model(model, other)
            except DisplayError:
                continue
            rays = _rays(other, count, slope(position))
            yield _compare(
                f"{position:g}", other, model, rays, np.float32, in_pixels=True, position=position
            )


_PIXELS = {"limit": LANDING_PIXELS, "unit": "panel pixels in float32", "covers": _COVERS,
           "source": "inim.generators.accuracy_limits; beyond it, validations warn",
           "subjects": _ANALYTIC}  # fmt: skip


@relation("growth of error with slope", axis="sideways travel per mm", **_PIXELS)
def _slopes(model: str, effort: int) -> Iterator[Deviation]:
    """Panel points in float32 are exact enough up to the slope from which a warning is given."""
    slopes = (1e-6, 1e-4, 1e-3, 0.01, 0.1, 0.3, 0.6, 1.0, 2.0, 3.0, 10.0, 100.0, 1e3, 1e4, 1e6)
    yield from _grows(
        model, slopes[:: 1 if effort > 1 else 2], lambda _: _display(), lambda s: s, 20 * effort
    )


@relation("growth of error with the array", axis="panel pixels across", **_PIXELS)
def _widths(model: str, effort: int) -> Iterator[Deviation]:
    """Panel points in float32 are exact enough up to the width from which a warning is given."""
    for lenses in (9, 64, 256, 1000, 4000, 10_000, 40_000, 100_000)[:: 1 if effort > 1 else 3]:
        display = _display(lens_columns=lenses)
        rng = np.random.default_rng(3)
        turn = rng.uniform(0, 2 * math.pi, 20 * effort)
        x, y = (rng.random(len(turn)) - 0.5) * (lenses - 4), rng.random(len(turn)) - 0.5
        rays = _float32(x, y, 0.15 * np.cos(turn), 0.15 * np.sin(turn))
        yield _compare(
            f"{lenses} lenses", display, model, rays, np.float32, in_pixels=True,
            position=float(display.eia_shape[1]),
        )  # fmt: skip


@relation("growth of error with the index", axis="n - 1", **_PIXELS)
def _indices(model: str, effort: int) -> Iterator[Deviation]:
    """Panel points in float32 are exact enough down to the index with a warning."""
    indices = (1e-12, 1e-9, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 0.01, 0.1, 0.3, 0.5, 1.0)
    yield from _grows(
        model, indices[:: 1 if effort > 1 else 2],
        lambda n: _display(refractive_index=1 + n), lambda _: 0.15,
    )  # fmt: skip


@relation("growth of error with scale", axis="factor of all lengths", **_PIXELS)
def _factors(model: str, effort: int) -> Iterator[Deviation]:
    """Accuracy of panel points in float32 does not depend on the unit of length."""
    yield from _grows(
        model, [10.0**k for k in range(-6, 7, 1 if effort > 1 else 4)],
        lambda k: scaled(_display(), k), lambda _: 0.15,
    )  # fmt: skip


# -- lens models against each other -------------------------------------------------------------


@relation(
    "thin lenses are pinholes in their focal plane", covers=_COVERS, limit=64, unit="ulp",
    source="a few roundings of float64",
)  # fmt: skip
def _focal_plane(_: str, effort: int) -> Iterator[Deviation]:
    """Parallel rays meet at g = f in the point of the ray through the lens's centre."""
    for name, changes in _KINDS.items():
        if "gap_mm" in changes or "layers" in changes:
            continue
        focused = {"gap_mm": 3.0, "focal_length_mm": 3.0, "depth_min_mm": 4.0, "depth_max_mm": 9.0}
        display = _display(**{**changes, **focused})
        if display.between_lenses == "clear" or display.tilt_x_deg:
            continue
        r = _rays(display, 50 * effort, 0.3, 5)
        thin, pinhole = (trace_to_panel(display, m, r.x, r.y, r.sx, r.sy) for m in _ANALYTIC[1::-1])
        for a, b in zip(thin, pinhole, strict=True):
            yield difference(name, a, b, 10 * EPS)


@relation(
    "rays through lens centres", covers=_COVERS, limit=1e-9, unit="mm",
    source="a few roundings of float64; symmetry of revolution", subjects=LENS_MODELS,
    explain=lambda name: "" if lens_model(name).mesh is None else None,
)  # fmt: skip
def _centres(model: str, effort: int) -> Iterator[Deviation]:
    """A lens bends no ray on its own axis, and its light is the white's exposure."""
    for name, changes in _KINDS.items():
        for side, display in _sides(model, changes):
            if display.layout.of_cylinders or display.tilt_x_deg:
                continue
            straight = display.replace(rotation_deg=0.0, shift_x_mm=0.0, shift_y_mm=0.0)
            rows, columns = display.layout.grid
            n, m = (columns - 1) % 2 / 2, (rows - 1) % 2 / 2
            x, y = n * display.pitch_mm, m * display.row_pitch_mm
            if display.lattice == "hexagonal":
                middle = rows // 2 if rows % 2 else rows // 2 - 1
                x += (-0.25 if middle % 2 == 0 else 0.25) * (rows > 1) * display.pitch_mm
            panel = trace_to_panel(straight, model, x, y, 0.0, 0.0)
            yield excess(f"{name}, {side}", np.abs(np.subtract(panel[:2], (x, y))), 0.0)
            exposure = float(white_exposure(straight, model))
            yield excess(f"{name}, {side}: white", abs(float(panel[2]) * exposure - 1) / 100, 0.0)


@relation(
    "closed forms of one lens", covers="display.lens", limit=1e-12, unit="mm",
    source="a few roundings of float64",
)  # fmt: skip
def _forms(_: str, effort: int) -> Iterator[Deviation]:
    """Collimated light has the landing points and Fresnel losses of plane trigonometry."""
    f, n, t, g = 3.0, 1.5, 0.8, 3.4
    radius = f * (n - 1)
    heights = np.array([1e-6, 0.01, 0.1, 0.3, 0.45, 0.49])
    sag = radius - np.sqrt(radius**2 - heights**2)
    changes = {"refractive_index": n, "lens_thickness_mm": t, "gap_mm": g, "pitch_mm": 1.0}

    def transmitted(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        with np.errstate(invalid="ignore"):
            s, p = np.sin(a - b) / np.sin(a + b), np.tan(a - b) / np.tan(a + b)
        share: np.ndarray = 1 - (s * s + p * p) / 2
        return share

    display = _display(**changes, curved_side="panel")
    x, y, weight = trace_to_panel(display, "thick", heights, 0.0, 0.0, 0.0)
    inside, outside = np.arcsin(heights / radius), np.arcsin(n * heights / radius)
    yield excess("flat first", np.abs(x - heights + np.tan(outside - inside) * (g + sag)), 0.0)
    flat = 4 * n / (n + 1) ** 2
    yield excess("flat first: light", np.abs(weight - flat * transmitted(inside, outside)), 0.0)
    display = _display(**changes)
    x, y, weight = trace_to_panel(display, "thick", 0.0, heights, 0.0, 0.0)
    before, after = np.arcsin(heights / radius), np.arcsin(heights / radius / n)
    first = heights - np.tan(before - after) * (t - sag)
    leaving = np.arcsin(n * np.sin(before - after))
    yield excess("bulge first", np.abs(y - first + np.tan(leaving) * (g - t / n)), 0.0)
    light = transmitted(before, after) * transmitted(before - after, leaving)
    yield excess("bulge first: light", np.abs(weight - light), 0.0)
    # Descartes: a hyperboloid of k = -n^2 has one focus, at f behind its vertex.
    display = _display(curved_side="panel", refractive_index=n, conic=-(n**2), gap_mm=f,
                       depth_min_mm=4.0, depth_max_mm=9.0)  # fmt: skip
    x, _, _ = trace_to_panel(display, "thick", heights, 0.0, 0.0, 0.0)
    yield excess("hyperboloid", np.abs(x), 0.0)
    # The bare sheet shifts a ray, and has two losses.
    display = _display(**changes, fill_factor=0.1, between_lenses="clear")
    slopes = np.array([0.0, 0.3, 1.0, 4.0])
    x, _, weight = trace_to_panel(display, "thick", 0.3, 0.2, slopes, 0.0)
    glass = np.arcsin(np.sin(np.arctan(slopes)) / n)
    expected = 0.3 + t * np.tan(glass) + (g - t / n) * slopes
    yield excess("bare sheet", np.abs(x - expected), 0.0)
    share = transmitted(np.arctan(slopes[1:]), glass[1:]) ** 2
    yield excess("bare sheet: light", np.abs(weight[1:] - share), 0.0)


@relation(
    "thick lenses become thin ones", covers="display.lens", limit=0.2, unit="order",
    source="third-order aberrations; docs/theory/lens-models.md",
)  # fmt: skip
def _weak(_: str, effort: int) -> Iterator[Deviation]:
    """The distance of thick and thin lenses falls with the third power of aperture and slope."""
    for name in ("sphere", "weak lens", "high index", "paraboloid", "hexagonal", "thin sheet"):
        for side, display in _sides("thick", _KINDS[name]):
            distances = []
            for share in (0.2, 0.1, 0.05):
                at = np.array([0.3, 0.1, -0.2]) * share, np.array([0.1, -0.3, 0.2]) * share
                slope = np.array([0.1, -0.2, 0.15]) * share
                centre_x = -0.25 if display.lattice == "hexagonal" else 0.0
                ends = [
                    trace_to_panel(display, m, at[0] + centre_x, at[1], slope, -slope)[:2]
                    for m in ("thick", "thin")
                ]
                distances.append(float(np.abs(np.subtract(*ends)).max()))
            orders = -np.diff(np.log2(distances))
            yield excess(f"{name}, {side}", np.abs(orders - 3), 0.0)


@relation(
    "the mesh of a sheet", covers="display.lens.full", limit=1e-9, unit="mm",
    source="roundings of float64; a closed body",
)  # fmt: skip
def _mesh(_: str, effort: int) -> Iterator[Deviation]:
    """The refracting mesh is closed and faces outwards, with corners on the exact surface."""
    from inim.display.lens.full import sheet_mesh

    for name in ("sphere", "paraboloid", "shifted by half a pitch", "misaligned", "rows apart",
                 "lenticular", "even numbers", "fourth order"):  # fmt: skip
        changes = {"lens_columns": 3, "lens_rows": 2, **_KINDS[name], "tilt_x_deg": 0.0}
        for side, display in _sides("thick", changes):
            case, mesh = f"{name}, {side}", sheet_mesh(display, 8)
            corners = mesh.vertices[mesh.faces]
            volume = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
            area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            # The vectors of a closed body's faces add up to nothing.
            yield excess(f"{case}: closed", np.abs(area.sum(axis=0)), 0.0)
            yield is_true(f"{case}: outwards", volume.sum() > 0)
            facing = np.einsum("ij,ikj->ik", area, mesh.normals[mesh.faces]) > 0
            yield is_true(f"{case}: normals", facing[np.linalg.norm(area, axis=1) > 1e-12])
            size = np.linalg.norm(mesh.normals, axis=1)
            yield excess(f"{case}: unit normals", np.abs(size - 1), 0.0)
            sign = 1.0 if display.curved_side == "viewer" else -1.0
            design = display.refractive_index
            t = display.pitch_mm
            flat = -t if sign > 0 else t / design
            vertex = flat + sign * t
            yield excess(f"{case}: places", abs(mesh.flat_mm - flat), 0.0)
            rear = t / design - t
            yield excess(f"{case}: rear plane", abs(mesh.rear_principal_mm - rear), 0.0)
            on_face = np.unique(mesh.faces[mesh.is_glass])
            curved = np.abs(mesh.vertices[on_face, 2] - flat) > 1e-9
            yield from _on_surface(case, display, mesh, on_face[curved], vertex, sign)


def _on_surface(
    case: str, display: Display, mesh: Any, corners: np.ndarray, vertex: float, sign: float
) -> Iterator[Deviation]:
    """Corners of facets against the sag of one of the adjacent lenses."""
    x, y, z = mesh.vertices[corners].T
    turn = math.radians(display.rotation_deg)
    c, s = math.cos(turn), math.sin(turn)
    u, v = x - display.shift_x_mm, y - display.shift_y_mm
    u, v = c * u + s * v, c * v - s * u
    rows, columns = display.layout.grid
    curvature = 1 / (display.focal_length_mm * (display.refractive_index - 1))
    far = np.full(len(x), np.inf)
    # On borders, patches of two lenses meet.
    for nudge_x in (-1e-9, 1e-9):
        for nudge_y in (-1e-9, 1e-9):
            odd_x, odd_y = (columns - 1) % 2 / 2, (rows - 1) % 2 / 2
            if display.layout.of_cylinders:
                odd_x = 0.0
            p, q = display.pitch_mm, display.row_pitch_mm
            du = u - (np.rint((u + nudge_x) / p - odd_x) + odd_x) * p
            dv = v - (np.rint((v + nudge_y) / q - odd_y) + odd_y) * q
            r2 = du**2 + (0 if display.layout.of_cylinders else dv**2)
            root = np.sqrt(1 - (1 + display.conic) * curvature**2 * r2)
            depth = curvature * r2 / (1 + root)
            depth = depth + display.asphere_a4 * r2**2 + display.asphere_a6 * r2**3
            far = np.minimum(far, np.abs(z - (vertex - sign * depth)))
    yield excess(f"{case}: surface", far, 0.0)


# -- symmetries ---------------------------------------------------------------------------------


def _certain(display: Display, count: int, seed: int = 9) -> LensRays:
    """Random rays whose distance to borders between lenses exceeds any rounding error."""
    rays = _rays(display, count, 0.2, seed)
    inside = np.ones(count, bool)
    for coordinate in (rays.x, rays.y):
        cell = coordinate.astype(float) / display.pitch_mm + 0.5
        inside &= np.abs(cell - np.rint(cell)) > 0.02
    return LensRays(*(getattr(rays, n)[inside].astype(float) for n in ("x", "y", "sx", "sy")))


@lru_cache
def _symmetric() -> tuple[Display, ...]:
    return (
        _display(), _display(curved_side="panel", gap_mm=2.7),
        _display(conic=-0.7, asphere_a4=0.003), _display(aperture="round", fill_factor=0.95),
        _display(layers="0.5 1.52"),
    )  # fmt: skip


@relation(
    "symmetries of lenses", covers=_COVERS, limit=64, unit="ulp of the array's half width",
    source="two orders of the same sums", subjects=LENS_MODELS,
    explain=lambda name: "" if lens_model(name).mesh is None else None,
)  # fmt: skip
def _symmetries(model: str, effort: int) -> Iterator[Deviation]:
    """Mirrored, transposed, moved, turned, scaled and single rays land where they must."""
    for number, display in enumerate(_symmetric()):
        r, p = _certain(display, 100 * effort), display.pitch_mm
        unit = EPS * display.width_mm / 2
        x, y, w = trace_to_panel(display, model, r.x, r.y, r.sx, r.sy)
        turned, shift = display.replace(rotation_deg=90.0), 3.5 * display.pixel_pitch_mm
        moved = display.replace(shift_x_mm=shift)
        pairs = {
            "mirror": ((display, -r.x, r.y, -r.sx, r.sy), (-x, y, w)),
            "transpose": ((display, r.y, r.x, r.sy, r.sx), (y, x, w)),
            "by a lens": ((display, r.x + p, r.y, r.sx, r.sy), (x + p, y, w)),
            "array and rays": ((moved, r.x + shift, r.y, r.sx, r.sy), (x + shift, y, w)),
            "array turned": ((turned, r.x, r.y, r.sx, r.sy), (x, y, w)),
        }
        for name, ((other, *rays), expected) in pairs.items():
            traced = trace_to_panel(other, model, *rays)
            lit = (expected[2] > 0) & (traced[2] > 0)
            yield is_true(f"{name} {number}: light", (expected[2] > 0) == (traced[2] > 0), len(x))
            for a, b in zip(traced, expected, strict=True):
                yield difference(f"{name} {number}", a[lit], b[lit], unit)
        every = range(0, len(r.x), 7)
        alone = [trace_to_panel(display, model, r.x[i], r.y[i], r.sx[i], r.sy[i]) for i in every]
        for k, values in enumerate((x, y, w)):
            single = np.array([float(point[k]) for point in alone])
            yield difference(f"alone {number}", single, values[::7], 1e-300)
        if display.asphere_a4 or display.layers:
            continue  # coefficients and layers are no lengths of `scaled`
        for factor in (2.0**10, 2.0**-7, 1000.0, 0.3):
            u, v, weight = trace_to_panel(
                scaled(display, factor), model, r.x * factor, r.y * factor, r.sx, r.sy
            )
            step = 1e-300 if math.frexp(factor)[0] == 0.5 else unit
            for a, b in ((u / factor, x), (v / factor, y), (weight, w)):
                yield difference(f"x {factor:g} {number}", a, b, step)


@relation(
    "rejected lenses", covers="display.lens.thick display.lens.model", limit=0,
    unit="wrong answers", source="the sag and the sheet's thickness in closed form",
)  # fmt: skip
def _rejected(_: str, effort: int) -> Iterator[Deviation]:
    """Lenses that cannot be made are rejected, up to a ten-millionth of the limit."""
    corner = math.sqrt(0.5)
    for name, changes, limit in (
        ("radius", lambda v: {"focal_length_mm": v / 0.4917, "lens_thickness_mm": 1.0,
                              "gap_mm": 3.3}, corner),
        ("thickness", lambda v: {"lens_thickness_mm": v},
         3 * 0.4917 - math.sqrt((3 * 0.4917) ** 2 - 0.5)),
        ("gap", lambda v: {"gap_mm": v, "depth_min_mm": 1.0, "depth_max_mm": 2.0}, 1 / 1.4917),
        ("layers", lambda v: {"layers": ((0.5 * 1.52, 1.52),), "gap_mm": v, "depth_min_mm": 1.0,
                              "depth_max_mm": 2.0}, 1 / 1.4917 + 0.5 - 1e-3),
        ("round radius", lambda v: {"focal_length_mm": v / 0.4917, "aperture": "round"}, 0.5),
        ("conic", lambda v: {"conic": 3 - v, "focal_length_mm": 1 / 0.4917,
                             "lens_thickness_mm": 3.0,
                             "gap_mm": 3.3}, 2.0),
    ):  # fmt: skip
        for inside in (1 - 1e-6, 1 + 1e-6):
            display = _display(**changes(limit * inside))
            expected = inside < 1
            yield difference(f"{name} {inside:g}", _is_rejected(display), expected)


def _is_rejected(display: Display) -> bool:
    try:
        check_lens_model("thick", display)
    except DisplayError:
        return True
    return False
