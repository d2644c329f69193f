"""The layers of closed-form scenes: fronts, backs, coverage, colours."""

import re

import numpy as np
import pytest

from inim.generators import NO_LENS, find_sources
from inim.image.files.image import read_exr, read_rgbd
from inim.image.rgbd import RGBD, LayeredRGBD
from inim.pipeline.plan import make_plan
from inim.pipeline.request import Request
from tests.conftest import scene_text, small_display, sphere, square
from tests.system.conftest import without_page

pytestmark = pytest.mark.usefixtures("renderer")

DISPLAY = small_display()
PER_PITCH = 5
PIXEL_MM = DISPLAY.pitch_mm / PER_PITCH
RANGE_MM = DISPLAY.depth_range_mm[1] - DISPLAY.depth_range_mm[0]
RED, GREEN = "0.8,0.05,0.05", "0.05,0.8,0.05"
# Lit from all around: nothing is black, and two bounces mix no colours.
AROUND = """<integrator type="path"><integer name="max_depth" value="2"/></integrator>
<emitter type="constant"/>"""
FLIPPED = '<boolean name="flip_normals" value="true"/>'


def cube(centre, half, rgb="0.8", more=""):
    """A box of half sizes `half`."""
    (x, y, z), (a, b, c) = centre, half
    return f"""<shape type="cube">{more}<transform name="to_world">
        <scale x="{a}" y="{b}" z="{c}"/><translate x="{x}" y="{y}" z="{z}"/></transform>
        <bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="{rgb}"/></bsdf>
        </bsdf></shape>"""


def around(*shapes):
    return f'<scene version="3.0.0">{AROUND}{"".join(shapes)}</scene>'


def peeled(open_fitted, text):
    """The scene and its layers."""
    from inim.render.depth_peeling import peel

    fitted = open_fitted(text, DISPLAY)
    layers = peel(fitted, DISPLAY, pixels_per_pitch=PER_PITCH, hidden=True)
    assert not (layers.covered[1:] & ~layers.covered[:-1]).any(), "no layer without one before it"
    # Behind each other, and each behind its own front; -inf where there is none.
    assert (layers.back_mm <= layers.front_mm).all()
    assert (layers.front_mm[1:] <= layers.back_mm[:-1])[layers.covered[1:]].all()
    return fitted, layers


def places(fitted, layers):
    """World x, y of the pixels' centres, and the display's z of a world z."""
    rows, columns = layers.front_mm.shape[1:]
    back = fitted.fit.world_from_display
    x = (np.arange(columns) + 0.5 - columns / 2) * PIXEL_MM * back[0, 0] + back[0, 3]
    y = (rows / 2 - np.arange(rows) - 0.5) * PIXEL_MM * back[1, 1] + back[1, 3]
    forward = fitted.fit.display_from_world
    return x[None, :], y[:, None], lambda z: forward[2, 2] * z + forward[2, 3]


def chord(x, y, centre, radius):
    """World z of a sphere's front and back, nan where there is none."""
    inside = radius**2 - (x - centre[0]) ** 2 - (y - centre[1]) ** 2
    with np.errstate(invalid="ignore"):
        half = np.sqrt(inside)
    return centre[2] + half, centre[2] - half


def close(layers, expected, mask):
    assert mask.sum() > 100
    assert np.abs(layers - expected)[mask].max() < 1e-4 * RANGE_MM


OUTER = ((0, 0, 0), 5.0)
BEHIND, INSIDE = ((0.7, -0.4, -14), 3.0), ((0.5, 0, 1), 2.0)


@pytest.mark.parametrize(("other", "solids"), [(BEHIND, [OUTER, BEHIND]), (INSIDE, [OUTER])])
def test_spheres_in_a_row_are_two_layers_and_one_inside_another_is_none(open_fitted, other, solids):
    fitted, layers = peeled(open_fitted, scene_text(sphere(*OUTER), sphere(*other)))
    assert len(layers.front_mm) == len(solids) and layers.cut_share == 0
    x, y, depth = places(fitted, layers)
    for layer, (centre, radius) in enumerate(solids):
        front, back = chord(x, y, centre, radius)
        assert (layers.covered[layer] == np.isfinite(front)).mean() > 0.999
        clear = layers.covered[layer] & (front - back > radius / 2)  # the rim is ill-conditioned
        close(layers.front_mm[layer], depth(front), clear)
        close(layers.back_mm[layer], depth(back), clear)


def test_a_box_before_a_wall_hides_a_part_of_it(open_fitted):
    fitted, layers = peeled(
        open_fitted, scene_text(cube((0, 0, 0), (2.02, 3.03, 1)), cube((0, 0, -6), (5, 5, 0.5)))
    )
    x, y, depth = places(fitted, layers)
    box = (np.abs(x) < 2.02) & (np.abs(y) < 3.03)
    wall = (np.abs(x) < 5) & (np.abs(y) < 5)
    assert np.array_equal(layers.covered, [wall, box])
    close(layers.front_mm[0], np.where(box, depth(1), depth(-5.5)), wall)
    close(layers.back_mm[0], np.where(box, depth(-1), depth(-6.5)), wall)
    close(layers.front_mm[1], depth(-5.5), box)
    close(layers.back_mm[1], depth(-6.5), box)


