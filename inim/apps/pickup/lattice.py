"""Lattice of elemental images in a picture taken through a lens array.

A white picture is bright within each elemental image and dark in between. In a picture of a scene,
neighbouring elemental images do not continue each other, so brightness jumps at their seams. The
object repeats, too, at another pitch; therefore the approximate pitch must be given.

Start: the two frequencies whose harmonics have the largest sums in the spectrum.

Refinement: the mean elemental image is symmetric about its centre. Vignetting and uneven light
multiply it by a gain, which is nearly linear within one elemental image. The odd part of an
elemental image is therefore this gain's slope times the mean, minus the mean's gradient times the
error of the centre. Linear least squares estimate both for every elemental image, and the lattice
is fitted to the centres without outliers.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
from scipy import ndimage
from scipy.stats import t as student

from inim.system.errors import FileError

_LEAST_PITCH_PX, _LEAST_COUNT = 6.0, 6
_HARMONICS, _FIRST_HARMONICS, _PEAKS = 10, 4, 40
# Sum of harmonics, in typical amplitudes at their frequencies; that of white noise is below.
_LEAST_SUM = 25.0
# Relative deviation of the pitch from a given one.
_NEAR_PITCH = 0.025
# Angle between the base vectors against 90 or 60 degrees, and ratio of their lengths.
_MOST_SKEW_DEG, _MOST_ASPECT = 8.0, 1.25
# JPEG codes blocks of 8 x 8 pixels, whose borders resemble seams.
_JPEG_BLOCK = 8
_SAMPLES = 24
# Half the width of the window in which symmetry is measured, in pitches. Seams lie at 0.5.
_WINDOW, _WINDOW_WITH_SEAMS = 0.5, 0.65
_NEAR_SEAM = 0.12
# Systematic displacement of centres in pitches, in one direction on either side of the array: gains
# are not exactly linear, and outlines of the object touch seams.
_DISPLACED, _DISPLACED_WITH_SCENE = 2e-5, 0.06
# The same in pixels: they sample edges that are sharper than they are. This does not average out if
# the pitch is nearly a whole number of pixels.
_SAMPLING_PX = 0.01
# Rounds end when no centre moves by more than this.
_MOST_ROUNDS, _CONVERGED_PX = 25, 1e-4
# Contrast of an elemental image, in median ones; dark ones have less and are not used.
_LEAST_CONTRAST = 0.3
# Share of the elemental images that must be usable, and scatter of their centres in pitches: in a
# white picture, and in a scene.
_LEAST_USED, _MOST_SCATTER = (0.75, 0.1), (0.02, 0.05)
# Harmonics can be stronger than the base frequencies. Their cells are smaller, and fail the checks.
_MOST_PAIRS = 4
_TUKEY = 4.685
# Errors of neighbouring centres are correlated: intervals follow from sums over blocks.
_BLOCKS = 6
_NAMES = ("x_px", "y_px", "pitch_px", "row_pitch_px", "rotation_deg")


# Signals whose symmetry gives the x and the y of centres: one for a white picture, or two kinds of
# seams.
_Signals: TypeAlias = tuple[np.ndarray, np.ndarray]


class Interval(NamedTuple):
    """Estimate and half the width of its 95 % interval."""

    value: float
    half_width: float

    def __str__(self) -> str:
        digits = max(0, 1 - math.floor(math.log10(max(self.half_width, 1e-9))))
        return f"{self.value:.{digits}f} ± {self.half_width:.{digits}f}"


@dataclass(frozen=True)
class Lattice:
    """Lattice of `rows` x `columns` elemental images; those in the middle row are complete.

    Coordinates count from the picture's top left corner, x to the right and y down, in pixels,
    whose centres are at half-integers.
    """

    kind: str  #: "square" or "hexagonal", as `Display.lattice`.
    rows: int
    columns: int
    x_px: Interval  #: Centre of the array.
    y_px: Interval
    pitch_px: Interval
    row_pitch_px: Interval
    rotation_deg: Interval  #: Counter-clockwise, as the picture is seen.
    is_regular: bool  #: True if the row pitch was fitted as that of a regular lattice.
    #: (rows, columns, 2) float: measured minus fitted centre, x and y; NaN where unused.
    residual_px: np.ndarray

    @property
    def rms_px(self) -> float:
        """Root mean square residual of a coordinate."""
        return float(np.sqrt(np.nanmean(self.residual_px**2)))

    @property
    def used_count(self) -> int:
        """Number of elemental images that the lattice was fitted to."""
        return int(np.isfinite(self.residual_px[..., 0]).sum())

    def centres_px(self) -> np.ndarray:
        """Fitted centres, (rows, columns, 2) float: x and y."""
        position = _positions(self.kind, self.rows, self.columns)
        values = np.array([getattr(self, name).value for name in _NAMES])
        return _centres(values, position.reshape(-1, 2)).reshape(position.shape)


def find_lattice(light: np.ndarray, name: str, about_px: float | None = None) -> Lattice:
    """Find the lattice of elemental images.

    * `light`, (height, width) float: linear light.
    * `name`: name of the picture in error messages.
    * `about_px`: None for a white picture. For elemental images of a scene, their pitch within
      2.5 %: the object in them repeats, too, with a pitch that differs by its depth.

    Raises `FileError`: the picture has no lattice of at least 6 x 6 elemental images of 6 pixels.
    """
    signal = np.asarray(light, np.float64)
    if min(signal.shape) < _LEAST_COUNT * _LEAST_PITCH_PX or not np.ptp(signal) > 0:
        raise _no_lattice(name, "the picture is too small or uniform")
    signals = _seams(signal) if about_px is not None else (signal / np.quantile(signal, 0.99),) * 2
    errors = []
    for first, second in _frequencies(signals, name, about_px):
        try:
            return _fit_lattice(signals, first, second, name, about_px)
        except FileError as error:
            errors.append(error)
    raise errors[0]


def _fit_lattice(
    signals: _Signals, first: np.ndarray, second: np.ndarray, name: str, about_px: float | None
) -> Lattice:
    """Checked lattice with about these base frequencies."""
    kind, guess = _start(signals, first, second, name)
    fit = _LatticeFit(signals, kind, guess)
    # Corners and middles of sides are centres of symmetry, too, but not the brightest.
    shift = fit.brightest_shift()
    if shift.any():
        fit = _LatticeFit(signals, kind, fit.values + np.array([*shift, 0, 0, 0]))
    lattice = fit.lattice(name)
    pitches = lattice.pitch_px.value, lattice.row_pitch_px.value / _row_ratio(kind)
    if about_px is not None and any(abs(p / about_px - 1) > _NEAR_PITCH for p in pitches):
        raise _no_lattice(name, f"the seams lead to a pitch of {pitches[0]:.4g} pixels")
    return lattice


def _no_lattice(name: str, reason: str) -> FileError:
    return FileError(
        f"{name}: no lattice of elemental images ({reason}); give a sharp picture of at least "
        f"{_LEAST_COUNT} x {_LEAST_COUNT} elemental images, and --white, or "
        "--pitch-px"
    )


def _seams(light: np.ndarray) -> _Signals:
    """Relative jumps of brightness to the right and down, negative and limited in size."""
    floor = 0.01 * np.quantile(light, 0.99) + 1e-6
    logarithm = ndimage.gaussian_filter(np.log(np.maximum(light, 0) + floor), 0.7)
    down, right = (np.maximum(-np.abs(jump), -0.25) for jump in np.gradient(logarithm))
    return np.asarray(right), np.asarray(down)


def _frequencies(
    signals: _Signals, name: str, about_px: float | None
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Pairs of base frequencies of different cells, x and y in 1/pixel, likeliest first."""
    height, width = signals[0].shape
    right, down = (np.abs(np.fft.fftshift(np.fft.fft2(_windowed(s)))) for s in signals)
    fy, fx = (np.fft.fftshift(np.fft.fftfreq(size)) for size in (height, width))
    spectrum = np.where(np.abs(fx)[None, :] > np.abs(fy)[:, None], right, down)
    radius = np.hypot(fx[None, :], fy[:, None])
    ring = (radius * 200).astype(int)
    typical = ndimage.median(spectrum, ring, np.arange(ring.max() + 1))
    spectrum /= np.maximum(typical, 1e-300)[ring]
    least = _LEAST_COUNT / min(height, width)
    spectrum[radius < least / 2] = 0
    if about_px is not None:
        spectrum[_on_blocks(fy), :] = 0
        spectrum[:, _on_blocks(fx)] = 0
    is_peak = (spectrum == ndimage.maximum_filter(spectrum, 5)) & (fy[:, None] >= 0)
    peaks = np.argwhere(is_peak)
    strongest = peaks[np.argsort(-spectrum[is_peak])[:_PEAKS]]
    bases = [
        base
        for peak in strongest - np.array([height // 2, width // 2])
        for base in _base_frequencies(spectrum, peak)
        if least <= np.hypot(*base) <= 1 / _LEAST_PITCH_PX
    ]
    pairs = sorted(_pairs(spectrum, bases, about_px), key=lambda pair: -pair[0])
    if not pairs or pairs[0][0] < _LEAST_SUM:
        raise _no_lattice(name, "its spectrum has no two series of harmonics")
    chosen: list[tuple[np.ndarray, np.ndarray]] = []
    for total, *pair in pairs:
        sizes = [abs(_cross(*pair) / _cross(*other)) for other in chosen]
        is_new = all(abs(math.log(size)) > 0.1 for size in sizes)
        if total > _LEAST_SUM and is_new and len(chosen) < _MOST_PAIRS:
            chosen.append((pair[0], pair[1]))
    return chosen


def _windowed(signal: np.ndarray) -> np.ndarray:
    window = np.outer(*(np.hanning(size) for size in signal.shape))
    windowed: np.ndarray = (signal - signal.mean()) * window
    return windowed


def _on_blocks(f: np.ndarray) -> np.ndarray:
    """Mask of the frequencies of JPEG's blocks and their neighbours."""
    order = f * _JPEG_BLOCK
    is_near = np.abs(order - np.rint(order)) < 3 * _JPEG_BLOCK / f.size
    return np.asarray(is_near & (np.rint(order) != 0))


def _base_frequencies(spectrum: np.ndarray, peak: np.ndarray) -> list[np.ndarray]:
    """Base frequencies, in cycles per pixel, for a peak that is one of the first harmonics."""
    shape = np.array(spectrum.shape)
    near = np.linspace(-0.5, 0.5, 9)
    offsets = np.stack(np.meshgrid(near, near), axis=-1).reshape(-1, 2)
    bases = []
    for order in range(1, _FIRST_HARMONICS + 1):
        base = ((peak + offsets) / order / shape)[:, ::-1]
        bases.append(base[int(_harmonic_sums(spectrum, base).argmax())])
    return bases


def _harmonic_sums(spectrum: np.ndarray, base: np.ndarray) -> np.ndarray:
    """Sums of the weighted amplitudes at multiples of base frequencies, (n, 2) x and y."""
    shape, total = np.array(spectrum.shape), np.zeros(len(base))
    for harmonic in range(1, _HARMONICS + 1):
        frequency = harmonic * base[:, ::-1]
        if (np.abs(frequency) < 0.45).all():
            index = (frequency * shape + shape // 2).T
            # Weights prefer a base to its half, which has the same harmonics among its own.
            total += ndimage.map_coordinates(spectrum, index, order=1) / math.sqrt(harmonic)
    return total


def _pairs(
    spectrum: np.ndarray, bases: list[np.ndarray], about_px: float | None
) -> list[tuple[float, np.ndarray, np.ndarray]]:
    """Pairs of frequencies that can be those of a lattice, after the sum of their harmonics."""
    sums = _harmonic_sums(spectrum, np.reshape(bases, (-1, 2)))
    pairs = []
    for a, b in itertools.combinations(range(len(bases)), 2):
        first, second = bases[a], bases[b]
        lengths = np.hypot(*first), np.hypot(*second)
        angle = math.degrees(math.acos(min(1, abs(first @ second) / math.prod(lengths))))
        kind, turn = ("square", 90) if angle > 75 else ("hexagonal", 60)
        rows_px = math.inf if about_px is None else about_px * _row_ratio(kind)
        if (
            abs(angle - turn) < _MOST_SKEW_DEG
            and 1 / _MOST_ASPECT < lengths[0] / lengths[1] < _MOST_ASPECT
            and (about_px is None or all(abs(n * rows_px - 1) < _NEAR_PITCH for n in lengths))
        ):
            pairs.append((float(sums[a] + sums[b]), first, second))
    return pairs


def _cross(a: np.ndarray, b: np.ndarray) -> float:
    return float(a[0] * b[1] - a[1] * b[0])


def _start(
    signals: _Signals, first: np.ndarray, second: np.ndarray, name: str
) -> tuple[str, np.ndarray]:
    """Kind of the lattice, and start values in the order of `_NAMES`, about any elemental image."""
    base = np.stack([first, second])
    vectors = [*np.linalg.inv(base).T]
    area = abs(_cross(*vectors))
    angle = math.degrees(math.asin(min(1.0, area / math.prod(np.hypot(*v) for v in vectors))))
    if abs(angle - 60) <= _MOST_SKEW_DEG:
        kind = "hexagonal"
        vectors.append(
            min(vectors[0] + vectors[1], vectors[0] - vectors[1], key=lambda v: np.hypot(*v))
        )
    elif angle >= 90 - _MOST_SKEW_DEG:
        kind = "square"
    else:
        raise _no_lattice(name, f"its rows and columns enclose {angle:.0f} degrees")
    step = max([s * v for v in vectors for s in (1, -1)], key=lambda v: v[0] / np.hypot(*v))
    pitch = float(np.hypot(*step))
    # Both waves are brightest at a centre.
    shape = signals[0].shape
    y, x = (np.arange(size) + 0.5 for size in shape)
    phases = [
        np.angle(
            np.exp(-2j * np.pi * f[1] * y)
            @ _windowed(signals[int(abs(f[0]) <= abs(f[1]))])
            @ np.exp(-2j * np.pi * f[0] * x)
        )
        for f in base
    ]
    middle = np.array(shape[::-1]) / 2
    turns = -np.array(phases) / (2 * np.pi)
    centre = np.linalg.solve(base, turns + np.rint(base @ middle - turns))
    return kind, np.array([*centre, pitch, area / pitch, -math.degrees(math.atan2(*step[::-1]))])


def _row_ratio(kind: str) -> float:
    """Row pitch of a regular lattice, in pitches."""
    return math.sqrt(3) / 2 if kind == "hexagonal" else 1.0


def _centres(values: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Centres, (n, 2), of positions in the lattice: pitches to the right, rows down."""
    right, down = position[:, 0] * values[2], position[:, 1] * values[3]
    angle = math.radians(values[4])
    c, s = math.cos(angle), math.sin(angle)
    return np.stack([values[0] + c * right + s * down, values[1] - s * right + c * down], axis=-1)


def _positions(kind: str, rows: int, columns: int) -> np.ndarray:
    """Positions about the array's centre, (rows, columns, 2): pitches to the right, rows down.

    Rows of a hexagonal array are staggered as in `Display`.
    """
    down, right = (np.arange(count) - (count - 1) / 2 for count in (rows, columns))
    position = np.stack(np.meshgrid(right, down), axis=-1)
    if kind == "hexagonal" and rows > 1:
        position[..., 0] += (np.arange(rows) % 2)[:, None] / 2 - 0.25
    return position


class _LatticeFit:
    """Lattice fitted to centres of symmetry near start values."""

    def __init__(self, signals: _Signals, kind: str, start: np.ndarray) -> None:
        self._shape, self._kind, self.values = signals[0].shape, kind, start
        is_same = signals[0] is signals[1]
        self._window = _WINDOW if is_same else _WINDOW_WITH_SEAMS
        self._samples = min(_SAMPLES, math.ceil(2 * self._window * start[2]))
        step = 2 * self._window * start[2] / self._samples
        sigma = 0.5 * step if step > 1.5 else 0.0
        self._splines = [
            ndimage.spline_filter(ndimage.gaussian_filter(signal, sigma))
            for signal in signals[: 1 if is_same else 2]
        ]
        self._number()
        self._free = np.eye(5)
        self._iterate()
        # Lens arrays are regular unless the measurement clearly contradicts.
        excess = np.array([0, 0, -_row_ratio(kind), 1, 0])
        error = self._quantile * math.sqrt(excess @ self._covariance @ excess)
        if abs(excess @ self.values) <= 2 * error:
            self._free = np.delete(self._free, 3, axis=1)
            self._free[3, 2] = _row_ratio(kind)
            self.values[3] = self.values[2] * _row_ratio(kind)
            self._iterate()

    def _iterate(self) -> None:
        for _ in range(_MOST_ROUNDS):
            before = _centres(self.values, self._position)
            self._measure()
            self._solve()
            moved = np.abs(_centres(self.values, self._position) - before).max()
            if moved < _CONVERGED_PX * (1 if len(self._splines) == 1 else 100):
                break

    def _number(self) -> None:
        """Number the elemental images that lie in the picture; move the origin to their middle."""
        height, width = self._shape
        pitch, row_pitch, angle = self.values[2], self.values[3], math.radians(self.values[4])
        reach = math.ceil(math.hypot(height, width) / min(pitch, row_pitch))
        count = np.arange(-reach, reach + 1)
        row, column = (axis.ravel() for axis in np.meshgrid(count, count, indexing="ij"))
        stagger = 0.5 * (self._kind == "hexagonal")
        position = np.stack([column + stagger * (row % 2), row], axis=-1)
        centre = _centres(self.values, position)
        border = 0.49 * pitch * (abs(math.cos(angle)) + abs(math.sin(angle)))
        inside = ((centre > border) & (centre < (width - border, height - border))).all(axis=-1)
        row, position = row[inside], position[inside]
        self._row = row - row.min()
        start = position[:, 0] - stagger * (self._row % 2)
        self._column = np.rint(start - start.min()).astype(int)
        self.rows, self.columns = int(self._row.max()) + 1, int(self._column.max()) + 1
        grid = _positions(self._kind, self.rows, self.columns)
        self._position = grid[self._row, self._column]
        self.values = self.values.copy()
        self.values[:2] = _centres(self.values, (position - self._position)[:1])[0]

    def _sample(self, spline: np.ndarray, right: np.ndarray, down: np.ndarray) -> np.ndarray:
        """Signal at offsets from each centre along the lattice's axes, (n, offsets)."""
        turned = _centres(np.array([0, 0, 1, 1, self.values[4]]), np.stack([right, down], axis=-1))
        x, y = (_centres(self.values, self._position)[:, None] + turned).transpose(2, 0, 1)
        sampled: np.ndarray = ndimage.map_coordinates(
            spline, [y - 0.5, x - 0.5], order=3, mode="nearest", prefilter=False
        )
        return sampled

    def brightest_shift(self) -> np.ndarray:
        """Shift in pixels to the brightest of the four kinds of centres of symmetry."""
        position = np.array([[1.0, 0.0], [0.5 * (self._kind == "hexagonal"), 1.0]])
        right, down = _centres(np.array([0, 0, *self.values[2:]]), position)
        disc = np.linspace(-0.15, 0.15, 5) * self.values[2]
        across, along = (axis.ravel() for axis in np.meshgrid(disc, disc))
        base, shifts = self.values, (0 * right, right / 2, down / 2, (right + down) / 2)
        light = []
        for shift in shifts:
            self.values = base + np.array([*shift, 0, 0, 0])
            light.append(
                sum(self._sample(s, across, along)[self._used].mean() for s in self._splines)
            )
        self.values = base
        return np.asarray(shifts[int(np.argmax(light))])

    def _measure(self) -> None:
        """Measure the distance of each centre of symmetry from its fitted centre, pixels."""
        count = self._samples
        axis = ((np.arange(count) + 0.5) / count * 2 - 1) * self._window * self.values[2]
        right, down = (offset.ravel() for offset in np.meshgrid(axis, axis))
        offsets, contrasts = [], []
        for spline, along in zip(self._splines, (right, down), strict=False):
            sampled = self._sample(spline, right, down)
            if len(self._splines) > 1:  # the object's outlines are not at the seams
                near = np.abs(np.abs(along / self.values[2]) - 0.5) < _NEAR_SEAM
                sampled = np.where(near, sampled, 0)
            even, odd = (sampled + sampled[:, ::-1]) / 2, (sampled - sampled[:, ::-1]) / 2
            even -= even.mean(axis=1, keepdims=True)
            mean = even.mean(axis=0)
            for _ in range(2):
                contrast = even @ mean / (mean @ mean)
                used = contrast > _LEAST_CONTRAST * np.median(contrast)
                mean = even[used].mean(axis=0)
            slopes = np.gradient(mean.reshape(count, count), axis[1] - axis[0])
            level = mean - np.quantile(mean, 0.02)
            design = [-slopes[1].ravel(), -slopes[0].ravel(), right * level, down * level]
            if len(self._splines) > 1:
                design = [np.where(near, column, 0) for column in design]
            offset = odd @ np.linalg.pinv(np.stack(design, axis=1)).T[:, :2]
            offsets.append(offset / np.maximum(contrast, 1e-9)[:, None])
            contrasts.append(np.where(used, np.minimum(contrast, 1), 0))
        offset = np.stack([offsets[0][:, 0], offsets[-1][:, 1]], axis=-1)
        turned = _centres(np.array([0, 0, 1, 1, self.values[4]]), offset)
        self._offset = np.clip(turned, -self.values[2] / 4, self.values[2] / 4)
        self._weight = np.minimum(contrasts[0], contrasts[-1])

    def _solve(self) -> None:
        """Fit the free values to the measured centres, robustly; estimate their covariance."""
        angle, n = math.radians(self.values[4]), len(self._position)
        c, s = math.cos(angle), math.sin(angle)
        right, down = self._position.T
        jacobian = np.zeros((n, 2, 5))
        jacobian[:, (0, 1), (0, 1)] = 1
        jacobian[:, :, 2] = np.stack([c * right, -s * right], axis=-1)
        jacobian[:, :, 3] = np.stack([s * down, c * down], axis=-1)
        x, y = (_centres(self.values, self._position) - self.values[:2]).T
        jacobian[:, :, 4] = np.radians(np.stack([y, -x], axis=-1))
        jacobian = jacobian @ self._free
        change, weight = np.zeros(jacobian.shape[2]), self._weight
        for _ in range(10):
            residual = self._offset - jacobian @ change
            size = np.hypot(*residual.T)
            scale = np.median(size[self._weight > 0]) / 1.1774  # of a 2D normal distribution
            share = size / (_TUKEY * max(scale, 1e-9))
            weight = self._weight * np.where(share < 1, (1 - share**2) ** 2, 0)
            weighted = jacobian * weight[:, None, None]
            information = np.einsum("nki,nkj->ij", weighted, jacobian)
            change = np.linalg.solve(information, np.einsum("nki,nk->i", weighted, self._offset))
        self.values = self.values + self._free @ change
        self._residual = self._offset - jacobian @ change
        self._used = weight > 0
        # Delete-a-block jackknife; one step of least squares gives each block's influence.
        across = self._column * _BLOCKS // self.columns
        block = np.where(self._used, self._row * _BLOCKS // self.rows * _BLOCKS + across, -1)
        influence = []
        for number in np.unique(block[self._used]):
            own, rest = weighted[block == number], block != number
            remaining = np.einsum("nki,nkj->ij", weighted[rest], jacobian[rest])
            score = np.einsum("nki,nk->i", own, self._residual[block == number])
            influence.append(self._free @ np.linalg.solve(remaining, score))
        self._covariance = np.transpose(influence) @ influence
        freedom = max(len(influence) - jacobian.shape[2], 2)
        self._quantile = float(student.ppf(0.975, freedom))

    def lattice(self, name: str) -> Lattice:
        """Checked result."""
        half = self._quantile * np.sqrt(np.diag(self._covariance))
        displaced = _DISPLACED if len(self._splines) == 1 else _DISPLACED_WITH_SCENE
        across, down = self.columns / 2, self.rows / 2
        size = displaced * self.values[2] + _SAMPLING_PX
        turn = math.radians(1) * min(across, down) * self.values[2]
        bound = size / np.array([1, 1, across, down, turn])
        half = np.hypot(half, bound)
        residual = np.full((self.rows, self.columns, 2), np.nan)
        residual[self._row[self._used], self._column[self._used]] = self._residual[self._used]
        intervals = map(Interval, self.values.tolist(), half.tolist())
        lattice = Lattice(
            self._kind,
            self.rows,
            self.columns,
            **dict(zip(_NAMES, intervals, strict=True)),
            is_regular=self._free.shape[1] < len(_NAMES),
            residual_px=residual,
        )
        pitch, share = lattice.pitch_px.value, float(self._used.mean())
        case = len(self._splines) - 1
        if share < _LEAST_USED[case] or not lattice.rms_px < _MOST_SCATTER[case] * pitch:
            raise _no_lattice(
                name,
                f"{share:.0%} of the elemental images at a pitch of {pitch:.4g} pixels are usable, "
                f"their centres scatter by {lattice.rms_px:.2g} pixels",
            )
        return lattice
