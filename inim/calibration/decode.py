"""Decoding: the panel point that each camera pixel sees, from photographs of the patterns.

From three steps of a cosine, I_k = A + B cos(p - 2 pi k / 3), mean, amplitude and phase follow:
A = sum(I_k) / 3, and B e^(i p) = 2/3 sum(I_k e^(2 pi i k / 3)). Constant light cancels. A wrong
gamma adds C cos 2(p - 2 pi k / 3): the amplitude then varies as C cos 3p, and the phase is off by
-C / B sin 3p. The first gives C, which corrects the second.

A camera that shakes moves the photographs. A is the same for columns and rows in aligned
photographs. Where it is not, the photographs' gradients give their displacement.

The phase gives the panel point modulo a period; `lattice` numbers the periods.

Through cylinders, a photograph is smoothed over a lens first. Its waves are then those of a bare
panel at the depth of the gap: the displacements within a lens, to both sides, cancel.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.ndimage import affine_transform, gaussian_filter

from inim.calibration.patterns import Position, read_photograph
from inim.calibration.video import read_video
from inim.errors import FileError

_TURNS = np.exp(2j * np.pi / 3 * np.arange(3)).astype(np.complex64)
_BRIGHT_QUANTILE = 0.95
# Amplitude of lenses, as a share of that of bright ones; of those, the least for all.
_LIT_SHARE, _DARKEST = 0.1, 0.015
_FEWEST_LIT = 0.005
# Codes from 254 on: JPEG moves them by one.
_SATURATED_LIGHT = 0.99
_MOST_SATURATED = 0.02
# Amplitude over mean. Two lenses with phases 129 degrees apart have less than this share of the
# usual ratio together if each gives more than a fifth of the light.
_SINGLE_LENS_SHARE = 0.7
_LEAST_CONTRAST = 0.4
# The same of views: cylinders mix neighbouring ones, most of all at the edges of the viewing zone.
_SIMILAR_VIEWS, _LEAST_VIEWS = 0.3, 0.08
# Sigma of the smoothing over cylinders, in pitches: the lenses themselves, and the rows of pixels
# that slanted ones cross, vanish. Amplitude of the panel then, as for lenses, and its least share
# of what a pixel is smoothed over: three sigmas from its edges.
_SMOOTHING, _SMOOTH_LIT_SHARE, _WHOLLY_LIT = 1.2, 0.3, 0.999
# Pixels per cylinder, below which the cylinders beat with the pixels.
_NARROWEST_PX = 2.5
# The fourth harmonic of a power of a cosine is 0.1 of the second, near the power 1. It adds to the
# ripple of the amplitude and takes from that of the phase: (1 - 0.1) / (1 + 0.1).
_SECOND_HARMONIC, _RIPPLE_STEPS = 0.82, 3
# Marks are darker than the mean of the cosine, and rare.
_MOST_MARKED = 0.3
# Mean of the columns' photographs less that of the rows', relative to it, without noise.
_MOST_UNLIKE, _UNLIKE_BLUR_PX = 0.04, 2.0
# Displacements are found from coarse to fine: blur in pixels. Usual displacements and exposures
# keep undetermined ones at zero.
_SCALES_PX = (4.0, 2.0, 1.0, 0.7)
_ALIGNED_PIXELS = 60_000
_USUAL_MOTION_PX, _USUAL_GAIN = 1.0, 0.1
# Pixels of a lens have a common error. An alignment must lessen the difference to this share.
_CORRELATED_PIXELS, _LEAST_GAIN = 50, 0.95
# Difference of the means in aligned photographs, as a share of them.
_LEAST_UNLIKE = 0.01
# Interpolation blurs: smaller displacements are not corrected.
_LEAST_MOTION_PX = 0.03


class Decoded(NamedTuple):
    """Panel coordinates that the pixels of a camera see, (H, W) each."""

    #: Panel pixels from the panel's centre to the right and down, modulo the cosine's period; NaN,
    #: for both, where not decoded. They are means over a camera pixel's blur.
    column: np.ndarray
    row: np.ndarray
    is_marked: np.ndarray  #: True where a mark of the white pattern is seen.
    #: (2, H, W) complex: cosines of columns and rows, with amplitudes relative to the usual one.
    waves: np.ndarray
    motion_px: float  #: Corrected displacement of the photographs, root mean square.
    warnings: tuple[str, ...]
    view: np.ndarray | None = None  #: Phase of the view patterns, periods, modulo 1.


def decode(position: Position) -> Decoded:
    """Decode the photographs of one camera position.

    Raises `FileError`: a photograph that cannot be read; photographs too dark, saturated or
    unsharp, or not in the order of the patterns. The line names the photographs.
    """
    paths = position.photographs
    name = str(position.source)
    warnings = []
    white, *lights = _read(position)
    absent = [k for k, light in enumerate(lights) if light is None]
    phases = np.stack([np.zeros(position.shape, np.float32) if x is None else x for x in lights])
    for k in absent:
        _derive(phases, k)
    lit = _lit(phases, name)
    if position.cylinder_px is not None:
        if white is None:
            raise FileError(
                f"{name}: the photograph of the white pattern is missing, whose marks number the "
                "lenses; take the photographs again"
            )
        sigma_px = _SMOOTHING * _cylinder_px(phases, lit, position)
        for light in (*phases, white):
            gaussian_filter(light, sigma_px, output=light)
        lit = _lit(phases, name, _SMOOTH_LIT_SHARE)
        lit = gaussian_filter(lit.astype(np.float32), sigma_px) > _WHOLLY_LIT
    motion_px = 0.0
    if white is None or absent:
        warnings.append(f"{name}: a photograph is missing; the others replace it")
    if not absent:
        # Where they are smooth, a motion of a pixel moves a position's waves as the camera would.
        is_smooth = position.cylinder_px is not None
        motion_px, unlike = (0.0, _unlike(phases, lit)) if is_smooth else _align(phases, lit)
        if unlike > _MOST_UNLIKE:
            worst = _replace_worst(phases, lit)
            warnings.append(
                f"{paths[1 + worst]}: does not fit the other photographs of this position and is "
                "not used; keep camera, exposure and display fixed"
            )
    mean, waves = _waves(phases)
    # By the other axis's mean: one's own has a third harmonic with a wrong gamma.
    contrast = np.abs(waves) / np.roll(mean, 1, axis=0)
    usual = np.median(contrast[:, lit], axis=1)[:, None, None]
    if usual[:2].min() < _LEAST_CONTRAST:
        raise FileError(
            f"{name}: blurred, or lit by the room: the waves have {usual[:2].min():.0%} of their "
            "contrast; focus on the lens sheet, hold the camera still, darken the room"
        )
    if usual[2:].min(initial=1.0) < _LEAST_VIEWS:
        raise FileError(
            f"{name}: the views have {usual[2:].min():.0%} of their contrast; give the "
            "photographed display with --display, such as its model with the right sign of the "
            "slope, and show the patterns pixel for pixel"
        )
    relative = contrast / usual
    similar = np.array([_SINGLE_LENS_SHARE] * 2 + [_SIMILAR_VIEWS] * (len(waves) - 2))
    similar = similar[:, None, None]
    is_single = ((relative > similar) & (relative < 1 / similar)).all(axis=0) & lit
    column, row, *views = (
        np.float32(period) * _cycles(wave, ratio, is_single)
        for period, wave, ratio in zip((*position.periods_px, 1.0), waves, contrast, strict=False)
    )
    is_marked = np.zeros(lit.shape, bool)
    if white is not None:
        is_marked = (white < mean.mean(axis=0)) & lit
        if is_marked.sum() > _MOST_MARKED * lit.sum():
            raise FileError(
                f"{paths[0]}: is darker than the waves; photograph the patterns in their order, "
                "white first, with fixed exposure"
            )
    _check_saturation(name, [light for light in (white, *lights) if light is not None], lit)
    waves /= (mean * usual).astype(np.float32)
    return Decoded(column, row, is_marked, waves, motion_px, tuple(warnings), *views)


def _read(position: Position) -> list[np.ndarray | None]:
    """The photographs; None for one that is missing or damaged."""
    if not position.source.is_dir():
        return read_video(position.source, len(position.photographs))
    lights: list[np.ndarray | None] = []
    failure = FileError(f"{position.name}: two photographs are missing; take them again")
    for path in position.photographs:
        light = None
        try:
            light = None if path is None else read_photograph(path)
        except FileError as error:
            failure = error
        if light is not None and light.shape != position.shape:
            raise FileError(
                f"{path}: has {light.shape[1]} x {light.shape[0]} pixels, but the others have "
                f"{position.shape[1]} x {position.shape[0]}; photograph all patterns of a position "
                "with one camera"
            )
        lights.append(light)
    if sum(light is None for light in lights) > 1:
        raise failure
    return lights


def _derive(phases: np.ndarray, k: int) -> None:
    """Replace a phase: all three of an axis add up to those of another axis."""
    own = 3 * (k // 3)
    other = 3 if own == 0 else 0
    phases[k] += phases[other : other + 3].sum(axis=0) - phases[own : own + 3].sum(axis=0)


def _waves(phases: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means and complex amplitudes of columns, rows and views, (axes, ...) each."""
    steps = phases.reshape(-1, 3, *phases.shape[1:])
    mean = np.maximum(steps.mean(axis=1), np.float32(1e-6))
    return mean, np.einsum("k,ak...->a...", _TURNS * np.float32(2 / 3), steps)


