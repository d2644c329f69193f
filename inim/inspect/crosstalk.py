"""Where the light that reaches an eye comes from: its lens's own elemental image, or elsewhere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from inim.display import Display
from inim.inspect.spots import array_to_display, cell_of, land, lens_at

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


@dataclass(frozen=True)
class LightShares:
    """What becomes of the rays from an eye to the lens array, in shares that add up to 1.

    By reversibility: of the light the eye could get, what it gets and from where.

    Attributes
    ----------
    own : float
        From the elemental image of the lens it came through.
    neighbour : float
        From under a neighbour: crosstalk.
    past_lenses : float
        Through the bare sheet between lenses, bent by none.
    beside_panel : float
        The ray lands where no elemental image is.
    dark_between : float
        The ray meets the paint between lenses.
    blocked : float
        Vignetted or totally reflected.
    reflected : float
        Lost at the lens's two faces (Fresnel).
    """

    own: float
    neighbour: float
    past_lenses: float
    beside_panel: float
    dark_between: float
    blocked: float
    reflected: float

    @property
    def crosstalk(self) -> float:
        """Share of the light that arrives that comes from under a neighbour; NaN without light."""
        arriving = self.own + self.neighbour + self.past_lenses
        return self.neighbour / arriving if arriving > 0 else float("nan")

    @property
    def astray(self) -> float:
        """All but the lens's own light and the faces' reflections."""
        lost = self.beside_panel + self.dark_between + self.blocked
        return lost + self.neighbour + self.past_lenses


@dataclass(frozen=True)
class CrosstalkMap:
    """Crosstalk over eye positions at the viewing distance.

    Attributes
    ----------
    eye_x_mm : (n,) float64
    eye_y_mm : (m,) float64
        Ascending.
    share : (m, n) float64
        See `LightShares.crosstalk`.
    """

    eye_x_mm: np.ndarray
    eye_y_mm: np.ndarray
    share: np.ndarray


def array_samples(display: Display) -> Samples:
    """Points over the array: 16 on each of up to 256 cells.

    The cells are spread evenly, the outermost among them: those flip first. Each has a grid of 4 x
    4 points, moved from cell to cell so that together they fill a cell evenly.
    """
    pitch, row = display.pitch_mm, display.row_pitch_mm
    columns, across = _spread(display.lens_columns)
    rows, down = _spread(display.lens_rows)
    left, low = columns * pitch - display.width_mm / 2, rows * row - display.height_mm / 2
    corner_x, corner_y = (grid.reshape(-1, 1) for grid in np.meshgrid(left, low))
    steps = np.arange(_POINTS_ACROSS)
    right, up = (grid.reshape(1, -1) for grid in np.meshgrid(steps, steps))
    cell = np.arange(corner_x.size).reshape(-1, 1)
    x = corner_x + (right + (0.5 + cell * _R2[0]) % 1) / _POINTS_ACROSS * pitch
    y = corner_y + (up + (0.5 + cell * _R2[1]) % 1) / _POINTS_ACROSS * row
    area = np.repeat(np.outer(down, across), right.size)
    x, y = array_to_display(display, x.ravel(), y.ravel())
    inside = lens_at(display, x, y).exists
    return Samples(x[inside], y[inside], area[inside] / area[inside].sum())


def _spread(lenses: int) -> tuple[np.ndarray, np.ndarray]:
    """Up to 16 of a row of lenses, counted from one end, and how many each stands for.

    The first and the last stand for themselves, the others for equal parts of what is between.
    """
    if lenses <= _LENSES_ACROSS:
        return np.arange(lenses), np.ones(lenses)
    between = _LENSES_ACROSS - 2
    each = (lenses - 2) / between
    inner = np.floor(1 + (np.arange(between) + 0.5) * each)
    stands_for = np.full(between, each)
    return np.array([0, *inner, lenses - 1]), np.array([1, *stands_for, 1])


def light_shares(
    design: Display,
    mounted: Display,
    model: str,
    eye_mm: tuple[float, float, float],
    samples: Samples | None = None,
) -> LightShares:
    """Follow rays from an eye to the panel and sort them by what they meet.

    Parameters
    ----------
    design : Display
        What the panel's elemental images are laid out for.
    mounted : Display
        The same with its array as it really lies.
    model : str
        One of `inim.lens.lens_models` that is no mesh.
    eye_mm : (x, y, z)
    samples : Samples, optional
        `array_samples(mounted)`, to make them once for many eyes.
    """
    x, y, area = array_samples(mounted) if samples is None else samples
    eye_x, eye_y, distance = eye_mm
    landed = land(mounted, model, x, y, (x - eye_x) / distance, (y - eye_y) / distance)
    light = landed.weight
    passes = light > 0
    cell_x, cell_y, is_lit = cell_of(design, landed.x_mm, landed.y_mm)
    within = lens_at(mounted, x, y).in_aperture
    bent = passes & is_lit & ~np.isnan(landed.lens_x_mm)
    off = np.hypot(cell_x - landed.lens_x_mm, cell_y - landed.lens_y_mm)
    own = bent & (off < mounted.pitch_mm / 8)

    def share(which: np.ndarray, weight: np.ndarray) -> float:
        return float((weight * area)[which].sum())

    whole = np.ones_like(light)
    return LightShares(
        own=share(own, light),
        neighbour=share(bent & ~own, light),
        past_lenses=share(passes & is_lit & ~bent, light),
        beside_panel=share(passes & ~is_lit, light),
        dark_between=share(~passes & ~within, whole),
        blocked=share(~passes & within, whole),
        reflected=share(passes, 1 - light),
    )


def crosstalk_map(
    design: Display, mounted: Display, model: str, distance_mm: float
) -> CrosstalkMap:
    """Crosstalk at eyes on a grid over 1.5 flip limits to all sides.

    Where the viewing zone is empty, the limit of a single lens, V Q / 2g, takes its place.
    """
    alone = distance_mm * design.elemental_image_pitch_mm / (2 * design.gap_mm)
    reach = [limit if limit > 0 else alone for limit in design.flip_limit_mm(distance_mm)]
    eye_x, eye_y = (np.linspace(-_MAP_REACH, _MAP_REACH, _EYES_ACROSS) * v for v in reach)
    samples = array_samples(mounted)
    share = [
        [
            light_shares(design, mounted, model, (x, y, distance_mm), samples).crosstalk
            for x in eye_x
        ]
        for y in eye_y
    ]
    return CrosstalkMap(eye_x, eye_y, np.array(share))
