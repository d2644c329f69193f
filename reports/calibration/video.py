"""Simulated videos of a display that runs through the calibration's patterns.

    inim calibrate patterns --display nominal -o out/patterns
    python -m reports.calibration.video 3 --patterns out/patterns -o out/videos

One H.264 file is written for each position of a disturbed case (`reports.calibration.cases`). The
panel repeats the pictures, and the video starts at a random time. A frame whose exposure contains a
change shows the mean of both pictures. Needs imageio-ffmpeg.
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
from reports.calibration.photographs import (
    STILL,
    Movement,
    draw_movements,
    read_pictures,
    take_position,
)

# Exposure of a frame: a shutter of half the frame's time.
_SHUTTER = 0.5
_ROUNDS = 2
# Frames over which the hand's shake is smooth.
_SHAKE_FRAMES = 4.0
# Of imageio-ffmpeg, 10 is the best.
_QUALITY = 7


def shares(time_s: float, exposure_s: float, picture_s: float, pictures: int) -> dict[int, float]:
    """Shares of a frame's exposure by picture.

    Parameters
    ----------
    time_s, exposure_s : float
        Start of the exposure after that of the first picture, and its length: shorter than a
        picture's time.
    picture_s : float
        Time that each picture is visible, before the next one of a loop.
    pictures : int
    """
    number, into_s = divmod(time_s, picture_s)
    first = min((picture_s - into_s) / exposure_s, 1.0)
    lengths = {int(number) % pictures: first, int(number + 1) % pictures: 1 - first}
    return {k: share for k, share in lengths.items() if share > 0}


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
    case: Case,
    sheet: Sheet,
    number: int,
    pictures: Sequence[np.ndarray],
    picture_s: float,
    rate_hz: float,
) -> Iterator[np.ndarray]:
    """Frames of a position, (rows, columns, 3) uint8 sRGB: two rounds of the pictures."""
    shot = take_position(case, sheet, number)
    random = np.random.default_rng([case.number, number])
    round_s = picture_s * len(pictures)
    start_s = random.uniform(0, round_s)
    count = int(_ROUNDS * round_s * rate_hz)
    focal_length_px = case.cameras[number - 1].focal_length_px
    motion = case.motions[number - 1]
    movements = video_movements(motion, focal_length_px, count, random)
    still = [shot.light(codes, STILL) for codes in pictures] if motion == Motion() else []
    for frame, movement in enumerate(movements):
        time_s = start_s + frame / rate_hz
        visible = shares(time_s, _SHUTTER / rate_hz, picture_s, len(pictures))
        light = sum(
            np.float32(share) * (still[k] if still else shot.light(pictures[k], movement))
            for k, share in visible.items()
        )
        yield shot.develop(np.asarray(light), int(random.integers(1 << 32)))


def film_case(case: Case, patterns: Path, out: Path, picture_s: float, rate_hz: float) -> None:
    """Write ``position-1.mp4`` and so on."""
    pictures, sheet = read_pictures(patterns), Sheet(case.display, case.assembly)
    encoder = importlib.import_module("imageio_ffmpeg")
    out.mkdir(parents=True, exist_ok=True)
    for number in range(1, len(case.poses) + 1):
        writer = encoder.write_frames(
            str(out / f"position-{number}.mp4"),
            (case.camera.columns, case.camera.rows),
            fps=rate_hz,
            quality=_QUALITY,
            macro_block_size=2,
        )
        writer.send(None)  # starts the encoder
        for frame in film_position(case, sheet, number, pictures, picture_s, rate_hz):
            writer.send(frame)
        writer.close()


def main() -> None:
    """Film a disturbed case."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("case", type=int, help="number of the disturbed case")
    parser.add_argument("--patterns", type=Path, required=True, help="folder of the patterns")
    parser.add_argument("--seconds", type=float, default=1.0, help="per picture (%(default)s)")
    parser.add_argument("--rate", type=float, default=30.0, help="frames a second (%(default)s)")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder for the videos")
    args = parser.parse_args()
    film_case(draw_disturbed(args.case), args.patterns, args.out, args.seconds, args.rate)


if __name__ == "__main__":
    main()
