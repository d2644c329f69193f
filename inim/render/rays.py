"""Tables of the rays of a depth camera, of a display's pixels, and of an eye.

docs/theory/ground-truth.md, "Three families of rays", defines them. An eye may have a pupil, a disc
about its centre e in the plane z = V, focused on the plane a distance F in front of it. The ray of
a film point from the pupil's point e + u meets the ray from e in the plane of focus: with s the
slope of that chief ray, it runs at s - u / F, and crosses z = `start_mm` with an offset of
u (1 - (V - start) / F).

All three are separable in x and y and linear inside a pixel. In the display frame a ray starts on
the plane z = `start_mm`, just in front of the scene. The pickup of a hexagonal, rotated or tilted
array is not separable: each pixel has an individual lens, position and gap.
"""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from inim.display import Display
from inim.display.pixels import (
    SUBPIXELS,
    PixelAxis,
    PixelOffset,
    SubPixel,
    pixel_rays,
    row_blocks,
)
from inim.display.viewpoint import Viewpoint, focus_distance_mm

#: All of a pixel shines.
WHOLE_PIXEL = SUBPIXELS["none"][0]

#: Ends of an interval across or up: low and high of each column, row or pixel, mm.
Interval = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class FilmAxis:
    """One axis of a ray family: the rays of the pixel centres, and how they change inside a pixel.

    * `place_mm`, (n,) float64: where the ray of each column (row) crosses the start plane.
    * `slope`, (n,) float64: its sideways travel per millimetre away from the viewer.
    * `place_step_mm`, `slope_step`: change of both from one side of a pixel to the other, in film
      order.
    """

    place_mm: np.ndarray
    slope: np.ndarray
    place_step_mm: float
    slope_step: float = 0.0


@dataclass(frozen=True)
class SeparableRays:
    """The rays of one sensor, display frame, millimetres; see the module's text.

    `pupil_place_mm` and `pupil_slope` are the changes of position and slope from the centre of an
    eye's pupil to its edge; both are 0 without a pupil.
    """

    start_mm: float
    x: FilmAxis
    y: FilmAxis
    pupil_place_mm: float = 0.0
    pupil_slope: float = 0.0

    @property
    def has_pupil(self) -> bool:
        """True if a pixel's rays start on a disc."""
        return self.pupil_slope != 0

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the film."""
        return len(self.y.place_mm), len(self.x.place_mm)

    def reach(self, depths: np.ndarray) -> list[Interval]:
        """Reach of ray bundles across and up, between two depths below the start plane.

        The bundle's middle runs straight and its half width is convex in depth: extremes are at
        ends.
        """
        reach = []
        for axis in (self.x, self.y):
            lows, highs = [], []
            for depth in depths:
                middle = axis.place_mm + axis.slope * depth
                half = abs(axis.place_step_mm + axis.slope_step * depth) / 2
                half += abs(self.pupil_place_mm + self.pupil_slope * depth)
                lows.append(middle - half)
                highs.append(middle + half)
            reach.append((np.minimum(*lows), np.maximum(*highs)))
        return reach


@dataclass(frozen=True)
class NonSeparableRays:
    """Rays of a panel under an arbitrary array: an individual lens, position and gap for every
    pixel.

    These are the pickup rays of displays that are not separable. A ray joins a point of its pixel
    and the centre of the pixel's lens; display frame, millimetres. Tables are (rows, columns)
    float32: differences are computed in float64 first, to avoid cancellation.

    * `offset_x_mm`, `offset_y_mm`: vector from the centre of the pixel's bundle to the lens centre.
    * `gap_mm`: gap at the centre of the bundle.
    * `step_x_mm`, `step_y_mm`: size of the bundle's base on the panel, in film order.
    * `tilt_x`, `tilt_y`: growth of the gap per millimetre.
    * `along_x`, `along_y`: see `inim.display.layouts.Layout.crossing_steps`.
    """

    start_mm: float
    x0_mm: np.ndarray
    y0_mm: np.ndarray
    offset_x_mm: np.ndarray
    offset_y_mm: np.ndarray
    gap_mm: np.ndarray
    step_x_mm: float
    step_y_mm: float
    tilt_x: float
    tilt_y: float
    along_x: float = 0.0
    along_y: float = 0.0

    has_pupil = False

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the film."""
        return self.x0_mm.shape[0], self.x0_mm.shape[1]


