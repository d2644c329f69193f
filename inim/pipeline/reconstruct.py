"""What the viewer sees of an EIA, from every viewpoint of a run."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from inim.cache.digest import array_digest
from inim.cache.store import Record
from inim.display import Viewpoint
from inim.lens import white_exposure
from inim.pipeline.deciding import look_parts
from inim.pipeline.ledger import Ledger

__all__ = ["Seen", "observed_pixels", "reconstruct_views"]


@dataclass(frozen=True)
class Seen:
    """A view, and by how much noise could have made it another.

    Attributes
    ----------
    image : (rows, columns, 3) float32, linear RGB
        Depends on the EIA and the seed only: equal EIAs look equal.
    noise : (rows, columns, 3) float32
        Half of the difference of what two halves of the samples yield, those of the EIA and those
        of the look at it.
    """

    image: np.ndarray
    noise: np.ndarray

    @property
    def first(self) -> np.ndarray:
        """The view by one half of the samples."""
        half: np.ndarray = self.image + self.noise
        return half

    @property
    def second(self) -> np.ndarray:
        """The view by the other half."""
        half: np.ndarray = self.image - self.noise
        return half


def reconstruct_views(
    job: Ledger, eia: np.ndarray, noise: np.ndarray | None, name: str
) -> dict[str, Seen]:
    """Look at an EIA from every viewpoint, exposed so that the panel's white looks white.

    Two looks of half of the samples each make a view. A view is linear in its EIA; so what the
    EIA's noise does to it is a third look, with the first one's random numbers, less the first.

    Parameters
    ----------
    job : Ledger
    eia : (rows, columns, 3) float32, linear RGB
    noise : (rows, columns, 3) float32, or None
        Half of the difference of two halves of the EIA's samples; None where it has no noise.
    name : str
        The views are written to ``views/NAME/``.

    Returns
    -------
    dict of str to Seen
        By viewpoint.
    """
    digest = array_digest(eia, noise)
    looks = _Looks(job, eia, noise)
    seen = {}
    for viewpoint in job.plan.viewpoints:
        parts = look_parts(job) | {
            "EIA": digest,
            "viewpoint": [*viewpoint.position_mm, viewpoint.pupil_mm, viewpoint.focus_mm],
        }
        with job.stage("reconstruct views"):
            found = job.memo.recall(
                f"view of {name}: {viewpoint.name}",
                parts,
                lambda viewpoint=viewpoint: looks.view(viewpoint),  # type: ignore[misc]
                told=lambda: ("looked at", "nothing", "its EIA or its eye is new"),
            )
        seen[viewpoint.name] = Seen(found.arrays["image"], found.arrays["noise"])
    with job.stage("write pictures"):
        for view, picture in seen.items():
            job.pictures.save(f"views/{name}/{view}", picture.image)
    return seen


class _Looks:
    """An EIA on the display, looked at by halves of the samples; shown when first looked at."""

    def __init__(self, job: Ledger, eia: np.ndarray, noise: np.ndarray | None) -> None:
        self._job, self._eia, self._noise = job, eia, noise

    def view(self, viewpoint: Viewpoint) -> Record:
        """What is seen of it, and the noise of that."""
        first, second = (self._look(self._shown, viewpoint, half) for half in (0, 1))
        moved = first if self._noise is None else self._look(self._moved, viewpoint, 0)
        image = np.float32(0.5) * (first + second)
        noise = np.float32(0.5) * (first - second) + (moved - first)
        return Record({"image": image, "noise": noise})

    @cached_property
    def _shown(self) -> Any:
        return self._display_scene(self._eia)

    @cached_property
    def _moved(self) -> Any:
        assert self._noise is not None
        moved: np.ndarray = self._eia + self._noise
        return self._display_scene(moved)

    def _display_scene(self, eia: np.ndarray) -> Any:
        self._job.use_renderer()
        from inim.render.reconstruct import DisplayScene

        return DisplayScene(eia, self._job.plan.mounted, self._job.plan.settings.lens_model)

    def _look(self, shown: Any, viewpoint: Viewpoint, half: int) -> np.ndarray:
        """A view by half of the samples."""
        job, s = self._job, self._job.plan.settings
        seen: np.ndarray = shown.view(
            viewpoint,
            pixels_per_lens=s.view_pixels_per_lens,
            spp=half_of(s.reconstruction_spp),
            seed=look_seeds(s.seed)[half],
            observer=job.listener,
        )
        return np.float32(white_exposure(job.plan.mounted, s.lens_model)) * seen


def half_of(spp: int) -> int:
    """Samples of each of two looks."""
    return max(1, spp // 2)


def look_seeds(seed: int) -> tuple[int, int]:
    """Of the two looks at any EIA: equal EIAs look equal."""
    return 2 * seed, 2 * seed + 1


def observed_pixels(job: Ledger) -> np.ndarray | None:
    """Panel pixels that the run's views have samples of, (rows, columns) bool; None: all may be."""
    plan, s = job.plan, job.plan.settings
    parts = look_parts(job) | {
        "viewpoints": [[*v.position_mm, v.pupil_mm, v.focus_mm] for v in plan.viewpoints]
    }

    def make() -> Record:
        job.use_renderer()
        from inim.render import reconstruct

        found = reconstruct.observed_pixels(
            plan.mounted,
            plan.viewpoints,
            s.lens_model,
            pixels_per_lens=s.view_pixels_per_lens,
            spp=half_of(s.reconstruction_spp),
            seeds=look_seeds(s.seed),
            observer=job.listener,
        )
        return Record({} if found is None else {"pixels": np.packbits(found, axis=1)})

    with job.stage("observed pixels"):
        arrays = job.memo.recall("observed panel pixels", parts, make).arrays
    if "pixels" not in arrays:
        return None
    return np.unpackbits(arrays["pixels"], axis=1, count=plan.display.eia_shape[1]).astype(bool)
