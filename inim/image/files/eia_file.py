"""Reading of EIAs from any program, and writing of EIAs with their physical size.

An EIA matches its lens array only at the correct pixel size. The size is therefore stored in the
file: in a PNG, an EXR, or a PDF that prints at true size.
"""

import zlib
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inim.display import Display
from inim.display.pixels import MM_PER_INCH
from inim.image.color import linear_from_srgb, to_srgb
from inim.image.files.image import read_exr_channels, write_exr_parts
from inim.image.files.picture import open_picture, png_gamma
from inim.system.errors import FileError
from inim.system.files import check_file
from inim.system.process.atomic_file import write_atomically
from inim.system.row_bands import row_bands

# Pillow's names for grey of 16 bits.
_GREY_16 = ("I;16", "I;16B", "I")


def check_eia_name(path: Path) -> None:
    """Raise `FileError` if a file is missing or not a PNG or EXR by its name.

    The content is not decoded: only a supervised worker runs the native decoders.
    """
    if path.suffix.lower() not in EIA_SUFFIXES:
        raise FileError(f"{path}: not an EIA; give a .png (sRGB) or an .exr (linear)")
    check_file(path)


def read_eia(
    path: Path, display: Display, *, only_finite: bool = True
) -> tuple[np.ndarray, np.ndarray | None]:
    """Read a finished EIA: linear EXR, or sRGB PNG (grey or colour, 8 or 16 bits, optional alpha).

    Pillow reduces 16-bit colour to 8 bits; grey and EXR keep their precision. Colour profiles of
    PNGs are ignored.

    * `display`: its `eia_shape` must match the file.
    * `only_finite`: reject colours that are not finite.

    Returns `eia`, (rows, columns, 3) float32: linear RGB, composited over black; `mask`, (rows,
    columns) bool, or None: True where alpha is above 0; None for a file without alpha.

    Raises `FileError`: missing, damaged, wrong format or wrong size.
    """
    check_eia_name(path)
    if path.suffix.lower() == ".exr":
        eia, alpha = _read_exr(path, display)
        if only_finite:
            _check_finite(path, eia)
    else:
        with _open_png(path) as picture:
            _check_size(path, picture.size, display)
            eia, alpha = _linear(picture)
    return eia, None if alpha is None else alpha > 0


def _check_finite(path: Path, eia: np.ndarray) -> None:
    bad = np.count_nonzero(~np.isfinite(eia).all(axis=-1))
    if bad:
        raise FileError(f"{path}: {bad} pixels have colours that are not finite; replace them")


def turned_for(path: Path, display: Display) -> Display:
    """The display, on its side if the EIA in a file is: `inim generate` turns it for a picture.

    Raises `FileError`: missing, damaged or wrong format.
    """
    check_eia_name(path)
    if path.suffix.lower() == ".exr":
        size = next(iter(read_exr_channels(path).values())).shape[::-1]
    else:
        with _open_png(path) as picture:
            size = picture.size
    is_turned = size == display.eia_shape and size[0] != size[1]
    return display.turned() if is_turned and not display.differs_on_its_side else display


def _open_png(path: Path) -> AbstractContextManager[Any]:
    return open_picture(path, ("PNG",), 4, "not a readable PNG; save it again")


def _check_size(path: Path, size: tuple[int, int], display: Display) -> None:
    rows, columns = display.eia_shape
    if size != (columns, rows):
        raise FileError(
            f"{path}: has {size[0]} x {size[1]} pixels, display {display.name} needs {columns} x "
            f"{rows}; generate it for this display, or set its display with --display or -D"
        )


def _read_exr(path: Path, display: Display) -> tuple[np.ndarray, np.ndarray | None]:
    channels = read_exr_channels(path)
    _check_size(path, next(iter(channels.values())).shape[::-1], display)
    missing = [n for n in "RGB" if n not in channels or channels[n].shape != display.eia_shape]
    if missing:
        raise FileError(
            f"{path}: no full channel {', '.join(missing)}; it has {', '.join(channels) or 'none'}"
        )
    rgb = np.stack([channels[name] for name in "RGB"], axis=-1)
    alpha = channels.get("A")
    if alpha is None or alpha.shape != display.eia_shape:
        return rgb, None
    # EXR colours are premultiplied by alpha.
    return np.where((alpha > 0)[..., None], rgb, np.float32(0)), alpha


def _linear(picture: Any) -> tuple[np.ndarray, np.ndarray | None]:
    """Decode linear RGB and alpha of an open picture."""
    gamma = png_gamma(picture)
    if picture.mode in _GREY_16:
        return _linear_codes(np.asarray(picture)[..., None], 65535, gamma), None
    if "transparency" not in picture.info and "A" not in picture.getbands():
        return _linear_codes(np.asarray(picture.convert("RGB")), 255, gamma), None
    rgba = np.asarray(picture.convert("RGBA"))
    alpha = rgba[..., 3].astype(np.float32) / 255
    rgb = _linear_codes(rgba[..., :3], 255, gamma)
    rgb *= alpha[..., None]
    return rgb, alpha