def capture_rays(
    display: Display,
    pixels_per_pitch: float,
    start_mm: float,
    slopes: tuple[float, float] = (0.0, 0.0),
) -> SeparableRays:
    """Parallel rays: the orthographic RGB-D camera.

    `slopes` are their millimetres to the right and upwards per millimetre towards the viewer. The
    pixels are squares of the array's plane for all slopes.
    """
    rows, columns = display.capture_shape(pixels_per_pitch)
    pixel_mm = display.capture_pixel_mm(pixels_per_pitch)

    def axis(count: int, sign: int, slope: float) -> FilmAxis:
        place_mm = _pixel_centres(count, sign * pixel_mm) + slope * start_mm
        # Not -slope: a ray along z has the slope 0, not -0, which rounds differently.
        return FilmAxis(place_mm, np.zeros(count) - slope, sign * pixel_mm)

    return SeparableRays(start_mm, axis(columns, +1, slopes[0]), axis(rows, -1, slopes[1]))


def pickup_rays(
    display: Display, start_mm: float, subpixel: SubPixel = WHOLE_PIXEL
) -> SeparableRays | NonSeparableRays:
    """Bundles from the emitting area of each panel pixel through its lens centre (Eq. 1).

    * `subpixel`: emitting area of the colour, independent of its `turn`.
    """
    right = float(subpixel.right)
    width, height = (float(side) * display.pixel_fill for side in (subpixel.width, subpixel.height))
    if not display.is_separable:
        offset = PixelOffset(Fraction(0), subpixel.right, subpixel.channel)
        return _non_separable_pickup_rays(display, start_mm, offset, width, height)

    def axis(pixels: PixelAxis, sign: int, offset: float, share: float) -> FilmAxis:
        # A step across the pixel moves the panel end of the ray; the lens centre stays.
        step = sign * display.pixel_pitch_mm / display.gap_mm
        slope = pixels.slope - offset * step
        return FilmAxis(
            pixels.centre_mm + slope * start_mm, -slope, -step * start_mm * share, step * share
        )

    return SeparableRays(
        start_mm, axis(display.columns, +1, right, width), axis(display.rows, -1, 0.0, height)
    )


def _non_separable_pickup_rays(
    display: Display, start_mm: float, centre: PixelOffset, width: float, height: float
) -> NonSeparableRays:
    """Bundles from the emitting areas of pixels: their centres and sizes.

    Areas are in pixels.
    """
    pixel = display.pixel_pitch_mm
    blocks = [pixel_rays(display, rows, centre) for rows in row_blocks(display)]
    x0, y0, offset_x, offset_y, gap = (
        np.concatenate(table).astype(np.float32)
        for table in zip(
            *((r.x0, r.y0, r.slope_x * r.gap_mm, r.slope_y * r.gap_mm, r.gap_mm) for r in blocks),
            strict=True,
        )
    )
    steps = width * pixel, -height * pixel
    return NonSeparableRays(
        start_mm, x0, y0, offset_x, offset_y, gap, *steps, *display.tilt_slopes,
        *display.layout.crossing_steps,
    )  # fmt: skip


def eye_rays(
    display: Display,
    viewpoint: Viewpoint,
    pixels_per_lens: int | tuple[float, float],
    start_mm: float,
) -> SeparableRays:
    """Rays from an eye through the lens array, which fills the film: `frustum_rays` of square
    lenses.

    * `viewpoint`: the pupil's centre and diameter, and the distance it is focused at.
    * `pixels_per_lens`, int, or (down, across): a pair need not be whole: the array has whole
      pixels all the same.
    """
    cell_x, cell_y = display.layout.view_cell_mm
    down, across = np.broadcast_to(pixels_per_lens, 2)
    shape = display.view_shape(pixels_per_lens)
    return frustum_rays(shape, (cell_x / across, cell_y / down), display, viewpoint, start_mm)


def frustum_rays(
    shape: tuple[int, int],
    pixel_mm: tuple[float, float],
    display: Display,
    viewpoint: Viewpoint,
    start_mm: float,
) -> SeparableRays:
    """Rays from an eye through a film on the array: an off-axis frustum.

    * `pixel_mm`: width and height of its pixels, on the array.
    * `display`: display for the default focus.
    """
    x, y, distance = viewpoint.position_mm
    focus, pupil_mm = focus_distance_mm(viewpoint, display), viewpoint.pupil_mm

    def axis(count: int, step: float, eye: float, sign: int) -> FilmAxis:
        on_array = _pixel_centres(count, sign * step)
        slope = (on_array - eye) / distance
        return FilmAxis(
            on_array - slope * start_mm,
            slope,
            sign * step * (1 - start_mm / distance),
            sign * step / distance,
        )

    return SeparableRays(
        start_mm,
        axis(shape[1], pixel_mm[0], x, +1),
        axis(shape[0], pixel_mm[1], y, -1),
        pupil_mm / 2 * (1 - (distance - start_mm) / focus),
        -pupil_mm / 2 / focus,
    )


def _pixel_centres(count: int, step: float) -> np.ndarray:
    """Centres of `count` pixels about the axis; a negative step runs downwards."""
    return (np.arange(count) - (count - 1) / 2) * step
