"""Studies: what is multiplied, what is refused and in which words, and what units are known by."""

from pathlib import Path

import pytest

from inim.apps.sweep.study import AS_SCENE, read_study
from inim.apps.sweep.unit import expand
from inim.display import DISPLAYS
from inim.system.errors import EXIT_USAGE, InimError
from tests.conftest import scene_text, sphere

STUDY = """
[study]
scenes = ["one.xml", "sub/two.xml"]
displays = ["nominal", "tiny", "scene"]
algorithms = ["template", "gu2020"]
viewpoints = ["centre", "near=0 0 300"]
lens_model = ["thin", "thick"]

[settings]
eia_spp = [2, 4]
view_spp = 2

[[display]]
name = "tiny"
lens_columns = 8
lens_rows = 6
"""

# Of one scene and one display.
ONE = (
    STUDY.partition("[[display]]")[0]
    .replace('"one.xml", "sub/two.xml"', '"one.xml"')
    .replace('"nominal", "tiny", "scene"', '"nominal"')
)


@pytest.fixture
def write_study(tmp_path):
    """Write two scenes and a study of them; its path."""
    (tmp_path / "sub").mkdir()
    for name, radius in (("one.xml", 1.0), ("sub/two.xml", 2.0)):
        (tmp_path / name).write_text(scene_text(sphere((0, 0, 0), radius)))

    def write(text: str = STUDY, name: str = "study.toml") -> Path:
        (tmp_path / name).write_text(text)
        return tmp_path / name

    return write


def units_of(path: Path):
    return expand(read_study(path), path.parent / "out")


def test_the_project_s_own_studies_are_read(tmp_path):
    """A new preset must not take the name of a display in them."""
    root = Path(__file__).parents[2]
    page = (root / "docs/how-to/sweep.md").read_text("utf-8")
    _, _, example = page.partition("<!-- file: scenes/small.toml -->\n```toml\n")
    study = tmp_path / "small.toml"
    scenes = root / "scenes"
    study.write_text(
        example.partition("```")[0].replace('"amphora', f'"{scenes}/amphora')
        .replace('"jade', f'"{scenes}/jade'), "utf-8"
    )  # fmt: skip
    for path in (study, scenes / "study.toml"):
        assert len(units_of(path)) >= 8


def test_a_study_multiplies_scenes_displays_and_lists(write_study):
    study = read_study(write_study())
    assert list(study.scenes) == ["one", "two"]
    assert [d.name for d in study.displays] == ["nominal", "tiny", AS_SCENE]
    assert study.algorithms == ("template", "gu2020")
    assert list(study.variations) == [
        f"eia_spp = {spp}, lens_model = {model}" for spp in (2, 4) for model in ("thin", "thick")
    ]
    units = units_of(study.path)
    assert len(units) == 2 * 3 * 4
    # `scene` is nominal here: the same work by another name, and the same key.
    assert len({unit.hash for unit in units}) == 2 * 2 * 4
    plan = units[0].plan
    assert plan.settings.eia_spp == 2
    assert plan.settings.view_spp == 2
    assert [v.name for v in plan.viewpoints] == ["centre", "near"]


GRID = """
[study]
scenes = ["one.xml"]
displays = ["grid", "phone", "scene"]
algorithms = ["template"]

[settings]
gap_mm = [3.3, 3.4]

[[display]]
name = "grid"
pitch_mm = {from = 0.9, to = 1.1, step = 0.1}
lens_columns = [8, 9]
lens_rows = 8
"""


