"""Rays of the renderer: pickup, capture and eye, and the points of pixels at which they start."""

from collections.abc import Iterator
from fractions import Fraction
from typing import Any

import numpy as np

from inim.apps.stress.oracles.rays import panel_places, panel_rays
from inim.apps.stress.pictures import displays, small_display
from inim.apps.stress.relation import EPS, EPS32, Deviation, difference, excess, is_true, relation
from inim.display import Display
from inim.display.pixels import SUBPIXELS, PixelOffset
from inim.display.viewpoint import Viewpoint
from inim.render.rays import (
    NonSeparableRays,
    SeparableRays,
    capture_rays,
    eye_rays,
    frustum_rays,
    pickup_rays,
)

_START = 9.0
_WORLD = np.array([[0.3, 0.1, 0.0, 4.0], [-0.1, 0.3, 0.05, -2.0], [0.02, 0.0, 0.7, 1.0],
                   [0.0, 0.0, 0.0, 1.0]])  # fmt: skip


def traced(rays: SeparableRays | NonSeparableRays, spp: int, seed: int = 0) -> list[np.ndarray]:
    """Rays that the renderer makes of a family, for some samples of each pixel.

    Column, row, position in the pixel (right, down), point of the pupil (0 without one), start (x,
    y), slopes (x, y), world origin and direction; (pixels, samples) each, or (..., 3).
    """
    from inim.render.trace import FilmCamera, trace_samples

    camera = FilmCamera(rays, _WORLD)

    def sampled(index: Any, sampler: Any) -> list[Any]:
        pixel, within, pupil = camera.sample(index, sampler)
        start, run = camera.lines(pixel, within, pupil)
        ray, _ = camera.world_rays(start, run)
        disc = [within.x * 0, within.y * 0] if pupil is None else [pupil.x, pupil.y]
        return [pixel.x, pixel.y, within.x, within.y, *disc, *start, *run, *ray.o, *ray.d]

    pixels = np.arange(camera.shape[0] * camera.shape[1])
    return [np.asarray(v).reshape(-1, spp) for v in trace_samples(sampled, pixels, 0, spp, seed)]


def _against(
    case: str, rays: SeparableRays | NonSeparableRays, expected: Any, spp: int, unit: float
) -> Iterator[Deviation]:
    """Compare starts and slopes with those of a function of pixel, position and pupil."""
    column, row, right, down, pupil_x, pupil_y, *actual = traced(rays, spp)
    x, y, slope_x, slope_y = expected(
        column.astype(int), row.astype(int), right.astype(float) - 0.5, down.astype(float) - 0.5,
        pupil_x.astype(float), pupil_y.astype(float),
    )  # fmt: skip
    z = rays.start_mm
    for name, values, true in zip(
        ("x", "y", "slope x", "slope y"), actual[:4], (x, y, slope_x, slope_y), strict=True
    ):
        yield difference(f"{case}: {name}", values, true, unit * EPS32)
    place = np.stack([x, y, np.full_like(x, z)], axis=-1) @ _WORLD[:3, :3].T + _WORLD[:3, 3]
    towards = np.stack([slope_x, slope_y, np.full_like(x, -1.0)], axis=-1) @ _WORLD[:3, :3].T
    towards /= np.linalg.norm(towards, axis=-1, keepdims=True)
    yield difference(f"{case}: origin", np.stack(actual[4:7], -1), place, 4 * unit * EPS32)
    yield difference(f"{case}: direction", np.stack(actual[7:], -1), towards, 4 * unit * EPS32)


