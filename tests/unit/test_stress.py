"""Relations of the stress run: each kind can fail, for anybody's algorithm and lens model.

Faults are planted, and the relations that cover the changed module must break. The table of many
more planted faults is `reports/stress/faults.md`.
"""

import numpy as np
import pytest

from inim.apps.stress.relation import (
    QUICK,
    TOPICS,
    Deviation,
    Relation,
    all_relations,
    difference,
    excess,
    is_true,
    run_relation,
)
from inim.apps.stress.run import StressRequest, verdict_lines
from inim.display import lens as lens_models
from inim.display.layouts import Hexagonal
from inim.generators import algorithm_items
from inim.generators.raycast import columns
from inim.image import color
from inim.system.errors import UsageError
from tests.system.conftest import install_metadata

RELATIONS = {relation.name: relation for relation in all_relations()}


def result_of(name: str, subject: str = ""):
    return run_relation(RELATIONS[name], subject, QUICK)


# -- declarations -------------------------------------------------------------------------------


def test_every_relation_states_its_claim_its_source_and_existing_modules():
    from importlib.util import find_spec

    names = [relation.name for relation in all_relations()]
    assert len(names) == len(set(names)) > 50
    for relation in all_relations():
        assert relation.claim.endswith(".") and relation.source and relation.unit, relation.name
        assert relation.topic in TOPICS
        for module in relation.covers:
            assert find_spec(f"inim.{module}"), (relation.name, module)


def test_a_relation_reaches_the_modules_of_a_package_only():
    relation = RELATIONS["rays of pixels"]
    assert relation.reaches("inim.display.layouts.hexagonal")
    assert not relation.reaches("inim.display.layouts_of_others")
    assert not relation.reaches("inim.scores.metrics.ssim")


# -- verdicts -----------------------------------------------------------------------------------


def verdict(*deviations: Deviation, **changes: object):
    relation = Relation(
        "r", "displays", lambda *_: iter(deviations), ("display",), 2.0, "ulp", "none",
        **changes,
    )  # fmt: skip
    return run_relation(relation, "", QUICK)


def test_a_relation_holds_up_to_its_limit_and_not_beyond():
    assert verdict(Deviation("a", 2.0), Deviation("b", 0.0)).passed
    broken = verdict(Deviation("a", 2.0), Deviation("b", 2.1))
    assert not broken.passed and (broken.worst, broken.worst_case) == (2.1, "b")


@pytest.mark.parametrize("worst", [np.nan, np.inf])
def test_what_is_not_a_number_never_holds(worst):
    assert not verdict(Deviation("a", 0.0), Deviation("b", worst)).passed


def test_no_case_is_a_failure_and_a_warned_one_is_no_case():
    assert not verdict().passed
    assert not verdict(Deviation("a", 9.0, warned=True)).passed
    assert verdict(Deviation("a", 9.0, warned=True), Deviation("b", 1.0)).passed


def test_a_crash_is_a_result_and_what_is_not_promised_is_measured():
    def crash(*_):
        raise ZeroDivisionError("by planting")
        yield

    relation = Relation("r", "displays", crash, ("display",), 0.0, "ulp", "none")
    result = run_relation(relation, "", QUICK)
    assert not result.passed and result.message == "ZeroDivisionError: by planting"
    measured = verdict(Deviation("a", 9.0, 10, 3), explain=lambda _: "another definition")
    assert measured.passed and measured.share == 0.3


def test_deviations_compare_infinities_shapes_and_statements():
    assert difference("", [np.inf, np.nan, 1.0], [np.inf, np.nan, 1.5], 0.25).worst == 2.0
    assert difference("", [1.0], [np.nan]).worst == np.inf
    assert difference("", [1.0, 2.0], [1.0]).worst == np.inf
    assert excess("", [1.0, 3.0], 2.5).worst == 0.5 and excess("", [], 0.0).worst == 0.0
    assert is_true("", [True, False]).worst == np.inf and is_true("", True).worst == 0


# -- planted faults -----------------------------------------------------------------------------


def test_a_mirrored_stagger_of_rows_breaks_the_rays(monkeypatch):
    assert result_of("rays of pixels").passed
    find_rays = Hexagonal.find_rays

    def mirrored(self, x, y, offset):
        lens, x0, y0 = find_rays(self, -x, y, offset)
        return lens, -x0, y0

    monkeypatch.setattr(Hexagonal, "find_rays", mirrored)
    assert not result_of("rays of pixels").passed


def test_a_lens_model_with_a_wrong_sign_breaks(monkeypatch):
    from dataclasses import replace

    thin = lens_models.lens_model("thin")

    def wrong(array, traits, ops, x, y, sx, sy, index):
        ray = thin.trace(array, traits, ops, x, y, sx, sy, index)
        return ray._replace(y=2 * y - ray.y)

    assert result_of("panel points of lenses", "thin").passed
    monkeypatch.setitem(lens_models._OWN, "thin", replace(thin, trace=wrong))
    lens_models.lens_model.cache_clear()
    try:
        assert not result_of("panel points of lenses", "thin").passed
    finally:
        monkeypatch.undo()
        lens_models.lens_model.cache_clear()


def test_a_thinner_column_breaks_first_hits(monkeypatch):
    assert result_of("first hits", "template").passed
    monkeypatch.setattr(columns, "THICKNESS_PX", 9.0)
    assert not result_of("first hits", "template").passed