@pytest.mark.parametrize("more", ["", FLIPPED], ids=["front", "back"])
def test_a_sheet_is_as_thick_as_its_slope_and_shows_no_gaps(open_fitted, more):
    """A square whose world z is 0.8 x."""
    sheet = f"""<shape type="rectangle">{more}<transform name="to_world"><scale value="5"/>
        <rotate y="1" angle="{-np.degrees(np.arctan(0.8))}"/></transform></shape>"""
    fitted, layers = peeled(open_fitted, scene_text(sheet))
    assert len(layers.front_mm) == 1
    x, y, depth = places(fitted, layers)
    own = layers.covered[0]
    reach = 5 * np.cos(np.arctan(0.8))
    assert (own == ((np.abs(y) < 5) & (np.abs(x) < reach))).mean() > 0.995
    close(layers.front_mm[0], depth(0.8 * x) + 0 * y, own)
    slope = 0.8 * fitted.fit.scale_z / fitted.fit.scale_xy
    beside = own & np.roll(own, 1, axis=1)  # the lower end has nothing to reach for
    close(layers.back_mm[0], depth(0.8 * x) + 0 * y - PIXEL_MM * slope, beside)
    # Rays of the display that the whole column behind the sheet stops, the sheet stops too.
    thin, whole = (
        sources(layers, layers.back_mm),
        sources(layers, np.full_like(layers.back_mm, -np.inf)),
    )
    edge = 8
    inner = own.copy()
    for step in range(1, edge):
        for down, right in ((step, 0), (-step, 0), (0, step), (0, -step)):
            inner &= np.roll(own, (down, right), (0, 1))
    visible = np.where(whole >= 0, inner.reshape(-1)[np.maximum(whole, 0)], False)
    assert visible.sum() > 1000
    assert np.array_equal(thin[visible], whole[visible])


def sources(layers, back_mm):
    front = np.where(layers.covered, layers.front_mm, 0)[0]
    color = np.zeros((*front.shape, 3))
    rgbd = LayeredRGBD(color, front, layers.covered[0], layers.pixel_mm, back_mm[0])
    return find_sources(rgbd, DISPLAY, "layered", samples=1)


def test_columns_that_reach_the_back_are_the_template_s(open_fitted):
    _, layers = peeled(open_fitted, scene_text(sphere((0, 0, 0), 5.0)))
    front = np.where(layers.covered, layers.front_mm, 0)[0]
    plain = RGBD(np.zeros((*front.shape, 3)), front, layers.covered[0], layers.pixel_mm)
    expected = find_sources(plain, DISPLAY, "template:columns=solid")
    assert np.array_equal(sources(layers, np.full_like(layers.back_mm, -np.inf)), expected)
    solid = sources(layers, layers.back_mm)
    assert (solid != expected).any(), "rays pass behind the sphere"
    shows = (solid != expected) & (expected != NO_LENS)
    assert (solid == expected)[~shows & (solid >= 0)].all()


def colours(open_fitted, text, spp=16, seed=1):
    from inim.render.ground_truth import capture_layers

    fitted, layers = peeled(open_fitted, text)
    return capture_layers(fitted, layers, spp=spp, seed=seed), fitted, layers


def is_side(layers, number):
    """Mask of the pixels whose layer of this number is a piece of a side."""
    sides, mask = layers.sides, np.zeros(layers.front_mm.shape[1:], bool)
    own = sides.solid + 1 + sides.order == number
    mask[sides.row[own], sides.column[own]] = True
    return mask


def test_no_colour_mixes_surfaces(open_fitted):
    """Red before green: every pixel of either solid is the one or the other, sides apart."""
    from inim.render.ground_truth import capture

    text = around(sphere((0.3, 0.2, 6), 3.0, RED), square((0, 0, 0), 5.5, GREEN))
    rgbd, fitted, layers = colours(open_fitted, text)
    reds = 0
    for number, layer in enumerate(rgbd.layers):
        solid = layer.covered & ~is_side(layers, number)
        red, green = layer.color[solid][:, 0], layer.color[solid][:, 1]
        assert (np.maximum(red, green) > 0).all()
        share = red / (red + green)
        pure = np.minimum(np.abs(share - 16 / 17), np.abs(share - 1 / 17))
        assert pure.max() < 1e-5
        reds += np.count_nonzero(share > 0.5)
    assert reds > 100
    plain = capture(fitted, DISPLAY, pixels_per_pitch=PER_PITCH, spp=16, seed=1)
    mixed = plain.color[..., 0] / np.maximum(plain.color.sum(axis=-1) - plain.color[..., 2], 1e-9)
    assert ((mixed > 0.2) & (mixed < 0.8)).any(), "the picture of one layer mixes them"
    assert np.array_equal(plain.depth_mm, rgbd.depth_mm)
    assert np.array_equal(plain.covered, rgbd.covered)


