"""An EIA for printing, and its views for other programs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from inim.system.errors import FileError, UsageError, ViewpointError
from inim.system.process.atomic_file import published_together

if TYPE_CHECKING:
    import numpy as np

    from inim.apps.export.quilt import QuiltRequest
    from inim.display import Display
    from inim.report import Report

#: Two whole numbers, across and down: ``(8, 6)`` or ``"8x6"``.
Pair = str | tuple[int, int]
#: Quilts of published devices, by their columns and rows of views: width and height of a view in
#: pixels, and its width over its height as seen, where its pixels are not square.
_QUILTS = {
    (8, 6): (420, 560, 0.75),
    (5, 9): (819, 455, 16 / 9),
    (7, 7): (857, 857, 16 / 9),
    (11, 6): (372, 682, 9 / 16),
}
#: Defaults of a quilt: tiles across and down, and samples per pixel.
TILES, SPP = "8x6", 32


@dataclass(frozen=True)
class _ChosenEIA:
    """EIA to export, with the design of its display and the misaligned display.

    `distance_mm` is the distance of the eyes, and `description` is the name of the EIA with the
    reason of its choice.
    """

    path: Path
    display: Display
    misaligned: Display
    lens_model: str
    distance_mm: float | None
    description: str
    report: Report | None = None
    is_truth: bool = False

    @property
    def design_display(self) -> Display:
        """Display for which the EIA was generated: algorithms use the design."""
        return self.misaligned if self.is_truth else self.display


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
    grid: Pair | None = None,
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
    grid : pair, optional
        Number of sub-aperture views; default: the pixels per lens.
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
    if native is not None:
        others: dict[str, object] = {
            "--pdf": pdf,
            "--views": views,
            "--hci": hci,
            "--quilt": quilt,
            "--grid": grid,
        }
        others |= {"--algorithms": algorithm, "--view-size": view_size, "--scene": scene}
        for option, other in others.items():
            if other is not None:
                raise UsageError(f"{option}: --native is for a quilt; leave one of them out")
        return [_write_native(Path(source), Path(native), display, definitions, tiles, aspect)]
    outputs = [None if path is None else Path(path) for path in (pdf, views, hci)]
    if not (any(outputs) or quilt):
        raise UsageError(
            "nothing to write: give --pdf FILE, --views DIR, --hci DIR, --quilt FILE or --native "
            "FILE"
        )
    for option, path in zip(("--views", "--hci"), outputs[1:], strict=True):
        if path is not None and path.exists() and not path.is_dir():
            raise FileError(f"{option} {path}: is a file; name a folder")
    of_quilt = {"tiles": tiles, "view-size": view_size, "aspect": aspect, "view-spp": view_spp}
    for option, value in {**of_quilt, "scene": scene}.items():
        if value is not None and quilt is None:
            raise UsageError(f"--{option}: needs a quilt; add --quilt FILE")
    source = Path(source)
    if source.is_dir():
        chosen = _choose_from_report(source, algorithm, bool(display or definitions))
    else:
        chosen = _choose_eia(source, algorithm, display, definitions)
    request = None
    if quilt is not None:
        sizes = (tiles or TILES, view_size, aspect, view_spp)
        request = _quilt(chosen, Path(quilt), *sizes, scene, allow_folders)
        try:
            request.check()
        except ViewpointError as error:
            raise FileError(f"{source}: {error}") from None
    lenses = None if grid is None else _pair("--grid", grid, 10_000)[::-1]
    files = [path for path in outputs if path is not None]
    with published_together():
        if files:
            _write_sheet_and_views(chosen, outputs[0], outputs[1], outputs[2], lenses)
        if request is not None:
            from inim.apps.export.quilt import render_quilt

            render_quilt(request, quiet=quiet, debug=debug)
            files.append(request.file)
    if say is not None:
        say(f"exported {chosen.description}")
    return files


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
    from inim.render.scene_files.file import choose_display, parse_definitions

    design, _ = choose_display(display, parse_definitions(definitions or {}), "inim export")
    pair = None if tiles is None else _pair("--tiles", tiles, 1000)
    if aspect is not None and not 0.01 <= aspect <= 100:
        raise UsageError(f"--aspect {aspect:g}: must be width over height, such as 0.75")
    weave_file(source, out, design, pair, aspect)
    return out


def _pair(option: str, pair: Pair, most: int) -> tuple[int, int]:
    """Two whole numbers, across and down."""
    text = pair if isinstance(pair, str) else "x".join(map(str, pair))
    across, _, down = text.lower().partition("x")
    if not (across.isdecimal() and down.isdecimal() and 0 < int(across) * int(down) <= most):
        raise UsageError(f"{option} {text}: write ACROSSxDOWN, such as 9x9, of at most {most}")
    return int(across), int(down)


def _choose_eia(
    path: Path,
    algorithm: str | None,
    display: Display | str | Path | None,
    definitions: Mapping[str, Any] | None,
) -> _ChosenEIA:
    from inim.display.misalignment import misaligned
    from inim.image.files.eia_file import turned_for
    from inim.render.scene_files.file import choose_display, parse_definitions

    if algorithm:
        raise UsageError("--algorithms: needs a report's folder; an EIA has no algorithms")
    design, settings = choose_display(display, parse_definitions(definitions or {}), "inim export")
    design = turned_for(path, design)
    real, distance = misaligned(design, settings.misalign), settings.viewing_distance_mm
    return _ChosenEIA(path, design, real, settings.lens_model, distance, path.name)


def _choose_from_report(folder: Path, algorithm: str | None, has_display: bool) -> _ChosenEIA:
    """Chosen algorithm or the ground truth; by default the best by the headline score."""
    from inim.display.misalignment import misaligned
    from inim.report import TRUTH, Report

    if has_display:
        raise UsageError(
            f"{folder}: is a report, which has its own display; --display and -D are for an EIA"
        )
    report = Report.load(folder)
    name, why = (algorithm, "") if algorithm else _best(report)
    path, design = report.eia_path(name, "--algorithms"), report.display
    return _ChosenEIA(
        path,
        design,
        misaligned(design, report.data.misalign),
        report.data.lens_model,
        report.data.settings.viewing_distance_mm,
        name + why,
        report,
        name == TRUTH,
    )


def _best(report: Report) -> tuple[str, str]:
    """Best algorithm, with a phrase for the reason."""
    from inim.scores.metrics import HEADLINE_WORDS

    names, best = list(report.data.algorithms), report.data.best_algorithm
    if len(names) == 1:
        return names[0], ", the report's only algorithm"
    if best is None:
        raise UsageError(
            f"{report.folder}: has no scores to choose by; name one with --algorithms: "
            f"{', '.join([*names, 'truth'])}"
        )
    return best, f", the best of {len(names)} by {HEADLINE_WORDS}"


def _write_sheet_and_views(
    chosen: _ChosenEIA,
    pdf: Path | None,
    views: Path | None,
    hci: Path | None,
    grid: tuple[int, int] | None,
) -> None:
    from inim.image.color import to_srgb
    from inim.image.files.eia_file import read_eia, write_true_size_pdf
    from inim.image.files.light_field import sub_aperture_views, write_hci

    display = chosen.design_display
    eia = read_eia(chosen.path, display)[0]
    codes = to_srgb(eia)
    images = None if views is None else sub_aperture_views(codes, display, grid)
    field = None if hci is None else _light_field(chosen, codes, grid)
    if pdf is not None:
        write_true_size_pdf(pdf, eia, display.pixel_pitch_mm)
    if views is not None and images is not None:
        _write_views(views, images)
    if hci is not None and field is not None:
        write_hci(hci, field[0], display, field[1])


def _light_field(
    chosen: _ChosenEIA, codes: np.ndarray, grid: tuple[int, int] | None
) -> tuple[np.ndarray, np.ndarray | None]:
    """Views; for a report also the disparity of the centre view."""
    from inim.image.files.image import read_rgbd
    from inim.image.files.light_field import centre_disparity, sub_aperture_views, view_grid

    display = chosen.design_display
    if chosen.report is None:
        return sub_aperture_views(codes, display, grid), None
    if grid is None:  # odd numbers, for a centre view
        down, across = (n - 1 + n % 2 for n in view_grid(display))
    elif not (grid[0] % 2 and grid[1] % 2):
        raise UsageError(
            f"--grid {grid[1]}x{grid[0]}: has no centre view, which needs a disparity; use odd "
            "numbers"
        )
    else:
        down, across = grid
    rgbd = read_rgbd(chosen.report.folder / "rgbd.exr")
    views = sub_aperture_views(codes, display, (down, across))
    return views, centre_disparity(rgbd, display, across)


def _write_views(folder: Path, views: np.ndarray) -> None:
    from PIL import Image

    from inim.system.process.atomic_file import write_atomically

    for row, line in enumerate(views):
        for column, view in enumerate(line):
            save = partial(Image.fromarray(view).save, format="PNG")
            write_atomically(folder / f"view_{row:02}_{column:02}.png", save)


def _quilt(
    chosen: _ChosenEIA,
    out: Path,
    tiles: Pair,
    view_size: Pair | None,
    aspect: float | None,
    spp: int | None,
    scene: Path | str | None,
    allow_folders: Sequence[Path | str],
) -> QuiltRequest:
    from inim.apps.export.quilt import QuiltRequest, TracedScene

    if scene is not None and not chosen.is_truth:
        raise UsageError("--scene: needs the ground truth; add --algorithms truth")
    columns, rows = _pair("--tiles", tiles, 1000)
    if view_size is not None:
        width, height = _pair("--view-size", view_size, 2**28)
        default_aspect = width / height
    elif (columns, rows) in _QUILTS:
        width, height, default_aspect = _QUILTS[columns, rows]
    else:
        raise UsageError(f"--tiles {columns}x{rows}: unknown size of a tile; give --view-size WxH")
    truth = chosen.report if chosen.is_truth else None
    path = None if scene is None else Path(scene)
    folders = tuple(map(Path, allow_folders))
    return QuiltRequest(
        out=out,
        source=TracedScene.of(truth, path, folders) if truth else chosen.path,
        label=chosen.path,
        design=chosen.display,
        misaligned_display=chosen.misaligned,
        lens_model=chosen.lens_model,
        spp=SPP if spp is None else spp,
        distance_mm=chosen.distance_mm,
        columns=columns,
        rows=rows,
        width=width,
        height=height,
        aspect=default_aspect if aspect is None else aspect,
    )
