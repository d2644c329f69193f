"""The accuracy study's own tools: its oracles are right, and each of its checks can fail.

An error is planted into a generator or a lens model, and the check that should see it must.
"""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from hypothesis.database import DirectoryBasedExampleDatabase

from inim.apps.stress.document import RelationResult
from inim.apps.stress.pictures import MOUNTINGS, algorithm_output, noise
from inim.display import Display
from inim.display.lens import trace_to_panel
from inim.generators import HOLE, find_sources, generate
from inim.generators.accuracy_limits import accuracy_warnings
from inim.generators.oracle import lensed_pixels
from inim.generators.template import ray_by_ray
from inim.image.rgbd import RGBD
from inim.system.document import read_document
from inim.system.errors import EXIT_PASSED
from reports.stress.study import generators, lens_cases, lens_models, lens_relations, relations
from reports.stress.study.__main__ import STUDY
from reports.stress.study.cases import FULL, NONSEPARABLE_FAMILIES, Case, Family, ties
from reports.stress.study.lens_cases import display_of
from reports.stress.study.limits import accuracy_limits_of, checks_of, regions_of
from reports.stress.study.oracles import answer, exact_first_hits, first_hits
from reports.stress.study.page import GENERATORS, LENSES, checks, rows_of
from reports.stress.study.rays import rays_over
from reports.study import StudyDocument
from tests import oracle as rational
from tests.conftest import small_display

# Failures found once are tried first ever after, here and wherever the folder goes.
FAILURES = DirectoryBasedExampleDatabase(Path(__file__).parent / "stress_failures")
RANDOM = settings(
    max_examples=2,
    deadline=None,
    database=FAILURES,
    suppress_health_check=[HealthCheck.too_slow],
    derandomize=False,
)
# Panel pixels of a case that oracles answer for; the corners and the middle are always among them.
FEW = 25


def picture(display: Display, seed: int = 0, per_pitch: int = 2) -> RGBD:
    shape = display.capture_shape(per_pitch)
    return noise(display, shape, display.pitch_mm / per_pitch, seed)


def all_rays(display: Display, rgbd: RGBD):
    return rays_over(display, rgbd, lensed_pixels(display))


# -- oracles ------------------------------------------------------------------------------------


@pytest.mark.parametrize("shift", [0.0, 0.1])
@pytest.mark.parametrize("pixels", [4, 5])
def test_oracles_in_fractions_and_in_float64_agree_with_the_tests_rational_one(pixels, shift):
    display = small_display(3, 2, pixels=pixels)
    rgbd = picture(display)
    rays = all_rays(display, rgbd)
    hits = exact_first_hits(rays, rgbd, display, np.arange(len(rays.pixels)))
    expected = rational.exact_sources(rgbd, display)[rays.pixels[:, 0], rays.pixels[:, 1]]
    assert np.array_equal(hits, expected)
    # The float one agrees wherever it does not say that rounding decides.
    float64 = answer("template", rays, rgbd, display, np.float64)
    assert not ((float64.sources != hits) & ~float64.uncertain).any()
    if shift:
        moved = display.replace(shift_x_mm=shift)
        assert not np.array_equal(first_hits(all_rays(moved, rgbd), rgbd, moved), hits)


lengths = st.sampled_from([1.0, 0.5, 0.93, 1 / 3, 1.17, 2.0])


@st.composite
def displays(draw):
    """Random displays, real and virtual, of whole and broken numbers of pixels."""
    pitch = draw(lengths)
    focal = pitch * draw(st.sampled_from([2.0, 3.0, 3.7]))
    gap = focal * draw(st.sampled_from([0.8, 0.9, 1.1, 1.25]))
    ratio = draw(st.sampled_from([2, 3, 4.5, 5, 5.3]))
    columns, rows = draw(st.integers(1, 4)), draw(st.integers(1, 3))
    ends = draw(st.sampled_from([None, (-6.0, 5.0), (3.0, 9.0), (-9.0, -2.5)]))
    stated = {}
    if ends is not None:
        stated = {"depth_min_mm": ends[0] * pitch, "depth_max_mm": ends[1] * pitch}
    return Display(pitch, focal, gap, pitch / ratio, columns, rows, **stated)


