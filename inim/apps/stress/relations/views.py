"""Views of the renderer, and its ground truth of a scene in closed form."""

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from inim.apps.stress.oracles.rays import panel_rays
from inim.apps.stress.pictures import displays, small_display
from inim.apps.stress.relation import (
    LENS_MODELS,
    Deviation,
    difference,
    excess,
    is_true,
    relation,
)
from inim.apps.stress.relations.rays import traced
from inim.display import Display
from inim.display.lens import channel_indices, check_lens_model, lens_model, trace_to_panel
from inim.display.panel import white_of
from inim.display.pixels import CENTRE, panel_points
from inim.display.settings import plain_parameters
from inim.display.viewpoint import Viewpoint
from inim.generators import find_sources
from inim.image.rgbd import Layer, LayeredRGBD
from inim.system.errors import DisplayError

_VIEWS = "render.view_matrix render.display_emitter render.reconstruct render.trace render.rays \
    display.lens display.panel display.pixels display.cells display.layouts"
_TRUTH = "render.ground_truth render.trace render.rays render.culling render.depth_peeling \
    render.scene render.scene_files.file display.pixels image.rgbd"


def _analytic(name: str) -> str | None:
    return "" if lens_model(name).mesh is None else None


def _eye(pupil_mm: float = 0.0) -> Viewpoint:
    return Viewpoint("eye", 3.7, -2.9, 91.0, pupil_mm, 70.0 if pupil_mm else None)


def _expected_matrices(
    display: Display, model: str, eye: Viewpoint, spp: int, seed: int
) -> list[Any]:
    """Share of each panel pixel in each view pixel, from the renderer's own sample positions."""
    from inim.render.rays import eye_rays

    rays = eye_rays(display, eye, 2, 0.0)
    x, y, slope_x, slope_y = traced(rays, spp, seed)[6:10]
    indices = channel_indices(display) if lens_model(model).refracts else (None,) * 3
    rows, columns = display.eia_shape
    matrices = []
    for channel, index in enumerate(indices):
        panel_x, panel_y, weight = trace_to_panel(
            display, model, x.astype(float), y.astype(float), slope_x.astype(float),
            slope_y.astype(float), index=index,
        )  # fmt: skip
        lit = weight > 0
        points = panel_points(display, np.where(lit, panel_x, 0), np.where(lit, panel_y, 0))
        share = np.where(lit, weight, 0) * points.shines[channel] / spp
        pixel = np.broadcast_to(np.arange(len(x))[:, None], x.shape).ravel()
        place = (points.row * columns + points.column).ravel()
        matrices.append(csr_array((share.ravel(), (pixel, place)), (len(x), rows * columns)))
    return matrices


@relation(
    "matrices of views", covers=_VIEWS, limit=0.02, unit="share of a view's light",
    source="samples within float32 of a border of pixels", subjects=LENS_MODELS, explain=_analytic,
)  # fmt: skip
def _matrices(model: str, effort: int) -> Iterator[Deviation]:
    """Each view pixel sees the panel pixels that its samples reach, with their weights."""
    from inim.render.view_matrix import observed_columns, view_matrices

    spp = 8 * effort
    for number, (name, display) in enumerate(displays()):
        if effort == 1 and number % 3 != ("pinhole", "thin", "thick").index(model) % 3 if model in (
            "pinhole", "thin", "thick") else number % 3:  # fmt: skip
            continue
        # Glass of the default thickness does not fit into all gaps.
        display = display.replace(lens_thickness_mm=0.6, abbe_number=50.0 if number % 2 else None)
        try:
            check_lens_model(model, display)
        except DisplayError:
            continue
        eye = _eye(3.0 if number % 4 == 1 else 0.0)
        matrices = view_matrices(display, eye, model, pixels_per_lens=2, spp=spp, seed=5)
        expected = _expected_matrices(display, model, eye, spp, 5)
        if len(matrices) == 1:
            matrices = [*matrices] * 3
        for channel, (actual, true) in enumerate(zip(matrices, expected, strict=True)):
            light = max(true.sum(), 1e-3)
            far = abs(actual - true).sum() / light
            yield Deviation(f"{name}: colour {channel}", float(far), true.nnz)
        mask, reduced = observed_columns(matrices[:1])
        dark = np.delete(np.ones(len(mask)), np.flatnonzero(mask))
        yield is_true(
            f"{name}: observed", mask.sum() == reduced[0].shape[1] and len(dark) + mask.sum()
        )
        light = np.random.default_rng(1).random(len(mask))
        yield difference(f"{name}: kept", reduced[0] @ light[mask], matrices[0] @ light, 1e-4)


