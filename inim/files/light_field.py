"""4D light fields: sub-aperture views of an EIA, folders of views as in the HCI benchmark, quilts.

A light field is a grid of views: row 0 is seen by the uppermost eye, column 0 by the leftmost. The
pixels at one place under all lenses send parallel rays, so together they are one view, of one pixel
per lens. An eye on the left is reached by rays that go left, from pixels to the right of their
lens's axis: columns of views run against columns of pixels, and so do rows.

Where lenses have a whole number of pixels, views are a permutation of the EIA's pixels; elsewhere a
view takes, under each lens, the pixel nearest to its place.

In a view, a point at depth z lies aside of where it is on the axis by z times the view's slope; so
between neighbouring views it moves by ``d = z s / p`` pixels, for a step s of slope and a pixel p.
That is the HCI benchmark's disparity: positive nearer than the plane that does not move, which is
here the lens array. Honauer et al. (2016), https://lightfield-analysis.uni-konstanz.de.
"""

from __future__ import annotations

import configparser
import re
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from inim.display import Display
from inim.display.pixels import PixelAxis
from inim.errors import FileError, UsageError
from inim.files.image import write_atomically
from inim.files.picture import open_picture, read_pfm, write_pfm
from inim.files.regular_file import read_file
from inim.image.rgbd import RGBD

_VIEW = re.compile(r"input_Cam(\d{3,4})\.png")
_PARAMETERS = "parameters.cfg"
_DISPARITY, _ANY_DISPARITY = "gt_disp_lowres.pfm", "gt_disp_*.pfm"
_QUILT_NAME = re.compile(r"_qs(\d{1,3})x(\d{1,3})a(\d+(?:\.\d+)?)$")
_MOST_VIEWS = 10_000
_MOST_BYTES = 2**32
_MOST_PARAMETER_BYTES = 2**20


@dataclass(frozen=True)
class LightField:
    """A grid of views.

    Attributes
    ----------
    views : (rows, columns, H, W, 3) uint8, sRGB
        Row 0 from the uppermost eye, column 0 from the leftmost.
    disparity : (H, W) float32, or None
        Of the centre view: pixels to the next view, positive where nearer.
    of_display : bool
        Whether they are an EIA's views, as `write_hci` marks them: what lies on the lens array has
        no disparity. Of others nobody knows where that plane is.
    """

    views: NDArray[np.uint8]
    disparity: NDArray[np.float32] | None = None
    of_display: bool = False


def view_grid(display: Display) -> tuple[int, int]:
    """Rows and columns of views of an EIA: as many as a lens has whole pixels, at least one."""
    _check_rows(display)
    down = display.elemental_row_pitch_mm / display.pixel_pitch_mm
    return max(1, int(down + 1e-9)), max(1, int(display.pixels_per_lens + 1e-9))


def sub_aperture_views(
    eia: np.ndarray, display: Display, grid: tuple[int, int] | None = None
) -> np.ndarray:
    """The views of an EIA.

    Parameters
    ----------
    eia : (rows, columns, ...) array
        Of the display's `eia_shape`.
    display : Display
        With a square lattice, neither turned nor tilted.
    grid : (rows, columns), optional
        Of views, their directions evenly spread over a lens's field; `view_grid` otherwise.

    Returns
    -------
    (view rows, view columns, lens_rows, lens_columns, ...) array, of the EIA's type.

    Raises
    ------
    UsageError
        Another shape, or a display whose lenses do not stand in rows and columns.
    """
    _check_rows(display)
    if eia.shape[:2] != display.eia_shape:
        raise UsageError(
            f"EIA of {eia.shape[1]} x {eia.shape[0]} pixels; display {display.name} has "
            f"{display.eia_shape[1]} x {display.eia_shape[0]}"
        )
    down, across = view_grid(display) if grid is None else grid
    rows, columns = _pixels_of_views(display, down, across)
    views: np.ndarray = eia[rows[:, None, :, None], columns[None, :, None, :]]
    return views


