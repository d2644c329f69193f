"""Looking Glass quilts: views side by side in one picture, the leftmost at the bottom left.

Tiles run from left to right and then upwards, as the eye moves from left to right. The file's name
says how to cut it up again: ``NAME_qs8x6a0.75.png`` has 8 columns and 6 rows of views, each 0.75
times as wide as high.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from inim.errors import FileError, UsageError
from inim.files.image import write_atomically

__all__ = ["quilt_grid", "read_quilt", "write_quilt"]

_NAME = re.compile(r"_qs(\d{1,3})x(\d{1,3})a(\d+(?:\.\d+)?)$")


def quilt_grid(views: int) -> tuple[int, int]:
    """Columns and rows, as near to a square as whole rows of this many views allow."""
    rows = max(n for n in range(1, int(views**0.5) + 1) if views % n == 0)
    return views // rows, rows


def write_quilt(
    path: Path, views: NDArray[np.uint8], aspect: float, grid: tuple[int, int] | None = None
) -> Path:
    """Write views as a quilt.

    Parameters
    ----------
    path : Path
        .png; what the name lacks of ``_qsCOLSxROWSaASPECT`` is added.
    views : (n, H, W, 3) uint8, sRGB
        From the leftmost eye to the rightmost.
    aspect : float
        Width of a view over its height, as seen.
    grid : (columns, rows), optional
        `quilt_grid` otherwise.

    Returns
    -------
    Path
        What was written.

    Raises
    ------
    UsageError
        A grid of another number of tiles, or another kind of file.
    """
    from PIL import Image

    columns, rows = quilt_grid(len(views)) if grid is None else grid
    if columns * rows != len(views):
        raise UsageError(f"a quilt of {columns} x {rows} tiles cannot hold {len(views)} views")
    if path.suffix.lower() != ".png":
        raise UsageError(f"--quilt {path}: a quilt is a .png")
    stem = _NAME.sub("", path.stem)
    out = path.with_name(f"{stem}_qs{columns}x{rows}a{aspect:.6g}{path.suffix}")
    _, height, width, channels = views.shape
    tiles = views.reshape(rows, columns, height, width, channels)[::-1]
    picture = tiles.swapaxes(1, 2).reshape(rows * height, columns * width, channels)
    shown = Image.fromarray(np.ascontiguousarray(picture))
    write_atomically(out, lambda p: shown.save(p, "PNG", compress_level=1))
    return out


def read_quilt(path: Path) -> tuple[NDArray[np.uint8], float]:
    """Views of a quilt, (n, H, W, 3) uint8 sRGB from left to right, and their aspect.

    Raises
    ------
    FileError
        Missing, not a picture, or a name or size that does not say how to cut it.
    """
    from PIL import Image

    found = _NAME.search(path.stem)
    if not found or not int(found[1]) * int(found[2]):
        raise FileError(f"{path}: a quilt's name ends in _qsCOLSxROWSaASPECT; rename it")
    columns, rows = int(found[1]), int(found[2])
    try:
        with Image.open(path, formats=["PNG", "JPEG"]) as picture:
            pixels = np.asarray(picture.convert("RGB"))
    except Exception as error:
        raise FileError(f"{path}: not a readable picture ({error})") from error
    if pixels.shape[0] % rows or pixels.shape[1] % columns:
        raise FileError(
            f"{path}: {pixels.shape[1]} x {pixels.shape[0]} pixels cannot be cut into {columns} x "
            f"{rows} tiles; correct its name"
        )
    height, width = pixels.shape[0] // rows, pixels.shape[1] // columns
    tiles = pixels.reshape(rows, height, columns, width, 3).swapaxes(1, 2)[::-1]
    return tiles.reshape(rows * columns, height, width, 3), float(found[3])
