"""Fringes between the views on a panel and its cylinders: observations of lenticular displays.

A photograph of a lenticular display need not resolve its lenses. Smoothed over them, it shows the
bare panel at the depth of the gap, which gives the camera's pose, and the phase of the view
patterns: the phase on the panel, through the lenses, less the number of the lens. From an eye at
the height z over the panel, that phase changes over the panel by the elemental images' pitch for a
viewer there, P z / (z - g), and by the rotation. Between positions it changes by g / P for each
unit of the tangent of the eye's direction across the axes. One position thus gives pitch, rotation
and shift for its own distance; positions from different sides give the gap.

A ray passes a lens off its axis, and a pixel of the smoothed photograph sees all rays between the
seams of a lens. Seams are a sag deep in the relief: at a slope s, the rays between them cross the
plane of the vertices around the distance -s sag from the axis. The light of all of them, traced
through the thick lens, is the sum of waves exp(2 pi i x / P) of their panel points x.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from inim.calibration.lattice import check_marks, period_numbers
from inim.calibration.model import (
    Deviations,
    Guess,
    Intrinsics,
    Kind,
    Pose,
    Residuals,
    bow_mm,
    farther_in_glass,
    panel_mm,
    rays,
)
from inim.calibration.patterns import periods_px, view_phase
from inim.calibration.start import focal_guess, homography, pose_of_plane
from inim.display import Display
from inim.display.pixels import SUBPIXELS
from inim.errors import FileError
from inim.lens import lens_model
from inim.lens.array import NUMPY_OPS, lens_array, lens_traits, to_array, to_panel
from inim.lens.model import sag
from inim.lens.thick import curved_face

if TYPE_CHECKING:
    from inim.calibration.decode import Decoded

# Samples of a photograph, among which phases are unwrapped. Every third shows marks. Of rows and
# columns, every eighth is fitted: samples are then about a smoothing apart or more.
_SAMPLES, _MARK_STEP, _FITTED_STEP = 30_000, 3, 8
_LEAST_SAMPLES = 750
# Gaps tried at the start, in shares of the nominal one, and their usual deviation. The logarithm of
# the likelihood of the best one must exceed that of others by the last number.
_GAPS, _GAP_SPREAD, _CLEAR = np.linspace(0.4, 1.8, 281), 0.3, 0.5
# Radius of the lenses, in pitches.
_LEAST_RADIUS = 0.51
# Rays through a lens, Gauss and Legendre's places and weights from seam to seam.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
# Samples of a position that is not photographed yet, across and down, and the least share of them
# that sees the panel.
_GRID, _LEAST_SEEN = 24, 1 / 8


@dataclass(frozen=True)
class Fringes:
    """Smoothed photographs of one camera position, in samples."""

    index: np.ndarray  #: (n, 2) int: column and row of the samples' grid.
    pixel: np.ndarray  #: (n, 2) float: x and y in the photograph.
    panel_px: np.ndarray  #: (n, 2) float: panel column and row that the sample sees.
    phase: np.ndarray  #: (n,) float: periods of the view patterns, less a whole number for all.
    motion_px: float  #: Corrected displacement of the photographs, root mean square.
    shape: tuple[int, int]  #: Height and width of the photograph.


def find_fringes(decoded: Decoded, display: Display, name: str) -> Fringes:
    """Phases of the decoded photographs of a lenticular display, counted over the panel.

    * `name`: name of the photographs in error messages.

    Raises `FileError`: too little of the panel is seen, or its marks are not recognised.
    """
    from scipy.ndimage import label
    from skimage.restoration import unwrap_phase

    shape = decoded.column.shape
    step = max(1, round(math.sqrt(shape[0] * shape[1] / _SAMPLES)))
    part = np.s_[step // 2 :: step, step // 2 :: step]
    period = periods_px(display)
    view = np.zeros(shape) if decoded.view is None else decoded.view
    cycles = [decoded.column[part] / period[0], decoded.row[part] / period[1], view[part]]
    regions, count = label(np.isfinite(cycles).all(axis=0))
    sizes = np.bincount(regions.ravel(), minlength=2)[1:]
    if not count or sizes.max() < _LEAST_SAMPLES:
        raise FileError(
            f"{name}: the display covers {sizes.max(initial=0) / regions.size:.0%} of the "
            f"photographs; fill at least {_LEAST_SAMPLES / _SAMPLES:.1%} of them with it"
        )
    is_seen = regions == 1 + sizes.argmax()
    row, column = np.nonzero(is_seen)
    # The start of the algorithm's random numbers: results are repeatable.
    phases = [
        unwrap_phase(np.ma.array(2 * np.pi * np.nan_to_num(c), mask=~is_seen), rng=0)
        for c in cycles
    ]
    column_px, row_px, phase = (np.asarray(p)[is_seen] / (2 * np.pi) for p in phases)
    middle = np.stack([column_px, row_px], axis=-1) * period
    rows, columns = display.eia_shape
    marked = decoded.is_marked[part][is_seen]
    offset, is_contradicted = period_numbers(middle[::_MARK_STEP], marked[::_MARK_STEP], display)
    check_marks(is_contradicted or offset is None, display, name)
    green = float(SUBPIXELS[display.subpixels][1].right)
    origin = np.array([columns / 2 + green, rows / 2])
    index = np.stack([column, row], axis=-1)
    fitted = (index % _FITTED_STEP == 0).all(axis=-1)
    return Fringes(
        index[fitted] // _FITTED_STEP,
        (step * index[fitted] + step // 2 + 0.5).astype(float),
        (middle + offset * period + origin)[fitted],
        phase[fitted],
        decoded.motion_px,
        shape,
    )


def see_through(
    sheet: Display, arriving: np.ndarray, deviations: Deviations
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Panel points that samples of a smoothed photograph see, and numbers of their lenses.

    * `sheet`: see `Guess.sheet`.
    * `arriving`, (4, n): see `inim.calibration.model.rays`.

    Returns `panel`, (n, 2): mean panel point, display frame, mm; `wave`, (n, 2): the panel point
    with the phase of the waves' sum; `lens`, (n,): lens number, continuous.
    """
    array, traits = lens_array(sheet), lens_traits(sheet)
    pitch, face = array.pitch_x, curved_face(array, traits)
    x, y, sx, sy = to_array(array, traits, *arriving)
    height = bow_mm(array, deviations, x, y)
    x, y = x - height * sx, y - height * sy
    # One lens about its own axis; the numbers of others follow from the ray's place.
    alone = array._replace(
        pitch_x=2 * pitch, half_aperture=pitch, gap=(array.gap + height)[:, None]
    )
    traits = traits._replace(full_aperture=False, clear_between=False)
    centre = x + sx * sag(NUMPY_OPS, face, pitch * pitch / 4)
    from_axis = (x - centre)[:, None] + pitch / 2 * _NODES
    zeros, sx, sy = np.zeros_like(from_axis), sx[:, None], sy[:, None]
    with np.errstate(invalid="ignore"):
        ray = lens_model("thick").function(
            alone,
            traits,
            NUMPY_OPS,
            from_axis,
            zeros,
            sx + zeros,
            sy + zeros,
            sheet.refractive_index,
        )
        farther = deviations.glass_mm * farther_in_glass(ray.sx, ray.sy)
    weight = np.where(ray.weight > 0, ray.weight, 0.0) * _WEIGHTS
    weight /= weight.sum(axis=1, keepdims=True)
    across, along = (
        np.where(weight > 0, place + farther * slope, 0.0)
        for place, slope in ((ray.x, ray.sx), (ray.y, ray.sy))
    )
    mean = (weight * across).sum(axis=1)
    waves = (weight * np.exp(2j * np.pi / pitch * (across - mean[:, None]))).sum(axis=1)
    y = y + (weight * along).sum(axis=1)
    places = []
    for at in (mean, mean + pitch / (2 * np.pi) * np.angle(waves)):
        at_panel = ray._replace(x=centre + at, y=y, sx=sx[:, 0], sy=sy[:, 0])
        places.append(np.stack(to_panel(array, lens_traits(sheet), at_panel)[:2], axis=-1))
    return places[0], places[1], centre / pitch


