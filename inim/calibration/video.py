"""Videos of a display that runs through the patterns: mean light of each pattern.

Patterns are recognised by the content of the frames, not by time, so that frame rates, dropped
frames and a start within the sequence do not matter. Frames of a pattern are equal up to noise.
Frames of different patterns differ by about half of their light. Frames during a change of the
picture are mixtures, which last a short time. White is about twice as bright as a wave: it marks
the start of the sequence.
"""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from inim.errors import FileError, UsageError
from inim.image.color import linear_from_srgb

#: Endings of file names.
ENDINGS = (".mp4", ".mov", ".mkv", ".webm", ".avi", ".m4v")
_READER = "imageio_ffmpeg"
# Pixels of each frame that are compared.
_PLACES = 10_000
# Mean difference of two frames, relative to their light, above which they show two pictures: waves
# of full contrast differ by 0.8 to 1.1, white and a wave by 0.7.
_CHANGE = 0.2
# Pictures visible for less than this share of the usual time are mixtures of two.
_SHORT = 0.3
# Frames that differ more from their picture's median, relative to the usual difference, are
# mixtures, too.
_MIXED = 1.5
# Light relative to that of a wave: less is not a pattern, more is white.
_DARK, _WHITE = 0.3, 1.4
_LIGHT = linear_from_srgb(np.arange(256, dtype=np.float32) / 255)


def video_shape(path: Path) -> tuple[int, int]:
    """Rows and columns of a video, as the sensor has them.

    Raises `FileError`: not a video; `UsageError`: the reader is not installed.
    """
    frame = next(_frames(path), None)
    if frame is None:
        raise _not_a_video(path)
    rows, columns = frame.shape
    return rows, columns


def read_video(path: Path, count: int) -> list[np.ndarray | None]:
    """Mean linear light of the green channel for each of `count` patterns, (rows, columns) float32.

    White is the first pattern. None: a pattern that the video does not show.

    Raises `FileError`: not a video, or not one of the patterns in order; `UsageError`: see
    `video_shape`.
    """
    shape = video_shape(path)
    size = shape[0] * shape[1]
    places = np.sort(np.random.default_rng(0).integers(0, size, _PLACES))
    samples = [frame.ravel()[places] for frame in _frames(path)]
    chosen = pattern_frames(np.stack(samples), count)
    missing = sum(frames.size == 0 for frames in chosen)
    if missing > 1:
        raise FileError(
            f"{path}: {missing} of {count} patterns are missing in this video; film the patterns, "
            "repeated, with fixed exposure and without moving the camera, for twice their time"
        )
    numbers = {int(frame): k for k, frames in enumerate(chosen) for frame in frames}
    totals = np.zeros((count, *shape), np.float32)
    for n, frame in enumerate(_frames(path)):
        if n in numbers:
            totals[numbers[n]] += _LIGHT[frame]
    return [
        total / np.float32(frames.size) if frames.size else None
        for total, frames in zip(totals, chosen, strict=True)
    ]


def pattern_frames(samples: np.ndarray, count: int) -> list[np.ndarray]:
    """Numbers of the frames that show each pattern; empty if none does.

    * `samples`: codes of the same pixels in each frame, (frames, pixels) uint8.
    * `count`: patterns of the sequence; white is the first.
    """
    runs = _runs(samples)
    level = np.array([_LIGHT[samples[run]].mean() for run in runs])
    usual = np.median(level[level > _DARK * np.median(level)])
    letters = np.where(level < _DARK * usual, "d", np.where(level > _WHITE * usual, "W", "w"))
    sequence = "".join(letters.tolist())
    chosen: list[list[np.ndarray]] = [[] for _ in range(count)]
    parts = [begin for begin, letter in enumerate(sequence) if letter == "W"]
    for begin, end in zip(parts, [*parts, len(sequence)][1:], strict=True):
        waves = sequence[begin + 1 : end].partition("d")[0]
        if len(waves) == count - 1:
            for k in range(count):
                chosen[k].append(runs[begin + k])
    if not chosen[0] and len(parts) == 1:
        # A part before white and a part after it, of two runs through the sequence.
        before = sequence[: parts[0]].rpartition("d")[2]
        after = sequence[parts[0] + 1 :].partition("d")[0]
        if len(before) < count and len(after) < count:
            for k in range(len(after) + 1):
                chosen[k].append(runs[parts[0] + k])
            for k in range(1, len(before) + 1):
                chosen[count - k].append(runs[parts[0] - k])
    empty = np.zeros(0, int)
    return [np.concatenate([empty, *frames]) for frames in chosen]


def _runs(samples: np.ndarray) -> list[np.ndarray]:
    """Numbers of the frames that show a picture without a mixture, for each picture in order."""
    begins = [0]
    for n in range(1, len(samples)):
        # Not to the frame before: a slow panel changes little from frame to frame.
        if _difference(samples[n], samples[begins[-1]]) > _CHANGE:
            begins.append(n)
    runs = np.split(np.arange(len(samples)), begins[1:])
    # Length of the picture that most of the time is made of: mixtures may be many.
    lengths = np.sort([len(run) for run in runs])
    usual = lengths[np.searchsorted(np.cumsum(lengths), len(samples) / 2)]
    merged: list[np.ndarray] = []
    medians: list[np.ndarray] = []
    for run in runs:
        if len(run) < _SHORT * usual:
            continue
        median = np.median(samples[run], axis=0)
        if merged and _difference(median, medians[-1]) < _CHANGE:
            merged[-1] = np.append(merged[-1], run)
        else:
            merged.append(run)
            medians.append(median)
    pure = []
    for run, median in zip(merged, medians, strict=True):
        off = np.array([_difference(samples[n], median) for n in run])
        pure.append(run[off <= _MIXED * np.median(off)])
    return pure


def _difference(a: np.ndarray, b: np.ndarray) -> float:
    """Mean difference of the light of two frames, relative to their mean light."""
    light_a, light_b = (_LIGHT[np.asarray(codes, np.uint8)] for codes in (a, b))
    total = float(light_a.mean() + light_b.mean())
    return 2 * float(np.abs(light_a - light_b).mean()) / max(total, 1e-6)


def _frames(path: Path) -> Iterator[np.ndarray]:
    """Green codes of all frames, (rows, columns) uint8; a turn in the metadata is not applied."""
    if importlib.util.find_spec(_READER) is None:
        raise UsageError(f"{path}: a video needs imageio-ffmpeg; pip install imageio-ffmpeg")
    reader = importlib.import_module(_READER).read_frames(path, input_params=["-noautorotate"])
    try:
        columns, rows = next(reader)["size"]
        for data in reader:
            yield np.frombuffer(data, np.uint8).reshape(rows, columns, 3)[..., 1]
    except (OSError, RuntimeError):
        raise _not_a_video(path) from None
    finally:
        reader.close()


def _not_a_video(path: Path) -> FileError:
    return FileError(f"{path}: not a video that ffmpeg can read; save it as .mp4")