#: Each of wang2024's entries is on a border of picture pixels.
ON_BORDERS = Display(1 / 3, 2 / 3, 1.6 / 3, 1 / 15, 1, 2)


def random_displays(limits):
    """A test of random displays and pictures, the known hard one first."""

    def decorated(test):
        arguments = given(displays(), st.integers(0, 2**31), st.sampled_from([1, 2, 3, 1.7]))
        return limits(arguments(example(ON_BORDERS, 113, 3)(test)))

    return decorated


@random_displays(RANDOM)
def test_random_displays_are_exact_and_uncertain_where_they_differ(display, seed, per_pitch):
    exact_or_uncertain(display, seed, per_pitch)


@random_displays(settings(RANDOM, max_examples=40))
def test_many_random_displays_are_too(display, seed, per_pitch):
    exact_or_uncertain(display, seed, per_pitch)


def exact_or_uncertain(display, seed, per_pitch):
    """`template` in all forms against fractions; the others within rounding of their definition."""
    rgbd = noise(display, (14, 16), display.pitch_mm / per_pitch, seed)
    rays = all_rays(display, rgbd)
    if not len(rays.pixels):
        return
    at = rays.pixels[:, 0], rays.pixels[:, 1]
    exact = exact_first_hits(rays, rgbd, display, np.arange(len(rays.pixels)))
    alone = ray_by_ray(display, rgbd.shape, rgbd.pixel_mm).sources(rgbd)
    # Lengths of too many digits (3 x 0.8 is not 2.4) are warned of, and then ties may be lost.
    warned = bool(accuracy_warnings(display, pixel_mm=rgbd.pixel_mm))
    uncertain = answer("template", rays, rgbd, display, np.float64).uncertain
    for sources in (find_sources(rgbd, display), alone):
        wrong = sources[at] != exact
        assert not (wrong & ~uncertain if warned else wrong).any()
    for algorithm in ("gu2020", "wang2024:matching=ray", "li2012"):
        expected = answer(algorithm, rays, rgbd, display, np.float64)
        sources = find_sources(rgbd, display, algorithm)[at]
        assert not ((sources != expected.sources) & ~expected.uncertain).any(), algorithm


# -- checks that can fail -------------------------------------------------------------------------

MEANS = {(v.algorithm, np.dtype(v.dtype).name) for v in generators.VARIANTS if v.samples > 1}


def one_case(**changes):
    display = small_display(3, 3, pixels=5, **changes)
    result = (display, picture(display))
    return Family("family", "value", lambda _: []), Case("case", lambda: result, 1.0)


def replace_finder(monkeypatch, finder):
    """Let sources come from elsewhere in the cases, those of rays walked alone too."""

    def alone(display, *_):
        return SimpleNamespace(sources=lambda rgbd: finder(rgbd, display))

    monkeypatch.setattr(generators, "find_sources", finder)
    monkeypatch.setattr(generators, "ray_by_ray", alone)
    # Means of colours are planted in by themselves.
    named = [v for v in generators.VARIANTS if v.samples == 1]
    monkeypatch.setattr(generators, "VARIANTS", named)


def failed(rows):
    return {(r["algorithm"], r["dtype"]) for r in rows if not r["passed"]}


def test_an_honest_case_passes():
    rows = generators.run_case(*one_case(), FEW)
    assert len(rows) == len(generators.VARIANTS)
    assert not failed(rows)
    assert all(r["changed"] == 0 for r in rows if r["algorithm"] == "template")


def lens_off_by_one(rgbd, display, algorithm="template", **options):
    return np.roll(find_sources(rgbd, display, algorithm, **options), 5, axis=1)


def wrong_sign_of_depth(rgbd, display, algorithm="template", **options):
    depth = np.float32(sum(display.depth_range_mm)) - rgbd.depth_mm
    return find_sources(replace(rgbd, depth_mm=depth), display, algorithm, **options)


def one_wrong_pixel(rgbd, display, algorithm="template", **options):
    sources = find_sources(rgbd, display, algorithm, **options)
    sources[7, 7] = HOLE if sources[7, 7] != HOLE else 0
    return sources


