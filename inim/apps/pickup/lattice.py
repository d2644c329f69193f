"""Lattice of elemental images in a picture taken through a lens array.

A white picture is bright within elemental images; in one of a scene, brightness jumps at their
seams. The start is the frequency with the largest sum of harmonics, in all directions of a regular
lattice. Then centres are measured: the mean elemental image is symmetric about its centre, and
vignetting multiplies it by a nearly linear gain, so the odd part of an elemental image is the
gain's slope times the mean, minus the mean's gradient times the error of the centre. Points and
places, in pitches right and down, are complex: a centre is c + s z + e conj(z), regular if e is 0.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy import ndimage
from scipy.stats import t as student

from inim.system.errors import FileError

_LEAST_PITCH_PX, _LEAST_COUNT = 6.0, 6
# Sums of harmonics are in typical amplitudes at their frequencies; those of white noise are below.
# Harmonics can be stronger than the base. Their cells are smaller, and fail the checks.
_HARMONICS, _FIRST_HARMONICS, _PEAKS, _LEAST_SUM, _MOST_STARTS = 10, 4, 40, 12.5, 4
# Relative deviation from a given pitch; borders of JPEG's blocks, which resemble seams.
_NEAR_PITCH, _JPEG_BLOCK = 0.025, 8
# Angle between the base vectors of a lattice, and the number of their directions.
_TURNS = {"square": (math.pi / 2, 2), "hexagonal": (math.pi / 3, 3)}
_ROW_RATIO = {kind: math.sin(turn) for kind, (turn, _) in _TURNS.items()}
# An elemental image counts if this part of a pitch about its centre is in the picture.
_LEAST_INSIDE = 0.44
# Where two numbers follow, they are for a white picture and for a scene. Half the width of the
# window in which symmetry is measured, in pitches, and samples across it. Seams lie at 0.5.
_WINDOW, _SAMPLES, _NEAR_SEAM = (0.5, 0.65), 24, 0.12
# Systematic displacement of centres on either side of the array: in pitches, as gains are not
# exactly linear and outlines touch seams; in pixels, as samples of sharp edges do not average out.
_DISPLACED, _SAMPLING_PX = (2e-5, 0.06), 0.01
_MOST_ROUNDS, _CONVERGED_PX = 25, (1e-4, 1e-2)
# Share of the elemental images that the mean one explains; a smaller cell has different images.
_LEAST_EXPLAINED = (0.9, 0.0)
# Contrast in median ones, share of the elemental images that must have it, scatter in pitches.
_LEAST_CONTRAST, _LEAST_USED, _MOST_SCATTER = 0.3, (0.75, 0.1), (0.02, 0.05)
# Errors of neighbouring centres are correlated: intervals follow from fits without a block.
_TUKEY, _BLOCKS = 4.685, 6
_NAMES = ("x_px", "y_px", "pitch_px", "row_pitch_px", "rotation_deg")


class Interval(NamedTuple):
    """Estimate and half the width of its 95 % interval."""

    value: float
    half_width: float

    def __str__(self) -> str:
        digits = max(0, 1 - math.floor(math.log10(max(self.half_width, 1e-9))))
        return f"{self.value:.{digits}f} ± {self.half_width:.{digits}f}"


@dataclass(frozen=True)
class Lattice:
    """Lattice of `rows` x `columns` elemental images; those in the middle row are nearly complete.

    Pixels count from the picture's top left corner, x to the right and y down.
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
    rms_px: float  #: Root mean square residual of a coordinate.
    used_count: int  #: Number of elemental images that the lattice was fitted to.

    def centres_px(self) -> np.ndarray:
        """Fitted centres, (rows, columns, 2) float: x and y."""
        places = _places(self.kind, self.rows, self.columns)
        down = self.row_pitch_px.value / _ROW_RATIO[self.kind] * places.imag
        along = self.pitch_px.value * places.real + 1j * down
        turned = along * np.exp(-1j * math.radians(self.rotation_deg.value))
        return np.stack([self.x_px.value + turned.real, self.y_px.value + turned.imag], axis=-1)


