"""Findings as text for a terminal, every number with its unit."""

from __future__ import annotations

import textwrap
from collections.abc import Callable

from inim.apps.inspect.document import InspectDocument, PixelChoice
from inim.apps.inspect.geometry import (
    COVER_GLASS,
    PIXEL_STEPS,
    aperture_blur_mm,
    mode,
    pixel_footprint_mm,
    voxel_mm,
)
from inim.display.lens import lens_model as find_lens_model
from inim.display.panel import panel_words

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
    blocks = [
        _display(data),
        _depth_lines(data),
        _choices(data),
        _viewing_lines(data),
        _suitability_lines(data),
        _spots(data),
        _light_lines(data),
        _warnings(data),
    ]
    return "\n\n".join("\n".join(block) for block in blocks if block)


def _line(label: str, value: str) -> str:
    return f"  {label:{_LABEL}}{value}"


def _n(value: float) -> str:
    """Number with at most four significant digits, and without a minus sign before zero."""
    return f"{value + 0.0:.4g}"


def _display(data: InspectDocument) -> list[str]:
    d = data.display
    rows, columns = d.eia_shape
    lens = f"f = {_n(d.focal_length_mm)} mm, gap g = {_n(d.gap_mm)} mm"
    lines = [
        f"Display {d.name}",
        _line("array", f"{_n(d.width_mm)} x {_n(d.height_mm)} mm"),
        _line(
            "lenses",
            f"{d.layout.lens_counts()}, pitch {_n(d.pitch_mm)} mm, {d.lattice} lattice, "
            f"{d.aperture} apertures",
        ),
        _line("", f"{lens}, aperture {_n(d.fill_factor * d.pitch_mm)} mm"),
        *_layers(data),
        _line("panel", f"{columns} x {rows} pixels of {_n(1e3 * d.pixel_pitch_mm)} µm"),
        _line("pixels per lens", f"{_n(d.pixels_per_lens)} pixels along one axis"),
        *(_line("panel light", sentence) for sentence in panel_words(d)),
        _line("lens model used below", data.lens_model.name),
    ]
    off = data.misalignment
    lines += [_line("misalignment" if n == 0 else "", sentence) for n, sentence in enumerate(off)]
    if off:
        lines += [
            _line("", "formulas hold for the aligned array; spots and light shares"),
            _line("", "are traced through the misaligned array"),
        ]
    return lines


def _layers(data: InspectDocument) -> list[str]:
    d = data.display
    if not d.layers:
        return []
    parts = ", ".join(f"{_n(thickness)} mm of n = {_n(n)}" for thickness, n in d.layers)
    measured = f"{_n(d.gap_mm + data.depth.layers_excess_mm)} mm geometrically"
    return [
        _line("layers from the lenses on", parts),
        _line("", f"gap g = {_n(d.gap_mm)} mm is air-equivalent, {measured}"),
    ]


def _depth_lines(data: InspectDocument) -> list[str]:
    d = data.display
    low, high = d.depth_range_mm
    kind = mode(d)
    lines = ["Depth", _line("mode", _MODES[kind])]
    if kind != "focused":
        lines += [
            _line("central depth plane D", f"{_n(d.central_depth_mm)} mm"),
            _line("scene pixel P_I at D", f"{_n(d.scene_pixel_mm)} mm"),
        ]
    wrong = data.depth.central_depth_if_measured_mm
    glass = "these layers" if d.layers else f"{_n(COVER_GLASS[0][0])} mm of cover glass"
    value = "none" if wrong is None else f"{_n(wrong)} mm"
    lines.append(_line("D if g is a measured length", f"{value}, with {glass} in it"))
    stated = d.depth_min_mm is not None
    origin = (
        "from the settings"
        if stated
        else "by the formula, cut off the array" * d.depth_range_is_cut
    )
    lines.append(
        _line("depth range", f"{_n(low)} to {_n(high)} mm" + (f" ({origin})" if origin else ""))
    )
    if kind != "focused" and not stated:
        lines.append(_line("depth span by the formula", f"{_n(d.depth_span_mm)} mm"))
    if kind == "focused":
        lines.append(_line("sharp to", f"{_n(data.depth.blur_onset_mm)} mm from the array"))
    return lines + _voxels(data)


def _voxels(data: InspectDocument) -> list[str]:
    d = data.display
    low, high = d.depth_range_mm
    places = {"far end": low, "near end": high}
    if mode(d) != "focused":
        places = {"far end": low, "at D": d.central_depth_mm, "near end": high}
    parts: list[tuple[str, Callable[[float], float]]] = [
        ("depth", float),
        ("voxel width, total:", lambda z: float(voxel_mm(d, z))),
        ("  pixel footprint", lambda z: float(pixel_footprint_mm(d, z))),
        ("  blur of the lens aperture", lambda z: float(aperture_blur_mm(d, z))),
    ]
    lines = [_line("", "".join(f"{name:>12}" for name in places))]
    for label, measure in parts:
        values = "".join(f"{_n(measure(z)):>9} mm" for z in places.values())
        lines.append(_line(label, values))
    return lines


