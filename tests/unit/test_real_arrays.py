"""Arrays as they really lie: hexagonal, moved, turned, tilted, over panels with sub-pixels.

The expected pictures come from brute force: all lens centres in a list, the nearest one to each
point, and a smooth pattern of three different colour waves that no turn or mirror maps to itself.
"""

import cmath
import functools
import math

import numpy as np
import pytest

from inim.display import Display, Viewpoint
from inim.display.lens import trace_to_panel
from inim.display.pixels import SUBPIXELS as PATTERNS
from inim.display.pixels import pixel_rays
from inim.generators import generate
from inim.image.rgbd import RGBD
from inim.system.errors import DisplayError
from tests.conftest import small_display
from tests.generator_cases import OFF_IN_EVERY_WAY

NON_SEPARABLE = {
    "hexagonal": {"lattice": "hexagonal"},
    "skewed rows": {"lattice": "skewed"},
    "turned left": {"rotation_deg": 4.0},
    "turned right": {"rotation_deg": -4.0},
    "tilted": {"tilt_x_deg": 8.0, "tilt_y_deg": -6.0},
    "hexagonal, off in every way": OFF_IN_EVERY_WAY,
}
SEPARABLE = {
    "moved": {"shift_x_mm": 0.37, "shift_y_mm": -0.21},
    "rows closer": {"pitch_y_mm": 0.8},
    "15.7 pixels": {"pixel_pitch_mm": 0.0636, "shift_x_mm": -0.2, "shift_y_mm": 0.4},
}
SUBPIXELS = {
    "stripes": {"subpixels": "rgb-stripe"},
    "pentile, moved": {"subpixels": "pentile", "shift_y_mm": 0.13},
    "stripes, turned": {"subpixels": "rgb-stripe", "rotation_deg": 5.0},
}
EVERY = NON_SEPARABLE | SEPARABLE | SUBPIXELS
# Where each colour's middle is, in pixels to the right of the pixel's.
MIDDLES = {"none": (0, 0, 0), "rgb-stripe": (-1 / 3, 0, 1 / 3), "pentile": (-1 / 4, 1 / 4, -1 / 4)}


def real_display(name: str, **changes: object) -> Display:
    return small_display(12, 10, 17, **(EVERY[name] | changes))


# -- the oracle ---------------------------------------------------------------------------------


def pattern(x, y):
    """Three waves across, in directions of their own; and the steepest change per millimetre."""
    waves = ((0.7, 0.25, 0.4), (-0.2, 0.6, 1.7), (0.45, -0.5, -0.9))
    return np.stack([0.5 + 0.4 * np.sin(a * x + b * y + c) for a, b, c in waves], axis=-1)


STEEPEST = 0.4 * math.hypot(0.7, 0.25)


def centres(display: Display, pitch: float, beyond: int = 4):
    """Centres of the cells of a pitch as complex numbers, and whether each has a lens."""
    ratio, turn = pitch / display.pitch_mm, cmath.rect(1, math.radians(display.rotation_deg))
    positions, real = [], []
    for m in range(-beyond, display.lens_rows + beyond):
        for n in range(-beyond, display.lens_columns + beyond):
            stagger = {
                "square": 0.0,
                "hexagonal": 0.25 if m % 2 else -0.25,
                "skewed": 0.3 * ((display.lens_rows - 1) / 2 - m),
            }[display.lattice]
            x = (n - (display.lens_columns - 1) / 2 + stagger) * display.pitch_mm * ratio
            y = ((display.lens_rows - 1) / 2 - m) * display.row_pitch_mm * ratio
            positions.append(complex(x, y) * turn + complex(display.shift_x_mm, display.shift_y_mm))
            real.append(0 <= m < display.lens_rows and 0 <= n < display.lens_columns)
    return np.array(positions), np.array(real)


def nearest(points, candidates):
    """Index of the candidate nearest to each point, and how much farther the next one is."""
    distance = np.abs(points.reshape(-1, 1) - candidates)
    two = np.partition(distance, 1, axis=1)[:, :2]
    shape = points.shape
    return distance.argmin(axis=1).reshape(shape), (two[:, 1] - two[:, 0]).reshape(shape)


