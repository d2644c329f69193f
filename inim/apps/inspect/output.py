"""Findings as text for a terminal, every number with its unit."""

import textwrap
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from inim.apps.inspect.document import InspectDocument, PixelChoice, Suitability, ViewingLimits
from inim.apps.inspect.geometry import (
    COVER_GLASS,
    PIXEL_STEPS,
    aperture_blur_mm,
    mode,
    pixel_footprint_mm,
    voxel_mm,
)
from inim.apps.inspect.suitability import sharp_depth_mm
from inim.display import Display
from inim.display.lens import lens_model as find_lens_model
from inim.display.panel import panel_words
from inim.report.labels import aligned

_COLUMNS = 100
_LABEL = 30
_MODES = {
    "real": "real: pictures stand in front of the lens array (g > f)",
    "virtual": "virtual: pictures stand behind the lens array (g < f)",
    "focused": "focused: g = f, no central depth plane; the depth range is a setting",
}
_SHARES = (
    ("own", "own elemental image"),
    ("neighbour", "under a neighbour"),
    ("past_lenses", "through the bare sheet"),
    ("beside_panel", "outside the panel"),
    ("dark_between", "dark between lenses"),
    ("blocked", "vignetted, total reflection"),
    ("reflected", "reflected at lens faces"),
    ("astray", "lost or misdirected, total"),
    ("crosstalk", "crosstalk in arriving light"),
)
# Of the light that arrives on a lenticular.
_VIEWS = ("of the eye's own view", "of neighbouring views", "of their neighbours", "of other views")


def as_text(data: InspectDocument) -> str:
    """Format all findings as text, without a final line break."""
    distance = f"{_n(data.viewing.distance_mm)} mm"
    point = "a far point" if mode(data.display) == "focused" else "a point at D"
    blocks = {
        f"Display {data.display.name}": _display(data) + _alignment(data.misalignment),
        "Depth": [*_depth(data), *_depth_range(data), *_voxels(data.display)],
        "Pixels per lens: benefit and cost": _choices(data),
        "Viewing": _viewing(data.viewing),
        f"Suitability for a viewer at {distance}": _suitability(data.suitability, data.display),
        f"Spot of {point} through one lens ({data.lens_model.name})": _spots(data),
        f"Light that reaches an eye at {distance}, % of the rays to the array": _light(data),
        "Notes": _notes(data.warnings),
    }
    return "\n\n".join("\n".join([title, *lines]) for title, lines in blocks.items() if lines)


def _line(label: str, value: str) -> str:
    return f"  {label:{_LABEL}}{value}"


def _row(label: str, cells: Iterable[str], width: int) -> str:
    return _line(label, "".join(f"{cell:>{width}}" for cell in cells))


def _n(value: float) -> str:
    """Number with at most four significant digits, and without a minus sign before zero."""
    return f"{value + 0.0:.4g}"


def _display(data: InspectDocument) -> list[str]:
    d = data.display
    rows, columns = d.eia_shape
    layers = []
    if d.layers:
        parts = ", ".join(f"{_n(thickness)} mm of n = {_n(n)}" for thickness, n in d.layers)
        measured = f"{_n(d.gap_mm + data.depth.layers_excess_mm)} mm geometrically"
        layers = [
            _line("layers from the lenses on", parts),
            _line("", f"gap g = {_n(d.gap_mm)} mm is air-equivalent, {measured}"),
        ]
    return [
        _line("array", f"{_n(d.width_mm)} x {_n(d.height_mm)} mm"),
        _line(
            "lenses",
            f"{d.layout.lens_counts()}, pitch {_n(d.pitch_mm)} mm, {d.lattice} lattice, "
            f"{d.aperture} apertures",
        ),
        _line(
            "",
            f"f = {_n(d.focal_length_mm)} mm, gap g = {_n(d.gap_mm)} mm, aperture "
            f"{_n(d.fill_factor * d.pitch_mm)} mm",
        ),
        *layers,
        _line("panel", f"{columns} x {rows} pixels of {_n(1e3 * d.pixel_pitch_mm)} µm"),
        _line("pixels per lens", f"{_n(d.pixels_per_lens)} pixels along one axis"),
        *(_line("panel light", sentence) for sentence in panel_words(d)),
        _line("lens model used below", data.lens_model.name),
    ]