@relation(
    "views are their matrices", covers=_VIEWS, limit=8, unit="1e-6 of white", source="float32 sums",
    subjects=LENS_MODELS, explain=_analytic,
)  # fmt: skip
def _views(model: str, effort: int) -> Iterator[Deviation]:
    """A view is its matrix times the panel's light, in any order, and in passes of any size."""
    from inim.render import trace
    from inim.render.reconstruct import DisplayScene
    from inim.render.view_matrix import view_matrices

    kinds: dict[str, dict[str, Any]] = {
        "plain": {}, "stripes": {"subpixels": "rgb-stripe", "pixel_fill": 0.7},
        "panel": {"black_level": 0.02, "white_point_k": 5000.0, "abbe_number": 40.0},
    }  # fmt: skip
    for name, changes in kinds.items():
        display = small_display(lens_thickness_mm=0.6, lens_rows=4, **changes)
        eia = np.random.default_rng(2).random((*display.eia_shape, 3)).astype(np.float32)
        light = eia
        if name == "panel":
            light = white_of(display) * (0.02 + 0.98 * eia)
        eyes = [_eye(), Viewpoint("other", -5.0, 1.0, 120.0, 4.0, 100.0)]
        scene = DisplayScene(eia, display, model)
        size = {"pixels_per_lens": 2, "spp": 12, "seed": 7}
        views = [scene.view(eye, **size) for eye in eyes]
        for eye, view in zip(eyes, views, strict=True):
            matrices = view_matrices(display, eye, model, **size)
            if len(matrices) == 1:
                matrices = [*matrices] * 3
            product = np.stack([m @ light[..., c].ravel() for c, m in enumerate(matrices)], axis=-1)
            yield difference(f"{name}: {eye.name}", view, product.reshape(view.shape), 1e-6)
        for eye, view in zip(eyes[::-1], views[::-1], strict=True):
            yield difference(f"{name}: in another order", scene.view(eye, **size), view, 1e-30)
        before = trace.rays_per_pass()
        trace.limit_rays(80)  # five of the twelve samples in a pass, five, and two
        try:
            small = scene.view(eyes[0], **size)
        finally:
            trace.limit_rays(before)
        yield difference(f"{name}: small passes", small, views[0], 1e-6)
        double = DisplayScene(eia / 2, display.replace(black_level=0.0), model)
        if name != "panel":
            half = double.view(eyes[0], **size)
            yield difference(f"{name}: half the light", half, views[0] / 2, 1e-6)


@relation(
    "lens models agree", covers="display.lens render.reconstruct render.display_emitter",
    limit=0.08, unit="share of the mean light",
    source="noise of path tracing; crosstalk within the glass",
    subjects=("full",),
)  # fmt: skip
def _full(model: str, effort: int) -> Iterator[Deviation]:
    """The path traced mesh shows the view of the thick lens, with its loss of light."""
    from inim.render.reconstruct import DisplayScene

    for name, changes in {
        "to the viewer": {}, "to the panel": {"curved_side": "panel"},
        "shifted, turned": {"shift_x_mm": 0.3, "rotation_deg": 5.0},
        "stripes": {"subpixels": "rgb-stripe"}, "dispersion": {"abbe_number": 30.0},
    }.items() if effort > 1 else {"to the viewer": {}}.items():  # fmt: skip
        display = small_display(lens_columns=5, lens_rows=4, **changes)
        rows, columns = np.indices(display.eia_shape)
        eia = np.stack([rows / rows.max(), columns / columns.max(), 0.5 + 0 * rows], axis=-1)
        eia = eia.astype(np.float32)
        eye, size = Viewpoint("eye", 1.0, 2.0, 60.0), {"pixels_per_lens": 1, "seed": 3}
        thick = DisplayScene(eia, display, "thick").view(eye, spp=256, **size)
        full = DisplayScene(eia, display, model).view(eye, spp=512 * effort, **size)
        for channel in range(3):
            far = np.abs(full - thick)[1:-1, 1:-1, channel].mean() / thick[..., channel].mean()
            yield Deviation(f"{name}: colour {channel}", float(far), full[..., 0].size)
        ratio = full[1:-1, 1:-1].mean() / thick[1:-1, 1:-1].mean()
        yield excess(f"{name}: light", abs(ratio - 1), 0.0)