@functools.cache
def own_lens(display: Display):
    """Position of every pixel, its lens's index in `centres`, and whether that is certain."""
    rows, columns = display.eia_shape
    x = (np.arange(columns) - (columns - 1) / 2) * display.pixel_pitch_mm
    y = ((rows - 1) / 2 - np.arange(rows)) * display.pixel_pitch_mm
    middle = x + 1j * y[:, None]
    own, margin = nearest(middle, centres(display, display.elemental_image_pitch_mm)[0])
    return middle, own, margin > 1e-9


def expected_rays(display: Display, right: float = 0.0):
    """Lens centre and slope of every pixel's ray (complex), whether it has one, whether sure."""
    lenses, real = centres(display, display.pitch_mm)
    middle, own, sure = own_lens(display)
    place = middle + right * display.pixel_pitch_mm
    gap = (
        display.gap_mm
        + math.tan(math.radians(display.tilt_x_deg)) * place.real
        + math.tan(math.radians(display.tilt_y_deg)) * place.imag
    )
    return lenses[own], (lenses[own] - place) / gap, real[own], sure


def flat_picture(display: Display, depth_mm: float, per_pitch: int = 10) -> RGBD:
    """The pattern on a plane, as wide as any ray reaches."""
    rows, columns = display.capture_shape(per_pitch)
    pixel = display.pitch_mm / per_pitch
    x = (np.arange(columns) - (columns - 1) / 2) * pixel
    y = ((rows - 1) / 2 - np.arange(rows)) * pixel
    color = pattern(x[None, :], y[:, None])
    depth = np.full((rows, columns), depth_mm, np.float32)
    return RGBD(color, depth, np.ones((rows, columns), bool), pixel)


# -- rays ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", EVERY)
def test_a_pixel_s_ray_from_the_viewer_lands_on_that_pixel(name):
    display = real_display(name)
    rows, columns = display.eia_shape
    rays = pixel_rays(display, slice(0, rows))
    lensed = rays.lens >= 0
    x, y, weight = trace_to_panel(
        display, "pinhole", rays.x0, rays.y0, -rays.slope_x, -rays.slope_y
    )
    pitch = display.pixel_pitch_mm
    assert np.abs(x - (np.arange(columns) - (columns - 1) / 2) * pitch)[lensed].max() < 1e-12
    assert np.abs(y.T - ((rows - 1) / 2 - np.arange(rows)) * pitch).T[lensed].max() < 1e-12
    assert (weight[lensed] == 1).all() and lensed.mean() > 0.8
    assert np.array_equal(display.lensed[lensed], lensed[lensed])


@pytest.mark.parametrize("name", EVERY)
def test_pixels_belong_to_the_nearest_lens(name):
    display = real_display(name)
    rays = pixel_rays(display, slice(0, display.eia_shape[0]))
    centre, slope, lensed, sure = expected_rays(display)
    assert sure.mean() > 0.95
    assert np.array_equal((rays.lens >= 0)[sure], lensed[sure])
    assert np.array_equal(display.lensed[sure], lensed[sure])
    assert np.abs(rays.x0 + 1j * rays.y0 - centre)[sure].max() < 1e-12
    assert np.abs(rays.slope_x + 1j * rays.slope_y - slope)[sure].max() < 1e-12
    order = centres(display, display.pitch_mm, beyond=0)[0]
    assert np.abs(order[rays.lens] - centre)[sure & lensed].max() < 1e-12, "rows from the top"


def test_an_array_beside_its_panel_or_through_it_is_refused():
    with pytest.raises(DisplayError, match="shift_x_mm = 40"):
        _ = small_display(shift_x_mm=40.0).columns
    with pytest.raises(DisplayError, match="shift_x_mm = 40, shift_y_mm = 0: the array is"):
        _ = small_display(shift_x_mm=40.0, rotation_deg=3.0).lensed
    steep = small_display(60, 10, 4, tilt_x_deg=8.0)
    with pytest.raises(DisplayError, match="tilt_x_deg = 8"):
        pixel_rays(steep, slice(0, 4))


