"""One definition of what decides a result: the keys of stages, reports and units, and conditions.

Expected: an input that makes two runs incomparable, or that changes an image, changes the key of
the whole result; a path, a title or the text of a list does not.
"""

from pathlib import Path

import numpy as np
import pytest

from inim.image.files.image import write_rgbd
from inim.image.rgbd import RGBD
from inim.pipeline import plan as plan_module
from inim.pipeline.plan import Plan, inputs_of, make_plan
from inim.pipeline.request import Request
from inim.pipeline.stages import reconstruction, stage
from inim.pipeline.stages.scene import Renderer
from inim.system import cache
from inim.system.backend import Backend
from inim.system.cache import input_digests
from tests.conftest import scene_text, sphere


@pytest.fixture
def plan_of(tmp_path, monkeypatch):
    """Make a plan for a sphere with options of a request."""
    monkeypatch.chdir(tmp_path)
    Path("ball.xml").write_text(scene_text(sphere((0, 0, 0), 1)))

    def make(scene: str = "ball.xml", out: str = "out", **options) -> Plan:
        options = {"algorithms": ("template",), "viewpoints": ("centre", "left")} | options
        return make_plan(Request(Path(scene), Path(out), **options))

    return make


def renderer(device: str = "a processor") -> Renderer:
    llvm = Renderer("auto", None)
    llvm.__dict__["backend"] = Backend("llvm", "llvm_ad_rgb", None, "18", device)
    return llvm


def key(plan: Plan) -> dict[str, str]:
    return input_digests(plan.cache_key())


CONDITIONS = [
    {"definitions": {"inim.pitch_mm": "0.9"}},
    {"definitions": {"inim.fit_share": "0.5"}},
    {"definitions": {"inim.turn_deg": "10"}},
    {"definitions": {"inim.view_pixels_per_lens": "3"}},
    {"definitions": {"inim.capture_pixels_per_pitch": "9"}},
    {"algorithms": ("gu2020",)},
    {"viewpoints": ("centre",)},
    {"lens_model": "pinhole"},
    {"misalign": {"rotation_deg": 0.5}},
    {"lazy": True},
]
CIRCUMSTANCES = [
    {"definitions": {f"inim.{name}": "4"}}
    for name in ("capture_spp", "eia_spp", "view_spp", "reconstruction_spp", "seed")
] + [
    {"definitions": {"inim.score_error": "0.5"}},
    {"definitions": {"inim.min_ssim_to_reference": "0.5"}},
    {"viewpoints": ("left", "centre")},
    {"time": True},
    {"backend": "llvm"},
]


@pytest.mark.parametrize("options", CONDITIONS, ids=str)
def test_what_makes_runs_incomparable_changes_the_key(plan_of, options):
    plan, other = plan_of(), plan_of(**options)
    assert inputs_of(other) != inputs_of(plan)
    assert key(other) != key(plan)


@pytest.mark.parametrize("options", CIRCUMSTANCES, ids=str)
def test_circumstances_change_the_key_of_comparable_runs(plan_of, options):
    plan, other = plan_of(), plan_of(**options)
    assert inputs_of(other) == inputs_of(plan)
    assert key(other) != key(plan)


@pytest.mark.parametrize(
    "options",
    [
        {"scene": "other.xml"},
        {"out": "elsewhere"},
        {"definitions": {"inim.title": "another"}},
        {"definitions": {"inim.algorithms": "template"}, "algorithms": None},
        {"definitions": {"inim.viewpoints": "centre, left"}, "viewpoints": None},
    ],
    ids=str,
)
def test_paths_titles_and_spelling_decide_nothing(plan_of, options):
    Path("other.xml").write_bytes(Path("ball.xml").read_bytes())
    assert key(plan_of(**options)) == key(plan_of())


def test_the_backend_of_a_machine_is_part_of_the_key(plan_of):
    plan = plan_of()
    keys = [input_digests(plan.cache_key(renderer(device))) for device in ("one", "one", "other")]
    assert keys[0] == keys[1] != keys[2]
    assert {n for n in keys[0] if keys[0][n] != keys[2][n]} == {"backend"}


def test_keys_follow_code_versions_and_other_packages(plan_of, monkeypatch):
    plan = plan_of(algorithms=("template", "gu2020"))
    theirs = {"version": "1"}
    keys = [key(plan)]
    for module, name, value in (
        (stage, "code_digest", lambda *_: "edited"),
        (cache, "versions", lambda: {"numpy": "9"}),
        (reconstruction, "foreign_identity", lambda _: theirs),
    ):
        monkeypatch.setattr(module, name, value)
        keys.append(key(plan))
    algorithm = type(plan.methods[0].algorithm)
    monkeypatch.setattr(algorithm, "own", property(lambda self: self.name == "template"))
    for version in ("1", "2"):
        monkeypatch.setattr(plan_module, "identity", lambda *_, v=version: {"version": v})
        keys.append(key(plan))
    assert all(a != b for n, a in enumerate(keys) for b in keys[:n])


def test_the_key_of_a_stage_is_part_of_the_key_of_the_result(plan_of):
    """A handle contributes the same inputs to both."""
    plan = plan_of()
    whole = input_digests(plan.cache_key(renderer()))
    code = stage.RENDERING
    for inputs in ({"optics": plan.optics}, {"renderer": renderer()}):
        parts = input_digests(stage.deciding_inputs(code, **inputs))
        del parts["program"]  # the stage depends on a part of the program
        assert parts.items() <= whole.items()


def test_a_picture_without_a_scene_has_a_key_of_its_pixels(plan_of):
    keys = []
    for name, grey in (("one.exr", 0.5), ("copy.exr", 0.5), ("darker.exr", 0.4)):
        shape = (40, 40)
        color, covered = np.full((*shape, 3), grey), np.ones(shape, bool)
        write_rgbd(Path(name), RGBD(color, np.full(shape, 30.0), covered, 0.5))
        keys.append(key(plan_of(scene=name)))
    assert keys[0] == keys[1] != keys[2]