def test_a_wrong_constant_of_a_metric_or_of_the_curve_breaks(monkeypatch):
    assert result_of("SSIM and PSNR").passed and result_of("the sRGB curve").passed
    from importlib import import_module

    settings = import_module("inim.scores.metrics.ssim")._SETTINGS
    monkeypatch.setitem(settings, "sigma", 1.4)
    assert not result_of("SSIM and PSNR").passed
    monkeypatch.setattr(color, "_KNEE", 0.0032)
    assert not result_of("the sRGB curve").passed


# -- algorithms of other packages ---------------------------------------------------------------


@pytest.fixture
def planted(tmp_path, monkeypatch):
    """Announce an algorithm `planted` as another package would; its fault is an option."""
    (tmp_path / "planted_eia.py").write_text(
        """
import numpy as np
from inim.system.errors import UsageError
from inim.generators import SourceGenerator, prepare as own

def prepare(display, shape, pixel_mm, *, fault="none"):
    '''An algorithm with a fault to choose.'''
    if fault == "refuses":
        raise UsageError("not today")
    name = "template:samples=1:colour=nearest"
    right = own(display, name, shape=shape, pixel_mm=pixel_mm)
    return Colours(right) if fault == "colours" else Sources(display, shape, pixel_mm, right, fault)

class Sources(SourceGenerator):
    calls = 0

    def __init__(self, display, shape, pixel_mm, right, fault):
        super().__init__(display, shape, pixel_mm)
        self.right, self.fault = right, fault

    def find(self, rgbd):
        Sources.calls += 1
        if self.fault == "crash":
            raise ZeroDivisionError("by planting")
        found = self.right.find(rgbd)
        if self.fault == "stale":
            self.first = getattr(self, "first", found)
            return self.first.copy()
        by = {"lens": 5, "fickle": Sources.calls}.get(self.fault, 0)
        return np.roll(found, by, axis=1)

class Colours:
    def __init__(self, right):
        self.right = right

    def generate(self, rgbd, out=None):
        return self.right.generate(rgbd, out)
"""
    )
    install_metadata(tmp_path, "planted", "[inim.generators]\nplanted = planted_eia:prepare\n")
    monkeypatch.syspath_prepend(tmp_path)
    return "planted"


@pytest.mark.parametrize(
    ("fault", "relation", "passed"),
    [
        ("none", "moved by a lens", True),
        ("none", "split panels", True),
        ("colours", "split panels", True),
        ("colours", "scaled by powers of two", True),
        ("fickle", "one thread or all", False),
        ("fickle", "split panels", False),
        ("stale", "streams of pictures", False),
        ("lens", "mirrored", False),
        ("crash", "moved by a lens", False),
    ],
)
def test_somebody_else_s_algorithm_keeps_relations_or_breaks_them(planted, fault, relation, passed):
    result = result_of(relation, f"{planted}:fault={fault}")
    assert result.passed is passed
    assert bool(result.message) is (fault == "crash")


def test_the_share_of_wrong_sources_is_stated_and_not_a_failure(planted):
    result = result_of("first hits", f"{planted}:fault=lens")
    assert result.passed and result.explained and result.share > 0.1 and result.farthest > 1
    (line,) = verdict_lines([result])
    assert line.startswith("ok") and "% of its sources differ" in line


def test_broken_relations_are_listed_below_a_failed_line(planted):
    failed = result_of("mirrored", f"{planted}:fault=lens")
    first, second = verdict_lines([failed])
    assert first.startswith("FAILED") and "1 broken" in first
    assert "mirrored" in second and "limit 0" in second


# -- jitter ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("fault", ["none", "colours"])
def test_coarser_depth_changes_more(planted, fault):
    from inim.apps.stress.jitter import measure_jitter
    from inim.apps.stress.pictures import noise, small_display

    display = small_display(lens_columns=4, lens_rows=4)
    rgbd = noise(display, display.capture_shape(4), 1 / 4)
    rows = measure_jitter(rgbd, display, [f"{planted}:fault={fault}"])
    assert len({r.jitter for r in rows}) == len(rows) == 12
    changed = {r.jitter: r.changed for r in rows}
    assert changed["8 bits"] > changed["10 bits"] > changed["16 bits"]
    assert changed["+1 ulp"] <= changed["16 bits"] < 0.01


# -- requests -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("algorithms", "says"),
    [("nobody", "nobody"), ("template,template", "twice"), ("template:x=1", "x"), (",", "none")],
)
def test_mistakes_in_names_are_usage_errors(tmp_path, algorithms, says):
    with pytest.raises(UsageError, match=says):
        StressRequest(tmp_path, algorithms=algorithm_items(algorithms)).plan()


def test_unknown_relations_and_lens_models_are_usage_errors(tmp_path):
    with pytest.raises(UsageError, match="the sRGB curv"):
        StressRequest(tmp_path, relations=("the sRGB curv",)).plan()
    with pytest.raises(UsageError, match="nobody"):
        StressRequest(tmp_path, lens_models=("nobody",)).plan()


def test_named_subjects_and_relations_select(tmp_path):
    everything = StressRequest(tmp_path).chosen_relations()
    assert {relation.topic for relation, _ in everything} == set(TOPICS)
    of_one = StressRequest(tmp_path, algorithms=("gu2020",)).chosen_relations()
    assert {subject for _, subject in of_one} == {"gu2020"}
    of_model = StressRequest(tmp_path, lens_models=("thin",)).chosen_relations()
    assert {subject for _, subject in of_model} == {"thin"}
    by_topic = StressRequest(tmp_path, relations=("scores",)).chosen_relations()
    assert {relation.topic for relation, _ in by_topic} == {"scores"}
    by_name = StressRequest(tmp_path, relations=("SSIM and PSNR",)).chosen_relations()
    assert [relation.name for relation, _ in by_name] == ["SSIM and PSNR"]
