"""The virtual display of a report or of an EIA as one page, which needs no rendering.

A report's panels and views are in its folder; the replacement views of a single EIA come from the
lens models in NumPy.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from inim.display import Display
from inim.display.misalignment import misaligned
from inim.display.viewpoint import parse_viewpoints
from inim.image.color import to_srgb
from inim.image.files.eia_file import read_eia, turned_for
from inim.render.scene_files.file import choose_display
from inim.report import Report
from inim.report.images import ENCODINGS, ReportImages
from inim.report.page import Section, render_page, text
from inim.report.sections.virtual_display import report_display
from inim.report.virtual_display import (
    ANCHOR,
    LIVE,
    TITLE,
    Panel,
    Still,
    live_display,
    shown_lens_model,
    still_view,
)
from inim.scores.document_parts import EyePosition
from inim.system.document import write_text
from inim.system.errors import FileError
from inim.system.process.threads import threads
from inim.system.version import __version__

#: Largest size of a page.
MOST_BYTES = 60_000_000


def view_report(folder: Path, out: Path) -> None:
    """Write the virtual display of a report, with all its panels, as the page `out`.

    Raises `FileError` if the report is missing or has no panels.
    """
    report = Report.load(folder)
    pictures = ReportImages(report.folder, ENCODINGS[0])
    content = report_display(report.data, pictures, most_bytes=MOST_BYTES)
    if not LIVE.is_in(content):
        raise FileError(
            f"{folder}: the report's panels cannot be shown (missing, of another size than its "
            "display, or too large); run inim validate again"
        )
    page = _page(report.data.title or folder.name, f"Display {report.display.name}", content)
    _write_page(out, page)


def view_eia(
    eia: Path,
    out: Path,
    display: Display | str | Path | None = None,
    definitions: Mapping[str, Any] | None = None,
    most_bytes: int = MOST_BYTES,
) -> None:
    """Write the virtual display of an EIA as the page `out`.

    The EIA is a PNG (sRGB) or EXR (linear) of the panel's size. Display and definitions are those
    of `inim.render.scene_files.file.choose_display`. `most_bytes` limits the size of the EIA in the
    page: a large one is compressed.
    """
    design, settings = choose_display(display, definitions, "inim view")
    design = turned_for(eia, design)
    viewpoints = parse_viewpoints(settings.viewpoints, design, settings.viewing_distance_mm)
    eyes = [EyePosition(name=v.name, position_mm=v.position_mm) for v in viewpoints]
    real = misaligned(design, settings.misalign)
    codes = to_srgb(read_eia(eia, real)[0])
    model, size = shown_lens_model(real, settings.lens_model), settings.view_pixels_per_lens
    with threads() as submit:
        views = [
            submit(still_view, codes, real, eye.position_mm, model, pixels_per_lens=size)
            for eye in eyes
        ]
        stills = [
            Still(eye.name, f"{model} lenses", view.result())
            for eye, view in zip(eyes, views, strict=True)
        ]
    content = live_display(
        real,
        [Panel(eia.stem, codes)],
        eyes,
        stills,
        ReportImages(eia.parent, ENCODINGS[0]),
        most_bytes=most_bytes,
        lens_model=settings.lens_model,
    )
    if not LIVE.is_in(content):
        raise FileError(
            f"{eia}: {real.eia_shape[1]} x {real.eia_shape[0]} pixels are too many for one page of "
            f"{most_bytes / 1e6:g} MB; make one for a display of fewer pixels"
        )
    page = _page(eia.name, f"Display {_words(real)}", content)
    _write_page(out, page)


def _words(display: Display) -> str:
    lenses = display.layout.lens_counts("×")
    return f"{display.name}: {lenses} lenses of {display.pitch_mm:g} mm"


def _page(title: str, facts: str, content: str) -> str:
    """Self-contained HTML page."""
    return render_page(
        title,
        [text(facts)],
        [Section(ANCHOR, TITLE, content)],
        window_title=f"{title} – inim virtual display",
        footer=f"inim {__version__}",
        widgets=[LIVE],
    )


def _write_page(path: Path, page: str) -> None:
    if path.is_dir():
        raise FileError(f"{path}: is a folder; name a file with -o")
    write_text(path, page)