# -- the ground truth of a scene in closed form -------------------------------------------------

_SCENE = """<scene version="3.0.0"><integrator type="path"><integer name="max_depth" value="2"/>
</integrator><sensor type="perspective"><transform name="to_world">
<lookat origin="0,0,100" target="0,0,0" up="0,1,0"/></transform></sensor>
<emitter type="directional"><vector name="direction" value="0,0,-1"/>
<rgb name="irradiance" value="2.5"/></emitter>{}</scene>"""
_PLATE = """<shape type="rectangle"><transform name="to_world"><scale x="{2}" y="{3}"/>
<translate x="{0}" y="{1}" z="{4}"/></transform><bsdf type="diffuse">
<rgb name="reflectance" value="{5}"/></bsdf></shape>"""
_BALL = """<shape type="sphere"><point name="center" x="{0}" y="{1}" z="{2}"/>
<float name="radius" value="{3}"/><bsdf type="diffuse"><rgb name="reflectance" value="{4}"/>
</bsdf></shape>"""
# Plates: middle x and y, half width and height, z, colour. A red one far, a green one near.
_PLATES = ((-0.3, 0.1, 2.0, 1.5, -1.0, (0.8, 0, 0)), (0.7, -0.4, 0.6, 0.5, 1.0, (0, 0.5, 0)))
# A blue ball: centre and radius.
_CENTRE, _RADIUS = np.array([-1.2, 0.7, 0.3]), 0.45


def _open(display: Display, share: float) -> Any:
    """The plates and the ball."""
    plates = [_PLATE.format(*plate[:5], ",".join(map(str, plate[5]))) for plate in _PLATES]
    ball = _BALL.format(*_CENTRE, _RADIUS, "0,0,0.6")
    return _open_text(_SCENE.format("".join(plates) + ball), display, share)


def _open_text(text: str, display: Display, share: float, folder: str | None = None) -> Any:
    """Scene of a text, next to its files in a folder."""
    from inim.render.scene import open_scene
    from inim.render.scene_files.file import read_scene_file

    with tempfile.TemporaryDirectory() as own_folder:
        path = Path(folder or own_folder) / "scene.xml"
        path.write_text(text, encoding="utf-8")
        return open_scene(read_scene_file(path), display, share)


def _world_hits(world: np.ndarray, x: Any, y: Any, sx: Any, sy: Any) -> tuple[Any, Any, Any]:
    """First object of display rays (x + sx z, y + sy z): 0 red, 1 green, 2 blue, -1 none; its
    display z; and the distance from a change of the object, in world units.
    """
    start = np.stack([x, y, np.zeros_like(x), np.ones_like(x)], axis=-1) @ world.T
    run = np.stack([sx, sy, np.ones_like(x), np.zeros_like(x)], axis=-1) @ world.T
    best, which, margin = np.full(x.shape, -np.inf), np.full(x.shape, -1), np.full(x.shape, np.inf)
    for number, (px, py, half_x, half_y, pz, _) in enumerate(_PLATES):
        z = (pz - start[..., 2]) / run[..., 2]
        u, v = start[..., 0] + z * run[..., 0] - px, start[..., 1] + z * run[..., 1] - py
        inside = np.minimum(half_x - np.abs(u), half_y - np.abs(v))
        margin = np.minimum(margin, np.abs(inside))
        nearer = (inside > 0) & (z > best)
        best, which = np.where(nearer, z, best), np.where(nearer, number, which)
    o, d = start[..., :3] - _CENTRE, run[..., :3]
    a, b, c = (d * d).sum(-1), (o * d).sum(-1), (o * o).sum(-1) - _RADIUS**2
    under = b * b - a * c
    # Distance of the ray from the ball's rim.
    closest = np.sqrt(np.maximum((o * o).sum(-1) - b * b / a, 0))
    margin = np.minimum(margin, np.abs(closest - _RADIUS))
    z = (-b + np.sqrt(np.maximum(under, 0))) / a
    nearer = (under > 0) & (z > best)
    return np.where(nearer, 2, which), np.where(nearer, z, best), margin


