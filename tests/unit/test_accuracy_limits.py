"""Warnings of what was not measured safe: none for what is, one for each way out of it."""

import json
from pathlib import Path

import numpy as np
import pytest

from inim.apps.stress.oracles.generators import exact_first_hits
from inim.apps.stress.oracles.rays import chosen_pixels, rays_over
from inim.apps.stress.pictures import noise
from inim.display import DISPLAYS
from inim.display.lens import lens_model, lens_models
from inim.generators import accuracy_limits as limits
from inim.generators import find_sources
from inim.generators.accuracy_limits import accuracy_warnings
from inim.pipeline.plan import make_plan
from inim.pipeline.request import Request
from tests.conftest import small_display
from tests.oracle import exact_sources

ROOT = Path(__file__).parents[2]
SCENES = sorted((ROOT / "scenes").glob("*.xml"))
STEEPEST = {m: limit for m in lens_models() if (limit := lens_model(m).steepest_slope) < np.inf}
LEAST_INDEX = lens_model("thin").least_index
PUBLISHED = ROOT / "reports" / "stress" / "stress.json"


@pytest.fixture(scope="module")
def measured():
    return json.loads(PUBLISHED.read_text("utf-8"))


@pytest.mark.parametrize("scene", SCENES, ids=lambda p: p.stem)
def test_the_scenes_are_inside_the_limits(scene):
    plan = make_plan(Request(scene, Path("unused"), algorithms=("template",)))
    pixel = plan.display.pitch_mm / plan.settings.capture_pixels_per_pitch
    assert (
        accuracy_warnings(
            plan.display, plan.settings.lens_model, viewpoints=plan.viewpoints, pixel_mm=pixel
        )
        == []
    )


@pytest.mark.parametrize("model", ["pinhole", "thin", "thick"])
@pytest.mark.parametrize("display", DISPLAYS.values(), ids=DISPLAYS)
def test_presets_are_inside_them(display, model):
    assert accuracy_warnings(display, model, slope=0.3) == []


def growth(measured, relation):
    """Points of growth by subject: positions within the limit of the relation, and the others."""
    results = [r for r in measured["relations"] if r["relation"] == relation]
    assert results
    return {
        r["subject"]: {
            within: [p["position"] for p in r["growth"] if (_is_within(p, r)) is within]
            for within in (True, False)
        }
        for r in results
    }


def _is_within(point, result):
    return point["worst"] is not None and point["worst"] <= result["limit"]


def test_limits_are_no_wider_than_what_the_published_run_found_exact_enough(measured):
    slopes = growth(measured, "growth of error with slope")
    for model, limit in STEEPEST.items():
        assert max(slopes[model][True]) >= limit
        assert all(position > limit for position in slopes[model][False]), model
    for points in growth(measured, "growth of error with the array").values():
        assert max(points[True]) >= limits.WIDEST_PANEL_PIXELS < min(points[False])
    indices = growth(measured, "growth of error with the index")["thin"]
    assert min(indices[True]) <= LEAST_INDEX - 1 + 1e-12 and max(indices[False]) < LEAST_INDEX - 1
    hits = [r for r in measured["relations"] if r["relation"] == "first hits"]
    exact = [r for r in hits if not r["explained"]]
    assert {r["subject"] for r in exact} >= {"template", "layered"}
    for result in exact:
        assert result["worst"] == 0 < result["broken"]
        assert result["largest_share"] <= max(limits.CHANGED_BY_TIES, limits.CHANGED_BY_ROUNDING)


def test_the_published_run_holds(measured):
    assert measured["schema"] == "inim.stress/4"
    assert measured["mode"] == "full" and measured["passed"] is True
    assert all(r["passed"] and r["cases"] > 0 for r in measured["relations"])


def test_each_limit_warns_on_its_far_side_only():
    display = small_display()
    for model, limit in STEEPEST.items():
        assert accuracy_warnings(display, model, slope=limit) == []
        (warning,) = accuracy_warnings(display, model, slope=1.01 * limit)
        assert model in warning and f"{limit:g}" in warning
    assert accuracy_warnings(display.replace(refractive_index=LEAST_INDEX), "thin") == []
    (warning,) = accuracy_warnings(display.replace(refractive_index=1.009), "thin")
    assert "refractive_index = 1.009" in warning
    assert accuracy_warnings(display.replace(refractive_index=1.009), "pinhole") == []
    wide = display.replace(panel_columns=limits.WIDEST_PANEL_PIXELS, panel_rows=1)
    assert accuracy_warnings(wide, "pinhole") == []
    wider = wide.replace(panel_columns=limits.WIDEST_PANEL_PIXELS + 1)
    (warning,) = accuracy_warnings(wider, "pinhole")
    assert str(limits.WIDEST_PANEL_PIXELS + 1) in warning


def test_a_depth_range_without_depths_warns():
    shallow = small_display(depth_min_mm=1000.0, depth_max_mm=1000.001)
    (warning,) = accuracy_warnings(shallow)
    assert "1000" in warning and str(limits.FEWEST_DEPTHS) in warning
    assert accuracy_warnings(small_display(depth_min_mm=1000.0, depth_max_mm=1100.0)) == []


def test_lengths_of_many_digits_warn():
    """Without them, corners are met exactly."""
    short = small_display(3, 3, pixels=5, gap_mm=3.3)
    long = short.replace(gap_mm=3.0 * (1 + 2.0**-40), depth_min_mm=20.0, depth_max_mm=40.0)
    assert accuracy_warnings(short, pixel_mm=0.5) == []
    (warning,) = accuracy_warnings(long, pixel_mm=0.3)
    assert "digits" in warning
    rgbd = noise(short, short.capture_shape(2), 0.5)
    assert np.array_equal(find_sources(rgbd, short), exact_sources(rgbd, short))


@pytest.mark.parametrize(
    "changes",
    [{"lattice": "hexagonal"}, {"tilt_x_deg": 2.0}, {"rotation_deg": 90.0},
     {"rotation_deg": -30.0 + limits.LEAST_TURN_DEG / 2}],
)  # fmt: skip
def test_regular_mounted_arrays_warn_and_a_slight_rotation_avoids_it(changes):
    display = small_display(**changes)
    (warning,) = accuracy_warnings(display)
    assert next(iter(changes)) in warning and f"{limits.CHANGED_BY_TIES:.0%}" in warning
    turned = display.replace(rotation_deg=display.rotation_deg + limits.LEAST_TURN_DEG)
    assert accuracy_warnings(turned) == []


def test_the_suggested_fix_for_corners_works():
    """A tilted display shows sources of its corners' neighbours; turned a little, next to none."""
    lost = []
    for degrees in (0.0, limits.LEAST_TURN_DEG):
        display = small_display(3, 3, pixels=5, tilt_x_deg=2.0, rotation_deg=degrees)
        rgbd = noise(display, display.capture_shape(2), 0.5)
        rays = rays_over(display, rgbd, chosen_pixels(display, 225))
        sources = find_sources(rgbd, display)[rays.pixels[:, 0], rays.pixels[:, 1]]
        truth = exact_first_hits(rays, rgbd, display, np.arange(len(sources)))
        lost.append(np.count_nonzero(sources != truth) / len(sources))
    assert 0.05 < lost[0] < limits.CHANGED_BY_TIES
    assert lost[1] < 0.01
