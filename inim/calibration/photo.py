"""Comparison of a photograph of a calibrated display with its simulation.

The simulation renders the display through the lens models from the camera's position. The
differences are separated in this order: the photograph is shifted (geometry), less sharp (blur),
and has a different tone curve (tone). The rest has other causes.

    photograph = black + gain * blurred(moved(simulation)) ** gamma
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.ndimage import binary_erosion, gaussian_filter, shift
from scipy.optimize import least_squares, minimize_scalar

from inim.calibration.model import Intrinsics, Pose, rays
from inim.display import Display
from inim.documents.display import ImageShift, MatchedStage, PhotoDocument, ToneCurve
from inim.documents.parts import DisplayRecord, origin
from inim.errors import FileError
from inim.lens import trace_to_pixels
from inim.metrics import score
from inim.process.threads import threads

#: Side of the squares whose movement the flow tells.
BLOCK_PX = 64
_SAMPLES = 3  # along a side of a photograph's pixel
_BAND_ROWS = 64
# Movements are found from the coarse to the fine: sigmas of blur, photograph pixels.
_SCALES_PX = (8.0, 4.0, 2.0, 1.0, 0.5, 0.5)
# Tone is read off where neither a movement nor blur of a pixel or two matters.
_TONE_BLUR_PX = 2.0
_MOST_TONE_PIXELS = 20_000
# A Gaussian narrower than the least reaches no neighbour.
_LEAST_BLUR_PX, _MOST_BLUR_PX = 0.2, 6.0
# Pixels at the border of what is simulated that do not count: what is beyond it moves in.
_BORDER_PX = 8
_FEWEST_PIXELS = 1000
# The least share of the photograph's variance that the simulation must explain at the end.
_LEAST_EXPLAINED = 0.3
# Of a block: the least share of pixels seen, and of the usual contrast in its flattest direction.
_SEEN_SHARE, _FLAT_SHARE = 0.5, 0.05


def _response(tone: ToneCurve, light: np.ndarray) -> np.ndarray:
    """Response of a channel of the photograph to light."""
    response: np.ndarray = tone.black + tone.gain * np.maximum(light, 0) ** tone.gamma
    return response


class MatchedPicture(NamedTuple):
    """Simulation, (H, W, 3) float32 linear, after one more cause of a difference is put in."""

    name: str
    picture: np.ndarray


class Difference(NamedTuple):
    """Difference between a photograph and its simulation."""

    #: Shift of the photograph, and its standard error from the scatter of the blocks.
    right_px: float
    down_px: float
    error_px: float
    #: (rows, columns, 2) float array: shift of each block of `BLOCK_PX`, right and down; NaN
    #: without enough texture.
    flow: np.ndarray
    tones: tuple[ToneCurve, ...]  #: Red, green, blue.
    blur_px: float  #: Sigma of the Gaussian that blurs the simulation like the photograph.
    window: tuple[slice, slice]  #: The compared part of the photograph.
    counts: np.ndarray  #: (H, W) bool: compared pixels of that part.
    #: (H, W, 3) float32: that part, linear; black at other pixels, as in the stages.
    photograph: np.ndarray
    #: Simulation with the photograph's exposure only; then moved; then blurred; then with its tone
    #: curve.
    stages: tuple[MatchedPicture, ...]


def simulate(
    eia: np.ndarray, display: Display, camera: Intrinsics, pose: Pose, shape: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Simulate the photograph of a display with the thick lens model and a pinhole camera.

    * `eia`, (rows, columns, 3) float array, linear
    * `shape`, (H, W): of the photograph.

    Returns `light`, (H, W, 3) float32, linear: 1 being the panel's white without its way through
    the lenses; `seen`, (H, W) bool: pixels all of whose samples come from the panel through a lens.
    """
    light = np.zeros((*shape, 3), np.float32)
    is_display = np.zeros(shape, bool)

    def fill(first: int) -> None:
        rows = np.arange(first, min(first + _BAND_ROWS, shape[0]))
        offsets = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
        y = (rows[:, None] + offsets).ravel()
        x = (np.arange(shape[1])[:, None] + offsets).ravel()
        pixels = np.stack(np.broadcast_arrays(x, y[:, None]), axis=-1)
        row, column, share = trace_to_pixels(display, "thick", *rays(camera, pose, pixels))
        panel_light = eia[row, column] * share[..., None]
        by_pixel = (len(rows), _SAMPLES, shape[1], _SAMPLES)
        light[rows] = panel_light.reshape(*by_pixel, 3).mean(axis=(1, 3))
        is_display[rows] = (share.reshape(by_pixel) > 0).all(axis=(1, 3))

    with threads() as submit:
        for future in [submit(fill, first) for first in range(0, shape[0], _BAND_ROWS)]:
            future.result()
    return light, is_display


