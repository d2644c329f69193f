"""The study of the paper's experiments: readings, verdicts and their page."""

import numpy as np
import pytest

from inim.generators import find_sources
from inim.generators.registry import DEFAULT
from reports.bench.paper import inputs, run
from reports.bench.paper.claims import claims, median_interval, verdict
from reports.bench.paper.experiments import COMPILED, GU, LI, LOOPS, NUMPY, TEMPLATE
from reports.bench.paper.inputs import EMPTY, WAVES, spheres, waves
from reports.bench.paper.page import page
from reports.bench.paper.quality import DEVIATIONS
from reports.bench.paper.readings import (
    ALGORITHMS,
    READINGS,
    Reading,
    Search,
    plain_python,
    search_arrays,
    sources_of,
    surface_depth,
)  # fmt: skip
from reports.bench.paper.scaling import bench_scaling
from reports.bench.study import square_display

DISPLAY = square_display(2)
METHODS = {**READINGS, **DEVIATIONS, GU: Reading(reverse=True)}
PICTURES = pytest.mark.parametrize("picture", [waves, spheres])


@PICTURES
@pytest.mark.parametrize("name", METHODS)
def test_all_forms_of_a_reading_have_the_same_sources(picture, name):
    rgbd, reading = picture(DISPLAY, 2.5), METHODS[name]
    search = Search.of(DISPLAY, rgbd, reading=reading), surface_depth(rgbd), reading
    expected = sources_of(reading, DISPLAY, rgbd)
    assert np.array_equal(search_arrays(*search), expected)
    assert plain_python(*search)() == expected.ravel().tolist()


@PICTURES
def test_readings_and_rival_are_inim_s_algorithms(picture):
    rgbd = picture(DISPLAY, 5)
    for name, algorithm in {**ALGORITHMS, GU: GU}.items():
        sources = sources_of(METHODS[name], DISPLAY, rgbd)
        assert np.array_equal(sources, find_sources(rgbd, DISPLAY, algorithm))


def test_the_corner_of_a_panel_pixel_is_half_a_pixel_to_the_left_and_up():
    rgbd = waves(DISPLAY, 5)
    centre, corner = (
        Search.of(DISPLAY, rgbd, reading=Reading(from_corner=flag)) for flag in (False, True)
    )
    half = 0.5 * DISPLAY.pixel_pitch_mm / DISPLAY.gap_mm / rgbd.pixel_mm
    assert corner.du == pytest.approx(centre.du + half)
    assert corner.dv == pytest.approx(centre.dv + half)
    assert np.array_equal(corner.u, centre.u)


@pytest.mark.parametrize("count", [9, 20])
def test_an_interval_contains_the_median_as_often_as_stated(count):
    random = np.random.default_rng(1)
    ends = [median_interval(random.normal(size=count).tolist()) for _ in range(4000)]
    assert np.mean([low <= 0 <= high for low, high in ends]) > 0.95


@pytest.mark.parametrize(("second", "word"), [
    ((2.1, 3), "yes"), ((1.9, 3), "depends"), ((1, 1.5), "depends"),
])  # fmt: skip
def test_a_verdict_is_yes_only_if_every_interval_is_above_the_limit(second, word):
    result = verdict({"a": (2.5, 2.6), "b": second}, 2.0)
    assert result["verdict"] == word
    assert bool(result["condition"]) == (word == "depends")
    assert verdict({"a": (1, 2), "b": (0.5, 0.6)}, 2.0)["verdict"] == "no"


def results(ratio, growth=1.0):
    """Results in which rivals take `ratio` times as long as all readings, at any size."""

    def times(size):
        us = {**dict.fromkeys(READINGS, 1.0), GU: ratio, LI: ratio, TEMPLATE: 1e-4, DEFAULT: 1e-3}
        us = {name: [v * size ** (growth - 1) if name in READINGS else v] * 6
              for name, v in us.items()}  # fmt: skip
        return {name: dict.fromkeys((LOOPS, NUMPY, COMPILED), v) for name, v in us.items()}

    methods = (*READINGS, GU, LI, TEMPLATE, DEFAULT)
    step = {name: [0.1, 0.05, 0.15] for name in (GU, LI)}
    quality = {
        "covered": 1.0, "psnr": {name: 20.0 + (name == TEMPLATE) for name in methods},
        "wrong": dict.fromkeys(methods, 0.5),
        "ssim": {name: [0.5, 0.4, 0.6] for name in methods},
        "deviations": {name: {"changed": 0.5, "db": -1.0} for name in DEVIATIONS},
        "differences": {GU: {LI: step[LI]}} | dict.fromkeys(READINGS, step),
    }  # fmt: skip
    points = [{"size": n, "pixels": n, "covered": 1.0, "times": times(n)} for n in (1, 10, 100)]
    figures = {f"Fig. {n}": dict.fromkeys((WAVES, EMPTY), points) for n in (12, 13, 14)}
    measured = {name: {"quality": quality, "times": times(1)} for name in (WAVES, EMPTY)}
    paper = {"runs": 6, "processor": "x", "figures": figures}
    return {**measured, "figures": paper}


@pytest.mark.parametrize(("ratio", "growth", "verdicts"), [
    (2.1, 0.9, "yes yes yes yes"), (2.0, 1.0, "no yes no no"), (0.9, 1.1, "no no no no"),
])  # fmt: skip
def test_claims_follow_the_measured_times(ratio, growth, verdicts):
    measured = results(ratio, growth)
    checked = claims(measured, measured["figures"]["figures"])
    words = ("twice as fast as gu2020", "the fastest", "scene pixels", "number of elemental")
    for word, expected in zip(words, verdicts.split(), strict=True):
        word = "with elemental" if "number" in word else word
        of_claim = {c["verdict"] for c in checked if word in c["claim"]}
        assert of_claim == {expected}
    assert {c["verdict"] for c in checked if "SSIM" in c["claim"]} == {"yes"}


def test_the_study_runs_without_files_and_lists_what_it_left_out(renderer, tmp_path, monkeypatch):
    args = run.STUDY.parse(["--data", str(tmp_path), "--runs", "1"])
    assert {*run.STUDY.cases(args)} == {"scaling", "figures", *inputs.SCENES, WAVES, EMPTY}
    monkeypatch.setattr("reports.bench.paper.run.SAMPLE", slice(0, 1))
    points = [(DISPLAY, 1), (square_display(3, 9), 2)]
    monkeypatch.setattr("reports.bench.paper.experiments.figure_points", lambda _: points)
    source = inputs.read_input(WAVES, [])
    assert source.rgbd.shape == (200, 200) and source.rgbd.covered.all()
    measured = {part: run.measure(part, 1) for part in ("figures", WAVES)}
    measured[EMPTY] = measured[WAVES]
    measured["scaling"] = bench_scaling(run.Rounds(1, 1), (1, 4), (1, 3), 2)
    remarks, parts = page(measured)
    assert any("photograph, Athena, Hermes, jade, tripod" in remark for remark in remarks)
    assert [part.plot for part in parts] == ["paper", ""]
    assert {*READINGS} < {*measured[WAVES]["times"]}
