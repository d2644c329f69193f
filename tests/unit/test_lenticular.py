"""Slanted lenticulars: views by the vendor's formula, rays by geometry, and calibration files.

The formula is computed here on its own, in float64 and in rational numbers.
"""

import json
import math
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from inim.apps.export.native import subpixel_views
from inim.cli.main import main
from inim.display import DISPLAYS, Display, Viewpoint
from inim.display.lens import trace_to_panel
from inim.display.looking_glass import LookingGlass, parse_calibration
from inim.display.pixels import SUBPIXELS, PixelOffset, pixel_rays, ray_starts
from inim.display.viewpoint import check_viewpoint, parse_viewpoints, zone_eyes
from inim.generators import find_sources, generate
from inim.image.rgbd import RGBD
from inim.render.rays import pickup_rays
from inim.render.reconstruct import reconstruct
from inim.render.scene_files.file import choose_display, display_of, read_scene_file
from inim.system.errors import DisplayError, FileError, UsageError, ViewpointError

ROOT = Path(__file__).parents[2]

_CELLS = ((-0.3100000023841858, 0.25, 0.2800000011920929, 0.25, 0.0, -0.25),
          (-0.3100000023841858, -0.25, 0.2800000011920929, -0.25, 0.0, 0.25))  # fmt: skip
_NAMES = [f"{colour}Offset{axis}" for colour in "RGB" for axis in "XY"]


def visual(pitch, slope, center, cone, dpi, width, height, **others):
    """Content of a calibration file; cells are listed as six numbers."""
    numbers = {"pitch": pitch, "slope": slope, "center": center, "viewCone": cone, "DPI": dpi,
               "screenW": width, "screenH": height, "invView": 1, "flipImageX": 0}  # fmt: skip
    cells = [dict(zip(_NAMES, cell, strict=True)) for cell in others.pop("cells", ())]
    numbers |= others
    document = {"configVersion": "3.0" if cells else "1.0", "serial": "LKG-TEST-00000"}
    document |= {name: {"value": value} for name, value in numbers.items()}
    return document | ({"subpixelCells": cells} if cells else {})


#: Published calibrations: holoplay.js and its driverless patch (8.9 inches), a comment in the CGV
#: framework (15.6 inches), tests of other programs (Portrait; third generation, 16 inches).
PUBLISHED = {
    "8.9": visual(
        47.56401443481445, -5.480000019073486, 0.374184787273407, 40.0, 338.0, 2560, 1600
    ),
    "8.9, right": visual(
        49.825218200683597, 5.2160325050354, -0.23396748304367066, 40.0, 338.0, 2560, 1600
    ),
    "15.6": visual(
        50.0693473815918, -7.521984100341797, 0.07635253667831421, 40.0, 283.0, 3840, 2160
    ),
    "portrait": visual(
        52.58790040712976, -7.161397095759771, 0.7432299004945404, 40.0, 324.0, 1536, 2048
    ),
    "16": visual(
        44.75058319896644, -6.874565686767793, 0.16935753461833172, 50.0, 283.0, 3840, 2160,
        CellPatternMode=2.0, cells=_CELLS,
    ),
    "flipped": visual(50.0, -7.5, 0.1, 40.0, 283.0, 640, 360, flipImageX=1.0),
}  # fmt: skip
#: Small panels of the same optics, for everything else.
STRIPES = visual(50.07, -7.52, 0.076, 40.0, 283.0, 192, 108)
THIRD = visual(44.75, -6.87, 0.17, 50.0, 283.0, 192, 108, CellPatternMode=2.0, cells=_CELLS)


def display_from(document, **changes):
    calibration = parse_calibration(json.dumps(document).encode(), "visual.json")
    return calibration.display(**changes)


def formula(document, row, column):
    """View of each sub-pixel of panel pixels, (..., 3), by the vendor's formula."""
    value = {name: entry["value"] for name, entry in document.items() if isinstance(entry, dict)}
    width, height = value["screenW"], value["screenH"]
    pitch = value["pitch"] * width / value["DPI"] * math.cos(math.atan(1 / value["slope"]))
    tilt = height / (width * value["slope"]) * (-1 if value["flipImageX"] else 1)
    up = height - 1 - row
    x, y = (column + 0.5) / width, (up + 0.5) / height
    cells, views = document.get("subpixelCells", []), []
    for c, colour in enumerate("RGB"):
        if cells:
            kind = column % 2  # mode 2
            dx = np.array([cell[f"{colour}OffsetX"] for cell in cells])[kind]
            dy = np.array([cell[f"{colour}OffsetY"] for cell in cells])[kind]
            phase = ((x + dx / width) + (y + dy / height) * tilt) * pitch - value["center"]
        else:
            phase = (x + c / (3 * width) + y * tilt) * pitch - value["center"]
        views.append(1 - (phase - np.floor(phase)))
    return np.stack(views, axis=-1)


