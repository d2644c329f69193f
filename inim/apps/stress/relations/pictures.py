"""Pictures: layers with sides, merged cameras, warped views, and images with noise."""

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from inim.apps.stress.oracles.generators import first_hits
from inim.apps.stress.oracles.rays import Rays
from inim.apps.stress.pictures import (
    displays,
    noise_pictures,
    scaled,
    small_display,
    solids_of,
)
from inim.apps.stress.relation import EPS32, Deviation, difference, excess, is_true, relation
from inim.display import Display
from inim.display.viewpoint import Viewpoint
from inim.generators import find_sources, merge_cameras, merge_colourings, warp_to_viewpoint
from inim.image.noisy_image import NoisyImage, pseudo_values, split_samples
from inim.image.rgbd import Camera, CameraRGBD, CameraRGBDs, camera_directions
from inim.image.sides import BESIDE, PIECES, Sides, with_sides


@relation(
    "sides of solids", covers="image.sides image.rgbd generators.raycast", limit=0, unit="pixels",
    source="cutting a solid moves no surface",
)  # fmt: skip
def _sides(_: str, effort: int) -> Iterator[Deviation]:
    """Pieces of sides fill their solids, are open where neighbours are not, and move no ray."""
    for seed, (display, rgbd) in enumerate(noise_pictures()):
        solid = solids_of(rgbd, display)
        low = np.float32(display.depth_range_mm[0] - 1)
        layers = solid.layers
        front = np.stack([np.where(v.covered, v.front_mm, -np.inf) for v in layers])
        back = np.stack([np.where(v.covered, np.maximum(v.back_mm, low), -np.inf) for v in layers])
        front, back = front.astype(np.float32), back.astype(np.float32)
        slopes, span = display.steepest_slopes, np.subtract(*display.depth_range_mm[::-1])
        pixel_mm = rgbd.pixel_mm / 4  # steep enough for sides in noise
        sides = Sides.of(front, back, display.depth_range_mm, slopes, pixel_mm)
        case = f"picture {seed}"
        yield is_true(f"{case}: has sides", len(sides.row) > 20, len(sides.row))
        height = sides.front_mm - sides.back_mm
        yield excess(f"{case}: lowest piece", (sides.back_mm < low).astype(float), 0.0)
        yield is_true(f"{case}: height", height > 0, len(height))
        is_last = np.append(sides.is_first[1:], True)
        tall = (
            height[~is_last]
            <= span / PIECES * (1 + 1e-5) + 4 * EPS32 * np.abs(front[front > -np.inf]).max()
        )
        joined = sides.back_mm[:-1][~sides.is_first[1:]] == sides.front_mm[1:][~sides.is_first[1:]]
        yield is_true(f"{case}: joined", joined, len(joined))
        ends = back[sides.solid, sides.row, sides.column]
        yield is_true(f"{case}: ends", sides.back_mm[is_last] == ends[is_last], len(ends))
        # The last piece ends at its solid's back, not a rounding beside it.
        rounding = 8 * EPS32 * np.abs(back[back > -np.inf]).max()
        reach = np.abs(sides.low_mm - sides.back_mm[:, None]) < rounding
        is_end = is_last[:, None] & reach & (sides.low_mm < sides.high_mm)
        exact = sides.low_mm == sides.back_mm[:, None]
        yield is_true(f"{case}: last pieces", exact[is_end], int(is_end.sum()))
        yield from _gaps(case, sides, front, back, pixel_mm / max(slopes))
        colours = np.stack([v.color for v in layers])
        light = np.random.default_rng(seed).random((len(sides.row), 3)).astype(np.float32)
        cut = with_sides(
            (front, back, colours), sides, light, np.ones(len(light), bool), rgbd.pixel_mm
        )
        whole = with_sides(
            (front, back, colours), Sides.of(front, front, (0, 1), slopes, 1e9),
            np.zeros((0, 3), np.float32), np.zeros(0, bool), rgbd.pixel_mm,
        )  # fmt: skip
        # A piece that no ray reaches looks like what is before it.
        dark = np.random.default_rng(1).random(len(light)) < 0.5
        partly = with_sides((front, back, colours), sides, light, ~dark, rgbd.pixel_mm)
        partly_lit, all_lit = (np.stack([v.color for v in p.layers]) for p in (partly, cut))
        changed = (partly_lit != all_lit).any(axis=-1)
        above = np.concatenate([partly_lit[:1], partly_lit[:-1]])
        yield is_true(f"{case}: unseen", (partly_lit == above)[changed], int(changed.sum()))
        yield difference(f"{case}: unseen pieces", changed.sum(), dark.sum())
        before, after = (find_sources(p, display, "layered:samples=1") for p in (whole, cut))
        cells = rgbd.depth_mm.size
        moved = np.where(before >= 0, before % cells, before) != np.where(
            after >= 0, after % cells, after
        )
        yield Deviation(f"{case}: rays", int(moved.sum()), moved.size, int(moved.sum()))
        yield is_true(f"{case}: pieces", tall.mean() > 0.5 if len(tall) else True)


