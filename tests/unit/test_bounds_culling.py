"""Pixels that are black for certain: skipping them changes no bit of any ground truth."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from inim.display import Viewpoint
from inim.system.errors import FileError
from inim.system.process.observer import Observer
from tests.conftest import scene_text, small_display, sphere
from tests.serialized_meshes import serialized
from tests.splat_relics import random_splats, splat_scene

LAMP = """<shape type="rectangle"><transform name="to_world"><scale value="2"/>
    <rotate y="1" angle="180"/><translate z="9"/></transform>
    <emitter type="area"><rgb name="radiance" value="5"/></emitter></shape>"""
GLASS = """<shape type="cube"><transform name="to_world"><rotate x="1" y="1" angle="40"/>
    <translate x="-4" y="3"/></transform><bsdf type="thindielectric"/></shape>"""
SPHERES = (sphere((-3, 0, 0), 1.5), sphere((2, 2, -3), 1.0), sphere((4, -3, 1), 0.3))
ARRAYS = {
    "stripes": {"subpixels": "rgb-stripe", "pixel_fill": 0.8},
    "hexagonal, turned and tilted": {
        "lattice": "hexagonal", "rotation_deg": 3.0, "tilt_x_deg": 2.0, "tilt_y_deg": -1.0,
    },
}  # fmt: skip


@pytest.mark.parametrize("array", ARRAYS)
def test_the_eia_is_the_same_without_black_pixels(array, open_fitted):
    from inim.render.ground_truth import pickup

    display = small_display(**ARRAYS[array])
    fitted = open_fitted(scene_text(*SPHERES, LAMP, GLASS), display)
    observers = Observer(), Observer()
    eias = [
        pickup(fitted, display, spp=16, seed=1, skip=skip, observer=observer)
        for skip, observer in zip((True, False), observers, strict=True)
    ]
    assert eias[0].image.max() > 0.1
    assert np.array_equal(eias[0].first, eias[1].first)
    assert np.array_equal(eias[0].second, eias[1].second)
    assert observers[0].samples < 0.7 * observers[1].samples


@pytest.mark.parametrize("pupil", [0.0, 6.0])
def test_views_and_captures_are_the_same_without_black_pixels(pupil, open_fitted):
    from inim.render.ground_truth import capture_parts, true_view

    display = small_display()
    fitted = open_fitted(scene_text(*SPHERES, LAMP, GLASS), display)
    eye = Viewpoint("eye", 20, -15, 400, pupil_mm=pupil)
    results, observers = [], (Observer(), Observer())
    for skip, observer in zip((True, False), observers, strict=True):
        view, relic = true_view(
            fitted, display, eye, pixels_per_lens=6, spp=16, seed=1, skip=skip, observer=observer
        )
        pictures = capture_parts(
            fitted, display, pixels_per_pitch=5, spp=16, seed=2, skip=skip, observer=observer
        )
        results.append([view.first, view.second, relic, *(p.color for p in pictures)])
    assert all(np.array_equal(a, b) for a, b in zip(*results, strict=True))
    assert observers[0].samples < 0.8 * observers[1].samples


def test_few_pixels_around_a_relic_are_traced(open_fitted, tmp_path):
    """The grid is fine: of a ball's EIA, hardly more pixels are traced than show it."""
    from inim.render.ground_truth import pickup
    from inim.render.rays import pickup_rays

    display = small_display(6, 5, pixels=32)
    trimesh.creation.icosphere(subdivisions=4).export(tmp_path / "ball.ply")
    ball = """<shape type="ply"><string name="filename" value="ball.ply"/>
        <bsdf type="diffuse"/></shape>"""
    fitted = open_fitted(scene_text(ball), display)
    visible = fitted.bounds.visible_pixels(pickup_rays(display, fitted.start_mm))
    lit = pickup(fitted, display, spp=32, seed=1).image.max(axis=-1) > 0
    assert not (lit & ~visible).any()
    assert visible.sum() < 1.35 * lit.sum()


def test_an_observer_counts_the_samples_traced(open_fitted):
    from inim.render.depth_peeling import peel
    from inim.render.ground_truth import capture_layers, pickup

    display, progress = small_display(), Observer()
    fitted = open_fitted(scene_text(*SPHERES), display)
    pickup(fitted, display, spp=16, seed=1, observer=progress)
    whole = 16 * display.eia_shape[0] * display.eia_shape[1]
    assert 0 < progress.samples < 0.7 * whole
    before, seconds = progress.samples, progress.render_seconds
    layers = peel(fitted, display, pixels_per_pitch=2, observer=progress)
    capture_layers(fitted, layers, spp=4, seed=1, observer=progress)
    # Walls of sides twice: what they show, and whether anything comes to them.
    assert progress.samples - before == 4 * (layers.covered.sum() + 2 * len(layers.sides.walls))
    assert progress.render_seconds > seconds > 0


PLACE = '<transform name="to_world"><rotate x="1" y="2" angle="35"/></transform>'
GREY = f'{PLACE}<bsdf type="diffuse"/>'
CURVE = f'<string name="filename" value="curve.txt"/>{GREY}'
GRID = """<string name="filename" value="ball.vol"/><bsdf type="diffuse"/>
    <transform name="to_world"><translate x="-0.5" y="-0.5" z="-0.5"/></transform>"""


