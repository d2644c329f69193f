"""Pictures without a scene: the stages that take the place of capture and ground truth.

Surfaces that a picture hides are unknown, so there is no ground truth. Its place is taken by what
the picture determines: the picture itself, warped to each viewpoint by its own depth; and the EIA
of its exact first hits, whose views are the reference views. The relic is the area that the warped
picture covers.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import msgspec
import numpy as np

from inim.display import Display, Viewpoint
from inim.display.pixels import exact_ratio
from inim.generators import SourceGenerator, generate, warp_to_viewpoint
from inim.generators.base import (
    MOST_OUTSIDE,
    Sources,
    outside_depth_range,
    outside_depth_text,
)
from inim.generators.oracle import ExactHits, exact_hits, why_no_oracle
from inim.generators.registry import Input
from inim.image.files.image import read_rgbd
from inim.image.noisy_image import NoisyEIA, NoisyImage
from inim.image.rgbd import RGBD
from inim.pipeline.stages.capture import Capture, CapturedInput
from inim.pipeline.stages.generation import GeneratorHandle
from inim.pipeline.stages.method import GeneratorMethod, Method
from inim.pipeline.stages.scoring import MethodResult
from inim.pipeline.stages.stage import GENERATING, Run, stage
from inim.scores.document_parts import check
from inim.system.errors import FileError
from inim.system.process.user_paths import user_text

#: Algorithm whose EIA shows exactly the picture's surface: the best result without a ground truth.
EXACT = "template"
#: A warning is given if more than this share of a picture is clipped or of the array is empty.
MAX_LOST_SHARE = 0.5


@dataclass(frozen=True)
class PictureFile:
    """A file of `inim.image.files.image.write_rgbd` and its picture.

    It has the digest of the picture, no settings and no parameters; see
    `inim.render.scene_files.file.SceneFile`.
    """

    path: Path
    rgbd: RGBD
    sha256: str
    settings: ClassVar[dict[str, str]] = {}
    parameters: ClassVar[dict[str, str]] = {}

    @property
    def elements(self) -> dict[str, str]:
        """The picture in place of a scene's elements."""
        return {"RGB-D picture": self.sha256}

    @property
    def file_names(self) -> dict[str, str]:
        """Name of the file without its folder, by the picture's digest."""
        return {self.sha256: self.path.name}

    @classmethod
    def read(cls, path: Path) -> PictureFile:
        """Read a file; raises `FileError`."""
        rgbd = read_rgbd(path)
        digest = hashlib.sha256(f"{rgbd.shape} {rgbd.pixel_mm} {len(rgbd.layers)}".encode())
        for layer in rgbd.layers:
            for array in (layer.color, layer.front_mm, layer.back_mm, layer.covered):
                digest.update(np.ascontiguousarray(array).data)
        return cls(path, rgbd, digest.hexdigest())


@dataclass(frozen=True)
class FittedPicture:
    """A picture fitted to a display as designed: the place of a `DepthCamera` and its scene."""

    file: PictureFile
    display: Display

    def cache_key(self) -> dict[str, Any]:
        """Return all values that affect the capture."""
        return {"picture": self.file.sha256, "display": self.display.replace(name="")}

    @property
    def rgbd(self) -> RGBD:
        """The picture."""
        return self.file.rgbd

    @property
    def front(self) -> RGBD:
        """The picture's front surface."""
        return RGBD(self.rgbd.color, self.rgbd.depth_mm, self.rgbd.covered, self.rgbd.pixel_mm)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.rgbd.shape

    @property
    def pixel_mm(self) -> float:
        """Side length of a pixel."""
        return self.rgbd.pixel_mm

    @property
    def no_oracle(self) -> str | None:
        """Reason why the exact sources are unknown; None if they are known."""
        return why_no_oracle(self.rgbd, self.display)

    @classmethod
    def of(cls, file: PictureFile, display: Display) -> FittedPicture:
        """The picture on a display, which is turned on its side if only then it has its size."""
        if not _has_size_for(file.rgbd, display) and not display.differs_on_its_side:
            turned = display.turned()
            return cls(file, turned if _has_size_for(file.rgbd, turned) else display)
        return cls(file, display)

    def check(self, name: str) -> None:
        """Raise `FileError` for an empty picture or one of another depth range."""
        if not self.rgbd.covered.any():
            raise FileError(f"{name}: is empty; give a picture with covered pixels")
        if outside_depth_range(self.rgbd, self.display) > MOST_OUTSIDE:
            raise FileError(f"{name}: {outside_depth_text(self.rgbd, self.display)}")

    def warnings(self, name: str) -> tuple[str, ...]:
        """Warn of a picture of another display's size, or with a large empty area."""
        rgbd, display, warnings = self.rgbd, self.display, []
        if not _has_size_for(rgbd, display):
            per_pitch = _pixels_per_pitch(rgbd, display)
            shape = display.capture_shape(per_pitch)
            height, width = (n * display.capture_pixel_mm(per_pitch) for n in shape)
            warnings.append(
                f"{name}: is {rgbd.width_mm:.4g} x {rgbd.height_mm:.4g} mm; a picture for display "
                f"{display.name} is {width:.4g} x {height:.4g} mm: give the picture's display with "
                "--display"
            )
        empty = empty_share(rgbd.covered, display, rgbd.pixel_mm)
        if empty > MAX_LOST_SHARE:
            warnings.append(
                f"{name}: {empty:.1%} of the lens array is empty: fit the picture again with `inim "
                "generate --save-rgbd` and --fit cover, --orthographic or --missing-depth"
            )
        return tuple(warnings)


