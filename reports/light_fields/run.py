"""What one picture of a light field tells of all its other views, by method and kind of error.

    python -m reports.light_fields.run FOLDER ... -o reports/light_fields

Each folder is a light field of the 4D Light Field Benchmark (Honauer et al., ACCV 2016) or one
stored as that does: views ``input_CamNNN.png`` of a square grid, numbered row by row, of which some
may be missing but not the middle one, and one ``.pfm`` with the middle view's disparity, in pixels
to the next view, positive where nearer. A disparity of fewer pixels is one whose rim was left out:
it is carried on to the rim. The benchmark is free for research, CC BY-NC-SA 4.0, and stays with
whoever runs this; what is committed are figures.

The middle view and its disparity become a picture, a light field's grid a display: a lens for each
picture pixel, a panel pixel for each direction, so that a method's EIA is the light field, and its
sub-aperture views are compared with the true ones: PSNR of 8-bit sRGB, over all of them but the
middle one. The naive rival moves each pixel to its place in each view, the nearest on top, and
fills what stays empty from the nearest pixel.
"""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import distance_transform_edt

import inim
from inim.color import linear_from_srgb, srgb_from_linear, srgb_to_uint8
from inim.files.image import write_atomically
from inim.files.light_field import sub_aperture_views
from inim.files.picture import read_pfm
from inim.generators import HOLE, prepare
from inim.generators.raycast.fill import Filled
from inim.rgbd import RGBD

__all__ = ["METHODS", "MiddleView", "measure", "read", "splat", "table"]

#: What is compared, beside the naive rival and holes filled from the nearest pixel of their view.
METHODS = (
    "template:columns=solid",
    "template:columns=solid:samples=4",
    "template",
    "template:samples=4",
    "template:fill=hidden",
    "template:samples=4:fill=hidden",
)
_FILLED = "template:fill=hidden"
_NEAREST = "template, its holes from the nearest pixel"
_SIDE = 9
_VIEW = re.compile(r"input_Cam(\d+)\.png")


@dataclass(frozen=True)
class MiddleView:
    """A light field, and its middle view as a picture for a display.

    Attributes
    ----------
    name : str
    views : {(row, column): (H, W, 3) uint8}
        All but the middle one.
    disparity_file : str
    rgbd : RGBD
    display : Display
    """

    name: str
    views: dict[tuple[int, int], np.ndarray]
    disparity_file: str
    rgbd: RGBD
    display: inim.Display

    @property
    def disparity(self) -> np.ndarray:
        """Pixels to the next view, (H, W)."""
        return self.rgbd.depth_mm / np.float32(_SIDE**2)

    def of_eia(self, eia: np.ndarray) -> Iterator[tuple[tuple[int, int], np.ndarray]]:
        """Each view's place, and what an EIA shows there."""
        made = sub_aperture_views(eia, self.display)
        return ((place, made[place]) for place in self.views)