def _alignment(misalignments: Sequence[str]) -> list[str]:
    if not misalignments:
        return []
    sentences = [
        *misalignments,
        "formulas hold for the aligned array; spots and light shares",
        "are traced through the misaligned array",
    ]
    return [_line("" if n else "misalignment", sentence) for n, sentence in enumerate(sentences)]


def _depth(data: InspectDocument) -> list[str]:
    """The central depth plane, also for a gap that was measured through glass."""
    d = data.display
    lines = [_line("mode", _MODES[mode(d)])]
    if mode(d) != "focused":
        lines += [
            _line("central depth plane D", f"{_n(d.central_depth_mm)} mm"),
            _line("scene pixel P_I at D", f"{_n(d.scene_pixel_mm)} mm"),
        ]
    wrong = data.depth.central_depth_if_measured_mm
    glass = "these layers" if d.layers else f"{_n(COVER_GLASS[0][0])} mm of cover glass"
    value = "none" if wrong is None else f"{_n(wrong)} mm"
    return [*lines, _line("D if g is a measured length", f"{value}, with {glass} in it")]


def _depth_range(data: InspectDocument) -> list[str]:
    d = data.display
    low, high = d.depth_range_mm
    origin = ""
    if d.depth_min_mm is not None:
        origin = " (from the settings)"
    elif d.depth_range_is_cut:
        origin = " (by the formula, cut off the array)"
    lines = [_line("depth range", f"{_n(low)} to {_n(high)} mm{origin}")]
    if mode(d) != "focused" and d.depth_min_mm is None:
        lines.append(_line("depth span by the formula", f"{_n(d.depth_span_mm)} mm"))
    return lines


def _voxels(d: Display) -> list[str]:
    low, high = d.depth_range_mm
    middle = {} if mode(d) == "focused" else {"at D": d.central_depth_mm}
    places = {"far end": low, **middle, "near end": high}
    parts: dict[str, Callable[[Display, float], Any]] = {
        "depth": lambda _, z: z,
        "voxel width, total:": voxel_mm,
        "  pixel footprint": pixel_footprint_mm,
        "  blur of the lens aperture": aperture_blur_mm,
    }
    return [
        _row("", places, 12),
        *(
            _row(label, (f"{_n(float(width_mm(d, z)))} mm" for z in places.values()), 12)
            for label, width_mm in parts.items()
        ),
    ]


def _choices(data: InspectDocument) -> list[str]:
    columns: dict[str, Callable[[PixelChoice], str]] = {
        "pixels/lens": lambda c: _n(c.pixels_per_lens),
        "pixel, µm": lambda c: _n(1e3 * c.pixel_pitch_mm),
        "views/lens": lambda c: f"{_n(c.views_across)} x {_n(c.views_down)}",
        "step, °": lambda c: f"{c.angular_step_deg:.3g}",
        "depth span, mm": lambda c: "-" if c.depth_span_mm is None else _n(c.depth_span_mm),
        "panel, pixels": lambda c: f"{c.panel_columns} x {c.panel_rows}",
        "MB/frame": lambda c: f"{c.frame_mb:.3g}",
    }
    names = ["", *("half  ", "this  ", "double")[: len(PIXEL_STEPS)]]
    cells = [[head, *map(value, data.pixels_per_lens)] for head, value in columns.items()]
    return [
        *(f"  {line}" for line in aligned([names, *cells])),
        f"  The picture has {data.display.layout.lens_counts()} points in each view, one per lens, "
        "independent of the pixels per lens.",
    ]


