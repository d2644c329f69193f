"""The relic of a scene with a floor, a wall or a room around it, and the files of such scenes."""

import numpy as np
import pytest

from inim.render.scene import open_scene
from inim.render.scene_files.file import AUTO, read_scene_file
from inim.system.errors import SceneError
from tests.conftest import small_display, sphere

DISPLAY = small_display()
CAMERA = """<sensor type="perspective"><transform name="to_world">
<lookat origin="{}" target="{}" up="0,1,0"/></transform></sensor>"""
FRONT = CAMERA.format("0,3,12", "0,0,0")
BALL = sphere((0, 0, 0), 1).replace("<shape", '<shape id="ball"')
FLOOR = """<shape type="rectangle" id="floor"><transform name="to_world"><scale value="500"/>
<rotate x="1" angle="-90"/><translate y="-1"/></transform></shape>"""
ROOM = """<shape type="cube" id="room"><transform name="to_world"><scale value="60"/></transform>
</shape>"""


def scene(*parts):
    return f'<scene version="3.0.0">{"".join(parts)}<emitter type="constant"/></scene>'


@pytest.mark.parametrize("around", [FLOOR, ROOM, FLOOR + ROOM])
def test_surroundings_do_not_decide_the_size_of_what_the_camera_looks_at(open_fitted, around):
    alone = open_fitted(scene(FRONT, BALL), DISPLAY)
    fitted = open_fitted(scene(FRONT, around, BALL), DISPLAY)
    assert {*fitted.left_out} == {name for name in ("floor", "room") if f'"{name}"' in around}
    assert fitted.fit.scale_xy == alone.fit.scale_xy
    assert [shape.id() for shape in fitted.scene.shapes()] == ["ball"]
    assert "to choose the shapes, set inim.relic" in fitted.warnings[0]


def test_all_shapes_that_belong_together_are_the_relic(open_fitted):
    # A row of ten balls, each a tenth of the whole, on a plinth three times as wide as one.
    balls = "".join(sphere((2.5 * k, 0, 0), 1) for k in range(10))
    plinth = '<shape type="cube"><transform name="to_world"><scale value="3"/></transform></shape>'
    fitted = open_fitted(scene(FRONT, FLOOR, balls, plinth), DISPLAY)
    assert fitted.left_out == ("floor",)
    assert fitted.shapes == 11


@pytest.mark.parametrize("camera", ["", CAMERA.format("0,0,12", "0,900,13")])
def test_without_a_camera_or_a_hit_a_dominating_shape_is_named(open_fitted, camera):
    fitted = open_fitted(scene(camera, FLOOR, BALL), DISPLAY)
    assert fitted.left_out == ()
    assert "the shape floor is 408 times as large as all others together" in fitted.warnings[0]


def test_what_the_camera_shows_as_a_whole_is_the_relic(open_fitted):
    # A small gem before a large body; a gap in the middle; a pebble far away; a lamp before all.
    gem = sphere((0, 0, 3), 0.1)
    body = sphere((0, 0, 0), 1.5)
    lamp = """<shape type="rectangle"><transform name="to_world"><translate z="6"/></transform>
    <emitter type="area"/></shape>"""
    assert open_fitted(scene(FRONT, gem, body), DISPLAY).left_out == ()
    pair = sphere((-1.5, 0, 0), 0.2) + sphere((1.5, 0, 0), 0.2)
    pebble = sphere((4000, 0, 0), 1).replace("<shape", '<shape id="pebble"')
    fitted = open_fitted(scene(FRONT, FLOOR, lamp, pair, pebble), DISPLAY)
    assert {*fitted.left_out} == {"floor", "pebble"}
    assert fitted.shapes == 2


def test_a_setting_chooses_the_shapes(renderer, tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text(scene(FRONT, FLOOR, BALL, sphere((5, 0, 0), 1)))
    file = read_scene_file(path)
    fitted = open_scene(file, DISPLAY, 0.85, relic="floor, sphere")
    assert fitted.left_out == ("ball",)
    assert fitted.fit.scale_xy == pytest.approx(0.85 * 12 / 1000, rel=0.2)
    with pytest.raises(SceneError, match=r"inim.relic = 'bell': .* did you mean ball"):
        open_scene(file, DISPLAY, 0.85, relic="bell")


def test_backslashes_of_file_names_are_slashes(open_fitted, tmp_path):
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "Cube.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
        "property float z\nelement face 1\nproperty list uchar int vertex_index\nend_header\n"
        "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
    )
    name = r'<string name="filename" value="meshes\Cube.ply"/>'
    fitted = open_fitted(scene(f'<shape type="ply">{name}</shape>'), DISPLAY)
    assert fitted.imports == ("Cube.ply: 1 triangles",)
    assert [shape.id() for shape in fitted.scene.shapes()] == ["Cube"]


def test_the_common_folder_of_all_files_can_be_allowed(tmp_path):
    for folder in ("scene", "meshes"):
        (tmp_path / "a" / folder).mkdir(parents=True)
    (tmp_path / "a" / "meshes" / "m.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    path = tmp_path / "a" / "scene" / "s.xml"
    name = '<string name="filename" value="../meshes/m.obj"/>'
    path.write_text(scene(f'<shape type="obj">{name}</shape>'))
    with pytest.raises(SceneError, match=r"outside the scene's folder"):
        read_scene_file(path)
    assert read_scene_file(path, allowed=[AUTO]).common == tmp_path / "a"
    path.write_text(scene(f'<shape type="obj">{name.replace("../meshes/m.obj", "/etc/a")}</shape>'))
    with pytest.raises(SceneError, match=r"no folder in common"):
        read_scene_file(path, allowed=[AUTO])


def test_a_set_of_tiles_is_explained(tmp_path):
    path = tmp_path / "s.xml"
    texture = '<texture type="bitmap"><string name="filename" value="a.{}.png"/></texture>'
    path.write_text(scene(texture.format("&lt;UDIM&gt;")))
    with pytest.raises(Exception, match=r"one per tile"):
        read_scene_file(path)


@pytest.mark.parametrize(("material", "is_named"), [("diffuse", True), ("twosided", False)])
def test_a_mirrored_one_sided_mesh_is_named(open_fitted, tmp_path, material, is_named):
    (tmp_path / "m.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    inner = '<bsdf type="diffuse"/>' if material == "twosided" else ""
    mesh = f'''<shape type="obj"><string name="filename" value="m.obj"/>
    <transform name="to_world"><scale x="-1"/></transform>
    <bsdf type="{material}">{inner}</bsdf></shape>'''
    warnings = open_fitted(scene(mesh), DISPLAY).warnings
    assert any("to_world mirrors the shape m" in text for text in warnings) == is_named


def test_a_view_of_a_black_relic_is_warned_of(renderer):
    from inim.image.noisy_image import NoisyImage
    from inim.pipeline.stages.ground_truth import black_warnings

    image = np.zeros((20, 20, 3), np.float32)
    relic = np.ones((20, 20), bool)
    image[0, 0] = 0.5
    views = {"centre": NoisyImage.from_parts(np.stack([image, image]))}
    (text,) = black_warnings(views, {"centre": relic})
    assert "truth/centre: 90% of the relic's pixels are black" in text
    assert "twosided" in text
    image[:3] = 0.5
    views = {"centre": NoisyImage.from_parts(np.stack([image, image]))}
    assert black_warnings(views, {"centre": relic}) == []
