"""Findings as text for a terminal, every number with its unit, and as JSON."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable

from inim.display import Display
from inim.documents.inspect import (
    CrosstalkGrid,
    DepthFigures,
    InspectDocument,
    LightRecord,
    PixelChoice,
    Size,
    SpotFigures,
    TracedModel,
)
from inim.inspect.findings import PIXEL_STEPS, Findings, cautions, misalignments
from inim.inspect.geometry import (
    LightShares,
    aperture_blur_mm,
    has_whole_pixels,
    mode,
    pixel_footprint_mm,
    voxel_mm,
)
from inim.inspect.spots import Spot
from inim.lens import lens_model as find_lens_model
from inim.version import __version__

_COLUMNS = 100
_LABEL = 30
_MODES = {
    "real": "real: pictures stand in front of the lens array (g > f)",
    "virtual": "virtual: pictures stand behind the lens array (g < f)",
    "focused": "focused: g = f, no central depth plane; the depth range is stated",
}
_SHARES = (
    ("own", "own elemental image"),
    ("neighbour", "under a neighbour"),
    ("past_lenses", "past the lenses"),
    ("beside_panel", "beside the panel"),
    ("dark_between", "dark between lenses"),
    ("blocked", "vignetted, total reflection"),
    ("reflected", "reflected at lens faces"),
    ("astray", "goes astray in all"),
    ("crosstalk", "crosstalk, share of arriving"),
)


def as_text(findings: Findings) -> str:
    """The whole text, without a last line break."""
    blocks = [
        _display(findings),
        _depth_lines(findings),
        _choices(findings),
        _viewing_lines(findings),
        _spots(findings),
        _light_lines(findings),
        _warnings(findings),
    ]
    return "\n\n".join("\n".join(block) for block in blocks if block)


def _line(label: str, value: str) -> str:
    return f"  {label:{_LABEL}}{value}"


def _n(value: float) -> str:
    """Number with at most four significant digits, and without a minus sign before zero."""
    return f"{value + 0.0:.4g}"


def _display(findings: Findings) -> list[str]:
    d = findings.design
    rows, columns = d.eia_shape
    lens = f"f = {_n(d.focal_length_mm)} mm, gap g = {_n(d.gap_mm)} mm"
    lines = [
        f"Display {d.name}",
        _line("array", f"{_n(d.width_mm)} x {_n(d.height_mm)} mm"),
        _line(
            "lenses",
            f"{d.lens_columns} x {d.lens_rows}, pitch {_n(d.pitch_mm)} mm, {d.lattice} lattice, "
            f"{d.aperture} apertures",
        ),
        _line("", f"{lens}, aperture {_n(d.fill_factor * d.pitch_mm)} mm"),
        _line("panel", f"{columns} x {rows} pixels of {_n(1e3 * d.pixel_pitch_mm)} µm"),
        _line("pixels per lens", f"{_n(d.pixels_per_lens)} pixels along one axis"),
        _line("lens model used below", findings.lens_model),
    ]
    off = misalignments(d, findings.misaligned)
    lines += [_line("misalignment" if n == 0 else "", sentence) for n, sentence in enumerate(off)]
    if off:
        lines += [
            _line("", "formulas are those of the aligned array; spots and light shares"),
            _line("", "are traced through the misaligned array"),
        ]
    return lines


def _depth_lines(findings: Findings) -> list[str]:
    d = findings.design
    low, high = d.depth_range_mm
    kind = mode(d)
    lines = ["Depth", _line("mode", _MODES[kind])]
    if kind != "focused":
        lines += [
            _line("central depth plane D", f"{_n(d.central_depth_mm)} mm"),
            _line("scene pixel P_I at D", f"{_n(d.scene_pixel_mm)} mm"),
        ]
    stated = d.depth_min_mm is not None
    origin = "stated" if stated else "by the formula, cut off the array" * d.depth_range_is_cut
    lines.append(
        _line("depth range", f"{_n(low)} to {_n(high)} mm" + (f" ({origin})" if origin else ""))
    )
    if kind != "focused" and not stated:
        lines.append(_line("depth span by the formula", f"{_n(d.depth_span_mm)} mm"))
    return lines + _voxels(findings)


def _voxels(findings: Findings) -> list[str]:
    d = findings.design
    low, high = d.depth_range_mm
    places = {"far end": low, "near end": high}
    if mode(d) != "focused":
        places = {"far end": low, "at D": d.central_depth_mm, "near end": high}
    parts: list[tuple[str, Callable[[float], float]]] = [
        ("depth", float),
        ("voxel width, both together:", lambda z: float(voxel_mm(d, z))),
        ("  pixel footprint", lambda z: float(pixel_footprint_mm(d, z))),
        ("  blur of the lens aperture", lambda z: float(aperture_blur_mm(d, z))),
    ]
    lines = [_line("", "".join(f"{name:>12}" for name in places))]
    for label, measure in parts:
        values = "".join(f"{_n(measure(z)):>9} mm" for z in places.values())
        lines.append(_line(label, values))
    return lines


def _choices(findings: Findings) -> list[str]:
    d = findings.design
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
    rows += [[column(choice) for column in columns.values()] for choice in findings.choices]
    names = ("", *("half", "this", "double")[: len(PIXEL_STEPS)])
    widths = [max(len(row[n]) for row in rows) for n in range(len(columns))]
    table = [
        "  " + f"{name:8}" + "  ".join(f"{cell:>{w}}" for cell, w in zip(row, widths, strict=True))
        for name, row in zip(names, rows, strict=True)
    ]
    return [
        "Pixels per lens: benefit and cost",
        *table,
        f"  The picture has {d.lens_columns} x {d.lens_rows} points in each view, one per lens, "
        "independent of the pixels per lens.",
    ]


def _viewing_lines(findings: Findings) -> list[str]:
    zone = findings.zone
    nearest = "none" if zone.nearest_distance_mm is None else f"{_n(zone.nearest_distance_mm)} mm"
    lines = [
        "Viewing",
        _line("viewing half angle of a lens", f"{_n(zone.half_angle_deg)}°"),
        _line("nearest distance, no flips", nearest),
        _line("viewing distance", f"{_n(zone.distance_mm)} mm"),
    ]
    if zone.zone_is_empty:
        return [
            *lines,
            _line("sideways eye movement", "none: every eye sees flipped views"),
        ]
    limits = (
        f"±{_n(zone.flip_limit_x_mm)} mm (±{_n(zone.flip_limit_x_deg)}°) across, "
        f"±{_n(zone.flip_limit_y_mm)} mm (±{_n(zone.flip_limit_y_deg)}°) up and down"
    )
    return [*lines, _line("sideways eye movement", limits)]


def _spots(findings: Findings) -> list[str]:
    focused = mode(findings.design) == "focused"
    of = "a far point" if focused else "a point at D"
    lines = [f"Spot of {of} through one lens ({findings.lens_model})"]
    for spot in findings.spots:
        colour = "" if spot.colour == "all" else f", {spot.colour}"
        lost = f", {100 * spot.lost_share:.3g} % of its rays lost" if spot.lost_share else ""
        lines.append(
            _line(
                f"at {spot.field_angle_deg:.3g}°{colour}",
                f"RMS radius {spot.rms_radius_um:6.2f} µm = {spot.rms_radius_px:.3f} pixels{lost}",
            )
        )
    if not find_lens_model(findings.lens_model).refracts:
        lines.append("  Without refraction, the spot is the spread of a cell's directions.")
    return lines


def _light_lines(findings: Findings) -> list[str]:
    zone = findings.zone
    heads = [f"{v.name:>9}" for v in zone.viewpoints]
    x, y = ("".join(f"{v.position_mm[n] + 0.0:9.1f}" for v in zone.viewpoints) for n in (0, 1))
    lines = [
        f"Light that reaches an eye at {_n(zone.distance_mm)} mm, % of the rays to the array",
        _line("eye", "".join(heads)),
        _line("x, mm", x),
        _line("y, mm", y),
    ]
    for name, label in _SHARES:
        values = [getattr(findings.light[v.name], name) for v in zone.viewpoints]
        lines.append(_line(f"{label}, %", "".join(f"{100 * value + 0.0:9.2f}" for value in values)))
    return lines


def _warnings(findings: Findings) -> list[str]:
    sentences = cautions(findings)
    wrap = textwrap.TextWrapper(_COLUMNS, initial_indent="  * ", subsequent_indent="    ").wrap
    return (
        ["To know", *(line for sentence in sentences for line in wrap(sentence))]
        if sentences
        else []
    )


def inspect_document(findings: Findings) -> InspectDocument:
    """The findings as a document; infinite and unknown values are None."""
    light = {name: _light(shares) for name, shares in findings.light.items()}
    crosstalk = findings.crosstalk
    return InspectDocument(
        inim_version=__version__,
        source=findings.source,
        display=findings.design,
        lens_model=TracedModel(name=findings.lens_model, reason=findings.model_reason),
        size=_size(findings.design),
        depth=_depth(findings.design),
        pixels_per_lens=list(findings.choices),
        viewing=findings.zone,
        voxel=findings.voxels,
        spots=[_spot(spot) for spot in findings.spots],
        light=light,
        crosstalk=CrosstalkGrid(
            eye_x_mm=crosstalk.eye_x_mm.tolist(),
            eye_y_mm=crosstalk.eye_y_mm.tolist(),
            share=[[_finite(share) for share in row] for row in crosstalk.share.tolist()],
        ),
        misalignment=misalignments(findings.design, findings.misaligned),
        warnings=cautions(findings),
    )


def _size(display: Display) -> Size:
    rows, columns = display.eia_shape
    return Size(
        width_mm=display.width_mm,
        height_mm=display.height_mm,
        lens_columns=display.lens_columns,
        lens_rows=display.lens_rows,
        panel_columns=columns,
        panel_rows=rows,
        panel_width_mm=columns * display.pixel_pitch_mm,
        panel_height_mm=rows * display.pixel_pitch_mm,
        pixels_per_lens=display.pixels_per_lens,
        has_whole_pixels_per_lens=has_whole_pixels(display),
    )


def _depth(display: Display) -> DepthFigures:
    low, high = display.depth_range_mm
    return DepthFigures(
        mode=mode(display),
        central_depth_mm=_finite(display.central_depth_mm),
        scene_pixel_mm=_finite(display.scene_pixel_mm),
        depth_span_mm=_finite(display.depth_span_mm),
        depth_min_mm=low,
        depth_max_mm=high,
        depth_range_is_cut=display.depth_range_is_cut,
        depth_range_is_stated=display.depth_min_mm is not None,
        voxel_at_depth_min_mm=float(voxel_mm(display, low)),
        voxel_at_depth_max_mm=float(voxel_mm(display, high)),
    )


def _spot(spot: Spot) -> SpotFigures:
    return SpotFigures(
        field_angle_deg=spot.field_angle_deg,
        colour=spot.colour,
        rms_radius_um=_finite(spot.rms_radius_um),
        rms_radius_px=_finite(spot.rms_radius_px),
        centre_x_mm=_finite(spot.centre_x_mm),
        centre_y_mm=_finite(spot.centre_y_mm),
        lost_share=spot.lost_share,
    )


def _light(shares: LightShares) -> LightRecord:
    named = {f"{name}_share": value for name, value in vars(shares).items()}
    return LightRecord(
        **named, crosstalk_share=_finite(shares.crosstalk), astray_share=shares.astray
    )


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