@relation(
    "ground truth of plates and a ball", covers=_TRUTH, limit=1e-4,
    unit="share of the depth range, or of white", source="float32 intersections",
)  # fmt: skip
def _truth(_: str, effort: int) -> Iterator[Deviation]:
    """Depth, EIA and views show the surfaces of their rays, and skipping changes no bit."""
    from inim.render.ground_truth import capture, capture_parts, pickup, true_view

    ends = {"depth_min_mm": 9.0, "depth_max_mm": 15.0}
    kinds: dict[str, dict[str, object]] = {
        "square": {}, "hexagonal": {"lattice": "hexagonal", "rotation_deg": 8.0, "tilt_x_deg": 2.0},
        "stripes": {"subpixels": "rgb-stripe", "shift_x_mm": 0.3},
        "lenticular": {"lattice": "lenticular", "lens_rows": 1, "panel_columns": 50,
                       "panel_rows": 40, "rotation_deg": 12.0, "elemental_pitch_mm": 1.01},
        "cells": {"subpixels": "cells", "subpixel_cells": "-0.3 0.2 0.3 0 0 -0.2"},
    }  # fmt: skip
    for name, changes in list(kinds.items())[: 2 if effort == 1 else None]:
        display = small_display(**{"lens_columns": 10, "lens_rows": 8, **ends, **changes})
        fitted = _open(display, 0.8)
        low, high = display.depth_range_mm
        world = fitted.fit.world_from_display
        # The scene fills its share of the array, and the depth range but for a hundredth.
        corners = np.array([[-2.3, 1.6, 1.0, 1.0], [1.7, -1.4, -1.0, 1.0]])
        ends_mm = corners @ fitted.fit.display_from_world.T
        size = np.abs(ends_mm[0] - ends_mm[1])[:2] / (display.width_mm, display.height_mm)
        yield difference(f"{name}: fitted", size.max(), 0.8)
        yield difference(f"{name}: deep", ends_mm[:, 2], (high - 0.06, low + 0.06), high - low)
        rgbd = capture(fitted, display, pixels_per_pitch=4, spp=4, seed=1)
        rows, columns = rgbd.shape
        y, x = ((rows - 1) / 2 - np.arange(rows)) / 4, (np.arange(columns) - (columns - 1) / 2) / 4
        x, y = np.meshgrid(x * display.pitch_mm, y * display.pitch_mm)
        which, depth, margin = _world_hits(world, x, y, 0 * x, 0 * y)
        sure = margin > 1e-3
        yield is_true(f"{name}: covered", (rgbd.covered == (which >= 0))[sure], int(sure.sum()))
        certain = sure & (which >= 0)
        yield difference(f"{name}: depth", rgbd.depth_mm[certain], depth[certain], high - low)
        front = (which == 1) & (margin > 0.25)
        light = 0.5 * 2.5 / np.pi
        expected = np.broadcast_to((0, light, 0), rgbd.color[front].shape)
        yield difference(f"{name}: colour", rgbd.color[front], expected)
        parts = [
            capture_parts(fitted, display, pixels_per_pitch=4, spp=8, seed=2, skip=skip)
            for skip in (True, False)
        ]
        for a, b in zip(*parts, strict=True):
            yield difference(f"{name}: skipped", a.color, b.color)
            yield difference(f"{name}: skipped depth", a.depth_mm, b.depth_mm)
        slanted = capture_parts(
            fitted, display, pixels_per_pitch=4, spp=2, seed=2, slopes=(0.1, -0.05)
        )[0]
        lean = (0 * x + 0.1, 0 * x - 0.05)
        which, depth, margin = _world_hits(world, x, y, *lean)
        certain = (margin > 1e-3) & (which >= 0)
        yield difference(f"{name}: slanted", slanted.depth_mm[certain], depth[certain], high - low)
        yield from _panel_shows(name, display, fitted, world, pickup)
        eye = Viewpoint("eye", 4.0, -3.0, 140.0)
        view, relic = true_view(fitted, display, eye, pixels_per_lens=3, spp=8, seed=4)
        other, _ = true_view(fitted, display, eye, pixels_per_lens=3, spp=8, seed=4, skip=False)
        yield difference(f"{name}: view skipped", view.image, other.image)
        cell_x, cell_y = display.layout.view_cell_mm
        rows, columns = relic.shape
        x = (np.arange(columns) - (columns - 1) / 2) * cell_x / 3
        y = ((rows - 1) / 2 - np.arange(rows)) * cell_y / 3
        x, y = np.meshgrid(x, y)
        slopes = (4.0 - x) / 140.0, (-3.0 - y) / 140.0
        which, _, margin = _world_hits(world, x, y, *slopes)
        sure = margin > 1e-3
        yield is_true(f"{name}: relic", (relic == (which >= 0))[sure], int(sure.sum()))
        yield from _is_shown(f"{name}: view", view.image, which, margin > 0.3)


