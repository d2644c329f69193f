"""Images in and out: linear float32 EXR and 8-bit sRGB PNG, written whole or not at all."""

from __future__ import annotations

import contextlib
import io
import os
import threading
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from inim.cache import ResultCache
from inim.errors import FileError, UsageError
from inim.files.regular_file import check_file
from inim.image.color import srgb_codes
from inim.image.rgbd import RGBD, Layer, LayeredRGBD
from inim.process.atomic_file import atomic_file
from inim.version import __version__

# A picture beyond this is a bomb or a mistake; 8K panels have 33 million pixels.
_MOST_PIXELS = 2**28
# Compressed files unfold: to this much whatever their size, beyond it to this many times it.
# Noisy pictures unfold to twice their size, painted ones to tens of times, bombs to a thousand.
_MOST_UNFOLDED_BYTES = 2**28
_MOST_UNFOLDING = 100
# Without a store: it keeps nothing.
_NO_CACHE = ResultCache()


def write_atomically(path: Path, write: Callable[[Path], object]) -> None:
    """Let `write` fill a temporary file beside `path`, then rename it into place.

    Raises
    ------
    FileError
        When the folder cannot be written or the disk is full; `path` is then as it was.
    """
    try:
        with atomic_file(path) as temporary:
            write(temporary)
    except OSError as error:
        raise FileError(
            f"{path}: cannot be written ({error.strerror or error}); "
            "free some space or choose another folder with -o"
        ) from error


def write_png(path: Path, linear: np.ndarray, cache: ResultCache = _NO_CACHE) -> None:
    """Write (H, W, 3) linear RGB as an 8-bit sRGB PNG."""
    pixels = srgb_codes(linear)
    # Level 1: level 6 costs four times the time for 5 % of the bytes on noisy pictures.
    data = encoded(pixels, "PNG", cache, compress_level=1)
    write_atomically(path, lambda p: p.write_bytes(data))


def encoded(pixels: np.ndarray, form: str, cache: ResultCache = _NO_CACHE, **options: Any) -> bytes:
    """A picture's file in memory, by Pillow.

    Parameters
    ----------
    pixels : (H, W, 3) uint8
    form : {"PNG", "JPEG"}
    cache : ResultCache
        Reading a picture from it is faster than compressing it.
    **options
        Of Pillow's writer.
    """

    def make() -> np.ndarray:
        from PIL import Image

        stream = io.BytesIO()
        Image.fromarray(np.ascontiguousarray(pixels)).save(stream, form, **options)
        return np.frombuffer(stream.getvalue(), np.uint8)

    def parts() -> dict[str, Any]:
        return {"pixels": pixels, "form": [form, options], "pillow": _pillow_version()}

    data: np.ndarray = cache.find_or_make("picture file", parts, make, explain=False)[0]
    return data.tobytes()


@cache
def _pillow_version() -> str:
    return metadata.version("pillow")


def write_exr(path: Path, linear: np.ndarray, attributes: Mapping[str, Any] | None = None) -> None:
    """Write (H, W, 3) linear RGB as a one-part float32 EXR."""
    # Packed, the file is the same, and channels need not be copied apart.
    write_exr_parts(path, [({"RGB": linear}, "color")], attributes)


def write_rgbd(path: Path, rgbd: RGBD, attributes: Mapping[str, Any] | None = None) -> None:
    """Write an RGB-D picture as a two-part EXR: part 0 R, G, B and A (coverage), part 1 Z.

    Two parts, because a single RGBZ part breaks Mitsuba's textures. Z is millimetres in the
    display frame, towards the viewer; where nothing is covered, Z is NaN and A is 0.

    A picture of n layers has 3 n parts: `color` and `depth` as above, `back` with the Z at which
    the solid behind the front ends; then `color.1`, `depth.1`, `back.1` of the next layer, and so
    on.
    """
    layers = rgbd.layers
    header = {
        "inim:pixel_mm": repr(float(rgbd.pixel_mm)),
        "inim:unit": "mm",
        "inim:depth": "z of the front surface in the display frame, towards the viewer",
        **(attributes or {}),
    }
    parts = [part for n, layer in enumerate(layers) for part in _layer_parts(layer, n)]
    if isinstance(rgbd, LayeredRGBD):
        header |= {
            "inim:layers": str(len(layers)),
            "inim:back": "z at which the solid behind the front surface ends",
        }
        write_exr_parts(path, parts, header)
    else:
        write_exr_parts(path, parts[:2], header)