def tiles(views, count):
    return np.minimum((views * count).astype(int), count - 1)


@pytest.mark.parametrize("name", PUBLISHED)
def test_no_subpixel_of_some_rows_has_another_view_than_by_the_formula(name):
    document = PUBLISHED[name]
    display = display_from(document)
    rows, columns = display.eia_shape
    for first in np.linspace(0, rows - 4, 12).astype(int):
        views = subpixel_views(display, slice(first, first + 4))
        expected = formula(document, np.arange(first, first + 4)[:, None], np.arange(columns))
        for count in (45, 48, 100):
            assert np.count_nonzero(tiles(views, count) != tiles(expected, count)) == 0


def test_views_agree_with_rational_numbers_except_for_ties():
    """Every phase is rational: with slope -24/7, cos(atan(1/slope)) is 24/25."""
    document = visual(40, -24 / 7, 0.25, 40.0, 254, 200, 120)
    display = display_from(document)
    views, count = subpixel_views(display, slice(0, 120)), 45
    pitch, tilt = (
        Fraction(40) * 200 / 254 * Fraction(24, 25),
        Fraction(120) / (200 * Fraction(-24, 7)),
    )
    ties = 0
    for row in range(0, 120, 7):
        for column in range(0, 200, 3):
            for c in range(3):
                x = Fraction(2 * column + 1, 400) + Fraction(c, 600)
                phase = (x + Fraction(2 * (119 - row) + 1, 240) * tilt) * pitch - Fraction(1, 4)
                exact = (1 - (phase - math.floor(phase))) * count
                if abs(exact - round(exact)) < Fraction(1, 10**9):
                    ties += 1
                    assert abs(views[row, column, c] * count - exact) % count < 1e-9
                else:
                    assert int(views[row, column, c] * count) == math.floor(exact)
    assert ties < 100


@pytest.mark.parametrize("document", [STRIPES, THIRD], ids=["stripes", "cells"])
def test_rays_leave_through_an_axis_and_meet_the_eye_of_their_view(document):
    display = display_from(document, viewing_distance_mm=600.0)
    assert display.layout.design_distance_mm == pytest.approx(600)
    c, s = (
        math.cos(math.radians(display.rotation_deg)),
        math.sin(math.radians(display.rotation_deg)),
    )
    views = subpixel_views(display, slice(0, 108))
    for channel, subpixel in enumerate(SUBPIXELS[display.subpixels]):
        offset = PixelOffset(Fraction(0), subpixel.right, subpixel.channel)
        rays, starts = (f(display, slice(0, 108), offset) for f in (pixel_rays, ray_starts))
        assert np.allclose(rays.x0 - rays.slope_x * display.gap_mm, starts[0], atol=1e-12)
        assert np.allclose(rays.y0 - rays.slope_y * display.gap_mm, starts[1], atol=1e-12)
        axes = (c * (rays.x0 - display.shift_x_mm) + s * rays.y0) / display.pitch_mm
        assert np.abs(axes - np.round(axes)).max() < 1e-9
        x, y = rays.x0 + 600 * rays.slope_x, rays.y0 + 600 * rays.slope_y
        assert np.abs(y).max() < 1e-9
        zone = display.elemental_image_pitch_mm * 600 / display.gap_mm
        assert np.allclose(
            c * (x - display.shift_x_mm), (views[..., channel] - 0.5) * zone, atol=1e-6
        )


