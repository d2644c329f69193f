"""4D light fields: sub-aperture views of an EIA, folders of views as in the HCI benchmark, quilts.

A light field is a grid of views. Row 0 belongs to the uppermost eye, column 0 to the leftmost. The
pixels at the same position under all lenses emit parallel rays and form one view, with one pixel
per lens. Rays to an eye on the left start right of the lens axis: the order of view columns is
opposite to that of pixel columns, and likewise for rows.

With a whole number of pixels per lens, the views are a permutation of the EIA's pixels. Otherwise a
view takes the pixel nearest to its position under each lens.

A view shifts a point at depth z by z times the view's slope. Between adjacent views the point moves
by ``d = z s / p`` pixels, with the slope step s and the pixel size p. This is the HCI benchmark's
disparity: positive in front of the plane without shift, here the lens array.
Honauer et al. (2016), https://lightfield-analysis.uni-konstanz.de.
"""

import configparser
import re
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from inim.display import Display
from inim.display.pixels import PixelAxis
from inim.image.files.picture import open_picture, read_pfm, write_pfm
from inim.image.rgbd import RGBD
from inim.system.errors import FileError, UsageError
from inim.system.files import read_file
from inim.system.process.atomic_file import write_atomically

_VIEW = re.compile(r"input_Cam(\d{3,4})\.png")
_PARAMETERS = "parameters.cfg"
_DISPARITY, _ANY_DISPARITY = "gt_disp_lowres.pfm", "gt_disp_*.pfm"
_QUILT_NAME = re.compile(r"_qs(\d{1,3})x(\d{1,3})a(\d+(?:\.\d+)?)$")
_MOST_VIEWS = 10_000
_MOST_BYTES = 2**32
_MOST_PARAMETER_BYTES = 2**20


@dataclass(frozen=True)
class LightField:
    """A grid of views."""

    #: (rows, columns, H, W, 3) uint8, sRGB: row 0 from the uppermost eye, column 0 from the
    #: leftmost.
    views: NDArray[np.uint8]
    #: (H, W) float32, or None: disparity of the centre view: shift in pixels to the next view,
    #: positive if nearer.
    disparity: NDArray[np.float32] | None = None
    #: True for views of an EIA, as marked by `write_hci`: disparity is 0 on the lens array. For
    #: other light fields the plane of disparity 0 is unknown.
    of_display: bool = False


def view_grid(display: Display) -> tuple[int, int]:
    """Rows and columns of views of an EIA: the number of whole pixels per lens, at least one."""
    _check_rows(display)
    down, across = display.exact_pixels_per_lens
    return max(1, int(down)), max(1, int(across))


def sub_aperture_views(
    eia: np.ndarray, display: Display, grid: tuple[int, int] | None = None
) -> np.ndarray:
    """Extract the views of an EIA.

    * `eia`, (rows, columns, ...) array: shape: `eia_shape` of the display.
    * `display`: separable.
    * `grid`, (rows, columns): number of views, evenly spaced over a lens's field; by default
      `view_grid`.

    Returns (view rows, view columns, lens rows, lens columns, ...) array, of the EIA's type.

    Raises `UsageError`: wrong shape, or a display without rows and columns of lenses.
    """
    _check_rows(display)
    if eia.shape[:2] != display.eia_shape:
        raise UsageError(
            f"EIA of {eia.shape[1]} x {eia.shape[0]} pixels; display {display.name} has "
            f"{display.eia_shape[1]} x {display.eia_shape[0]}"
        )
    down, across = view_grid(display) if grid is None else grid
    x = (0.5 - (np.arange(across) + 0.5) / across) * display.elemental_image_pitch_mm
    y = ((np.arange(down) + 0.5) / down - 0.5) * display.elemental_row_pitch_mm
    rows = _nearest_pixels(display.rows, _lattice(display, 1), y, display.name)
    columns = _nearest_pixels(display.columns, _lattice(display, 0), x, display.name)
    views: np.ndarray = eia[rows[:, None, :, None], columns[None, :, None, :]]
    return views


