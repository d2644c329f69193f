"""Inspection of a display by its name, file or value: one value, and warnings in sentences."""

import math
from collections.abc import Iterator, Mapping
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

from msgspec.structs import replace

from inim.apps.inspect.document import InspectDocument, TracedModel
from inim.apps.inspect.geometry import (
    PIXEL_STEPS,
    array_samples,
    crosstalk_map,
    depth_figures,
    diffraction_px,
    has_whole_pixels,
    light_shares,
    pixel_choice,
    size_of,
    view_shares,
    viewing_limits,
    voxel_widths,
)
from inim.apps.inspect.output import as_text
from inim.apps.inspect.spots import Spot, spots
from inim.apps.inspect.suitability import suitability
from inim.display import DISPLAYS, Display
from inim.display.lens import LensModel, LensModelName, check_lens_model, lens_model_name
from inim.display.lens import lens_model as find_lens_model
from inim.display.misalignment import misaligned
from inim.display.pixels import least_gap_mm
from inim.display.settings import Settings
from inim.display.viewpoint import default_distance_mm
from inim.generators.accuracy_limits import lenses_beside_panel
from inim.render.scene_files.file import choose_display
from inim.system.document import write_document
from inim.system.errors import DisplayError, UsageError
from inim.system.process.atomic_file import file_errors
from inim.system.version import __version__

#: Tried first where none is chosen.
DEFAULT_LENS_MODEL = Settings.lens_model
_MOST_CROSSTALK = 0.01
# Above this, diffraction is no longer small against a pixel.
_MOST_DIFFRACTION_PX = 0.1
# Fields in which a mounted array may differ from its design, and the words for a positive and a
# negative number.
_DIRECTIONS = {
    "rotation_deg": ("turned by {}° counter-clockwise", "turned by {}° clockwise"),
    "shift_x_mm": ("moved {} mm to the right", "moved {} mm to the left"),
    "shift_y_mm": ("moved {} mm up", "moved {} mm down"),
    "tilt_x_deg": ("tilted by {}°: gap grows to the right", "tilted by {}°: gap grows to the left"),
    "tilt_y_deg": ("tilted by {}°: gap grows upwards", "tilted by {}°: gap grows downwards"),
}


class Inspection(NamedTuple):
    """Properties of a display, and the spots with their points for the figure.

    `files` are the names of the files written. As text, it is what `inim inspect` prints.
    """

    document: InspectDocument
    spots: tuple[Spot, ...]
    files: tuple[str, ...] = ()

    def __str__(self) -> str:
        return as_text(self.document)


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
        Of another package, pass the registered `inim.display.lens.LensModel`; its name works, too.
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
    design, settings = choose_display(_named_display(display), definitions, source)
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


def _named_display(display: Display | str | Path) -> Display | str | Path:
    """A display, the name of a preset, or the path of a file."""
    if isinstance(display, Display) or display in DISPLAYS:
        return display
    is_file = isinstance(display, PathLike) or display.lower().endswith((".xml", ".json"))
    if is_file or Path(display).exists():
        return Path(display)
    raise UsageError(
        f"{display}: neither a file nor a preset; give a .xml or visual.json file, or "
        f"{DISPLAYS.suggest(display)}; and change single values with -D inim.KEY=VALUE"
    )


def _write(inspection: Inspection, folder: Path) -> Inspection:
    """Write the figure, then the JSON, which marks a complete result."""
    from inim.apps.inspect.figure import draw_figure

    with file_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    figures = draw_figure(inspection, folder, "inspect")
    write_document(folder / "inspect.json", inspection.document)
    return inspection._replace(files=(*figures, "inspect.json"))


def usable_model(chosen: str | None, display: Display) -> tuple[str, str | None]:
    """Lens model to use, and the reason if the default was replaced.

    Raises `InimError`: a chosen model that does not exist or cannot be made.
    """
    if chosen is not None:
        check_lens_model(chosen, display)
        return chosen, None
    try:
        check_lens_model(DEFAULT_LENS_MODEL, display)
    except DisplayError as error:
        return find_lens_model(DEFAULT_LENS_MODEL).stand_in, str(error)
    return DEFAULT_LENS_MODEL, None