@relation(
    "pickup rays", covers="render.rays render.trace display.pixels display.layouts display.cells",
    limit=32, unit="ulp of float32 at the panel's edge", source="roundings of float32 tables",
)  # fmt: skip
def _pickup(_: str, effort: int) -> Iterator[Deviation]:
    """Rays join points of the emitting areas with the centres of their pixels' lenses."""
    for name, display in displays():
        for area in dict.fromkeys(SUBPIXELS[display.subpixels]):
            rays = pickup_rays(display, _START, area)

            def expected(
                column: np.ndarray, row: np.ndarray, right: np.ndarray, down: np.ndarray, *_: Any,
                display: Display = display, area: Any = area,
            ) -> tuple[np.ndarray, ...]:  # fmt: skip
                shape, pixels = column.shape, np.stack([row.ravel(), column.ravel()], axis=-1)
                start = PixelOffset(Fraction(0), area.right, area.channel)
                chief = panel_rays(display, pixels, start)
                x, y = panel_places(display, pixels, start)
                fill, step = display.pixel_fill, display.pixel_pitch_mm
                more_x = right.ravel() * float(area.width) * fill * step
                more_y = -down.ravel() * float(area.height) * fill * step
                slopes = [np.tan(np.radians(t)) for t in (display.tilt_x_deg, display.tilt_y_deg)]
                gap = chief.gap_mm + slopes[0] * more_x + slopes[1] * more_y
                x0, y0 = chief.x0, chief.y0
                if display.layout.of_cylinders:  # a point of its own on the axis of the cylinder
                    along_x, along_y = display.layout.crossing_steps
                    x0, y0 = x0 + along_x * more_y, y0 + along_y * more_y
                slope_x, slope_y = (x0 - x - more_x) / gap, (y0 - y - more_y) / gap
                values = (x0 + slope_x * _START, y0 + slope_y * _START, -slope_x, -slope_y)
                return tuple(v.astype(float).reshape(shape) for v in values)

            certain = _certain(display)
            half = float(np.hypot(*display.eia_shape)) * display.pixel_pitch_mm
            unit = half * (1 + _START / display.gap_mm)
            for deviation in _against(f"{name}, {area.right}", rays, expected, effort, unit):
                if certain:
                    yield deviation
    sheet = small_display(
        lattice="lenticular", lens_columns=5, lens_rows=1, panel_columns=26, panel_rows=17,
        rotation_deg=12.0, elemental_pitch_mm=1.02, depth_min_mm=-6.0, depth_max_mm=8.0,
    )  # fmt: skip
    pixels = np.argwhere(np.ones(sheet.eia_shape, bool))
    low, high = (panel_rays(sheet, pixels, PixelOffset(Fraction(d, 4), Fraction(0)))
                 for d in (1, -1))  # fmt: skip
    same = low.lens == high.lens
    step = sheet.pixel_pitch_mm / 2
    steps = [(b - a)[same] / step for a, b in ((low.x0, high.x0), (low.y0, high.y0))]
    for actual, of_panel in zip(sheet.layout.crossing_steps, steps, strict=True):
        # Cylinders are found from the point itself: the step is that of points of one cylinder.
        expected_step = np.median(of_panel.astype(float))
        yield difference("crossing steps", actual, expected_step, 1e3 * EPS)


def _certain(display: Display) -> bool:
    """True if no pixel is on a border between lenses, where rounding decides."""
    pixels = np.argwhere(np.ones(display.eia_shape, bool))
    margin = panel_rays(display, pixels).margin
    return bool(margin.min() > 1e-9)


@relation(
    "capture and eye rays", covers="render.rays render.trace display.display", limit=32,
    unit="ulp of float32 at the film's edge", source="roundings of float32 tables",
)  # fmt: skip
def _eyes(_: str, effort: int) -> Iterator[Deviation]:
    """Parallel rays pass their pixel of the array's plane; an eye's rays meet in its focus."""
    for name, display in displays():
        rows, columns = display.capture_shape(3)
        pixel = display.pitch_mm / 3
        for slopes in ((0.0, 0.0), (0.2, -0.1)):

            def parallel(
                column: np.ndarray, row: np.ndarray, right: np.ndarray, down: np.ndarray, *_: Any,
                slopes: tuple[float, float] = slopes, size: tuple[int, int, float] = (
                    rows, columns, pixel),
            ) -> tuple[np.ndarray, ...]:  # fmt: skip
                high, wide, side = size
                x = (column + 0.5 + right - wide / 2) * side + slopes[0] * _START
                y = (high / 2 - row - 0.5 - down) * side + slopes[1] * _START
                return x, y, np.full_like(x, -slopes[0]), np.full_like(x, -slopes[1])

            rays = capture_rays(display, 3, _START, slopes)
            yield from _against(f"{name}: capture {slopes}", rays, parallel, 1, columns * pixel)
    display = small_display(lens_columns=5, lens_rows=4)
    for eye in (
        Viewpoint("eye", 3.0, -2.0, 120.0),
        Viewpoint("eye", -8.0, 5.0, 90.0, pupil_mm=4.0, focus_mm=60.0),
        Viewpoint("eye", 0.0, 0.0, 200.0, pupil_mm=3.0),
    ):
        for per_lens in (2, (1.6, 3.4)):
            yield from _of_eye(display, eye, per_lens, effort)
    rays = frustum_rays((7, 9), (0.25, 0.5), display, Viewpoint("eye", 1.0, 2.0, 50.0), 0.0)
    yield difference("frustum", rays.x.place_mm, (np.arange(9) - 4) * 0.25, 4 * EPS)
    yield difference("frustum down", rays.y.place_mm, (3 - np.arange(7)) * 0.5, 4 * EPS)


