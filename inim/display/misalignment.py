"""Misalignment of an array over its panel, relative to the display's design."""

import math
from collections.abc import Mapping
from typing import Any

from inim.display.display import Display
from inim.system.errors import DisplayError, UsageError, suggest_words

#: Kinds of misalignment, with the meaning of a positive number.
MISALIGNMENTS = {
    "shift_x_mm": "the array is shifted to the right",
    "shift_y_mm": "the array is shifted up",
    "rotation_deg": "the array is rotated counter-clockwise, as the viewer sees it",
    "tilt_x_deg": "the gap grows to the right",
    "tilt_y_deg": "the gap grows upwards",
    "gap_mm": "the gap is larger",
    "pitch_mm": "the lens pitch is larger",
}


def one_pixel_errors(display: Display) -> dict[str, float]:
    """Misalignments that each shift the observed panel point by a pixel, by key.

    The point is at the edge of the array; the eye is on its axis, twice as far as the nearest
    usable position. A ray there moves P / 4g sideways for each millimetre of gap. Cylinders that
    are shifted up move sideways by the sine of their slant; an upright one does not move.
    """
    pixel = display.pixel_pitch_mm
    half_width, half_height = display.width_mm / 2, display.height_mm / 2
    farthest = max(half_width, half_height)
    gap = pixel * 4 * display.gap_mm / display.pitch_mm
    errors = {
        "pitch_mm": pixel * display.pitch_mm / farthest,
        "gap_mm": gap,
        "rotation_deg": math.degrees(pixel / farthest),
        "shift_x_mm": pixel,
        "shift_y_mm": pixel,
        "tilt_x_deg": math.degrees(math.atan(gap / half_width)),
        "tilt_y_deg": math.degrees(math.atan(gap / half_height)),
    }
    if display.layout.of_cylinders:
        sideways = abs(math.sin(math.radians(display.rotation_deg)))
        if not sideways:
            del errors["shift_y_mm"]
        else:
            errors["shift_y_mm"] /= sideways
    return errors


def parse_misalignment(misalignment: str | Mapping[str, float]) -> dict[str, float]:
    """Misalignment as numbers by key of `MISALIGNMENTS`.

    * `misalignment`: ``"rotation_deg=0.5, shift_x_mm=0.1"``, or ``{"rotation_deg": 0.5,
      "shift_x_mm": 0.1}``. Empty: none.

    Raises `UsageError`: an unknown or doubled key, a value that is no number, or another type.
    """
    if isinstance(misalignment, str):
        items = [part.strip() for part in misalignment.split(",") if part.strip()]
        pairs: list[tuple[str, Any]] = []
        for item in items:
            key, _, text = item.partition("=")
            pairs.append((key.strip(), text.strip()))
    elif isinstance(misalignment, Mapping):
        items, pairs = [str(key) for key in misalignment], list(misalignment.items())
    else:
        raise UsageError(
            f"misalign: {misalignment!r} is a {type(misalignment).__name__}; give a mapping such "
            "as {'rotation_deg': 0.5}, or text such as 'rotation_deg=0.5'"
        )
    numbers: dict[str, float] = {}
    for item, (key, value) in zip(items, pairs, strict=True):
        if key not in MISALIGNMENTS or value == "":
            hint = suggest_words(key, MISALIGNMENTS)
            raise UsageError(f"misalign {item!r}: write KEY=NUMBER; {hint}")
        if key in numbers:
            raise UsageError(f"misalign: {key} is given twice; keep one")
        try:
            numbers[key] = float(value)
        except (TypeError, ValueError):
            raise UsageError(f"misalign {item!r}: {value!r} is not a number") from None
    return numbers


def misalignment_text(misalignment: Mapping[str, float]) -> str:
    """Text of a misalignment, as `parse_misalignment` reads it."""
    return ", ".join(f"{key}={value!r}" for key, value in misalignment.items())


def misaligned(display: Display, misalignment: str | Mapping[str, float]) -> Display:
    """Display with its misaligned array.

    * `display`: design, as generators use it.
    * `misalignment`: deviation; see `parse_misalignment`. It is added to the design's own values.

    Raises `UsageError`: see `parse_misalignment`. `DisplayError`: the misalignment is impossible.
    """
    off = parse_misalignment(misalignment)
    if not off:
        return display
    # Picture and panel stay as designed: the depth range and the pixels are not the array's.
    changes: dict[str, Any] = _changes_with_pitch(display, off.get("pitch_mm", 0.0))
    changes |= {key: getattr(display, key) + value for key, value in off.items()}
    try:
        return display.with_fixed_panel().replace(name=f"{display.name}, misaligned", **changes)
    except DisplayError as error:
        raise DisplayError(f"misalign {misalignment_text(off)!r}: {error}") from None


def _changes_with_pitch(display: Display, off_mm: float) -> dict[str, float]:
    """Further changes with a wrong pitch: rows, and elemental images for the actual array.

    Those of the design stay on the panel, as they do under an array that is moved. A sheet's
    thickness is its own, also where the design takes it from the pitch.
    """
    if not off_mm:
        return {}
    explicit = {key: getattr(display, key) for key in ("pitch_y_mm", "elemental_pitch_mm")}
    scale = 1 + off_mm / display.pitch_mm
    changed = {key: value * scale for key, value in explicit.items() if value is not None}
    if display.lens_thickness_mm is None:
        changed["lens_thickness_mm"] = display.pitch_mm
    return changed