@pytest.mark.parametrize("document", [STRIPES, THIRD], ids=["stripes", "cells"])
def test_pickup_rays_start_all_over_a_subpixel_and_meet_the_same_eye(document, renderer):
    import drjit as dr
    import mitsuba as mi

    from inim.render.trace import FilmCamera

    display = display_from(document)
    lane, rows = dr.arange(mi.UInt32, 108 * 192), slice(0, 108)
    pixel = mi.Point2u(lane % 192, lane // 192)
    for subpixel in SUBPIXELS[display.subpixels]:
        camera = FilmCamera(pickup_rays(display, 5.0, subpixel), np.eye(4))
        centre = pixel_rays(
            display, rows, PixelOffset(Fraction(0), subpixel.right, subpixel.channel)
        )
        for right, down in ((Fraction(0), Fraction(0)), (Fraction(1, 10), Fraction(-1, 5))):
            ray = camera.rays(pixel, mi.Point2f(0.5 + float(right), 0.5 + float(down)))
            origin, run = (np.stack([np.asarray(c, float) for c in v]) for v in (ray.o, ray.d))
            offset = PixelOffset(
                down * subpixel.height,
                subpixel.right + right * subpixel.width,
                subpixel.channel,
            )
            expected = pixel_rays(display, rows, offset)
            same = expected.lens == centre.lens
            assert same.mean() > 0.9
            for z in (0.0, -display.gap_mm, display.layout.design_distance_mm):
                way = (z - origin[2]) / run[2]
                for k, (start, slope) in enumerate(
                    ((expected.x0, expected.slope_x), (expected.y0, expected.slope_y))
                ):
                    landing = (origin[k] + way * run[k]).reshape(same.shape)
                    off = np.abs(landing - (start + slope * z))[same].max()
                    assert off < (3e-5 if abs(z) < 1 else 3e-3)  # float32 over the way


def test_the_viewing_zone_has_no_limit_along_the_axes():
    display = display_from(STRIPES)
    distance = display.layout.design_distance_mm
    limit, along = display.flip_limit_mm(distance)
    assert limit == pytest.approx(display.elemental_image_pitch_mm * distance / 2 / display.gap_mm)
    assert along == math.inf
    eyes = parse_viewpoints("centre,left,right,up,down", display)
    assert all(map(math.isfinite, sum((eye.position_mm for eye in eyes), ())))
    assert eyes[0].position_mm == (0.0, 0.0, pytest.approx(distance))
    assert [eye.y_mm for eye in zone_eyes(display, 5)] == [0.0] * 5
    s = math.sin(math.radians(display.rotation_deg))
    high = Viewpoint("high", 0.0, 0.9 * limit / abs(s), distance)
    check_viewpoint(high, display)
    with pytest.raises(ViewpointError, match="outside the viewing zone"):
        check_viewpoint(Viewpoint("higher", 0.0, 1.1 * limit / abs(s), distance), display)


@pytest.mark.parametrize("document", [STRIPES, THIRD], ids=["stripes", "cells"])
def test_a_display_is_written_as_a_file_with_the_same_views(document, tmp_path):
    display = display_from(document)
    for name in ("visual.json", "display.xml"):
        display.save(tmp_path / name)
        again = display_of(tmp_path / name)
        views = [subpixel_views(d, slice(0, 108)) for d in (display, again)]
        assert (tiles(views[0], 1000) == tiles(views[1], 1000)).all()
        assert again.gap_mm == pytest.approx(display.gap_mm, rel=1e-12)
    values = LookingGlass.of(display)
    assert values.center == pytest.approx(document["center"]["value"], abs=1e-9)
    with pytest.raises(DisplayError, match=r"for slanted lenticulars; save it as \.xml"):
        DISPLAYS["nominal"].save(tmp_path / "nominal.json")


def test_a_lenticular_has_defaults_of_its_own_that_a_scene_does_not_override(tmp_path):
    path, file = tmp_path / "visual.json", read_scene_file(ROOT / "scenes" / "amphora.xml")
    path.write_text(json.dumps(STRIPES))
    _, settings = choose_display(path, scene=file)
    assert (settings.algorithms, settings.viewpoints) == ("template", "centre,left,right")
    assert settings.view_pixels_per_lens == 1
    changes = {"inim.algorithms": "gu2020", "inim.view_pixels_per_lens": "4"}
    _, settings = choose_display(path, changes, scene=read_scene_file(file.path, changes))
    assert (settings.algorithms, settings.view_pixels_per_lens) == ("gu2020", 4)
    _, settings = choose_display(None, scene=file)
    assert settings.algorithms == "wang2024,template"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (b"{", "not readable as JSON"),
        (b"[" * 100_000, "not readable as JSON"),
        (b"[1]", "not readable as JSON"),
        ({"pitch": None}, "no number 'pitch'"),
        ({"pitch": {"value": "50"}}, "no number 'pitch'"),
        ({"pitch": {"value": math.nan}}, "pitch = nan: must be from 1 to 1000"),
        ({"slope": {"value": 0.5}}, "slope = 0.5: must be at least 1"),
        ({"screenW": {"value": 0.5}}, "screenW = 0.5: must be from 1"),
        ({"screenW": {"value": 9.5}}, "screenW = 9.5, screenH = "),
        ({"flipSubp": {"value": 1}}, "flipSubp = 1 is not supported"),
        ({"CellPatternMode": 7}, "CellPatternMode = 7: must be 0 to 4"),
        ({"subpixelCells": 3}, "subpixelCells is no list"),
        ({"subpixelCells": [{"ROffsetX": 0.1}]}, "no number 'ROffsetY'"),
        ({"subpixelCells": [dict.fromkeys(_NAMES, 9)]}, "at most 1"),
    ],
)
def test_a_damaged_file_is_refused_in_one_line(change, message, tmp_path, capsys):
    text = change if isinstance(change, bytes) else json.dumps(STRIPES | change).encode()
    path = tmp_path / "visual.json"
    path.write_bytes(text)
    with pytest.raises((FileError, DisplayError), match=message.replace("[", r"\[")) as error:
        display_of(path)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)
    assert main(["generate", "picture.exr", "--display", str(path)]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"lens_rows": 2}, "cylinders have no rows"),
        ({"pitch_y_mm": 5.0}, "cylinders have no rows"),
        ({"panel_rows": None}, "set panel_columns and panel_rows"),
        ({"rotation_deg": 60.0}, "slanted by at most 45"),
        ({"subpixel_cells": _CELLS}, "'cells' needs subpixel_cells"),
        ({"subpixel_cells": "1 2"}, "write six numbers"),
    ],
)
def test_impossible_lenticulars_are_refused(changes, message):
    with pytest.raises(DisplayError, match=message):
        display_from(STRIPES).replace(**changes)