def last_bit_of_depth(rgbd, display, algorithm="template", **options):
    """Exact tables over a picture that is one float32 farther away: ties give it away."""
    if algorithm == "template":
        rgbd = replace(rgbd, depth_mm=np.nextafter(rgbd.depth_mm, np.float32(-np.inf)))
    return find_sources(rgbd, display, algorithm, **options)


@pytest.mark.parametrize(
    ("wrong", "whole"),
    [(lens_off_by_one, True), (wrong_sign_of_depth, True), (one_wrong_pixel, False),
     (last_bit_of_depth, False)],
)  # fmt: skip
def test_wrong_sources_are_reported(monkeypatch, wrong, whole):
    """Whole pictures of them for all algorithms, single pixels for the exact one."""
    replace_finder(monkeypatch, wrong)
    family, case = one_case()
    if wrong is last_bit_of_depth:
        case = next(c for c in ties() if c.label == "ray by ray, +0 ulp")
    rows = generators.run_case(family, case, FEW)
    assert {("template", "float32"), ("template", "float64")} <= failed(rows)
    assert not whole or len(rows) == len(generators.VARIANTS) == len(failed(rows))


def test_a_crash_is_a_row_and_not_the_end(monkeypatch):
    def broken(*_, **__):
        raise ZeroDivisionError("by planting")

    for name in ("find_sources", "ray_by_ray", "generate"):
        monkeypatch.setattr(generators, name, broken)
    rows = generators.run_case(*one_case(), FEW)
    assert {r["outcome"] for r in rows} == {"crashed"} and len(failed(rows)) == len(rows)


@pytest.mark.parametrize("wrong", ["nothing", "lens", "place", "weight", "one pixel"])
def test_a_wrong_mean_of_rays_is_reported(monkeypatch, wrong):
    def planted(rgbd, display, algorithm):
        if wrong == "place":  # all rays through the centre
            return generate(rgbd, display, algorithm.partition(":")[0], samples=1)
        eia = generate(rgbd, display, algorithm)
        if wrong == "lens":
            return np.roll(eia, 5, axis=1)
        if wrong == "weight":
            return eia * np.float32(1 + 2e-6)
        if wrong == "one pixel":
            eia[0, 0, 0] += np.float32(1e-5)  # of the pixels that are always compared
        return eia

    monkeypatch.setattr(generators, "generate", planted)
    means = [v for v in generators.VARIANTS if v.samples > 1]
    monkeypatch.setattr(generators, "VARIANTS", means)
    rows = generators.run_case(*one_case(), FEW)
    assert failed(rows) == (set() if wrong == "nothing" else MEANS)


@pytest.mark.parametrize("name", MOUNTINGS)
def test_a_wrong_ray_of_a_mounted_array_is_reported(monkeypatch, name):
    """The gap of the panel's middle for all pixels, a turn the other way, another lattice."""
    slip = {
        "turned": {"rotation_deg": -4.0},
        "tilted": {"tilt_x_deg": 0.0, "tilt_y_deg": 0.001},
        "hexagonal": {"pitch_y_mm": 0.9},
        "all at once": {"elemental_pitch_mm": 1.0},
    }[name]
    family, case = one_case(**MOUNTINGS[name])
    rows = generators.run_case(family, case, 2 * FEW)
    ran = {r["algorithm"] for r in rows if r["outcome"] == "ran"}
    assert ran >= {"template", "gu2020", "layered:samples=1", "template:samples=4:colour=nearest"}
    assert not failed(rows)

    def planted(rgbd, display, algorithm="template", **options):
        return find_sources(rgbd, display.replace(**slip), algorithm, **options)

    replace_finder(monkeypatch, planted)
    rows = generators.run_case(family, case, 2 * FEW)
    assert all(r["outside"] for r in rows if r["outcome"] == "ran")


@pytest.mark.parametrize("family", NONSEPARABLE_FAMILIES, ids=lambda f: f.name)
def test_every_case_of_mounted_arrays_holds(family):
    rows = [row for c in family.cases(FULL) for row in generators.run_case(family, c, 225)]
    assert rows and [r for r in rows if not r["passed"]] == []


def test_accepted_invalid_inputs_are_reported():
    family, case = one_case()
    (row,) = generators.run_case(family, Case(case.label, case.make, 1.0, refused=True), FEW)
    assert row["outcome"] == "accepted" and not row["passed"]


# -- relations ----------------------------------------------------------------------------------