def _panel_shows(
    name: str, display: Display, fitted: Any, world: np.ndarray, pickup: Any
) -> Iterator[Deviation]:
    eia, whole = (pickup(fitted, display, spp=8, seed=3, skip=skip) for skip in (True, False))
    yield difference(f"{name}: EIA skipped", eia.image, whole.image)
    yield is_true(f"{name}: dark", not eia.image[~display.lensed].any())
    mask = np.indices(display.eia_shape).sum(axis=0) % 5 == 0
    part = pickup(fitted, display, spp=8, seed=3, mask=mask)
    yield difference(f"{name}: masked", part.image, eia.image * mask[..., None])
    pixels = np.argwhere(display.lensed)
    observed = np.zeros(display.eia_shape, bool)
    observed[tuple(pixels[::3].T)] = True
    observed_eia = pickup(fitted, display, spp=8, seed=3, observed=observed)
    mean = observed_eia.observed.mean(axis=0)
    yield difference(f"{name}: replicates", mean, observed_eia.image[observed], 1e-2)
    rays = panel_rays(display, pixels, CENTRE)
    x0, y0, sx, sy = (np.asarray(v, float) for v in rays[1:5])
    which, _, margin = _world_hits(world, x0, y0, sx, sy)
    # A pixel's bundle at the front of the depth range, in world units.
    wide = display.pixel_pitch_mm * (1 + display.depth_range_mm[1] / display.gap_mm) * world[0, 0]
    sure = (margin > 1.2 * wide) & (rays.margin.astype(float) > 1e-6)
    yield from _is_shown(f"{name}: EIA", eia.image[tuple(pixels.T)], which, sure)


def _is_shown(case: str, colours: np.ndarray, which: np.ndarray, sure: np.ndarray) -> Iterator[Any]:
    """Pixels far from edges show the colour of one object only."""
    yield is_true(f"{case}: enough", sure.mean() > 0.05 and (which[sure] == 0).any())
    for number in (-1, 0, 1, 2):
        own = colours[sure & (which == number)]
        others = np.delete(own, number, axis=-1) if number >= 0 else own
        yield is_true(f"{case}: {number}", not others.any(), len(own))
    lit = colours[sure & (which == 1)][:, 1]
    yield difference(f"{case}: light", lit, np.full(lit.shape, 0.5 * 2.5 / np.pi))


