"""Simulated videos of a display that runs through the calibration's patterns.

    inim calibrate patterns --display nominal -o out/patterns
    python -m reports.calibration.video 3 --patterns out/patterns -o out/videos

One H.264 file is written for each position of a disturbed case (`reports.calibration.cases`). The
panel is black at first. At a random time it starts with the first picture, and the last picture
stays. A frame whose exposure contains a change shows the mean of both pictures. Needs
imageio-ffmpeg.
"""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter1d

from reports.calibration.cases import Case, Motion, draw_disturbed
from reports.calibration.landing import Sheet
from reports.calibration.photographs import Movement, draw_movements, read_pictures, take_position

_FRAMES_PER_SECOND = 30
# Exposure of a frame in seconds: a shutter of half the frame's time.
_EXPOSURE_S = 0.5 / _FRAMES_PER_SECOND
# Seconds before the first picture, and after the last one's time.
_BEFORE_S, _AFTER_S = (0.5, 1.5), 0.5
# Frames over which the hand's shake is smooth.
_SHAKE_FRAMES = 4.0
# Of imageio-ffmpeg, 10 is the best.
_QUALITY = 7


def shares(time_s: float, start_s: float, picture_s: float, pictures: int) -> dict[int, float]:
    """Shares of a frame's exposure by picture, which -1 is before the first.

    Parameters
    ----------
    time_s : float
        Start of the exposure.
    start_s, picture_s : float
        Start of the first picture and the time that each is visible.
    pictures : int
    """
    changes = start_s + picture_s * np.arange(pictures)
    edges = np.clip([time_s, *changes, time_s + _EXPOSURE_S], time_s, time_s + _EXPOSURE_S)
    lengths = np.diff(edges) / _EXPOSURE_S
    return {k - 1: float(length) for k, length in enumerate(lengths) if length > 0}


def video_movements(
    motion: Motion, focal_length_px: float, count: int, random: np.random.Generator
) -> list[Movement]:
    """Draw smooth movements of consecutive frames with the rms shake of `motion`."""
    still = draw_movements(
        Motion(drift_px=motion.drift_px, skew=motion.skew), focal_length_px, count, random
    )
    angles = gaussian_filter1d(random.standard_normal((count, 3)), _SHAKE_FRAMES, axis=0)
    # The filter reduces the variance to 1 / (2 sigma sqrt(pi)).
    angles *= motion.shake_px / focal_length_px * np.sqrt(2 * _SHAKE_FRAMES * np.sqrt(np.pi))
    return [
        movement._replace(turn=_small_rotation(vector) @ movement.turn)
        for movement, vector in zip(still, angles, strict=True)
    ]


def _small_rotation(vector: np.ndarray) -> np.ndarray:
    """Rotation by a small vector: its square, below 1e-6, is left out."""
    x, y, z = vector
    return np.array([[1, -z, y], [z, 1, -x], [-y, x, 1]])


def film_position(
    case: Case, sheet: Sheet, number: int, pictures: Sequence[np.ndarray], picture_s: float
) -> Iterator[np.ndarray]:
    """Frames of a position, (rows, columns, 3) uint8 sRGB."""
    shot = take_position(case, sheet, number)
    random = np.random.default_rng([case.number, number])
    start_s = random.uniform(*_BEFORE_S)
    count = int((start_s + picture_s * len(pictures) + _AFTER_S) * _FRAMES_PER_SECOND)
    focal_length_px = case.cameras[number - 1].focal_length_px
    movements = video_movements(case.motions[number - 1], focal_length_px, count, random)
    black = np.zeros_like(pictures[0])
    for frame, movement in enumerate(movements):
        visible = shares(frame / _FRAMES_PER_SECOND, start_s, picture_s, len(pictures))
        light = sum(
            np.float32(share) * shot.light(pictures[k] if k >= 0 else black, movement)
            for k, share in visible.items()
        )
        yield shot.develop(np.asarray(light), int(random.integers(1 << 32)))


def film_case(case: Case, patterns: Path, out: Path, picture_s: float) -> None:
    """Write ``position-1.mp4`` and so on."""
    pictures, sheet = read_pictures(patterns), Sheet(case.display, case.assembly)
    encoder = importlib.import_module("imageio_ffmpeg")
    out.mkdir(parents=True, exist_ok=True)
    for number in range(1, len(case.poses) + 1):
        writer = encoder.write_frames(
            str(out / f"position-{number}.mp4"),
            (case.camera.columns, case.camera.rows),
            fps=_FRAMES_PER_SECOND,
            quality=_QUALITY,
            macro_block_size=2,
        )
        writer.send(None)  # starts the encoder
        for frame in film_position(case, sheet, number, pictures, picture_s):
            writer.send(frame)
        writer.close()


def main() -> None:
    """Film a disturbed case."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("case", type=int, help="number of the disturbed case")
    parser.add_argument("--patterns", type=Path, required=True, help="folder of the patterns")
    parser.add_argument("--seconds", type=float, default=0.5, help="per picture (%(default)s)")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder for the videos")
    args = parser.parse_args()
    film_case(draw_disturbed(args.case), args.patterns, args.out, args.seconds)


if __name__ == "__main__":
    main()