def _of_eye(display: Display, eye: Viewpoint, per_lens: Any, effort: int) -> Iterator[Deviation]:
    down_per, across_per = np.broadcast_to(per_lens, 2)
    rows, columns = round(display.lens_rows * down_per), round(display.lens_columns * across_per)
    focus = eye.focus_mm or (eye.z_mm if not eye.pupil_mm else eye.z_mm - display.central_depth_mm)

    def through_film(
        column: np.ndarray, row: np.ndarray, right: np.ndarray, down: np.ndarray,
        pupil_x: np.ndarray, pupil_y: np.ndarray,
    ) -> tuple[np.ndarray, ...]:  # fmt: skip
        results: list[np.ndarray] = []
        for film, centre, pupil in (
            (
                (column + 0.5 + right - columns / 2) / across_per * display.pitch_mm,
                eye.x_mm,
                pupil_x,
            ),
            ((rows / 2 - row - 0.5 - down) / down_per * display.row_pitch_mm, eye.y_mm, pupil_y),
        ):
            slope = (film - centre) / eye.z_mm
            sharp = centre + slope * focus  # where all rays of a film point meet
            start = centre + pupil * eye.pupil_mm / 2
            run = (sharp - start) / focus
            results += [start + run * (eye.z_mm - _START), run]
        return results[0], results[2], results[1], results[3]

    rays = eye_rays(display, eye, per_lens, _START)
    case = f"{eye.position_mm}, pupil {eye.pupil_mm:g}, {per_lens}"
    yield difference(f"{case}: shape", rays.shape, (rows, columns))
    yield from _against(case, rays, through_film, 2 * effort, 10.0)


@relation(
    "reach of bundles", covers="render.rays render.culling", limit=1e-6, unit="mm outside",
    source="float32",
)  # fmt: skip
def _reach(_: str, effort: int) -> Iterator[Deviation]:
    """Every ray of a pixel stays within the declared interval, whose ends some rays reach."""
    display = small_display(lens_columns=5, lens_rows=4, pixel_fill=0.7)
    families = {
        "capture": capture_rays(display, 3, _START, (0.1, 0.2)),
        "pickup": pickup_rays(display, _START),
        "eye": eye_rays(display, Viewpoint("eye", 3.0, -2.0, 120.0), 3, _START),
        "pupil": eye_rays(display, Viewpoint("eye", 3.0, 1.0, 90.0, 5.0, 70.0), 3, _START),
    }
    spp = 64 * effort
    for name, rays in families.items():
        assert isinstance(rays, SeparableRays)
        column, row, *_, x, y, run_x, run_y = traced(rays, spp)[:10]
        depths = np.array([2.0, 31.0])
        for axis, (low, high), place, run in zip(
            (column, row), rays.reach(depths), (x, y), (run_x, run_y), strict=True
        ):
            own = axis[:, 0].astype(int)
            at = place[..., None].astype(float) + run[..., None].astype(float) * depths
            lowest, highest = at.min(axis=(1, 2)), at.max(axis=(1, 2))
            slack = 1e-4 * (1 + np.abs(at).max())
            yield excess(f"{name}: below", low[own] - lowest, slack)
            yield excess(f"{name}: above", highest - high[own], slack)
            if name in ("capture", "pickup", "eye"):
                wide = (high - low)[own] + 1e-9
                yield is_true(f"{name}: tight", ((highest - lowest) / wide).max() > 0.9)


