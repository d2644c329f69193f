"""Forms of an EIA that need no rendering: PDF, sub-aperture views and light field."""

from functools import partial
from pathlib import Path

import numpy as np
from PIL import Image

from inim.apps.export.source import ChosenEIA
from inim.image.color import to_srgb
from inim.image.files.eia_file import read_eia, write_true_size_pdf
from inim.image.files.image import read_rgbd
from inim.image.files.light_field import (
    centre_disparity,
    sub_aperture_views,
    view_grid,
    write_hci,
)
from inim.system.process.atomic_file import write_atomically


def write_lenslet_forms(
    eia: ChosenEIA, pdf: Path | None, views: Path | None, hci: Path | None
) -> list[Path]:
    """Write the given forms of an EIA, and return their paths.

    All forms are computed before the first one is written.
    """
    display = eia.design_display
    linear = read_eia(eia.path, display)[0]
    codes = to_srgb(linear)
    images = None if views is None else sub_aperture_views(codes, display)
    field = None if hci is None else _light_field(eia, codes)
    if pdf is not None:
        write_true_size_pdf(pdf, linear, display.pixel_pitch_mm)
    if views is not None and images is not None:
        _write_views(views, images)
    if hci is not None and field is not None:
        write_hci(hci, field[0], display, field[1])
    return [path for path in (pdf, views, hci) if path is not None]


def _light_field(chosen: ChosenEIA, codes: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    """Views; for a report also the disparity of the centre view."""
    display = chosen.design_display
    if chosen.report is None:
        return sub_aperture_views(codes, display), None
    down, across = (n - 1 + n % 2 for n in view_grid(display))  # odd, for a centre view
    rgbd = read_rgbd(chosen.report.folder / "rgbd.exr")
    views = sub_aperture_views(codes, display, (down, across))
    return views, centre_disparity(rgbd, display, across)


def _write_views(folder: Path, views: np.ndarray) -> None:
    for row, line in enumerate(views):
        for column, view in enumerate(line):
            save = partial(Image.fromarray(view).save, format="PNG")
            write_atomically(folder / f"view_{row:02}_{column:02}.png", save)