def eia_from_views(
    views: np.ndarray, display: Display, shift: float = 0.0, pixel_mm: float | None = None
) -> np.ndarray:
    """Compute the EIA of a light field: each panel pixel takes the view nearest to its direction.

    Inverts `sub_aperture_views` for whole numbers of pixels per lens.

    * `views`, (view rows, view columns, H, W, ...) array: any number and size.
    * `display`: separable.
    * `shift`: disparity to add, in view pixels; positive values move the scene towards the viewer.
    * `pixel_mm`: size of a view's pixel on the array; by default the views are stretched over the
      array.

    Returns (rows, columns, ...) array, of the views' type: zero outside the array, and where the
    shift exceeds the views.
    """
    _check_rows(display, "leave --all-views out")
    down, across, height, width = views.shape[:4]
    wide = display.width_mm / width if pixel_mm is None else pixel_mm
    high = display.height_mm / height if pixel_mm is None else pixel_mm
    view_column, column, outside_x = _view_pixels(display, 0, width, wide, across, shift)
    view_row, row, outside_y = _view_pixels(display, 1, height, high, down, shift)
    eia: np.ndarray = views[view_row[:, None], view_column[None, :], row[:, None], column[None, :]]
    eia[outside_y] = 0
    eia[:, outside_x] = 0
    return eia


def disparity_step_mm(display: Display, across: int, pixel_mm: float) -> float:
    """Depth per pixel of disparity [mm].

    ``p g / (Q / n)``: pixel size of a view over the slope step between n views in a lens's field.
    """
    return pixel_mm * display.gap_mm * across / display.elemental_image_pitch_mm


def read_hci(folder: Path) -> LightField:
    """Read a light field in the HCI benchmark's layout.

    ``input_Cam000.png`` ..., row by row from the top left; the grid from ``parameters.cfg``
    (``num_cams_x``, ``num_cams_y``), or a square one without it. The centre view's disparity is
    optional: ``gt_disp_lowres.pfm`` or ``gt_disp_CamNNN.pfm``.

    Raises `FileError`: a view is missing, damaged or of another size, or the grid does not match
    their number.
    """
    if not folder.is_dir():
        raise FileError(f"{folder}: no such folder; give the folder of an HCI light field's views")
    numbers = sorted(int(m[1]) for p in folder.iterdir() if (m := _VIEW.fullmatch(p.name)))
    if not numbers:
        raise FileError(f"{folder}: contains no input_Cam000.png; give the folder of the views")
    if numbers != list(range(len(numbers))) or len(numbers) > _MOST_VIEWS:
        missing = next(i for i, n in enumerate([*numbers, -1]) if i != n)
        raise FileError(f"{folder}: view input_Cam{missing:03}.png is missing; complete the folder")
    down, across, of_display = _read_parameters(folder, len(numbers))
    views: NDArray[np.uint8] = np.empty(0, np.uint8)
    for number in numbers:
        path = folder / f"input_Cam{number:03}.png"
        with open_picture(path, ("PNG",), 1) as picture:
            view = np.asarray(picture.convert("RGB"))
        if number == 0:
            if view.nbytes * len(numbers) > _MOST_BYTES:
                raise FileError(
                    f"{folder}: {len(numbers)} views of {view.nbytes} bytes; at most "
                    f"{_MOST_BYTES} bytes are read"
                )
            views = np.empty((len(numbers), *view.shape), np.uint8)
        if view.shape != views.shape[1:]:
            raise FileError(
                f"{path}: {view.shape[1]} x {view.shape[0]} pixels, the first view has "
                f"{views.shape[2]} x {views.shape[1]}; all need one size"
            )
        views[number] = view
    grid = views.reshape(down, across, *views.shape[1:])
    return LightField(grid, _read_disparity(folder, grid), of_display)


def centre_disparity(rgbd: RGBD, display: Display, across: int) -> NDArray[np.float32]:
    """Disparity of an EIA's centre view, from the depth of its scene.

    Centre view and depth camera both look straight back through the lens centres. Each lens takes
    the depth of the pixel at its centre.

    * `across`: columns of views.

    Returns (lens rows, lens columns) float32: shift in pixels to the next view, positive in front
    of the array; NaN without surface.
    """
    rows, columns = rgbd.shape
    # For centres on a pixel border, the offset selects the right and lower pixel despite rounding.
    row = rows / 2 - _lattice(display, 1) / rgbd.pixel_mm + 1e-6
    column = columns / 2 + _lattice(display, 0) / rgbd.pixel_mm + 1e-6
    pixels = np.ix_(
        np.clip(np.floor(row), 0, rows - 1).astype(int),
        np.clip(np.floor(column), 0, columns - 1).astype(int),
    )
    step = disparity_step_mm(display, across, display.width_mm / display.columns.lenses)
    disparity = np.where(rgbd.covered[pixels], rgbd.depth_mm[pixels] / step, np.nan)
    return disparity.astype(np.float32)


