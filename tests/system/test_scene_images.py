"""Images of a scene without a validation have the pixels, errors and warnings of `inim.validate`.

Expected: equal samples and seeds give equal bits, also where views observe the panel; every mistake
is the same line.
"""

import pickle

import numpy as np
import pytest

import inim
from inim.image.files.image import read_exr_channels
from inim.pipeline import scene_images
from inim.system.errors import InimError, UsageError
from tests.conftest import small_display, sphere, square
from tests.system.conftest import without_page, worker_here, write_scene

# With eight samples and more, observed panel pixels have replicates, of random numbers of their
# own.
SETTINGS = {
    "lens_columns": 8, "lens_rows": 6, "pixel_pitch_mm": 0.125, "capture_spp": 8, "eia_spp": 8,
    "view_spp": 8, "reconstruction_spp": 4, "seed": 3, "viewpoints": "left",
    "algorithms": "template", "misalign": "shift_x_mm=0.1",
}  # fmt: skip
STATED = "".join(f'<default name="inim.{k}" value="{v}"/>' for k, v in SETTINGS.items())
FLOOR = """<shape type="rectangle" id="floor"><transform name="to_world"><scale value="500"/>
<rotate x="1" angle="-90"/><translate y="-3"/></transform></shape>"""


@pytest.fixture(scope="module", autouse=True)
def in_this_process():
    with worker_here(), without_page():
        yield


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    shapes = STATED, sphere((0, 0, 1), 1.2), square((-1, 1, 0), 1.5, "0.9,0.1,0.1"), FLOOR
    return write_scene(tmp_path_factory.mktemp("scene"), *shapes)


def test_images_are_those_of_a_validation_bit_for_bit_and_warn_as_it_does(scene):
    report = inim.validate(scene, scene.parent / "out")
    (warning,) = report.data.scene.warnings

    def image(name: str) -> np.ndarray:
        channels = read_exr_channels(report.folder / f"{name}.exr")
        return np.stack([channels[channel] for channel in "RGB"], axis=-1)

    with pytest.warns(UserWarning) as warned:
        picture, eia = inim.capture(scene), inim.render_eia(str(scene))
        view = inim.render_view(scene, viewpoint="left")
    assert [str(record.message) for record in warned] == [warning] * 3
    expected = inim.read_rgbd(report.folder / "rgbd.exr")
    for name in ("color", "covered", "depth_mm"):
        np.testing.assert_array_equal(getattr(picture, name), getattr(expected, name))
    assert picture.pixel_mm == expected.pixel_mm
    assert picture.covered.any()
    for own, name in ((eia, "truth/eia"), (view, "truth/left")):
        assert own.dtype == np.float32
        np.testing.assert_array_equal(own, image(name))
        assert own.max() > 0.1


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_display_and_definitions_replace_those_of_the_scene(scene):
    display, centre = small_display(6, 5), (0, 0, 200)
    definitions = {"inim.relic": "sphere"}
    picture = inim.capture(scene, display, definitions=definitions)
    assert picture.shape == display.capture_shape(5)
    view = inim.render_view(scene, display, centre, definitions=definitions)
    assert view.shape == (20, 24, 3)
    text = inim.render_view(scene, display, "mine=0 0 200", definitions=definitions)
    np.testing.assert_array_equal(view, text)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("gone.xml", None),
        ("broken.xml", "<scene"),
        ("empty.xml", f'<scene version="3.0.0">{STATED}</scene>'),
        ("key.xml", '<scene version="3.0.0"><default name="inim.gapmm" value="1"/></scene>'),
    ],
)
def test_bad_scenes_have_the_error_of_a_validation(tmp_path, name, text):
    scene = tmp_path / name
    if text is not None:
        scene.write_text(text)
    with pytest.raises(InimError) as of_validation:
        inim.validate(scene, tmp_path / "out")
    for render in (inim.capture, inim.render_eia, inim.render_view):
        with pytest.raises(type(of_validation.value)) as raised:
            render(scene)
        assert str(raised.value) == str(of_validation.value)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ((3,), "scene: is a int; give a path"),
        (("x.xml", None, "left,right"), "names several; give one"),
        (("x.xml", None, (0, 0)), r"give a Viewpoint, .* \(x, y, z\) in mm"),
    ],
)
def test_mistakes_in_arguments_are_one_line(arguments, says):
    with pytest.raises(InimError, match=says) as raised:
        inim.render_view(*arguments)
    assert "\n" not in str(raised.value)


def test_a_setting_as_an_argument_is_refused_with_the_definition():
    for render in (inim.capture, inim.render_eia, inim.render_view):
        with pytest.raises(UsageError, match=r'^seed: .*definitions=\{"inim.seed": 3\}$'):
            render("x.xml", seed=3)


def test_requests_can_be_sent_to_a_worker():
    for render in (scene_images._capture, scene_images._eia, scene_images._view):
        assert pickle.loads(pickle.dumps(render)) is render
