"""Reading and atomic writing of images: linear float32 EXR and 8-bit sRGB PNG."""

import contextlib
import io
import os
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from inim.image.color import to_srgb
from inim.image.rgbd import RGBD, Layer, LayeredRGBD
from inim.system.cache import ResultCache
from inim.system.errors import FileError, UsageError
from inim.system.files import check_file, utf8_name
from inim.system.process.atomic_file import write_atomically
from inim.system.version import __version__

# Limit against decompression bombs; 8K panels have 33 million pixels.
_MOST_PIXELS = 2**28
# Limits on decoded data: this many bytes for any file, or this multiple of the file size. Noisy
# pictures expand by a factor of 2, painted ones by tens, decompression bombs by a thousand.
_MOST_UNFOLDED_BYTES = 2**28
_MOST_UNFOLDING = 100
# A cache without a folder stores no results.
_NO_CACHE = ResultCache()


def write_png(path: Path, linear: np.ndarray, cache: ResultCache = _NO_CACHE) -> None:
    """Write (H, W, 3) linear RGB as an 8-bit sRGB PNG."""
    pixels = to_srgb(linear)
    # Level 1: level 6 costs four times the time for 5 % of the bytes on noisy pictures.
    data = encode_image(pixels, "PNG", cache, compress_level=1)
    write_atomically(path, lambda p: p.write_bytes(data))


def save_image(path: Path | str, linear: np.ndarray) -> None:
    """Write a linear image, such as an EIA or a view, as a PNG or an EXR.

    Parameters
    ----------
    path : path
        `.png` for 8-bit sRGB, `.exr` for linear float32.
    linear : (rows, columns, 3) float array
        Linear RGB, 1 being the panel's white.

    Raises
    ------
    UsageError
        Another suffix, or an array that is no such image.
    FileError
        The file cannot be written.
    """
    path, image = Path(path), np.asarray(linear)
    writers: dict[str, Callable[[Path, np.ndarray], object]] = {
        ".png": write_png,
        ".exr": write_exr,
    }
    if path.suffix.lower() not in writers:
        raise UsageError(f"{path}: not an image that inim writes; name it .png or .exr")
    if image.ndim != 3 or image.shape[2] != 3 or not image.size or image.dtype.kind != "f":
        raise UsageError(
            f"{path}: the image is {image.dtype} of shape {image.shape}; give (rows, columns, 3) "
            "floats, linear RGB"
        )
    writers[path.suffix.lower()](path, image.astype(np.float32, copy=False))


def encode_image(
    pixels: np.ndarray, form: str, cache: ResultCache = _NO_CACHE, **options: Any
) -> bytes:
    """Encode an image as the bytes of a file.

    * `pixels`, (H, W, 3) uint8
    * `form`, {"PNG", "JPEG", "WEBP"}
    * `cache`: stores encoded images, as reading is faster than compressing.
    * `**options`: options of Pillow's writer.
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
    # Packed channels give the same file without copies.
    write_exr_parts(path, [({"RGB": linear}, "color")], attributes)


def write_rgbd(path: Path, rgbd: RGBD, attributes: Mapping[str, Any] | None = None) -> None:
    """Write an RGB-D picture as a two-part EXR: part 0 R, G, B and A (coverage), part 1 Z.

    Two parts are needed because a single RGBZ part breaks Mitsuba's textures. Z is in millimetres
    in the display frame, towards the viewer; in empty pixels, Z is NaN and A is 0.

    A picture of n layers has 3 n parts: `color` and `depth` as above, `back` with the Z of the
    solid's back; then `color.1`, `depth.1`, `back.1` of the next layer, and so on.
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
    empty = np.float32(np.nan)
    colors = {name: layer.color[..., channel] for channel, name in enumerate("RGB")}
    parts = {
        "color": colors | {"A": layer.covered.astype(np.float32)},
        "depth": {"Z": np.where(layer.covered, layer.front_mm, empty)},
        "back": {"Z": np.where(layer.covered, layer.back_mm, empty)},
    }
    return [(part, f"{name}.{number}" if number else name) for name, part in parts.items()]