def write_hci(
    folder: Path,
    views: NDArray[np.uint8],
    display: Display | None = None,
    disparity: NDArray[np.float32] | None = None,
) -> None:
    """Write views, (rows, columns, H, W, 3) uint8 sRGB, in the HCI benchmark's layout.

    * `folder`: created if missing; views and disparities in it are replaced.
    * `display`: display of the EIA; its geometry is written to ``parameters.cfg``.
    * `disparity`, (H, W) array: disparity of the centre view; see `LightField`.
    """
    from PIL import Image

    down, across, height, width = views.shape[:4]
    for number, view in enumerate(views.reshape(-1, height, width, 3)):
        picture = Image.fromarray(np.ascontiguousarray(view))
        write_atomically(folder / f"input_Cam{number:03}.png", partial(picture.save, format="PNG"))
    for stale in folder.glob("input_Cam*.png"):
        match = _VIEW.fullmatch(stale.name)
        if match and int(match[1]) >= down * across:
            stale.unlink()
    for stale in folder.glob(_ANY_DISPARITY):
        stale.unlink()
    if disparity is not None:
        write_atomically(folder / _DISPARITY, lambda p: write_pfm(p, disparity))
    text = (
        f"[intrinsics]\nimage_resolution_x_px = {width}\nimage_resolution_y_px = {height}\n\n"
        f"[extrinsics]\nnum_cams_x = {across}\nnum_cams_y = {down}\n"
    )
    if display is not None:
        step = disparity_step_mm(display, across, display.width_mm / width)
        text += (
            "\n[inim]\nprojection = parallel\n"
            f"slope_step = {display.elemental_image_pitch_mm / across / display.gap_mm!r}\n"
            f"view_pixel_mm = {display.width_mm / width!r}\ndepth_of_one_disparity_mm = {step!r}\n"
        )
    write_atomically(folder / _PARAMETERS, lambda p: p.write_text(text, encoding="utf-8"))


def quilt_path(path: Path, columns: int, rows: int, aspect: float) -> Path:
    """Path of a quilt with its layout in the file name.

    ``NAME_qs8x6a0.75.png`` has 8 columns and 6 rows of views, each with an aspect ratio (width over
    height) of 0.75. A layout in the given name is replaced.

    Raises `UsageError`: the suffix is not .png.
    """
    if path.suffix.lower() != ".png":
        raise UsageError(f"--quilt {path}: a quilt is a .png; change the file name")
    stem = _QUILT_NAME.sub("", path.stem)
    return path.with_name(f"{stem}_qs{columns}x{rows}a{aspect:.6g}{path.suffix}")


def quilt_layout(path: Path) -> tuple[int, int, float] | None:
    """Columns, rows and aspect ratio of views in the name of a quilt; None if it has none."""
    match = _QUILT_NAME.search(path.stem)
    if match is None:
        return None
    columns, rows, aspect = int(match[1]), int(match[2]), float(match[3])
    return (columns, rows, aspect) if columns and rows and aspect else None


def write_quilt(path: Path, views: NDArray[np.uint8], columns: int, rows: int) -> None:
    """Write views as a quilt: a grid of tiles in one picture.

    Tiles run from left to right and then upwards, for eyes from left to right.

    * `path`: see `quilt_path`.
    * `views`, (columns * rows, H, W, 3) uint8, sRGB: from the leftmost eye to the rightmost.
    * `columns`, `rows`: number of tiles.
    """
    from PIL import Image

    _, height, width, channels = views.shape
    tiles = views.reshape(rows, columns, height, width, channels)[::-1]
    picture = tiles.swapaxes(1, 2).reshape(rows * height, columns * width, channels)
    quilt = Image.fromarray(picture)
    write_atomically(path, lambda p: quilt.save(p, "PNG", compress_level=1))


