"""RunStatistics of a run: written and read back; changed inputs and verdicts of two runs."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from inim.display import DISPLAYS
from inim.image.noisy_image import NoisyImage
from inim.pipeline.compare import compare_reports
from inim.scores.document_parts import Checks, RunInputs
from inim.scores.regression.comparison import compare
from inim.scores.regression.document import BaselineDocument
from inim.scores.regression.fingerprints import fingerprint, reference_input
from inim.scores.regression.inputs import changed_inputs, paired_algorithms
from inim.scores.regression.run_statistics import (
    BASELINE,
    RunStatistics,
    read_statistics,
    write_statistics,
)
from inim.scores.regression.scores import ScoreEstimate
from inim.scores.regression.tiles import tile_statistics
from inim.system.errors import BaselineError
from tests.conftest import small_display
from tests.schemas import completed

DISPLAY = small_display(12, 10, 8)
NOMINAL = DISPLAYS["nominal"].parameters()
MADE = msgspec.convert(
    completed(
        "baseline",
        {
            "inputs": {
                "elements": {},
                "files": {},
                "viewpoints": {"left": [0.0, 0.0, 400.0, 0.0, None]},
                "algorithms": ["template"],
            },
            "circumstances": {"seed": 0, "title": 'A "b" 鼎'},
        },
    ),
    BaselineDocument,
)
INPUTS = MADE.inputs


def with_changes(changes: dict[str, Any]) -> RunInputs:
    inputs: RunInputs = msgspec.convert(msgspec.to_builtins(INPUTS) | changes, RunInputs)
    return inputs


SCORE = {"ssim_to_reference": ScoreEstimate(0.9, 0.001, 12.0, -0.01)}


def tiles(noise=0.01):
    halves = 0.3 + noise * np.random.default_rng(1).normal(size=(2, 40, 48, 3))
    return tile_statistics(NoisyImage.from_halves(*halves), (8, 8))


@pytest.fixture
def statistics():
    rgbd = reference_input(DISPLAY, (50, 60), 0.2)
    eia = np.random.default_rng(2).random((*DISPLAY.eia_shape, 3), np.float32)
    return RunStatistics(
        inputs=INPUTS,
        circumstances=MADE.circumstances,
        pictures={"truth/left": tiles()},
        scores={"template/left": SCORE},
        fingerprints={"template": fingerprint(rgbd, eia, DISPLAY, exact=True)},
    )


def test_written_statistics_are_read_back(statistics, tmp_path):
    accepted = replace(statistics, reason="because", accepted="2026-01-01")
    assert write_statistics(tmp_path, BASELINE, accepted) == ["baseline.json", "baseline.npz"]
    read_back = read_statistics(tmp_path, BASELINE)
    assert replace(read_back, pictures={}, fingerprints={}) == replace(
        accepted, pictures={}, fingerprints={}
    )
    for name, array in accepted.pictures["truth/left"].arrays().items():
        np.testing.assert_array_equal(read_back.pictures["truth/left"].arrays()[name], array)
    np.testing.assert_array_equal(
        read_back.fingerprints["template"].sample, accepted.fingerprints["template"].sample
    )


def test_arrays_of_another_run_are_refused(statistics, tmp_path):
    write_statistics(tmp_path, BASELINE, statistics)
    old = (tmp_path / "baseline.json").read_bytes()
    other = {
        "truth/left": tile_statistics(NoisyImage.from_image(np.full((40, 48, 3), 0.5)), (8, 8))
    }
    write_statistics(tmp_path, BASELINE, replace(statistics, pictures=other))
    (tmp_path / "baseline.json").write_bytes(old)
    with pytest.raises(BaselineError, match="belongs to another run"):
        read_statistics(tmp_path, BASELINE)


def test_a_score_that_is_not_a_number_stays_none(statistics, tmp_path):
    wrong = {"template/left": {"ssim_to_reference": ScoreEstimate(math.nan, 0.1, 1.0, 0.0)}}
    write_statistics(tmp_path, BASELINE, replace(statistics, scores=wrong))
    read_back = read_statistics(tmp_path, BASELINE)
    assert math.isnan(read_back.scores["template/left"]["ssim_to_reference"].plain)
    assert not all(v.passed for v in compare(statistics, read_back).checks)


def test_run_compared_with_itself_passes_every_check(statistics):
    comparison = compare(statistics, statistics)
    assert {check.kind for check in comparison.checks} == {"picture", "noise", "score", "pixels"}
    assert all(check.passed for check in comparison.checks)
    assert (comparison.verdict, comparison.inputs) == ("passed", [])


@pytest.mark.parametrize(
    ("change", "row"),
    [
        ({"pictures": {"truth/left": tiles(noise=0.02)}}, "ground truth: noise"),
        ({"pictures": {"truth/right": tiles()}}, "truth/left: tiles"),
        ({"scores": {"template/right": SCORE}}, "template/left: SSIM to reference"),
    ],
)
def test_each_change_fails_in_its_row(statistics, change, row):
    comparison = compare(statistics, replace(statistics, **change))
    failures = [check.name for check in comparison.checks if check.fails_run]
    assert f"{row} against the baseline" in failures
    assert comparison.verdict == "worse"


# --- Changed inputs -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("other", "change"),
    [
        ({"display": NOMINAL | {"pitch_mm": 1.1}}, ("display: pitch_mm", "1", "1.1")),
        (
            {"viewpoints": {"right": [0.0, 0.0, 400.0, 0.0, None]}},
            ("viewpoints: right", None, "[0, 0, 400, 0]"),
        ),
        (
            {"viewpoints": {"left": [0.0, 0.1 + 0.2, 410.0, 0.0, None]}},
            ("viewpoints: left", "[0, 0, 400, 0]", "[0, 0.3, 410, 0]"),
        ),
        ({"lens model": "thin"}, ("lens model", "text", "thin")),
        ({"elements": {"shape ball": "sphere"}}, ("scene: shape ball", None, "sphere")),
        (
            {"algorithms": ["template:samples=1"]},
            ("algorithm template", "template", "template:samples=1"),
        ),
    ],
)
def test_a_changed_input_is_named_with_both_values(other, change):
    changes = changed_inputs(INPUTS, with_changes(other))
    assert change in [(c.name, c.baseline, c.candidate) for c in changes]


def test_a_changed_file_has_its_name_and_place():
    texture = "shape ball / bsdf clay / texture bitmap"
    old, new = (
        with_changes(
            {"elements": {f"{texture} / string filename": sha}, "files": {sha: {"name": name}}}
        )
        for sha, name in (("a" * 64, "clay.png"), ("b" * 64, "clay.png"))
    )
    [change] = changed_inputs(old, new)
    assert change.name == f"file clay.png ({texture})"
    assert change.candidate == f"clay.png {'b' * 12}…"
    moved = with_changes({"elements": old.elements, "files": {"a" * 64: {"name": "copy.png"}}})
    assert changed_inputs(old, moved) == [], "a renamed file has the same content"


def test_an_added_element_is_one_change():
    inside = {"shape ball": "", "shape ball / float radius": "2"}
    changes = changed_inputs(INPUTS, with_changes({"elements": inside}))
    assert [change.name for change in changes] == ["scene: shape ball"]


def test_last_bits_of_a_length_are_no_change():
    near = {"viewpoints": {"left": [0.0, 1e-12, 400.0 * (1 + 1e-15), 0.0, None]}}
    assert changed_inputs(INPUTS, with_changes(near)) == []


def test_algorithms_pair_by_name_then_by_the_only_other_options():
    pairs = paired_algorithms(["a", "b:x=1", "c", "d:y=1"], ["a", "b:x=2", "d:y=2", "d:y=3"])
    assert pairs == {"a": "a", "b:x=1": "b:x=2"}


LOW = {"ssim_to_reference": ScoreEstimate(0.8, 0.001, 12.0, -0.01)}
HIGH = {"ssim_to_reference": ScoreEstimate(0.95, 0.001, 12.0, -0.01)}
LIGHTER = {"truth/left": tile_statistics(NoisyImage.from_image(np.full((40, 48, 3), 0.5)), (8, 8))}
OTHER = {"inputs": with_changes({"lens model": "thin"})}


@pytest.mark.parametrize(
    ("change", "verdict", "passes", "allowed"),
    [
        ({}, "passed", True, True),
        ({"scores": {"template/left": HIGH}}, "improved", True, True),
        ({"scores": {"template/left": HIGH}, "pictures": LIGHTER}, "worse", False, False),
        ({"scores": {"template/left": LOW}}, "worse", False, False),
        (OTHER, "inputs changed, scores within intervals", True, True),
        (OTHER | {"pictures": LIGHTER}, "inputs changed, scores within intervals", True, True),
        (
            OTHER | {"scores": {"template/left": LOW}},
            "inputs changed, scores changed",
            False,
            True,
        ),
        (OTHER | {"scores": {"mine/up": LOW}}, "not comparable", False, False),
    ],
)
def test_verdict_and_whether_it_passes(statistics, change, verdict, passes, allowed):
    candidate = replace(statistics, **change)
    for allow, expected in ((False, passes), (True, allowed)):
        comparison = compare(statistics, candidate, allow_changed_inputs=allow)
        assert comparison.verdict == verdict
        assert Checks.of(comparison.checks).passed is expected


def test_other_options_of_an_algorithm_are_compared_with_the_old_ones(statistics):
    inputs = with_changes({"algorithms": ["template:samples=1"]})
    name = "template:samples=1"
    candidate = replace(
        statistics,
        inputs=inputs,
        scores={f"{name}/left": LOW},
        fingerprints={name: statistics.fingerprints["template"]},
    )
    comparison = compare(statistics, candidate)
    assert (comparison.verdict, comparison.not_compared) == ("inputs changed, scores changed", [])


def test_a_comparison_of_two_reports_has_no_baseline(statistics, tmp_path, monkeypatch):
    runs = {"a": statistics, "b": replace(statistics, scores={"template/left": LOW})}
    monkeypatch.setattr("inim.pipeline.compare.read_run", lambda path: (None, runs[path.name]))
    data = compare_reports(Path("a"), Path("b"), tmp_path / "out")
    texts = [f"{check.name}: {check.detail}" for check in data.verdict.checks]
    assert "template/left: SSIM to reference: 0.8000, first report 0.9000" in texts
    assert not any("baseline" in text for text in texts)


def test_what_has_no_counterpart_is_named(statistics):
    other = small_display(11, 10, 8)
    candidate = replace(
        statistics,
        inputs=with_changes({"display": NOMINAL | {"lens_columns": 11}}),
        pictures={"truth/left": tiles()},
        fingerprints={
            "template": fingerprint(
                reference_input(other, (50, 55), 0.2),
                np.zeros((*other.eia_shape, 3), np.float32),
                other,
                exact=True,
            )
        },
    )
    assert compare(statistics, candidate).not_compared == ["reference input of template"]


def test_statistics_without_scores_or_images_are_refused(statistics, tmp_path):
    for number, empty in enumerate(({"pictures": {}}, {"scores": {}})):
        write_statistics(tmp_path / str(number), BASELINE, replace(statistics, **empty))
        with pytest.raises(BaselineError, match="no image or no score"):
            read_statistics(tmp_path / str(number), BASELINE)
