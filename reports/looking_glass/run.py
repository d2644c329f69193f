"""Compare rays per sub-pixel with quilts of views on simulated Looking Glass panels.

    python -m reports.looking_glass.run scenes/amphora.xml SCENE.xml ... -o reports/looking_glass
    python -m reports.looking_glass.run scenes/amphora.xml --picture docs/images/looking-glass.webp

Each scene is validated on a Portrait and on a 16-inch panel of the third generation. From the RGB-D
picture of the validation follow native pictures: with a ray for each sub-pixel (`template`), and
with the rays of quilts, which leave each view's eye and are as many as the views. Tiles are taken
as infinitely fine, or as fine as those of published quilts (nearest pixel). All are seen through
thick cylinders from five eyes across the viewing zone and scored against the scene.

For the first scene, native pictures for both readings of CellPatternMode 2 are also seen on panels
of either reading.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Mapping
from fractions import Fraction
from pathlib import Path
from statistics import fmean
from typing import Any, NamedTuple

import numpy as np
from PIL import Image

import inim
from inim.apps.export.native import Quilt, subpixel_views, weave
from inim.apps.inspect.geometry import view_shares
from inim.display import DISPLAYS, Display
from inim.display.parameters import CellPattern
from inim.display.pixels import SUBPIXELS, PixelOffset, ray_starts
from inim.display.viewpoint import default_distance_mm, zone_eyes, zone_half_mm
from inim.generators.raycast.cells import PictureRays, RayBlock
from inim.generators.raycast.ray_by_ray import RayByRay
from inim.image.color import srgb_from_linear, to_srgb
from inim.image.files.eia_file import write_eia
from inim.image.files.image import read_rgbd
from inim.image.rgbd import RGBD
from inim.pipeline.scene_capture import generate_from_scene
from inim.report import Report

PORTRAIT, SIXTEEN = "looking-glass-portrait-typical", "looking-glass-16-typical"
#: Tiles across and down, and pixels of each, of quilts for the panel (`inim export --quilt`).
TILES = {PORTRAIT: ((8, 6), (420, 560)), SIXTEEN: ((5, 9), (819, 455))}
#: Numbers of views of quilts with infinitely fine tiles.
VIEWS = (45, 100)
#: Places of the eyes, in shares of the half width of the viewing zone.
EYES = {"centre": 0.0, "a": -0.75, "b": -0.4, "c": 0.4, "d": 0.75}
#: Readings of CellPatternMode 2 by two sources of the vendor.
READINGS: tuple[CellPattern, ...] = ("columns", "rows-of-4")
# Size of a panel pixel in the picture, in pixels.
_ENLARGED = 6
DIRECT, NEAREST = "rays-per-sub-pixel", "rays-nearest-colour"


class QuiltRays(RayByRay):
    """First hits of the rays from the eyes of a quilt's views, through the sub-pixels of a colour.

    * `views`: their number; `tile`: width and height of a view in pixels, None: infinitely fine.
    """

    views = 45
    tile: tuple[int, int] | None = None
    channel = 0

    @property
    def _rays(self) -> list[PictureRays]:
        outer = self

        class Rays(PictureRays):
            def block(self, rows: slice, *_: slice, in_cells: bool = False) -> RayBlock:  # noqa: ARG002
                return outer.block(rows)

        return [Rays(self.display, self.shape, self.pixel_mm, self.offsets[0])]

    def _columns_in_reach(self, above: np.ndarray) -> Callable[[slice], slice]:  # noqa: ARG002
        """All columns: a tile's ray may start far from the pixel that shows it."""
        columns = slice(0, self.display.eia_shape[1])
        return lambda _: columns

    def block(self, rows: slice) -> RayBlock:
        """Rays of some panel rows over the picture; see `RayBlock`."""
        display, (height, width), pixel_mm = self.display, self.shape, self.pixel_mm
        eyes, distance = zone_eyes(display, self.views), default_distance_mm(display)
        eye_x = np.array([eye.x_mm for eye in eyes])
        view = (subpixel_views(display, rows)[..., self.channel] * self.views).astype(np.int64)
        eye = eye_x[np.minimum(view, self.views - 1)]
        # A tile is read where the sub-pixel's pixel is.
        x, y, _, _ = ray_starts(display, rows, PixelOffset(Fraction(0), Fraction(0)))
        if self.tile is not None:
            sizes = display.width_mm / self.tile[0], display.height_mm / self.tile[1]
            x, y = (
                (np.floor(place / size) + 0.5) * size
                for place, size in zip((x, y), sizes, strict=True)
            )
        slope_x, slope_y = (eye - x) / distance, -y / distance
        lines = (
            x / pixel_mm + width / 2, slope_x / pixel_mm,
            height / 2 - y / pixel_mm, -slope_y / pixel_mm,
        )  # fmt: skip
        shape = eye.shape
        u0, du, v0, dv = (np.broadcast_to(line, shape) for line in lines)
        return RayBlock(u0, du, v0, dv, 1.0, 1.0)


