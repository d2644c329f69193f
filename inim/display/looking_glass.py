"""Looking Glass displays, and their calibration files, `visual.json`.

A file states the view of each sub-pixel (LKG-Toolkit, ``Calibration.cs``). With x, y from 0 to
1 at a pixel's centre, y from the bottom, and c = 0, 1, 2 for red, green and blue::

    pitch' = pitch W / DPI cos(atan(1 / slope))      tilt = H / (W slope), negative with flipImageX
    view = 1 - fract((x + c / (3 W) + y tilt) pitch' - center)

or, with `subpixelCells`, ``x + dx_c / W + (y + dy_c / H) tilt``. In terms of a display, 25.4 /
pitch is the pitch Q of the elemental images, atan(1 / slope) the rotation, and ``phase - center``
counts elemental images from their left edges. Red is at the pixel's centre in the formula, and a
third of a pixel to the left in a display.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from typing import Any

from inim.display.display import Display
from inim.display.layouts import Lenticular
from inim.display.parameters import Cells
from inim.display.pixels import MM_PER_INCH, exact_ratio
from inim.system.errors import DisplayError, FileError

#: Values of `Display.cell_pattern` for CellPatternMode 0 to 4, as in the vendor's Unity plugin.
#: Another source of the vendor has "rows-of-4" for mode 2 and "columns" for mode 4.
CELL_MODES = ("single", "checkerboard", "columns", "staggered", "rows")
# Names in `subpixelCells`, in the order of `Display.subpixel_cells`.
_OFFSETS = tuple(f"{colour}Offset{axis}" for colour in "RGB" for axis in "XY")
# Vertical field of view of the vendor's cameras. It places the viewer, whom no file states.
_CAMERA_DEG = 14.0
# Of PMMA, and of polycarbonate for lenses that cannot be ground from PMMA.
_INDICES = (1.4917, 1.586)
# Spread of the light of one direction at the ends of the depth range, in lens pitches.
_SPREAD = 2.0
# Ranges of numbers in a file: generous for any panel, and small enough for all arithmetic.
_RANGES = {
    "pitch": (1.0, 1000.0),
    "DPI": (10.0, 5000.0),
    "viewCone": (1.0, 150.0),
    "screenW": (1.0, 32768.0),
    "screenH": (1.0, 32768.0),
    "center": (-1e6, 1e6),
    "slope": (-1e6, 1e6),
}
# Numbers and the parameters that they determine, each after those it depends on.
_PARAMETERS = {
    "dpi": "pixel_pitch_mm",
    "pitch": "elemental_pitch_mm",
    "slope": "rotation_deg",
    "view_cone": "gap_mm",
    "center": "shift_x_mm",
}
# Where a number is sought that gives a parameter exactly: digits, and units of its last place.
_SHORT_NUMBERS = (4, 6, 9, 12, 15)
_MOST_STEPS = 64
# Of centers: they are added to phases, whose last place is no finer.
_FINEST_STEP = 2.0**-48


@dataclass(frozen=True)
class LookingGlass:
    """Values of a calibration file, under the vendor's names.

    * `pitch`: elemental images per inch, across the axes; `slope`: rise over run of the axes.
    * `view_cone`: angle between the outermost views, degrees.
    * `cells`, `pattern`: see `Display.subpixel_cells`; without cells, pixels are stripes.
    """

    pitch: float
    slope: float
    center: float
    view_cone: float
    dpi: float
    screen_w: int
    screen_h: int
    flip_x: bool = False
    cells: Cells = ()
    pattern: str = "single"

    def display(self, viewing_distance_mm: float | None = None, name: str = "custom") -> Display:
        """The display.

        * `viewing_distance_mm`: V; by default that of the vendor's cameras, from which the panel is
          14 degrees high.

        The gap is the air-equivalent one that gives `view_cone`, seen from the panel. Lenses focus
        on the panel. Their index is that of PMMA; where a face of radius g (n - 1) would not reach
        the edge of its lens, that of polycarbonate. The depth range ends where the light of a
        direction, of which each lens has as many as sub-pixels, spreads over two lens pitches.
        """
        pixel, pitch = MM_PER_INCH / self.dpi, MM_PER_INCH / self.pitch
        rotation_deg = math.degrees(math.atan(1 / self.slope)) * (-1 if self.flip_x else 1)
        angle = math.radians(rotation_deg)
        height = self.screen_h * pixel
        distance = viewing_distance_mm or height / 2 / math.tan(math.radians(_CAMERA_DEG / 2))
        # g = P / (2 cos s tan(cone / 2)), with P = Q V / (V + g).
        wide = pitch / (2 * math.cos(angle) * math.tan(math.radians(self.view_cone / 2)))
        gap = 2 * wide / (1 + math.sqrt(1 + 4 * wide / distance))
        lens = pitch * distance / (distance + gap)
        index = next((n for n in _INDICES if 2 * gap * (n - 1) > lens), _INDICES[-1])
        phase = self._phase(angle) - self.center - 0.5
        # In eighths, exact in float32: depths of pictures at the ends do not round beyond them.
        depth = max(1, math.floor(8 * _SPREAD * lens * 3 * gap / pixel)) / 8
        return Display(
            pitch_mm=lens,
            elemental_pitch_mm=pitch,
            focal_length_mm=gap,
            gap_mm=gap,
            refractive_index=index,
            pixel_pitch_mm=pixel,
            lens_columns=max(1, round(exact_ratio(self.screen_w * pixel * math.cos(angle) / lens))),
            lens_rows=1,
            panel_columns=self.screen_w,
            panel_rows=self.screen_h,
            depth_min_mm=-depth,
            depth_max_mm=depth,
            lattice="lenticular",
            rotation_deg=rotation_deg,
            shift_x_mm=(round(phase) - phase) * pitch / math.cos(angle),
            subpixels="cells" if self.cells else "rgb-stripe",
            subpixel_cells=self.cells,
            cell_pattern=self.pattern if self.cells else "single",  # type: ignore[arg-type]
            name=name,
        )

    def _phase(self, angle: float) -> float:
        """Phase of the panel's centre: elemental images from the lower left corner."""
        third = 0 if self.cells else 1 / 3
        right, up = self.screen_w / 2 + third, self.screen_h / 2
        return (math.cos(angle) * right + math.sin(angle) * up) * self.pitch / self.dpi

    @classmethod
    def of(cls, display: Display) -> LookingGlass:
        """Calibration of a display.

        Raises `DisplayError`: not a slanted lenticular with colours side by side.
        """
        if display.lattice != Lenticular.name or not display.rotation_deg:
            raise DisplayError(
                f"display {display.name}: visual.json is for slanted lenticulars; save it as .xml"
            )
        if display.subpixels not in ("rgb-stripe", "cells") or (
            display.cell_pattern not in CELL_MODES
        ):
            raise DisplayError(
                f"subpixels = {display.subpixels!r}, cell_pattern = {display.cell_pattern!r}: "
                "visual.json has only rgb-stripe, and cells in the patterns "
                f"{', '.join(CELL_MODES)}"
            )
        angle, pitch = math.radians(display.rotation_deg), display.elemental_image_pitch_mm
        c, s = math.cos(angle), math.sin(angle)
        rows, columns = display.eia_shape
        values = cls(
            pitch=MM_PER_INCH / pitch,
            slope=c / s,
            center=0.0,
            view_cone=2 * math.degrees(math.atan(display.pitch_mm / (2 * display.gap_mm * c))),
            dpi=MM_PER_INCH / display.pixel_pitch_mm,
            screen_w=columns,
            screen_h=rows,
            cells=display.subpixel_cells,
            pattern=display.cell_pattern,
        )
        moved = (c * display.shift_x_mm + s * display.shift_y_mm) / pitch
        values = replace(values, center=(values._phase(angle) + moved - 0.5) % 1.0)
        for name, parameter in _PARAMETERS.items():
            values = values._restored(name, parameter, display)
        return values

    def _restored(self, name: str, parameter: str, display: Display) -> LookingGlass:
        """Copy with a number that gives a parameter of the display to the last bit.

        Of such numbers near the present one the shortest, or else the nearest is chosen. A display
        from no file may have none; it keeps the present number.
        """
        number, goal = getattr(self, name), getattr(display, parameter)
        grain = _FINEST_STEP if name == "center" else math.ulp(number)
        steps = sorted(range(-_MOST_STEPS, _MOST_STEPS + 1), key=abs)
        texts = [float(f"{number:.{digits}g}") for digits in _SHORT_NUMBERS]
        for candidate in (*texts, *(number + step * grain for step in steps)):
            values = replace(self, **{name: candidate})
            if getattr(values.display(), parameter) == goal:
                return values
        return self

    def text(self) -> str:
        """Text of the file."""
        numbers: dict[str, float] = {
            "pitch": self.pitch, "slope": self.slope, "center": self.center,
            "viewCone": self.view_cone, "invView": 1, "DPI": self.dpi, "screenW": self.screen_w,
            "screenH": self.screen_h, "flipImageX": int(self.flip_x), "flipImageY": 0,
            "flipSubp": 0, "CellPatternMode": CELL_MODES.index(self.pattern),
        }  # fmt: skip
        document: dict[str, Any] = {"configVersion": "3.0" if self.cells else "1.0", "serial": ""}
        document |= {name: {"value": value} for name, value in numbers.items()}
        cells = [dict(zip(_OFFSETS, cell, strict=True)) for cell in self.cells]
        return json.dumps(document | {"subpixelCells": cells}, indent=1) + "\n"