@relation(
    "culled pixels", covers="render.culling render.rays", limit=0, unit="wrong answers",
    source="a ray that meets an occupied cell may show its content",
)  # fmt: skip
def _culled(_: str, effort: int) -> Iterator[Deviation]:
    """No pixel is skipped of which a ray passes an occupied cell, and most others are."""
    from inim.render.culling import BoundsGrid

    shape = slabs, rows, columns = 4, 11, 13
    skipped = []
    for seed, (name, display) in enumerate(displays()):
        rays = pickup_rays(display, _START)
        places = [v.astype(float) for v in traced(rays, 4 * effort)[6:10]]
        deepest, highest = display.depth_range_mm
        reach = [np.quantile(start, (0.1, 0.9)) for start in places[:2]]
        low = np.array([reach[0][0], reach[1][0], deepest])
        cell = (np.array([reach[0][1], reach[1][1], highest]) - low) / (columns, rows, slabs)
        occupied = np.random.default_rng(seed).random(shape) < 0.02
        counts = np.zeros((slabs, rows + 1, columns + 1), np.int64)
        counts[:, 1:, 1:] = occupied.cumsum(axis=1).cumsum(axis=2)
        visible = BoundsGrid(low, cell, counts, _START).visible_pixels(rays)
        meets = np.zeros(visible.size, bool)
        for slab in range(slabs):
            for height in (0.02, 0.5, 0.98):
                depth = _START - (low[2] + (slab + height) * cell[2])
                x, y = (a + b * depth for a, b in zip(places[:2], places[2:], strict=True))
                across, up = (x - low[0]) / cell[0], (y - low[1]) / cell[1]
                column, row = np.floor(across).astype(int), np.floor(up).astype(int)
                is_inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
                edge = np.minimum(np.abs(across - np.rint(across)), np.abs(up - np.rint(up)))
                is_met = occupied[slab, row.clip(0, rows - 1), column.clip(0, columns - 1)]
                meets |= (is_met & is_inside & (edge > 1e-3)).any(axis=1)
        lensed = display.lensed.ravel()
        missed = meets & ~visible.ravel() & lensed
        yield is_true(f"{name}: skipped", not missed.any(), int(lensed.sum()))
        yield is_true(f"{name}: met", meets.any())
        skipped.append(float((~visible).mean()))
    yield is_true("most pixels are skipped somewhere", max(skipped) > 0.5)


@relation(
    "random points", covers="render.counter_sampler render.trace", limit=0, unit="empty cells",
    source="the (0, 2)-sequence has one point in every elementary interval",
)  # fmt: skip
def _random(_: str, effort: int) -> Iterator[Deviation]:
    """2^k samples of a pixel have one point in each cell of every binary grid."""
    display = small_display(lens_columns=2, lens_rows=2, pixel_pitch_mm=0.5)
    rays = pickup_rays(display, _START)
    for bits in (2, 4, 6):
        spp = 2**bits
        _, _, right, down, *_ = traced(rays, spp, seed=3)
        for split in range(bits + 1):
            cells = np.floor(right * 2**split) * 2 ** (bits - split)
            cells += np.floor(down * 2 ** (bits - split))
            missing = [spp - len(np.unique(pixel)) for pixel in cells]
            yield difference(f"2^{bits}, {split} across", missing, np.zeros(len(missing)))
    first, again, other = (np.stack(traced(rays, 16, seed)[2:4]) for seed in (3, 3, 4))
    yield difference("equal seeds", again, first)
    yield is_true("other seeds", (first != other).mean() > 0.99)
    flat = first.reshape(2, -1)
    yield is_true("other pixels", len(np.unique(flat[0])) > 0.99 * flat.shape[1])
    correlation = np.corrcoef(flat[0], flat[1])[0, 1]
    yield excess("independent axes", abs(correlation), 0.45)
    fewer = np.stack(traced(rays, 4, 3)[2:4])
    yield difference("the first samples", first[..., :4], fewer)
    eye = eye_rays(display, Viewpoint("eye", 0.0, 0.0, 90.0, 6.0), 1, 0.0)
    *_, pupil_x, pupil_y = traced(eye, 1024)[:6]
    radius = np.hypot(pupil_x, pupil_y)
    yield is_true("in the pupil", radius <= 1 + 1e-6)
    inner = np.abs((radius**2 < 0.5).mean(axis=1) - 0.5)
    yield is_true("even over the pupil", inner < 0.05)
    yield is_true("centred", np.abs(pupil_x.mean(axis=1)) < 0.05)