def refracted(d, normal, ratio):
    """Direction behind a face by Snell's law, from angles, and Fresnel's transmittance."""
    cos_in = -d @ normal
    sin_out = ratio * math.sqrt(1 - cos_in**2)
    angle_in, angle_out = math.acos(cos_in), math.asin(sin_out)
    across = d + cos_in * normal
    across = across / np.linalg.norm(across) if np.linalg.norm(across) > 0 else across
    if angle_in == 0:
        return d, 4 * ratio / (1 + ratio) ** 2
    s = math.sin(angle_in - angle_out) ** 2 / math.sin(angle_in + angle_out) ** 2
    p = math.tan(angle_in - angle_out) ** 2 / math.tan(angle_in + angle_out) ** 2
    return sin_out * across - math.cos(angle_out) * normal, 1 - (s + p) / 2


def traced_cylinder(display, x, y, sx, sy):
    """Panel point and transmittance of a ray through the plane z = 0 at (x, y), array frame.

    The curved side faces the viewer, with its vertex line at z = 0; z counts towards the panel.
    """
    n, pitch = display.refractive_index, display.pitch_mm
    radius, thickness = display.focal_length_mm * (n - 1), display.pitch_mm
    axis = round(x / pitch) * pitch
    d = np.array([sx, sy, 1.0]) / math.sqrt(sx**2 + sy**2 + 1)
    # (x - axis + t dx)^2 + (t dz - R)^2 = R^2, the nearer solution.
    roots = np.roots([
        d[0] ** 2 + d[2] ** 2, 2 * ((x - axis) * d[0] - radius * d[2]), (x - axis) ** 2
    ])  # fmt: skip
    point = np.array([x - axis, y, 0.0]) + min(roots, key=abs) * d
    normal = np.array([point[0], 0.0, point[2] - radius]) / radius
    d, front = refracted(d, normal, 1 / n)
    point = point + (thickness - point[2]) / d[2] * d
    d, back = refracted(d, np.array([0.0, 0.0, -1.0]), n)
    point = point + (display.gap_mm - thickness / n) / d[2] * d
    return axis + point[0], point[1], front * back