def eia_from_views(
    views: np.ndarray, display: Display, shift: float = 0.0, pixel_mm: float | None = None
) -> np.ndarray:
    """The EIA of a light field: each panel pixel shows the view nearest to its direction.

    The inverse of `sub_aperture_views` where there is one.

    Parameters
    ----------
    views : (view rows, view columns, H, W, ...) array
        Of any number and size.
    display : Display
        With a square lattice, neither turned nor tilted.
    shift : float
        Disparity to add, in view pixels: moves all that is seen towards the viewer.
    pixel_mm : float, optional
        A view's pixel on the array; None stretches the views over all of the array.

    Returns
    -------
    (rows, columns, ...) array, of the views' type
        Zero beside the array, and where the shift leaves the views.
    """
    _check_rows(display)
    down, across, height, width = views.shape[:4]
    cell_x, cell_y = display.elemental_image_pitch_mm, display.elemental_row_pitch_mm
    wide = display.width_mm / width if pixel_mm is None else pixel_mm
    high = display.height_mm / height if pixel_mm is None else pixel_mm
    column, x = _place(display.columns, _lattice(display, 0), width, display.pitch_mm / wide)
    row, y = _place(display.rows, _lattice(display, 1), height, display.row_pitch_mm / high)
    # Against the pixels: the leftmost view from the rightmost pixel, the upper one from the lower.
    view_column = np.clip(np.floor((0.5 - x / cell_x) * across), 0, across - 1).astype(int)
    view_row = np.clip(np.floor((0.5 + y / cell_y) * down), 0, down - 1).astype(int)
    # What comes nearer moves to the right for eyes on the left, and down for eyes above.
    column = np.floor(column + shift * (view_column - (across - 1) / 2))
    row = np.floor(row + shift * (view_row - (down - 1) / 2))
    beside_x = (column < 0) | (column >= width) | (display.columns.lens < 0)
    beside_y = (row < 0) | (row >= height) | (display.rows.lens < 0)
    column = np.clip(column, 0, width - 1).astype(int)
    row = np.clip(row, 0, height - 1).astype(int)
    eia: np.ndarray = views[view_row[:, None], view_column[None, :], row[:, None], column[None, :]]
    eia[beside_y] = 0
    eia[:, beside_x] = 0
    return eia


def disparity_step_mm(display: Display, across: int, pixel_mm: float) -> float:
    """Depth on the display of one pixel of disparity.

    ``p g / (Q / n)``: a view's pixel over the step of slope between n views across a lens's field.
    """
    return pixel_mm * display.gap_mm * across / display.elemental_image_pitch_mm


def read_hci(folder: Path) -> LightField:
    """Read a light field in the HCI benchmark's layout.

    ``input_Cam000.png`` ..., row by row from the top left; the grid from ``parameters.cfg``
    (``num_cams_x``, ``num_cams_y``), or a square one without it. The centre view's disparity, if
    there: ``gt_disp_lowres.pfm`` or ``gt_disp_CamNNN.pfm``.

    Raises
    ------
    FileError
        A view missing, damaged or of another size; or a grid that does not fit their number.
    """
    if not folder.is_dir():
        raise FileError(f"{folder}: no such folder; an HCI light field is a folder of views")
    numbers = sorted(int(m[1]) for p in folder.iterdir() if (m := _VIEW.fullmatch(p.name)))
    if not numbers:
        raise FileError(f"{folder}: holds no input_Cam000.png; it is no HCI light field")
    if numbers != list(range(len(numbers))) or len(numbers) > _MOST_VIEWS:
        missing = next(i for i, n in enumerate([*numbers, -1]) if i != n)
        raise FileError(f"{folder}: view input_Cam{missing:03}.png is missing; complete the folder")
    down, across, of_display = _parameters(folder, len(numbers))
    views: NDArray[np.uint8] | None = None
    for number in numbers:
        picture = _read_view(folder / f"input_Cam{number:03}.png")
        if views is None:
            if picture.nbytes * len(numbers) > _MOST_BYTES:
                raise FileError(
                    f"{folder}: {len(numbers)} views of {picture.nbytes} bytes; too many"
                )
            views = np.empty((len(numbers), *picture.shape), np.uint8)
        if picture.shape != views.shape[1:]:
            raise FileError(
                f"{folder / f'input_Cam{number:03}.png'}: {picture.shape[1]} x {picture.shape[0]} "
                f"pixels, the first view has {views.shape[2]} x {views.shape[1]}"
            )
        views[number] = picture
    assert views is not None
    shaped = views.reshape(down, across, *views.shape[1:])
    return LightField(shaped, _disparity(folder, shaped), of_display)


