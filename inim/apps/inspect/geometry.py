"""The closed forms: sizes, depth, voxels, viewing zone; and where the light at an eye comes from.

Formulas are those of Wang et al., Heritage Science 2024, doi 10.1186/s40494-024-01462-4, by
equation number; the rest is plain geometry. Crosstalk is counted by rays from the eye.
"""

import math
from typing import NamedTuple

import numpy as np

from inim.apps.inspect.document import (
    CrosstalkGrid,
    DepthFigures,
    LightRecord,
    PixelChoice,
    Size,
    ViewingLimits,
    VoxelWidths,
)
from inim.apps.inspect.spots import array_to_display, cell_of, finite_or_none, land, lens_at
from inim.display import Display
from inim.display.layers import excess_mm
from inim.display.layouts import Lenticular
from inim.display.lens.array import CHANNEL_WAVELENGTHS_NM, lens_array
from inim.display.pixels import panel_points
from inim.display.viewpoint import DEFAULT_VIEWPOINTS, named_viewpoint, zone_half_mm
from inim.report.diagram import zone_outline_mm
from inim.scores.document_parts import DepthRange, EyePosition
from inim.system.errors import DisplayError

#: Pixels per lens to compare: half as many, these, twice as many.
PIXEL_STEPS = (0.5, 1.0, 2.0)
#: Usual glass of a phone, for displays whose layers are not given.
COVER_GLASS = ((0.5, 1.52),)
# Panels are driven with 8 bits of red, green and blue.
_BYTES_PER_PIXEL = 3
_CURVE_POINTS = 241


def mode(display: Display) -> str:
    """``"real"`` (g > f, D in front), ``"virtual"`` (g < f, behind) or ``"focused"`` (g = f)."""
    if display.gap_mm == display.focal_length_mm:
        return "focused"
    return "real" if display.gap_mm > display.focal_length_mm else "virtual"


def has_whole_pixels(display: Display) -> bool:
    """True if elemental images are a whole number of pixels wide and high."""
    return all(count.denominator == 1 for count in display.exact_pixels_per_lens)


def size_of(display: Display) -> Size:
    """Sizes of a display's array and panel."""
    (rows, columns), (lens_rows, lens_columns) = display.eia_shape, display.layout.grid
    return Size(
        width_mm=display.width_mm,
        height_mm=display.height_mm,
        lens_columns=lens_columns,
        lens_rows=lens_rows,
        panel_columns=columns,
        panel_rows=rows,
        panel_width_mm=columns * display.pixel_pitch_mm,
        panel_height_mm=rows * display.pixel_pitch_mm,
        pixels_per_lens=display.pixels_per_lens,
        has_whole_pixels_per_lens=has_whole_pixels(display),
    )


def depth_figures(display: Display) -> DepthFigures:
    """Depths at which a display is sharp."""
    low, high = display.depth_range_mm
    derived = display.derived_quantities()
    return DepthFigures(
        **{name: derived[name] for name in DepthRange.__struct_fields__},
        mode=mode(display),
        depth_range_is_stated=display.depth_min_mm is not None,
        voxel_at_depth_min_mm=float(voxel_mm(display, low)),
        voxel_at_depth_max_mm=float(voxel_mm(display, high)),
        blur_onset_mm=blur_onset_mm(display),
        layers_excess_mm=excess_mm(display.layers),
        central_depth_if_measured_mm=depth_if_measured_mm(display),
    )


def blur_onset_mm(display: Display) -> float:
    """Distance from the array beyond which pictures lose sharpness: P g / p.

    There, the light of one direction, from an emitting area p wide, is as wide as a lens.
    """
    width_mm = display.elemental_image_pitch_mm / display.layout.directions[0]
    return display.pitch_mm * display.gap_mm / width_mm


def depth_if_measured_mm(display: Display) -> float | None:
    """Central depth plane if `gap_mm` were a measured length instead of air-equivalent; None: none.

    With the display's layers in it, or with `COVER_GLASS` if it has none.
    """
    f, gap = display.focal_length_mm, display.gap_mm - excess_mm(display.layers or COVER_GLASS)
    return None if gap <= 0 or gap == f else f * gap / (gap - f)