def test_a_thick_cylinder_agrees_with_an_own_exact_trace():
    display = display_from(STRIPES).replace(rotation_deg=0.0, shift_x_mm=0.0)
    random = np.random.default_rng(5)
    # Not so near a cell's border that the relief of the next cylinder is met first.
    within = random.uniform(-0.3, 0.3, 300)
    x = (random.integers(-9, 9, 300) + within) * display.pitch_mm
    y, sx, sy = random.uniform(-3, 3, 300), *random.uniform(-0.3, 0.3, (2, 300))
    panel_x, panel_y, weight = trace_to_panel(display, "thick", x, y, sx, sy)
    for k in range(300):
        expected = traced_cylinder(display, x[k], y[k], sx[k], sy[k])
        assert panel_x[k] == pytest.approx(expected[0], abs=1e-9)
        assert panel_y[k] == pytest.approx(expected[1], abs=1e-9)
        assert weight[k] == pytest.approx(expected[2], abs=1e-9)


@pytest.mark.parametrize(
    "changes",
    [{"conic": -0.5}, {"asphere_a4": 0.02}, {"curved_side": "panel"}, {"fill_factor": 0.9}],
)
def test_a_thick_cylinder_is_the_round_lens_for_rays_in_the_plane_across_its_axis(changes):
    slow = {"focal_length_mm": 2.0, "gap_mm": 2.0}  # so that the round lens has its corners, too
    straight = {"rotation_deg": 0.0, "shift_x_mm": 0.0}
    cylinder = display_from(STRIPES).replace(**straight, **slow, **changes)
    lens = cylinder.replace(lattice="square", lens_columns=41, lens_rows=41, pitch_y_mm=None)
    x, sx = np.linspace(-2, 2, 401), np.linspace(-0.2, 0.2, 401)
    traces = [trace_to_panel(d, "thick", x, 0.0, sx, 0.0) for d in (cylinder, lens)]
    assert np.allclose(traces[0][2], traces[1][2], atol=1e-12)
    lit = traces[0][2] > 0
    assert lit.mean() > 0.5
    assert np.allclose(traces[0][0][lit], traces[1][0][lit], atol=1e-12)
    # A cylinder is the same at all heights.
    moved = trace_to_panel(cylinder, "thick", x, 7.3, sx, 0.1)
    again = trace_to_panel(cylinder, "thick", x, -1.1, sx, 0.1)
    assert np.allclose(moved[0], again[0], atol=1e-12)
    assert np.allclose(moved[1] - 7.3, again[1] + 1.1, atol=1e-12)


def numbered_quilt(columns, rows, height=9, width=16):
    """Quilt of one grey per view, the view's number, from the lower left on."""
    numbers = np.arange(columns * rows).reshape(rows, columns)[::-1]
    grey = np.repeat(np.repeat(numbers, height, axis=0), width, axis=1)
    return np.repeat(grey[..., None], 3, axis=2).astype(np.uint8)


@pytest.mark.parametrize("document", [STRIPES, THIRD], ids=["stripes", "cells"])
def test_a_native_picture_takes_each_subpixel_from_its_view_of_a_quilt(document, tmp_path, capsys):
    path, quilt = tmp_path / "visual.json", tmp_path / "mine_qs8x6a1.7777.png"
    path.write_text(json.dumps(document))
    Image.fromarray(numbered_quilt(8, 6)).save(quilt)
    out = tmp_path / "native.png"
    assert main(["export", str(quilt), "--native", str(out), "--display", str(path)]) == 0
    expected = tiles(formula(document, np.arange(108)[:, None], np.arange(192)), 48)
    with Image.open(out) as picture:
        assert np.array_equal(np.asarray(picture), expected)
    plain = tmp_path / "plain.png"
    quilt.rename(plain)
    command = ["export", str(plain), "--native", str(out), "--display", str(path)]
    assert main(command) == 2
    assert "give --tiles COLSxROWS" in capsys.readouterr().err
    assert main([*command, "--tiles", "999x1"]) == 2
    assert "fewer than 999 x 1 tiles; correct --tiles" in capsys.readouterr().err
    assert main([*command, "--tiles", "8x6"]) == 0
    assert main([*command, "--tiles", "8x6", "--aspect", "0.8889"]) == 0
    with Image.open(out) as picture:
        bars = np.asarray(picture)
    assert not bars[:, :47].any()
    assert np.array_equal(bars[:, 49:143], expected[:, 49:143])
    assert main([*command, "--tiles", "8x6", "--pdf", "a.pdf"]) == 2
    with pytest.raises(UsageError, match="native pictures of quilts are for lenticular"):
        subpixel_views(DISPLAYS["nominal"], slice(0, 1))