@dataclass(frozen=True)
class FringeObservations(Residuals):
    """Observations of cylinders, which photographs need not resolve."""

    kinds = (
        Kind("panel", ("across", "up"), "µm", 1e3, 0.5, 0.05, 0.002, 0.5),
        Kind("views", ("across",), "‰ of a lens", 1e3, 0.05, 0.001, 0.0005, 0.02),
    )

    # Smoothed over lenses, and samples a smoothing apart.
    is_striped = False

    design: Display  #: Display whose views the patterns show.
    index: tuple[np.ndarray, ...]  #: (n, 2) int each: column and row of the samples.
    pixel: tuple[np.ndarray, ...]  #: (n, 2) float each: their pixels.
    panel: tuple[np.ndarray, ...]  #: (n, 2) float each: panel points, mm, display frame.
    phase: tuple[np.ndarray, ...]  #: (n,) float each: phases of the views, periods.

    @classmethod
    def of(cls, fringes: Sequence[Fringes], design: Display) -> FringeObservations:
        """Observations of all positions."""
        observed = [
            (position.index, position.pixel, panel_mm(design, position.panel_px), position.phase)
            for position in fringes
        ]
        return cls(design, *zip(*observed, strict=True))

    @property
    def places(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """See `Residuals.places`."""
        return [(index, index) for index in self.index]

    def grid(self, guess: Guess) -> tuple[int, int]:  # noqa: ARG002
        """See `Residuals.grid`: the samples."""
        columns, rows = np.max([index.max(axis=0) for index in self.index], axis=0) + 1
        return int(columns), int(rows)

    def residuals(self, guess: Guess) -> list[tuple[np.ndarray, np.ndarray]]:
        """Residuals by position: (n, 2) mm on the panel; (n, 1) views, in lenses."""
        arriving = [
            rays(guess.camera, pose, pixel).reshape(4, -1)
            for pose, pixel in zip(guess.poses, self.pixel, strict=True)
        ]
        panel, wave, lens = see_through(
            guess.sheet, np.concatenate(arriving, axis=1), guess.deviations
        )
        phase = view_phase(self.design, *wave.T) - lens - np.concatenate(self.phase)
        ends = np.cumsum([len(index) for index in self.index])[:-1]
        return [
            (point - observed, (off - np.rint(off))[:, None])
            for point, observed, off in zip(
                np.split(panel, ends), self.panel, np.split(phase, ends), strict=True
            )
        ]

    def imperfections(self, guess: Guess) -> np.ndarray:  # noqa: ARG002
        """See `Residuals.imperfections`: there are none."""
        return np.zeros((0, self.counts.sum()))

    @property
    def imperfection_sizes(self) -> np.ndarray:
        """See `Residuals.imperfection_sizes`."""
        return np.zeros(0)

    def seen_from(self, guess: Guess, shape: tuple[int, int]) -> FringeObservations | None:
        """See `Residuals.seen_from`."""
        row, column = np.indices((_GRID, _GRID)).reshape(2, -1)
        index = np.stack([column, row], axis=-1)
        pixel = (index + 0.5) / _GRID * shape[::-1]
        x, y, *_ = rays(guess.camera, guess.poses[0], pixel)
        inside = (abs(x) < self.design.width_mm / 2) & (abs(y) < self.design.height_mm / 2)
        if inside.mean() < _LEAST_SEEN:
            return None
        index, pixel, zeros = index[inside], pixel[inside], np.zeros(inside.sum())
        empty = replace(
            self,
            index=(index,),
            pixel=(pixel,),
            panel=(np.stack([zeros, zeros], axis=-1),),
            phase=(zeros,),
        )
        ((panel, phase),) = empty.residuals(guess)
        return replace(empty, panel=(panel,), phase=(phase[:, 0],))


def begin_fringes(
    fringes: Mapping[str, Fringes],
    design: Display,
    camera: Intrinsics | None,
    focal_px: float | None,
) -> Guess:
    """Values to begin with.

    Raises `FileError`: mirrored photographs, or gaps that explain the phases equally well.
    """
    points = [panel_mm(design, position.panel_px) for position in fringes.values()]
    maps = [homography(p, f.pixel) for p, f in zip(points, fringes.values(), strict=True)]
    shape = next(iter(fringes.values())).shape
    first = camera or focal_guess(maps, shape, focal_px)
    poses = [pose_of_plane(h, first, name) for h, name in zip(maps, fringes, strict=True)]
    # Number of the lens over a panel point: a constant and two slopes at each position.
    planes = np.array(
        [
            np.linalg.lstsq(
                np.column_stack([np.ones(len(p)), p]), view_phase(design, *p.T) - f.phase
            )[0]
            for p, f in zip(points, fringes.values(), strict=True)
        ]
    )
    eyes = np.array([pose.eye_mm for pose in poses])
    slope = planes[:, 1:].mean(axis=0)
    angle = math.atan(slope[1] / slope[0])
    across, height = eyes[:, :2] @ [math.cos(angle), math.sin(angle)], eyes[:, 2]

    def pitch_for(gap: np.ndarray | float) -> np.ndarray:
        """Lens pitch that the slopes give with a gap."""
        share = 1 - np.multiply.outer(gap, 1 / height)
        pitches: np.ndarray = (share / np.hypot(*planes[:, 1:].T)).mean(axis=-1)
        return pitches

    # Lenses of a shorter focal length would not be as wide as they are.
    possible = design.focal_length_mm * (design.refractive_index - 1) * _GAPS
    gaps = _GAPS[possible > _LEAST_RADIUS * design.pitch_mm] * design.gap_mm
    # At the panel's centre, lens g e / (z P) - s / P.
    moved = gaps[:, None] * across / height / pitch_for(gaps)[:, None]
    waves = np.exp(2j * np.pi * (planes[:, 0] - moved)).mean(axis=1)
    off = (gaps / design.gap_mm - 1) / _GAP_SPREAD
    score = np.log(np.abs(waves) + 1e-3) - off**2 / (2 * len(poses))
    best = int(score.argmax())
    peaks = 1 + np.flatnonzero((score[1:-1] > score[:-2]) & (score[1:-1] > score[2:]))
    if len(peaks) > 1 and score[peaks].max() - np.sort(score[peaks])[-2] < _CLEAR:
        raise FileError(
            f"{', '.join(fringes)}: several gaps explain the fringes; photograph from a position "
            "between these, too"
        )
    gap, pitch = float(gaps[best]), float(pitch_for(gaps[best]))
    phase = -float(np.angle(waves[best])) / (2 * math.pi)
    steps = pitch / math.cos(angle)
    shift = phase * steps
    shift -= steps * round((shift - design.shift_x_mm) / steps)
    display = design.replace(
        pitch_mm=pitch,
        rotation_deg=math.degrees(angle),
        shift_x_mm=shift,
        shift_y_mm=0.0,
        gap_mm=gap,
        focal_length_mm=design.focal_length_mm * gap / design.gap_mm,
    )
    back = np.array([0.0, 0.0, gap])
    return Guess(display, first, tuple(Pose(p.turn, p.eye_mm - back) for p in poses))