def diffraction_px(display: Display) -> float:
    """Wavelength x gap / (aperture x panel pixel), for green.

    That is how far the first zero of a square aperture's diffraction pattern is from its centre on
    the panel (Goodman, Introduction to Fourier Optics), in panel pixels.
    """
    wavelength_mm = 1e-6 * CHANNEL_WAVELENGTHS_NM[1]
    aperture_mm = display.fill_factor * display.pitch_mm
    return wavelength_mm * display.gap_mm / (aperture_mm * display.pixel_pitch_mm)


def pixel_choice(display: Display, times: float) -> PixelChoice:
    """Properties with `times` as many pixels under each lens, all else unchanged.

    One pixel's step in direction is atan(P_D / g) at the axis (Eq. 1: slope (x0 - x) / g), and the
    displayable depth 2 |D| P_I / P with P_I = |D| P_D / g (Eq. 3 and the text after Eq. 4) shrinks
    with the pixel.
    """
    pixel_mm = display.pixel_pitch_mm / times
    rows, columns = (math.ceil(n * times) for n in display.eia_shape)
    across, down = display.layout.directions
    span = display.depth_span_mm
    return PixelChoice(
        pixels_per_lens=display.pixels_per_lens * times,
        pixel_pitch_mm=pixel_mm,
        views_across=across * times,
        views_down=1.0 if display.layout.of_cylinders else down * times,
        angular_step_deg=math.degrees(math.atan(pixel_mm / display.gap_mm)),
        depth_span_mm=finite_or_none(span / times),
        panel_columns=columns,
        panel_rows=rows,
        frame_mb=rows * columns * _BYTES_PER_PIXEL / 1e6,
    )


def viewing_limits(display: Display, distance_mm: float) -> ViewingLimits:
    """The viewing zone and the default eyes at a distance; see `Display.flip_limit_mm`."""
    try:
        nearest: float | None = display.nearest_viewing_distance_mm
    except DisplayError:
        nearest = None
    limit_x, limit_y = display.flip_limit_mm(distance_mm)
    eyes = [named_viewpoint(name, display, distance_mm) for name in DEFAULT_VIEWPOINTS]
    return ViewingLimits(
        half_angle_deg=display.viewing_half_angle_deg,
        nearest_distance_mm=nearest,
        distance_mm=distance_mm,
        flip_limit_x_mm=limit_x,
        flip_limit_y_mm=finite_or_none(limit_y),
        flip_limit_x_deg=math.degrees(math.atan2(limit_x, distance_mm)),
        flip_limit_y_deg=math.degrees(math.atan2(limit_y, distance_mm)),
        zone_is_empty=min(limit_x, limit_y) < 0,
        zone_distance_and_limit_x_mm=zone_outline_mm(display, 1.5 * distance_mm),
        viewpoints=[EyePosition(name=eye.name, position_mm=eye.position_mm) for eye in eyes],
    )


def pixel_footprint_mm(display: Display, depth_mm: np.ndarray | float) -> np.ndarray:
    """A panel pixel projected through the lens centre onto depth z: |z| P_D / g (from Eq. 1)."""
    depth = np.asarray(depth_mm, float)
    return np.asarray(np.abs(depth) * display.pixel_pitch_mm / display.gap_mm)


def aperture_blur_mm(display: Display, depth_mm: np.ndarray | float) -> np.ndarray:
    """Width at depth z of the beam that a panel point sends through a lens: A |z - D| / |D|.

    A is the aperture's width, the pitch where lenses fill their cells. The beam is as wide as the
    lens at z = 0 and comes to a point at D (similar triangles); a focused display's stays A.
    """
    aperture = display.fill_factor * display.pitch_mm
    depth = np.asarray(depth_mm, float)
    if math.isinf(display.central_depth_mm):
        return np.full_like(depth, aperture)
    centre = display.central_depth_mm
    return np.asarray(aperture * np.abs(depth - centre) / abs(centre))


def voxel_mm(display: Display, depth_mm: np.ndarray | float) -> np.ndarray:
    """Width of one pixel's whole beam at depth z: footprint plus blur.

    Each point of the pixel sends a beam as wide as the blur, and their axes spread over the
    footprint; so the edges lie exactly their sum apart. At D it is P_I = |D| P_D / g (Eq. 3).
    """
    return np.asarray(pixel_footprint_mm(display, depth_mm) + aperture_blur_mm(display, depth_mm))