def inspect_display(
    design: Display,
    distance_mm: float,
    *,
    misaligned: Display | None = None,
    lens_model: str | None = None,
    source: str = "",
) -> Inspection:
    """Compute the properties of a display at a viewing distance.

    * `distance_mm`: viewing distance.
    * `misaligned`: misaligned display, if different from the design.
    * `lens_model`: default: `DEFAULT_LENS_MODEL`, or its replacement if such lenses cannot be
      manufactured.
    * `source`: source of the display.

    Raises `InimError`: an impossible lens model, or a tilted panel that meets the array.
    """
    real = design if misaligned is None else misaligned
    least_gap_mm(real)
    model, reason = usable_model(lens_model, real)
    zone = viewing_limits(design, distance_mm)
    samples = array_samples(real)
    all_spots = spots(real, model, design.central_depth_mm)
    light = {
        eye.name: light_shares(design, real, model, eye.position_mm, samples)
        for eye in zone.viewpoints
    }
    document = InspectDocument(
        inim_version=__version__,
        source=source,
        display=design,
        lens_model=TracedModel(name=model, reason=reason),
        size=size_of(design),
        depth=depth_figures(design),
        pixels_per_lens=[pixel_choice(design, times) for times in PIXEL_STEPS],
        viewing=zone,
        suitability=suitability(design, distance_mm, model, all_spots, light["centre"]),
        voxel=voxel_widths(design),
        diffraction_px=diffraction_px(design),
        spots=[spot.figures() for spot in all_spots],
        light=light,
        crosstalk=crosstalk_map(design, real, model, distance_mm),
        views={
            eye.name: view_shares(
                design, real, model, eye.position_mm, design.layout.directions[0], samples
            )
            for eye in zone.viewpoints
        },
        misalignment=misalignments(design, real),
        warnings=[],
    )
    return Inspection(replace(document, warnings=cautions(document)), all_spots)


def cautions(data: InspectDocument) -> list[str]:
    """Warnings, followed by hints; one or two sentences each."""
    return [
        *lenses_beside_panel(data.display),
        *_depth_findings(data.display),
        *_layer_findings(data),
        *_viewing_findings(data),
        *_lens_findings(data),
        *_crosstalk_findings(data),
        *_pixel_findings(data.display),
    ]


def misalignments(design: Display, misaligned: Display) -> list[str]:
    """Misalignments of the array, and the part that the EIA does not correct."""
    sentences = []
    for name, words in _DIRECTIONS.items():
        nominal = getattr(design, name)
        unknown = getattr(misaligned, name) - nominal
        for value, origin in ((nominal, "in the design"), (unknown, "not in the design")):
            if value:
                direction = words[0 if value > 0 else 1].format(f"{abs(value):.4g}")
                sentences.append(f"array {direction} ({origin})")
    off = misaligned.gap_mm - design.gap_mm
    if off:
        side = "far from" if off > 0 else "close to"
        sentences.append(f"array {abs(off):.4g} mm too {side} the panel (not in the design)")
    off = misaligned.pitch_mm - design.pitch_mm
    if off:
        direction = "far apart" if off > 0 else "close together"
        sentences.append(f"lenses {abs(off):.4g} mm too {direction} (not in the design)")
    return sentences


def _depth_findings(display: Display) -> Iterator[str]:
    low, high = display.depth_range_mm
    if display.depth_range_is_cut:
        yield (
            f"Depth range cut: the formula's {display.depth_span_mm:.4g} mm about the central "
            f"depth plane cross the lens array, so it is cut to {low:.4g} to {high:.4g} mm. "
            "More pixels per lens would make the formula valid."
        )


