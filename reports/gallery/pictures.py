"""Pictures of reports, made small."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from PIL import Image

#: Along a side of what `magnified` shows.
LENSES_MAGNIFIED = 12
_QUALITY = 85


def picture(path: Path) -> Image.Image:
    """A picture of a report."""
    with Image.open(path) as image:
        return image.convert("RGB")


def middle(path: Path) -> Image.Image:
    """Its middle square, where the relic is."""
    image = picture(path)
    side = min(image.size)
    left, top = ((length - side) // 2 for length in image.size)
    return image.crop((left, top, left + side, top + side))


def keep(image: Image.Image, path: Path) -> None:
    """Write it small."""
    image.save(path, quality=_QUALITY, method=6)


def magnified(eia: Path, display: Mapping[str, float], lens: tuple[int, int]) -> Image.Image:
    """Some lenses of an EIA from a lens (column, row) on, each panel pixel a square."""
    pixels = display["pixels_per_lens"]
    left, top = (round(pixels * at) for at in lens)
    side = round(pixels * LENSES_MAGNIFIED)
    crop = picture(eia).crop((left, top, left + side, top + side))
    return crop.resize((2 * side, 2 * side), Image.Resampling.NEAREST)