def voxel_widths(display: Display) -> VoxelWidths:
    """Voxel size over twice the depth range, its middle in the middle."""
    low, high = display.depth_range_mm
    margin = (high - low) / 2
    depth = np.linspace(low - margin, high + margin, _CURVE_POINTS)
    return VoxelWidths(
        depth_mm=depth.tolist(),
        footprint_mm=pixel_footprint_mm(display, depth).tolist(),
        blur_mm=aperture_blur_mm(display, depth).tolist(),
        width_mm=voxel_mm(display, depth).tolist(),
    )


_LENSES_ACROSS = 16
_POINTS_ACROSS = 4  # of a cell
# Roberts's R2 sequence: it fills the square evenly at any length.
_R2 = (0.7548776662466927, 0.5698402909980532)
_EYES_ACROSS = 21
_MAP_REACH = 1.5  # in flip limits


class Samples(NamedTuple):
    """Points of the lens array, display frame, and the share of its area each stands for."""

    x_mm: np.ndarray
    y_mm: np.ndarray
    area: np.ndarray


def array_samples(display: Display) -> Samples:
    """Points over the array: 16 on each of up to 256 cells.

    The cells are spread evenly, the outermost among them: those flip first. Each has a grid of 4 x
    4 points, moved from cell to cell so that together they fill a cell evenly.
    """
    is_lenticular = display.layout.of_cylinders
    pitch, row = display.pitch_mm, display.row_pitch_mm
    if is_lenticular:
        pitch, row = display.layout.view_cell_mm
    (rows, down), (columns, across) = map(_spread, display.layout.grid)
    left, low = columns * pitch - display.width_mm / 2, rows * row - display.height_mm / 2
    corner_x, corner_y = (grid.reshape(-1, 1) for grid in np.meshgrid(left, low))
    steps = np.arange(_POINTS_ACROSS)
    right, up = (grid.reshape(1, -1) for grid in np.meshgrid(steps, steps))
    cell = np.arange(corner_x.size).reshape(-1, 1)
    x = corner_x + (right + (0.5 + cell * _R2[0]) % 1) / _POINTS_ACROSS * pitch
    y = corner_y + (up + (0.5 + cell * _R2[1]) % 1) / _POINTS_ACROSS * row
    area = np.repeat(np.outer(down, across), right.size)
    x, y = x.ravel(), y.ravel()
    if not is_lenticular:  # cylinders cover their panel, however they are turned
        x, y = array_to_display(display, x, y)
    inside = lens_at(display, x, y).exists
    return Samples(x[inside], y[inside], area[inside] / area[inside].sum())


def _spread(lenses: int) -> tuple[np.ndarray, np.ndarray]:
    """Indices of up to 16 lenses of a row, and the number of lenses that each represents.

    The first and the last represent themselves, the others equal parts of the rest.
    """
    if lenses <= _LENSES_ACROSS:
        return np.arange(lenses), np.ones(lenses)
    between = _LENSES_ACROSS - 2
    lenses_per_sample = (lenses - 2) / between
    inner = np.floor(1 + (np.arange(between) + 0.5) * lenses_per_sample)
    stands_for = np.full(between, lenses_per_sample)
    return np.array([0, *inner, lenses - 1]), np.array([1, *stands_for, 1])


