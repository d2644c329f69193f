"""Properties of a display against closed forms and rays traced one by one."""

import math
from itertools import product

import numpy as np
import pytest
from msgspec.structs import asdict

from inim.apps.inspect import findings, geometry
from inim.apps.inspect.findings import Inspection, usable_model
from inim.apps.inspect.geometry import (
    crosstalk_map,
    light_shares,
    viewing_limits,
    voxel_mm,
)
from inim.apps.inspect.spots import land, spot, spots
from inim.display import DISPLAYS, Display
from inim.display.viewpoint import default_distance_mm
from inim.report.diagram import zone_outline_mm
from inim.system.errors import DisplayError, UsageError
from tests.conftest import small_display

NOMINAL = DISPLAYS["nominal"]
PHONE = DISPLAYS["phone"]
VIRTUAL = NOMINAL.replace(gap_mm=2.7)
FOCUSED = NOMINAL.replace(gap_mm=3.0, depth_min_mm=4, depth_max_mm=24)
BAD_LENS = {"focal_length_mm": 1.0, "gap_mm": 1.2}


def inspect_display(display: Display, distance_mm: float, **words: str) -> Inspection:
    """Findings with a crosstalk map of 3 x 3 eyes, which would take most of the time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(geometry, "_EYES_ACROSS", 3)
        return findings.inspect_display(display, distance_mm, **words)


@pytest.fixture(scope="module")
def nominal() -> Inspection:
    return inspect_display(NOMINAL, default_distance_mm(NOMINAL), source="nominal")


def inspected(**changes: object) -> Inspection:
    """A small display of eight pixels per lens, looked at from 400 mm."""
    return inspect_display(small_display(6, 6, **changes), 400.0)  # type: ignore[arg-type]


# --- Closed forms -------------------------------------------------------------------------------


def test_sharp_depth_has_one_name_with_simulated_and_with_ideal_lenses():
    inspection = inspect_display(DISPLAYS["looking-glass-portrait-typical"], 600.0)
    real = inspection.document.suitability.sharp_depth_mm
    # A pixel's beam is as wide as the lens at the array, and twice as wide at the onset of blur.
    ideal = 2 * inspection.document.depth.blur_onset_mm
    text = str(inspection)
    assert real < ideal
    assert f"  sharp depth{'':19}{real:.4g} mm; with ideal lenses {ideal:.4g} mm\n" in text
    assert text.count("sharp depth") == 1
    assert "sharp to" not in text


def test_numbers_of_the_nominal_display_are_those_worked_out_by_hand(nominal):
    depth, viewing = nominal.document.depth, nominal.document.viewing
    assert (depth.mode, depth.central_depth_mm) == ("real", NOMINAL.central_depth_mm)
    assert (depth.depth_min_mm, depth.depth_max_mm) == NOMINAL.depth_range_mm
    # The outermost lens, 31.5 mm off, just sees the axis: 31.5 g / V = P / 2.
    assert viewing.nearest_distance_mm == pytest.approx(31.5 * 6.6, rel=1e-12)
    assert viewing.distance_mm == pytest.approx(2 * 31.5 * 6.6, rel=1e-12)
    assert viewing.flip_limit_x_mm == pytest.approx(31.5, rel=1e-12)
    assert viewing.flip_limit_x_deg == pytest.approx(math.degrees(math.atan(0.5 / 6.6)))


def test_zone_of_lenses_aimed_at_an_eye_closes_again_behind_it():
    aimed = NOMINAL.replace(elemental_pitch_mm=(150 + 3.3) / 150)
    assert viewing_limits(aimed, 150.0).flip_limit_x_mm == pytest.approx(153.3 / 6.6, rel=1e-12)
    z, half = np.array(zone_outline_mm(aimed, 2000.0)).T
    # Farther off the outermost lens, 31.5 mm aside, looks too far inwards: by 0.022 - g / z.
    far = 31.5 * 3.3 / (31.5 * 0.022 - 1.022 / 2)
    assert far - 2000 / 201 < z[-1] <= far
    assert half.max() > half[-1]


@pytest.mark.parametrize("display", [NOMINAL, VIRTUAL, FOCUSED], ids=["real", "virtual", "focused"])
def test_voxel_is_as_wide_as_all_thin_lens_rays_of_one_pixel(display):
    """Each corner ray from pixel edge p through aperture edge a leaves with (a - p)/g - a/f."""
    f, g, pixel = display.focal_length_mm, display.gap_mm, display.pixel_pitch_mm
    for z in (-40.0, -3.0, 0.0, 5.0, 33.0, 60.0):
        ends = [
            a + z * ((a - p) / g - a / f) for p, a in product((-pixel / 2, pixel / 2), (-0.5, 0.5))
        ]
        assert voxel_mm(display, z) == pytest.approx(max(ends) - min(ends), rel=1e-9)


# --- Spots --------------------------------------------------------------------------------------


@pytest.mark.parametrize("display", [NOMINAL, VIRTUAL, FOCUSED], ids=["real", "virtual", "focused"])
def test_thin_lens_images_a_point_of_the_central_depth_plane_to_a_point(display):
    for colour_spot in spots(display, "thin", display.central_depth_mm):
        assert colour_spot.rms_radius_um < 1e-9  # 1e-12 mm
        assert colour_spot.lost_share == 0


def test_the_spot_is_at_the_chief_ray_of_eq_1():
    edge = spot(NOMINAL, "thin", 33.0, 8.0)
    assert edge.centre_x_mm == pytest.approx(0.5 - 3.3 * math.tan(math.radians(8)), abs=1e-12)
    assert edge.centre_y_mm == pytest.approx(0.5, abs=1e-12)


def test_spot_out_of_focus_is_the_aperture_in_proportion():
    """A point at depth z focuses at zf/(z - f); at g the cone is P |1 + g/z - g/f| wide."""
    width = abs(1 + 3.3 / 20 - 3.3 / 3)
    spot_size = spot(NOMINAL, "thin", 20.0, 0.0)
    side = math.sqrt(1 - 1 / 32**2)  # of 32 x 32 midpoints instead of the whole square
    assert spot_size.rms_radius_um == pytest.approx(1e3 * width * side / math.sqrt(6), rel=1e-9)


def test_pinhole_spreads_a_point_by_the_directions_within_a_cell():
    spot_size = spot(NOMINAL, "pinhole", 33.0, 0.0)
    side = math.sqrt(1 - 1 / 32**2)
    assert spot_size.rms_radius_um == pytest.approx(1e3 * 3.3 / 33 * side / math.sqrt(6), rel=1e-9)


@pytest.mark.parametrize(("side", "k"), [("viewer", 1.2047), ("panel", 4.6019)])
def test_collimated_spot_has_the_third_order_size(side, k):
    """Longitudinal aberration k h^2 / f lands at k h^3 / f^2: RMS k a^3 / 2 f^2 over a disc."""
    display = FOCUSED.replace(aperture="round", fill_factor=0.2, curved_side=side)
    spot_size = spot(display, "thick", math.inf, 0.0)
    # Midpoints fill the disc to some 2 % in the sixth moment.
    assert spot_size.rms_radius_um == pytest.approx(1e3 * k * 0.1**3 / (2 * 9), rel=0.04)


def test_dispersive_lens_has_a_spot_for_each_colour_and_blue_defocuses_most():
    spot_sizes = spots(NOMINAL.replace(abbe_number=30.0), "thin", 33.0)
    assert [s.colour for s in spot_sizes[:3]] == ["red", "green", "blue"]
    # Thin lens: power f^-1 (n - 1)/(n_d - 1); a defocused square is P g |change of power| wide.
    slope = 0.4917 / 30 / (486.13**-2 - 656.27**-2)
    for colour_spot, wavelength in zip(spot_sizes[:3], (611.4, 549.1, 464.2), strict=True):
        change = slope * (wavelength**-2 - 587.56**-2) / 0.4917 / 3
        width = 3.3 * abs(change) * math.sqrt(1 - 1 / 32**2)
        assert colour_spot.rms_radius_um == pytest.approx(1e3 * width / math.sqrt(6), rel=1e-6)


# --- Crosstalk ----------------------------------------------------------------------------------


@pytest.mark.parametrize("display", [NOMINAL, PHONE], ids=["nominal", "phone"])
def test_pinhole_crosstalk_begins_at_the_flip_limit(display):
    distance = default_distance_mm(display)
    shares = crosstalk_map(display, display, "pinhole", distance)
    limits = display.flip_limit_mm(distance)
    middle = len(shares.eye_x_mm) // 2
    grid = np.array(shares.share)
    for eyes, share, limit in (
        (np.array(shares.eye_x_mm), grid[middle], limits[0]),
        (np.array(shares.eye_y_mm), grid[:, middle], limits[1]),
    ):
        step = eyes[1] - eyes[0]
        # A ray at a cell's edge is half a pitch nearer to flipping than the lens's centre.
        inside = np.abs(eyes) < limit - display.pitch_mm / 2
        assert inside.sum() > 10
        assert (share[inside] == 0).all()
        assert (share[np.abs(eyes) > limit + step] > 0).all()
        assert (eyes[share > 0] < 0).any() and (eyes[share > 0] > 0).any()


def test_crosstalk_of_a_shift_the_design_does_not_know_is_the_share_of_flipped_lenses():
    """The ray of a lens at x lands g x / V aside on the axis; a shift of 0.4 P adds to that:
    lenses beyond 0.1 P V / g on one side are a cell off; the last column misses the panel."""
    distance = 415.8
    moved = NOMINAL.replace(shift_x_mm=0.4)
    shares = light_shares(NOMINAL, moved, "pinhole", (0.0, 0.0, distance))
    flipped = (32 - 0.1 * distance / 3.3) / 64
    # One sampled column of lenses in 14 stands for 4.4 of 64.
    assert shares.neighbour_share + shares.beside_panel_share == pytest.approx(
        flipped, abs=0.5 * 4.5 / 64
    )
    assert light_shares(moved, moved, "pinhole", (0.4, 0.0, distance)).neighbour_share == 0


DERIVED = ("crosstalk_share", "astray_share")  # sums and quotients of the others
KINDS = {
    "square": {},
    "round": {"aperture": "round", "fill_factor": 0.9},
    "hexagonal": {"lattice": "hexagonal", "rotation_deg": 3.0, "shift_y_mm": 0.2},
    "clear": {"aperture": "round", "fill_factor": 0.7, "between_lenses": "clear"},
    "flat first": {"curved_side": "panel", "tilt_x_deg": 0.5},
}


@pytest.mark.parametrize("model", ["pinhole", "thin", "thick"])
@pytest.mark.parametrize("kind", KINDS)
def test_every_ray_is_accounted_for_once(model, kind):
    display = small_display(9, 8, 12, **KINDS[kind])
    for eye in ((0.0, 0.0, 200.0), (20.0, -35.0, 150.0)):
        shares = light_shares(display, display, model, eye)
        values = [value for name, value in asdict(shares).items() if name not in DERIVED]
        assert sum(values) == pytest.approx(1, abs=1e-12)
        assert min(values) >= 0
        assert shares.astray_share == pytest.approx(1 - shares.own_share - shares.reflected_share)


@pytest.mark.parametrize("fate", ["dark", "clear"])
def test_light_between_round_apertures_is_the_area_outside_the_discs(fate):
    display = small_display(aperture="round", fill_factor=0.8, between_lenses=fate)
    shares = light_shares(display, display, "thin", (0.0, 0.0, 400.0))
    # At the rim, light that no lens bends inwards goes on beside the panel.
    lost = shares.dark_between_share
    if fate == "clear":
        lost = shares.past_lenses_share + shares.beside_panel_share
    assert lost == pytest.approx(1 - math.pi / 4 * 0.64, abs=0.01)
    assert (shares.past_lenses_share if fate == "dark" else shares.dark_between_share) == 0


def test_faces_reflect_as_fresnel_at_normal_incidence_and_little_more():
    shares = light_shares(NOMINAL, NOMINAL, "thick", (0.0, 0.0, 415.8))
    normal = 1 - (1 - (0.4917 / 2.4917) ** 2) ** 2
    assert normal < shares.reflected_share < normal + 0.003


def test_ray_that_slips_past_the_border_belongs_to_the_lens_it_meets():
    """The bulge is 0.087 mm deep at the border: a slope of 0.3 carries a ray 0.026 mm on."""
    rays = np.array([[0.99, 0.99, 0.9], [0.5] * 3, [0.3, -0.3, 0.3], [0.0] * 3])
    landed = land(NOMINAL, "thick", *rays)
    assert landed.lens_x_mm.tolist() == [1.5, 0.5, 0.5]
    assert landed.lens_y_mm.tolist() == [0.5, 0.5, 0.5]
    thin = land(NOMINAL, "thin", *rays)
    assert thin.lens_x_mm[0] == 0.5


# --- Warnings, models, data ---------------------------------------------------------------------


def says(inspection: Inspection, words: str) -> bool:
    return any(words in warning for warning in inspection.document.warnings)


@pytest.mark.parametrize(
    ("findings", "words"),
    [
        (lambda: inspected(), "Depth range cut"),
        (lambda: inspect_display(small_display(40, 6), 50.0), "move back to 128.7 mm"),
        (
            lambda: inspect_display(small_display(40, 6, elemental_pitch_mm=1.1), 90.0),
            "are for an eye at 33 mm: move closer",
        ),
        (lambda: inspect_display(small_display(pixels=16), 30.0), "Eye inside the picture"),
        (lambda: inspected(pixels=30), "Spot larger than a pixel"),
        (lambda: inspected(pixel_pitch_mm=0.0636), "15.72 x 15.72 pixels per lens"),
        (lambda: inspected(**BAD_LENS), "cannot be manufactured"),
        (lambda: inspect_display(small_display(12, 6), 20.0), "Crosstalk on the axis"),
        (lambda: inspected(pixels=17, layers="0.5 1.5168"), "at 72.42 mm instead of at 33 mm"),
        (lambda: inspected(pixels=17, layers="2 1.5"), "at -21.55 mm instead of at 33 mm"),
        (lambda: inspected(pitch_mm=0.2, pixel_pitch_mm=0.02), "Diffraction: 0.45 pixels"),
    ],
)
def test_defects_of_a_display_are_warnings(findings, words):
    assert says(findings(), words)


def test_impossible_thick_lens_becomes_thin_unless_requested():
    display = NOMINAL.replace(**BAD_LENS)
    model, reason = usable_model(None, display)
    assert model == "thin"
    assert reason is not None and "longer focal_length_mm" in reason
    with pytest.raises(DisplayError, match="longer focal_length_mm"):
        usable_model("thick", display)
    with pytest.raises(UsageError, match="fresnel"):
        usable_model("fresnel", display)
    assert usable_model(None, NOMINAL) == ("thick", None)