def _viewing(zone: ViewingLimits) -> list[str]:
    nearest = "none" if zone.nearest_distance_mm is None else f"{_n(zone.nearest_distance_mm)} mm"
    movement = "none: every eye sees flipped views"
    if not zone.zone_is_empty:
        up = "any up and down"
        if zone.flip_limit_y_mm is not None:
            up = f"±{_n(zone.flip_limit_y_mm)} mm (±{_n(zone.flip_limit_y_deg)}°) up and down"
        across = f"±{_n(zone.flip_limit_x_mm)} mm (±{_n(zone.flip_limit_x_deg)}°) across"
        movement = f"{across}, {up}"
    return [
        _line("viewing half angle of a lens", f"{_n(zone.half_angle_deg)}°"),
        _line("nearest distance, no flips", nearest),
        _line("viewing distance", f"{_n(zone.distance_mm)} mm"),
        _line("sideways eye movement", movement),
    ]


def _suitability(figures: Suitability, display: Display) -> list[str]:
    head = figures.head_movement_mm
    height = figures.zone_height_mm
    eyes = "no" if head is None else f"yes; the head may move by ±{_n(round(head, 3))} mm"
    tall = "any height" if height is None else f"{_n(height)} mm"
    accuracy = figures.accuracy
    ideal = ""
    if mode(display) == "focused":
        ideal = f"; with ideal lenses {_n(sharp_depth_mm(display))} mm"
    return [
        _line("finest detail", f"{_n(figures.detail_mm)} mm at the worst depth of the range"),
        _line("details across", f"{figures.details_across:.0f}"),
        _line("sharp depth", f"{_n(figures.sharp_depth_mm)} mm{ideal}"),
        _line("viewing zone", f"{_n(figures.zone_width_mm)} x {tall}"),
        _line("two eyes fit", eyes),
        _line("brightness", f"{100 * figures.brightness:.0f} % of the panel's"),
        _line(
            "alignment to be known to",
            f"{_n(1e3 * accuracy['shift_x_mm'])} µm, {_n(accuracy['rotation_deg'])}°, pitch "
            f"{_n(1e3 * accuracy['pitch_mm'])} µm, gap {_n(1e3 * accuracy['gap_mm'])} µm",
        ),
    ]


def _spots(data: InspectDocument) -> list[str]:
    diffraction = f"{data.diffraction_px:.3f} pixels, in no lens model"
    lines = [_line("diffraction, λ g / (P p)", diffraction)]
    for spot in data.spots:
        colour = "" if spot.colour == "all" else f", {spot.colour}"
        lost = f", {100 * spot.lost_share:.3g} % of its rays lost" if spot.lost_share else ""
        size = "no ray reaches the panel"
        if spot.rms_radius_um is not None and spot.rms_radius_px is not None:
            size = (
                f"RMS radius {spot.rms_radius_um:6.2f} µm = {spot.rms_radius_px:.3f} pixels{lost}"
            )
        lines.append(_line(f"at {spot.field_angle_deg:.3g}°{colour}", size))
    if not find_lens_model(data.lens_model.name).refracts:
        lines.append("  Without refraction, the spot is the spread of a cell's directions.")
    return lines


def _light(data: InspectDocument) -> list[str]:
    eyes = data.viewing.viewpoints
    rows = {
        "eye": [eye.name for eye in eyes],
        "x, mm": [f"{eye.position_mm[0] + 0.0:.1f}" for eye in eyes],
        "y, mm": [f"{eye.position_mm[1] + 0.0:.1f}" for eye in eyes],
    }
    for name, label in _SHARES:
        shares = [getattr(data.light[eye.name], f"{name}_share") for eye in eyes]
        rows[f"{label}, %"] = ["-" if s is None else f"{100 * s + 0.0:.2f}" for s in shares]
    shares_by_view = zip(*(data.views[eye.name] for eye in eyes), strict=True)
    for label, of_view in zip(_VIEWS, shares_by_view, strict=False):  # none without a lenticular
        rows[f"{label}, %"] = [f"{100 * share:.1f}" for share in of_view]
    return [_row(label, cells, 9) for label, cells in rows.items()]


def _notes(warnings: Sequence[str]) -> list[str]:
    wrap = textwrap.TextWrapper(_COLUMNS, initial_indent="  * ", subsequent_indent="    ").wrap
    return [line for sentence in warnings for line in wrap(sentence)]