def find_lattice(light: np.ndarray, name: str, about_px: float | None = None) -> Lattice:
    """Find the lattice of elemental images.

    * `light`, (height, width) float: linear light of the picture with a `name`.
    * `about_px`: None for a white picture. In one of a scene, the pitch within 2.5 %: the object
      repeats, too, with a pitch that differs by its depth.

    Raises `FileError`: the picture has no lattice of at least 6 x 6 elemental images of 6 pixels.
    """
    signal, is_scene = np.asarray(light, np.float64), about_px is not None
    if min(signal.shape) >= _LEAST_COUNT * _LEAST_PITCH_PX and np.ptp(signal) > 0:
        signals = _seams(signal) if is_scene else signal[None]
        for start in _starts(signals, about_px):
            fit = _LatticeFit(signals, *start)
            lattice, pitch = fit.lattice(), fit.values[2]
            is_sharp = lattice.rms_px < _MOST_SCATTER[is_scene] * pitch
            is_near = abs(pitch / (about_px or pitch) - 1) < _NEAR_PITCH
            is_alike = fit.explained_share > _LEAST_EXPLAINED[is_scene]
            is_used = (fit.weight > 0).mean() >= _LEAST_USED[is_scene]
            if is_sharp and is_near and is_alike and is_used:
                return lattice
    raise FileError(
        f"{name}: no lattice of elemental images; give a sharp picture of at least "
        f"{_LEAST_COUNT} x {_LEAST_COUNT} elemental images, and --white, or --pitch-px"
    )


def _seams(light: np.ndarray) -> np.ndarray:
    """Jumps of brightness to the right and down, (2, height, width): negative and limited."""
    floor = 0.01 * np.quantile(light, 0.99) + 1e-6
    logarithm = ndimage.gaussian_filter(np.log(np.maximum(light, 0) + floor), 0.7)
    return np.asarray(-np.abs(np.gradient(logarithm)[::-1]).clip(max=0.25))


def _places(kind: str, rows: int, columns: int) -> np.ndarray:
    """Places about the array's centre, (rows, columns) complex; staggered as in `Display`."""
    right, down = np.meshgrid(*(np.arange(n) - (n - 1) / 2 for n in (columns, rows)))
    if kind == "hexagonal" and rows > 1:
        right = right + (np.arange(rows) % 2)[:, None] / 2 - 0.25
    return np.asarray(right + 1j * _ROW_RATIO[kind] * down)