def _gaps(
    case: str, sides: Sides, front: np.ndarray, back: np.ndarray, least: float
) -> Iterator[Deviation]:
    """Compare the tallest gap beside some pieces with that of a fine sampling in depth."""
    rows, columns = front.shape[1:]
    for n in range(0, len(sides.row), max(1, len(sides.row) // 40)):
        low, high = float(sides.back_mm[n]), float(sides.front_mm[n])
        levels = low + (high - low) * (np.arange(4000) + 0.5) / 4000
        for number, (down, right) in enumerate(BESIDE):
            r, c = int(sides.row[n]) + down, int(sides.column[n]) + right
            empty = np.ones(len(levels), bool)
            if 0 <= r < rows and 0 <= c < columns:
                solid = (levels <= front[:, r, c, None]) & (levels >= back[:, r, c, None])
                empty = ~solid.any(axis=0)
            edges = np.diff(np.concatenate([[0], empty.astype(int), [0]]))
            runs = np.flatnonzero(edges == -1) - np.flatnonzero(edges == 1)
            tallest = runs.max(initial=0) / 4000 * (high - low)
            own = float(sides.high_mm[n, number] - sides.low_mm[n, number])
            far = abs(tallest - own) / (high - low)
            yield difference(f"{case}: gap", float(far > 2e-3), 0.0)
    del least


@relation(
    "pinhole cameras", covers="image.rgbd", limit=1e-9, unit="mm", source="the pinhole equation",
)  # fmt: skip
def _intrinsics(_: str, effort: int) -> Iterator[Deviation]:
    """A picture's point is (u - cx) z / fx to the right and (v - cy) z / fy down, then moved."""
    random = np.random.default_rng(8)
    for number in range(5):
        fx, fy, cx, cy = random.uniform((400, 300, 200, 100), (800, 700, 400, 300))
        move = random.normal(size=(3, 4))
        u, v, z = random.uniform((0, 0, 20), (640, 480, 900), (50, 3)).T
        camera = Camera.pinhole((fx, fy, cx, cy), move)
        own = camera.display_from_picture @ np.stack([u * z, v * z, z, np.ones(50)])
        point = np.stack([(u - cx) * z / fx, (v - cy) * z / fy, z, np.ones(50)])
        yield difference(f"camera {number}", own, move @ point)


# -- several cameras ----------------------------------------------------------------------------


def _at(display: Display, slopes: tuple[float, float]) -> Callable[[Any], tuple[Any, Any]]:
    """X and y of an orthographic camera's rays at a depth."""
    rows, columns = display.capture_shape(5)
    pixel = display.capture_pixel_mm(5)
    u = ((np.arange(columns) - (columns - 1) / 2) * pixel)[None]
    v = (((rows - 1) / 2 - np.arange(rows)) * pixel)[:, None]
    return lambda z: np.broadcast_arrays(u + slopes[0] * z, v + slopes[1] * z)  # type: ignore[return-value]


def _plane(display: Display, lean: tuple[float, float]) -> CameraRGBDs:
    """A leaning plane z = m + a x + b y with colours linear in x and y, from five cameras."""
    middle, steepest = sum(display.depth_range_mm) / 2, max(display.steepest_slopes)
    shots = []
    for x, y in camera_directions("5"):
        slopes = x * steepest, y * steepest
        u, v = _at(display, slopes)(0.0)
        z = (middle + lean[0] * u + lean[1] * v) / (1 - lean[0] * slopes[0] - lean[1] * slopes[1])
        px, py = u + slopes[0] * z, v + slopes[1] * z
        color = _ramp(display, px, py)
        camera = Camera.orthographic(slopes, u.shape, display.capture_pixel_mm(5))
        shots.append(CameraRGBD(color, z.astype(np.float32), camera))
    return CameraRGBDs(tuple(shots))


def _ramp(display: Display, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    size = 4 * display.width_mm
    return np.stack([0.5 + x / size, 0.5 + y / size, 0.3 + 0 * x], axis=-1).astype(np.float32)


@relation(
    "merged cameras", covers="generators.raycast.merge generators.cameras image.rgbd image.sides",
    limit=1, unit="thousandths of a pixel, or of white",
    source="bilinear interpolation reproduces planes; depths by halving",
)  # fmt: skip
def _merged(_: str, effort: int) -> Iterator[Deviation]:
    """A plane from five cameras is that plane with its colours, and a single camera is itself."""
    kinds = {"real": {"depth_min_mm": 8.0, "depth_max_mm": 14.0},
             "virtual": {"focal_length_mm": 3.6, "depth_min_mm": -14.0,
                         "depth_max_mm": -8.0}}  # fmt: skip
    for name, changes in kinds.items():
        display = small_display(lens_columns=6, lens_rows=5, **changes)
        pixel = display.capture_pixel_mm(5)
        for lean in ((0.3, -0.2), (0.0, 0.0), (-0.1, 0.5))[: 3 if effort > 1 else 1]:
            merged = merge_cameras(_plane(display, lean), display)
            x, y = _at(display, (0.0, 0.0))(0.0)
            low, high = display.depth_range_mm
            z = sum(display.depth_range_mm) / 2 + lean[0] * x + lean[1] * y
            inside = (np.abs(x) < display.width_mm / 2) & (np.abs(y) < display.height_mm / 2)
            inside &= (z > low) & (z < high)
            case = f"{name}, {lean}"
            yield is_true(f"{case}: covered", merged.covered[inside], int(inside.sum()))
            depth = merged.depth_mm[inside].astype(float)
            yield difference(
                f"{case}: depth", depth, z[inside], 1e-2 * pixel * (1 + 8 * max(map(abs, lean)))
            )
            colour = merged.color[inside].astype(float)
            yield difference(f"{case}: colour", colour, _ramp(display, x, y)[inside], 2e-3)
        single = CameraRGBDs(_plane(display, (0.1, 0.1)).pictures[:1])
        alone = merge_cameras(single, display)
        own = single.pictures[0]
        inside = (own.depth > low) & (own.depth < high)
        yield is_true(f"{name}: alone", alone.covered[inside], int(inside.sum()))
        yield difference(
            f"{name}: own depth", alone.depth_mm[inside], own.depth[inside], 1e-2 * pixel
        )
        darker = CameraRGBDs(
            tuple(
                CameraRGBD(p.color / 2, p.depth, p.camera)
                for p in _plane(display, (0.0, 0.0)).pictures
            )
        )
        bright, dark = merge_colourings([_plane(display, (0.0, 0.0)), darker], display, 5)
        yield difference(f"{name}: two colourings", dark.color, bright.color / 2, 1e-5)
        yield difference(f"{name}: their depth", dark.depth_mm, bright.depth_mm)
    yield from _pinholes()
    yield difference("directions", camera_directions("3x3")[0], (-1.0, 1.0))
    yield difference("down a row", camera_directions("2x3")[3], (-1.0, -1.0))


def _pinholes() -> Iterator[Deviation]:
    """A pinhole camera in front of the display sees a plane where it is."""
    display = small_display(lens_columns=6, lens_rows=5, depth_min_mm=8.0, depth_max_mm=14.0)
    middle, distance = sum(display.depth_range_mm) / 2, 80.0
    rows, columns, f = 120, 160, 300.0
    # Its axis runs along -z: x to the right, y down.
    pose = np.array([[1.0, 0, 0, 2.0], [0, -1.0, 0, -1.0], [0, 0, -1.0, distance]])
    camera = Camera.pinhole((f, f, (columns - 1) / 2, (rows - 1) / 2), pose)
    column, row = np.meshgrid(np.arange(columns), np.arange(rows))
    depth = np.full((rows, columns), distance - middle)
    x = 2.0 + (column - (columns - 1) / 2) / f * depth
    y = -1.0 - (row - (rows - 1) / 2) / f * depth
    picture = CameraRGBD(_ramp(display, x, y), depth.astype(np.float32), camera)
    merged = merge_cameras(CameraRGBDs((picture,)), display)
    px, py = _at(display, (0.0, 0.0))(0.0)
    inside = (np.abs(px) < 2.5) & (np.abs(py) < 2.0)
    yield is_true("pinhole: covered", merged.covered[inside], int(inside.sum()))
    yield difference("pinhole: depth", merged.depth_mm[inside], middle + 0 * px[inside], 2e-3)
    yield difference("pinhole: colour", merged.color[inside], _ramp(display, px, py)[inside], 2e-3)


# -- warped views -------------------------------------------------------------------------------


@relation(
    "warped views", covers="generators.raycast.view generators.raycast.ray_by_ray", limit=0.02,
    unit="share of rays", source="ties of float64 rays",
)  # fmt: skip
def _warped(_: str, effort: int) -> Iterator[Deviation]:
    """A picture seen by an eye shows the first hits of its rays, four by four per pixel."""
    for display, rgbd in noise_pictures():
        if display.pixel_pitch_mm == 0.125 and effort == 1:
            continue
        for eye in (Viewpoint("eye", 3.1, -2.3, 81.7), Viewpoint("eye", -1.7, 6.2, 143.3)):
            view, share = warp_to_viewpoint(rgbd, display, eye, 1)
            rows, columns = view.shape[0] * 4, view.shape[1] * 4
            x = (np.arange(columns) + 0.5) / 4 * display.pitch_mm - display.width_mm / 2
            y = display.height_mm / 2 - (np.arange(rows) + 0.5) / 4 * display.row_pitch_mm
            y, x = (v.ravel() for v in np.meshgrid(y, x, indexing="ij"))
            zeros = np.zeros(x.size)
            rays = Rays(
                np.zeros((x.size, 2), int), None,
                rgbd.shape[0] / 2 - y / rgbd.pixel_mm, -(eye.y_mm - y) / eye.z_mm / rgbd.pixel_mm,
                x / rgbd.pixel_mm + rgbd.shape[1] / 2, (eye.x_mm - x) / eye.z_mm / rgbd.pixel_mm,
                zeros, zeros, zeros.astype(bool),
            )  # fmt: skip
            sources = first_hits(rays, rgbd, display)
            hit = sources >= 0
            colour = np.where(hit[:, None], rgbd.color.reshape(-1, 3)[np.maximum(sources, 0)], 0)
            blocks = colour.reshape(view.shape[0], 4, view.shape[1], 4, 3).mean(axis=(1, 3))
            hits = hit.reshape(view.shape[0], 4, view.shape[1], 4).mean(axis=(1, 3))
            wrong = (np.abs(view - blocks).max(axis=-1) > 1e-5) | (np.abs(share - hits) > 1e-5)
            yield Deviation(f"{eye.position_mm}", float(wrong.mean()), wrong.size, int(wrong.sum()))


# -- noise --------------------------------------------------------------------------------------


@relation(
    "images with noise", covers="image.noisy_image", limit=8, unit="ulp of float32",
    source="roundings of float32 sums",
)  # fmt: skip
def _noise(_: str, effort: int) -> Iterator[Deviation]:
    """Image, noise and halves follow from each other; replicates and samples are split evenly."""
    random = np.random.default_rng(0)
    first, second = random.random((2, 5, 7, 3)).astype(np.float32)
    image = NoisyImage.from_halves(first, second)
    yield difference("image", image.image, (first.astype(float) + second) / 2, EPS32)
    yield difference("noise", image.noise, (first.astype(float) - second) / 2, EPS32)
    again = NoisyImage.from_image(image.image, image.noise)
    for a, b in zip(again.halves(), (first, second), strict=True):
        yield difference("halves", a, b, EPS32)
    yield difference("a band", again.halves(slice(1, 3))[1], second[1:3], EPS32)
    replicates = random.random((8, 5, 7, 3)).astype(np.float32)
    image = NoisyImage.from_replicates(replicates)
    yield difference("mean", image.image, replicates.astype(float).mean(axis=0), EPS32)
    yield difference("first half", image.first, replicates[:4].astype(float).mean(axis=0), EPS32)
    yield difference("second half", image.second, replicates[4:].astype(float).mean(axis=0), EPS32)
    broken = first.copy()
    broken[2, 3, 1] = np.nan
    mended = NoisyImage.from_halves(broken, second).replace_nonfinite()
    yield difference("not finite", mended.nonfinite, 1)
    yield difference("black", mended.first[2, 3], (0, 0, 0))
    yield difference("the rest", np.delete(mended.first.reshape(-1, 3), 17, 0),
                     np.delete(first.reshape(-1, 3), 17, 0))  # fmt: skip
    for spp in range(1, 70):
        count, part = split_samples(spp)
        enough = count * part >= spp if spp >= 8 else count * part <= max(spp, 2)
        yield is_true(f"{spp} samples", count in (2, 8) and enough and count * part < spp + 8)
    others = NoisyImage.from_replicates(random.random((8, 5, 7, 3)).astype(np.float32))
    all_samples = image.merged(others, 0.25)
    for own, a, b in (
        (all_samples.image, image.image, others.image),
        (all_samples.replicates, image.replicates, others.replicates),
    ):
        yield difference("merged", own, 0.75 * a.astype(float) + 0.25 * b, EPS32)
    # Jackknife: the square of a mean has the bias variance / K, which pseudo-values remove.
    values = random.normal(size=(6, 1000))
    mean = values.mean(axis=0)
    without = ((values.sum(axis=0) - v) / 5 for v in values)
    squares = pseudo_values(mean**2, (m**2 for m in without)).mean(axis=0)
    unbiased = mean**2 - values.var(axis=0, ddof=1) / 6
    yield difference("jackknife", squares, unbiased, EPS32)


@relation(
    "scaled pictures", covers="display.display", limit=0, unit="pixels", source="counts",
)  # fmt: skip
def _sizes(_: str, effort: int) -> Iterator[Deviation]:
    """The pixels of a picture are squares that cover whole pitches, in any unit of length."""
    for name, display in displays():
        for per_pitch in (1, 2, 5, 1.7):
            side = display.capture_pixel_mm(per_pitch)
            yield difference(f"{name}: side", side * per_pitch, display.pitch_mm, 4e-16)
            in_inches = scaled(display, 1 / 25.4)
            shapes = in_inches.capture_shape(per_pitch), display.capture_shape(per_pitch)
            yield difference(f"{name}: shape", *shapes)
            yield is_true(f"{name}: not tiny", math.prod(shapes[0]) > 0)
