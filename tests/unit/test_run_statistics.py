"""RunStatistics of a run: written and read back, and whether two can be compared."""

import math
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import pytest

from inim.display import DISPLAYS
from inim.image.noisy_image import NoisyImage
from inim.scores.document_parts import Conditions
from inim.scores.regression.comparison import check_comparable, compare, differing_conditions
from inim.scores.regression.document import BaselineDocument
from inim.scores.regression.fingerprints import fingerprint, reference_input
from inim.scores.regression.run_statistics import (
    BASELINE,
    RunStatistics,
    read_statistics,
    write_statistics,
)
from inim.scores.regression.scores import ScoreEstimate
from inim.scores.regression.tiles import tile_statistics
from inim.system.errors import EXIT_BASELINE, BaselineError
from tests.conftest import small_display
from tests.schemas import completed

DISPLAY = small_display(12, 10, 8)
NOMINAL = DISPLAYS["nominal"].parameters()
MADE = msgspec.convert(
    completed(
        "baseline",
        {
            "conditions": {"viewpoints": {"left": [0.0, 0.0, 400.0, 0.0, None]}},
            "circumstances": {"seed": 0, "title": 'A "b" 鼎'},
        },
    ),
    BaselineDocument,
)
CONDITIONS = MADE.conditions


def with_changes(changes: dict[str, Any]) -> Conditions:
    conditions: Conditions = msgspec.convert(msgspec.to_builtins(CONDITIONS) | changes, Conditions)
    return conditions


SCORE = {"ssim_to_reference": ScoreEstimate(0.9, 0.001, 12.0, -0.01)}


def tiles(noise=0.01):
    halves = 0.3 + noise * np.random.default_rng(1).normal(size=(2, 40, 48, 3))
    return tile_statistics(NoisyImage.from_halves(*halves), (8, 8))


@pytest.fixture
def statistics():
    rgbd = reference_input(DISPLAY, (50, 60), 0.2)
    eia = np.random.default_rng(2).random((*DISPLAY.eia_shape, 3), np.float32)
    return RunStatistics(
        conditions=CONDITIONS,
        circumstances=MADE.circumstances,
        pictures={"truth/left": tiles()},
        scores={"template/left": SCORE},
        fingerprints={"template": fingerprint(rgbd, eia, DISPLAY, exact=True)},
        reported={"template": {"eia ssim": 0.7, "eia psnr_db": None}},
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
    assert not all(v.passed for v in compare(statistics, read_back, "here"))


def test_run_compared_with_itself_passes_every_verdict(statistics):
    verdicts = compare(statistics, statistics, "here")
    assert {v.kind for v in verdicts} == {"picture", "noise", "score", "pixels"}
    assert all(v.passed for v in verdicts)


@pytest.mark.parametrize(
    ("change", "row"),
    [
        ({"pictures": {"truth/left": tiles(noise=0.02)}}, "ground truth: noise"),
        ({"pictures": {"truth/right": tiles()}}, "truth/left: tiles"),
        ({"scores": {"template/right": SCORE}}, "template/left: SSIM to reference"),
    ],
)
def test_each_change_fails_in_its_row(statistics, change, row):
    verdicts = compare(statistics, replace(statistics, **change), "here")
    assert f"{row} against the baseline" in [v.name for v in verdicts if not v.passed]


@pytest.mark.parametrize(
    ("other", "words"),
    [
        ({"display": NOMINAL | {"pitch_mm": 1.1}}, "display: pitch_mm 1.1, baseline "),
        ({"display": NOMINAL | {"pitch_mm": 1.1, "gap_mm": 3.5}}, ", gap_mm 3.5, baseline "),
        (
            {"viewpoints": {"right": [0.0, 0.0, 400.0, 0.0, None]}},
            "right [0, 0, 400, 0], baseline missing",
        ),
        (
            {"viewpoints": {"left": [0.0, 0.1 + 0.2, 410.0, 0.0, None]}},
            "left [0, 0.3, 410, 0], baseline [",
        ),
        ({"lens model": "thin"}, "lens model thin, baseline text"),
    ],
)
def test_other_conditions_are_named(other, words):
    [phrase] = differing_conditions(CONDITIONS, with_changes(other))
    assert words in phrase


def test_last_bits_of_a_length_are_no_other_condition():
    near = {"viewpoints": {"left": [0.0, 1e-12, 400.0 * (1 + 1e-15), 0.0, None]}}
    assert differing_conditions(CONDITIONS, with_changes(near)) == []


def test_nothing_to_compare_is_an_error_and_no_pass(statistics):
    for empty in (replace(statistics, pictures={}), replace(statistics, scores={})):
        with pytest.raises(BaselineError) as caught:
            check_comparable(empty, CONDITIONS, "here")
        assert caught.value.exit_code == EXIT_BASELINE