@pytest.mark.parametrize("name", EVERY)
def test_the_capture_covers_every_ray_and_little_more(name):
    display = real_display(name)
    rows, columns = display.capture_shape(4)
    reach = [0.0, 0.0]
    for right in MIDDLES[display.subpixels]:
        centre, slope, lensed, _ = expected_rays(display, right)
        for z in display.depth_range_mm:
            at = (centre + slope * z)[lensed]
            reach = [max(reach[0], np.abs(at.real).max()), max(reach[1], np.abs(at.imag).max())]
    for pixels, need in ((columns, reach[0]), (rows, reach[1])):
        assert need <= pixels / 8
        # Half a lens around the outermost centres; boxes around what is turned; the least gap.
        assert pixels / 8 - need < 0.2 * need + 1.5


# -- views --------------------------------------------------------------------------------------

EYE = Viewpoint("eye", 9.0, -7.0, 150.0)
PER_LENS = 3


def view_rays(display: Display, view: np.ndarray):
    """Point of the array on each view pixel's ray, and its slope towards the viewer (complex)."""
    rows, columns = view.shape[:2]
    x = (np.arange(columns) + 0.5 - columns / 2) * display.width_mm / columns
    y = (rows / 2 - np.arange(rows) - 0.5) * display.height_mm / rows
    at = x + 1j * y[:, None]
    return at, (complex(EYE.x_mm, EYE.y_mm) - at) / EYE.z_mm


def error_of_view(eia, display: Display, depth_mm: float, lens_model: str) -> float:
    """Mean distance of a view from the pattern, in the middle of the array."""
    from inim.render.reconstruct import reconstruct

    view = reconstruct(
        np.ascontiguousarray(eia), display, EYE, lens_model, pixels_per_lens=PER_LENS, spp=64
    )
    at, slope = view_rays(display, view)
    through = at
    if lens_model == "pinhole":  # it shows what lies behind the middle of the lens
        lenses, _ = centres(display, display.pitch_mm)
        through = lenses[nearest(at, lenses)[0]]
    places = through + slope * depth_mm
    inside = (np.abs(at.real) < 0.35 * display.width_mm) & (
        np.abs(at.imag) < 0.35 * display.height_mm
    )
    return float(np.abs(view - pattern(places.real, places.imag))[inside].mean())


WRONG = {
    "hexagonal": {"shift_x_mm": 0.5},  # the other rows staggered
    "skewed rows": {"shift_x_mm": 0.3},
    "turned left": {"rotation_deg": -4.0},
    "turned right": {"rotation_deg": 4.0},
    "tilted": {"tilt_x_deg": -8.0, "tilt_y_deg": 6.0},
    "hexagonal, off in every way": {"shift_y_mm": 0.22},
    "moved": {"shift_x_mm": -0.37},
    "rows closer": {"pitch_y_mm": None},
    "15.7 pixels": {"shift_y_mm": -0.4},
}
# A view finds lenses in the same way for all models.
PINHOLES = ("hexagonal", "skewed rows", "tilted", "hexagonal, off in every way")


@pytest.mark.parametrize(
    ("name", "lens_model"),
    [*((name, "thin") for name in WRONG), *((name, "pinhole") for name in PINHOLES)],
)
def test_a_view_shows_the_pattern_and_that_for_another_array_does_not(name, lens_model, renderer):
    display = real_display(name)
    rows, columns = display.eia_shape
    other = display.replace(**WRONG[name], panel_rows=rows, panel_columns=columns)
    depth = display.central_depth_mm
    right, wrong = (
        error_of_view(generate(flat_picture(d, depth), d), display, depth, lens_model)
        for d in (display, other)
    )
    # A panel pixel is 0.59 mm wide at this depth: half of that either way, a quarter on average.
    assert right < STEEPEST * 0.588 / 2
    # A tilted panel is in focus along a line only, whatever it shows.
    assert wrong > (1.5 if (name, lens_model) == ("tilted", "thin") else 2) * right