def test_lists_and_ranges_multiply_displays_and_their_parameters(write_study):
    units = units_of(write_study(GRID))
    assert len(units) == (3 * 2 + 1 + 1) * 2
    assert all(unit.plan is not None for unit in units)
    displays = {(unit.display, unit.variation): unit.plan.display for unit in units}
    last = displays["grid", "pitch_mm = 1.1, lens_columns = 9, gap_mm = 3.4"]
    assert (last.pitch_mm, last.lens_columns, last.gap_mm) == (1.1, 9, 3.4)
    phone = DISPLAYS["phone"].replace(gap_mm=3.4).parameters()
    assert displays["phone", "gap_mm = 3.4"].parameters() == phone | {"name": "phone, changed"}
    assert displays["scene", "gap_mm = 3.3"].gap_mm == 3.3
    assert len({unit.hash for unit in units}) == len(units)


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("{from = 0.1, to = 0.3, step = 0.1}", [0.1, 0.2, 0.3]),
        ("{from = 0.3, to = 0.1, step = -0.1}", [0.3, 0.2, 0.1]),
        ("{from = 3, to = 3.5, step = 0.2}", [3, 3.2, 3.4]),
        ("{from = 0, to = 1, count = 4}", [0, 1 / 3, 2 / 3, 1]),
        ("{from = 1, to = 3, step = 1}", [1, 2, 3]),
    ],
)
def test_ranges_are_exact_in_decimals(write_study, text, values):
    study = read_study(write_study(GRID.replace("[3.3, 3.4]", text)))
    assert [float(v["inim.gap_mm"]) for v in study.variations.values()] == values


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("[study]", "[stduy]", ["unknown field `stduy`"]),
        ("scenes =", "scene =", ["study", "unknown field `scene`"]),
        ('scenes = ["one.xml", "sub/two.xml"]', "", ["study", "required field `scenes`"]),
        ('"one.xml"', '"gone.xml"', ["study.scenes", "'gone.xml'", "study's folder"]),
        ('"one.xml"', '"sub/two.xml"', ["study.scenes", "twice"]),
        ('["one.xml", "sub/two.xml"]', '"one.xml"', ["study.scenes", "array"]),
        ('["nominal", "tiny", "scene"]', '["huge"]', ["study.displays", "'huge'", "tiny"]),
        ('"gu2020"]', '"nonesuch"]', ["study.algorithms", "nonesuch", "template"]),
        ('"gu2020"]', '"template"]', ["study.algorithms", "twice"]),
        ('["thin", "thick"]', '["fish"]', ["study.lens_model", "'fish'", "pinhole"]),
        ("view_spp = 2", "veiw_spp = 2", ["settings.veiw_spp", "did you mean view_spp"]),
        ("view_spp = 2", "view_spp = {from = 2}", ["settings.view_spp", "to = 1, step = 0.1"]),
        ("view_spp = 2", "gap_mm = {from = 3, to = 4, step = -1}", ["settings.gap_mm", "no"]),
        ("view_spp = 2", "gap_mm = {from = 3, to = nan, step = 1}", ["gap_mm.to", "number"]),
        ("view_spp = 2", "gap_mm = {from = 3, to = 4, count = 1}", ["settings.gap_mm", "count"]),
        ("view_spp = 2", "gap_mm = {from = 3, to = 4, by = 1}", ["gap_mm.by", "unknown key"]),
        ("view_spp = 2", 'algorithms = "x"', ["settings.algorithms", "study.algorithms"]),
        ("view_spp = 2", "view_spp = 2.5", ["view_spp", "2.5", "whole number"]),
        ("view_spp = 2", "view_spp = true", ["settings.view_spp", "a number or a text"]),
        ("[2, 4]", "[2, 2]", ["settings.eia_spp", "twice"]),
        ("[2, 4]", "[]", ["settings.eia_spp", "empty"]),
        ("lens_rows = 6", "lens_rows = 0", ["tiny", "lens_rows"]),
        ("lens_rows = 6", "rows = 6", ["display 'tiny': rows", "did you mean lens_rows"]),
        ('name = "tiny"', 'name = "phone"', ["display.name", "'phone'", "taken"]),
        ('name = "tiny"', 'preset = "phone"', ["display.name", "letters"]),
        ("[2, 4]", "[2, 4", ["no TOML"]),
    ],
)  # fmt: skip
def test_a_mistake_is_one_line_with_file_key_and_fix(write_study, old, new, says):
    assert old in STUDY
    path = write_study(STUDY.replace(old, new, 1))
    with pytest.raises(InimError) as caught:
        read_study(path)
    message = str(caught.value)
    assert caught.value.exit_code == EXIT_USAGE
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    for words in says:
        assert words in message


def test_too_much_at_once_is_refused(write_study):
    numbers = ", ".join(map(str, range(2, 2002)))
    with pytest.raises(InimError, match="24000 validations"):
        read_study(write_study(STUDY.replace("[2, 4]", f"[{numbers}]")))


def test_a_hash_depends_on_deciding_inputs_only(write_study, tmp_path):
    def first(text: str = ONE):
        return units_of(write_study(text))[0].hash

    before = first()
    assert first(ONE.replace("[study]", '[study]\ntitle = "other"')) == before
    assert first(ONE.replace("view_spp = 2", 'min_ssim_to_reference = ""\nview_spp = 2')) == before
    (tmp_path / "one.xml").rename(tmp_path / "renamed.xml")
    assert first(ONE.replace("one.xml", "renamed.xml")) == before
    (tmp_path / "renamed.xml").rename(tmp_path / "one.xml")
    changed = [
        first(ONE.replace("view_spp = 2", "view_spp = 4")),
        first(ONE.replace("0 0 300", "0 0 301")),
        first(ONE.replace('["thin", "thick"]', '"thick"')),
        first(ONE.replace("[study]", "[study]\ntime = true")),
        first(ONE.replace("[study]", '[study]\nbackend = "llvm"')),
        first(ONE.replace('["template", "gu2020"]', '["template", "li2012"]')),
        first(ONE.replace("view_spp = 2", 'min_ssim_to_reference = "template:0.5"\nview_spp = 2')),
    ]
    (tmp_path / "one.xml").write_text(scene_text(sphere((0, 0, 0), 1.5)))
    changed.append(first())
    assert len({before, *changed}) == 1 + len(changed)
