"""EIAs of a relic on a turntable: the ground truth's and those of algorithms, angle by angle.

Each angle's files and scores are a result in the cache, so an interrupted command continues with
the next angle when it is repeated.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from PIL import Image

from inim.cache import ResultCache, open_store
from inim.documents.document import read_document, write_listed
from inim.documents.parts import DisplayRecord, origin
from inim.documents.report import AlgorithmResult, TurntableDocument, TurntableFrame
from inim.errors import UsageError, suggest_words
from inim.files.image import write_png
from inim.metrics import HEADLINE, HEADLINE_WORDS
from inim.pipeline.launch import scene_and_out
from inim.pipeline.output import Images
from inim.pipeline.plan import Plan, make_plan
from inim.pipeline.request import Request
from inim.pipeline.stages.scene import Renderer
from inim.pipeline.stages.stage import Run
from inim.pipeline.validate import evaluate
from inim.process.atomic_file import file_errors
from inim.process.observer import Observer
from inim.report import TRUTH
from inim.report.labels import check_sentence
from inim.views.film import ENCODER, write_panel_video
from inim.worker.output import publish, staging_folder
from inim.worker.supervisor import run_in_worker

#: Marks the folder of a turntable.
JSON = "turntable.json"
#: Algorithms by default: the best one of a scene, and the best one of a single picture.
ALGORITHMS = ("layered", "template")
#: Frames of the videos per second, by default.
RATE = 24.0
_MOST_FRAMES = 2000


@dataclass(frozen=True)
class _WholeTurn:
    """A checked request for the EIAs of a whole turn; `command` is the command line."""

    plan: Plan
    frames: int
    frames_per_second: float
    command: str


@dataclass(frozen=True)
class Turntable:
    """A finished turntable: its folder and the content of its `turntable.json`."""

    folder: Path
    data: TurntableDocument

    @classmethod
    def load(cls, folder: Path) -> Turntable:
        """Read a folder; raises `FileError` for a missing or damaged document."""
        remedy = "export it again with inim export --turntable"
        return cls(folder, read_document(folder / JSON, remedy, TurntableDocument))

    @property
    def names(self) -> list[str]:
        """Names of the EIAs, that of the ground truth first."""
        return [TRUTH, *self.data.frames[0].algorithms]

    def eia_paths(self, name: str, option: str) -> tuple[Path, ...]:
        """Paths of the EIAs of all frames; raises `UsageError` for an unknown name."""
        if name not in self.names:
            raise UsageError(f"{option} {name}: {suggest_words(name, self.names)}")
        return tuple(
            self.folder / "eia" / name / f"{n:04}.png" for n in range(len(self.data.frames))
        )


def export_turntable(
    source: Path,
    out: Path,
    frames: int,
    frames_per_second: float = RATE,
    *,
    new_scene: Mapping[str, Any] | None = None,
    allow_folders: tuple[Path, ...] = (),
    command: str = "",
    quiet: bool = True,
    debug: bool = False,
    **choices: Any,
) -> bool:
    """Write the EIAs of a relic at the angles of a whole turn; True if every check passed.

    `source` is a scene, or a mesh, whose scene is written to the folder `OUT-scene` with the
    options `new_scene`. `choices` are the fields of `inim.pipeline.request.Choices`, by default
    `ALGORITHMS`, and `command` is the command line for the record. `quiet` and `debug` are those of
    `run_in_worker`.

    Raises an `InimError`: impossible settings, an unreadable scene, or no usable backend.
    """
    for name, value, high in (
        ("--turntable", frames, _MOST_FRAMES),
        ("--rate", frames_per_second, 100),
    ):
        if not 1 <= value <= high:
            raise UsageError(f"{name} {value:g}: must be in 1..{high}")
    scene, out = scene_and_out(source, out, new_scene)
    choices = {"algorithms": ALGORITHMS, "viewpoints": ("centre",)} | choices
    request = Request(scene, out, allow_folders=allow_folders, **choices)
    return run_in_worker(
        f"{__name__}:run_job",
        lambda: _WholeTurn(make_plan(request), frames, frames_per_second, command),
        staging_folder(out, (JSON, "eia/")),
        about=str(scene),
        quiet=quiet,
        debug=debug,
    )


def run_job(request: _WholeTurn, staging: Path, observer: Observer) -> bool:
    """Entry point in the worker: render all angles, write and publish."""
    plan, out = request.plan, request.plan.request.out
    cache = ResultCache(open_store())
    renderer = Renderer("auto", Observer(), plan.rays_in_flight)
    angles = [360 * n / request.frames for n in range(request.frames)]
    stages = [f"{angle:g} degrees" for angle in angles]
    observer.begin(["start", *stages, "write"])
    frames, failures = [], dict[str, None]()
    for number, (angle, name) in enumerate(zip(angles, stages, strict=True)):
        observer.stage(name)
        turned = replace(plan, settings=replace(plan.settings, turn_deg=angle))
        files, results, failed = _render_angle(turned, staging, renderer, cache)
        _write_files(files, staging / "eia", f"{number:04}.png")
        frames.append(
            TurntableFrame(
                angle_deg=angle, algorithms=msgspec.convert(results, dict[str, AlgorithmResult])
            )
        )
        failures |= dict.fromkeys(f"{name}: {text}" for text in failed)
    observer.stage("write")
    has_encoder = importlib.util.find_spec(ENCODER) is not None
    for folder in sorted((staging / "eia").iterdir()) if has_encoder else ():
        video = folder.with_name(f"{folder.name}.mp4")
        pictures = (np.asarray(Image.open(path)) for path in sorted(folder.iterdir()))
        write_panel_video(video, pictures, request.frames_per_second)
    document = TurntableDocument(
        title=plan.settings.title or out.name,
        **origin(request.command),
        settings=plan.settings,
        display=DisplayRecord.of(plan.display),
        frames_per_second=request.frames_per_second,
        frames=frames,
        warnings=[*failures],
    )
    write_listed(document, staging, JSON, {})
    publish(staging, out, JSON)
    for line in _score_lines(document):
        observer.line(line)
    if not has_encoder:
        observer.line("no videos: pip install imageio-ffmpeg, and repeat the command")
    return not failures


class _EIAs(Images):
    """Writes the EIAs of a run as PNG files, by name, and no other image."""

    def save(self, name: str, linear: np.ndarray) -> None:
        """See `Images`."""
        kind, _, rest = name.partition("/")
        if name == f"{TRUTH}/eia":
            rest, kind = TRUTH, "eia"
        if kind == "eia":
            write_png(self.folder / f"{rest}.png", linear)


def _render_angle(
    plan: Plan, folder: Path, renderer: Renderer, cache: ResultCache
) -> tuple[dict[str, np.ndarray], dict[str, Any], list[str]]:
    """Files of all EIAs at the plan's turn, results by algorithm, and failed checks; cached.

    Files are arrays of bytes, (n,) uint8, by name. The folder is for temporary files.
    """

    def make() -> list[Any]:
        images = _EIAs(folder / "angle", {}, renderer.observer, data_only=True)
        evaluation = evaluate(plan, renderer, images, Run(observer=renderer.observer))
        files = {}
        for path in sorted(images.folder.iterdir()):
            files[path.stem] = np.fromfile(path, np.uint8)
            path.unlink()
        images.folder.rmdir()
        failed = [f"{c.name}: {check_sentence(c)}" for c in evaluation.checks if not c.passed]
        results = msgspec.to_builtins(evaluation.algorithms, enc_hook=lambda number: number.item())
        return [files, results, failed]

    key = plan.cache_key(renderer)
    del key["command"]  # the folder changes no EIA, and all settings are in the key
    content, _ = cache.find_or_make("turntable", lambda: key, make, explain=False)
    files, results, failed = content
    return files, results, list(failed)


def _write_files(files: dict[str, np.ndarray], folder: Path, name: str) -> None:
    for eia, content in files.items():
        path = folder / eia / name
        with file_errors(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            content.tofile(path)


def _score_lines(document: TurntableDocument) -> list[str]:
    """Mean and extremes of each algorithm's scores over the turn, and its time."""
    lines = []
    for name in document.frames[0].algorithms:
        results = [frame.algorithms[name] for frame in document.frames]
        scores = [view[HEADLINE] for result in results for view in result.views.values()]
        finite = [score for score in scores if score is not None]
        if finite:
            mean, low, high = np.mean(finite), min(finite), max(finite)
            seconds = np.mean([result.seconds or 0.0 for result in results])
            lines.append(
                f"{name:10} {HEADLINE_WORDS}: {mean:.4f} ({low:.4f} to {high:.4f}), "
                f"{seconds:.2f} s per EIA"
            )
    return lines