def quilt_picture(
    rgbd: RGBD, display: Display, views: int, tile: tuple[int, int] | None
) -> np.ndarray:
    """Native picture of a quilt of an RGB-D picture, (rows, columns, 3) float32, linear RGB."""
    picture = np.zeros((*display.eia_shape, 3), np.float32)
    for channel, area in enumerate(SUBPIXELS[display.subpixels]):
        offset = PixelOffset(Fraction(0), area.right, area.channel)
        rays = QuiltRays(display, rgbd.shape, rgbd.pixel_mm, "surface", (offset,))
        rays.views, rays.tile, rays.channel = views, tile, channel
        sources = rays.rays()[0].sources(rgbd)
        colours = rgbd.color[..., channel].reshape(-1)
        picture[..., channel] = np.where(sources >= 0, colours[np.maximum(sources, 0)], 0)
    return picture


class Scores(NamedTuple):
    """Mean scores of the views of a native picture against the scene."""

    psnr_db: float
    ssim_on_relic: float


def mean_scores(views: Mapping[str, Mapping[str, float | None]]) -> Scores:
    """Mean over the eyes."""
    return Scores(
        *(
            fmean(float(view[key] or 0) for view in views.values())
            for key in ("psnr_db", "ssim_on_relic")
        )
    )


def viewpoints(display: Display) -> str:
    """The eyes as text."""
    half = zone_half_mm(display, default_distance_mm(display))[0]
    return ", ".join(f"{name}={share * half:.4f} 0" for name, share in EYES.items())


def score_scene(scene: Path, preset: str, work: Path) -> dict[str, Any]:
    """Scores of all native pictures of a scene on a display, and run times."""
    display = DISPLAYS[preset]
    common: dict[str, Any] = {"display": preset, "viewpoints": viewpoints(display), "lazy": True}
    folder = work / f"{scene.stem}-{preset}"
    if not (folder / "report.json").is_file():
        inim.validate(scene, folder, algorithms="template:samples=1", **common)
    rgbd = read_rgbd(folder / "rgbd.exr")
    (columns, rows), tile = TILES[preset]
    pictures, seconds = {}, {}
    started = time.process_time()
    pictures[DIRECT] = inim.generate(rgbd, display, "template:samples=1")
    seconds[DIRECT] = time.process_time() - started
    pictures[NEAREST] = inim.generate(rgbd, display, "template:samples=1:colour=nearest")
    for views in VIEWS:
        pictures[f"quilt-{views}"] = quilt_picture(rgbd, display, views, None)
    name = f"quilt-{columns * rows}-tiles"
    pictures[name] = quilt_picture(rgbd, display, columns * rows, tile)
    codes = np.zeros((rows * tile[1], columns * tile[0], 3), np.uint8)
    started = time.process_time()
    weave(Quilt(codes, columns, rows, display.width_mm / display.height_mm), display)
    seconds["weaving"] = time.process_time() - started
    files = {}
    for label, picture in pictures.items():
        files[label] = folder / f"{label}.exr"
        write_eia(files[label], picture, None, display.pixel_pitch_mm)
    scored = work / f"{scene.stem}-{preset}-scored"
    if (scored / "report.json").is_file():
        report = Report.load(scored)
    else:
        report = inim.validate(scene, scored, algorithms="none", eias=files, **common)
    scores = {n: mean_scores(r.views)._asdict() for n, r in report.data.algorithms.items()}
    scores["reference"] = mean_scores(report.data.reference.views)._asdict()
    whole = Report.load(folder).data.algorithms["template:samples=1"].views
    assert abs(mean_scores(whole).psnr_db - scores[DIRECT]["psnr_db"]) < 0.5
    return {"relic": scene.stem, "display": preset, "scores": scores, "cpu_seconds": seconds}


