"""Rendering of a case: inputs for authors, and the truth that submissions are scored with.

A case is a folder with `case.json`, the digests of its files; `input/` is all that an algorithm may
see, `truth/` has the EIA, the views, and their matrices, so that scores need no renderer.
"""

import hashlib
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np

from inim.apps.benchmark.definition import BLIND_SPP, CAMERAS, RELICS, BenchmarkCase
from inim.apps.benchmark.document import CaseDocument, InputDocument, InputPicture, Statistic
from inim.apps.benchmark.protocol import PROTOCOL
from inim.display import Display
from inim.display.pixels import SUBPIXELS, PixelOffset, pixel_rays, row_blocks
from inim.image.color import to_srgb
from inim.image.files.eia_file import write_eia
from inim.image.files.image import write_exr_parts
from inim.image.rgbd import RGBD
from inim.pipeline.job import setup
from inim.pipeline.plan import Plan, make_plan
from inim.pipeline.request import Request
from inim.pipeline.stages.capture import CapturedInput, DepthCamera, camera_pictures
from inim.pipeline.stages.ground_truth import (
    SceneView,
    pick_up_eia,
    render_ground_truth_eia,
    render_view,
)
from inim.pipeline.stages.optimal import ScoredViews, optimise_eia
from inim.pipeline.stages.reconstruction import DisplayViews
from inim.pipeline.stages.scene import seed_of
from inim.render.scene_files.new_scene import new_scene
from inim.report.summary import markdown_section
from inim.scores.document_parts import DisplayRecord, EyePosition
from inim.scores.metrics import relic_region
from inim.system.cache import ResultCache
from inim.system.document import folder_files, read_document, write_document, write_text
from inim.system.errors import FileError
from inim.system.files import read_file
from inim.system.process.observer import Observer
from inim.system.worker.output import staging_folder
from inim.system.worker.supervisor import run_in_worker

MANIFEST = "case.json"
#: EIAs of the truth's folder that are entries of the board: bounds of what is possible, and ray
#: tracing of the mesh with few samples per pixel.
OPTIMAL, TRACED, TRACED_SPP = "optimal", "traced", 16
_FILES = (MANIFEST, "input/", "truth/")
# Of a file of a case or of a submission.
_MOST_BYTES = 2**30


@dataclass(frozen=True)
class CaseJob:
    """A case to render, with its plans; `blind` is that of the deviating array."""

    case: BenchmarkCase
    seed: int
    blind_seed: int
    plan: Plan
    blind: Plan

    @classmethod
    def of(cls, case: BenchmarkCase, scene: Path, seed: int, blind_seed: int) -> "CaseJob":
        """Plan a case; raises an `InimError` for a scene that cannot be used."""
        settings = {**case.conditions, "seed": seed, "score_error": 0.0}
        definitions = {f"inim.{name}": value for name, value in settings.items()}

        def plan(misalign: Mapping[str, float] | None) -> Plan:
            request = Request(
                scene=scene, out=Path(case.name), definitions=definitions, display=case.display,
                viewpoints=tuple(case.viewpoints), algorithms=("template",), misalign=misalign,
            )  # fmt: skip
            return make_plan(request, of_scene=True)

        return cls(case, seed, blind_seed, plan({}), plan(case.misalignment(blind_seed)))

    def is_made(self, manifest: Path) -> bool:
        """True if a manifest is that of this job; raises `FileError` if it is damaged."""
        if not manifest.is_file():
            return False
        document = read_document(manifest, "delete its folder", CaseDocument)
        expected = (PROTOCOL, self.seed, self.blind_seed, self.plan.samples, self.plan.file.sha256)
        return expected == (
            document.protocol,
            document.seed,
            document.blind_seed,
            document.samples,
            document.scene,
        )


def write_licences(suite: Path) -> None:
    """Write the sources and licences of the relics, next to the cases."""
    rows = [[relic.name, relic.source, relic.licence] for relic in RELICS.values()]
    table = markdown_section("Relics", ["relic", "source", "licence"], rows)
    head = f"# {PROTOCOL}\n\nPictures of a relic have the relic's licence.\n\n"
    write_text(suite / "LICENCES.md", f"{head}{table}\n")