def _pixels_per_pitch(rgbd: RGBD, display: Display) -> int:
    return max(1, round(exact_ratio(display.pitch_mm / rgbd.pixel_mm)))


def _has_size_for(rgbd: RGBD, display: Display) -> bool:
    """True if a picture has the size of a capture for a display, within one pitch."""
    per_pitch = _pixels_per_pitch(rgbd, display)
    shape = display.capture_shape(per_pitch)
    return all(abs(a - b) <= per_pitch for a, b in zip(rgbd.shape, shape, strict=True))


def empty_share(covered: np.ndarray, display: Display, cell_mm: float) -> float:
    """Share of the lens array without a surface of a fitted picture; `covered` is its coverage."""
    rows, columns = covered.shape
    x = np.abs((np.arange(columns) + 0.5) * cell_mm - columns * cell_mm / 2)
    y = np.abs((np.arange(rows) + 0.5) * cell_mm - rows * cell_mm / 2)
    on_array = np.ix_(y < display.height_mm / 2, x < display.width_mm / 2)
    return float(1 - covered[on_array].mean())


def describe_picture(picture: FittedPicture, *, run: Run) -> dict[str, Any]:
    """Describe the picture for report.json, and record the steps that need a scene."""
    reason = "a picture has no scene: the surfaces that it hides are unknown"
    run.skipped.add("ground truth", "nothing", "rendering, noise floor, scores of EIAs", reason)
    if picture.no_oracle is not None:
        run.skipped.add("wrong sources", "nothing", "exact first hits", picture.no_oracle)
    return {"layers": len(picture.rgbd.layers)}


def capture_picture(picture: FittedPicture, inputs: Collection[Input]) -> Capture:
    """Return a picture as the input of all methods."""
    content = CapturedInput(picture.rgbd, None)
    warnings = picture.warnings(user_text(picture.file.path))
    return Capture(picture, {RGBD: content, **dict.fromkeys(inputs, content)}, warnings=warnings)


@stage("exact EIA", code=GENERATING, result_types=(NoisyEIA,), timer="exact EIA")
def generate_exact_eia(picture: FittedPicture) -> NoisyEIA:
    """Generate the EIA of the exact first hits on the front surface, without noise."""
    return NoisyEIA((generate(picture.front, picture.display, EXACT), None))


@stage(
    "warped picture: {viewpoint.name}",
    code=GENERATING,
    result_types=(NoisyImage,),
    timer="warp picture",
)
def warp_picture(
    picture: FittedPicture, viewpoint: Viewpoint, view_pixels_per_lens: int
) -> tuple[NoisyImage, np.ndarray]:
    """Warp the front surface to a viewpoint; also return the covered pixels, (rows, columns)."""
    view, share = warp_to_viewpoint(picture.front, picture.display, viewpoint, view_pixels_per_lens)
    return NoisyImage.from_image(view), share > 0


@stage(
    "exact sources: {columns}",
    code=GENERATING,
    result_types=(ExactHits,),
    timer="exact sources",
    describe=("a random sample of the panel pixels", "the others", "the sample is large enough"),
)
def _find_exact_sources(picture: FittedPicture, columns: str) -> ExactHits:
    return exact_hits(picture.rgbd, picture.display, columns)


@stage("sources of {generator.algorithm}", code=GENERATING)
def _find_sources(generator: GeneratorHandle, picture: FittedPicture) -> Sources | None:
    """Sources of a generator for a picture; None if it does not report them."""
    if not isinstance(generator.generator, SourceGenerator):
        return None
    return generator.generator.sources(picture.rgbd)


def score_sources(
    method: Method, picture: FittedPicture, result: MethodResult, *, run: Run
) -> MethodResult:
    """Add the share of wrong sources to a method's result; an exact algorithm must have none.

    An algorithm without an exact column model is compared with the columns of the surface.
    """
    if picture.no_oracle is not None or not isinstance(method, GeneratorMethod):
        return result
    algorithm = method.algorithm
    generator = GeneratorHandle(algorithm, picture.display, picture.shape, picture.pixel_mm)
    if algorithm.own:
        sources = _find_sources(generator, picture, run=run)
    else:  # changes of another package's code cannot be detected
        sources = _find_sources.function(generator, picture)
    if sources is None:
        return result
    columns = algorithm.columns if algorithm.exact else "surface"
    share = _find_exact_sources(picture, columns, run=run).wrong_share(sources)
    checks = result.checks
    if algorithm.exact:
        detail = "exact first hits by definition"
        checks += (check(f"{algorithm}: wrong sources", share, "<=", 0.0, detail),)
    return replace(
        result, scores=msgspec.structs.replace(result.scores, wrong_source=share), checks=checks
    )