def read(folder: Path) -> MiddleView:
    """Read a light field; see the module."""
    from PIL import Image

    views = {}
    for path in sorted(folder.iterdir()):
        if found := _VIEW.fullmatch(path.name):
            views[divmod(int(found[1]), _SIDE)] = np.asarray(Image.open(path).convert("RGB"))
    middle = views.pop((_SIDE // 2, _SIDE // 2))
    (file,) = folder.glob("*.pfm")
    disparity = read_pfm(file)
    rim = [((n - m) // 2,) * 2 for n, m in zip(middle.shape, disparity.shape, strict=False)]
    disparity = np.pad(disparity, rim, mode="edge")
    rows, columns = disparity.shape
    # One lens a pixel; z = 81 d of disparity d moves by d pixels from view to view.
    depth = np.float32(_SIDE**2) * disparity
    display = inim.Display(
        pitch_mm=1.0,
        focal_length_mm=_SIDE - 0.1,
        gap_mm=float(_SIDE),
        pixel_pitch_mm=1 / _SIDE,
        lens_columns=columns,
        lens_rows=rows,
        depth_min_mm=float(depth.min()) - 5,
        depth_max_mm=float(depth.max()) + 1,
    )
    color = linear_from_srgb(middle.astype(np.float32) / 255)
    rgbd = RGBD(color, depth, np.ones(depth.shape, bool), 1.0)
    return MiddleView(folder.name, views, file.name, rgbd, display)


def splat(field: MiddleView) -> Iterator[tuple[tuple[int, int], np.ndarray]]:
    """The naive rival's views, (H, W, 3) uint8."""
    order = np.argsort(field.disparity, axis=None, kind="stable")
    rows, columns = np.divmod(order, field.rgbd.shape[1])
    moved = field.disparity.ravel()[order]
    color = _codes(field.rgbd.color).reshape(-1, 3)[order]
    for row, column in field.views:
        y = np.rint(rows - moved * (row - _SIDE // 2)).astype(int)
        x = np.rint(columns - moved * (column - _SIDE // 2)).astype(int)
        inside = (y >= 0) & (y < field.rgbd.shape[0]) & (x >= 0) & (x < field.rgbd.shape[1])
        view = np.zeros((*field.rgbd.shape, 3), np.uint8)
        empty = np.ones(field.rgbd.shape, bool)
        view[y[inside], x[inside]] = color[inside]  # the last, nearest one stays
        empty[y[inside], x[inside]] = False
        yield (row, column), view[_nearest(empty)]


def _nearest(empty: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the nearest pixel that is not empty."""
    rows, columns = distance_transform_edt(empty, return_distances=False, return_indices=True)
    return rows, columns


def _codes(linear: np.ndarray) -> np.ndarray:
    return srgb_to_uint8(srgb_from_linear(linear))


def _left(field: MiddleView) -> np.ndarray:
    """Sources of the panel, with the holes that a fill is given."""
    rgbd = field.rgbd
    made = prepare(field.display, _FILLED, shape=rgbd.shape, pixel_mm=rgbd.pixel_mm)
    assert isinstance(made, Filled)
    cells: np.ndarray = made.left.sources(rgbd)
    return cells


class _Errors:
    """Squared errors of all views, by kind of pixel."""

    def __init__(self, field: MiddleView) -> None:
        self._field = field
        holes = sub_aperture_views(_left(field), field.display)
        self.kinds = {place: _kinds(field, place, holes[place] == HOLE) for place in field.views}
        counts = [np.bincount(k.ravel(), minlength=len(_KINDS)) for k in self.kinds.values()]
        self.pixels = np.sum(counts, axis=0)

    def of(self, views: Iterator[tuple[tuple[int, int], np.ndarray]]) -> dict[str, Any]:
        """PSNR over all views, and each kind's share of the squared error."""
        squared = np.zeros(len(_KINDS))
        for place, view in views:
            far = view.astype(np.float32) - self._field.views[place]
            squared += np.bincount(
                self.kinds[place].ravel(), (far**2).mean(axis=-1).ravel(), len(_KINDS)
            )
        mean = squared.sum() / self.pixels.sum()
        shares = squared / squared.sum()
        return {
            "psnr_db": float(10 * np.log10(255**2 / mean)),
            "error_share": dict(zip(_KINDS, map(float, shares), strict=True)),
        }


_KINDS = ("shown", "uncovered", "beyond_edge")


def _kinds(field: MiddleView, place: tuple[int, int], holes: np.ndarray) -> np.ndarray:
    """Index of each pixel's kind: a hole is beyond the edge if its ray leaves the picture."""
    rows, columns = np.indices(holes.shape)
    leaves = np.zeros(holes.shape, bool)
    for disparity in (field.disparity.min(), field.disparity.max()):
        row = rows + disparity * (place[0] - _SIDE // 2)
        column = columns + disparity * (place[1] - _SIDE // 2)
        leaves |= (row < 0) | (row > holes.shape[0] - 1)
        leaves |= (column < 0) | (column > holes.shape[1] - 1)
    kinds: np.ndarray = holes * (1 + (holes & leaves))
    return kinds


def measure(field: MiddleView) -> dict[str, Any]:
    """Score every method on a light field."""
    errors = _Errors(field)
    methods = {"splat": errors.of(splat(field))}
    for name in METHODS:
        eia = inim.generate(field.rgbd, field.display, name)
        methods[name] = errors.of((p, _codes(v)) for p, v in field.of_eia(eia))
    methods[_NEAREST] = errors.of(_nearest_fill(field))
    return {
        "name": field.name,
        "views": len(field.views),
        "disparity": field.disparity_file,
        "disparity_range_px": [float(field.disparity.min()), float(field.disparity.max())],
        "pixel_share": dict(
            zip(_KINDS, (errors.pixels / errors.pixels.sum()).tolist(), strict=True)
        ),
        "methods": methods,
    }


def _nearest_fill(field: MiddleView) -> Iterator[tuple[tuple[int, int], np.ndarray]]:
    """Columns that end, each hole from the nearest pixel of its own view, whatever that shows."""
    palette = _codes(field.rgbd.color).reshape(-1, 3)
    for place, view in field.of_eia(_left(field)):
        yield place, palette[view[_nearest(view == HOLE)]]


def table(results: list[dict[str, Any]]) -> str:
    """The results in Markdown."""
    names = [r["name"] for r in results]
    lines = [
        "# Light fields from their middle view",
        "",
        "PSNR in dB over all other views; in brackets above the naive splat. Made by",
        "`python -m reports.light_fields.run FOLDER ... -o reports/light_fields`, whose docstring",
        "says what a folder holds.",
        "",
        f"| method | {' | '.join(names)} |",
        f"| --- |{' --: |' * len(names)}",
    ]
    for method in results[0]["methods"]:
        scores = [r["methods"][method]["psnr_db"] for r in results]
        naive = [r["methods"]["splat"]["psnr_db"] for r in results]
        cells = [
            f"{score:.2f}" + ("" if method == "splat" else f" ({score - than:+.2f})")
            for score, than in zip(scores, naive, strict=True)
        ]
        label = "splat, nearest" if method == "splat" else f"`{method}`"
        lines.append(f"| {label} | {' | '.join(cells)} |")
    lines += [
        "",
        "Where the error is: share of the pixels, and of each method's squared error.",
        "",
    ]
    lines += [f"| kind of pixel | {' | '.join(names)} |", f"| --- |{' --: |' * len(names)}"]
    words = ("shown", "uncovered, a hole", "beyond the picture's edge, a hole")
    best = METHODS[-1]
    for kind, word in zip(_KINDS, words, strict=True):
        share = [f"{r['pixel_share'][kind]:.2%}" for r in results]
        lines.append(f"| {word}: pixels | {' | '.join(share)} |")
        for method in ("splat", _NEAREST, best):
            share = [f"{r['methods'][method]['error_share'][kind]:.1%}" for r in results]
            lines.append(f"| {word}: error, `{method}` | {' | '.join(share)} |")
    lines += ["", "| light field | views compared | disparity | its range, pixels |"]
    lines += ["| --- | --: | --- | --- |"]
    for r in results:
        low, high = r["disparity_range_px"]
        lines.append(f"| {r['name']} | {r['views']} | {r['disparity']} | {low:.2f} to {high:.2f} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folders", nargs="+", type=Path, help="light fields")
    parser.add_argument("-o", "--out", type=Path, default=Path("reports/light_fields"))
    args = parser.parse_args()
    results = []
    for folder in args.folders:
        results.append(measure(read(folder)))
        for name, scored in results[-1]["methods"].items():
            print(f"{folder.name:12} {name:50} {scored['psnr_db']:.2f} dB", flush=True)
    data = {"inim_version": inim.__version__, "light_fields": results}
    args.out.mkdir(parents=True, exist_ok=True)
    text = json.dumps(data, indent=1) + "\n"
    write_atomically(args.out / "light_fields.json", lambda p: p.write_text(text, "utf-8"))
    write_atomically(args.out / "light_fields.md", lambda p: p.write_text(table(results), "utf-8"))


if __name__ == "__main__":
    main()