def parse_calibration(text: bytes, source: str) -> LookingGlass:
    """Calibration from the bytes of a file, named `source` in messages.

    Numbers may be wrapped, ``{"value": 1}``. `serial`, versions and unknown names are ignored, as
    is `invView`: the vendor's current programs do not read it.

    Raises `FileError`: not such a file, or a number that is missing or describes no panel.
    """
    try:
        values = json.loads(text)
    except (ValueError, RecursionError):
        values = None
    if not isinstance(values, dict):
        raise FileError(f"{source}: not readable as JSON; give the display's visual.json unchanged")

    def number(name: str, default: float | None = None, holder: Any = values) -> float:
        value = holder.get(name, default) if isinstance(holder, dict) else None
        if isinstance(value, dict):
            value = value.get("value")
        low, high = _RANGES.get(name, (-1e3, 1e3))
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise FileError(
                f"{source}: no number {name!r}; give the display's visual.json unchanged"
            )
        if not low <= value <= high:
            raise FileError(f"{source}: {name} = {value:g}: must be from {low:g} to {high:g}")
        return float(value)

    for name in ("flipImageY", "flipSubp"):
        if number(name, 0.0) >= 0.5:
            raise FileError(f"{source}: {name} = 1 is not supported: no published formula has it")
    slope, listed = number("slope"), values.get("subpixelCells") or []
    if abs(slope) < 1:
        raise FileError(f"{source}: slope = {slope:g}: must be at least 1, or at most -1")
    if not isinstance(listed, list):
        raise FileError(f"{source}: subpixelCells is no list; give visual.json unchanged")
    mode = number("CellPatternMode", number("cellPatternMode", 0.0))
    if mode not in range(len(CELL_MODES)):
        raise FileError(f"{source}: CellPatternMode = {mode:g}: must be 0 to {len(CELL_MODES) - 1}")
    cells = tuple(tuple(number(name, holder=cell) for name in _OFFSETS) for cell in listed)
    width, height = number("screenW"), number("screenH")
    if not (width.is_integer() and height.is_integer()):
        raise FileError(
            f"{source}: screenW = {width:g}, screenH = {height:g}: must be whole numbers of pixels"
        )
    return LookingGlass(
        pitch=number("pitch"),
        slope=slope,
        center=number("center"),
        view_cone=number("viewCone"),
        dpi=number("DPI"),
        screen_w=int(width),
        screen_h=int(height),
        flip_x=number("flipImageX", 0.0) >= 0.5,
        cells=cells,
        pattern=CELL_MODES[int(mode)] if cells else CELL_MODES[0],
    )


_GEN3 = ((-0.31, 0.25, 0.28, 0.25, 0.0, -0.25), (-0.31, -0.25, 0.28, -0.25, 0.0, 0.25))
#: Typical values by model. Each unit differs from them; its phase is arbitrary.
TYPICAL = {
    "looking-glass-8.9-typical": LookingGlass(47.6, -5.48, 0.0, 40, 338, 2560, 1600),
    "looking-glass-15.6-typical": LookingGlass(50.1, -7.52, 0.0, 40, 283, 3840, 2160),
    "looking-glass-portrait-typical": LookingGlass(52.6, -7.15, 0.0, 40, 324, 1536, 2048),
    "looking-glass-go-typical": LookingGlass(80.7, -6.66, 0.0, 54, 491, 1440, 2560),
    "looking-glass-16-typical": LookingGlass(
        44.75, -6.88, 0.0, 50, 283, 3840, 2160, cells=_GEN3, pattern="columns"
    ),
}
