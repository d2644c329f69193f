"""Drawn misalignments: what is drawn, the curve through what they cost, and what is said of it.

Expected: draws depend on the seed alone and more of them change none; a curve finds a known law
again, whatever a few draws do; each sentence says what the numbers do.
"""

import json
import math
from itertools import pairwise
from random import Random
from statistics import fmean, pstdev

import pytest
from msgspec.structs import replace

from inim.display import DISPLAYS
from inim.display.misalignment import MISALIGNMENTS, misaligned, misalignment_text
from inim.documents import read_document, schema
from inim.documents.display import FailedDisplay, ToleranceDocument
from inim.documents.parts import DisplayRecord, SceneFileRecord
from inim.errors import FileError, SceneError, UsageError
from inim.report.tolerate import sentences, write_tolerance
from inim.tolerate.findings import (
    Curve,
    aligned_score,
    fit_curve,
    parameter_tolerances,
    share_interval,
    tolerance_interval,
)
from inim.tolerate.study import (
    Spread,
    ToleranceStudy,
    default_spreads,
    read_standard_errors,
    read_tolerance_study,
)
from tests.schemas import example

NOMINAL = DISPLAYS["nominal"]
SPREADS = {"rotation_deg": Spread("normal", 0.01), "gap_mm": Spread("uniform", 0.05)}
STUDY = ToleranceStudy(SPREADS, alone=20, together=60, seed=3)
LAW = {"rotation_deg": Curve(2.0, 0.16, 0.24), "gap_mm": Curve(1.0, 8.0, 6.5)}
CRITERION = 0.01


# -- draws ----------------------------------------------------------------------------------------


def test_draws_of_one_parameter_reach_both_sides_and_leave_no_large_gap():
    draws = STUDY.draw_alone("rotation_deg")
    assert len(draws) == 20 and all(abs(error) <= 0.06 for error in draws)
    places = [-0.06, *sorted(draws), 0.06]
    gaps = [high - low for low, high in pairwise(places)]
    assert max(gaps) < 2.5 * 0.12 / 20


def test_draws_together_scatter_as_their_spreads_say():
    study = ToleranceStudy(SPREADS, together=2000)
    draws = study.draw_together()
    turned, apart = ([draw[name] for draw in draws] for name in SPREADS)
    assert abs(fmean(turned)) < 4 * 0.01 / math.sqrt(2000)
    assert pstdev(turned) == pytest.approx(0.01, rel=0.06)
    assert max(map(abs, apart)) <= 0.05
    assert pstdev(apart) == pytest.approx(0.05 / math.sqrt(3), rel=0.06)
    product = fmean(a * b for a, b in zip(turned, apart, strict=True))
    assert abs(product) < 4 * pstdev(turned) * pstdev(apart) / math.sqrt(2000)


def test_more_draws_add_to_those_there_are_and_another_seed_draws_others():
    more = ToleranceStudy(SPREADS, alone=30, together=70, seed=3)
    assert more.draw_alone("gap_mm")[:20] == STUDY.draw_alone("gap_mm")
    assert more.draw_together()[:60] == STUDY.draw_together()
    other = ToleranceStudy(SPREADS, alone=20, together=60, seed=4)
    assert other.draw_alone("gap_mm") != STUDY.draw_alone("gap_mm")
    assert other.draw_together() != STUDY.draw_together()


@pytest.mark.parametrize("name", sorted(DISPLAYS))
def test_errors_by_the_geometry_are_of_all_that_can_be_off(name):
    spreads = default_spreads(DISPLAYS[name])
    assert spreads.keys() == MISALIGNMENTS.keys()
    study = ToleranceStudy(spreads, alone=5)
    for parameter in spreads:
        for error in study.draw_alone(parameter):
            off = misaligned(DISPLAYS[name], misalignment_text({parameter: error}))
            assert getattr(off, parameter) == getattr(DISPLAYS[name], parameter) + error


def test_a_panel_pixel_at_the_edge_decides_the_errors_by_the_geometry():
    spreads = default_spreads(NOMINAL)
    moved = spreads["shift_x_mm"].size
    # 32 lenses out, each a pitch error farther; and 32 mm out, turned.
    assert 32 * spreads["pitch_mm"].size == pytest.approx(moved, rel=0.05)
    assert 32 * math.radians(spreads["rotation_deg"].size) == pytest.approx(moved, rel=0.05)
    # Rays from twice the nearest distance, 2 x 64 x 3.3 mm, to the edge, 32 mm from the axis.
    assert spreads["gap_mm"].size * 32 / (2 * 64 * 3.3) == pytest.approx(moved, rel=0.05)


