"""A display file is a display to every command: with a scene, in a study."""

from pathlib import Path

import pytest

from inim.apps.sweep.study import read_study
from inim.apps.sweep.unit import expand
from inim.display import DISPLAYS
from inim.pipeline.plan import make_plan
from inim.pipeline.request import Request
from inim.render.scene_files.file import choose_display
from inim.system.errors import FileError, InimError, UsageError
from tests.conftest import scene_text, sphere

MINE = """<scene version="3.0.0">
    <default name="inim.display" value="phone"/>
    <default name="inim.pitch_mm" value="0.9957"/>
    <default name="inim.lens_columns" value="20"/>
    <default name="inim.lens_rows" value="10"/>
    <default name="inim.rotation_deg" value="1.1"/>
    <default name="inim.view_spp" value="6"/>
</scene>
"""
OWN = (
    '<default name="inim.display" value="nominal"/><default name="inim.gap_mm" value="3.4"/>'
    '<default name="inim.eia_spp" value="4"/>'
)


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "scene.xml"
    path.write_text(scene_text(sphere((0, 0, 0), 1.0)).replace('"3.0.0">', f'"3.0.0">{OWN}'))
    return path


@pytest.fixture
def mine(tmp_path: Path) -> str:
    (tmp_path / "elsewhere").mkdir()
    path = tmp_path / "elsewhere" / "mine.xml"
    path.write_text(MINE)
    return str(path)


def test_a_file_replaces_the_display_of_a_scene_and_no_other_setting(scene, mine):
    plan = make_plan(Request(scene, Path("unused"), display=mine))
    assert plan.display == choose_display(mine)[0]
    assert (plan.display.pitch_mm, plan.display.gap_mm) == (0.9957, 3.3)
    assert (plan.settings.eia_spp, plan.settings.view_spp) == (4, 64)


def test_misalignment_belongs_to_its_own_display(scene, mine):
    own = '<default name="inim.misalign" value="rotation_deg=0.5"/>'
    scene.write_text(scene.read_text().replace('"3.0.0">', f'"3.0.0">{own}'))
    assert make_plan(Request(scene, Path("unused"))).misaligned_display.rotation_deg == 0.5
    assert (
        make_plan(Request(scene, Path("unused"), display=mine)).misaligned_display.rotation_deg
        == 1.1
    )
    again = Request(scene, Path("unused"), display=mine, misalign={"rotation_deg": 0.2})
    assert make_plan(again).misaligned_display.rotation_deg == pytest.approx(1.3)


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ('"inim.pich_mm" value="1"', r"mine\.xml: unknown setting .* did you mean inim\.pitch_mm"),
        ('"inim.gap_mm" value="abc"', r"mine\.xml: inim\.gap_mm = 'abc': must be a number"),
        ('"inim.gap_mm" value="-1"', r"mine\.xml: gap_mm = -1.0: must be a positive length"),
    ],
)
def test_a_mistake_in_the_file_is_the_file_s(scene, mine, wrong, says):
    Path(mine).write_text(MINE.replace("</scene>", f"<default name={wrong}/></scene>"))
    with pytest.raises(InimError, match=says):
        make_plan(Request(scene, Path("unused"), display=mine))


def test_the_command_line_has_the_last_word_on_single_values(scene, mine):
    definitions = {"inim.rotation_deg": "0.2", "inim.view_spp": "2"}
    plan = make_plan(Request(scene, Path("unused"), definitions=definitions, display=mine))
    assert (plan.display.rotation_deg, plan.display.pitch_mm) == (0.2, 0.9957)
    assert plan.settings.view_spp == 2


def test_a_study_takes_a_file_next_to_itself(scene, mine, tmp_path):
    study = tmp_path / "study.toml"
    text = (
        '[study]\nscenes = ["scene.xml"]\nalgorithms = ["template"]\n[[display]]\nname = "mine"\n'
    )
    study.write_text(f'{text}file = "elsewhere/mine.xml"\n')
    (unit,) = expand(read_study(study), tmp_path / "out")
    assert unit.plan.display.parameters() == choose_display(mine)[0].parameters()
    study.write_text(f'{text}file = "elsewhere/mine.xml"\ngap_mm = 3.5\n')
    with pytest.raises(InimError, match=r"display 'mine': gap_mm: belongs into its file"):
        read_study(study)
    study.write_text(f'{text}file = "none.xml"\n')
    with pytest.raises(FileError, match=r"none\.xml"):
        read_study(study)


@pytest.mark.parametrize("preset", list(DISPLAYS))
@pytest.mark.parametrize(
    "changes",
    [{}, {"gap_mm": 1 / 3 + 3, "lattice": "hexagonal"}, {"panel_columns": 700, "panel_rows": 300}],
)
def test_a_saved_display_is_read_back_exactly(tmp_path, preset, changes):
    display = DISPLAYS[preset].replace(**changes, name="")
    display.save(tmp_path / "mine.xml")
    assert choose_display(tmp_path / "mine.xml")[0].replace(name="") == display
    assert "<svg" in display._repr_svg_()
    with pytest.raises(UsageError, match=r"a display file is an \.xml; name it mine\.xml"):
        display.save(tmp_path / "mine.png")
