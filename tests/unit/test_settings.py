"""Settings and scene files: what is read, what is refused, in which words."""

import pytest

from inim.display import DISPLAYS
from inim.display.viewpoint import parse_viewpoints
from inim.errors import DisplayError, FileError, SceneError, UsageError, ViewpointError
from inim.inspect.accuracy_limits import lenses_beside_panel
from inim.scene.file import parse_definitions, read_scene_file
from inim.settings import Settings
from tests.conftest import small_display


def scene(tmp_path, body, name="s.xml"):
    path = tmp_path / name
    path.write_text(f'<scene version="3.0.0">{body}</scene>', encoding="utf-8")
    return path


def test_the_command_line_wins_over_the_file(tmp_path):
    path = scene(tmp_path, '<default name="inim.pitch_mm" value="2"/>')
    assert read_scene_file(path).settings == {"inim.pitch_mm": "2"}
    assert read_scene_file(path, {"inim.pitch_mm": "3"}).settings == {"inim.pitch_mm": "3"}


def test_only_parameters_that_the_scene_uses_reach_the_renderer(tmp_path):
    body = """<default name="inim.pitch_mm" value="2"/><default name="spp" value="4"/>
        <default name="inim.seed" value="1"/><integer name="a" value="$spp"/>
        <float name="b" value="$inim.pitch_mm"/>"""
    found = read_scene_file(
        scene(tmp_path, body), {"spp": "8", "inim.pitch_mm": "3", "inim.seed": "5"}
    )
    assert found.parameters == {"spp": "8", "inim.pitch_mm": "3"}


def test_an_unknown_parameter_is_named_with_those_there_are(tmp_path):
    path = scene(tmp_path, '<default name="spp" value="4"/>')
    with pytest.raises(SceneError, match=r"-D sppp.*spp"):
        read_scene_file(path, {"sppp": "8"})


@pytest.mark.parametrize(
    ("text", "error", "words"),
    [
        ({"inim.pich_mm": "1"}, SceneError, "inim.pitch_mm"),
        ({"inim.pitch_mm": "wide"}, SceneError, "a number"),
        ({"inim.pitch_mm": "nan"}, SceneError, "finite"),
        ({"inim.lens_rows": "1.5"}, SceneError, "whole number"),
        ({"inim.eia_spp": "0"}, SceneError, "at least 2"),
        ({"inim.display": "tv"}, SceneError, "nominal or phone"),
        ({"inim.pitch_mm": "0"}, DisplayError, "pitch_mm = 0"),
        ({"inim.gap_mm": "3"}, DisplayError, "depth_min_mm"),
        ({"inim.depth_min_mm": "3"}, DisplayError, "both"),
    ],
)
def test_a_wrong_setting_is_named(text, error, words):
    with pytest.raises(error, match=words):
        Settings.parse(text, "s.xml").make_display("s.xml")


def test_a_changed_array_gets_a_panel_of_its_own_size():
    phone = Settings.parse({"inim.display": "phone"}, "s").make_display("s")
    assert phone.eia_shape == (1080, 2400)
    wider = Settings.parse(
        {"inim.display": "phone", "inim.lens_columns": "10", "inim.lens_rows": "10"}, "s"
    ).make_display("s")
    assert wider.eia_shape == (158, 158), "10 lenses of 15.72 pixels, covered"


def test_limits_go_to_the_algorithms_they_name():
    both = ("template", "wang2024")
    parse = lambda text: Settings.parse({"inim.min_ssim_to_ceiling": text}, "s")  # noqa: E731
    assert parse("0.9").ssim_limits(both, "s") == {"template": 0.9, "wang2024": 0.9}
    assert parse("template:0.9, wang2024:0.5").ssim_limits(both, "s") == {
        "template": 0.9,
        "wang2024": 0.5,
    }
    assert parse("").ssim_limits(both, "s") == {}
    for wrong in ("1.5", "high", "other:0.5"):
        with pytest.raises(SceneError):
            parse(wrong).ssim_limits(both, "s")


@pytest.mark.parametrize("item", ["inim.pitch_mm", "=3", ""])
def test_a_definition_without_key_or_value_is_refused(item):
    with pytest.raises(UsageError, match="key=value"):
        parse_definitions([item])


def test_the_hash_follows_contents_not_names(tmp_path):
    body = '<default name="inim.seed" value="1"/>'
    one = read_scene_file(scene(tmp_path, body, "a.xml")).sha256
    assert one == read_scene_file(scene(tmp_path, body, "b.xml")).sha256
    assert one != read_scene_file(scene(tmp_path, body + " ", "a.xml")).sha256
    mesh = '<shape type="ply"><string name="filename" value="m.ply"/></shape>'
    (tmp_path / "m.ply").write_bytes(b"1")
    first = read_scene_file(scene(tmp_path, mesh)).sha256
    (tmp_path / "m.ply").write_bytes(b"2")
    assert first != read_scene_file(scene(tmp_path, mesh)).sha256


