"""Settings and scene files: what is read, what is refused, in which words."""

import pytest

from inim.display import DISPLAYS
from inim.display.settings import Settings
from inim.display.viewpoint import parse_viewpoints
from inim.generators.accuracy_limits import lenses_beside_panel
from inim.render.scene_files.file import read_scene_file
from inim.system.errors import SceneError
from tests.conftest import small_display


def scene(tmp_path, body, name="s.xml"):
    path = tmp_path / name
    path.write_text(f'<scene version="3.0.0">{body}</scene>', encoding="utf-8")
    return path


def test_only_parameters_that_the_scene_uses_reach_the_renderer(tmp_path):
    body = """<default name="inim.pitch_mm" value="2"/><default name="spp" value="4"/>
        <default name="inim.seed" value="1"/><integer name="a" value="$spp"/>
        <float name="b" value="$inim.pitch_mm"/>"""
    scene_file = read_scene_file(
        scene(tmp_path, body), {"spp": "8", "inim.pitch_mm": "3", "inim.seed": "5"}
    )
    assert scene_file.parameters == {"spp": "8", "inim.pitch_mm": "3"}


def test_a_changed_array_gets_a_panel_of_its_own_size():
    phone = Settings.parse({"inim.display": "phone"}, "s").make_display("s")
    assert phone.eia_shape == (1080, 2400)
    wider = Settings.parse(
        {"inim.display": "phone", "inim.lens_columns": "10", "inim.lens_rows": "10"}, "s"
    ).make_display("s")
    assert wider.eia_shape == (158, 158), "10 lenses of 15.72 pixels, covered"


def test_limits_go_to_the_algorithms_they_name():
    algorithms = ("template", "wang2024")
    parse = lambda text: Settings.parse({"inim.min_ssim_to_reference": text}, "s")  # noqa: E731
    assert parse("0.9").ssim_limits(algorithms, "s") == {"template": 0.9, "wang2024": 0.9}
    assert parse("template:0.9, wang2024:0.5").ssim_limits(algorithms, "s") == {
        "template": 0.9,
        "wang2024": 0.5,
    }
    assert parse("").ssim_limits(algorithms, "s") == {}
    for wrong in ("1.5", "high", "other:0.5"):
        with pytest.raises(SceneError):
            parse(wrong).ssim_limits(algorithms, "s")


def test_the_hash_follows_contents_not_names(tmp_path):
    body = '<default name="inim.seed" value="1"/>'
    digest = read_scene_file(scene(tmp_path, body, "a.xml")).sha256
    assert digest == read_scene_file(scene(tmp_path, body, "b.xml")).sha256
    assert digest != read_scene_file(scene(tmp_path, body + " ", "a.xml")).sha256
    mesh = '<shape type="ply"><string name="filename" value="m.ply"/></shape>'
    (tmp_path / "m.ply").write_bytes(b"1")
    first = read_scene_file(scene(tmp_path, mesh)).sha256
    (tmp_path / "m.ply").write_bytes(b"2")
    assert first != read_scene_file(scene(tmp_path, mesh)).sha256


DISPLAY = small_display(12, 10)


def test_named_viewpoints_are_inside_the_zone_and_apart():
    viewpoints = {v.name: v for v in parse_viewpoints("centre,left,right,up,down", DISPLAY)}
    assert viewpoints["left"].x_mm < -5 < 5 < viewpoints["right"].x_mm
    assert viewpoints["down"].y_mm < -5 < 5 < viewpoints["up"].y_mm
    assert viewpoints["left"].x_mm == -viewpoints["right"].x_mm


def test_lenses_are_counted_from_a_panel_that_is_given():
    parameters = {
        "inim.display": "phone", "inim.panel_columns": "2340", "inim.panel_rows": "1080",
        "inim.pixel_pitch_mm": "0.0629", "inim.pitch_mm": "1.2",
    }  # fmt: skip
    counted = Settings.parse(parameters, "here").make_display("here")
    assert (counted.lens_columns, counted.lens_rows) == (122, 56)  # 147.186 / 1.2, 67.932 / 1.2
    assert counted.panel_excess_mm == (0, 0)
    fixed = Settings.parse(parameters | {"inim.lens_columns": "152"}, "here").make_display("here")
    assert (fixed.lens_columns, fixed.lens_rows) == (152, 56)
    assert fixed.panel_excess_mm[0] == pytest.approx(152 * 1.2 - 2340 * 0.0629)
    (warning,) = lenses_beside_panel(fixed)
    assert "set lens_columns to 122 and lens_rows to 56" in warning


def test_a_picture_may_have_the_pixel_of_eq_3():
    """P / P_I pixels to the pitch, 1.7 on the nominal display; a whole number stays whole."""
    key = "inim.capture_pixels_per_pitch"
    fraction, whole = (
        Settings.parse({key: text}, "x").capture_pixels_per_pitch for text in ("1.7", "4")
    )
    assert isinstance(whole, int)
    display = DISPLAYS["nominal"]
    assert display.capture_pixel_mm(fraction) == display.scene_pixel_mm
    # The array and the outermost rays, whole pixels for each side and for the array.
    reach = 64 + 2 * display.depth_range_mm[1] / 6.6
    assert 0 <= display.capture_shape(fraction)[0] - reach / display.scene_pixel_mm < 3
    with pytest.raises(SceneError, match="must be a number"):
        Settings.parse({key: "few"}, "x")