def _layer_parts(layer: Layer, number: int) -> list[tuple[dict[str, np.ndarray], str]]:
    """Colour, depth and back of a layer, and the names of their parts."""
    nothing = np.float32(np.nan)
    colors = {name: layer.color[..., channel] for channel, name in enumerate("RGB")}
    channels = {
        "color": colors | {"A": layer.covered.astype(np.float32)},
        "depth": {"Z": np.where(layer.covered, layer.front_mm, nothing)},
        "back": {"Z": np.where(layer.covered, layer.back_mm, nothing)},
    }
    return [(made, f"{name}.{number}" if number else name) for name, made in channels.items()]


def read_rgbd(path: Path | str) -> RGBD:
    """Read what `write_rgbd` wrote: a `LayeredRGBD` where the file holds layers.

    Parameters
    ----------
    path : path
        `rgbd.exr` of a report, or what `inim generate --rgbd` wrote.

    Raises
    ------
    FileError
        Missing, damaged, or not an RGB-D picture of this kind.
    """
    path = Path(path)
    parts = _read_parts(path)
    try:
        header = parts[0][1]
        pixel_mm = float(header["inim:pixel_mm"])
        channels = [channels for channels, _ in parts]
        count = int(header.get("inim:layers", 0))
        if not count:
            front = _read_layer([*channels[:2], channels[1]])
            return RGBD(front.color, front.front_mm, front.covered, pixel_mm)
        front, *deeper = (_read_layer(channels[3 * n : 3 * n + 3]) for n in range(count))
        return LayeredRGBD(
            front.color, front.front_mm, front.covered, pixel_mm, front.back_mm, tuple(deeper)
        )
    except (IndexError, KeyError, TypeError, ValueError) as error:
        raise FileError(
            f"{path}: not an RGB-D picture of inim (two parts, R G B A and Z, with "
            f"inim:pixel_mm); missing {error}"
        ) from error
    except UsageError as error:
        raise FileError(f"{path}: {error}") from error


def _read_layer(parts: list[dict[str, np.ndarray]]) -> Layer:
    """A layer from the channels of its colour, depth and back."""
    color, depth, back = parts[0], parts[1]["Z"], parts[2]["Z"]
    rgb = np.stack([color[c] for c in "RGB"], axis=-1)
    # A back of -inf is one: only what is not there becomes 0.
    back = np.where(np.isnan(back), np.float32(0), back)
    return Layer(rgb, np.nan_to_num(depth), back, color["A"] > 0.5)


def read_exr(path: Path) -> np.ndarray:
    """Read the colours of an EXR's first part: (H, W, 3) float32 of R, G, B, or (H, W, 1) of Y.

    Raises
    ------
    FileError
        Missing, damaged, too large, or without those channels.
    """
    channels = read_exr_channels(path)
    names = "Y" if "Y" in channels and "R" not in channels else "RGB"
    missing = [name for name in names if name not in channels]
    if missing or len({channels[name].shape for name in names}) > 1:
        raise FileError(
            f"{path}: no whole channels {', '.join(names)}; it has {', '.join(channels)}"
        )
    return np.stack([channels[name] for name in names], axis=-1)


def read_exr_channels(path: Path) -> dict[str, np.ndarray]:
    """Read all channels of an EXR's first part, (H, W) float32 each where not subsampled.

    Raises
    ------
    FileError
        Missing, damaged or too large.
    """
    return _read_parts(path)[0][0]


def check_unfolding(path: Path, bytes_unfolded: int, size: int | None = None) -> None:
    """Raise `FileError` where a file, or `size` bytes of it, declare more than they can mean."""
    size = path.stat().st_size if size is None else size
    if bytes_unfolded > max(_MOST_UNFOLDED_BYTES, _MOST_UNFOLDING * size):
        raise FileError(
            f"{path}: unfolds from {size} to {bytes_unfolded} bytes; refused as damaged, save it "
            "without compression if it is not"
        )