def centre_disparity(rgbd: RGBD, display: Display, across: int) -> NDArray[np.float32]:
    """The disparity of the centre view of an EIA's, from the depth of its scene.

    The centre view looks straight back through the lens centres, and so does the depth camera: so
    each lens has the depth of the picture's pixel that its centre lies in.

    Parameters
    ----------
    rgbd : RGBD
    display : Display
    across : int
        Columns of views.

    Returns
    -------
    (lens_rows, lens_columns) float32
        Pixels to the next view, positive in front of the array; NaN where nothing is.
    """
    rows, columns = rgbd.shape
    # A centre on a pixel's border, of which rounding would choose either side, goes to the right
    # and below.
    row = rows / 2 - _lattice(display, 1) / rgbd.pixel_mm + 1e-6
    column = columns / 2 + _lattice(display, 0) / rgbd.pixel_mm + 1e-6
    places = np.ix_(
        np.clip(np.floor(row), 0, rows - 1).astype(int),
        np.clip(np.floor(column), 0, columns - 1).astype(int),
    )
    step = disparity_step_mm(display, across, display.width_mm / display.lens_columns)
    found = np.where(rgbd.covered[places], rgbd.depth_mm[places] / step, np.nan)
    return found.astype(np.float32)


def write_hci(
    folder: Path,
    views: NDArray[np.uint8],
    display: Display | None = None,
    disparity: NDArray[np.float32] | None = None,
) -> None:
    """Write views, (rows, columns, H, W, 3) uint8 sRGB, in the HCI benchmark's layout.

    Parameters
    ----------
    folder : Path
        Made if need be; views and disparities in it are replaced.
    views : array
    display : Display, optional
        Whose EIA they are of: what is known of their geometry goes into ``parameters.cfg``.
    disparity : (H, W) array, optional
        Of the centre view; see `LightField`.
    """
    from PIL import Image

    down, across, height, width = views.shape[:4]
    for number, view in enumerate(views.reshape(-1, height, width, 3)):
        picture = Image.fromarray(np.ascontiguousarray(view))
        put = partial(picture.save, format="PNG")
        write_atomically(folder / f"input_Cam{number:03}.png", put)
    for stale in folder.glob("input_Cam*.png"):
        found = _VIEW.fullmatch(stale.name)
        if found and int(found[1]) >= down * across:
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
    """The path of a quilt, whose name says how to cut it up again.

    ``NAME_qs8x6a0.75.png`` has 8 columns and 6 rows of views, each 0.75 times as wide as high, as
    seen. What the name lacks of it is added, and what it says otherwise is replaced.

    Raises
    ------
    UsageError
        Another kind of file.
    """
    if path.suffix.lower() != ".png":
        raise UsageError(f"--quilt {path}: a quilt is a .png")
    stem = _QUILT_NAME.sub("", path.stem)
    return path.with_name(f"{stem}_qs{columns}x{rows}a{aspect:.6g}{path.suffix}")


def write_quilt(path: Path, views: NDArray[np.uint8], columns: int, rows: int) -> None:
    """Write views as a quilt: side by side in one picture.

    Tiles run from left to right and then upwards, as the eye moves from left to right.

    Parameters
    ----------
    path : Path
        See `quilt_path`.
    views : (columns * rows, H, W, 3) uint8, sRGB
        From the leftmost eye to the rightmost.
    columns, rows : int
        Of tiles.
    """
    from PIL import Image

    _, height, width, channels = views.shape
    tiles = views.reshape(rows, columns, height, width, channels)[::-1]
    picture = tiles.swapaxes(1, 2).reshape(rows * height, columns * width, channels)
    shown = Image.fromarray(picture)
    write_atomically(path, lambda p: shown.save(p, "PNG", compress_level=1))