def _layer_findings(data: InspectDocument) -> Iterator[str]:
    display, excess = data.display, data.depth.layers_excess_mm
    depth, (low, high) = data.depth.central_depth_if_measured_mm, display.depth_range_mm
    if excess and (depth is None or not low <= depth <= high):
        position = "nowhere" if depth is None else f"at {depth:.4g} mm"
        yield (
            f"Layers: gap_mm is air-equivalent. If the {display.gap_mm:.4g} mm are a measured "
            f"length with the layers in it, set gap_mm to {display.gap_mm - excess:.4g}: the "
            f"central depth plane is then {position} instead of at "
            f"{display.central_depth_mm:.4g} mm, outside the depth range."
        )


def _viewing_findings(data: InspectDocument) -> Iterator[str]:
    zone = data.viewing
    at = f"at {zone.distance_mm:.4g} mm"
    if zone.zone_is_empty:
        yield f"Viewing zone empty {at}: every eye sees flipped views; {_way_out(data)}."
    nearest_point = data.display.depth_range_mm[1]
    if zone.distance_mm <= nearest_point:
        yield f"Eye inside the picture {at}: the depth range ends at {nearest_point:.4g} mm."


def _way_out(data: InspectDocument) -> str:
    """Hint to the location of the viewing zone."""
    zone, display = data.viewing, data.display
    if zone.nearest_distance_mm is None:
        return "every distance has flips: elemental_pitch_mm and pitch_mm differ too much"
    if zone.nearest_distance_mm > zone.distance_mm:
        return f"move back to {zone.nearest_distance_mm:.4g} mm at least"
    # All lenses show an eye their middles at V = g / (Q / P - 1).
    aim = display.gap_mm / (display.elemental_image_pitch_mm / display.pitch_mm - 1)
    return f"the elemental images are for an eye at {aim:.4g} mm: move closer"


def _lens_findings(data: InspectDocument) -> Iterator[str]:
    if data.lens_model.reason is not None:
        yield (
            f"The {DEFAULT_LENS_MODEL} lens cannot be manufactured, so {data.lens_model.name} "
            f"lenses are used: {data.lens_model.reason}."
        )
    if not find_lens_model(data.lens_model.name).refracts:  # no spot could be too large
        return
    pixel_um = 1e3 * data.display.pixel_pitch_mm
    radii = [(s.rms_radius_um or 0.0, s.field_angle_deg) for s in data.spots]
    large = [(radius, angle) for radius, angle in radii if 2 * radius > pixel_um]
    if large:
        (radius, angle), first = max(large, key=lambda s: s[0]), min(angle for _, angle in large)
        position = "the axis" if first == 0 else f"{first:.3g}°"
        yield (
            f"Spot larger than a pixel from {position} outwards: up to "
            f"{2 * radius:.3g} µm across (twice the RMS radius, at "
            f"{angle:.3g}°) on pixels of {pixel_um:.3g} µm; "
            "neighbouring directions blend."
        )
    if data.diffraction_px > _MOST_DIFFRACTION_PX:
        yield (
            f"Diffraction: {data.diffraction_px:.2g} pixels, more than {_MOST_DIFFRACTION_PX:g}. "
            "No lens model includes it, so views are less sharp than computed; larger lenses or "
            "pixels reduce it."
        )


def _crosstalk_findings(data: InspectDocument) -> Iterator[str]:
    share = data.light["centre"].crosstalk_share
    if share is None:
        yield "No light of the panel reaches the eye on the axis."
    elif share > _MOST_CROSSTALK:
        yield (
            f"Crosstalk on the axis: {100 * share:.3g} % of the light comes from under a "
            f"neighbouring lens (more than {100 * _MOST_CROSSTALK:g} %)."
        )


def _pixel_findings(display: Display) -> Iterator[str]:
    if not (has_whole_pixels(display) or display.layout.of_cylinders):
        down = display.elemental_row_pitch_mm / display.pixel_pitch_mm
        yield (
            f"For information: {display.pixels_per_lens:.4g} x {down:.4g} pixels per lens, not a "
            "whole number. Each pixel belongs to the lens whose cell holds its centre."
        )
