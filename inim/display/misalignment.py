"""How an array really lies over its panel, where that is not as the display was designed."""

from __future__ import annotations

from inim.display.display import Display
from inim.errors import DisplayError, UsageError, known_words

#: What can be off, and what a positive number means.
MISALIGNMENTS = {
    "shift_x_mm": "the array lies to the right",
    "shift_y_mm": "the array lies too high",
    "rotation_deg": "the array is turned counter-clockwise, as the viewer sees it",
    "tilt_x_deg": "the gap grows to the right",
    "tilt_y_deg": "the gap grows upwards",
    "gap_mm": "the array stands too far from the panel",
    "pitch_mm": "the lenses lie too far apart",
}


def mounted(display: Display, misalignment: str) -> Display:
    """The display as it is on the bench.

    Parameters
    ----------
    display : Display
        As designed: what generators know.
    misalignment : str
        By how much it is off, like ``"rotation_deg=0.5, shift_x_mm=0.1"``; keys of
        `MISALIGNMENTS`. Added to the design's own values. Empty: nothing is off.

    Raises
    ------
    UsageError
        Unknown or doubled key, or not a number.
    DisplayError
        No display can be mounted like that.
    """
    off: dict[str, float] = {}
    for item in filter(None, (part.strip() for part in misalignment.split(","))):
        key, equals, text = (part.strip() for part in item.partition("="))
        if not equals or key not in MISALIGNMENTS:
            hint = known_words(key, MISALIGNMENTS)
            raise UsageError(f"misalign {item!r}: write KEY=NUMBER; {hint}")
        if key in off:
            raise UsageError(f"misalign: {key} is given twice; keep one")
        try:
            off[key] = float(text)
        except ValueError:
            raise UsageError(f"misalign {item!r}: {text!r} is not a number") from None
    if not off:
        return display
    # Picture and panel stay as designed: the depth range and the pixels are not the array's.
    try:
        return display.held().replace(
            name=f"{display.name}, misaligned",
            **_stretched(display, off.get("pitch_mm", 0.0)),
            **{key: getattr(display, key) + value for key, value in off.items()},
        )
    except DisplayError as error:
        raise DisplayError(f"misalign {misalignment!r}: {error}") from None


def _stretched(display: Display, off_mm: float) -> dict[str, float]:
    """What follows a pitch that is off: rows, and elemental images made for the array as it is.

    Those of the design stay on the panel, as they do under an array that is moved. A sheet's
    thickness is its own, also where the design takes it from the pitch.
    """
    if not off_mm:
        return {}
    given = {key: getattr(display, key) for key in ("pitch_y_mm", "elemental_pitch_mm")}
    scale = 1 + off_mm / display.pitch_mm
    changed = {key: value * scale for key, value in given.items() if value is not None}
    if display.lens_thickness_mm is None:
        changed["lens_thickness_mm"] = display.pitch_mm
    return changed