@pytest.mark.parametrize("name", SUBPIXELS)
def test_colours_of_sub_pixels_meet_on_a_grey_ramp(name, renderer):
    """Sampled at pixel centres, a ramp has a fringe: its slope times the sub-pixels' distance."""
    from inim.render.reconstruct import DisplayScene

    display = real_display(name)
    depth, slope = display.central_depth_mm, 0.03
    flat = flat_picture(display, depth)
    x = (np.arange(flat.shape[1]) - (flat.shape[1] - 1) / 2) * flat.pixel_mm
    grey = np.broadcast_to(0.5 + slope * x[None, :, None], flat.color.shape)
    ramp = RGBD(grey.astype(np.float32), flat.depth_mm, flat.covered, flat.pixel_mm)
    # Eyes over the directions of two pixels: a single one sees a pattern's stripes, not their mean.
    turn = display.pixel_pitch_mm / display.gap_mm * EYE.z_mm
    eyes = [Viewpoint("eye", EYE.x_mm + k / 12 * turn, EYE.y_mm, EYE.z_mm) for k in range(24)]
    last = 2 if display.subpixels == "rgb-stripe" else 1

    def fringe(eia) -> float:
        """Excess of the rightmost colour over red in the middle of the array."""
        scene = DisplayScene(eia, display, "thin")
        views = [scene.view(eye, pixels_per_lens=2, spp=64, seed=0) for eye in eyes]
        middle = np.mean(views, axis=0)[5:-5, 6:-6]
        return float((middle[..., last] - middle[..., 0]).mean())

    apart = MIDDLES[display.subpixels][last] - MIDDLES[display.subpixels][0]
    expected = slope * apart * display.pixel_pitch_mm * depth / display.gap_mm
    plain = generate(ramp, display.replace(subpixels="none"))
    assert abs(fringe(generate(ramp, display))) < 0.15 * expected
    assert fringe(plain) == pytest.approx(expected, rel=0.15)


# -- ground truth -------------------------------------------------------------------------------


CORNERS = ((0.5, 0.5), (0.0, 0.0), (1.0, 0.25))


@pytest.mark.parametrize("name", EVERY)
def test_pickup_rays_start_all_over_the_light_and_pass_the_lens_centre(name, renderer):
    import drjit as dr
    import mitsuba as mi

    from inim.render.rays import pickup_rays
    from inim.render.trace import FilmCamera

    display = real_display(name, pixel_fill=0.8)
    rows, columns = display.eia_shape
    lane = dr.arange(mi.UInt32, rows * columns)
    pixel = mi.Point2u(lane % columns, lane // columns)
    lenses, _ = centres(display, display.pitch_mm)
    middle, own, sure = own_lens(real_display(name))  # whatever part of a pixel is lit
    sure = sure & display.lensed
    tilts = [math.tan(math.radians(t)) for t in (display.tilt_x_deg, display.tilt_y_deg)]
    for subpixel in PATTERNS[display.subpixels]:
        camera = FilmCamera(pickup_rays(display, 50.0, subpixel), np.eye(4))
        for across, down in CORNERS:
            ray = camera.rays(pixel, mi.Point2f(across, down))
            origin, run = (np.stack([np.asarray(c, float) for c in v]) for v in (ray.o, ray.d))
            # Pixels of the panel to the right and down, of what is 0.8 of the sub-pixel.
            right = float(subpixel.right) + (across - 0.5) * 0.8 * float(subpixel.width)
            place = middle + complex(right, -(down - 0.5) * 0.8) * display.pixel_pitch_mm
            gap = display.gap_mm + tilts[0] * place.real + tilts[1] * place.imag
            for z, expected in ((0.0, lenses[own]), (-gap, place)):
                t = (z - origin[2].reshape(rows, columns)) / run[2].reshape(rows, columns)
                landings = [
                    (origin[k].reshape(t.shape) + t * run[k].reshape(t.shape)) for k in (0, 1)
                ]
                # float32 over a way of 50 mm
                assert np.abs(landings[0] + 1j * landings[1] - expected)[sure].max() < 3e-5
