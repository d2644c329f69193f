"""Image files of a report, written while the run continues."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from inim.cache import ResultCache
from inim.display import Display
from inim.files.image import write_exr, write_png, write_rgbd
from inim.image.color import linear_from_srgb, magma
from inim.image.rgbd import RGBD
from inim.pipeline.stages.capture import Capture
from inim.pipeline.stages.ground_truth import GroundTruth
from inim.process.observer import Observer

# Images waiting to be written occupy memory: at most a quarter of a gigabyte.
_WAITING_BYTES = 2**28
_TIMER = "write pictures"


class Images:
    """Writes images in a separate thread: compressing them takes as long as scoring them.

    `attributes` go into every EXR file; the cache holds compressed PNG files.
    """

    def __init__(
        self,
        folder: Path,
        attributes: Mapping[str, str],
        observer: Observer,
        cache: ResultCache | None = None,
    ) -> None:
        self.folder, self.cache = folder, cache or ResultCache()
        self._observer = observer
        self._attributes = attributes
        self._thread = ThreadPoolExecutor(1, "images")
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
        """Write the RGB-D picture, and PNG files of its colour and depth."""
        rgbd = capture.rgbd

        def write() -> None:
            write_rgbd(self.folder / "rgbd.exr", capture.layered or rgbd, self._attributes)
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

    def save_heat_maps(self, name: str, maps: Mapping[str, np.ndarray]) -> None:
        """Write heat maps of a method's views in colours: ``maps/cvvdp/template/left.png``."""
        for key, heat_map in maps.items():
            metric, _, viewpoint = key.partition("/")
            path = self.folder / "maps" / metric / name / f"{viewpoint}.png"
            colors = linear_from_srgb(magma(heat_map).astype(np.float32) / 255)
            self._submit(partial(write_png, path, colors, self.cache), colors.nbytes)

    def _submit(self, write: Callable[[], None], size: int) -> None:
        """Submit a function that writes a file and occupies `size` bytes until then."""
        with self._observer.timed(_TIMER):
            while self._waiting and (
                self._waiting[0][0].done()
                or sum(waiting for _, waiting in self._waiting) > _WAITING_BYTES
            ):
                self._waiting.pop(0)[0].result()
        self._waiting.append((self._thread.submit(write), size))
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
