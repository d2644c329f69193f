"""Record of a scene's elements and files, in canonical form."""

import base64
import io

import msgspec
import numpy as np
import pytest
from PIL import Image

from inim.pipeline.plan import inputs_of, make_plan
from inim.pipeline.request import Request
from inim.render.meshes.ply import write_ply
from inim.render.meshes.triangle_mesh import Mesh
from inim.render.scene_files import elements
from inim.render.scene_files.facts import file_facts
from inim.render.scene_files.file import read_scene_file
from inim.scores.regression.inputs import changed_inputs
from tests.conftest import box_surface

SCENE = """<scene version="3.0.0">
<default name="grey" value="0.5"/>
<bsdf type="diffuse" id="clay">
  <texture type="bitmap" name="reflectance"><string name="filename" value="clay.png"/></texture>
</bsdf>
<shape type="ply" id="box"><string name="filename" value="box.ply"/><ref id="clay"/>
  <transform name="to_world"><rotate y="1" angle="30"/><translate x="1" y="2"/></transform></shape>
<emitter type="constant"><rgb name="radiance" value="$grey"/></emitter>
</scene>"""


@pytest.fixture
def record(tmp_path, monkeypatch):
    """A function that records a scene, with a mesh and a texture of one grey."""
    monkeypatch.chdir(tmp_path)

    def make(text: str = SCENE, grey: int = 100, scale: float = 1.0, **options):
        corners, faces = box_surface()
        (tmp_path / "scene.xml").write_text(text)
        write_ply(tmp_path / "box.ply", Mesh((scale * corners).astype(np.float32), faces))
        Image.new("RGB", (80, 40), (grey, grey, grey)).save("clay.png")
        plan = make_plan(Request(tmp_path / "scene.xml", tmp_path / "out", **options))
        return inputs_of(plan, facts=file_facts(plan.file))

    return make


def names(before, after):
    return [change.name for change in changed_inputs(before, after)]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("<emitter", "<!-- a lamp -->\n\t<emitter"),
        ('type="ply" id="box"', 'id="box"   type="ply"'),
        ('angle="30"', 'angle="30.0"'),
        ('value="$grey"', 'value="0.50"'),
        ('value="box.ply"', 'value="./box.ply"'),
        ('<rotate y="1"', '<rotate   y="1.000"'),
    ],
)
def test_layout_and_the_form_of_numbers_are_no_change(record, old, new):
    assert old in SCENE
    assert names(record(), record(SCENE.replace(old, new))) == []


@pytest.mark.parametrize(
    ("old", "new", "name"),
    [
        ('angle="30"', 'angle="31"', "scene: shape box / transform to_world / rotate 1"),
        ('value="$grey"', 'value="0.6"', "scene: emitter constant / rgb radiance"),
        ("<shape", '<shape type="sphere" id="ball"/><shape', "scene: shape ball"),
    ],
)
def test_a_changed_element_is_named_by_its_ids(record, old, new, name):
    assert names(record(), record(SCENE.replace(old, new))) == [name]


def test_the_order_of_a_transform_s_steps_is_a_change(record):
    steps = '<rotate y="1" angle="30"/>', '<translate x="1" y="2"/>'
    assert "".join(steps) in SCENE
    assert names(record(), record(SCENE.replace("".join(steps), "".join(reversed(steps)))))


def test_a_parameter_from_the_command_line_counts_where_it_is_used(record):
    changed = record(definitions={"grey": "0.7"})
    assert names(record(), changed) == ["scene: emitter constant / rgb radiance"]


def test_a_changed_picture_has_both_previews(record):
    [change] = changed_inputs(record(), record(grey=50))
    assert change.name == "file clay.png (bsdf clay / texture reflectance)"
    assert change.candidate.endswith(", 80 x 40 pixels")
    for preview, grey in zip(change.previews, (100, 50), strict=True):
        with Image.open(io.BytesIO(base64.b64decode(preview))) as picture:
            assert (picture.size, picture.getpixel((3, 3))) == ((32, 16), (grey, grey, grey))


def test_a_changed_mesh_has_both_bounding_boxes(record):
    [change] = changed_inputs(record(), record(scale=2.5))
    assert change.name == "file box.ply (shape box)"
    assert change.baseline.endswith("8 vertices, box 0 to 1, 0 to 1, 0 to 1")
    assert change.candidate.endswith("8 vertices, box 0 to 2.5, 0 to 2.5, 0 to 2.5")


def test_a_long_scene_is_recorded_by_its_shapes(record, monkeypatch, tmp_path):
    record()
    monkeypatch.setattr(elements, "MOST_RECORDED", 8)
    file = read_scene_file(tmp_path / "scene.xml")
    assert list(file.elements) == ["bsdf clay", "shape box", "emitter constant"]
    monkeypatch.setattr(elements, "MOST_RECORDED", 2)
    assert len(read_scene_file(tmp_path / "scene.xml").elements) == 1


def test_a_preview_in_a_baseline_is_base64_and_nothing_else(record):
    inputs = msgspec.to_builtins(record())
    inputs["files"] = {"a" * 64: {"name": "x", "preview": '"><script>'}}
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert(inputs, type(record()))
