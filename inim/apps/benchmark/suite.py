"""A made suite: its cases, their inputs and their truth."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from inim.apps.benchmark.definition import TIERS, BenchmarkCase, case_of
from inim.apps.benchmark.document import CaseDocument, InputDocument
from inim.apps.benchmark.make import MANIFEST, file_digest
from inim.apps.benchmark.protocol import PROTOCOL
from inim.display import Viewpoint
from inim.display.misalignment import misaligned
from inim.image.color import linear_from_srgb
from inim.image.files.image import read_exr_channels
from inim.image.noisy_image import NoisyEIA, NoisyImage
from inim.image.rgbd import RGBD, Camera, CameraRGBD, CameraRGBDs
from inim.pipeline.stages.reconstruction import DisplayViews, Optics
from inim.pipeline.stages.scene import Renderer
from inim.scores.metrics import relic_region
from inim.system.document import read_document
from inim.system.errors import FileError
from inim.system.process.observer import Observer

_REMEDY = "render it again with `inim benchmark make`"


class TruthView(NamedTuple):
    """Ground truth at a viewpoint, and the relic's region of it."""

    image: NoisyImage
    region: np.ndarray


class Truth(NamedTuple):
    """Truth of a track: the EIA, the display's views, and the scene's views by viewpoint."""

    eia: NoisyEIA
    views: DisplayViews
    scene: dict[str, TruthView]


@dataclass(frozen=True)
class MadeCase:
    """A case in its folder."""

    case: BenchmarkCase
    folder: Path
    manifest: CaseDocument

    @classmethod
    def read(cls, folder: Path, name: str) -> "MadeCase":
        """Read the manifest of a case; raises `FileError` if it is missing, damaged or stale."""
        manifest = read_document(folder / name / MANIFEST, _REMEDY, CaseDocument)
        if manifest.protocol != PROTOCOL:
            raise FileError(
                f"{folder / name / MANIFEST}: is of {manifest.protocol}, and this is {PROTOCOL}; "
                f"{_REMEDY}"
            )
        return cls(case_of(name), folder / name, manifest)

    def changed_files(self, part: str = "") -> list[str]:
        """Files, below a folder of the case, that are missing or not those that were made."""
        return [
            name
            for name, digest in self.manifest.files.items()
            if name.startswith(part)
            and not ((path := self.folder / name).is_file() and file_digest(path) == digest)
        ]

    def check(self, part: str) -> None:
        """Raise `FileError` for the first changed file below a folder of the case."""
        for name in self.changed_files(part):
            raise FileError(f"{self.folder / name}: is not the file that was made; {_REMEDY}")

    @property
    def viewpoints(self) -> Sequence[Viewpoint]:
        """Viewpoints of the scores."""
        return self.case.viewpoints

    @cached_property
    def inputs(self) -> InputDocument:
        """Description of the inputs."""
        return read_document(self.folder / "input" / "input.json", _REMEDY, InputDocument)

    def pictures(self) -> tuple[RGBD, CameraRGBDs]:
        """The RGB-D picture of the first camera, and those of all cameras."""
        self.check("input/")
        pictures = []
        for picture in self.inputs.pictures:
            color, covered = _read_color(self.folder / "input" / picture.color)
            depth = read_exr_channels(self.folder / "input" / picture.depth)["Z"]
            place = Camera.orthographic(
                (picture.right, picture.up), depth.shape, self.inputs.pixel_mm
            )
            depth = np.where(covered, depth, np.inf).astype(np.float32)
            pictures.append(CameraRGBD(color, depth, place, picture.color))
        first = pictures[0]
        covered = np.isfinite(first.depth)
        front = RGBD(first.color, np.where(covered, first.depth, 0), covered, self.inputs.pixel_mm)
        return front, CameraRGBDs(tuple(pictures))

    def truth(self, *, blind: bool) -> Truth:
        """Truth of the track `blind`, or of the others."""
        self.check("truth/")
        kind = {True: "blind", False: "eia"}[blind]
        with np.load(self.folder / "truth" / f"{kind}.npz") as file:
            arrays = dict(file)
        eia = NoisyEIA((arrays["eia"], arrays["noise"]), observed=arrays["observed"])
        views = DisplayViews.from_arrays(
            self.viewpoints, self.optics(blind=blind), Renderer("auto", Observer()), arrays
        )
        scene = {}
        with np.load(self.folder / "truth" / "views.npz") as file:
            for eye in self.viewpoints:
                image = NoisyImage.from_replicates(file[f"{eye.name} image"])
                scene[eye.name] = TruthView(image, relic_region(file[f"{eye.name} relic"]))
        return Truth(eia, views, scene)

    def optics(self, *, blind: bool) -> Optics:
        """Optics of the views, with the deviations of the track `blind`."""
        display = self.case.display
        if blind:
            display = misaligned(display, self.case.misalignment(self.manifest.blind_seed))
        conditions = self.case.conditions
        names = ("lens_model", "view_pixels_per_lens", "reconstruction_spp")
        return Optics(display, *(conditions[name] for name in names))


def _read_color(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Linear colours, (rows, columns, 3) float32, and where alpha is not 0."""
    from PIL import Image

    with Image.open(path) as picture:
        codes = np.asarray(picture.convert("RGBA"))
    return linear_from_srgb(codes[..., :3] / np.float32(255)), codes[..., 3] > 0


def made_cases(folder: Path) -> list[MadeCase]:
    """The cases of a suite; raises `FileError` if there is none or one is stale."""
    names = [name for name in TIERS["full"] if (folder / name / MANIFEST).is_file()]
    if not names:
        raise FileError(f"{folder}: no case of {PROTOCOL}; make one with `inim benchmark make`")
    return [MadeCase.read(folder, name) for name in names]