def _lit(phases: np.ndarray, name: str, share: float = _LIT_SHARE) -> np.ndarray:
    """Mask of pixels that see the panel, whose amplitude is above a share of bright ones."""
    amplitude = np.abs(_waves(phases)[1]).max(axis=0)
    bright = float(np.quantile(amplitude, _BRIGHT_QUANTILE))
    lit: np.ndarray = amplitude > share * max(bright, _DARKEST)
    if bright < _DARKEST or lit.mean() < _FEWEST_LIT:
        raise FileError(
            f"{name}: the waves are hardly visible ({2 * bright:.1%} of the brightest code); "
            "expose longer, darken the room, and let the display fill the picture"
        )
    return lit


def _cylinder_px(phases: np.ndarray, lit: np.ndarray, position: Position) -> float:
    """Pitch of the cylinders in a photograph, from the mean slopes of the waves.

    Raises `FileError`: too few pixels per lens.
    """
    scale = 1.0
    for wave, period in zip(_waves(phases[:6])[1], position.periods_px, strict=True):
        wave = np.where(lit, wave, 0)
        steps = [
            (wave[1:] * wave[:-1].conj()).sum(),
            (wave[:, 1:] * wave[:, :-1].conj()).sum(),
        ]
        cycles_per_px = np.hypot(*np.angle(steps)) / (2 * np.pi)
        scale *= float(cycles_per_px * period)
    pitch_px = (position.cylinder_px or 0.0) / max(math.sqrt(scale), 1e-9)
    if pitch_px < _NARROWEST_PX:
        raise FileError(
            f"{position.source}: a lens is {pitch_px:.1f} pixels wide, and {_NARROWEST_PX:g} are "
            "needed; fill the photograph with the display, or take larger photographs"
        )
    return pitch_px