def compare(
    photograph: np.ndarray, light: np.ndarray, is_display: np.ndarray, name: str
) -> Difference:
    """Compare a photograph with its simulation.

    * `photograph`, `light`, (H, W, 3) float arrays, linear
    * `is_display`, (H, W) bool: pixels that see the display, from `simulate`.
    * `name`: name of the photograph in error messages.

    Raises `FileError`: the display covers too little of the photograph, has no texture to compare,
    or does not resemble the simulation.
    """
    counts = binary_erosion(is_display, iterations=_BORDER_PX)
    if np.count_nonzero(counts) < _FEWEST_PIXELS:
        raise FileError(
            f"{name}: hardly shows the display from this position; give the position of the "
            "photograph with --position"
        )
    window = _window(counts)
    counts, photo, sim = counts[window], photograph[window], light[window]
    grey = photo.mean(axis=-1, dtype=np.float64)
    model = sim.mean(axis=-1, dtype=np.float64)
    if np.std(grey[counts]) < 1e-3 or np.std(model[counts]) < 1e-3:
        raise FileError(
            f"{name}: the photograph or its simulation is uniform; photograph the EIA of --eia"
        )
    moved = np.zeros(2)
    gain = float(grey[counts].mean() / model[counts].mean())
    tone = ToneCurve(black=0.0, gain=gain, gamma=1.0)
    for sigma in _SCALES_PX:
        simulated = _response(tone, shift(model, moved, order=3, mode="nearest"))
        moved = moved + _movement(grey, simulated, counts, sigma)
        tone = _tone(grey, shift(model, moved, order=3, mode="nearest"), counts, _TONE_BLUR_PX)
    placed = np.stack(
        [shift(sim[..., c], moved, order=3, mode="nearest") for c in range(3)], axis=-1
    )
    blur = _blur(grey, placed.mean(axis=-1), counts)
    blurred = gaussian_filter(placed, (blur, blur, 0)) if blur else placed
    tones = tuple(_tone(photo[..., c], blurred[..., c], counts, 0.0) for c in range(3))
    final = np.stack([_response(tones[c], blurred[..., c]) for c in range(3)], axis=-1)
    # The last word on the movement has blur and tone right.
    last = final.mean(axis=-1)
    explained = 1 - np.mean((last - grey)[counts] ** 2) / np.var(grey[counts])
    if not explained >= _LEAST_EXPLAINED:
        raise FileError(
            f"{name}: does not resemble the simulation, which explains {max(0.0, explained):.0%} "
            "of its light and shade; check --eia and the position, and that the photograph is "
            "neither mirrored nor inverted"
        )
    flow = _flow(grey, last, counts)
    is_measured = np.isfinite(flow).all(axis=-1)
    by_blocks = flow[is_measured] - np.median(flow[is_measured], axis=0)
    spread = 1.4826 * float(np.median(np.abs(by_blocks))) if is_measured.any() else np.nan
    moved_last = moved + _movement(grey, last, counts, _SCALES_PX[-1])
    gains = photo[counts].mean(axis=0) / np.maximum(sim[counts].mean(axis=0), 1e-9)
    mask = counts[..., None].astype(np.float32)
    stages = tuple(
        MatchedPicture(stage, (np.clip(picture, 0, 1) * mask).astype(np.float32))
        for stage, picture in (
            ("exposure only", sim * gains),
            ("moved", placed * gains),
            ("blurred", blurred * gains),
            ("in its tones", final),
        )
    )
    return Difference(
        float(moved_last[1]),
        float(moved_last[0]),
        spread / max(int(np.count_nonzero(is_measured)), 1) ** 0.5,
        flow + moved[::-1],
        tones,
        blur,
        window,
        counts,
        (photo * mask).astype(np.float32),
        stages,
    )


def _window(counts: np.ndarray) -> tuple[slice, slice]:
    """Smallest rectangle around the compared pixels."""
    slices = []
    for axis in (1, 0):
        places = np.flatnonzero(counts.any(axis=axis))
        slices.append(slice(int(places[0]), int(places[-1]) + 1))
    return slices[0], slices[1]