@relation(
    "peeled layers", covers=_TRUTH + " image.sides", limit=2e-3, unit="share of the depth range",
    source="float32 intersections; steps behind each hit",
)  # fmt: skip
def _peeled(_: str, effort: int) -> Iterator[Deviation]:
    """Layers are the fronts and backs along each ray, coloured without what is in front of them."""
    from inim.render.depth_peeling import peel
    from inim.render.ground_truth import capture_layers

    display = small_display(lens_columns=10, lens_rows=8, depth_min_mm=9.0, depth_max_mm=15.0)
    fitted = _open(display, 0.8)
    world, span = fitted.fit.world_from_display, 6.0
    peeled = peel(fitted, display, pixels_per_pitch=4, hidden=True)
    rows, columns = peeled.front_mm.shape[1:]
    y, x = ((rows - 1) / 2 - np.arange(rows)) / 4, (np.arange(columns) - (columns - 1) / 2) / 4
    x, y = np.meshgrid(x, y)
    start = np.stack([x, y, np.zeros_like(x), np.ones_like(x)], axis=-1) @ world.T
    per_mm = world[2, 2]
    fronts = []
    rim = np.full(x.shape, np.inf)
    for px, py, half_x, half_y, pz, _ in _PLATES:
        inside = np.minimum(
            half_x - np.abs(start[..., 0] - px), half_y - np.abs(start[..., 1] - py)
        )
        rim = np.minimum(rim, np.abs(inside))
        fronts.append(np.where(inside > 0, (pz - start[..., 2]) / per_mm, -np.inf))
    off_axis = np.hypot(start[..., 0] - _CENTRE[0], start[..., 1] - _CENTRE[1])
    rim = np.minimum(rim, np.abs(off_axis - _RADIUS))
    half = np.sqrt(np.maximum(_RADIUS**2 - off_axis**2, 0))
    ball = np.where(off_axis < _RADIUS, (_CENTRE[2] + half - start[..., 2]) / per_mm, -np.inf)
    back = np.where(off_axis < _RADIUS, (_CENTRE[2] - half - start[..., 2]) / per_mm, -np.inf)
    ordered = -np.sort(-np.stack([*fronts, ball]), axis=0)
    sure = rim > 0.05
    layers = len(peeled.front_mm)
    for k in range(min(3, layers)):
        there = sure & np.isfinite(ordered[k])
        yield is_true(f"layer {k}: covered", peeled.covered[k][sure] == there[sure])
        yield difference(f"layer {k}: front", peeled.front_mm[k][there], ordered[k][there], span)
        solid = there & (ordered[k] == ball)
        ends = peeled.back_mm[k][solid] - back[solid]
        yield excess(f"layer {k}: back", ends, 1e-3 * span)
        # Only backs next to the rim are lowered to neighbours.
        deep = float(np.quantile(ends, 0.9)) if len(ends) else 0.0
        yield difference(f"layer {k}: lowest back", deep, 0.0, span)
    in_view = peel(fitted, display, pixels_per_pitch=4)
    yield is_true("in view", ~in_view.covered | np.isfinite(in_view.front_mm))
    yield difference("front layer", in_view.front_mm[0], peeled.front_mm[0])
    yield from _kept_layers(peel)
    picture = capture_layers(fitted, peeled, spp=4, seed=1)
    for layer in picture.layers:
        for number, depth in enumerate((*fronts, ball)):
            own = layer.covered & sure & (np.abs(layer.front_mm - depth) < 1e-3 * span)
            colours = layer.color[own]
            yield is_true(
                f"object {number}", not np.delete(colours, number, axis=-1).any(), len(colours)
            )


def _kept_layers(peel: Any) -> Iterator[Deviation]:
    """Layers that are removed as hidden are the source of no ray; colours have positive widths."""
    kinds: dict[str, dict[str, object]] = {
        "square": {}, "hexagonal": {"lattice": "hexagonal", "rotation_deg": 8.0},
        "behind": {"focal_length_mm": 3.3, "gap_mm": 3.0, "depth_min_mm": -15.0,
                   "depth_max_mm": -9.0},
    }  # fmt: skip
    for name, changes in kinds.items():
        ends = {"depth_min_mm": 9.0, "depth_max_mm": 15.0}
        display = small_display(**{"lens_columns": 10, "lens_rows": 8, **ends, **changes})
        fitted, depths = _open(display, 0.8), []
        for hidden in (True, False):
            peeled = peel(fitted, display, pixels_per_pitch=4, hidden=hidden)
            shape = (*peeled.front_mm.shape, 3)
            front, *deeper = (
                Layer(np.zeros(shape[1:], np.float32), *values)
                for values in zip(peeled.front_mm, peeled.back_mm, peeled.covered, strict=True)
            )
            layers = LayeredRGBD(
                front.color, front.front_mm, front.covered, peeled.pixel_mm, front.back_mm,
                tuple(deeper),
            )  # fmt: skip
            sources = find_sources(layers, display, "layered:samples=1")
            depths.append(np.where(sources >= 0, peeled.front_mm.ravel()[sources], sources))
            wide = np.abs(peeled.front_mm) * display.pixel_pitch_mm / display.gap_mm / 2
            width = np.maximum(wide / peeled.pixel_mm, 1)[peeled.covered]
            yield difference(f"{name}: widths", peeled.spread[peeled.covered], width, 0.01)
        yield difference(f"{name}: hidden layers", *depths)


