"""Requests of Python values and of text: the same plan, and a command that repeats it.

Expected: a value reaches the plan as it is; the recorded command, typed, makes the same plan; a
wrong type is one line that gives the remedy.
"""

import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import trimesh

import inim
from inim.cli.main import main
from inim.display import DISPLAYS, Display, Viewpoint
from inim.display.settings import Settings
from inim.pipeline import launch
from inim.pipeline.plan import Plan, inputs_of, make_plan
from inim.system.errors import FileError, InimError
from tests.conftest import scene_text, sphere


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.png").touch()
    (tmp_path / "own.py").write_text("raise AssertionError('the plan imports no plugin')")
    path = tmp_path / "ball.xml"
    path.write_text(scene_text(sphere((0, 0, 0), 10)), encoding="utf-8")
    return path


def with_settings(scene: Path, **settings: object) -> Path:
    elements = "".join(f'<default name="inim.{k}" value="{v}"/>' for k, v in settings.items())
    text = scene.read_text("utf-8")
    scene.write_text(text.replace('version="3.0.0">', f'version="3.0.0">{elements}', 1), "utf-8")
    return scene


class NotRunError(Exception):
    pass


@pytest.fixture
def plans(monkeypatch: pytest.MonkeyPatch) -> list[Plan]:
    """Plans of calls and commands, of which nothing is run."""
    plans: list[Plan] = []

    def stop(make_request: Any, *_: Any, **__: Any) -> bool:
        plans.append(make_plan(make_request()))
        raise NotRunError

    monkeypatch.setattr(launch, "validate_in_worker", stop)
    return plans


def planned(plans: list[Plan], scene: Path, **values: Any) -> Plan:
    with pytest.raises(NotRunError):
        inim.validate(scene, "out", **values)
    return plans[-1]


def typed(plans: list[Plan], *words: str) -> Plan:
    count = len(plans)
    main(["validate", *words])
    assert len(plans) == count + 1
    return plans[-1]


LAB = Display(
    pitch_mm=0.7, focal_length_mm=2.5, gap_mm=2.75, pixel_pitch_mm=0.05, lens_columns=60,
    lens_rows=40, lattice="hexagonal", fill_factor=0.9, name="custom",
)  # fmt: skip


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"display": DISPLAYS["phone"]}, ["--display", "phone"]),
        (
            {"display": DISPLAYS["phone"].replace(gap_mm=3.2, name="mine")},
            ["--display", "phone", "-D", "inim.gap_mm=3.2"],
        ),
        ({"algorithms": ["template", "wang2024"]}, ["--algorithms", "template, wang2024"]),
        (
            {"algorithms": {"template": {"samples": np.int64(2), "fill": "all"}, "gu2020": {}}},
            ["--algorithms", "template:samples=2:fill=all,gu2020"],
        ),
        (
            {"viewpoints": ["left", Viewpoint("mine", -20, 0.5, 400), "near=1 2"]},
            ["--viewpoints", "left,mine=-20 0.5 400,near=1 2"],
        ),
        (
            {"viewpoints": [Viewpoint("mine", 0, 0, 400, pupil_mm=4.0, focus_mm=360.5)]},
            ["--viewpoints=mine=0 0 400", "-D", "inim.pupil_mm=4", "-D", "inim.focus_mm=360.5"],
        ),
        (
            {"misalign": {"tilt_x_deg": 1, "gap_mm": 0.1}},
            ["-D", "inim.misalign=tilt_x_deg=1,gap_mm=0.1"],
        ),
        (
            {"definitions": {"inim.fit_share": 0.5, "inim.seed": np.int32(3)}},
            ["-D", "inim.fit_share=0.5", "-D", "inim.seed=3"],
        ),
        ({"eias": {"mine": Path("mine.png")}}, ["--eia", "mine=mine.png"]),
        ({"lens_model": "thin"}, ["--lens-model", "thin"]),
    ],
)  # fmt: skip
def test_values_and_text_make_the_same_plan(scene, plans, values, words):
    from_values = planned(plans, scene, **values)
    from_text = typed(plans, "ball.xml", *words)
    assert inputs_of(from_values) == inputs_of(from_text)
    assert from_values.methods == from_text.methods


@pytest.mark.parametrize(
    ("settings", "values"),
    [
        ({"pitch_mm": 2, "gap_mm": 5, "lens_columns": 7}, {"display": LAB}),
        ({"depth_min_mm": 3, "depth_max_mm": 40}, {"display": LAB}),
        ({"gap_mm": 5}, {"display": DISPLAYS["nominal"]}),
        ({"pupil_mm": 4, "focus_mm": 300}, {"viewpoints": [Viewpoint("mine", 0, 0, 400)]}),
        ({}, {"algorithms": {"template": {"samples": 2}}, "misalign": {"gap_mm": 1 / 3}}),
        ({}, {"definitions": {"inim.seed": 3}, "preview": True, "lazy": True}),
        ({}, {"cameras": 5, "algorithms": "cameras", "plugins": ["own.py"]}),
    ],
)
def test_the_recorded_command_repeats_the_run(scene, plans, settings, values):
    plan = planned(plans, with_settings(scene, **settings), **values)
    again = typed(plans, *plan.command)
    assert inputs_of(again) == inputs_of(plan)
    assert again.settings == plan.settings
    assert again.command == plan.command
    assert again.definitions == plan.definitions