def _check_saturation(name: str, lights: list[np.ndarray], lit: np.ndarray) -> None:
    saturated = max(float((light[lit] > _SATURATED_LIGHT).mean()) for light in lights)
    if saturated > _MOST_SATURATED:
        raise FileError(
            f"{name}: saturated in {saturated:.0%} of the lit area; use a shorter exposure for all "
            "photographs of this position"
        )


def _cycles(wave: np.ndarray, contrast: np.ndarray, is_single: np.ndarray) -> np.ndarray:
    """Phase in periods, with the second harmonic of a wrong gamma removed; NaN elsewhere."""
    phase = np.where(is_single, np.angle(wave), np.float32(np.nan))
    ripple = np.cos(3 * phase[is_single])
    ratio = contrast[is_single] / contrast[is_single].mean() - 1
    share = _SECOND_HARMONIC * float(ripple @ ratio / np.maximum(ripple @ ripple, 1))
    true = phase
    for _ in range(_RIPPLE_STEPS):
        true = phase + np.float32(share) * np.sin(3 * true)
    cycles: np.ndarray = true / np.float32(2 * np.pi)
    return cycles


def _align(phases: np.ndarray, lit: np.ndarray) -> tuple[float, float]:
    """Align the photographs, and equalise their exposures, in place.

    The difference of the two means is linear in each photograph's displacement, an affine map, and
    in its exposure. What does not change the difference does not change the result either: a
    displacement that is common to an axis is one of the camera.

    Returns displacement, root mean square in pixels, and the remaining difference of the means as a
    share of them.
    """
    places = np.flatnonzero(lit)
    places = places[:: 1 + len(places) // _ALIGNED_PIXELS]
    height, width = lit.shape
    row, column = np.divmod(places, width)
    # Shift and first order of the position: 1, x, y from the middle, in half widths.
    terms = np.stack(
        [np.ones(len(places)), 2 * column / width - 1, (2 * row - height) / width]
    ).astype(np.float32)
    usual = np.repeat([_USUAL_GAIN, _USUAL_MOTION_PX], [1, 6])
    total, original = np.zeros((6, 7)), phases.copy()
    sign = np.repeat(np.array([1 / 3, -1 / 3], np.float32), 3)
    for scale in _SCALES_PX:
        columns, difference = [], np.zeros(len(places))
        for k, light in enumerate(phases):
            smooth = gaussian_filter(light, scale)
            down, across = (g.ravel()[places] for g in np.gradient(smooth))
            here = smooth.ravel()[places]
            difference += sign[k] * here
            columns += [here, *(-across * terms), *(-down * terms)]
            columns[-7:] = [sign[k] * part for part in columns[-7:]]
        matrix = np.stack(columns)
        level = _LEAST_UNLIKE * float(matrix[::7].mean(axis=1) @ sign)
        noise = np.sqrt(_CORRELATED_PIXELS * (np.mean(difference**2) + level**2))
        prior = np.diag(np.tile(usual, 6) ** -2.0)
        # What is common to all is the camera's; a common gain scales the difference, too.
        for own in np.arange(42).reshape(6, 7).T:
            prior[np.ix_(own, own)] += len(places) * prior[own, own].sum()
        total += np.linalg.solve(
            matrix @ matrix.T / noise**2 + prior,
            matrix @ difference / noise**2 - prior @ total.ravel(),
        ).reshape(6, 7)
        for k in range(6):
            phases[k] = _moved(original[k], total[k])
    before, after = (
        np.abs(gaussian_filter(np.diff(_waves(x)[0], axis=0)[0], _UNLIKE_BLUR_PX).ravel()[places])
        for x in (original, phases)
    )
    level = phases.reshape(6, -1)[:, places].mean()
    before, after, unlike = before.mean(), after.mean(), after.mean() / level
    if after > _LEAST_GAIN * before or unlike > _MOST_UNLIKE:  # nothing moved, or more than moved
        phases[:] = original
        return 0.0, float(unlike)
    motion = total[:, 1:].reshape(6, 2, 3) @ terms[:, ::50]
    return float(np.sqrt((motion**2).mean())), float(unlike)


def _unlike(phases: np.ndarray, lit: np.ndarray) -> float:
    """Largest difference of the means, as a share of them."""
    mean = _waves(phases)[0][:, lit]
    return float(np.abs(mean[1:] - mean[0]).mean(axis=1).max() / mean.mean())


def _moved(light: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Photograph without a gain and a displacement: of columns and of rows, each 1, x, y."""
    height, width = light.shape
    across, down = change[1:4], change[4:7]
    matrix = np.eye(2) + 2 / width * np.array([[down[2], down[1]], [across[2], across[1]]])
    middle = np.array([height / 2, width / 2])
    offset = middle + np.array([down[0], across[0]]) - matrix @ middle
    if np.abs(change[1:]).max() > _LEAST_MOTION_PX:
        light = affine_transform(light, matrix, offset, order=3, mode="nearest")
    return light / np.float32(1 + change[0])


def _replace_worst(phases: np.ndarray, lit: np.ndarray) -> int:
    """Replace the photograph without which the waves have the most uniform contrast."""

    def spread(k: int) -> float:
        changed = phases[:, lit]
        _derive(changed, k)
        mean, waves = _waves(changed)
        return float(np.ptp(np.quantile(np.abs(waves) / mean, (0.1, 0.9), axis=1), axis=0).sum())

    worst = min(range(len(phases)), key=spread)
    _derive(phases, worst)
    return worst