def _gradients(
    grey: np.ndarray, simulated: np.ndarray, counts: np.ndarray, sigma: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Slopes of the simulation, down and right, and the difference to the photograph; 0 outside."""
    soft = gaussian_filter(simulated, sigma)
    less = (soft - gaussian_filter(grey, sigma)) * counts
    down, right = np.gradient(soft)
    return down * counts, right * counts, less


def _movement(
    grey: np.ndarray, simulated: np.ndarray, counts: np.ndarray, sigma: float
) -> np.ndarray:
    """Down and right, by which the photograph is moved: one step of Lucas and Kanade (1981)."""
    down, right, less = _gradients(grey, simulated, counts, sigma)
    matrix = np.array([[np.sum(a * b) for b in (down, right)] for a in (down, right)])
    vector = np.array([np.sum(a * less) for a in (down, right)])
    step: np.ndarray = np.linalg.lstsq(matrix, vector, rcond=None)[0]
    return step


def _flow(grey: np.ndarray, simulated: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """The same by blocks, right and down."""
    down, right, less = _gradients(grey, simulated, counts, _SCALES_PX[-1])

    def sums(values: np.ndarray) -> np.ndarray:
        high, wide = (size // BLOCK_PX for size in values.shape)
        whole = values[: high * BLOCK_PX, : wide * BLOCK_PX]
        total: np.ndarray = whole.reshape(high, BLOCK_PX, wide, BLOCK_PX).sum(axis=(1, 3))
        return total

    a, b, c = sums(right * right), sums(right * down), sums(down * down)
    u, v = sums(right * less), sums(down * less)
    flattest = (a + c) / 2 - np.hypot((a - c) / 2, b)
    usual = np.median((a + c)[sums(counts * 1.0) > 0]) if a.size else 1.0
    good = (flattest > _FLAT_SHARE * usual) & (sums(counts * 1.0) > _SEEN_SHARE * BLOCK_PX**2)
    with np.errstate(invalid="ignore", divide="ignore"):
        flow = np.stack([c * u - b * v, a * v - b * u], axis=-1) / (a * c - b * b)[..., None]
    shifts: np.ndarray = np.where(good[..., None], flow, np.nan)
    return shifts


def _tone(grey: np.ndarray, light: np.ndarray, counts: np.ndarray, sigma: float) -> ToneCurve:
    """Response of a channel, or of the mean of all."""
    soft = [
        gaussian_filter(image, sigma)[counts] if sigma else image[counts] for image in (light, grey)
    ]
    every = 1 + soft[0].size // _MOST_TONE_PIXELS
    x, y = (channel[::every].astype(np.float64) for channel in soft)
    x = np.maximum(x, 1e-6)
    solution = least_squares(
        lambda p: p[0] + p[1] * x ** p[2] - y,
        [max(float(y.min()), 0.0), max(float(np.ptp(y)), 1e-3) / float(x.max()), 1.0],
        bounds=([-0.1, 1e-6, 0.2], [0.9, 1e3, 5.0]),
        loss="soft_l1",
        f_scale=0.05,
    )
    black, gain, gamma = map(float, solution.x)
    return ToneCurve(black=black, gain=gain, gamma=gamma)


def _blur(grey: np.ndarray, placed: np.ndarray, counts: np.ndarray) -> float:
    """Sigma of the blur after which the tone fits best."""

    def left(sigma: float) -> float:
        soft = gaussian_filter(placed, sigma)
        simulated = _response(_tone(grey, soft, counts, 0.0), soft)
        return float(np.mean((simulated - grey)[counts] ** 2))

    solution = minimize_scalar(
        left, bounds=(0.0, _MOST_BLUR_PX), method="bounded", options={"xatol": 0.01}
    )
    return float(solution.x) if solution.x > _LEAST_BLUR_PX else 0.0


def photo_document(
    difference: Difference,
    display: Display,
    lens_px: float,
    *,
    title: str,
    command: str,
    photograph: str,
    eia: str,
    position: str,
) -> PhotoDocument:
    """A comparison as a document, without the list of its files.

    * `lens_px`: lens pitch in pixels of the photograph.
    * `title`, `command`, `photograph`, `eia`, `position`: names of the document and its inputs.
    """
    errors = [
        float(np.mean((stage.picture - difference.photograph)[difference.counts] ** 2))
        for stage in difference.stages
    ]
    rows, columns = difference.window
    return PhotoDocument(
        title=title,
        **origin(command, ("numpy", "scipy")),
        photograph=photograph,
        eia=eia,
        position=position,
        display=DisplayRecord.of(display),
        window_px=(columns.start, rows.start, columns.stop, rows.stop),
        geometry=ImageShift(
            right_px=difference.right_px,
            down_px=difference.down_px,
            standard_error_px=float(difference.error_px),
            lens_px=lens_px,
            block_px=BLOCK_PX,
            largest_block_px=float(
                np.nanmax(np.hypot(difference.flow[..., 0], difference.flow[..., 1]), initial=0.0)
            ),
        ),
        blur_sigma_px=difference.blur_px,
        tone=dict(zip(("red", "green", "blue"), difference.tones, strict=True)),
        stages=[
            MatchedStage(
                name=stage.name,
                error_share=error / errors[0],
                scores=score(difference.photograph, stage.picture),
            )
            for stage, error in zip(difference.stages, errors, strict=True)
        ],
        files=[],
    )
