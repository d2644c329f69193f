"""Inspection of a display by its name, file or value."""

from __future__ import annotations

import math
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

from inim.display import DISPLAYS, Display
from inim.display.misalignment import misaligned
from inim.display.viewpoint import default_distance_mm
from inim.errors import UsageError, suggest_words
from inim.inspection.findings import DEFAULT_LENS_MODEL, Inspection, inspect_display
from inim.lens import LensModel, LensModelName, lens_model_name
from inim.lens import lens_model as find_lens_model
from inim.process.atomic_file import file_errors
from inim.scene.file import choose_display, parse_definitions


def inspect(
    display: Display | str | Path = "nominal",
    *,
    definitions: Mapping[str, Any] | None = None,
    lens_model: LensModelName | LensModel | None = None,
    distance_mm: float | None = None,
    out: Path | str | None = None,
) -> Inspection:
    """Compute depth, viewing zone and resolution of a display, as `inim inspect` does.

    Parameters
    ----------
    display : Display, str or path
        A display, the name of a preset, or the path of a scene or display file.
    definitions : mapping, optional
        Settings to override: ``{"inim.gap_mm": 3.2}``.
    lens_model : {"pinhole", "thin", "thick", "full"} or LensModel, optional
        Of another package, pass the registered `inim.lens.LensModel`; its name works, too.
        Default: the file's, or ``"thick"`` if such lenses can be manufactured.
    distance_mm : float, optional
        Viewing distance; default: the file's, or twice the nearest usable distance.
    out : path, optional
        Folder for `inspect.json`, `.svg` and `.png`.

    Returns
    -------
    Inspection
        Its `document` has the values; `print` shows them as text.

    Raises
    ------
    InimError
        An unknown display, an impossible value, or a folder that cannot be written.
    """
    source = display.name if isinstance(display, Display) else str(display)
    changes = parse_definitions(definitions or {})
    design, settings = choose_display(_checked(display), changes, source)
    distance = settings.viewing_distance_mm if distance_mm is None else distance_mm
    if distance is not None and not (math.isfinite(distance) and distance > 0):
        raise UsageError(f"--distance {distance:g}: give a distance above 0, in millimetres")
    model = find_lens_model(settings.lens_model)
    stated = model.name if model.mesh is None else model.stand_in  # a mesh is for the renderer
    default = None if stated == DEFAULT_LENS_MODEL else stated
    inspection = inspect_display(
        design,
        default_distance_mm(design) if distance is None else distance,
        misaligned=misaligned(design, settings.misalign),
        lens_model=lens_model_name(lens_model) if lens_model else default,
        source=source,
    )
    return inspection if out is None else _write(inspection, Path(out))


def _checked(display: Display | str | Path) -> Display | str | Path:
    """A display, the name of a preset, or the path of a file."""
    if isinstance(display, Display) or display in DISPLAYS:
        return display
    if isinstance(display, PathLike) or display.lower().endswith(".xml") or Path(display).exists():
        return Path(display)
    raise UsageError(
        f"{display}: neither a scene file nor a preset; give a .xml file, or "
        f"{suggest_words(display, DISPLAYS)}; and change single values with -D inim.KEY=VALUE"
    )


def _write(inspection: Inspection, folder: Path) -> Inspection:
    """Write the figure, then the JSON, which marks a complete result."""
    from inim.documents.files import write_document
    from inim.inspection.figure import draw_figure

    with file_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    figures = draw_figure(inspection, folder, "inspect")
    write_document(folder / "inspect.json", inspection.document)
    return inspection._replace(files=(*figures, "inspect.json"))
