"""The ledger of a run: what its stages took, what was checked, which pictures were written."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from inim.backend import Backend, choose_backend
from inim.observer import Observer
from inim.parallel import Begin, beside
from inim.pipeline.memo import Memo
from inim.pipeline.picture_files import PictureFiles
from inim.pipeline.plan import Plan
from inim.pipeline.score import Scorer
from inim.settings import Settings

__all__ = ["Ledger"]

# A score takes some 100 bytes a pixel while it is made: 0.4 GB for all of them together.
_PIXELS_AT_ONCE = 2**22


@dataclass
class Ledger:
    """What accumulates while a plan is carried out; the report is made from it.

    Parameters
    ----------
    plan : Plan
    folder : Path
        Where the pictures go.
    listener : Observer
        Counts time and samples inside the renderer, too.
    memo : Memo
        Results found again.
    observed : (rows, columns) bool, optional
        Panel pixels that anything asked for depends on; all if None.
    """

    plan: Plan
    folder: Path
    listener: Observer
    memo: Memo = field(default_factory=Memo)
    observed: np.ndarray | None = None
    timings: dict[str, float] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    checks: list[dict[str, Any]] = field(default_factory=list)

    def for_round(self, settings: Settings, viewpoints: int | None = None) -> Ledger:
        """The ledger as it is, for a round with other numbers of samples; see `jobs.sampling`.

        Times go on adding up; what is checked, skipped and warned of is the round's.

        Parameters
        ----------
        settings : Settings
        viewpoints : int, optional
            How many of them; all if None.
        """
        plan = replace(self.plan, settings=settings, viewpoints=self.plan.viewpoints[:viewpoints])
        return replace(self, plan=plan, memo=self.memo.fork(), warnings=[*self.warnings], checks=[])

    @property
    def skip(self) -> bool:
        """Whether to leave out what changes no result."""
        return not self.plan.request.no_skip

    @cached_property
    def scorer(self) -> Scorer:
        """The run's scores."""
        return Scorer(self.memo)

    @cached_property
    def pictures(self) -> PictureFiles:
        """The run's picture files, which say where they come from."""
        attributes = {
            "inim:scene_sha256": self.plan.file.sha256,
            "inim:seed": str(self.plan.settings.seed),
        }
        return PictureFiles(self.folder, attributes)

    def beside(self) -> AbstractContextManager[Begin]:
        """Threads to score the run's pictures in, as many as their memory allows."""
        display, per_lens = self.plan.display, self.plan.settings.view_pixels_per_lens
        view = display.lens_rows * display.lens_columns * per_lens**2
        return beside(_PIXELS_AT_ONCE // max(view, display.eia_shape[0] * display.eia_shape[1]))

    @cached_property
    def backend(self) -> Backend:
        """What renders, should anything have to be rendered."""
        return choose_backend(self.plan.request.backend)

    def use_renderer(self) -> None:
        """Load the renderer: a run that finds all its pictures again never does."""
        from inim.render import trace, variant

        variant.use(self.plan.request.backend)
        trace.limit_rays(self.plan.rays_in_flight)

    @cached_property
    def fitted(self) -> Any:
        """The scene in the renderer, a `FittedScene`; opened when it is first asked for."""
        self.use_renderer()
        from inim.render.scene import open_scene

        with self.stage("open scene"):
            plan = self.plan
            return open_scene(plan.file, plan.display, plan.settings.fit_share, self.listener)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time a stage under its name; the same name adds up."""
        self.listener.stage(name)
        started = time.perf_counter()
        yield
        self.timings[name] = self.timings.get(name, 0.0) + time.perf_counter() - started

    def check(
        self,
        name: str,
        value: float | None,
        relation: str,
        limit: float,
        detail: str = "",
        interval: tuple[float, float] | None = None,
    ) -> None:
        """Add a row to the verdict. A value that is missing or not finite never passes.

        `interval` is the value's, where its noise is known.
        """
        known = value is not None and bool(np.isfinite(value))
        passed = bool(known and (value >= limit if relation == ">=" else value <= limit))  # type: ignore[operator]
        self.checks.append(
            {
                "name": name,
                "value": value,
                "relation": relation,
                "limit": limit,
                "passed": passed,
                "detail": detail,
                **({} if interval is None else {"interval": list(interval)}),
            }
        )

    def finite(self, name: str, *images: np.ndarray) -> list[np.ndarray]:
        """Pictures whose pixels are finite: others are counted, fail a check and turn black."""
        if all(np.isfinite(image).all() for image in images):
            return list(images)
        wrong = [~np.isfinite(image).all(axis=-1) for image in images]
        bad = sum(int(np.count_nonzero(w)) for w in wrong)
        self.check(f"{name}: pixels not finite", bad, "<=", 0, "taken as black")
        return [
            np.where(w[..., None], np.float32(0), image) if w.any() else image
            for w, image in zip(wrong, images, strict=True)
        ]

    def complete(self, name: str, views: Collection[str]) -> None:
        """A viewpoint of the plan that nobody looked from fails a check."""
        missing = [v.name for v in self.plan.viewpoints if v.name not in views]
        if missing or not views:
            detail = ", ".join(missing) or "there is none at all"
            self.check(f"{name}: viewpoints missing", max(1, len(missing)), "<=", 0, detail)
