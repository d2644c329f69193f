"""Pictures of what changed, left beside a report that failed against its baseline."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np

from inim.files.image import write_png
from inim.pipeline.ledger import Ledger
from inim.regression import Evidence, Fingerprint
from inim.regression.difference_images import changed_pixels, tile_pictures

__all__ = ["FOLDER", "keep_fixed", "write_difference"]

#: Of a report: the candidate and, where it fails, pictures of the differences.
FOLDER = "regression"


def keep_fixed(
    job: Ledger,
    name: str,
    fixed: Callable[[], np.ndarray],
    new: Fingerprint,
    old: Fingerprint | None,
) -> None:
    """The changed EIA of the fixed picture, if it has, and where."""
    if old is None or old.eia_sha256 == new.eia_sha256 or old.sample.shape != new.sample.shape:
        return
    folder = job.folder / FOLDER / "fixed"
    write_png(folder / f"{name}-candidate.png", np.nan_to_num(fixed()))
    write_png(folder / f"{name}-difference.png", changed_pixels(old, new, job.plan.display))


def write_difference(folder: Path, name: str, baseline: Evidence, candidate: Evidence) -> bool:
    """The candidate's picture beside the baseline's tiles and what changed; whether it could be."""
    old, new = baseline.pictures[name], candidate.pictures.get(name)
    if new is None or (new.shape, new.tile) != (old.shape, old.tile):
        return False
    before, change = tile_pictures(old, new)
    target = folder / FOLDER / name
    write_png(target.with_name(f"{target.name}-baseline.png"), before)
    write_png(target.with_name(f"{target.name}-difference.png"), change)
    source = folder / f"{name}.png"
    if source.is_file():
        shutil.copyfile(source, target.with_name(f"{target.name}-candidate.png"))
    return True