# A post, a square prism along z in a white room: half its sides, and the colours of its faces.
_ROOM = """<scene version="3.0.0"><integrator type="path"><integer name="max_depth" value="2"/>
</integrator><emitter type="constant"><rgb name="radiance" value="1"/></emitter>{}</scene>"""
_FACE = """<shape type="rectangle"><transform name="to_world">{0}</transform><bsdf type="twosided">
<bsdf type="diffuse"><rgb name="reflectance" value="{1}"/></bsdf></bsdf></shape>"""
_FACES = {
    "front": ("", (0.5, 0.5, 0.5)),
    "left": ('<rotate y="1" angle="-90"/>', (0.8, 0.0, 0.0)),
    "right": ('<rotate y="1" angle="90"/>', (0.0, 0.8, 0.0)),
    "above": ('<rotate x="1" angle="-90"/>', (0.0, 0.0, 0.8)),
    "below": ('<rotate x="1" angle="90"/>', (0.8, 0.8, 0.0)),
    "behind": ('<rotate y="1" angle="180"/>', (0.5, 0.5, 0.5)),
}


@relation(
    "colours of sides", covers="render.ground_truth render.depth_peeling image.sides", limit=0.06,
    unit="of white", source="noise of 64 samples; a side within half a pixel of its wall",
)  # fmt: skip
def _sides(_: str, effort: int) -> Iterator[Deviation]:
    """A side has the colour of its face; at a corner, faces count by the slopes of their rays."""
    from inim.render.depth_peeling import peel
    from inim.render.ground_truth import capture_layers

    faces = [
        _FACE.format(f'<translate z="1"/>{turn}<scale value="2"/>', ",".join(map(str, color)))
        for turn, color in _FACES.values()
    ]
    colors = {name: np.array(color) for name, (_, color) in _FACES.items()}
    sides = [colors[name] for name in ("left", "right", "above", "below")]
    for changes in ({"pitch_y_mm": 0.4, "lens_rows": 20}, {"pitch_y_mm": 2.0, "lens_rows": 4}):
        display = small_display(
            **{"lens_columns": 8, "depth_min_mm": 9.0, "depth_max_mm": 15.0, **changes}
        )
        steep = display.pitch_mm / 2, display.row_pitch_mm / 2
        # 20 pixels wide and high: the faces are borders of pixels.
        fitted = _open_text(_ROOM.format("".join(faces)), display, 0.625)
        peeled = peel(fitted, display, pixels_per_pitch=4)
        picture = capture_layers(fitted, peeled, spp=16 * effort, seed=1)
        covered = np.pad(picture.layers[0].covered, 1)
        middle = np.s_[1:-1, 1:-1]
        is_open = [~np.roll(covered, move, axis=axis)[middle]
                   for axis, move in ((1, 1), (1, -1), (0, 1), (0, -1))]  # fmt: skip
        for right, down in ((0, 2), (0, 3), (1, 2), (1, 3), (0, None), (None, 3)):
            # Corners have two open sides, edges one.
            there = picture.layers[0].covered.copy()
            for side, is_beside in enumerate(is_open):
                there &= is_beside == (side in (right, down))
            weights = [s * (n is not None) for s, n in zip(steep, (right, down), strict=True)]
            parts = [w * sides[n] for w, n in zip(weights, (right, down), strict=True)
                     if n is not None]  # fmt: skip
            own = [layer.color[there & layer.covered] for layer in picture.layers[1:]]
            colours = np.concatenate(own)
            expected = sum(parts) / sum(weights)
            case = f"{changes}, {right}, {down}"
            yield is_true(f"{case}: pieces", len(colours) > 3)
            yield difference(case, colours.mean(axis=0) if len(colours) else 0.0, expected)