def test_a_hidden_surface_has_its_own_light(open_fitted):
    """Lit from the side, the wall behind a square is in the sun: rho / pi E cos 45."""
    sun = """<integrator type="path"><integer name="max_depth" value="2"/></integrator>
        <emitter type="directional"><vector name="direction" value="1,0,-1"/>
        <rgb name="irradiance" value="2.5"/></emitter>"""
    shapes = square((0, 0, 0), 6, GREEN), square((0, 0, 4), 1, RED)
    text = f'<scene version="3.0.0">{sun}{"".join(shapes)}</scene>'
    rgbd, fitted, layers = colours(open_fitted, text, spp=4)
    hidden = rgbd.layers[1]
    x, y, _ = places(fitted, layers)
    assert np.array_equal(hidden.covered, (np.abs(x) < 1) & (np.abs(y) < 1))
    light = 2.5 / np.pi * np.sqrt(0.5)
    assert np.abs(hidden.color[hidden.covered] - light * np.array([0.05, 0.8, 0.05])).max() < 1e-4
    assert (hidden.color[~hidden.covered] == 0).all()


def validated(folder, algorithms):
    """A small validation of a red ball before a green wall, and what it made."""
    from inim.pipeline.job import run

    scene = folder / "scene.xml"
    scene.write_text(around(sphere((0, 0, 6), 3.0, RED), square((0, 0, 0), 5.5, GREEN)))
    settings = {
        "lens_columns": 12, "lens_rows": 10, "pixel_pitch_mm": 0.125, "capture_spp": 8,
        "eia_spp": 8, "view_spp": 4, "reconstruction_spp": 4, "algorithms": algorithms,
        "viewpoints": "centre",
    }  # fmt: skip
    out = folder / "_".join(algorithms.split(","))
    out.mkdir()
    definitions = {f"inim.{key}": str(value) for key, value in settings.items()}
    with without_page():
        return run(make_plan(Request(scene, out, definitions=definitions)), out), out


def test_layers_are_captured_on_request_and_change_no_other_result(tmp_path):
    outcome, with_layers = validated(tmp_path, "layered,template")
    alone, without = validated(tmp_path, "template")
    eias = [read_exr(out / "eia" / "template.exr") for out in (with_layers, without)]
    assert np.array_equal(*eias)
    assert not (without / "layers.exr").exists()
    pictures = [read_rgbd(out / "rgbd.exr") for out in (with_layers, without)]
    assert not isinstance(pictures[0], LayeredRGBD)
    assert np.array_equal(pictures[0].color, pictures[1].color)
    rgbd = read_rgbd(with_layers / "layers.exr")
    assert isinstance(rgbd, LayeredRGBD) and len(rgbd.layers) > 2, "the wall, and the ball's side"
    assert "capture layers" in outcome.data.timings
    assert "capture layers" not in alone.data.timings
    rows = {c.name: c for c in outcome.data.verdict.checks}
    assert rows["RGB-D: layers"].value == len(rgbd.layers)
    _, behind = re.findall("[0-9.]+%", rows["RGB-D: layers"].detail)
    last = rgbd.layers[-1].covered.mean()
    assert 0 < last <= float(behind.rstrip("%")) / 100 < rgbd.covered.mean(), "the wall"
    psnr = {name: row.eia["psnr_db"] for name, row in outcome.data.algorithms.items()}
    assert psnr["layered"] > psnr["template"] + 3


def test_surfaces_without_a_ray_of_the_display_are_left_out_and_counted(open_fitted):
    """A small sphere in a box: closed all around, it is no layer. Before it, it is."""
    from inim.render.depth_peeling import peel

    inside = [cube((0, 0, 0), (5, 5, 0.4)), cube((0, 0, -9), (5, 5, 0.4))]
    walls = [cube((s * 4.8, 0, -4.5), (0.4, 5, 5)) for s in (-1, 1)]
    walls += [cube((0, s * 4.8, -4.5), (5, 0.4, 5)) for s in (-1, 1)]
    fitted = open_fitted(scene_text(*inside, *walls, sphere((0, 0, -5), 1.5)), DISPLAY)
    all_of_it = peel(fitted, DISPLAY, pixels_per_pitch=PER_PITCH, hidden=True)
    layers = peel(fitted, DISPLAY, pixels_per_pitch=PER_PITCH)
    assert len(all_of_it.front_mm) == 3 and all_of_it.hidden_share == 0
    assert len(layers.front_mm) == 1 and layers.hidden_share == 1
    assert np.array_equal(layers.front_mm[0], all_of_it.front_mm[0])
