"""Bad input ends in one line that names it, the documented exit code, and nothing written.

Expected: no traceback, no leftovers, an existing output folder as it was. Mistakes that need no
renderer are checked in this process, where one costs milliseconds.
"""

from collections.abc import Mapping
from pathlib import Path

import pytest

from inim.pipeline.plan import make_plan
from inim.pipeline.request import Request
from inim.system.errors import EXIT_BACKEND, EXIT_USAGE, OutOfMemoryError
from tests.conftest import LIT, scene_text, sphere
from tests.system.conftest import (
    SHAPES,
    SMALLEST,
    TINY,
    assert_one_line,
    assert_refused,
    definitions,
    small_disk,
    write_scene,
)

TEXTURED = (
    '<shape type="rectangle"><bsdf type="diffuse"><texture type="bitmap" name="reflectance">'
    '<string name="filename" value="{}"/></texture></bsdf></shape>'
)


def test_a_mesh_in_place_of_a_scene_needs_its_axes(tmp_path):
    (tmp_path / "my pot.OBJ").write_bytes(b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    says = ["my pot.OBJ: the format contains no up axis; the mesh is 1 x 1 x 0 units", "Give --up"]
    assert_refused("validate", "my pot.OBJ", folder=tmp_path, says=says)
    assert [path.name for path in tmp_path.iterdir()] == ["my pot.OBJ"]


# --- Settings -----------------------------------------------------------------------------------

SETTINGS = [
    ("inim.pich_mm=1", "did you mean inim.pitch_mm?"),
    ("inim.zzz=1", "inim info settings"),
    ("inim.=1", "unknown setting"),
    ("foo=1", "-D foo: the scene has no such parameter"),
    ("pitch_mm=1", "-D pitch_mm: the setting is called inim.pitch_mm"),
    ("inim.pitch_mm", "write -D key=value"),
    ("inim.pitch_mm=-1", "pitch_mm = -1.0: must be a positive"),
    ("inim.pitch_mm=inf", "inim.pitch_mm = 'inf': must be finite"),
    ("inim.pitch_mm=1e308", "inim.pitch_mm = '1e308': must be finite and below"),
    ("inim.pitch_mm=", "inim.pitch_mm = '': must be a number"),
    ("inim.pitch_mm=1,5", "inim.pitch_mm = '1,5': must be a number; write 1.5"),
    ("inim.refractive_index=1e308", "inim.refractive_index"),
    ("inim.seed=1 -D inim.seed=2", "inim.seed: given twice"),
    ("inim.depth_min_mm=9 -D inim.depth_max_mm=5", "depth range [9, 5] mm"),
    ("inim.seed=1 --algoritms template", "--algoritms"),
    (f"inim.lens_columns={'9' * 400}", "inim.lens_columns = '999"),
    ("inim.algorithms=templat", "algorithm 'templat': did you mean template?"),
    ("inim.display=phones", "did you mean phone?"),
    ("inim.lens_model=thik", "lens model 'thik': did you mean thick?"),
    ("inim.viewpoints=lefft", "viewpoint 'lefft': did you mean left?"),
    ("inim.algorithms=,", "name at least one"),
    ("inim.algorithms=template,template", "algorithm 'template' is given twice"),
    ("inim.fit_share=0", "inim.fit_share = 0: must be at least"),
    ("inim.fit_share=1.5", "inim.fit_share = 1.5: must be at most 1"),
    ("inim.eia_spp=1", "inim.eia_spp = 1: must be at least 2"),
    ("inim.view_spp=1000000000000", "inim.view_spp = 1000000000000: must be at most"),
    ("inim.seed=-1", "inim.seed = -1: must be at least 0"),
    ("inim.viewpoints=middle", "use centre or left or right or up or down, or give a position"),
    ("inim.viewpoints=a=500 0", "outside the viewing zone"),
    ("inim.viewpoints=a/b=0 0", "viewpoint name 'a/b'"),
    ("inim.viewpoints=a\nb=0 0", "viewpoint name 'a\\nb'"),
    ("inim.min_ssim_to_reference=nan", "must be in 0..1"),
    ("inim.min_ssim_to_reference=template:0.5,template:0.6", "limits 'template' twice"),
]


@pytest.mark.parametrize(("item", "says"), SETTINGS)
def test_bad_setting_is_named_with_the_fix(tiny_scene, item, says):
    # A value with a space has no second option.
    items = item.split(" ") if " -" in item else [item]
    words = ("validate", tiny_scene, "-o", "out", "-D", *items)
    assert_refused(*words, folder=tiny_scene.parent, says=[says])


def test_unknown_key_in_the_scene_names_the_scene(tmp_path):
    scene = write_scene(tmp_path, '<default name="inim.gapmm" value="1"/>', *SHAPES)
    says = [str(scene), "did you mean inim.gap_mm?"]
    assert_refused("validate", scene, folder=tmp_path, says=says)


@pytest.mark.parametrize(
    "item",
    ["inim.lens_columns=1000000000", f"inim.lens_rows={'9' * 15}", "inim.panel_rows=99999999"],
)
def test_display_too_large_for_memory_is_refused_before_it_is_allocated(tiny_scene, item):
    words, says = ("validate", tiny_scene, "-D", item), ["GiB", "with fewer pixels"]
    assert_refused(*words, folder=tiny_scene.parent, says=says, code=EXIT_BACKEND)


@pytest.mark.parametrize("key", ["view_pixels_per_lens", "capture_pixels_per_pitch"])
def test_pictures_too_large_for_memory_are_refused_before_they_are_allocated(tiny_scene, key):
    out, large = tiny_scene.parent / "out", {f"inim.{key}": "20000"}
    request = Request(tiny_scene, out, definitions=large)
    with pytest.raises(OutOfMemoryError, match=key):
        make_plan(request)


# --- Scene files --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"\x00\x01\x02\xff", "broken XML"),
        (b'<?xml version="1.0" encoding="klingon"?><scene/>', "unknown encoding"),
        (b'<scene><include filename="gone.xml"/></scene>', "no such file"),
        (b'<scene><string name="filename" value="/etc/passwd"/></scene>', "outside the scene's"),
        (b'<scene><string name="filename" value="gone.ply"/></scene>', "'gone.ply' is not there"),
        (b'<scene><string name="filename" value="gone.png"/></scene>', "'gone.png' is not there"),
        (b'<scene><string name="filename" value="folder"/></scene>', "'folder' is not there"),
    ],
)
def test_bad_scene_file_is_named_with_the_reason(tmp_path, content, says):
    (tmp_path / "bad.xml").write_bytes(content)
    (tmp_path / "folder").mkdir()
    assert_refused("validate", "bad.xml", "-o", "out", folder=tmp_path, says=["bad.xml", says])


