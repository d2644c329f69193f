"""Light field with true views, and its middle view as a picture for a display.

A folder holds views ``input_CamNNN.png`` of a square grid, numbered row by row from the upper left.
Some may be missing, but not the middle view. One ``.pfm`` file has the middle view's disparity:
pixels to the next view, positive where nearer. This is the format of the 4D Light Field Benchmark
(Honauer et al., ACCV 2016). The side of the grid is ``num_cams_x`` of ``parameters.cfg``; without
that file it is 9, as in the benchmark. A disparity of fewer pixels lacks its rim, which repeats its
border. ``source`` and ``licence`` of the views are in ``source.json``, if it exists.
"""

from __future__ import annotations

import configparser
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import inim
from inim.image.color import linear_from_srgb, srgb_from_linear, srgb_to_uint8
from inim.image.files.light_field import sub_aperture_views
from inim.image.files.picture import read_pfm
from inim.image.rgbd import RGBD

Place = tuple[int, int]
#: Places in the grid, (row, column), and (H, W, 3) uint8 sRGB.
Views = Iterator[tuple[Place, np.ndarray]]

_SIDE = 9
_VIEW = re.compile(r"input_Cam(\d+)\.png")
# Gap between panel and lenses, in lens pitches. It determines the depth of a disparity.
_GAP = 9
# Gap less focal length, times the squared side of the grid: with it, `gu2020` steps by an eighth of
# a pixel of disparity in every light field.
_DEFOCUS_MM = 8.1
# Margins of the depth range at its near and far ends, in pixels of disparity.
_IN_FRONT, _BEHIND = 1 / 81, 5 / 81


@dataclass(frozen=True)
class LightField:
    """True views, and the picture and display for a method."""

    name: str
    side: int  #: Views in a row and in a column.
    views: dict[Place, np.ndarray]  #: True views without the middle view, (H, W, 3) uint8 sRGB.
    rgbd: RGBD  #: The middle view and its depth.
    display: inim.Display  #: A lens for each picture pixel, a panel pixel for each view.
    disparity_file: str = ""
    source: str = ""
    licence: str = ""

    @property
    def disparity(self) -> np.ndarray:
        """Pixels to the next view, (H, W)."""
        return self.rgbd.depth_mm / np.float32(_GAP * self.side)

    @property
    def middle(self) -> np.ndarray:
        """The middle view, (H, W, 3) uint8 sRGB."""
        return codes(self.rgbd.color)

    def offset(self, place: Place) -> Place:
        """Rows and columns from the middle view."""
        return place[0] - self.side // 2, place[1] - self.side // 2

    def ring(self, place: Place) -> int:
        """Distance from the middle view, in views, along the axis where it is larger."""
        return max(map(abs, self.offset(place)))

    def of_eia(self, eia: np.ndarray) -> Iterator[tuple[Place, np.ndarray]]:
        """Places of the views, and the views that an EIA shows there."""
        views = sub_aperture_views(eia, self.display)
        return ((place, views[place]) for place in self.views)


def codes(linear: np.ndarray) -> np.ndarray:
    """Linear light as uint8 sRGB."""
    return srgb_to_uint8(srgb_from_linear(linear))


def of_views(
    name: str, side: int, views: Mapping[Place, np.ndarray], disparity: np.ndarray, **about: str
) -> LightField:
    """Light field of all its views and the disparity of the middle view."""
    others = dict(views)
    middle = others.pop((side // 2, side // 2))
    rows, columns = disparity.shape
    # One lens for each pixel: a point at z = gap side d moves by d pixels from view to view.
    depth_per_pixel = np.float32(_GAP * side)
    depth = depth_per_pixel * disparity
    display = inim.Display(
        pitch_mm=1.0,
        focal_length_mm=_GAP - round(_DEFOCUS_MM / side**2, 4),
        gap_mm=float(_GAP),
        pixel_pitch_mm=1 / side,
        lens_columns=columns,
        lens_rows=rows,
        depth_min_mm=float(depth.min()) - float(_BEHIND * depth_per_pixel),
        depth_max_mm=float(depth.max()) + float(_IN_FRONT * depth_per_pixel),
    )
    color = linear_from_srgb(middle.astype(np.float32) / 255)
    rgbd = RGBD(color, depth, np.ones(depth.shape, bool), 1.0)
    return LightField(name, side, others, rgbd, display, **about)


def read(folder: Path) -> LightField:
    """Light field of a folder; see the module."""
    from PIL import Image

    side = _side(folder)
    views = {}
    for path in sorted(folder.iterdir()):
        if match := _VIEW.fullmatch(path.name):
            views[divmod(int(match[1]), side)] = np.asarray(Image.open(path).convert("RGB"))
    (file,) = folder.glob("*.pfm")
    disparity = read_pfm(file)
    shape = views[(side // 2, side // 2)].shape
    rim = [((n - m) // 2,) * 2 for n, m in zip(shape, disparity.shape, strict=False)]
    padded = np.pad(disparity, rim, mode="edge")
    path = folder / "source.json"
    about = json.loads(path.read_text("utf-8")) if path.is_file() else {}
    return of_views(folder.name, side, views, padded, disparity_file=file.name, **about)


def _side(folder: Path) -> int:
    parameters = configparser.ConfigParser(interpolation=None)
    parameters.read(folder / "parameters.cfg", "utf-8")
    return parameters.getint("extrinsics", "num_cams_x", fallback=_SIDE)
