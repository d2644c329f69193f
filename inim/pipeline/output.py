"""Output of a run: image files, written while the run continues, and the content of report.json."""

import shlex
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import msgspec
import numpy as np

from inim.display import Display
from inim.generators.accuracy_limits import accuracy_warnings, lenses_beside_panel
from inim.image.files.image import write_exr, write_png, write_rgbd
from inim.image.rgbd import RGBD, LayeredRGBD
from inim.pipeline.baseline import BaselineComparison
from inim.pipeline.evaluation import Evaluation
from inim.pipeline.stages.capture import Capture
from inim.pipeline.stages.doubts import find_doubts
from inim.pipeline.stages.ground_truth import GroundTruth
from inim.pipeline.stages.picture import PictureFile
from inim.pipeline.stages.scoring import reported_scores
from inim.report import Report
from inim.report.document import (
    CapturedPicture,
    MetricSettings,
    NoiseFloor,
    PictureRecord,
    Preview,
    ReferenceViews,
    ReportDocument,
    SceneRecord,
    Scoring,
    SkippedStep,
)
from inim.scores import metrics
from inim.scores.document_parts import BackendRecord, Checks, DisplayRecord, EyePosition, origin
from inim.scores.metrics import HEADLINE
from inim.system.cache import ResultCache
from inim.system.document import folder_files
from inim.system.process.observer import Observer
from inim.system.process.threads import OneThread
from inim.system.process.user_paths import user_text

# Images waiting to be written occupy memory: at most a quarter of a gigabyte.
_WAITING_BYTES = 2**28
_TIMER = "write pictures"
# A layered depth image has other colours than the RGB-D picture, so both are stored.
_INPUT_FILES = {RGBD: "rgbd.exr", LayeredRGBD: "layers.exr"}


class Images:
    """Writes images in a separate thread: compressing them takes as long as scoring them.

    The block `with images.thread` ends the thread. `attributes` go into every EXR file; the cache
    holds compressed PNG files. With `data_only`, nothing is written.
    """

    def __init__(
        self,
        folder: Path,
        attributes: Mapping[str, str],
        observer: Observer,
        cache: ResultCache | None = None,
        *,
        data_only: bool = False,
    ) -> None:
        self.folder, self.cache, self._data_only = folder, cache or ResultCache(), data_only
        self._observer = observer
        self._attributes = attributes
        self.thread = OneThread("images")
        self._waiting: list[tuple[Future[None], int]] = []

    def save(self, name: str, linear: np.ndarray) -> None:
        """Write an image, (rows, columns, 3) linear RGB, as PNG and EXR; do not modify it later.

        Raises `FileError` if this or an earlier image cannot be written.
        """

        def write() -> None:
            write_png(self.folder / f"{name}.png", linear, self.cache)
            write_exr(self.folder / f"{name}.exr", linear, self._attributes)

        self._submit(write, linear.nbytes)

    def save_capture(self, capture: Capture, display: Display) -> None:
        """Write the methods' inputs, and PNG files of the RGB-D picture's colour and depth."""
        rgbd = capture.rgbd

        def write() -> None:
            for kind, content in capture.inputs.items():
                if content.rgbd is rgbd and kind is not RGBD:  # a picture without a scene
                    continue
                name = f"cameras-{kind}.exr" if isinstance(kind, str) else _INPUT_FILES[kind]
                write_rgbd(self.folder / name, content.rgbd, self._attributes)
            write_rgbd_pngs(self.folder, rgbd, display, self.cache)

        self._submit(write, rgbd.color.nbytes)

    def save_truth(self, truth: GroundTruth) -> None:
        """Write the ground-truth EIA and views, the relic's regions and the reference views."""
        self.save("truth/eia", truth.eia.image)
        for name, view in truth.views.items():
            self.save(f"truth/{name}", view.image)
            region = truth.regions[name]
            white = np.repeat(region[..., None], 3, axis=-1).astype(np.float32)
            path = self.folder / "truth" / "relic" / f"{name}.png"
            self._submit(partial(write_png, path, white, self.cache), white.nbytes)
        self.save_views("reference", truth.reference_views)

    def save_views(self, name: str, views: Mapping[str, Any]) -> None:
        """Write views of an EIA, by viewpoint."""
        for viewpoint, view in views.items():
            self.save(f"views/{name}/{viewpoint}", view.image)

    def _submit(self, write: Callable[[], None], size: int) -> None:
        """Submit a function that writes a file and occupies `size` bytes until then."""
        if self._data_only:
            return
        with self._observer.timed(_TIMER):
            while self._waiting and (
                self._waiting[0][0].done()
                or sum(waiting for _, waiting in self._waiting) > _WAITING_BYTES
            ):
                self._waiting.pop(0)[0].result()
        self._waiting.append((self.thread.submit(write), size))
        if size > _WAITING_BYTES:
            self.finish()

    def finish(self) -> None:
        """Wait until all images are written."""
        with self._observer.timed(_TIMER):
            while self._waiting:
                self._waiting.pop(0)[0].result()