BROKEN_LAYERS = {
    "without layers as template": lambda s, r: np.roll(s, 1, axis=1),
    "a solid cut in two": lambda s, r: np.roll(s, len(r.layers) % 2, axis=1),
    "the deepest solid changes what shows it": lambda s, r: np.roll(s, len(r.layers) % 2, axis=1),
    "solids without gaps are columns": lambda s, r: np.roll(s, len(r.layers) // 2, axis=1),
}


def test_every_relation_of_layers_fails_on_its_fault():
    assert {r.name for r in relations.LAYER_RELATIONS} == BROKEN_LAYERS.keys()
    assert all(r.passed for r in relations.run_relations())
    for number, name in enumerate(r.name for r in relations.LAYER_RELATIONS):

        def wrong(rgbd, display, algorithm, name=name):
            return BROKEN_LAYERS[name](find_sources(rgbd, display, algorithm), rgbd)

        assert not relations.run_relations(wrong)[number].passed, name


def test_types_are_compared_for_real():
    """An answer that changes with every call differs from any other type's."""
    calls = iter(range(1, 1000))

    def fickle(rgbd, display, algorithm):
        return np.roll(algorithm_output(rgbd, display, algorithm), next(calls), axis=1)

    assert not relations.run_relations(show=fickle)[-1].passed


LENS_BROKEN = {
    "mirror left and right": lambda x, y, d: (x + 1e-9, y),
    "transpose": lambda x, y, d: (x * (1 + 1e-9), y),
    "shift by one pitch": lambda x, y, d: (x * (1 + 1e-9), y),
    "array and rays shifted by half and whole pixels": lambda x, y, d: (x - 2 * d.shift_x_mm, y),
    "all lengths x 2^10": lambda x, y, d: (x + 1e-12, y),
    "all lengths x 1000": lambda x, y, d: (x + 1e-9, y),
    "one ray or many": lambda x, y, d: (x + 1e-12 * np.size(x), y),
}


@pytest.fixture(scope="module")
def honest_lenses():
    return lens_relations.run_lens_relations()


@pytest.mark.parametrize("name", lens_relations.LENS_RELATIONS)
def test_every_lens_relation_fails_on_its_fault(name, honest_lenses, monkeypatch):
    def planted(display, model, *ray):
        x, y, weight = trace_to_panel(display, model, *ray)
        return (*LENS_BROKEN[name](x, y, display), weight)

    only = {name: lens_relations.LENS_RELATIONS[name]}
    monkeypatch.setattr(lens_relations, "LENS_RELATIONS", only)
    assert all(r.passed for r in honest_lenses if r.relation == name)
    assert not any(r.passed for r in lens_relations.run_lens_relations(planted))


def lens_case():
    display = display_of()
    rays = lens_cases.rays_over(display, 40)
    family = lens_cases.LensFamily("family", "value", ("pinhole", "thin", "thick"), lambda _: [])
    return family, Case("case", lambda: (display, rays), 1.0)


def test_honest_lens_models_pass():
    rows = lens_models.run_lens_case(*lens_case())
    assert len(rows) == 6 and all(r["passed"] and r["safe"] for r in rows)


@pytest.mark.parametrize("wrong", ["sign", "lens", "single"])
def test_a_wrong_lens_model_is_reported(monkeypatch, wrong):
    """A wrong sign, the next lens, float32 where float64 is claimed."""

    def planted(display, model, x, y, sx, sy, dtype):
        if wrong == "sign":
            return trace_to_panel(display, model, x, y, -sx, sy, dtype=dtype)
        if wrong == "lens":
            a, b, weight = trace_to_panel(display, model, x, y, sx, sy, dtype=dtype)
            return a + display.pitch_mm, b, weight
        return trace_to_panel(display, model, x, y, sx, sy, dtype=np.float32)

    monkeypatch.setattr(lens_models, "trace_to_panel", planted)
    rows = lens_models.run_lens_case(*lens_case())
    dtypes = ("float64",) if wrong == "single" else ("float64", "float32")
    assert all(not r["passed"] for r in rows if r["dtype"] in dtypes)


# -- what follows from rows -----------------------------------------------------------------------


def row(value, safe=True, dtype="float32", **more):
    common = {
        "family": "incidence", "case": str(value), "value": value, "model": "thin", "dtype": dtype,
        "algorithm": "template", "outcome": "ran", "safe": safe, "guards": [], "passed": safe,
        "exact": more.get("algorithm", "template") == "template", "form": "lists",
        "worst_pixels": 0.0, "pixels": 10, "changed": 0 if safe else 3, "digest": "same",
    }  # fmt: skip
    return common | more


def test_a_region_ends_where_the_first_unsafe_value_is():
    rows = [row(1.0), row(2.0), row(3.0), row(4.0, safe=False), row(5.0)]
    (region,) = regions_of([], rows, {"incidence": "slope"})
    assert (region["low"], region["high"], region["tried"]) == (1.0, 3.0, [1.0, 5.0])
    far_off = [row(1.0), row(2.0, worst_pixels=0.02)]
    (region,) = regions_of([], far_off, {"incidence": "slope"})
    assert region["high"] == 1.0


def test_limits_are_the_last_safe_values():
    lenses = [row(v, safe=v < 3, model=m) for v in (1.0, 2.0, 3.0) for m in ("pinhole", "thin")]
    lenses += [row(v, safe=v < 2, model="thick") for v in (1.0, 2.0)]
    widths = [row(v, family="array width", model=m) for v in (9.0, 64.0) for m in
              ("pinhole", "thin", "thick")]  # fmt: skip
    indices = [row(v, safe=v > 1.1, family="index", model=m) for v in (1.05, 1.2, 1.5)
               for m in ("thin", "thick")]  # fmt: skip
    limits = accuracy_limits_of([row(0.0), row(1.0, safe=False)], lenses + widths + indices, 17)
    assert limits["slope"] == {"pinhole": 2.0, "thin": 2.0, "thick": 1.0}
    assert (limits["panel_pixels"], limits["least_index"]) == (17 * 64.0, 1.2)
    assert limits["changed_by_rounding"] == 0.3


HELD = RelationResult(
    relation="r", algorithm="template", explained="", compared=1, broken=0, uncertain=0,
    message="", passed=True,
)  # fmt: skip


def verdicts(rows, relations_rows=(HELD,)):
    return checks_of(rows, rows, relations_rows)


def test_the_verdict_fails_for_unsafe_unguarded_inputs():
    good = [row(1.0), row(1.0, dtype="float64"), row(2.0, algorithm="gu2020")]
    assert all(c["passed"] for c in verdicts(good))
    bad = [*good, row(3.0, safe=False)]
    assert not all(c["passed"] for c in verdicts(bad))
    guarded = [*good, row(3.0, safe=False, guards=["warned"], passed=True)]
    assert all(c["passed"] for c in verdicts(guarded))


def test_the_verdict_fails_where_types_differ_or_nothing_was_tried():
    other = [row(1.0), row(1.0, dtype="float64", digest="other"), row(2.0, algorithm="gu2020")]
    by_name = {c["name"]: c["passed"] for c in verdicts(other)}
    assert not next(v for k, v in by_name.items() if "are equal" in k)
    assert not any(c["passed"] for c in verdicts([], ()))


def test_a_quick_run_has_every_part_and_all_it_claims_holds(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert STUDY.main(["--quick", "-o", "out/stress"]) == EXIT_PASSED
    document = read_document(tmp_path / "out/stress/stress.json", "", StudyDocument)
    expected = {f"stress.{kind}" for kind in ("html", "json", "md", "png", "svg")}
    assert set(document.files) == expected
    assert all(c["passed"] and c["cases"] > 0 for c in checks(document.results))
    sources = [r for r in rows_of(document.results, GENERATORS) if r["outcome"] == "ran"]
    assert {r["algorithm"] for r in sources} == {v.algorithm for v in generators.VARIANTS}
    assert {r["form"] for r in sources} >= {"lists", "ray by ray", "non-separable"}
    lenses = [r for r in rows_of(document.results, LENSES) if r["outcome"] == "ran"]
    assert {(r["model"], r["dtype"]) for r in lenses} == {
        (m, d) for m in ("pinhole", "thin", "thick") for d in ("float32", "float64")
    }
    names = {r["relation"] for r in document.results["relations"]}
    assert {"a solid cut in two", "mirror left and right"} <= names