@relation(
    "layers of splats", covers="render.splats render.depth_peeling", limit=0.02,
    unit="share of the depth range", source="shells of splats are polyhedra",
)  # fmt: skip
def _layers_of_splats(_: str, effort: int) -> Iterator[Deviation]:
    """Splats with overlapping supports are one layer, from its half light to its last peak."""
    from inim.render.depth_peeling import peel
    from inim.render.meshes.splat_ply import Splats, write_splats
    from inim.render.scene_files.relic_scene import splat_scene_xml

    # Supports end where opacity is a hundredth: at 3.03 standard deviations.
    cases = {
        "apart": ((5.0, -5.0), ((0, 0), (1, 1))),
        "overlapping": ((6.0, 2.0, -7.0), ((0, 1), (2, 2))),
        "chain": ((6.0, 2.0, -2.0, -6.0), ((0, 3),)),
    }
    for name, (peaks, layers) in cases.items():
        count = len(peaks)
        splats = Splats(
            np.array([(0, 0, z) for z in peaks], np.float32), np.zeros((count, 3), np.float32),
            np.tile(np.float32([1, 0, 0, 0]), (count, 1)), np.full(count, 4.6, np.float32),
            np.ones((count, 1, 3), np.float32),
        )  # fmt: skip
        display = small_display(lens_columns=9, lens_rows=9, depth_min_mm=9.0, depth_max_mm=15.0)
        half = np.array([3.1, 3.1, 10.0])
        with tempfile.TemporaryDirectory() as folder:
            write_splats(Path(folder) / "splats.ply", splats)
            xml = splat_scene_xml("splats.ply", half, name)
            fitted = _open_text(xml, display, 0.8, folder)
        forward = fitted.fit.display_from_world
        depths = [forward[2, 2] * z + forward[2, 3] for z in peaks]
        peeled = peel(fitted, display, pixels_per_pitch=1, hidden=True)
        row, column = (n // 2 for n in peeled.front_mm.shape[1:])
        number = int(peeled.covered[:, row, column].sum())
        yield is_true(f"{name}: {number} layers", number == len(layers))
        for k, (first, last) in enumerate(layers[:number]):
            front, back = peeled.front_mm[k, row, column], peeled.back_mm[k, row, column]
            yield difference(f"{name}: front {k}", front, depths[first], 6.0)
            yield excess(f"{name}: back {k}", (back - depths[last]) / 6.0, 0.0)


@relation(
    "a display in a scene", covers="render.display_emitter render.sensors", limit=0.02,
    unit="of white", source="float32 places of the renderer's own rays",
)  # fmt: skip
def _in_a_scene(_: str, effort: int) -> Iterator[Deviation]:
    """An eye in a scene of the renderer sees in each lens what its elemental image has for it."""
    from inim.render.library import mi

    display = small_display(lens_columns=6, lens_rows=4)
    per_lens = round(display.pixels_per_lens)
    colours = np.random.default_rng(4).random((4, 6, 3)).astype(np.float32)
    eia = colours.repeat(per_lens, axis=0).repeat(per_lens, axis=1)
    # An eye below sees the upper two of five rows.
    lower = np.arange(len(eia)) % per_lens >= 2
    eia[lower] = 1 - eia[lower]
    parameters, size = plain_parameters(display), [display.width_mm / 2, display.height_mm / 2, 1]
    turned = mi.ScalarTransform4f().translate([3, -1, 7]).rotate([0.6, 0, 0.8], 70)
    for name, world in (("as it is", mi.ScalarTransform4f()), ("turned", turned)):
        place = world @ mi.ScalarTransform4f().scale(size)
        emitter = {"type": "inim_display", **parameters, "eia": mi.TensorXf(eia)}
        eye = {"type": "inim_eye", "to_world": place, **parameters, "x_mm": 4.0, "y_mm": -12.0,
               "z_mm": 140.0}  # fmt: skip
        scene = mi.load_dict({
            "type": "scene", "integrator": {"type": "path"}, "eye": eye,
            "panel": {"type": "rectangle", "to_world": place, "emitter": emitter},
        })  # fmt: skip
        view = np.array(mi.render(scene, spp=16))
        side = view.shape[0] // 4
        inner = view.reshape(4, side, 6, side, 3)[:, 1 : side - 1, :, 1 : side - 1]
        expected = np.broadcast_to(colours[:, None, :, None], inner.shape)
        yield difference(name, inner / inner.mean() * expected.mean(), expected)