def scene_of(case: BenchmarkCase, suite: Path, scans: Path | None) -> Path:
    """The scene of a case's relic, in the project's folder; that of a scan is written into the
    suite first.

    Raises `FileError` if a scene or a scan is missing.
    """
    relic = case.relic
    if relic.scan is None:
        path = Path("scenes", f"{relic.name}.xml")
        if not path.is_file():
            raise FileError(f"{path}: no such scene; run the command in the project's folder")
        return path
    path = suite / "scenes" / f"{relic.name}.xml"
    if not path.is_file():
        new_scene(relic.mesh(scans), path, unit="any", up="y")
    return path


def render_case(job: CaseJob, suite: Path, *, quiet: bool, debug: bool) -> None:
    """Render a case in a worker process, and publish its folder as a whole."""
    run_in_worker(
        f"{__name__}:run_job",
        lambda: job,
        staging_folder(suite / job.case.name, _FILES),
        quiet=quiet,
        debug=debug,
    )


def run_job(job: CaseJob, staging: Path, observer: Observer) -> bool:
    """Entry point in the worker: render a case and write its files."""
    observer.stage("start")
    observer.begin(["capture", "truth", "blind", "write"])
    run, renderer, _ = setup(job.plan, staging, observer, ResultCache(), data_only=True)
    plan, case = job.plan, job.case
    camera = plan.camera(renderer)
    observer.stage("capture")
    inputs = _write_inputs(case, camera, staging / "input")
    observer.stage("truth")
    rounds, settings = {k: (v,) for k, v in plan.samples.items()}, plan.settings
    views = {
        eye.name: SceneView(*render_view(
            camera.scene, eye, settings.view_pixels_per_lens, rounds["view_spp"], job.seed, run=run
        ))
        for eye in plan.viewpoints
    }  # fmt: skip
    (staging / "truth").mkdir()
    statistics = {}
    spp = plan.samples["eia_spp"]
    for name, of, eia_spp in (("eia", plan, spp), ("blind", job.blind, min(spp, BLIND_SPP))):
        observer.stage("truth" if name == "eia" else "blind")
        display_views = DisplayViews(plan.viewpoints, of.optics, renderer, run=run)
        eia = render_ground_truth_eia(
            camera.scene, of.misaligned_display, (eia_spp,), job.seed, None,
            display_views.observed, run=run,
        )  # fmt: skip
        assert eia.noise is not None
        assert eia.observed is not None
        assert display_views.observed is not None
        arrays = {"eia": eia.image, "noise": eia.noise, "observed": eia.observed}
        _write_arrays(staging / "truth" / f"{name}.npz", arrays | display_views.to_arrays())
        bound = ScoredViews(of.optics, plan.viewpoints)
        best, _ = optimise_eia(OPTIMAL, camera.scene, bound, rounds["view_spp"][0], eia, run=run)
        _write_panel(staging / "truth" / f"{OPTIMAL}-{name}.png", best.image, case.display)
        statistics[name] = _statistic(eia.observed, float(display_views.observed.mean()))
    traced, _ = pick_up_eia(
        camera.scene, case.display.through_pinholes(), (TRACED_SPP,), seed_of("pickup", job.seed),
        run=run,
    )  # fmt: skip
    _write_panel(staging / "truth" / f"{TRACED}.png", traced.image, case.display)
    pictures: dict[str, np.ndarray] = {}
    for name, (image, relic) in views.items():
        region = relic_region(relic)
        replicates = image.replace_nonfinite().replicates
        assert replicates is not None
        pictures |= {f"{name} image": replicates, f"{name} relic": relic}
        statistics[name] = _statistic(replicates[:, region], float(region.mean()))
    _write_arrays(staging / "truth" / "views.npz", pictures)
    observer.stage("write")
    write_document(staging / "input" / "input.json", inputs)
    files = folder_files(staging)
    document = CaseDocument(
        protocol=PROTOCOL,
        case=case.name,
        seed=job.seed,
        blind_seed=job.blind_seed,
        scene=plan.file.sha256,
        samples=plan.samples,
        files={name: file_digest(staging / name) for name in files},
        statistics=statistics,
    )
    write_document(staging / MANIFEST, document)
    return True