def crosstalk(preset: str) -> list[dict[str, Any]]:
    """Light from the eye's own view, its neighbours and farther ones, by number of views."""
    display = DISPLAYS[preset]
    distance = default_distance_mm(display)
    half = zone_half_mm(display, distance)[0]
    rows = []
    for views in (display.layout.directions[0], *VIEWS):
        for name in ("centre", "d"):
            eye = (EYES[name] * half, 0.0, distance)
            shares = view_shares(display, display, "thick", eye, views)
            rows.append({"display": preset, "views": views, "eye": name, "shares": shares})
    return rows


def disputed_cells(scene: Path, work: Path) -> list[dict[str, Any]]:
    """Native pictures for one reading of the cells, on panels of either: PSNR and colour at edges.

    Colours differ from those of the same picture's view on its own panel: mean distance of the
    differences red - green and blue - green, sRGB codes, over the relic's edges.
    """
    design = DISPLAYS[SIXTEEN]
    rgbd = read_rgbd(work / f"{scene.stem}-{SIXTEEN}" / "rgbd.exr")
    half = zone_half_mm(design, default_distance_mm(design))[0]
    panels = {reading: design.replace(cell_pattern=reading) for reading in READINGS}
    pictures = {r: inim.generate(rgbd, panel, "template:samples=1") for r, panel in panels.items()}
    rows = []
    for made_for in READINGS:
        for shown_on in READINGS:
            errors, colours = [], []
            for share in EYES.values():
                eye = f"eye={share * half} 0"
                own, view = (
                    inim.reconstruct(pictures[p], panels[q], eye, pixels_per_lens=1)
                    for p, q in ((shown_on, shown_on), (made_for, shown_on))
                )
                a, b = (255 * srgb_from_linear(np.clip(v, 0, 1)) for v in (own, view))
                step = np.abs(np.diff(a.mean(axis=-1), axis=1, prepend=0))
                edges = step > np.quantile(step, 0.95)
                errors.append(float(np.mean((a - b) ** 2)))
                difference = (a - b)[edges]
                colours.append(float(np.abs(difference[:, ::2] - difference[:, 1:2]).mean()))
            mse = fmean(errors)
            rows.append({
                "made_for": made_for, "shown_on": shown_on,
                "psnr_db": float(10 * np.log10(255**2 / mse)) if mse else None,
                "edge_colour_error": fmean(colours),
            })  # fmt: skip
    return rows


