"""Images in and out: linear float32 EXR and 8-bit sRGB PNG, written whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from inim.color import srgb_from_linear, srgb_to_uint8
from inim.errors import FileError
from inim.rgbd import RGBD
from inim.version import __version__

__all__ = [
    "check_exr",
    "exr_size",
    "read_exr",
    "read_exr_channels",
    "read_rgbd",
    "write_atomically",
    "write_exr",
    "write_png",
    "write_rgbd",
]

# A picture beyond this is a bomb or a mistake; 8K panels have 33 million pixels.
_MOST_PIXELS = 2**28


def write_atomically(path: Path, write: Callable[[Path], None]) -> None:
    """Let `write` fill a temporary file beside `path`, then rename it into place.

    Raises
    ------
    FileError
        When the folder cannot be written or the disk is full; `path` is then as it was.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write(temporary)
        temporary.replace(path)
    except OSError as error:
        raise FileError(
            f"{path}: cannot be written ({error.strerror or error}); "
            "free some space or choose another folder with -o"
        ) from error
    finally:
        temporary.unlink(missing_ok=True)


def write_png(path: Path, linear: np.ndarray) -> None:
    """Write (H, W, 3) linear RGB as an 8-bit sRGB PNG."""
    from PIL import Image

    pixels = srgb_to_uint8(srgb_from_linear(linear))
    # Level 1: level 6 costs four times the time for 5 % of the bytes on noisy pictures.
    write_atomically(path, lambda p: Image.fromarray(pixels).save(p, "PNG", compress_level=1))


def write_exr(path: Path, linear: np.ndarray, attributes: Mapping[str, Any] | None = None) -> None:
    """Write (H, W, 3) linear RGB as a one-part float32 EXR."""
    part = ({"R": linear[..., 0], "G": linear[..., 1], "B": linear[..., 2]}, "color")
    _write_parts(path, [part], attributes)


def write_rgbd(path: Path, rgbd: RGBD, attributes: Mapping[str, Any] | None = None) -> None:
    """Write an RGB-D picture as a two-part EXR: part 0 R, G, B and A (coverage), part 1 Z.

    Two parts, because a single RGBZ part breaks Mitsuba's textures. Z is millimetres in the
    display frame, towards the viewer; where nothing is covered, Z is NaN and A is 0.
    """
    covered = rgbd.covered.astype(np.float32)
    depth = np.where(rgbd.covered, rgbd.depth_mm, np.float32(np.nan))
    color = {"R": rgbd.color[..., 0], "G": rgbd.color[..., 1], "B": rgbd.color[..., 2]}
    header = {
        "inim:pixel_mm": repr(float(rgbd.pixel_mm)),
        "inim:unit": "mm",
        "inim:depth": "z of the front surface in the display frame, towards the viewer",
        **(attributes or {}),
    }
    _write_parts(path, [({**color, "A": covered}, "color"), ({"Z": depth}, "depth")], header)


def read_rgbd(path: Path) -> RGBD:
    """Read what `write_rgbd` wrote.

    Raises
    ------
    FileError
        Missing, damaged, or not an RGB-D picture of this kind.
    """
    parts = _read_parts(path)
    try:
        color, depth = parts[0][0], parts[1][0]["Z"]
        pixel_mm = float(parts[0][1]["inim:pixel_mm"])
        rgb = np.stack([color[c] for c in "RGB"], axis=-1)
        return RGBD(rgb, np.nan_to_num(depth), color["A"] > 0.5, pixel_mm)
    except (IndexError, KeyError, ValueError) as error:
        raise FileError(
            f"{path}: not an RGB-D picture of inim (two parts, R G B A and Z, with "
            f"inim:pixel_mm); missing {error}"
        ) from error


def read_exr(path: Path) -> np.ndarray:
    """Read the R, G, B of an EXR's first part as (H, W, 3) float32, linear.

    Raises
    ------
    FileError
        Missing, damaged, too large, or without those channels.
    """
    channels = _read_parts(path)[0][0]
    missing = [name for name in "RGB" if name not in channels]
    if missing:
        raise FileError(
            f"{path}: no channel {', '.join(missing)}; it has {', '.join(channels) or 'none'}"
        )
    return np.stack([channels[name] for name in "RGB"], axis=-1)


def read_exr_channels(path: Path) -> dict[str, np.ndarray]:
    """Read all channels of an EXR's first part, (H, W) float32 each where not subsampled.

    Raises
    ------
    FileError
        Missing, damaged or too large.
    """
    return _read_parts(path)[0][0]


def exr_size(path: Path) -> tuple[int, int]:
    """Columns and rows of an EXR's first part, from its header alone.

    Raises
    ------
    FileError
        Missing or damaged.
    """
    import OpenEXR

    try:
        return _size(OpenEXR.File(str(path), header_only=True).parts[0].header)
    except Exception as error:
        cause = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise FileError(f"{path}: not a readable EXR ({cause})") from error


def check_exr(path: Path) -> None:
    """Raise `FileError` unless the EXR decodes whole; for files that others will read."""
    _read_parts(path)


def _write_parts(
    path: Path,
    parts: list[tuple[dict[str, np.ndarray], str]],
    attributes: Mapping[str, Any] | None,
) -> None:
    import OpenEXR

    header = {"inim:version": __version__, **(attributes or {})}
    made = []
    for channels, name in parts:
        arrays = {k: np.ascontiguousarray(v, np.float32) for k, v in channels.items()}
        made.append(
            OpenEXR.Part(
                {"compression": OpenEXR.ZIPS_COMPRESSION, "type": OpenEXR.scanlineimage, **header},
                arrays,
                name,
            )
        )
    write_atomically(path, lambda p: _write_exr_file(OpenEXR.File(made), p))


def _write_exr_file(file: Any, path: Path) -> None:
    try:
        file.write(str(path))
    except RuntimeError as error:  # OpenEXR's own errors are not OSErrors
        raise OSError(0, str(error).splitlines()[0]) from error


def _read_parts(path: Path) -> list[tuple[dict[str, np.ndarray], dict[str, Any]]]:
    """Channels and header of each part, checked: OpenEXR does not raise on truncated files."""
    import OpenEXR

    if not path.is_file():
        raise FileError(f"{path}: no such file")
    try:
        header = OpenEXR.File(str(path), header_only=True)
        for part in header.parts:
            _check_size(path, part.header)
        # Separate channels: packed "RGB" arrays would scramble A and Z in odd files.
        parts = OpenEXR.File(str(path), separate_channels=True).parts
        read = [
            ({k: np.asarray(c.pixels, np.float32) for k, c in part.channels.items()}, part.header)
            for part in parts
        ]
    except FileError:
        raise
    except Exception as error:
        cause = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise FileError(f"{path}: not a readable EXR ({cause})") from error
    if not read or any(a.size == 0 for channels, _ in read for a in channels.values()):
        raise FileError(f"{path}: the EXR holds no pixels; it may be cut short")
    return read


def _check_size(path: Path, header: Mapping[str, Any]) -> None:
    columns, rows = _size(header)
    if columns < 1 or rows < 1 or columns * rows > _MOST_PIXELS:
        raise FileError(f"{path}: declares {columns} x {rows} pixels; refused as damaged")


def _size(header: Mapping[str, Any]) -> tuple[int, int]:
    low, high = header["dataWindow"]
    return int(high[0]) - int(low[0]) + 1, int(high[1]) - int(low[1]) + 1