# -- a study's file -------------------------------------------------------------------------------


def evaluate_draws(tmp_path, text):
    path = tmp_path / "errors.toml"
    path.write_text(text)
    return read_tolerance_study(path, NOMINAL)


def test_a_study_is_read_with_defaults_for_missing_keys(tmp_path):
    text = (
        "[study]\nalone = 9\nreach = 3\n"
        "[errors]\npitch_mm = { uniform = 0.002 }\ngap_mm = { normal = 1 }\n"
    )
    assert evaluate_draws(tmp_path, text) == ToleranceStudy(
        {"pitch_mm": Spread("uniform", 0.002), "gap_mm": Spread("normal", 1.0)}, alone=9, reach=3.0
    )
    assert evaluate_draws(tmp_path, "") == ToleranceStudy(default_spreads(NOMINAL))
    assert read_tolerance_study(None, NOMINAL) == evaluate_draws(tmp_path, "[study]\nseed = 0")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[error]", "did you mean errors"),
        ("[study]\nalone = 4", r"study\.alone: must be a whole number of at least 5, not 4"),
        ("[study]\nseed = true", r"study\.seed: must be a whole number"),
        ("[study]\nreach = 0", r"study\.reach: must be a positive number, not 0"),
        ("[study]\nreach = nan", r"study\.reach: must be a positive number, not nan"),
        ("[study]\ndraws = 4", r"study\.draws: unknown key"),
        ("[study]\ntogether = 10_000", "10113 displays; at most 10000"),
        ("[errors]\nrotation = { normal = 1 }", "did you mean rotation_deg"),
        ("[errors]\ngap_mm = 1", r"errors\.gap_mm: write \{ normal = SIZE \}, not 1"),
        ("[errors]\ngap_mm = { normal = 1, uniform = 1 }", r"errors\.gap_mm: write"),
        ("[errors]\ngap_mm = { gauss = 1 }", r"errors\.gap_mm\.gauss: unknown key"),
        ("[errors]\ngap_mm = { normal = -1 }", r"errors\.gap_mm\.normal: must be a positive"),
        ("errors = 1", r"errors: write it as a table"),
    ],
)
def test_invalid_study_is_rejected_with_the_key(tmp_path, text, says):
    with pytest.raises(UsageError, match=says):
        evaluate_draws(tmp_path, text)


def test_files_that_are_no_study_are_refused(tmp_path):
    with pytest.raises(FileError, match=r"errors\.toml: no TOML"):
        evaluate_draws(tmp_path, "[")
    with pytest.raises(FileError, match="nothing"):
        read_tolerance_study(tmp_path / "nothing.toml", NOMINAL)


# -- the curve ------------------------------------------------------------------------------------


def losses_of(law, errors, noise=0.0, seed=0):
    random = Random(seed)
    return [law.loss(error) + random.gauss(0, noise) for error in errors]


@pytest.mark.parametrize("power", [1.0, 1.5, 2.0, 3.0])
def test_a_known_law_is_recovered(power):
    law = Curve(power, 0.8, 0.6)
    errors = ToleranceStudy({"gap_mm": Spread("uniform", 0.1)}, alone=16).draw_alone("gap_mm")
    evaluated = fit_curve(errors, losses_of(law, errors), CRITERION)
    tolerance = 0.6 * (-math.log(1 - CRITERION)) ** (1 / power)
    assert law.tolerance(CRITERION) == pytest.approx(tolerance)
    assert law.loss(tolerance) == pytest.approx(CRITERION)
    assert evaluated.tolerance(CRITERION) == pytest.approx(tolerance, rel=0.01)


def test_a_few_outliers_change_little():
    law, errors = LAW["rotation_deg"], STUDY.draw_alone("rotation_deg")
    losses = losses_of(law, errors, 2e-4)
    tolerance = law.tolerance(CRITERION)
    for i in (3, 11):
        losses[i] += 0.1
    assert fit_curve(errors, losses, CRITERION).tolerance(CRITERION) == pytest.approx(
        tolerance, rel=0.05
    )


def test_the_smaller_of_both_ways_counts():
    law = Curve(2.0, 0.1, 5.0)
    assert law.tolerance(CRITERION) == pytest.approx(0.1 * math.sqrt(-math.log(0.99)))
    assert law.loss(-0.05) > law.loss(0.05)