def _starts(signals: np.ndarray, about_px: float | None) -> Iterator[tuple[str, complex, complex]]:
    """Kind, centre and step of regular lattices of different cells, likeliest first."""
    shape = np.array(signals.shape[1:])
    window = np.outer(*(np.hanning(size) for size in shape))
    signals = (signals - signals.mean(axis=(1, 2), keepdims=True)) * window
    spectrum = _spectrum(signals)
    is_peak = (spectrum == ndimage.maximum_filter(spectrum, 5)) & (spectrum > 0)
    peaks = np.argwhere(is_peak)[np.argsort(-spectrum[is_peak])[:_PEAKS]] - shape // 2
    # A peak, half a pixel of the spectrum to either side, is one of the first harmonics.
    near = np.linspace(-0.5, 0.5, 9)
    offsets = np.stack(np.meshgrid(near, near), axis=-1).reshape(-1, 2)
    bases = ((peaks[:, None] + offsets) / shape) @ (1j, 1)
    bases = np.concatenate([bases / n for n in range(1, _FIRST_HARMONICS + 1)])
    starts = []
    for kind, (turn, directions) in _TURNS.items():
        pitch = 1 / np.abs(bases[:, offsets.shape[0] // 2]) / _ROW_RATIO[kind]
        fits = (pitch > _LEAST_PITCH_PX) & (pitch < shape.min() / _LEAST_COUNT)
        if about_px is not None:
            fits &= np.abs(pitch / about_px - 1) < _NEAR_PITCH
        turned = bases[fits, :, None] * np.exp(1j * turn * np.arange(directions))
        sums = _harmonic_sums(spectrum, turned).min(axis=-1)
        best = np.arange(len(sums)), sums.argmax(axis=1)
        starts += [(*start, kind) for start in zip(sums[best], bases[fits][best], strict=True)]
    starts.sort(key=lambda start: start[0])
    of_cells = {(start[2], round(20 * math.log(abs(start[1])))): start for start in starts}
    for total, base, kind in sorted(of_cells.values(), key=lambda s: -s[0])[:_MOST_STARTS]:
        if total > _LEAST_SUM:
            yield kind, *_first_lattice(signals, kind, complex(base))


def _spectrum(signals: np.ndarray) -> np.ndarray:
    """Amplitudes relative to the typical one of a ring, with the frequency 0 in the middle."""
    fy, fx = (np.fft.fftshift(np.fft.fftfreq(size)) for size in signals.shape[1:])
    right, down = (np.abs(np.fft.fftshift(np.fft.fft2(signals[k]))) for k in (0, -1))
    spectrum = np.where(np.abs(fx) > np.abs(fy)[:, None], right, down)
    radius = np.hypot(fx, fy[:, None])
    ring = (radius * 200).astype(int)
    counts = np.maximum(np.bincount(ring.ravel()), 1)
    spectrum /= np.maximum(np.bincount(ring.ravel(), spectrum.ravel()) / counts, 1e-300)[ring]
    spectrum[radius < _LEAST_COUNT / 2 / min(spectrum.shape)] = 0
    for f, lines in ((fy, spectrum), (fx, spectrum.T)):
        order = f * _JPEG_BLOCK
        is_block = np.abs(order - np.rint(order)) < 3 * _JPEG_BLOCK / f.size
        lines[is_block & (np.rint(order) != 0) & (len(signals) > 1)] = 0
    return spectrum


def _harmonic_sums(spectrum: np.ndarray, base: np.ndarray) -> np.ndarray:
    """Sums of the weighted amplitudes at multiples of base frequencies, x + iy in 1/pixel."""
    rows, columns = spectrum.shape
    total = np.zeros(base.shape)
    for n in range(1, _HARMONICS + 1):
        index = [n * base.imag * rows + rows // 2, n * base.real * columns + columns // 2]
        # Weights prefer a base to its half, which has the same harmonics among its own.
        amplitude = ndimage.map_coordinates(spectrum, index, order=1) / math.sqrt(n)
        total += np.where(n * np.abs(base) < 0.45, amplitude, 0)
    return total


def _first_lattice(signals: np.ndarray, kind: str, base: complex) -> tuple[complex, complex]:
    """Centre, near the picture's middle, and step of the lattice with a base frequency."""
    turn, (height, width) = _TURNS[kind][0], signals.shape[1:]
    pair = np.array([base, base * np.exp(1j * turn)])
    down = np.exp(-2j * np.pi * np.outer(pair.imag, np.arange(height) + 0.5))
    right = np.exp(-2j * np.pi * np.outer(pair.real, np.arange(width) + 0.5))
    own = signals[np.where(np.abs(pair.real) > np.abs(pair.imag), 0, -1)]
    # Both waves are brightest at a centre.
    turns = -np.angle(((down[:, None] @ own)[:, 0] * right).sum(axis=1)) / (2 * np.pi)
    directions = np.stack([pair.real, pair.imag], axis=1)
    turns += np.rint(directions @ (width / 2, height / 2) - turns)
    # Base vectors are perpendicular to base frequencies; the step is the most level one.
    steps = 1j * base / abs(base) ** 2 / math.sin(turn) * np.exp(1j * turn * np.arange(6))
    return complex(*np.linalg.solve(directions, turns)), complex(steps[steps.real.argmax()])


class _LatticeFit:
    """Lattice fitted to centres of symmetry near that of a start."""

    def __init__(self, signals: np.ndarray, kind: str, centre: complex, step: complex) -> None:
        self._kind, self._is_scene, reach = kind, len(signals) > 1, _WINDOW[len(signals) - 1]
        self._samples = min(_SAMPLES, math.ceil(2 * reach * abs(step)))
        sigma = reach * abs(step) / self._samples  # half the distance of samples
        smooth = [ndimage.gaussian_filter(s, sigma if sigma > 0.75 else 0.0) for s in signals]
        self._splines = [ndimage.spline_filter(signal) for signal in smooth]
        self._number(signals.shape[1:], centre, step)
        self._iterate(terms=2)
        # A start does not reach all corners.
        self._number(signals.shape[1:], self._centres()[0], self._model[1])
        # Lens arrays are regular unless the measurement clearly contradicts.
        self._iterate(terms=3)
        excess = np.array([0, 0, _ROW_RATIO[kind], -1, 0])
        error = self._quantile * math.hypot(*self._errors @ excess)
        self._is_regular = bool(abs(self.values @ excess) <= 2 * error)
        if self._is_regular:
            self._iterate(terms=2)

    def _number(self, shape: tuple[int, ...], centre: complex, step: complex) -> None:
        """Number the elemental images in the picture; move the origin to their middle."""
        height, width = shape
        reach = math.ceil(math.hypot(height, width) / abs(step) / _ROW_RATIO[self._kind])
        count = np.arange(-reach, reach + 1)
        row, column = np.meshgrid(count, count, indexing="ij")
        stagger = 0.5 * (self._kind == "hexagonal")
        right = column + stagger * (row % 2)
        point = centre + step * (right + 1j * _ROW_RATIO[self._kind] * row)
        border = _LEAST_INSIDE * (abs(step.real) + abs(step.imag))
        inside = np.abs(point.real - width / 2) < width / 2 - border
        inside &= np.abs(point.imag - height / 2) < height / 2 - border
        self._row = row[inside] - row[inside].min()
        start = right[inside] - stagger * (self._row % 2)
        self._column = np.rint(start - start.min()).astype(int)
        self._shape = int(self._row.max()) + 1, int(self._column.max()) + 1
        place = _places(self._kind, *self._shape)[self._row, self._column]
        self._design = np.stack([np.ones_like(place), place, place.conj()], axis=-1)
        self._model = np.array([point[inside][0] - step * place[0], step, 0])

    def _centres(self) -> np.ndarray:
        return np.asarray(self._design @ self._model)

    def _iterate(self, terms: int) -> None:
        """Measure centres and fit the model's first terms to them, until the centres rest."""
        for _ in range(_MOST_ROUNDS):
            before = self._centres()
            self._measure()
            self._solve(terms)
            if np.abs(self._centres() - before).max() < _CONVERGED_PX[self._is_scene]:
                return

    def _measure(self) -> None:
        """Measure each centre of symmetry near its fitted centre, and its relative contrast."""
        count, step = self._samples, self._model[1]
        axis = ((np.arange(count) + 0.5) / count * 2 - 1) * _WINDOW[self._is_scene]
        right, down = (offset.ravel() for offset in np.meshgrid(axis, axis))
        centres = self._centres()
        points = centres[:, None] + step * (right + 1j * down) - (0.5 + 0.5j)
        self._contrast, offsets = np.ones(len(centres)), []
        for spline, along in zip(self._splines, (right, down), strict=False):
            sampled = ndimage.map_coordinates(
                spline, [points.imag, points.real], order=3, mode="nearest", prefilter=False
            )
            # Outlines of the object lie elsewhere.
            compared = (np.abs(np.abs(along) - 0.5) < _NEAR_SEAM) | (not self._is_scene)
            sampled[:, ~compared] = 0
            even, odd = (sampled + sampled[:, ::-1]) / 2, (sampled - sampled[:, ::-1]) / 2
            even -= even.mean(axis=1, keepdims=True)
            mean = even.mean(axis=0)
            for _ in range(2):
                contrast = even @ mean / (mean @ mean)
                used = contrast > _LEAST_CONTRAST * np.median(contrast)
                mean = even[used].mean(axis=0)
            self.explained_share = (mean @ mean) * contrast @ contrast / (even**2).sum()
            slope_down, slope_right = np.gradient(mean.reshape(count, count), axis[1] - axis[0])
            level = mean - np.quantile(mean, 0.02)
            columns = [-slope_right.ravel(), -slope_down.ravel(), right * level, down * level]
            fit = odd @ np.linalg.pinv(np.stack(columns, axis=1) * compared[:, None]).T
            offsets.append((fit[:, :2] / np.maximum(contrast, 1e-9)[:, None]).clip(-0.25, 0.25))
            self._contrast = np.minimum(self._contrast, np.where(used, contrast.clip(1e-6), 0))
        self._measured = centres + step * (offsets[0][:, 0] + 1j * offsets[-1][:, 1])

    def _solve(self, terms: int) -> None:
        """Fit the model's first terms to measured centres, robustly; estimate its errors."""
        for _ in range(10):
            size = np.abs(self._measured - self._centres())
            scale = np.median(size[self._contrast > 0]) / 1.1774  # of a 2D normal distribution
            share = size / (_TUKEY * max(scale, 1e-9))
            weight = self._contrast * np.where(share < 1, (1 - share**2) ** 2, 0)
            self._model = self._least_squares(weight, terms)
        self.weight, self.values = weight, self._parameters(self._model)
        # Delete-a-block jackknife.
        rows, columns = self._shape
        block = self._row * _BLOCKS // rows * _BLOCKS + self._column * _BLOCKS // columns
        others = [weight * (block != b) for b in np.unique(block[weight > 0])]
        parameters = [self._parameters(self._least_squares(w, terms)) for w in others]
        self._errors = np.stack(parameters) - self.values
        self._quantile = float(student.ppf(0.975, max(len(self._errors) - terms, 2)))

    def _least_squares(self, weight: np.ndarray, terms: int) -> np.ndarray:
        root, model = np.sqrt(weight), np.zeros(3, complex)
        design = self._design[:, :terms] * root[:, None]
        model[:terms] = np.linalg.lstsq(design, self._measured * root, rcond=None)[0]
        return model

    def _parameters(self, model: np.ndarray) -> np.ndarray:
        """x, y, pitch, row pitch in pixels, rotation in degrees."""
        centre, step, skew = model
        pitches = abs(step + skew), _ROW_RATIO[self._kind] * abs(step - skew)
        return np.array([centre.real, centre.imag, *pitches, -math.degrees(np.angle(step))])

    def lattice(self) -> Lattice:
        """Result with 95 % intervals."""
        random = self._quantile * np.sqrt((self._errors**2).sum(axis=0))
        down, across = (count / 2 for count in self._shape)
        turn = math.radians(1) * min(across, down) * self.values[2]
        size = _DISPLACED[self._is_scene] * self.values[2] + _SAMPLING_PX
        half = np.hypot(random, size / np.array([1, 1, across, down, turn]))
        residual = np.full((*self._shape, 2), np.nan)
        off = np.where(self.weight > 0, self._measured - self._centres(), np.nan)
        residual[self._row, self._column] = np.stack([off.real, off.imag], axis=-1)
        intervals = map(Interval, self.values.tolist(), half.tolist())
        named: dict[str, Any] = dict(zip(_NAMES, intervals, strict=True))
        named |= {"is_regular": self._is_regular, "residual_px": residual}
        rms, used = float(np.sqrt(np.nanmean(residual**2))), int((self.weight > 0).sum())
        return Lattice(self._kind, *self._shape, **named, rms_px=rms, used_count=used)
