"""Stress of an algorithm: each of its checks can fail, for anybody's algorithm.

An error is planted into what an algorithm shows, and the check that should see it must.
"""

from dataclasses import replace

import numpy as np
import pytest

from inim.apps.stress.checks import cases, check_first_hits, measure_jitter
from inim.apps.stress.pictures import algorithm_output, noise, random_picture, small_display
from inim.apps.stress.relations import RELATIONS, run_relations
from inim.apps.stress.run import StressRequest
from inim.generators import algorithm_items
from inim.system.errors import UsageError
from tests.system.conftest import install_metadata

CASES = {(case.family, case.name): case for case in cases()}
ONE = CASES["ties", "real mode, +0 ulp"]


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
    def __init__(self, display, shape, pixel_mm, right, fault):
        super().__init__(display, shape, pixel_mm)
        self.right, self.fault = right, fault

    def find(self, rgbd):
        if self.fault == "crash":
            raise ZeroDivisionError("by planting")
        found = self.right.find(rgbd)
        return np.roll(found, 5, axis=1) if self.fault == "lens" else found

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


# -- first hits ---------------------------------------------------------------------------------


@pytest.mark.parametrize("algorithm", ["template", "layered"])
@pytest.mark.parametrize("case", [CASES[k] for k in CASES if "ulp" in k[1]], ids=lambda c: c.name)
def test_first_hits_by_definition_are_right_at_ties(algorithm, case):
    row = check_first_hits(algorithm, case)
    assert row.outcome == "ran" and row.exact
    assert row.wrong == 0 < row.pixels and row.passed


def test_a_wrong_first_hit_fails_where_it_is_promised(monkeypatch):
    monkeypatch.setattr("inim.apps.stress.checks.is_first_hit", lambda _: True)
    assert not check_first_hits("gu2020", ONE).passed
    long = random_picture(0)  # its lengths have too many digits: a validation warns
    row = check_first_hits("gu2020", replace(ONE, make=lambda: long))
    assert row.wrong and row.warnings and row.passed


@pytest.mark.parametrize(
    ("fault", "outcome", "passed"),
    [("crash", "crashed", False), ("refuses", "refused", True), ("colours", "no sources", True)],
)
def test_a_failed_case_is_a_row_and_the_study_continues(planted, fault, outcome, passed):
    row = check_first_hits(f"{planted}:fault={fault}", ONE)
    assert (row.outcome, row.passed) == (outcome, passed)


# -- relations ----------------------------------------------------------------------------------

_SHIFT = "shift by one pitch"
_NEARER = "a nearer object changes only its shadow"
#: For each relation, what breaks it: of what is shown, the display and the picture.
BROKEN_BY = {
    _SHIFT: lambda s, d, r: np.where((np.arange(s.shape[1]) < 9)[:, None], s, np.roll(s, 1, 1)),
    "mirror left and right": lambda s, d, r: np.roll(s, 1, axis=1),
    "mirror top and bottom": lambda s, d, r: np.roll(s, 1, axis=0),
    "transpose": lambda s, d, r: np.roll(s, 1, axis=1),
    "all lengths x 2^10": lambda s, d, r: np.roll(s, int(d.pitch_mm > 2), axis=1),
    "all lengths x 2^-7": lambda s, d, r: np.roll(s, int(d.pitch_mm < 0.5), axis=1),
    "all lengths x 1000": lambda s, d, r: np.roll(s, int(d.pitch_mm > 2), axis=1),
    "stretch along z x 4": lambda s, d, r: np.roll(s, int(d.gap_mm > 10), axis=1),
    "move along z": lambda s, d, r: np.roll(s, int(d.depth_range_mm[1] > 30), axis=1),
    _NEARER: lambda s, d, r: np.roll(s, np.count_nonzero(r.covered), axis=1),
    "an object where nothing was": lambda s, d, r: np.roll(s, int(r.covered.all()), axis=1),
    "uncovered pixels do not matter": lambda s, d, r: np.roll(
        s, int(not np.isfinite(r.depth_mm).all()), axis=1
    ),
    "turned right round, as straight": lambda s, d, r: np.roll(s, int(d.rotation_deg != 0), 1),
    "mounted array upside down": lambda s, d, r: np.roll(s, 1, axis=1),
    "mounted array in a mirror": lambda s, d, r: np.roll(s, 1, axis=0),
    "mounted array, all lengths x 2^10": lambda s, d, r: np.roll(s, int(d.pitch_mm > 2), axis=1),
}
#: Those that compare two calls with the same arguments.
CALLS = ("one thread or all", "tiles or whole", "mounted array, one thread or all")


def test_every_relation_is_planted_an_error():
    assert {r.name for r in RELATIONS} == {*BROKEN_BY, *CALLS}


@pytest.mark.parametrize("name", BROKEN_BY)
def test_every_relation_fails_on_its_fault(name):
    (relation,) = (r for r in RELATIONS if r.name == name)

    def wrong(rgbd, display, algorithm):
        return BROKEN_BY[name](algorithm_output(rgbd, display, algorithm), display, rgbd)

    algorithm = "template:columns=solid" if relation.own_columns else "template"
    (row,) = run_relations([algorithm], relations=[relation])
    assert row.passed and not row.explained and row.compared > 0
    (row,) = run_relations([algorithm], show=wrong, relations=[relation])
    assert not row.passed


def test_threads_and_tiles_are_compared_for_real():
    """An answer that changes with every call breaks the relations that compare two calls."""
    calls = iter(range(1000))

    def fickle(rgbd, display, algorithm):
        return np.roll(algorithm_output(rgbd, display, algorithm), next(calls), axis=1)

    chosen = [r for r in RELATIONS if r.name in CALLS]
    rows = run_relations(["template"], show=fickle, relations=chosen)
    assert {r.relation for r in rows if not r.passed} == set(CALLS)


@pytest.mark.parametrize("fault", ["none", "colours"])
def test_somebody_else_s_algorithm_keeps_them_by_sources_or_by_colours(planted, fault):
    chosen = [r for r in RELATIONS if r.name in (_SHIFT, "tiles or whole", "all lengths x 2^10")]
    rows = run_relations([f"{planted}:fault={fault}"], relations=chosen)
    assert len(rows) == 3 and all(r.passed and r.compared > 0 for r in rows)


# -- jitter ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("fault", ["none", "colours"])
def test_coarser_depth_changes_more(planted, fault):
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