def _read_parameters(folder: Path, count: int) -> tuple[int, int, bool]:
    """Rows and columns of the grid of views, and True if they are views of an EIA."""
    path = folder / _PARAMETERS
    if not path.exists():
        side = round(count**0.5)
        if side * side != count:
            raise FileError(
                f"{path}: missing, and {count} is not a square number; give num_cams_x and _y"
            )
        return side, side, False
    text = read_file(path, _MOST_PARAMETER_BYTES)
    try:
        parser = configparser.ConfigParser(interpolation=None)
        parser.read_string(text.decode("utf-8"))
        down = parser.getint("extrinsics", "num_cams_y")
        across = parser.getint("extrinsics", "num_cams_x")
    except (ValueError, configparser.Error) as error:
        cause = str(error).partition("\n")[0]
        raise FileError(f"{path}: not readable ({cause}); give num_cams_x and _y") from error
    if down < 1 or across < 1 or down * across != count:
        raise FileError(
            f"{path}: {across} x {down} cameras, but there are {count} views; correct num_cams_x "
            "and _y"
        )
    return down, across, parser.get("inim", "projection", fallback="") == "parallel"


def _read_disparity(folder: Path, views: np.ndarray) -> NDArray[np.float32] | None:
    down, across, height, width = views.shape[:4]
    centre = (down // 2) * across + across // 2
    for name in (_DISPARITY, f"gt_disp_Cam{centre:03}.pfm"):
        path = folder / name
        if path.is_file():
            disparity = read_pfm(path)
            if disparity.shape != (height, width):
                raise FileError(
                    f"{path}: {disparity.shape[1]} x {disparity.shape[0]} pixels; the views have "
                    f"{width} x {height}"
                )
            return disparity
    return None


def _check_rows(display: Display, remedy: str = "export a --quilt instead") -> None:
    if not display.is_separable:
        raise UsageError(
            f"display {display.name}: has no grid of views, as {display.not_separable_by} leaves "
            f"no rows and columns of lenses; {remedy}"
        )


def _lattice(display: Display, axis: int) -> np.ndarray:
    """Centres of the elemental images, columns (0) left to right or rows (1) top to bottom."""
    panel, cell, shift, sign = (
        (display.columns, display.elemental_image_pitch_mm, display.shift_x_mm, 1),
        (display.rows, display.elemental_row_pitch_mm, display.shift_y_mm, -1),
    )[axis]
    count = panel.lenses
    return sign * (np.arange(count) - (count - 1) / 2) * cell + shift


def _view_pixels(
    display: Display, axis: int, pixels: int, pixel_mm: float, views: int, shift: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """View, pixel of the view, and True outside the views, for each panel pixel of an axis."""
    panel, pitch, cell = (
        (display.columns, display.pitch_mm, display.elemental_image_pitch_mm),
        (display.rows, display.row_pitch_mm, -display.elemental_row_pitch_mm),
    )[axis]
    lattice = _lattice(display, axis)
    lens = np.clip(panel.lens, 0, len(lattice) - 1)
    # Reversed order: the leftmost view belongs to the rightmost pixel, the upper one to the lowest.
    within = (panel.position_mm - lattice[lens]) / cell
    view = np.clip(np.floor((0.5 - within) * views), 0, views - 1).astype(int)
    # Nearer points move to the right for eyes on the left, and down for eyes above.
    centre = (lens + 0.5 - len(lattice) / 2) * (pitch / pixel_mm) + pixels / 2
    pixel = np.floor(centre + shift * (view - (views - 1) / 2))
    outside = (pixel < 0) | (pixel >= pixels) | (panel.lens < 0)
    return view, np.clip(pixel, 0, pixels - 1).astype(int), outside


def _nearest_pixels(
    axis: PixelAxis, lattice: np.ndarray, offset: np.ndarray, display: str
) -> np.ndarray:
    """Index of the lens's pixel nearest to each offset from its centre, (offsets, lenses).

    `display` is the name for the error message.
    """
    indices = np.empty((len(offset), len(lattice)), np.int64)
    for lens, middle in enumerate(lattice):
        pixels = np.flatnonzero(axis.lens == lens)
        if not pixels.size:
            raise UsageError(
                f"display {display}: lens {lens} has no pixel of the panel; enlarge the panel"
            )
        distance = np.abs(axis.position_mm[pixels][None, :] - middle - offset[:, None])
        indices[:, lens] = pixels[distance.argmin(axis=1)]
    return indices