@pytest.mark.parametrize("name", [n for n, d in DISPLAYS.items() if not d.layout.of_cylinders])
@pytest.mark.parametrize(
    "changes",
    [
        {"panel_columns": 500, "panel_rows": 300},
        {"depth_min_mm": 5.0, "depth_max_mm": 9.0},
        {"pitch_mm": 1.1, "elemental_pitch_mm": None},
        {"rotation_deg": 1 / 3, "shift_x_mm": np.float32(0.1)},
        {"lens_columns": 20, "panel_columns": None, "panel_rows": None},
    ],
)
def test_a_display_reaches_the_plan_against_any_scene_setting(scene, plans, name, changes):
    display = DISPLAYS[name].replace(**changes)
    with_settings(scene, depth_min_mm=3, depth_max_mm=40, pitch_mm=2)
    assert planned(plans, scene, display=display).display.replace(name="") == display.replace(
        name=""
    )


@pytest.mark.parametrize(
    "changes",
    [
        {"layers": [(0.5, 1.52)]},
        {"subpixels": "cells", "subpixel_cells": "0.1 0 0 0 -0.1 0", "cell_pattern": "columns"},
        {"lattice": "hexagonal", "aperture": "round", "curved_side": "panel"},
    ],
)
def test_recorded_settings_of_a_display_are_read_back(scene, plans, changes):
    settings = planned(plans, scene, display=DISPLAYS["nominal"].replace(**changes)).settings
    assert msgspec.json.decode(msgspec.json.encode(settings), type=Settings) == settings


def test_a_plan_is_sent_to_the_worker(scene, plans):
    plan = planned(
        plans, scene, display=LAB, algorithms="pickup:spp=4,template", eias={"a": "mine.png"}
    )
    assert pickle.loads(pickle.dumps(plan)) == plan


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"scene": None}, "scene: is a NoneType; give a path"),
        ({"display": 3}, "display: 3 is a int; give a Display"),
        ({"display": LAB, "definitions": {"inim.gap_mm": 3}}, "definitions set inim.gap_mm"),
        ({"algorithms": 3}, "algorithms: 3 is a int"),
        ({"algorithms": []}, "algorithms: none given"),
        ({"algorithms": ["template", None]}, "algorithms: None"),
        ({"algorithms": {"template": 2}}, "give options as a mapping"),
        ({"algorithms": {"template": {"samples": [2]}}}, r"\[2\] is a list; give text or a number"),
        ({"viewpoints": [3]}, r"viewpoints: 3 is a int; give a Viewpoint"),
        ({"viewpoints": []}, "viewpoints: none given"),
        (
            {"viewpoints": [Viewpoint("a", 0, 0, 400, 4.0), Viewpoint("b", 0, 0, 400)]},
            "different pupils",
        ),
        (
            {"viewpoints": Viewpoint("a", 0, 0, 400), "definitions": {"inim.pupil_mm": 3}},
            "remove inim.pupil_mm",
        ),
        ({"lens_model": 3}, "lens model"),
        ({"misalign": 0.5}, "misalign: 0.5 is a float"),
        ({"misalign": {"rotation_deg": None}}, "None is not a number"),
        ({"definitions": 3}, "definitions: is a int; give a mapping"),
        (
            {"definitions": {"inim.seed": True}},
            r"ball\.xml: inim\.seed = .*True.*: must be a whole number",
        ),
        ({"eias": ["a.png"]}, "eias: is a list; give a mapping"),
        ({"eias": {"a": 3}}, r"eias\['a'\]: is a int; give a path"),
        ({"baseline": 3}, "baseline: is a int; give a path"),
        ({"allow_folders": 3}, "allow_folders: is a int; give a path"),
        ({"plugins": 3}, "plugins: is a int; give a path"),
        ({"plugins": "nowhere.paint"}, "--plugin nowhere.paint: no such module"),
        ({"new_scene": {"unit": "mm"}}, "ball.xml is a scene already"),
        ({"scene": trimesh.creation.box()}, "a trimesh has no unit and no up axis"),
        ({"scene": {"type": "sphere"}}, "has the type 'sphere'"),
        ({"scene": {"type": "scene", "relic": {"type": "unknown"}}}, "cannot be written as XML"),
    ],
)
def test_wrong_types_are_one_line(scene, plans, values, says):
    with pytest.raises(InimError, match=says) as raised:
        inim.validate(**({"scene": scene} | values))
    assert "\n" not in str(raised.value)


BALL = {
    "type": "scene",
    "paint": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.5, 0.2, 0.1]}},
    "relic": {"type": "ply", "filename": "relic.ply", "bsdf": {"type": "ref", "id": "paint"}},
}


@pytest.mark.parametrize(
    ("source", "options"),
    [(BALL, None), ("relic.ply", {"unit": "cm", "up": "z"}), (None, {"unit": "cm", "up": "z"})],
    ids=["dictionary", "mesh", "trimesh"],
)
def test_dictionaries_and_meshes_become_scenes_next_to_the_report(scene, plans, source, options):
    box = trimesh.creation.box((1, 2, 3))
    box.export("relic.ply")
    for _ in range(2):  # a second run replaces the first one's files
        plan = planned(plans, source or box, new_scene=options)
    assert plan.request.scene.parent == Path("out-scene") and plan.request.scene.is_file()
    (mesh,) = plan.file.meshes
    assert mesh[1].is_relative_to(scene.parent / "out-scene")
    assert make_plan(replace(plan.request, definitions={})).file.sha256 == plan.file.sha256
    assert typed(plans, *plan.command).request.scene == plan.request.scene
    Path("out-scene/mine.txt").touch()
    Path("out-scene", plan.request.scene.name).unlink()
    Path("out-scene", plan.request.scene.name).symlink_to("mine.txt")
    with pytest.raises(FileError, match="is in the way"):
        inim.validate(source or box, "out", new_scene=options)