def test_control_characters_in_a_name_do_not_break_the_line(tmp_path):
    name = "a\nb\x1b[31m 'c' \"d\" 青铜.xml"
    assert_refused("validate", name, folder=tmp_path, says=["青铜.xml: no such file"])


def test_name_that_is_no_text_is_refused(tmp_path):
    says = [r"'\udcff.xml'", "PYTHONUTF8=1"]
    assert_refused("validate", "\udcff.xml", folder=tmp_path, says=says)


# --- What only the renderer finds out -----------------------------------------------------------

PLY = (
    "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
    "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
    "0 0 0\n1 0 0\n0 1 0.5\n3 0 1 7\n"
)
MESH = '<shape type="ply"><string name="filename" value="a.ply"/></shape>'


def refused(
    scene: Path | str, folder: Path, says: list[str], settings: Mapping[str, str] | None = None
) -> None:
    """Assert that a validation with the tiny display is refused in one line."""
    tiny = definitions(TINY | dict(settings or {}))
    assert_refused("validate", scene, "-o", "out", *tiny, folder=folder, says=says)


@pytest.mark.parametrize(
    ("shapes", "files", "says"),
    [
        ("", {}, "no shape except lights"),
        ('<shape type="sphere"><emitter type="area"/></shape>', {}, "no shape except lights"),
        ('<shape type="teapot"/>', {}, "teapot"),
        ('<shape type="sphere"><float name="radios" value="1"/></shape>', {}, "radios"),
        (sphere((0, 0, 0), float("nan")), {}, "no finite bounding box"),
        (sphere((float("inf"), 0, 0), 1), {}, "no finite bounding box"),
        (sphere((0, 0, 0), 0), {}, "no width or height to fit; check its transforms"),
        (MESH, {"a.ply": PLY}, "refers to vertex 7"),
        (TEXTURED.format("a.png"), {"a.png": "no picture"}, "a.png"),
        (TEXTURED.format("a.jpg"), {"a.jpg": "\xff\xd8\xff\xe0" + "\0" * 30}, "picture"),
    ],
)
def test_damaged_content_is_named(tmp_path, shapes, files, says):
    scene = write_scene(tmp_path, text=scene_text(shapes))
    for name, content in files.items():
        (tmp_path / name).write_text(content, encoding="latin-1")
    refused(scene.name, folder=tmp_path, says=[says, next(iter(files), scene.name)])


@pytest.mark.parametrize("integrator", ["ptracer", "prb"])
def test_integrator_that_traces_no_single_rays_is_refused(tmp_path, integrator):
    text = scene_text(*SHAPES).replace(LIT[: LIT.index("<sensor")], "")
    text = text.replace("</scene>", f'<integrator type="{integrator}"/></scene>')
    says = ["integrator", "use 'path' or 'volpath'"]
    refused(write_scene(tmp_path, text=text), folder=tmp_path, says=says)


@pytest.mark.parametrize("bsdf", ["null", "dielectric"])
def test_participating_media_are_refused(tmp_path, bsdf):
    """A depth camera would take the boundary of the smoke for the surface of a ball."""
    smoke = (
        f'<shape type="sphere" id="smoke"><bsdf type="{bsdf}"/>'
        '<medium name="interior" type="homogeneous"/></shape>'
    )
    says = ["tiny.xml", "smoke", "participating medium", "remove"]
    refused(write_scene(tmp_path, *SHAPES, smoke), folder=tmp_path, says=says)


# --- Output folders -----------------------------------------------------------------------------


def test_full_disk_is_one_line_and_leaves_nothing(tiny_scene, run_inim, tmp_path):
    with small_disk(tmp_path / "disk", "200k") as disk:
        ended = run_inim(tiny_scene, "-o", disk / "out", folder=tmp_path, **SMALLEST)
        assert ended.code == EXIT_USAGE
        assert_one_line(ended.stderr, ["free some space", "-o"])
        assert list(disk.iterdir()) == []


def test_read_only_disk_is_refused_before_rendering(tiny_scene, tmp_path):
    with small_disk(tmp_path / "disk", "200k", read_only=True) as disk:
        words, says = ("validate", tiny_scene, "-o", disk / "out"), ["disk/out", "Read-only", "-o"]
        assert_refused(*words, folder=tmp_path, says=says)


def test_deleted_current_folder_is_one_line(tiny_scene, run_process):
    without_folder = ("sh", "-c", 'mkdir gone; cd gone; rmdir ../gone; exec "$@"', "sh")
    ended = run_process("tiny.xml", "-o", "out", folder=tiny_scene.parent, prefix=without_folder)
    assert ended.code == EXIT_USAGE
    assert_one_line(ended.stderr, ["tiny.xml"])
