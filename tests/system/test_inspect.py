"""`inim inspect` as its users run it: text, JSON, figure, and one line where something is wrong.

Expected: nothing is rendered and the renderer is not even loaded; every number has its unit; bad
input ends in one line, the documented exit code, and nothing written.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from inim.apps.inspect import geometry
from inim.cli.main import main
from inim.system.errors import EXIT_PASSED
from tests.schemas import read_text
from tests.system.conftest import assert_refused, definitions, write_scene
from tests.unit.test_cli import loaded_by

SMALL = definitions({"inim.lens_columns": "6", "inim.lens_rows": "6"})


@pytest.fixture(scope="module", autouse=True)
def coarse_map() -> Iterator[None]:
    """A crosstalk map of 7 x 7 eyes; it would take most of each test's time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(geometry, "_EYES_ACROSS", 7)
        yield


def inspect(capsys: pytest.CaptureFixture[str], *words: str | Path) -> str:
    """Output of the command when it succeeds."""
    assert main(["inspect", *map(str, words), *SMALL]) == EXIT_PASSED
    output = capsys.readouterr()
    assert output.err == ""
    return output.out


def test_json_is_valid_and_complete_with_units(capsys):
    data = read_text(inspect(capsys, "nominal", "--json"))
    assert data["schema"] == "inim.inspect/3"
    assert len(data["pixels_per_lens"]) == 3
    assert set(data["light"]) == {"centre", "left", "right", "up", "down"}
    share = np.array(data["crosstalk"]["share"])
    assert share.shape == (len(data["crosstalk"]["eye_y_mm"]), len(data["crosstalk"]["eye_x_mm"]))
    assert len({len(values) for values in data["voxel"].values()}) == 1
    unitless = (
        *("columns", "rows", "pixels_per_lens", "views_across", "views_down", "share"),
        *("refractive_index", "conic", "fill", "fill_factor", "asphere_a4", "asphere_a6"),
        *("black_level", "ambient_reflection", "veiling_glare", "details_across", "brightness"),
    )
    units = ("_mm", "_deg", "_um", "_px", "_mb")
    for place, key, value in numbers(data):
        assert key.endswith((*units, *unitless)), f"{place}: {key} = {value} has no unit"


def numbers(value: object, place: str = "", key: str = "") -> list[tuple[str, str, float]]:
    """Every number in some data, with its path and the nearest key above it."""
    if isinstance(value, dict):
        return [n for k, v in value.items() for n in numbers(v, f"{place}/{k}", k)]
    if isinstance(value, list):
        return [n for v in value for n in numbers(v, place, key)]
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return [(place, key, float(value))] if is_number else []  # type: ignore[arg-type]


def test_scene_s_settings_are_read_and_the_command_line_wins(capsys, tmp_path):
    settings = (
        '<default name="inim.gap_mm" value="2.7"/><default name="inim.lens_model" value="thin"/>'
        '<default name="inim.viewing_distance_mm" value="500"/>'
        '<default name="inim.misalign" value="rotation_deg=0.5"/>'
    )
    scene = write_scene(tmp_path, settings)
    data = read_text(inspect(capsys, scene, "--json"))
    assert (data["depth"]["mode"], data["depth"]["central_depth_mm"]) == ("virtual", -27)
    assert data["lens_model"]["name"] == "thin"
    assert data["viewing"]["distance_mm"] == 500
    assert data["misalignment"] == ["array turned by 0.5° counter-clockwise (not in the design)"]
    words = ("--json", "--distance", "300", "--lens-model", "pinhole", "-D", "inim.gap_mm=3.3")
    data = read_text(inspect(capsys, scene, *words))
    assert (data["depth"]["mode"], data["lens_model"]["name"]) == ("real", "pinhole")
    assert data["viewing"]["distance_mm"] == 300


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("tv",), ("tv", "nominal or phone")),
        (("nominal", "-D", "inim.pich_mm=1"), ("did you mean inim.pitch_mm?",)),
        (("nominal", "-D", "spp=4"), ("-D spp", "inim.*")),
        (("nominal", "-D", "inim.display=phone"), ("inim.display", "name it once")),
        (("nominal", "-D", "inim.gap_mm=3"), ("set depth_min_mm and depth_max_mm",)),
        (("nominal", "-D", "inim.pitch_mm=0"), ("pitch_mm = 0.0", "positive")),
        (("nominal", "--distance", "0"), ("--distance 0", "above 0")),
        (("nominal", "--distance", "nan"), ("--distance nan", "above 0")),
        (("nominal", "--distance", "far"), ("--distance", "far")),
        (("nominal", "--lens-model", "fresnel"), ("'fresnel'", "thick")),
        (("nominal", "-D", "inim.tilt_x_deg=10"), ("the panel, tilted, meets the array",)),
        (("nominal", "--lens-model", "full"), ("'full'", "use 'thick'")),
        (("nominal", "-D", "inim.elemental_pitch_mm=0.9"), ("every viewing distance",)),
        (
            ("nominal", "--lens-model", "thick", "-D", "inim.focal_length_mm=0.9"),
            ("longer focal_length_mm",),
        ),
    ],
)
def test_bad_input_is_one_line_with_the_fix(tmp_path, words, says):
    assert_refused("inspect", *words, "-o", "out", folder=tmp_path, says=says)


def test_neither_the_renderer_nor_the_plots_are_loaded_for_a_text():
    renderer = {"mitsuba", "drjit", "numba", "skimage", "scipy", "trimesh", "OpenEXR"}
    assert loaded_by("inspect", "nominal", *SMALL).isdisjoint(renderer | {"matplotlib"})