def _write_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    np.savez_compressed(path, allow_pickle=False, **arrays)


def _write_panel(path: Path, eia: np.ndarray, display: Display) -> None:
    write_eia(path, eia, None, display.pixel_pitch_mm)


def file_digest(path: Path) -> str:
    """SHA-256 of a file; raises `FileError` if it is no regular file, or is too large."""
    return hashlib.sha256(read_file(path, _MOST_BYTES)).hexdigest()


def _statistic(replicates: np.ndarray, share: float) -> Statistic:
    """Mean colour of replicates, (K, pixels, 3), with its error."""
    means = replicates.mean(axis=1, dtype=np.float64)
    error = means.std(axis=0, ddof=1) / np.sqrt(len(means))
    (r, g, b), (r_error, g_error, b_error) = means.mean(axis=0).tolist(), error.tolist()
    return Statistic(mean=(r, g, b), error=(r_error, g_error, b_error), share=share)


def _write_inputs(case: BenchmarkCase, camera: DepthCamera, folder: Path) -> InputDocument:
    """Write pictures, rays and the mesh; return their description."""
    folder.mkdir(parents=True)
    pictures = []
    for number, (_, (right, up), parts) in enumerate(camera_pictures(camera, CAMERAS)):
        end = f"_{number}" if number else ""
        names = f"color{end}.png", f"depth{end}.exr"
        write_picture(CapturedInput.of(parts).rgbd, folder / names[0], folder / names[1])
        pictures.append(InputPicture(color=names[0], depth=names[1], right=right, up=up))
    write_rays(case.display, folder / "rays.exr")
    file = camera.scene.file
    for path in file.contents:
        target = folder / "mesh" / path.relative_to(file.path.resolve().parent)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, target)
    return InputDocument(
        protocol=PROTOCOL,
        case=case.name,
        relic=case.relic.name,
        source=case.relic.source,
        licence=case.relic.licence,
        display=DisplayRecord.of(case.display),
        rays="rays.exr",
        pixel_mm=camera.pixel_mm,
        pictures=pictures,
        mesh=f"mesh/{file.path.name}",
        display_from_scene=camera.scene.fitted.fit.display_from_world.tolist(),
        viewpoints=[EyePosition(name=e.name, position_mm=e.position_mm) for e in case.viewpoints],
    )


def write_picture(rgbd: RGBD, color: Path, depth: Path) -> None:
    """Write a picture as sRGB with alpha, and its depth as an EXR with the channel Z."""
    from PIL import Image

    alpha = np.where(rgbd.covered, 255, 0).astype(np.uint8)
    Image.fromarray(np.dstack([to_srgb(rgbd.color), alpha])).save(color)
    values = np.where(rgbd.covered, rgbd.depth_mm, 0)
    write_exr_parts(depth, [({"Z": values}, "depth")], None)


def write_rays(display: Display, path: Path) -> None:
    """Write the rays of all panel pixels, for each colour; see `InputDocument.rays`."""
    channels = {
        f"{color}.{name}": np.full(display.eia_shape, np.nan, np.float32)
        for color in "RGB"
        for name in ("x", "y", "right", "up")
    }
    for color, subpixel in zip("RGB", SUBPIXELS[display.subpixels], strict=True):
        offset = PixelOffset(Fraction(0), subpixel.right, subpixel.channel)
        for rows in row_blocks(display):
            rays = pixel_rays(display, rows, offset)
            parts = {"x": rays.x0, "y": rays.y0, "right": rays.slope_x, "up": rays.slope_y}
            for name, values in parts.items():
                channels[f"{color}.{name}"][rows] = np.where(rays.lens < 0, np.nan, values)
    write_exr_parts(path, [(channels, "rays")], None)
