"""Pictures of 200 x 200 pixels, all covered but one, with their ground truth.

Relics stand in front of a textured wall. The photograph and the waves have no scene: the exact
first hits of the picture, and the picture warped to the eye, take the place of the ground truth.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from inim.apps.own_picture.picture import CameraPicture
from inim.display import DISPLAYS, Display, Viewpoint
from inim.display.viewpoint import parse_viewpoints
from inim.generators import generate, warp_to_viewpoint
from inim.image.noisy_image import NoisyImage
from inim.image.rgbd import RGBD
from inim.pipeline.stages.capture import CapturedInput
from inim.pipeline.timing import linear_picture
from inim.render.scene_files.two_spheres import two_spheres, two_spheres_eia, two_spheres_view
from reports.bench.study import square_display
from reports.study import ROOT

#: 64 x 64 lenses of 17 x 17 pixels: near the paper's 68 x 68 on 1080 x 1080 pixels.
DISPLAY = DISPLAYS["nominal"]
#: Picture pixels per lens pitch: 200 x 200 pixels for `DISPLAY`.
PIXELS_PER_PITCH = 2.5
VIEW_PIXELS_PER_LENS = 4
SCENES, RELICS = ("jade", "tripod"), ("Athena", "Hermes")
PHOTOGRAPH, WAVES, EMPTY = "photograph", "waves", "two spheres"
#: Covered pictures, and a mostly empty one for contrast.
COVERED = (PHOTOGRAPH, *RELICS, *SCENES, WAVES)
# Samples per pixel of the picture, of the ground-truth EIA and of the ground-truth view.
_CAPTURE_SPP, _EIA_SPP, _VIEW_SPP = 64, 16, 128
# Share of the array that a relic fills; distance of the wall behind it, and clearance of the wall
# from z_min, in depth ranges.
_SHARE, _WALL, _MARGIN = 0.85, 0.15, 0.01


class Input(NamedTuple):
    """A picture and its ground truth, in linear RGB."""

    rgbd: RGBD
    parts: tuple[RGBD, ...]  #: Replicates of its colours; none without noise.
    eia: np.ndarray
    view: NoisyImage  #: From the middle.


def files_of(name: str, data: Path) -> list[Path]:
    """Files of an input; those of relics and of the photograph are below the folder `data`."""
    if name in SCENES:
        return [ROOT / "scenes" / f"{name}.xml"]
    if name in RELICS:
        return [data / "relics" / f"{name}.ply"]
    kinds = ("color.jpg", "depth.png") if name == PHOTOGRAPH else ()
    return [data / "rgbd" / f"redwood_00000.{kind}" for kind in kinds]


def read_input(name: str, files: Sequence[Path]) -> Input:
    """Read or render an input; see `COVERED` and `EMPTY`."""
    (eye,) = parse_viewpoints("centre", DISPLAY)
    if name in RELICS + SCENES:
        return _render(files[0], eye)
    if name == EMPTY:
        truth = two_spheres_view(DISPLAY, eye, VIEW_PIXELS_PER_LENS)
        rgbd, eia = spheres(DISPLAY, PIXELS_PER_PITCH), two_spheres_eia(DISPLAY)
    else:
        rgbd = _photograph(*files) if files else waves(DISPLAY, PIXELS_PER_PITCH)
        truth, _ = warp_to_viewpoint(rgbd, DISPLAY, eye, VIEW_PIXELS_PER_LENS)
        eia = generate(rgbd, DISPLAY, "template")
    return Input(rgbd, (), eia, NoisyImage.from_image(truth))


def spheres(display: Display, pixels_per_pitch: float) -> RGBD:
    """Two spheres without a background, which cover a few per cent of the picture."""
    shape = display.capture_shape(pixels_per_pitch)
    rgbd = two_spheres(display, shape, display.capture_pixel_mm(pixels_per_pitch))
    return replace(rgbd, color=linear_picture(rgbd.color))


def waves(display: Display, pixels_per_pitch: float) -> RGBD:
    """Waves of depth and colour that cover the picture, of any size."""
    shape, (low, high) = display.capture_shape(pixels_per_pitch), display.depth_range_mm
    y, x = np.meshgrid(*((np.arange(n) + 0.5) / n for n in shape), indexing="ij")
    height = (
        0.5 + 0.3 * np.cos(9 * x + 4 * y) * np.sin(7 * y) + 0.15 * np.cos(31 * x) * np.cos(23 * y)
    )
    depth = (low + (high - low) * height).astype(np.float32)
    colours = [0.5 + 0.4 * np.cos(60 * x + k) * np.cos(47 * y - k) for k in range(3)]
    color = np.stack(colours, axis=-1).astype(np.float32)
    pixel_mm = display.capture_pixel_mm(pixels_per_pitch)
    return RGBD(color, depth, np.ones(shape, bool), pixel_mm)


def _photograph(color: Path, depth: Path) -> RGBD:
    """Fit a photograph with depth, as orthographic, to the whole picture."""
    files = CameraPicture(
        color=color, depth=depth, depth_unit="mm", orthographic=True, missing="0",
        missing_depth="behind",
    )  # fmt: skip
    # A fit fills the array, and the picture reaches beyond it: fit it to a larger array.
    larger = square_display(3 * DISPLAY.lens_rows // 2)
    fit, _ = files.fit_to(files.read(), larger, PIXELS_PER_PITCH)
    rgbd, shape = fit.rgbd, DISPLAY.capture_shape(PIXELS_PER_PITCH)
    part = tuple(slice((n - m) // 2, (n + m) // 2) for n, m in zip(rgbd.shape, shape, strict=True))
    return RGBD(rgbd.color[part], rgbd.depth_mm[part], rgbd.covered[part], rgbd.pixel_mm)


def _render(path: Path, eye: Viewpoint) -> Input:
    from inim.render.ground_truth import capture_parts, pickup, true_view

    with tempfile.TemporaryDirectory() as folder:
        fitted = _before_a_wall(path, Path(folder))
        parts = capture_parts(
            fitted, DISPLAY, pixels_per_pitch=PIXELS_PER_PITCH, spp=_CAPTURE_SPP, seed=1
        )
        eia = pickup(fitted, DISPLAY.through_pinholes(), spp=_EIA_SPP, seed=2).image
        view, _ = true_view(
            fitted, DISPLAY, eye, pixels_per_lens=VIEW_PIXELS_PER_LENS, spp=_VIEW_SPP, seed=3
        )
    return Input(CapturedInput.of(parts).rgbd, parts, eia, view)


def _before_a_wall(path: Path, folder: Path) -> Any:
    """Open a scene with a textured wall behind its relic; both fill the depth range together."""
    from inim.render.scene import open_scene
    from inim.render.scene_files.file import read_scene_file
    from inim.render.scene_files.new_scene import new_scene

    if path.suffix != ".xml":
        path = new_scene(path, folder / "relic.xml", unit="any", up="y")
    alone = open_scene(read_scene_file(path), DISPLAY, _SHARE)
    relic = alone.fit
    names_of_shapes = [s.id() for s in alone.scene.shapes() if not s.is_emitter()]
    low, high = DISPLAY.depth_range_mm
    wall, bottom = low - _WALL * (high - low), low + _MARGIN * (high - low)
    place = np.diag([2 * DISPLAY.width_mm, 2 * DISPLAY.height_mm, 1, 1])
    place[2, 3] = wall
    names = f'value="{path.parent}/'
    text = re.sub(r'value="(?=meshes/|textures/)', names, path.read_text("utf-8"))
    numbers = " ".join(f"{value:.9g}" for value in (relic.world_from_display @ place).ravel())
    rectangle = f"""<shape type="rectangle" id="wall">
        <transform name="to_world"><matrix value="{numbers}"/></transform>
        <bsdf type="diffuse"><texture type="bitmap" name="reflectance">
            <string name="filename" value="{ROOT}/scenes/textures/wood.png"/>
            <transform name="to_uv"><scale x="8" y="8"/></transform>
        </texture></bsdf>
    </shape></scene>"""
    walled = folder / "walled.xml"
    walled.write_text(text.replace("</scene>", rectangle), "utf-8")
    allowed = (path.parent, ROOT / "scenes")
    shapes = ",".join([*names_of_shapes, "wall"])  # or it would be left out as surroundings
    opened = open_scene(read_scene_file(walled, allowed=allowed), DISPLAY, _SHARE, relic=shapes)
    squeeze = np.eye(4)
    squeeze[2, 2] = (high - bottom) / (high - wall)
    squeeze[2, 3] = bottom - wall * squeeze[2, 2]
    forward, back = squeeze @ relic.display_from_world, np.linalg.inv(squeeze)
    back, scale_z = relic.world_from_display @ back, relic.scale_z * squeeze[2, 2]
    fit = replace(relic, display_from_world=forward, world_from_display=back, scale_z=scale_z)
    return replace(opened, fit=fit)