def _choices(data: InspectDocument) -> list[str]:
    d = data.display
    columns: dict[str, Callable[[PixelChoice], str]] = {
        "pixels/lens": lambda c: _n(c.pixels_per_lens),
        "pixel, µm": lambda c: _n(1e3 * c.pixel_pitch_mm),
        "views/lens": lambda c: f"{_n(c.views_across)} x {_n(c.views_down)}",
        "step, °": lambda c: f"{c.angular_step_deg:.3g}",
        "depth span, mm": lambda c: "-" if c.depth_span_mm is None else _n(c.depth_span_mm),
        "panel, pixels": lambda c: f"{c.panel_columns} x {c.panel_rows}",
        "MB/frame": lambda c: f"{c.frame_mb:.3g}",
    }
    rows = [list(columns)]
    rows += [[column(choice) for column in columns.values()] for choice in data.pixels_per_lens]
    names = ("", *("half", "this", "double")[: len(PIXEL_STEPS)])
    widths = [max(len(row[n]) for row in rows) for n in range(len(columns))]
    table = [
        "  " + f"{name:8}" + "  ".join(f"{cell:>{w}}" for cell, w in zip(row, widths, strict=True))
        for name, row in zip(names, rows, strict=True)
    ]
    return [
        "Pixels per lens: benefit and cost",
        *table,
        f"  The picture has {d.layout.lens_counts()} points in each view, one per lens, "
        "independent of the pixels per lens.",
    ]


def _viewing_lines(data: InspectDocument) -> list[str]:
    zone = data.viewing
    nearest = "none" if zone.nearest_distance_mm is None else f"{_n(zone.nearest_distance_mm)} mm"
    lines = [
        "Viewing",
        _line("viewing half angle of a lens", f"{_n(zone.half_angle_deg)}°"),
        _line("nearest distance, no flips", nearest),
        _line("viewing distance", f"{_n(zone.distance_mm)} mm"),
    ]
    if zone.zone_is_empty:
        return [*lines, _line("sideways eye movement", "none: every eye sees flipped views")]
    across = f"±{_n(zone.flip_limit_x_mm)} mm (±{_n(zone.flip_limit_x_deg)}°) across"
    up = "any up and down"
    if zone.flip_limit_y_mm is not None:
        up = f"±{_n(zone.flip_limit_y_mm)} mm (±{_n(zone.flip_limit_y_deg)}°) up and down"
    return [*lines, _line("sideways eye movement", f"{across}, {up}")]


def _suitability_lines(data: InspectDocument) -> list[str]:
    figures = data.suitability
    head = figures.head_movement_mm
    height = figures.zone_height_mm
    eyes = "no" if head is None else f"yes; the head may move by ±{_n(round(head, 3))} mm"
    tall = "any height" if height is None else f"{_n(height)} mm"
    accuracy = figures.accuracy
    return [
        f"Suitability for a viewer at {_n(data.viewing.distance_mm)} mm",
        _line("finest detail", f"{_n(figures.detail_mm)} mm at the worst depth of the range"),
        _line("details across", f"{figures.details_across:.0f}"),
        _line("depth with sharp details", f"{_n(figures.sharp_depth_mm)} mm"),
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
    focused = mode(data.display) == "focused"
    of = "a far point" if focused else "a point at D"
    lines = [f"Spot of {of} through one lens ({data.lens_model.name})"]
    lines.append(
        _line("diffraction, λ g / (P p)", f"{data.diffraction_px:.3f} pixels, in no lens model")
    )
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


def _light_lines(data: InspectDocument) -> list[str]:
    zone = data.viewing
    heads = [f"{v.name:>9}" for v in zone.viewpoints]
    x, y = ("".join(f"{v.position_mm[n] + 0.0:9.1f}" for v in zone.viewpoints) for n in (0, 1))
    lines = [
        f"Light that reaches an eye at {_n(zone.distance_mm)} mm, % of the rays to the array",
        _line("eye", "".join(heads)),
        _line("x, mm", x),
        _line("y, mm", y),
    ]
    for name, label in _SHARES:
        values = [getattr(data.light[v.name], f"{name}_share") for v in zone.viewpoints]
        texts = ("-" if value is None else f"{100 * value + 0.0:.2f}" for value in values)
        lines.append(_line(f"{label}, %", "".join(f"{cell:>9}" for cell in texts)))
    for n, label in enumerate(_VIEWS[: len(next(iter(data.views.values()), ()))]):
        texts = (f"{100 * data.views[v.name][n]:.1f}" for v in zone.viewpoints)
        lines.append(_line(f"{label}, %", "".join(f"{cell:>9}" for cell in texts)))
    return lines


def _warnings(data: InspectDocument) -> list[str]:
    wrap = textwrap.TextWrapper(_COLUMNS, initial_indent="  * ", subsequent_indent="    ").wrap
    lines = [line for sentence in data.warnings for line in wrap(sentence)]
    return ["Notes", *lines] if lines else []