def _linear_codes(codes: np.ndarray, white: int, gamma: float | None) -> np.ndarray:
    """Linear RGB, (rows, columns, 3) float32, of grey or colour codes from 0 to `white`.

    * `gamma`: exponent of the codes; None: sRGB.
    """
    linear = np.empty((*codes.shape[:2], 3), np.float32)
    for band in row_bands(*codes.shape[:2]):
        share = codes[band].astype(np.float32) / white
        linear[band] = linear_from_srgb(share) if gamma is None else share ** (1 / gamma)
    return linear


EIA_SUFFIXES = (".png", ".exr")
_POINTS_PER_INCH = 72.0
# Many viewers crop pages with a side of more points (PDF 1.7, annex C).
_MOST_POINTS = 14_400


def shows_holes(display: Display) -> bool:
    """True if the file of an EIA marks holes; native pictures for panels of cylinders are opaque,
    because programs that show them would show their own background.
    """
    return not display.layout.of_cylinders


def write_eia(
    path: Path, eia: NDArray[np.float32], empty: NDArray[np.bool_] | None, pixel_mm: float
) -> None:
    """Write an EIA: sRGB PNG with its pixel size (pHYs), or linear EXR (xDensity).

    * `path`: .png or .exr.
    * `eia`, (rows, columns, 3) float32, linear RGB
    * `empty`, (rows, columns) bool, or None: pixels without a surface at their centre. They get
      alpha 0 if they are black, others 1; None writes no alpha.
    * `pixel_mm`: pixel pitch of the panel.

    Raises `FileError`: the file cannot be written.
    """
    if empty is not None:
        empty = empty & ~eia.any(axis=-1)
    if path.suffix.lower() == ".exr":
        channels: dict[str, np.ndarray] = {"RGB": eia}
        if empty is not None:
            channels["A"] = np.where(empty, np.float32(0), np.float32(1))
        header = {"inim:pixel_mm": repr(float(pixel_mm)), "xDensity": MM_PER_INCH / pixel_mm}
        write_exr_parts(path, [(channels, "color")], header)
        return
    codes = to_srgb(eia)
    if empty is not None:
        alpha = np.where(empty, 0, 255).astype(np.uint8)
        codes = np.concatenate([codes, alpha[..., None]], axis=-1)
    write_codes(path, codes, pixel_mm)


def write_codes(path: Path, codes: NDArray[np.uint8], pixel_mm: float) -> None:
    """Write sRGB codes of panel pixels, (rows, columns, 3 or 4) uint8, as PNG with their size."""
    from PIL import Image

    picture, per_inch = Image.fromarray(codes), MM_PER_INCH / pixel_mm
    options = {"compress_level": 1, "dpi": (per_inch, per_inch)}
    write_atomically(path, lambda p: picture.save(p, "PNG", **options))


def write_true_size_pdf(path: Path, eia: NDArray[np.float32], pixel_mm: float) -> None:
    """Write an EIA as a one-page PDF with exactly the size of the panel.

    Pixels are lossless and not interpolated; empty ones are black. Print at 100 % ("actual size"),
    if possible at a multiple of the picture's resolution.

    * `path`: .pdf
    * `eia`, (rows, columns, 3) float32, linear RGB

    Raises `FileError`: the suffix is wrong, the page is too large for PDF, or the file cannot be
    written.
    """
    if path.suffix.lower() != ".pdf":
        raise FileError(f"{path}: not a PDF file name; use .pdf")
    rows, columns = eia.shape[:2]
    width, height = (n * pixel_mm / MM_PER_INCH * _POINTS_PER_INCH for n in (columns, rows))
    if max(width, height) > _MOST_POINTS:
        raise FileError(
            f"{path}: a page of {columns * pixel_mm:.0f} x {rows * pixel_mm:.0f} mm is larger than "
            "PDF allows; print the PNG from a program that keeps its size"
        )
    codes = to_srgb(eia)
    content = f"q {width:.6f} 0 0 {height:.6f} 0 0 cm /EIA Do Q\n".encode()
    picture = zlib.compress(codes.tobytes(), 6)
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {width:.6f} {height:.6f}] "
        "/Resources << /XObject << /EIA 5 0 R >> >> /Contents 4 0 R >>".encode(),
        f"<< /Length {len(content)} >>\nstream\n".encode() + content + b"endstream",
        f"<< /Type /XObject /Subtype /Image /Width {columns} /Height {rows} /ColorSpace /DeviceRGB "
        f"/BitsPerComponent 8 /Interpolate false /Filter /FlateDecode /Length {len(picture)} >>"
        "\nstream\n".encode()
        + picture
        + b"\nendstream",
    ]
    write_atomically(path, lambda p: p.write_bytes(_pdf(objects)))


def _pdf(objects: list[bytes]) -> bytes:
    """PDF file of these objects, numbered from 1; the first is the catalogue."""
    body, offsets = bytearray(b"%PDF-1.6\n%\xe2\xe3\xcf\xd3\n"), []
    for number, content in enumerate(objects, 1):
        offsets.append(len(body))
        body += b"%d 0 obj\n" % number + content + b"\nendobj\n"
    start = len(body)
    body += b"xref\n0 %d\n0000000000 65535 f \n" % (len(objects) + 1)
    body += b"".join(b"%010d 00000 n \n" % offset for offset in offsets)
    body += b"trailer\n<< /Size %d /Root 1 0 R >>\n" % (len(objects) + 1)
    return bytes(body) + b"startxref\n%d\n%%%%EOF\n" % start
