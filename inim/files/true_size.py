"""EIA files that know how large they are: PNG, EXR, and a PDF that prints at true size.

An elemental image array only works under its lens sheet when every pixel is as large as the sheet
was made for; so the size travels with the picture.
"""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inim.color import srgb_codes
from inim.errors import FileError
from inim.files.image import write_atomically
from inim.version import __version__

__all__ = ["EIA_SUFFIXES", "write_eia", "write_true_size_pdf"]

EIA_SUFFIXES = (".png", ".exr")
_MM_PER_INCH = 25.4
_POINTS_PER_INCH = 72.0
# A page beyond this many points a side is cut off by many viewers (PDF 1.7, annex C).
_MOST_POINTS = 14_400


def write_eia(
    path: Path, eia: NDArray[np.float32], empty: NDArray[np.bool_] | None, pixel_mm: float
) -> None:
    """Write an EIA: sRGB PNG with its pixel size (pHYs), or linear EXR (xDensity).

    Parameters
    ----------
    path : Path
        .png or .exr.
    eia : (rows, columns, 3) float32, linear RGB
    empty : (rows, columns) bool, or None
        Pixels that show nothing: alpha 0 there, 1 elsewhere; no alpha without it.
    pixel_mm : float
        The panel's pixel.

    Raises
    ------
    FileError
        Another kind of file, or it cannot be written.
    """
    suffix = path.suffix.lower()
    if suffix not in EIA_SUFFIXES:
        raise FileError(f"{path}: an EIA is written as {' or '.join(EIA_SUFFIXES)}")
    if path.is_dir():
        raise FileError(f"{path}: is a folder; name a file")
    if suffix == ".png":
        _write_png(path, eia, empty, pixel_mm)
    else:
        _write_exr(path, eia, empty, pixel_mm)


def _write_png(
    path: Path, eia: NDArray[np.float32], empty: NDArray[np.bool_] | None, pixel_mm: float
) -> None:
    from PIL import Image

    codes = srgb_codes(eia)
    if empty is not None:
        alpha = np.where(empty, 0, 255).astype(np.uint8)
        codes = np.concatenate([codes, alpha[..., None]], axis=-1)
    per_inch = _MM_PER_INCH / pixel_mm
    picture = Image.fromarray(codes)
    write_atomically(
        path,
        lambda p: picture.save(p, "PNG", compress_level=1, dpi=(per_inch, per_inch)),
    )


def _write_exr(
    path: Path, eia: NDArray[np.float32], empty: NDArray[np.bool_] | None, pixel_mm: float
) -> None:
    import OpenEXR

    header: dict[str, Any] = {
        "compression": OpenEXR.ZIPS_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "inim:version": __version__,
        "inim:pixel_mm": repr(float(pixel_mm)),
        "xDensity": _MM_PER_INCH / pixel_mm,
    }
    channels = {"RGB": np.ascontiguousarray(eia, np.float32)}
    if empty is not None:
        channels["A"] = np.where(empty, np.float32(0), np.float32(1))
    write_atomically(path, lambda p: OpenEXR.File(header, channels).write(str(p)))


def write_true_size_pdf(path: Path, eia: NDArray[np.float32], pixel_mm: float) -> None:
    """Write an EIA as a PDF of one page that is exactly as large as the panel.

    The pixels are stored without loss and drawn unsmoothed; empty ones are black. Print it at 100 %
    ("actual size"), at a resolution that is a multiple of the picture's if the printer has one.

    Parameters
    ----------
    path : Path
        .pdf
    eia : (rows, columns, 3) float32, linear RGB
    pixel_mm : float

    Raises
    ------
    FileError
        Another kind of file, a page larger than PDF allows, or it cannot be written.
    """
    if path.suffix.lower() != ".pdf":
        raise FileError(f"{path}: a sheet for printing is a .pdf")
    rows, columns = eia.shape[:2]
    width, height = (n * pixel_mm / _MM_PER_INCH * _POINTS_PER_INCH for n in (columns, rows))
    if max(width, height) > _MOST_POINTS:
        raise FileError(
            f"{path}: a page of {columns * pixel_mm:.0f} x {rows * pixel_mm:.0f} mm is larger than "
            "PDF allows; print the PNG from a program that keeps its size"
        )
    codes = srgb_codes(eia)
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
    write_atomically(path, lambda p: _put(p, _pdf(objects)))


def _pdf(objects: list[bytes]) -> bytes:
    """A PDF file of these objects, numbered from 1; the first is the catalogue."""
    body, places = bytearray(b"%PDF-1.6\n%\xe2\xe3\xcf\xd3\n"), []
    for number, content in enumerate(objects, 1):
        places.append(len(body))
        body += b"%d 0 obj\n" % number + content + b"\nendobj\n"
    start = len(body)
    body += b"xref\n0 %d\n0000000000 65535 f \n" % (len(objects) + 1)
    body += b"".join(b"%010d 00000 n \n" % place for place in places)
    body += b"trailer\n<< /Size %d /Root 1 0 R >>\n" % (len(objects) + 1)
    return bytes(body) + b"startxref\n%d\n%%%%EOF\n" % start


def _put(path: Path, data: bytes) -> None:
    path.write_bytes(data)