def test_files_outside_the_scene_s_folder_are_refused(tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "secret.ply").write_text("x")
    (tmp_path / "in" / "link.ply").symlink_to(tmp_path / "secret.ply")
    for name in ("../secret.ply", str(tmp_path / "secret.ply"), "link.ply"):
        body = f'<shape type="ply"><string name="filename" value="{name}"/></shape>'
        with pytest.raises(SceneError, match="outside the scene's folder"):
            read_scene_file(scene(tmp_path / "in", body))
    with pytest.raises(SceneError, match="outside"):
        read_scene_file(scene(tmp_path / "in", '<include filename="../s.xml"/>'))
    with pytest.raises(SceneError, match="outside"):
        read_scene_file(
            scene(
                tmp_path / "in",
                '<default name="up" value=".."/>'
                '<shape type="ply"><string name="filename" value="$up/secret.ply"/></shape>',
            )
        )


def test_a_circle_of_includes_ends(tmp_path):
    with pytest.raises(SceneError, match="circle"):
        read_scene_file(scene(tmp_path, '<include filename="s.xml"/>'))


def test_includes_are_scanned_too(tmp_path):
    scene(tmp_path, '<default name="inim.seed" value="7"/>', "part.xml")
    found = read_scene_file(scene(tmp_path, '<include filename="part.xml"/>'))
    assert found.settings == {"inim.seed": "7"}


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("<scene><a></scene>", FileError),
        ("", FileError),
        ("<html/>", FileError),
        ("<scene>" + "<a>" * 20000, SceneError),
        ('<scene version="3.0.0">' + "<a/>" * 200_001 + "</scene>", SceneError),
        ('<!DOCTYPE x [<!ENTITY a "b">]><scene>&a;</scene>', SceneError),
        ("\x00\x01\x02", FileError),
    ],
)
def test_broken_deep_and_entity_laden_xml_is_refused(tmp_path, text, error):
    path = tmp_path / "bad.xml"
    path.write_text(text)
    with pytest.raises(error, match=r"bad\.xml"):
        read_scene_file(path)


DISPLAY = small_display(12, 10)


def test_named_viewpoints_are_inside_the_zone_and_apart():
    found = {v.name: v for v in parse_viewpoints("centre,left,right,up,down", DISPLAY)}
    assert found["left"].x_mm < -5 < 5 < found["right"].x_mm
    assert found["down"].y_mm < -5 < 5 < found["up"].y_mm
    assert found["left"].x_mm == -found["right"].x_mm


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "at least one"),
        ("centre,centre", "twice"),
        ("middle", "middle"),
        ("a=1", "millimetres"),
        ("a=1 2 3 4", "millimetres"),
        ("a=x y", "millimetres"),
        ("../a=0 0", "letters"),
        ("a=0 0 -5", "in front"),
        ("a=0 0 nan", "finite"),
        ("a=0 0 20", "inside the picture"),
        ("a=60 0 120", "flipped"),
        ("a=0 -60 120", "flipped"),
        ("a=0 0 33", "move back"),
    ],
)
def test_a_viewpoint_that_cannot_be_used_is_named(text, words):
    with pytest.raises(ViewpointError, match=words):
        parse_viewpoints(text, DISPLAY.replace(depth_min_mm=10, depth_max_mm=30), 120)


def test_lenses_are_counted_from_a_panel_that_is_given():
    given = {
        "inim.display": "phone", "inim.panel_columns": "2340", "inim.panel_rows": "1080",
        "inim.pixel_pitch_mm": "0.0629", "inim.pitch_mm": "1.2",
    }  # fmt: skip
    made = Settings.parse(given, "here").make_display("here")
    assert (made.lens_columns, made.lens_rows) == (122, 56)  # 147.186 / 1.2, 67.932 / 1.2
    assert made.beside_panel_mm == (0, 0)
    kept = Settings.parse(given | {"inim.lens_columns": "152"}, "here").make_display("here")
    assert (kept.lens_columns, kept.lens_rows) == (152, 56)
    assert kept.beside_panel_mm[0] == pytest.approx(152 * 1.2 - 2340 * 0.0629)
    (said,) = lenses_beside_panel(kept)
    assert "set lens_columns to 122 and lens_rows to 56" in said


@pytest.mark.parametrize("name", list(DISPLAYS))
def test_presets_fit_their_panels(name):
    assert lenses_beside_panel(DISPLAYS[name]) == []


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