def test_an_error_without_loss_tolerates_more_than_was_drawn():
    errors = STUDY.draw_alone("gap_mm")
    losses = losses_of(Curve(1.0, 1e9, 1e9), errors, 1e-4)
    evaluated = fit_curve(errors, losses, CRITERION)
    assert evaluated.tolerance(CRITERION) > 0.3
    assert tolerance_interval(evaluated, errors, losses, 0.3, CRITERION, "s")[1] is None
    scores = scores_of(STUDY, LAW | {"gap_mm": Curve(1.0, 1e9, 1e9)})
    row = parameter_tolerances(STUDY, scores, CRITERION, {})[0][1]
    assert row.tolerance is None and row.interval == (None, None)


@pytest.mark.slow
def test_the_interval_holds_the_truth_as_a_rule_and_shrinks_with_less_noise():
    law = LAW["rotation_deg"]
    tolerance = law.tolerance(CRITERION)

    def interval(noise, seed):
        errors = ToleranceStudy(SPREADS, alone=20, seed=seed).draw_alone("rotation_deg")
        losses = losses_of(law, errors, noise, seed)
        curve = fit_curve(errors, losses, CRITERION)
        return tolerance_interval(curve, errors, losses, 0.06, CRITERION, "s")

    evaluated = [interval(1e-3, seed) for seed in range(6)]
    assert sum(low <= tolerance <= high for low, high in evaluated) >= 5
    low, high = interval(1e-4, 0)
    assert high - low < (evaluated[0][1] - evaluated[0][0]) / 3
    assert interval(1e-4, 0) == [low, high]


def test_the_interval_of_a_share_is_wilson_s():
    # Newcombe 1998, Table I, method 3: 81 of 263, 15 of 148, none of 20, one of 29.
    for passed, of, low, high in (
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ):
        assert share_interval(passed, of) == pytest.approx((low, high), abs=6e-5)
    assert share_interval(20, 20)[1] == 1.0


# -- what the draws say ---------------------------------------------------------------------------


def scores_of(study, law=LAW, aligned=0.98):
    draws = [{name: e} for name in study.spreads for e in study.draw_alone(name)]
    draws += study.draw_together()
    return {"": aligned} | {
        misalignment_text(draw): aligned
        - sum(law[name].loss(error) for name, error in draw.items())
        for draw in draws
    }


def document_of(scores, reached=(), **changes):
    parameters, together = parameter_tolerances(STUDY, scores, CRITERION, dict(reached))
    values = {
        "title": "T <b>&", "created": "2026-11-23T05:00:00+00:00", "inim_version": "1",
        "command": "inim tolerate s.xml", "scene": SceneFileRecord(path="s.xml", sha256="0" * 64),
        "display": DisplayRecord.of(NOMINAL), "viewpoints": ["centre"], "algorithm": "pickup",
        "criterion": CRITERION, "reach": 6.0, "seed": 3, "aligned": aligned_score(scores),
        "parameters": parameters, "together": together, "failed": [],
    }  # fmt: skip
    return ToleranceDocument(**values | changes)


@pytest.fixture(scope="module")
def evaluated():
    return document_of(scores_of(STUDY), {"rotation_deg": 0.002, "gap_mm": 0.1})


def test_each_parameter_alone_has_the_tolerance_of_its_law(evaluated):
    assert [row.name for row in evaluated.parameters] == ["rotation_deg", "gap_mm"]
    for row in evaluated.parameters:
        tolerance = LAW[row.name].tolerance(CRITERION)
        assert row.tolerance == pytest.approx(tolerance, rel=0.01)
        assert row.interval[0] <= row.tolerance <= row.interval[1]
        assert row.scatter < 1e-3 and len(row.draws) == 20
        line = row.curve.line
        assert line[0][0] == -row.farthest == -line[-1][0]
        assert line[20] == (0, 0)


def test_losses_that_add_up_are_reported_as_such(evaluated):
    together = evaluated.together
    assert together.to_sum == pytest.approx(1, abs=0.02)
    lost = [evaluated.aligned - draw.score for draw in together.draws]
    assert together.share == sum(loss <= CRITERION for loss in lost) / 60
    assert 0.2 < together.share < 1
    whole = sum(
        LAW[row.name].loss(side * together.part_of_each * row.tolerance)
        for row, side in zip(evaluated.parameters, (-1, 1), strict=True)
    )
    assert whole == pytest.approx(CRITERION, rel=0.02)