def _parameters(folder: Path, count: int) -> tuple[int, int, bool]:
    """Rows and columns of the grid of views, and whether `write_hci` had a display."""
    path = folder / _PARAMETERS
    if not path.exists():
        side = round(count**0.5)
        if side * side != count:
            raise FileError(f"{path}: missing, and {count} views make no square; state num_cams_x")
        return side, side, False
    text = read_file(path, _MOST_PARAMETER_BYTES)
    try:
        parser = configparser.ConfigParser(interpolation=None)
        parser.read_string(text.decode("utf-8"))
        down = parser.getint("extrinsics", "num_cams_y")
        across = parser.getint("extrinsics", "num_cams_x")
    except (ValueError, configparser.Error) as error:
        cause = str(error).partition("\n")[0]
        raise FileError(f"{path}: not readable ({cause}); state num_cams_x and _y") from error
    if down < 1 or across < 1 or down * across != count:
        raise FileError(f"{path}: {across} x {down} cameras, but there are {count} views")
    return down, across, parser.get("inim", "projection", fallback="") == "parallel"


def _read_view(path: Path) -> NDArray[np.uint8]:
    with open_picture(path, ("PNG",), 1) as picture:
        return np.asarray(picture.convert("RGB"))


def _disparity(folder: Path, views: np.ndarray) -> NDArray[np.float32] | None:
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


def _check_rows(display: Display) -> None:
    if not display.is_separable:
        raise UsageError(
            f"display {display.name}: with {display.not_separable_by} its lenses stand in no rows "
            "and columns, so it has no grid of views; export for a square, aligned array"
        )


def _lattice(display: Display, axis: int) -> np.ndarray:
    """Middles of the elemental images, columns (0) left to right or rows (1) top to bottom."""
    if axis == 0:
        n, cell, shift = (
            display.lens_columns,
            display.elemental_image_pitch_mm,
            display.shift_x_mm,
        )
        return (np.arange(n) - (n - 1) / 2) * cell + shift
    n, cell, shift = display.lens_rows, display.elemental_row_pitch_mm, display.shift_y_mm
    return ((n - 1) / 2 - np.arange(n)) * cell + shift


def _place(
    axis: PixelAxis, lattice: np.ndarray, pixels: int, per_lens: float
) -> tuple[np.ndarray, np.ndarray]:
    """Per panel pixel: its lens's place in a view, in view pixels, and its own under the lens."""
    lens = np.clip(axis.lens, 0, len(lattice) - 1)
    return (lens + 0.5 - len(lattice) / 2) * per_lens + pixels / 2, axis.position_mm - lattice[lens]


def _pixels_of_views(display: Display, down: int, across: int) -> tuple[np.ndarray, np.ndarray]:
    """Panel rows, (view rows, lens rows), and columns, (view columns, lens columns)."""
    cell_x, cell_y = display.elemental_image_pitch_mm, display.elemental_row_pitch_mm
    aside = (0.5 - (np.arange(across) + 0.5) / across) * cell_x
    above = ((np.arange(down) + 0.5) / down - 0.5) * cell_y
    return (
        _nearest(display.rows, _lattice(display, 1), above),
        _nearest(display.columns, _lattice(display, 0), aside),
    )


def _nearest(axis: PixelAxis, lattice: np.ndarray, aside: np.ndarray) -> np.ndarray:
    """Index of the pixel nearest to each place under each lens, of those the lens owns."""
    found = np.empty((len(aside), len(lattice)), np.int64)
    for lens, middle in enumerate(lattice):
        own = np.flatnonzero(axis.lens == lens)
        if not own.size:
            raise UsageError(f"lens {lens} has no pixel of the panel; enlarge the panel")
        places = axis.position_mm[own]
        found[:, lens] = own[np.abs(places[None, :] - middle - aside[:, None]).argmin(axis=1)]
    return found
