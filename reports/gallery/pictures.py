"""Pictures of reports, reduced for the gallery."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

from PIL import Image

#: Number of lenses along a side of a picture of `magnified`.
LENSES_MAGNIFIED = 12
_QUALITY = 85


def picture(path: Path) -> Image.Image:
    """Read a picture of a report."""
    with Image.open(path) as image:
        return image.convert("RGB")


def middle(path: Path) -> Image.Image:
    """Read the middle square of a picture, which shows the relic."""
    image = picture(path)
    side = min(image.size)
    left, top = ((length - side) // 2 for length in image.size)
    return image.crop((left, top, left + side, top + side))


def save_small(image: Image.Image, path: Path) -> None:
    """Write a strongly compressed picture."""
    image.save(path, quality=_QUALITY, method=6)


def magnified(
    eia: Path, display: Mapping[str, float], lens: tuple[int, int], width_px: int = 0
) -> Image.Image:
    """Magnify some elemental images, from the lens (column, row); each panel pixel is a square.

    The picture is at least `width_px` wide.
    """
    pixels = display["pixels_per_lens"]
    left, top = (round(pixels * at) for at in lens)
    side = round(pixels * LENSES_MAGNIFIED)
    crop = picture(eia).crop((left, top, left + side, top + side))
    large = side * max(2, math.ceil(width_px / side))
    return crop.resize((large, large), Image.Resampling.NEAREST)
