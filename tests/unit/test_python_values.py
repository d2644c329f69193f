"""`inim.validate` with Python values: the request is the one that the text makes."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from inim.cli import main
from inim.commands import validate as command
from inim.display import DISPLAYS, Display, Viewpoint
from inim.errors import UsageError
from inim.pipeline import validation
from inim.pipeline.plan import conditions_of, make_plan
from inim.pipeline.request import Request
from tests.conftest import scene_text, sphere


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "ball.xml"
    path.write_text(scene_text(sphere((0, 0, 0), 10)), encoding="utf-8")
    return path


def with_settings(scene: Path, **settings: object) -> Path:
    elements = "".join(f'<default name="inim.{k}" value="{v}"/>' for k, v in settings.items())
    text = scene.read_text("utf-8")
    scene.write_text(text.replace('version="3.0.0">', f'version="3.0.0">{elements}', 1), "utf-8")
    return scene


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch):
    """The request of a call, of which nothing is run."""
    requests: list[Request] = []

    class NotRunError(Exception):
        pass

    def stop(request: Request, **_: Any) -> bool:
        requests.append(request)
        raise NotRunError

    monkeypatch.setattr(validation, "validate_in_worker", stop)

    def ask(scene: Path, **values: Any) -> Request:
        with pytest.raises(NotRunError):
            validation.validate(scene, "out", **values)
        return requests[-1]

    return ask


LAB = Display(
    pitch_mm=0.7, focal_length_mm=2.5, gap_mm=2.75, pixel_pitch_mm=0.05, lens_columns=60,
    lens_rows=40, lattice="hexagonal", fill_factor=0.9, name="custom",
)  # fmt: skip


@pytest.mark.parametrize(
    ("values", "texts"),
    [
        ({"display": DISPLAYS["phone"]}, {"display": "phone"}),
        (
            {"display": DISPLAYS["phone"].replace(gap_mm=3.2, name="mine")},
            {"display": "phone", "definitions": {"inim.gap_mm": "3.2"}},
        ),
        ({"algorithms": ["template", "wang2024"]}, {"algorithms": "template,wang2024"}),
        (
            {"algorithms": ["template:samples=2", {"wang2024": {}}]},
            {"algorithms": "template:samples=2,wang2024"},
        ),
        (
            {"algorithms": {"template": {"samples": np.int64(2), "fill": "all"}, "gu2020": {}}},
            {"algorithms": "template:samples=2:fill=all,gu2020"},
        ),
        (
            {"viewpoints": ["left", Viewpoint("mine", -20, 0.5, 400), "near=1 2"]},
            {"viewpoints": "left,mine=-20 0.5 400,near=1 2"},
        ),
        ({"viewpoints": Viewpoint("mine", -20, 0, 400)}, {"viewpoints": "mine=-20 0 400"}),
        (
            {"viewpoints": [Viewpoint("mine", 0, 0, 400, pupil_mm=4.0, focus_mm=360.5)]},
            {
                "viewpoints": "mine=0 0 400",
                "definitions": {"inim.pupil_mm": "4", "inim.focus_mm": "360.5"},
            },
        ),
        (
            {"misalign": {"rotation_deg": 0.5, "gap_mm": 0.1}},
            {"misalign": "rotation_deg=0.5, gap_mm=0.1"},
        ),
        (
            {"definitions": {"inim.fit_share": 0.5, "inim.seed": np.int32(3)}},
            {"definitions": {"inim.fit_share": "0.5", "inim.seed": "3"}},
        ),
        ({"eias": {"mine": Path("mine.png")}}, {"eias": {"mine": "mine.png"}}),
        ({"lens_model": "thin"}, {"lens_model": "thin"}),
    ],
)
def test_values_make_the_request_of_their_text(scene, asked, values, texts):
    assert asked(scene, **values) == asked(scene, **texts)


def test_a_display_of_one_s_own_reaches_plan_and_command(scene, asked, monkeypatch):
    request = asked(with_settings(scene, pitch_mm=2, gap_mm=5, lens_columns=7), display=LAB)
    plan = make_plan(request)
    assert plan.display.replace(name="custom") == LAB, "whatever the scene says"
    seen = []
    monkeypatch.setattr(command, "validate_in_worker", None, raising=False)
    monkeypatch.setattr(
        "inim.pipeline.validation.validate_in_worker",
        lambda request, **_: seen.append(request) or True,
    )
    words = shlex.split(shlex.join(request.command()))
    assert main(["validate", *words, "--quiet"]) == 0
    assert seen == [request], "typed, the report's command makes the same request"
    assert conditions_of(make_plan(seen[0])) == conditions_of(plan)


@pytest.mark.parametrize("name", list(DISPLAYS))
@pytest.mark.parametrize(
    "changes",
    [
        {"panel_columns": 500, "panel_rows": 300},
        {"depth_min_mm": 5.0, "depth_max_mm": 9.0},
        {"pitch_mm": 1.1},
        {"rotation_deg": 1 / 3, "shift_x_mm": np.float32(0.1)},
        {"lens_columns": 20, "panel_columns": None, "panel_rows": None},
    ],
)
def test_any_display_can_be_stated(scene, asked, name, changes):
    display = DISPLAYS[name].replace(**changes)
    made = make_plan(asked(scene, display=display)).display
    assert made.replace(name="") == display.replace(name="")


def test_what_a_scene_sets_and_a_display_leaves_open_is_asked_about(scene, asked):
    with_settings(scene, depth_min_mm=3, depth_max_mm=40)
    with pytest.raises(UsageError, match=r"the scene sets inim.depth_max_mm, inim.depth_min_mm"):
        validation.validate(scene, display=LAB)


def test_a_scene_s_pupil_yields_to_the_viewpoint_s(scene, asked):
    with_settings(scene, pupil_mm=4)
    request = asked(scene, viewpoints=[Viewpoint("mine", 0, 0, 400)])
    assert request.definitions == ("inim.pupil_mm=0",)


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"display": 3}, "display: 3 is a int"),
        ({"display": LAB, "definitions": {"inim.gap_mm": 3}}, "definitions set inim.gap_mm"),
        ({"algorithms": 3}, "algorithms: 3 is a int"),
        ({"algorithms": []}, "algorithms: none given"),
        ({"algorithms": ["template", None]}, "algorithms: None"),
        ({"algorithms": {"template": 2}}, "give options as a mapping"),
        ({"algorithms": {"template": {"samples": [2]}}}, r"\[2\] is a list; give text or a number"),
        ({"viewpoints": [(1, 2, 3)]}, r"viewpoints: \(1, 2, 3\) is a tuple"),
        (
            {"viewpoints": [Viewpoint("a", 0, 0, 400, 4.0), Viewpoint("b", 0, 0, 400)]},
            "different pupils",
        ),
        ({"lens_model": thick} if (thick := object()) else {}, "lens_model: <object"),
        ({"misalign": 0.5}, "misalign: 0.5 is a float"),
        ({"misalign": {"rotation_deg": None}}, "misalign: None is a NoneType"),
        ({"definitions": ["a=b"]}, "definitions: is a list; give a mapping"),
        ({"definitions": {"inim.seed": True}}, "True is a bool; give text or a number"),
        ({"eias": ["a.png"]}, "eias: is a list; give a mapping"),
        ({"eias": {"a": 3}}, r"eias\['a'\]: is a int; give a path"),
        ({"baseline": 3}, "baseline: is a int; give a path"),
        ({"allow_folders": 3}, "allow_folders: is a int; give a path, or a list"),
    ],
)
def test_wrong_types_are_one_line(scene, values, says):
    with pytest.raises(UsageError, match=says) as raised:
        validation.validate(scene, **values)
    assert "\n" not in str(raised.value)


def test_a_scene_is_a_path():
    with pytest.raises(UsageError, match="scene: is a NoneType; give a path"):
        validation.validate(None)  # type: ignore[arg-type]


def test_one_allowed_folder_is_one(scene, asked, tmp_path):
    assert asked(scene, allow_folders=str(tmp_path)).allow_folders == (tmp_path,)