def shape(plugin: str, content: str) -> str:
    return f'<shape type="{plugin}">{content}</shape>'


def mesh(form: str) -> str:
    return shape(form, f'<string name="filename" value="ball.{form}"/>{GREY}')


#: A relic of each of Mitsuba's shapes, except those made of splats.
RELICS = {
    "bsplinecurve": shape("bsplinecurve", CURVE),
    "cube": shape("cube", GREY),
    "cylinder": shape("cylinder", GREY),
    "disk": shape("disk", GREY),
    "instance": shape("instance", f'<ref id="balls"/>{PLACE}'),
    "linearcurve": shape("linearcurve", CURVE),
    "merge": shape("merge", mesh("ply") + mesh("obj")),
    "obj": mesh("obj"),
    "ply": mesh("ply"),
    "rectangle": shape("rectangle", GREY),
    "sdfgrid": shape("sdfgrid", GRID),
    "shapegroup": '<shape type="shapegroup" id="balls"><shape type="sphere"/></shape>',
    "serialized": mesh("serialized"),
    "sphere": shape("sphere", GREY),
}
RELICS["instance"] = RELICS["shapegroup"] = RELICS["shapegroup"] + RELICS["instance"]
SPLATS = ("ellipsoids", "ellipsoidsmesh")
REFUSED = {"blender": shape("blender", GREY)}


def write_relics(folder: Path) -> None:
    """Write the files of `RELICS`."""
    import mitsuba as mi

    ball = trimesh.creation.icosphere(subdivisions=2)
    for form in ("ply", "obj"):
        ball.export(folder / f"ball.{form}")
    content = serialized([{"vertices": np.asarray(ball.vertices), "faces": np.asarray(ball.faces)}])
    (folder / "ball.serialized").write_bytes(content)
    points = [(x, x * x - 0.5, 0.3 * x, 0.2) for x in (-1, -0.5, 0, 0.5, 1, 1.5)]
    (folder / "curve.txt").write_text("".join(f"{x} {y} {z} {r}\n" for x, y, z, r in points))
    distance = np.linalg.norm(np.indices((16, 16, 16)).T / 15 - 0.5, axis=-1) - 0.4
    mi.VolumeGrid(distance[..., None].astype(np.float32)).write(str(folder / "ball.vol"))


def test_every_shape_of_mitsuba_is_a_relic_here(renderer):
    import mitsuba as mi

    plugins = [path.stem for path in (Path(mi.__file__).parent / "plugins").glob("*.*")]
    kind = mi.PluginManager.instance().plugin_type
    shapes = {name for name in plugins if kind(name) == mi.ObjectType.Shape}
    assert shapes == {*RELICS, *SPLATS, *REFUSED}


#: In the fast tier: shapes next to each other in one scene, each in pixels of its own.
ROWS = {
    "curves and quadrics": ("bsplinecurve", "linearcurve", "cylinder", "disk", "sphere"),
    "meshes and groups": ("cube", "merge", "instance", "sdfgrid", "rectangle"),
}


def in_a_row(plugins: tuple[str, ...]) -> str:
    """Relics of some plugins, four units apart."""
    texts = []
    for place, plugin in enumerate(plugins):
        move = f'<translate x="{4 * place}"/></transform>'
        texts.append(RELICS[plugin].replace("</transform>", move))
    return "".join(texts)


def slow(names: Iterable[str]) -> list[Any]:
    return [pytest.param(name, marks=pytest.mark.slow) for name in names]


@pytest.mark.parametrize("plugin", [*ROWS, "ellipsoids", *slow(RELICS), *slow(SPLATS[1:])])
def test_black_pixels_of_every_shape_change_nothing(plugin, open_fitted, tmp_path):
    from inim.render.ground_truth import capture_parts, pickup, true_view

    display, eye = small_display(pixels=12), Viewpoint("eye", 20, -15, 400)
    if plugin in SPLATS:
        text = splat_scene(tmp_path, random_splats(60, 1), plugin)
    else:
        write_relics(tmp_path)
        text = scene_text(in_a_row(ROWS[plugin]) if plugin in ROWS else RELICS[plugin])
    fitted = open_fitted(text, display)
    images = []
    for skip in (True, False):
        eia = pickup(fitted, display, spp=4, seed=1, skip=skip)
        view, relic = true_view(fitted, display, eye, pixels_per_lens=8, spp=6, seed=1, skip=skip)
        first, *_, last = capture_parts(
            fitted, display, pixels_per_pitch=9, spp=8, seed=2, skip=skip
        )
        pictures = (first.color, last.color, first.depth_mm, first.covered)
        images.append((eia.first, eia.second, view.first, view.second, relic, *pictures))
    assert images[0][0].max() > 0.1 and images[0][4].mean() > 0.01
    assert all(np.array_equal(a, b) for a, b in zip(*images, strict=True))


@pytest.mark.parametrize("plugin", REFUSED)
def test_shapes_that_are_not_read_are_refused(plugin, open_fitted, tmp_path):
    write_relics(tmp_path)
    with pytest.raises(FileError, match=r"scene\.xml: the renderer refuses it|export it as PLY"):
        open_fitted(scene_text(REFUSED[plugin]), small_display())