def show_picture(scene: Path, out: Path) -> None:
    """Write sub-pixels of a scene's native picture, enlarged, and the views of three eyes."""
    _, display, run = generate_from_scene(scene, PORTRAIT, {}, "template")
    half = zone_half_mm(display, default_distance_mm(display))[0]
    eyes = (f"eye={EYES[name] * half:.4f} 0" for name in ("a", "centre", "d"))
    views = [inim.reconstruct(run.eia, display, eye, pixels_per_lens=1) for eye in eyes]
    middle = tuple(
        slice((n - m // _ENLARGED) // 2, (n + m // _ENLARGED) // 2 + 1)
        for n, m in zip(display.eia_shape, views[0].shape, strict=False)
    )
    enlarged = np.kron(run.eia[middle], np.ones((_ENLARGED, _ENLARGED, 1)))
    rows, columns = views[0].shape[:2]
    codes = to_srgb(np.hstack([enlarged[:rows, :columns], *views]).astype(np.float32))
    Image.fromarray(codes).save(out, quality=90)


def write_page(data: Mapping[str, Any]) -> str:
    """Markdown page of the results."""
    lines = [
        "# Rays per sub-pixel and quilts on a Looking Glass",
        "",
        "Made by `python -m reports.looking_glass.run SCENE.xml ... -o reports/looking_glass`.",
        "",
        "Views through thick cylinders from five eyes across the viewing zone, against the scene:",
        "mean PSNR of whole views in dB, and SSIM on the relic in brackets. A quilt's tiles are",
        "infinitely fine, or as fine as published ones (`-tiles`). `reference` is traced from the",
        "scene, with several samples of each sub-pixel; the others follow from one RGB-D picture.",
        "Quilts and `rays-nearest-colour` show its nearest pixel; `rays-per-sub-pixel` averages.",
        "",
    ]
    for preset in (PORTRAIT, SIXTEEN):
        rows = [row for row in data["rows"] if row["display"] == preset]
        names = list(rows[0]["scores"])
        lines += [
            f"## {preset}",
            "",
            f"| relic | {' | '.join(names)} | gain over 45 views |",
            f"| --- |{' --: |' * (len(names) + 1)}",
        ]
        for row in rows:
            scores = row["scores"]
            cells = [
                f"{scores[n]['psnr_db']:.2f} ({scores[n]['ssim_on_relic']:.3f})" for n in names
            ]
            gain = scores[DIRECT]["psnr_db"] - scores["quilt-45"]["psnr_db"]
            lines.append(f"| {row['relic']} | {' | '.join(cells)} | {gain:+.2f} dB |")
        seconds = [row["cpu_seconds"] for row in rows]
        direct, weaving = (fmean(s[key] for s in seconds) for key in (DIRECT, "weaving"))
        lines += [
            "",
            f"One ray for each sub-pixel takes {direct:.1f} processor seconds, without the start",
            f"of the program; weaving a finished quilt takes {weaving:.1f}.",
            "",
        ]
    lines += [
        "## Crosstalk of views",
        "",
        "Light at an eye from its own view, from the two next to it, from the two beyond them, and",
        "from all others, per cent. The first number of views is that of sub-pixels under a lens.",
        "",
        "| display | views | eye | own | next | beyond | others |",
        "| --- | --: | --- | --: | --: | --: | --: |",
    ]
    for row in data["crosstalk"]:
        shares = " | ".join(f"{100 * share:.1f}" for share in row["shares"])
        lines.append(f"| {row['display']} | {row['views']:.1f} | {row['eye']} | {shares} |")
    lines += [
        "",
        "## Disputed cells",
        "",
        "CellPatternMode 2 has two readings. Native pictures for one, on panels of either, against",
        "the right picture on the same panel: PSNR of whole views, and the error of colours at",
        "edges (differences red - green and blue - green, sRGB codes).",
        "",
        "| picture for | panel | PSNR, dB | colours at edges |",
        "| --- | --- | --: | --: |",
    ]
    for row in data["cells"]:
        psnr = "equal" if row["psnr_db"] is None else f"{row['psnr_db']:.1f}"
        lines.append(
            f"| {row['made_for']} | {row['shown_on']} | {psnr} | {row['edge_colour_error']:.1f} |"
        )
    return "\n".join(lines) + "\n"


def main() -> None:
    """Score the scenes and write the page and its data."""
    parser = argparse.ArgumentParser(prog="python -m reports.looking_glass.run")
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("-o", "--out", type=Path, default=Path("reports/looking_glass"))
    parser.add_argument("--work", type=Path, default=Path("out/looking_glass"))
    parser.add_argument("--picture", type=Path, help="views of the first scene, .webp, and no more")
    args = parser.parse_args()
    if args.picture is not None:
        show_picture(args.scenes[0], args.picture)
        return
    data = {
        "rows": [score_scene(s, preset, args.work) for preset in TILES for s in args.scenes],
        "crosstalk": [row for preset in TILES for row in crosstalk(preset)],
        "cells": disputed_cells(args.scenes[0], args.work),
    }
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "looking_glass.json").write_text(json.dumps(data, indent=1) + "\n")
    (args.out / "looking_glass.md").write_text(write_page(data))


if __name__ == "__main__":
    main()
