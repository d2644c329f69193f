"""Native picture of a slanted lenticular display, woven from the views of a quilt.

Each sub-pixel belongs to one view: the one whose direction its cylinder sends it to, of N at even
steps across an elemental image. View 0 is the leftmost eye's, and the right part of an elemental
image. The view's picture is read where the sub-pixel's pixel is, and interpolated.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np

from inim.display import Display
from inim.display.layouts import Lenticular
from inim.display.pixels import SUBPIXELS, PixelOffset, ray_starts
from inim.image.files.eia_file import write_codes
from inim.image.files.light_field import quilt_layout
from inim.image.files.picture import open_picture
from inim.system.errors import FileError, UsageError
from inim.system.row_bands import row_bands

# Views and places of so many pixels are in memory at once.
_PIXELS_AT_ONCE = 2**20
# Ratios of width to height that count as equal: names of quilts round them.
_SAME_ASPECT = 0.02


def subpixel_views(display: Display, rows: slice) -> np.ndarray:
    """Views of sub-pixels, (rows, columns, 3) float64.

    1 (leftmost place in its elemental image, seen from the right end of the viewing zone) to above
    0 (rightmost place).

    Raises `UsageError`: not a lenticular.
    """
    layout = display.layout
    if not isinstance(layout, Lenticular):
        raise UsageError(
            f"display {display.name}: lattice = {display.lattice!r}; native pictures of quilts are "
            "for lenticular displays"
        )
    views = np.empty((rows.stop - rows.start, display.eia_shape[1], 3))
    for channel, subpixel in enumerate(SUBPIXELS[display.subpixels]):
        offset = PixelOffset(Fraction(0), subpixel.right, subpixel.channel)
        _, _, (across, _), (right, _) = ray_starts(display, rows, offset)
        views[..., channel] = 1 - layout.place_in_cell(across + right)[1]
    return views


@dataclass(frozen=True)
class Quilt:
    """Views in one picture, from the lower left to the upper right.

    * `codes`, (height, width, 3) uint8.
    * `columns`, `rows`: tiles. What exceeds whole tiles, on the right and at the top, is unused.
    * `aspect`: width over height of a tile as displayed.
    """

    codes: np.ndarray
    columns: int
    rows: int
    aspect: float

    @classmethod
    def read(cls, path: Path, tiles: tuple[int, int] | None, aspect: float | None) -> Quilt:
        """Read a quilt of any program.

        * `tiles`, `aspect`: instead of those in its name, ``NAME_qs8x6a0.75.png``.

        Raises `FileError` or `UsageError`: unreadable, or no layout.
        """
        named = quilt_layout(path)
        if tiles is None and named is None:
            raise UsageError(
                f"{path}: no layout in its name, such as _qs8x6a0.75; give --tiles COLSxROWS"
            )
        columns, rows = tiles or (named or (1, 1, 1.0))[:2]
        with open_picture(
            path, ("PNG", "JPEG"), 3, "not a readable PNG or JPEG; save it again"
        ) as picture:
            codes = np.asarray(picture.convert("RGB"))
        height, width = codes.shape[0] // rows, codes.shape[1] // columns
        if not (height and width):
            raise FileError(
                f"{path}: has {codes.shape[1]} x {codes.shape[0]} pixels, fewer than {columns} x "
                f"{rows} tiles; correct --tiles"
            )
        if aspect is None:
            aspect = width / height if tiles or named is None else named[2]
        return cls(codes, columns, rows, aspect)


def weave(quilt: Quilt, display: Display) -> np.ndarray:
    """Native picture of a quilt, (rows, columns, 3) uint8.

    Tiles of another aspect ratio than the panel's are shown whole, between black bars.

    Raises `UsageError`: see `subpixel_views`.
    """
    from scipy.ndimage import map_coordinates

    panel_rows, panel_columns = display.eia_shape
    wider = panel_columns / panel_rows / quilt.aspect
    if abs(wider - 1) < _SAME_ASPECT:
        wider = 1.0
    height, width = quilt.codes.shape[0] // quilt.rows, quilt.codes.shape[1] // quilt.columns
    # Positions in a tile, of pixels' centres, from the tile's centre.
    x = ((np.arange(panel_columns) + 0.5) / panel_columns - 0.5) * max(wider, 1.0)
    y = ((np.arange(panel_rows) + 0.5) / panel_rows - 0.5)[:, None] * max(1 / wider, 1.0)
    inside = (abs(x) <= 0.5) & (abs(y) <= 0.5)
    across = np.clip((x + 0.5) * width - 0.5, 0, width - 1)
    down = np.clip((y + 0.5) * height - 0.5, 0, height - 1)
    native, count = np.zeros((*inside.shape, 3), np.uint8), quilt.columns * quilt.rows
    for rows in row_bands(panel_rows, panel_columns, _PIXELS_AT_ONCE):
        views = np.minimum((subpixel_views(display, rows) * count).astype(np.int64), count - 1)
        tile_rows, tiles = np.divmod(views, quilt.columns)
        top, left = len(quilt.codes) - (tile_rows + 1) * height, tiles * width
        for c in range(3):
            places = top[..., c] + down[rows], left[..., c] + across
            codes = map_coordinates(quilt.codes[..., c], places, np.float64, order=1)
            native[rows, :, c] = np.where(inside[rows], codes + 0.5, 0)
    return native


def weave_file(
    source: Path,
    out: Path,
    display: Display,
    tiles: tuple[int, int] | None = None,
    aspect: float | None = None,
) -> None:
    """Write the native picture of a quilt as PNG.

    Raises `FileError` or `UsageError`: see `Quilt.read` and `weave`; the name of `out`.
    """
    if out.suffix.lower() != ".png":
        raise UsageError(f"--native {out}: a native picture is a .png; change the file name")
    write_codes(out, weave(Quilt.read(source, tiles, aspect), display), display.pixel_pitch_mm)