@pytest.mark.parametrize("document", [STRIPES, THIRD], ids=["stripes", "cells"])
@pytest.mark.parametrize("depth_mm", [-4.0, 4.0, 8.0])
def test_forward_mapping_through_cylinders_reaches_the_pixels_whose_rays_meet_a_plane(
    document, depth_mm
):
    display = display_from(document)
    shape, pixel = display.capture_shape(12), display.capture_pixel_mm(12)
    depth = np.full(shape, depth_mm, np.float32)
    rgbd = RGBD(np.zeros((*shape, 3), np.float32), depth, np.ones(shape, bool), pixel)
    mapped = find_sources(rgbd, display, "li2012")
    # A point of the picture that reaches a pixel is the nearest to its ray.
    assert np.array_equal(mapped, find_sources(rgbd, display, "template", columns="solid"))
    # In front of the plane, the nearer half of the picture hides it.
    depth[:, : shape[1] // 2] = depth_mm + 1
    nearer = find_sources(replace(rgbd, depth_mm=depth), display, "li2012")
    changed = nearer != mapped
    is_near = nearer % shape[1] < shape[1] // 2
    assert (is_near | ~changed).mean() > 0.99
    assert is_near[changed].any()


@pytest.mark.parametrize("slant_deg", [0.0, 12.0])
@pytest.mark.parametrize("depth_mm", [-4.0, 0.5, 3.0])
def test_a_pixel_under_a_cylinder_averages_over_its_height(depth_mm, slant_deg):
    """Light of a pixel is the mean of those of a panel with 7 x 7 times as many pixels."""
    display, fine = (
        Display(
            pitch_mm=1.0, gap_mm=3.0, focal_length_mm=2.9, elemental_pitch_mm=1.01,
            lattice="lenticular", rotation_deg=slant_deg, lens_columns=20, lens_rows=1,
            depth_min_mm=-8.0, depth_max_mm=8.0,
            pixel_pitch_mm=0.2 / n, panel_columns=100 * n, panel_rows=60 * n,
        )
        for n in (1, 7)
    )  # fmt: skip
    pixel_mm, shape = 0.05, (240, 400)
    height_mm = (np.arange(shape[0])[:, None, None] + 0.5) * pixel_mm
    light = 0.5 + 0.4 * np.sin(4 * math.pi * height_mm)
    color = np.broadcast_to(light, (*shape, 3)).astype(np.float32)
    rgbd = RGBD(color, np.full(shape, depth_mm, np.float32), np.ones(shape, bool), pixel_mm)
    averaged = generate(rgbd, display, "template", samples=1, colour="averaged")
    points = generate(rgbd, fine, "template", samples=1, colour="nearest")
    expected = points.reshape(60, 7, 100, 7, 3).mean(axis=(1, 3))
    inside = np.s_[8:-8, 15:-15]
    # The pixel's height takes a quarter of the contrast of these stripes.
    assert averaged[inside].std() == pytest.approx(expected[inside].std(), rel=0.06)


@pytest.mark.parametrize("model", ["pinhole", "thin", "thick"])
@pytest.mark.parametrize("document", [STRIPES, THIRD], ids=["stripes", "cells"])
def test_an_eye_sees_the_subpixels_of_its_view(document, model, renderer):
    """A panel shows views as brightness; an eye in the middle of the zone sees 1/2 everywhere."""
    display = display_from(document)
    coded = subpixel_views(display, slice(0, 108)).astype(np.float32)
    distance = display.layout.design_distance_mm
    zone = display.flip_limit_mm(distance)[0]
    c = math.cos(math.radians(display.rotation_deg))
    # Off the axis, thick lenses of so wide a cone spread light to the next views.
    for share in (0.0, 0.5) if model != "thick" else (0.0,):
        eye = Viewpoint("eye", display.shift_x_mm + share * zone / c, 0.0, distance)
        view, light = (
            reconstruct(eia, display, eye, model, spp=64) for eia in (coded, np.ones_like(coded))
        )
        inside = np.s_[8:-8, 8:-8]
        mean = view[inside].mean(axis=(0, 1)) / light[inside].mean(axis=(0, 1))
        assert np.abs(mean - (0.5 + share / 2)).max() < 0.02