def light_shares(
    design: Display,
    misaligned: Display,
    model: str,
    eye_mm: tuple[float, float, float],
    samples: Samples | None = None,
) -> LightRecord:
    """Trace rays from an eye to the panel and classify them by destination.

    By reversibility, these are the shares of the light that reaches the eye, by origin.

    * `design`: design of the elemental images.
    * `misaligned`: the same display with its misaligned array.
    * `model`: one of `inim.display.lens.lens_models` that is not a mesh.
    * `eye_mm`, (x, y, z)
    * `samples`: `array_samples(misaligned)`, to make them once for many eyes.
    """
    x, y, area = array_samples(misaligned) if samples is None else samples
    eye_x, eye_y, distance = eye_mm
    landed = land(misaligned, model, x, y, (x - eye_x) / distance, (y - eye_y) / distance)
    light = landed.weight
    passes = light > 0
    cell_x, cell_y, is_lit = cell_of(design, landed.x_mm, landed.y_mm)
    within = lens_at(misaligned, x, y).in_aperture
    bent = passes & is_lit & ~np.isnan(landed.lens_x_mm)
    off = np.hypot(cell_x - landed.lens_x_mm, cell_y - landed.lens_y_mm)
    own = bent & (off < misaligned.pitch_mm / 8)

    def share(which: np.ndarray, weight: np.ndarray) -> float:
        return float((weight * area)[which].sum())

    whole = np.ones_like(light)
    own_share, neighbour = share(own, light), share(bent & ~own, light)
    past_lenses, beside_panel = (
        share(passes & is_lit & ~bent, light),
        share(passes & ~is_lit, light),
    )
    dark_between, blocked = share(~passes & ~within, whole), share(~passes & within, whole)
    arriving = own_share + neighbour + past_lenses
    return LightRecord(
        own_share=own_share,
        neighbour_share=neighbour,
        past_lenses_share=past_lenses,
        beside_panel_share=beside_panel,
        dark_between_share=dark_between,
        blocked_share=blocked,
        reflected_share=share(passes, 1 - light),
        crosstalk_share=neighbour / arriving if arriving > 0 else None,
        astray_share=beside_panel + dark_between + blocked + neighbour + past_lenses,
    )


def view_shares(
    design: Display,
    misaligned: Display,
    model: str,
    eye_mm: tuple[float, float, float],
    views: float,
    samples: Samples | None = None,
) -> list[float]:
    """Shares of the light at an eye by its view, on a lenticular display; empty on others.

    The views divide an elemental image into equal parts, and a sub-pixel belongs to the one at its
    centre. Light differs from the eye's own view by at most half a view, by up to 1.5, 2.5, and so
    on; the last number has the rest.

    * `views`: their number, rarely whole for `Layout.directions`.
    * the rest: see `light_shares`.
    """
    layout = design.layout
    if not isinstance(layout, Lenticular):
        return []
    x, y, area = array_samples(misaligned) if samples is None else samples
    eye_x, eye_y, distance = eye_mm
    landed = land(misaligned, model, x, y, (x - eye_x) / distance, (y - eye_y) / distance)
    lit = (landed.weight > 0) & ~np.isnan(landed.lens_x_mm)
    # The eye's own place under each lens, along the ray through the lens's centre.
    array = lens_array(misaligned)
    from_x, from_y = eye_x - array.shift_x, eye_y - array.shift_y
    eye_across = array.cosine * from_x + array.sine * from_y
    lens_x = np.where(lit, landed.lens_x_mm, 0.0)
    own = layout.place_in_cell(lens_x + (lens_x - eye_across) * misaligned.gap_mm / distance)[1]
    shares = np.zeros(_NEIGHBOURS + 2)
    points = panel_points(design, landed.x_mm, landed.y_mm)
    for shines, across in zip(points.shines, points.across_mm, strict=True):
        away = layout.place_in_cell(across)[1] - own
        steps = np.rint(np.abs(away - np.rint(away)) * views).astype(np.int64)
        light = np.where(lit, landed.weight * area * shines, 0.0)
        np.add.at(shares, np.minimum(steps, _NEIGHBOURS + 1), light)
    return [float(share) for share in shares / max(shares.sum(), np.finfo(float).tiny)]


# Neighbouring views on each side that are counted one by one.
_NEIGHBOURS = 2


def crosstalk_map(
    design: Display, misaligned: Display, model: str, distance_mm: float
) -> CrosstalkGrid:
    """Crosstalk at eyes on a grid over 1.5 flip limits to all sides.

    Where the viewing zone is empty, the limit of a single lens, V Q / 2g, takes its place.
    """
    alone = distance_mm * design.elemental_image_pitch_mm / (2 * design.gap_mm)
    reach = [half if half > 0 else alone for half in zone_half_mm(design, distance_mm)]
    eye_x, eye_y = (np.linspace(-_MAP_REACH, _MAP_REACH, _EYES_ACROSS) * v for v in reach)
    samples = array_samples(misaligned)
    share = [
        [
            light_shares(design, misaligned, model, (x, y, distance_mm), samples).crosstalk_share
            for x in eye_x
        ]
        for y in eye_y
    ]
    return CrosstalkGrid(eye_x_mm=eye_x.tolist(), eye_y_mm=eye_y.tolist(), share=share)