def write_rgbd_pngs(
    folder: Path, rgbd: RGBD, display: Display, cache: ResultCache | None = None
) -> None:
    """Write colour, and depth as grey: darker is farther within the depth range."""
    low, high = display.depth_range_mm
    grey = np.where(rgbd.covered, 0.1 + 0.9 * (rgbd.depth_mm - low) / (high - low), 0.0)
    cache = cache or ResultCache()
    write_png(folder / "rgbd_color.png", rgbd.color, cache)
    write_png(folder / "rgbd_depth.png", np.repeat(grey[..., None], 3, axis=-1), cache)


_VERSIONS = ("drjit", "mitsuba", "numba", "numpy", "OpenEXR", "scikit-image")


def make_report(
    evaluation: Evaluation,
    noise_floor: NoiseFloor | None,
    times: Mapping[str, float],
    comparison: BaselineComparison,
    folder: Path,
) -> Report:
    """Collect the data of a report, whose images are in `folder`; the caller writes it.

    `times` are in multiples of the reference kernel's, by generator.
    """
    plan, checks = evaluation.plan, [*evaluation.checks, *comparison.checks]
    doubts = find_doubts(evaluation.truth, evaluation.results, noise_floor)
    algorithms, observer = evaluation.algorithms, evaluation.run.observer
    for name, yardsticks in times.items():
        algorithms[name] = msgspec.structs.replace(algorithms[name], yardsticks=yardsticks)
    preview = None
    if plan.request.preview:
        command = replace(plan, request=replace(plan.request, preview=False)).command
        preview = Preview(full_command=shlex.join(["inim", "validate", *command]))
    settings, is_picture = plan.settings, isinstance(plan.file, PictureFile)
    source = {
        "path": user_text(plan.request.scene),
        "sha256": plan.file.sha256,
        "definitions": plan.definitions,
        **evaluation.source,
    }
    folders = {"allow_folders": [user_text(f) for f in plan.request.allow_folders]}
    # Lenses outside the panel, and displays beyond the tested accuracy limits.
    display_warnings = lenses_beside_panel(plan.display) + accuracy_warnings(
        plan.display,
        settings.lens_model,
        viewpoints=plan.viewpoints,
        pixel_mm=plan.display.capture_pixel_mm(settings.capture_pixels_per_pitch),
    )
    reference_views, reference_precision = reported_scores(evaluation.reference_scores)
    data = ReportDocument(
        title=settings.title or plan.request.scene.stem,
        **origin(
            shlex.join(["python", "-m", "inim.validate", *plan.command]),
            _VERSIONS,
        ),
        preview=preview,
        scene=None if is_picture else msgspec.convert(source | folders, SceneRecord),
        picture=msgspec.convert(source, PictureRecord) if is_picture else None,
        settings=settings,
        display=DisplayRecord.of(plan.display),
        misalign=settings.misalign,
        backend=BackendRecord.of(evaluation.backend),
        lens_model=settings.lens_model,
        viewpoints=[EyePosition(name=v.name, position_mm=v.position_mm) for v in plan.viewpoints],
        rgbd=_describe_picture(evaluation.capture.rgbd),
        noise_floor=noise_floor,
        scoring=_describe_scoring(),
        reference=ReferenceViews(views=reference_views, precision=reference_precision),
        algorithms=algorithms,
        differences=evaluation.differences,
        timings=observer.timings
        | {"mitsuba_render": observer.render_seconds, "total": perf_counter() - observer.started},
        skipped=[SkippedStep(**row) for row in evaluation.run.skipped.rows],
        warnings=[*doubts, *display_warnings, *evaluation.warnings],
        verdict=Checks.of(checks, doubts),
        files=folder_files(folder, "report.html", "report.json", "junit.xml", "summary.md"),
        regression=comparison.data,
    )
    return Report(folder, data)


def _describe_scoring() -> Scoring:
    return Scoring(
        headline=HEADLINE,
        relic_margin_px=metrics.RELIC_MARGIN_PX,
        metrics={
            metric.name: MetricSettings(border_px=metric.border, arguments=dict(metric.settings))
            for metric in metrics.all_metrics()
        },
    )


def _describe_picture(rgbd: RGBD) -> CapturedPicture:
    covered = rgbd.depth_mm[rgbd.covered]
    return CapturedPicture(
        rows=rgbd.shape[0],
        columns=rgbd.shape[1],
        pixel_mm=rgbd.pixel_mm,
        covered_fraction=float(rgbd.covered.mean()),
        depth_min_mm=float(covered.min()) if covered.size else None,
        depth_max_mm=float(covered.max()) if covered.size else None,
    )
