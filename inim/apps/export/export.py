"""An EIA for printing, and its views for other programs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from inim.apps.export.tiles import (
    SPP,
    Pair,
    Tiles,
    check_aspect,
    parse_tile_counts,
    parse_tiles,
)
from inim.system.errors import FileError, UsageError, ViewpointError
from inim.system.process.atomic_file import published_together

if TYPE_CHECKING:
    from inim.apps.export.quilt import QuiltRequest
    from inim.apps.export.source import ChosenEIA
    from inim.display import Display


def export(
    source: Path | str,
    *,
    pdf: Path | str | None = None,
    views: Path | str | None = None,
    hci: Path | str | None = None,
    quilt: Path | str | None = None,
    algorithm: str | None = None,
    display: Display | str | Path | None = None,
    definitions: Mapping[str, Any] | None = None,
    tiles: Pair | None = None,
    view_size: Pair | None = None,
    aspect: float | None = None,
    view_spp: int | None = None,
    native: Path | str | None = None,
    scene: Path | str | None = None,
    allow_folders: Sequence[Path | str] = (),
    quiet: bool = True,
    debug: bool = False,
    say: Callable[[str], object] | None = None,
) -> list[Path]:
    """Write an EIA as a PDF to print, as sub-aperture views, as a light field, or as a quilt.

    At least one of `pdf`, `views`, `hci` and `quilt` is required; or `native`, for which the source
    is a quilt. Pairs, across and down, are
    ``(8, 6)`` or ``"8x6"``.

    Parameters
    ----------
    source : path
        Folder of a report, or an EIA (.png, .exr); a quilt (.png, .jpg) for `native`.
    pdf : path, optional
        PDF that prints at true size.
    views, hci : path, optional
        Folders for sub-aperture views (``view_ROW_COLUMN.png``) and for an HCI light field.
    quilt : path, optional
        PNG of views rendered through the lens array; ``_qsCOLSxROWSaASPECT`` is added to its name.
    native : path, optional
        Native picture of a slanted lenticular display, .png, woven from a quilt of any program.
    algorithm : str, optional
        Algorithm of the report, or ``"truth"``; default: the best.
    display, definitions : optional
        Display of an EIA, as for `inim.validate`; a report has its own.
    tiles, view_size : pair, optional
        Tiles of the quilt (8x6), and the size of a tile in pixels.
    aspect : float, optional
        Displayed width of a tile over its height; default: square pixels.
    view_spp : int, optional
        Samples per pixel of a tile (32).
    scene : path, optional
        New path of the report's scene, for a quilt of the ground truth.
    allow_folders : sequence of path
        Additional folders for files that the scene references.
    quiet, debug : bool
        As for `inim.apps.export.quilt.render_quilt`.
    say : callable, optional
        Receives a sentence about the chosen EIA.

    Returns
    -------
    list of Path
        Files and folders written.

    Raises
    ------
    InimError
        Contradictory or impossible choices, unreadable files, or no usable backend.
    """
    source = Path(source)
    if native is not None:
        _refuse(
            "--native is for a quilt; leave one of them out",
            {"pdf": pdf, "views": views, "hci": hci, "quilt": quilt}
            | {"algorithms": algorithm, "view-size": view_size, "scene": scene},
        )
        return [_write_native(source, Path(native), display, definitions, tiles, aspect)]
    _check_outputs(pdf, views, hci, quilt)
    if quilt is None:
        _refuse(
            "needs a quilt; add --quilt FILE",
            {"tiles": tiles, "view-size": view_size, "aspect": aspect}
            | {"view-spp": view_spp, "scene": scene},
        )
    from inim.apps.export.source import choose

    eia = choose(source, algorithm, display, definitions)
    request = None
    if quilt is not None:
        sizes = parse_tiles(tiles, view_size, aspect)
        spp = SPP if view_spp is None else view_spp
        request = _quilt_request(eia, Path(quilt), sizes, spp, scene, allow_folders)
        try:
            request.check()
        except ViewpointError as error:
            raise FileError(f"{source}: {error}") from None
    sheet, folder, field = (None if path is None else Path(path) for path in (pdf, views, hci))
    files = []
    with published_together():
        if sheet or folder or field:
            from inim.apps.export.lenslet_forms import write_lenslet_forms

            files += write_lenslet_forms(eia, sheet, folder, field)
        if request is not None:
            from inim.apps.export.quilt import render_quilt

            render_quilt(request, quiet=quiet, debug=debug)
            files.append(request.file)
    if say is not None:
        say(f"exported {eia.description}")
    return files


def _refuse(reason: str, options: Mapping[str, object]) -> None:
    """Raise `UsageError` if any of the options has a value."""
    for name, value in options.items():
        if value is not None:
            raise UsageError(f"--{name}: {reason}")


def _check_outputs(
    pdf: Path | str | None,
    views: Path | str | None,
    hci: Path | str | None,
    quilt: Path | str | None,
) -> None:
    """Raise `InimError` if there is no output, or if a folder's path is a file."""
    if not (pdf or views or hci or quilt):
        raise UsageError(
            "nothing to write: give --pdf FILE, --views DIR, --hci DIR, --quilt FILE or --native "
            "FILE"
        )
    for option, path in (("--views", views), ("--hci", hci)):
        if path is not None and Path(path).exists() and not Path(path).is_dir():
            raise FileError(f"{option} {path}: is a file; name a folder")


def _write_native(
    source: Path,
    out: Path,
    display: Display | str | Path | None,
    definitions: Mapping[str, Any] | None,
    tiles: Pair | None,
    aspect: float | None,
) -> Path:
    """Write the native picture of a quilt."""
    from inim.apps.export.native import weave_file
    from inim.render.scene_files.file import choose_display

    design, _ = choose_display(display, definitions, "inim export")
    counts = None if tiles is None else parse_tile_counts(tiles)
    if aspect is not None:
        check_aspect(aspect)
    weave_file(source, out, design, counts, aspect)
    return out


def _quilt_request(
    eia: ChosenEIA,
    out: Path,
    tiles: Tiles,
    spp: int,
    scene: Path | str | None,
    allow_folders: Sequence[Path | str],
) -> QuiltRequest:
    """Request for the quilt of an EIA; the quilt of the ground truth is of its scene."""
    from inim.apps.export.quilt import QuiltRequest, TracedScene

    if scene is not None and not eia.is_truth:
        raise UsageError("--scene: needs the ground truth; add --algorithms truth")
    source: Path | TracedScene = eia.path
    if eia.is_truth and eia.report is not None:
        path = None if scene is None else Path(scene)
        source = TracedScene.of(eia.report, path, tuple(map(Path, allow_folders)))
    return QuiltRequest(
        out=out,
        source=source,
        label=eia.path,
        design=eia.display,
        misaligned_display=eia.misaligned,
        lens_model=eia.lens_model,
        spp=spp,
        distance_mm=eia.distance_mm,
        **tiles._asdict(),
    )