def write_exr_parts(
    path: Path,
    parts: list[tuple[dict[str, np.ndarray], str]],
    attributes: Mapping[str, Any] | None,
) -> None:
    """Write channels, (H, W) or packed (H, W, 3), as the named parts of a float32 EXR."""
    import OpenEXR

    header = {
        "compression": OpenEXR.ZIPS_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "inim:version": __version__,
        **(attributes or {}),
    }
    arrays = [
        ({k: np.ascontiguousarray(v, np.float32) for k, v in channels.items()}, name)
        for channels, name in parts
    ]
    file = OpenEXR.File([OpenEXR.Part(dict(header), channels, name) for channels, name in arrays])
    write_atomically(path, lambda p: _write_exr_file(file, p))


def _write_exr_file(file: Any, path: Path) -> None:
    try:
        file.write(str(path))
    except RuntimeError as error:  # OpenEXR's own errors are not OSErrors
        raise OSError(0, str(error).splitlines()[0]) from error


def _read_parts(path: Path) -> list[tuple[dict[str, np.ndarray], dict[str, Any]]]:
    """Channels, float32, and header of each part, checked: OpenEXR accepts truncated files."""
    check_file(path)
    try:
        with hushed():
            import OpenEXR

            header = OpenEXR.File(str(path), header_only=True)
            check_unfolding(path, sum(_check_size(path, part.header) for part in header.parts))
            # Separate channels: packed "RGB" arrays would scramble A and Z in odd files.
            parts = OpenEXR.File(str(path), separate_channels=True).parts
            read = [
                ({name: np.asarray(c.pixels) for name, c in part.channels.items()}, part.header)
                for part in parts
            ]
    except FileError:
        raise
    except Exception as error:
        cause = str(error).partition("\n")[0] or type(error).__name__
        raise FileError(f"{path}: not a readable EXR ({cause}); save it again") from error
    arrays = [pixels for channels, _ in read for pixels in channels.values()]
    lacking = any(not channels for channels, _ in read)
    if lacking or not arrays or any(a.size == 0 or a.dtype.kind not in "fu" for a in arrays):
        raise FileError(f"{path}: the EXR holds no pixels; it may be cut short")
    return [
        ({name: pixels.astype(np.float32, copy=False) for name, pixels in channels.items()}, header)
        for channels, header in read
    ]


# Descriptor 2 and `sys.stdout` belong to the whole process, so that all threads that ask share one
# silence: the first begins it, the last ends it. What others say meanwhile is lost, too.
_silence = threading.Lock()
_asking = 0
_undo = contextlib.ExitStack()


@contextlib.contextmanager
def hushed() -> Iterator[None]:
    """Keep a decoder's own words, hundreds of lines on a damaged file, off stdout and stderr.

    Python's `print` carries some of OpenEXR's, descriptor 2 its others and all of libtiff's.
    """
    global _asking
    with _silence:
        if not _asking:
            _begin_silence()
        _asking += 1
    try:
        yield
    finally:
        with _silence:
            _asking -= 1
            if not _asking:
                _undo.close()


def _begin_silence() -> None:
    kept = os.dup(2)
    _undo.callback(os.close, kept)
    _undo.callback(os.dup2, kept, 2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    os.close(nowhere)
    _undo.enter_context(contextlib.redirect_stdout(io.StringIO()))


def _check_size(path: Path, header: Mapping[str, Any]) -> int:
    """Bytes that a part's pixels take; a FileError where its size is absurd."""
    low, high = header["dataWindow"]
    columns, rows = int(high[0]) - int(low[0]) + 1, int(high[1]) - int(low[1]) + 1
    if columns < 1 or rows < 1 or columns * rows > _MOST_PIXELS:
        raise FileError(f"{path}: declares {columns} x {rows} pixels; refused as damaged")
    return columns * rows * 4 * len(header["channels"])