def read_rgbd(path: Path | str) -> RGBD:
    """Read a file of `write_rgbd`: a `LayeredRGBD` if it contains layers.

    Parameters
    ----------
    path : path
        `rgbd.exr` of a report, or a file from `inim generate --save-rgbd`.

    Raises
    ------
    FileError
        Missing, damaged, or not an RGB-D picture of `inim`.
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
    """Layer from the channels of its colour, depth and back."""
    color, depth, back = parts[0], parts[1]["Z"], parts[2]["Z"]
    rgb = np.stack([color[c] for c in "RGB"], axis=-1)
    if not np.isfinite(rgb).all():
        raise UsageError("has colours that are not finite; replace them")
    # Replace only missing values: -inf is a valid back.
    back = np.where(np.isnan(back), np.float32(0), back)
    return Layer(rgb, np.nan_to_num(depth), back, color["A"] > 0.5)


def read_exr(path: Path) -> np.ndarray:
    """Read the colours of an EXR: (H, W, 3) float32 of R, G, B, or (H, W, 1) of Y.

    Of several parts or layers, those of the first one with colours, preferably the first part.

    Raises `FileError`: missing, damaged, too large, or without those channels.
    """
    return read_exr_color(path)[0]


def read_exr_color(path: Path) -> tuple[np.ndarray, np.ndarray | None]:
    """Colours as `read_exr` has them, and their alpha, (H, W) float32, or None."""
    parts = _read_parts(path)
    channels = _all_channels(parts)
    to_xyz = _xyz_of_header(parts[0][1])
    layers = sorted(dict.fromkeys(name.rpartition(".")[0] for name in channels), key=_is_other)
    for names in ("RGB", "Y"):
        for layer in layers:
            start = f"{layer}." if layer else ""
            own = [channels.get(start + name) for name in names]
            arrays = [array for array in own if array is not None]
            if len(arrays) == len(names) and len({array.shape for array in arrays}) == 1:
                alpha = channels.get(f"{start}A")
                chroma = [channels.get(start + name) for name in ("RY", "BY")]
                if names == "Y" and chroma[0] is not None and chroma[1] is not None:
                    arrays = _color_of_chroma(arrays[0], chroma[0], chroma[1], to_xyz[1])
                is_whole = alpha is not None and alpha.shape == arrays[0].shape
                color = np.stack(arrays, axis=-1)
                if len(arrays) == 3 and not np.allclose(to_xyz, _XYZ_OF_709, atol=1e-3):
                    to_709 = np.linalg.solve(_XYZ_OF_709, to_xyz).astype(np.float32)
                    color = color @ to_709.T
                return color, alpha if is_whole else None
    raise FileError(f"{path}: no whole channels R, G, B; it has {', '.join(channels)}")


# Primaries and white of Rec. 709, x and y each.
_REC_709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)


def _xyz_of(chromaticities: Sequence[float] | np.ndarray) -> np.ndarray:
    """Matrix (3, 3) from light of some primaries to CIE XYZ; SMPTE RP 177."""
    x, y = np.array(chromaticities, np.float64).reshape(4, 2).T
    columns = np.stack([x, y, 1 - x - y])
    white = columns[:, 3] / y[3]
    matrix: np.ndarray = columns[:, :3] * np.linalg.solve(columns[:, :3], white)
    return matrix


_XYZ_OF_709 = _xyz_of(_REC_709)


def _xyz_of_header(header: Mapping[str, Any]) -> np.ndarray:
    """Matrix to CIE XYZ of the primaries that a header states; by default those of Rec. 709."""
    stated = header.get("chromaticities")
    numbers = np.ravel(stated) if stated is not None else np.empty(0)
    if numbers.shape != (8,) or not np.isfinite(numbers).all() or not numbers[7]:
        return _XYZ_OF_709
    try:
        return _xyz_of(numbers)
    except np.linalg.LinAlgError:
        return _XYZ_OF_709


def _color_of_chroma(
    y: np.ndarray, ry: np.ndarray, by: np.ndarray, luminance: np.ndarray
) -> list[np.ndarray]:
    """Red, green and blue of luminance Y and chroma, ``RY = R / Y - 1``, stored in fewer pixels.

    * `luminance`, (3,): shares of red, green and blue in Y.

    "Technical Introduction to OpenEXR", section "Luminance/Chroma Images".
    """
    rows, columns = y.shape
    ratios = []
    for chroma in (ry, by):
        down, right = -(-rows // chroma.shape[0]), -(-columns // chroma.shape[1])
        ratios.append(chroma.repeat(down, axis=0).repeat(right, axis=1)[:rows, :columns] + 1)
    red, blue = ratios[0] * y, ratios[1] * y
    shares = luminance.astype(np.float32)
    if not shares[1]:
        return [red, y, blue]
    return [red, (y - shares[0] * red - shares[2] * blue) / shares[1], blue]


# Last parts of the names of layers with the final colours of a renderer.
_FINAL = {"", "combined", "composite", "rgba", "rgb", "beauty", "color", "colour"}


def _is_other(layer: str) -> bool:
    """True for a layer that need not have the final colours, such as an occlusion."""
    return layer.rpartition(".")[2].lower() not in _FINAL


def read_exr_channels(path: Path) -> dict[str, np.ndarray]:
    """Read all channels of an EXR, (H, W) float32 each where not subsampled.

    Names of channels of a second or further part begin with the name of their part.

    Raises `FileError`: missing, damaged or too large.
    """
    return _all_channels(_read_parts(path))


def _all_channels(
    parts: Sequence[tuple[dict[str, np.ndarray], dict[str, Any]]],
) -> dict[str, np.ndarray]:
    channels: dict[str, np.ndarray] = {}
    for number, (own, header) in enumerate(parts):
        part = str(header.get("name") or f"part{number}")
        for name, pixels in own.items():
            is_full = number == 0 or name.startswith(f"{part}.")
            channels[name if is_full else f"{part}.{name}"] = pixels
    return channels


def check_unfolding(path: Path, bytes_unfolded: int, size: int | None = None) -> None:
    """Raise `FileError` if a file, or `size` bytes of it, decode to suspiciously many bytes."""
    size = path.stat().st_size if size is None else size
    if bytes_unfolded > max(_MOST_UNFOLDED_BYTES, _MOST_UNFOLDING * size):
        raise FileError(
            f"{path}: unfolds from {size} to {bytes_unfolded} bytes; refused as damaged, save it "
            "without compression if it is intact"
        )


def write_exr_parts(
    path: Path, parts: list[tuple[dict[str, np.ndarray], str]], attributes: Mapping[str, Any] | None
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
        file.write(utf8_name(path))
    except RuntimeError as error:  # OpenEXR's own errors are not OSErrors
        raise OSError(0, str(error).splitlines()[0]) from error


def _read_parts(path: Path) -> list[tuple[dict[str, np.ndarray], dict[str, Any]]]:
    """Read float32 channels and header of each part; also detect truncated files."""
    check_file(path)
    try:
        with silence_output():
            import OpenEXR

            name = utf8_name(path)
            header = OpenEXR.File(name, header_only=True)
            deep = (OpenEXR.deepscanline, OpenEXR.deeptile)
            if any(part.header.get("type") in deep for part in header.parts):
                raise FileError(f"{path}: has several depths per pixel (deep); flatten it")
            check_unfolding(path, sum(_check_size(path, part.header) for part in header.parts))
            # Separate channels: packed "RGB" arrays would scramble A and Z in odd files.
            parts = OpenEXR.File(name, separate_channels=True).parts
            contents = [
                ({name: np.asarray(c.pixels) for name, c in part.channels.items()}, part.header)
                for part in parts
            ]
    except FileError:
        raise
    except Exception as error:
        cause = str(error).partition("\n")[0] or type(error).__name__
        raise FileError(f"{path}: not a readable EXR ({cause}); save it again") from error
    arrays = [pixels for channels, _ in contents for pixels in channels.values()]
    has_empty_part = any(not channels for channels, _ in contents)
    if has_empty_part or not arrays or any(a.size == 0 or a.dtype.kind not in "fu" for a in arrays):
        raise FileError(f"{path}: the EXR has no pixels, as it may be truncated; save it again")
    return [
        ({name: pixels.astype(np.float32, copy=False) for name, pixels in channels.items()}, header)
        for channels, header in contents
    ]


# Descriptor 2 and `sys.stdout` belong to the whole process, so the first thread that asks silences
# them and the last one restores them. Other threads' output in between is lost.
_silence = threading.Lock()
_thread_count = 0
_undo = contextlib.ExitStack()


@contextlib.contextmanager
def silence_output() -> Iterator[None]:
    """Suppress the output of decoders, which is hundreds of lines for damaged files.

    OpenEXR writes to Python's stdout and to descriptor 2, libtiff to descriptor 2.
    """
    global _thread_count
    with _silence:
        if not _thread_count:
            _redirect_output()
        _thread_count += 1
    try:
        yield
    finally:
        with _silence:
            _thread_count -= 1
            if not _thread_count:
                _undo.close()


def _redirect_output() -> None:
    stderr_copy = os.dup(2)
    _undo.callback(os.close, stderr_copy)
    _undo.callback(os.dup2, stderr_copy, 2)
    null_device = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null_device, 2)
    os.close(null_device)
    _undo.enter_context(contextlib.redirect_stdout(io.StringIO()))


def _check_size(path: Path, header: Mapping[str, Any]) -> int:
    """Size of a part's pixels in bytes; `FileError` for implausible sizes."""
    low, high = header["dataWindow"]
    columns, rows = int(high[0]) - int(low[0]) + 1, int(high[1]) - int(low[1]) + 1
    if columns < 1 or rows < 1 or columns * rows > _MOST_PIXELS:
        raise FileError(f"{path}: declares {columns} x {rows} pixels; refused as damaged")
    return columns * rows * 4 * len(header["channels"])
