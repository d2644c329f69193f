"""Definition of inim-bench 1: relics, displays, tracks, viewpoints, samples and seeds.

A case is a relic on a display. Cases have the same inputs and the same truth on every machine, up
to the noise of the renderer. Any change here changes the scores: it needs a new `PROTOCOL`.
"""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from inim.apps.benchmark.protocol import PROTOCOL
from inim.display import Display, Viewpoint
from inim.display.misalignment import one_pixel_errors
from inim.display.viewpoint import zone_eyes
from inim.system.errors import FileError, UsageError, suggest_words
from inim.system.files import read_file

DISPLAYS = {
    "sheet": Display(
        pitch_mm=1.0, focal_length_mm=3.0, gap_mm=3.3, pixel_pitch_mm=1 / 16, lens_columns=24,
        lens_rows=24, name="sheet",
    ),
    "phone": Display(
        pitch_mm=1.0, focal_length_mm=3.0, gap_mm=3.3, pixel_pitch_mm=0.0637, lens_columns=30,
        lens_rows=20, name="phone",
    ),
    "lenticular": Display(
        lattice="lenticular", pitch_mm=0.5, focal_length_mm=0.75, gap_mm=0.75,
        pixel_pitch_mm=0.075, lens_columns=80, lens_rows=1, panel_columns=540, panel_rows=400,
        depth_min_mm=-10.0, depth_max_mm=10.0, rotation_deg=-9.462322, subpixels="rgb-stripe",
        name="lenticular",
    ),
}  # fmt: skip
#: Cameras of the track `cameras`; see `inim.image.rgbd.camera_directions`.
CAMERAS = "5"
# Rows and columns of viewpoints, by whether the display has horizontal parallax only.
_EYES = {False: (3, 3), True: (1, 9)}


class ScannedMesh(NamedTuple):
    """A scanned mesh that the project does not contain; it stands upright along y."""

    file: str
    sha256: str


@dataclass(frozen=True)
class Relic:
    """A relic of the benchmark.

    `scan` is None for those of the project's folder `scenes`. `eia_spp` are the samples per pixel
    of its true EIA, if the display is no panel of cylinders.
    """

    name: str
    source: str
    licence: str
    scan: ScannedMesh | None = None
    eia_spp: int = 256

    def mesh(self, folder: Path | None) -> Path:
        """The scan in a folder; raises `FileError` if it is missing or has another content."""
        assert self.scan is not None
        if folder is None:
            raise UsageError(
                f"--scans: missing; give the folder with {self.scan.file}, from {self.source}"
            )
        path = folder / self.scan.file
        if hashlib.sha256(read_file(path, 2**28)).hexdigest() != self.scan.sha256:
            raise FileError(f"{path}: is another version; its SHA-256 must be {self.scan.sha256}")
        return path


_THREE_D_SCANS = "Three D Scans, github.com/keijiro/ThreeDScans"
_UNRESTRICTED = "not copyrighted, use without restriction"
_OWN = "this project, scenes/"
RELICS = {
    relic.name: relic
    for relic in (
        *(
            Relic(name, _OWN, "BSD-3-Clause", eia_spp=eia_spp)
            for name, eia_spp in (
                ("amphora", 256), ("jade", 768), ("ibex", 320), ("altar", 256), ("tripod", 384),
                ("wine_coin", 256),
            )
        ),
        *(
            Relic(name.lower(), _THREE_D_SCANS, _UNRESTRICTED, ScannedMesh(f"{name}.ply", sha256),
                  eia_spp=1024)
            for name, sha256 in (
                ("Athena", "14a1bf40b76d2a5704df53bb2cdb45c9eb6258d0a8468802641a1a37fabcb0a7"),
                ("Hermes", "1d5114bdbfeaa67de46e6e4f77d919f3d5c76d8df83eda5d8329078c7a3569b6"),
                ("Column03", "725955000b31c93b5a2f753e9d01fb0e272a49e1ff63370ce9689914b8dccbf8"),
            )
        ),
        Relic(
            "demosthenes", "Louvre bust, github.com/odedstein/meshes", "CC BY 4.0, Oded Stein",
            ScannedMesh(
                "oded_demosthenes-low-res.obj",
                "52ebee44fc09a0da440e2b3608d791925b2db90175fbb0c06a7d2b56cc4468af",
            ),
            eia_spp=1024,
        ),
    )
}  # fmt: skip


@dataclass(frozen=True)
class BenchmarkCase:
    """A relic on a display."""

    relic: Relic
    display_name: str

    @property
    def name(self) -> str:
        """Name of the case, and of its files in a submission."""
        return f"{self.relic.name}-{self.display_name}"

    @property
    def display(self) -> Display:
        """The display as designed."""
        return DISPLAYS[self.display_name]

    @property
    def conditions(self) -> dict[str, Any]:
        """Settings of the renderer and of the views, by name."""
        conditions = CONDITIONS[self.display_name]
        if self.display.layout.of_cylinders:
            return conditions
        return {**conditions, "eia_spp": self.relic.eia_spp}

    @property
    def viewpoints(self) -> list[Viewpoint]:
        """Nine viewpoints, spread over the viewing zone."""
        rows, columns = _EYES[self.display.layout.of_cylinders]
        return zone_eyes(self.display, columns, rows=rows)

    def misalignment(self, seed: int) -> dict[str, float]:
        """Deviations of the array in the track `blind`: by up to one panel pixel each.

        Uniformly distributed errors of pitch, gap and rotation; see `one_pixel_errors`.
        """
        limits = one_pixel_errors(self.display)
        digest = hashlib.sha256(f"{PROTOCOL} {self.name} {seed}".encode()).digest()
        rng = np.random.default_rng(list(digest))
        kinds = ("pitch_mm", "gap_mm", "rotation_deg")
        return {kind: float(rng.uniform(-1, 1)) * limits[kind] for kind in kinds}


#: Cases by tier.
TIERS = {
    "small": ("amphora-sheet", "jade-phone", "altar-sheet", "ibex-lenticular"),
    "full": tuple(f"{relic}-{display}" for relic in RELICS for display in DISPLAYS),
}
_ARRAY = {"capture_pixels_per_pitch": 5, "view_pixels_per_lens": 4}
_CYLINDERS = {"capture_pixels_per_pitch": 3, "view_pixels_per_lens": 1}
#: Samples per pixel of the true EIA in the track `blind`, at most.
BLIND_SPP = 256
#: Settings by display, next to `Relic.eia_spp`. With these samples per pixel, the interval of a
#: headline score of a case is at most 0.005 to either side.
CONDITIONS: dict[str, dict[str, Any]] = {
    name: {"lens_model": "thick", "reconstruction_spp": 64, "fit_share": 0.9, **settings}
    for name, settings in {
        "sheet": {**_ARRAY, "capture_spp": 256, "view_spp": 256},
        "phone": {**_ARRAY, "capture_spp": 256, "view_spp": 256},
        "lenticular": {**_CYLINDERS, "capture_spp": 128, "eia_spp": 64, "view_spp": 256},
    }.items()
}


def case_of(name: str) -> BenchmarkCase:
    """The case of a name; raises `UsageError` for another."""
    relic, _, display = name.rpartition("-")
    if name not in TIERS["full"]:
        raise UsageError(f"case {name!r}: {suggest_words(name, TIERS['full'])}")
    return BenchmarkCase(RELICS[relic], display)


def cases_of(tier: str) -> Iterator[BenchmarkCase]:
    """The cases of a tier."""
    return map(case_of, TIERS[tier])
