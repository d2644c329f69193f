"""Short films from pictures: animated GIF and WebP, and MP4 where its encoder is installed."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from inim.errors import FileError, UsageError

__all__ = ["FILM_KINDS", "check_film", "write_film"]

FILM_KINDS = (".gif", ".webp", ".mp4")
_ENCODER = "imageio_ffmpeg"
_WEBP_QUALITY = 90


def check_film(path: Path) -> None:
    """Raise unless a film of this name can be written here, found out before frames are made.

    Raises
    ------
    UsageError
        Another kind of file, or MP4 without its encoder.
    """
    kind = path.suffix.lower()
    if kind not in FILM_KINDS:
        raise UsageError(f"{path}: a film is a {', '.join(FILM_KINDS[:-1])} or {FILM_KINDS[-1]}")
    if kind == ".mp4" and importlib.util.find_spec(_ENCODER) is None:
        raise UsageError(
            f"{path}: writing .mp4 needs imageio-ffmpeg; pip install imageio-ffmpeg, or choose "
            ".webp or .gif"
        )


def write_film(path: Path, frames: Sequence[np.ndarray], frames_per_second: float) -> None:
    """Write frames as a film that runs in a loop (GIF, WebP) or once (MP4).

    Parameters
    ----------
    path : Path
        Its ending says the kind, one of `FILM_KINDS`.
    frames : sequence of (rows, columns, 3) uint8
        sRGB, all of one size; for MP4 of even rows and columns.
    frames_per_second : float

    Raises
    ------
    UsageError
        See `check_film`.
    FileError
        It cannot be written.
    """
    check_film(path)
    try:
        if path.suffix.lower() == ".mp4":
            _write_mp4(path, frames, frames_per_second)
        else:
            _write_animation(path, frames, frames_per_second)
    except OSError as error:
        raise FileError(f"{path}: cannot be written ({error.strerror or error})") from error


def _write_animation(path: Path, frames: Sequence[np.ndarray], frames_per_second: float) -> None:
    from PIL import Image

    gif = path.suffix.lower() == ".gif"
    options = {} if gif else {"quality": _WEBP_QUALITY, "method": 4}
    # GIF counts in hundredths of a second, and players take 1/100 for a slip.
    least, unit = (20, 10) if gif else (1, 1)
    duration_ms = max(least, unit * round(1000 / frames_per_second / unit))
    first, *rest = map(Image.fromarray, frames)
    first.save(path, save_all=True, append_images=rest, duration=duration_ms, loop=0, **options)


def _write_mp4(path: Path, frames: Sequence[np.ndarray], frames_per_second: float) -> None:
    encoder = importlib.import_module(_ENCODER)
    rows, columns = frames[0].shape[:2]
    writer = encoder.write_frames(
        str(path), (columns, rows), fps=frames_per_second, quality=8, macro_block_size=2
    )
    writer.send(None)  # starts the encoder
    for frame in frames:
        writer.send(np.ascontiguousarray(frame))
    writer.close()