def test_displays_that_failed_are_left_out_and_too_few_say_nothing():
    scores = scores_of(STUDY)
    for i, error in enumerate(STUDY.draw_alone("gap_mm")):
        if i >= 4:
            scores[misalignment_text({"gap_mm": error})] = None
    for draw in STUDY.draw_together()[:10]:
        scores[misalignment_text(draw)] = None
    (_, gap), together = parameter_tolerances(STUDY, scores, CRITERION, {})
    assert (gap.tolerance, gap.interval, gap.curve, gap.scatter) == (None,) * 4
    assert len(gap.draws) == 4
    assert len(together.draws) == 50
    assert together.to_sum is None
    with pytest.raises(SceneError, match="no score"):
        parameter_tolerances(STUDY, scores | {"": None}, CRITERION, {})


# -- the report -----------------------------------------------------------------------------------


def plainly(lines):
    return [line.replace("\u00a0", " ") for line in lines]


def test_the_sentences_agree_with_the_numbers(evaluated):
    turned, apart, share, sums = plainly(sentences(evaluated))
    row = evaluated.parameters[0]
    low, high = row.interval
    assert turned == (
        f"With this sheet, rotation must be known to {row.tolerance:.3g} deg (95 % interval "
        f"{low:.3g} to {high:.3g}). A calibration reaches 0.00392 deg in 95 % of cases: "
        f"{row.tolerance / 0.00392:.2g} times better than needed."
    )
    assert apart.endswith("A calibration reaches 0.196 mm in 95 % of cases: not good enough.")
    assert f"{evaluated.together.share:.0%}".replace("%", " %") in share
    assert "60 displays" in share
    assert sums.startswith(
        "The loss of all errors together is 1 times the sum of the single losses"
    )


def test_a_tolerance_beyond_all_draws_is_stated_as_such(evaluated):
    rows = [
        replace(evaluated.parameters[0], tolerance=None, interval=(None, None)),
        replace(evaluated.parameters[1], interval=(0.1, None)),
    ]
    turned, apart = plainly(sentences(replace(evaluated, parameters=rows, together=None)))
    assert turned == "Rotation may deviate by 0.06 deg or more; use a larger reach."
    assert "(95 % interval 0.1 to beyond the drawn range)" in apart


def test_document_reads_back_and_the_page_shows_it(evaluated, tmp_path):
    document = replace(evaluated, failed=[FailedDisplay(display="s · <off>", error="why")])
    write_tolerance(document, tmp_path)
    assert read_document(tmp_path / "tolerate.json", "", ToleranceDocument) == document
    page = (tmp_path / "tolerate.html").read_text("utf-8")
    assert "T &lt;b&gt;&amp;" in page and "s · &lt;off&gt;: why" in page
    assert page.count("data:image/svg+xml") == 3
    assert "must be known to" in page


# -- what a calibration reaches -------------------------------------------------------------------


def calibration_of(**errors):
    """A calibration's text, with standard errors by parameter."""
    estimate = {
        "value": 0.0, "low": 0.0, "high": 0.0, "largest_standard_error": 1.0, "nominal": 0.0,
    }  # fmt: skip
    parameters = {
        name: estimate | {"standard_error": error, "is_determined": name != "pitch_mm"}
        for name, error in errors.items()
    }
    return json.dumps(example(schema("calibration"), "calibration") | {"parameters": parameters})


def test_standard_errors_are_read_where_a_calibration_has_them(tmp_path):
    path = tmp_path / "calibration.json"
    path.write_text(calibration_of(rotation_deg=0.002, pitch_mm=0.1, focal_length_mm=0.1))
    assert read_standard_errors(path) == {"rotation_deg": 0.002}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[", "not a JSON document"),
        ("[" * 100_000, "nested too deeply"),
        ('{"parameters": {"gap_mm": {"standard_error": 1}}}', "schema is null"),
        (calibration_of(gap_mm="wide"),
         "Expected `float`, got `str` - at `$.parameters[...].standard_error`"),
        (calibration_of(gap_mm=math.nan), "NaN"),
        (calibration_of(gap_mm=-1),
         "parameters.gap_mm.standard_error is -1, not a positive number"),
    ],
)  # fmt: skip
def test_files_that_are_no_calibration_are_refused(tmp_path, text, words):
    path = tmp_path / "calibration.json"
    path.write_text(text)
    with pytest.raises(FileError) as caught:
        read_standard_errors(path)
    assert words in str(caught.value)
    assert str(caught.value).startswith(f"{path}: ")
    assert str(caught.value).endswith("give the calibration.json that a calibration wrote")
