"""Compressed pictures, the picture of a report, and README's film of a moving eye.

One `inim validate` with a viewpoint for each eye position renders the scene and its display.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib import font_manager
from PIL import Image, ImageDraw, ImageFont

from reports.gallery.eye import EYE
from tests.chromium import browser

#: Number of lenses along a side of the magnified part of the panel.
_LENSES_MAGNIFIED = 12


def picture(path: Path) -> Image.Image:
    """Read a picture."""
    with Image.open(path) as image:
        return image.convert("RGB")


def save_small(image: Image.Image, path: Path, quality: int = 85) -> None:
    """Write a strongly compressed picture."""
    image.save(path, quality=quality, method=6)


def photograph_report(run: Path, out: Path) -> None:
    """Write a screenshot of a report's first screen."""
    shot = out.with_suffix(".png")
    with browser() as tab:
        tab.send("Emulation.setDeviceMetricsOverride", **EYE.report_window, mobile=False)
        tab.open(run / "report.html")
        assert tab.evaluate("inimDisplay.ready")
        tab.screenshot(shot, whole=False)
    save_small(picture(shot), out)
    shot.unlink()


def _eye_positions() -> list[tuple[float, float]]:
    """Eye positions on an ellipse; both coordinates from -1 (left, below) to 1 (right, above)."""
    turns = (2 * math.pi * k / EYE.frames for k in range(EYE.frames))
    return [(math.sin(turn), math.cos(turn)) for turn in turns]


def eye_viewpoints() -> str:
    """Value of `--viewpoints` for all eye positions, named by their numbers."""
    return ", ".join(
        f"{k}={EYE.across_mm * x:.2f} {EYE.up_mm * y:.2f} {EYE.distance_mm:g}"
        for k, (x, y) in enumerate(_eye_positions())
    )


def film_eye(run: Path, out: Path) -> None:
    """Film the scene, a part of the panel, and the panel through its lenses."""
    data = json.loads((run / "report.json").read_text("utf-8"))
    first = picture(run / "truth/0.png")
    eia, derived = run / "eia" / f"{EYE.algorithm}.png", data["display"]["derived"]
    panel = _magnified(eia, derived, first.width)
    panel = panel.crop((0, 0, *first.size))
    frames = []
    for k, (x, _) in enumerate(_eye_positions()):
        scene = picture(run / f"truth/{k}.png")
        view = picture(run / f"views/{EYE.algorithm}/{k}.png")
        frames.append(_labelled(list(zip((scene, panel, view), EYE.captions, strict=True)), x))
    # An animated WebP that repeats without end.
    options = {"duration": EYE.frame_ms, "loop": 0, "quality": EYE.quality, "method": 6}
    frames[0].save(out, save_all=True, append_images=frames[1:], **options)


def _magnified(eia: Path, display: Mapping[str, float], width_px: int) -> Image.Image:
    """Magnify some elemental images, at least `width_px` wide; each panel pixel is a square."""
    pixels = display["pixels_per_lens"]
    left, top = (round(pixels * at) for at in EYE.lens)
    side = round(pixels * _LENSES_MAGNIFIED)
    crop = picture(eia).crop((left, top, left + side, top + side))
    large = side * max(2, math.ceil(width_px / side))
    return crop.resize((large, large), Image.Resampling.NEAREST)


def _labelled(panels: Sequence[tuple[Image.Image, str]], at: float) -> Image.Image:
    """Draw captioned panels in a row, and a line with the eye's position, -1 left to 1 right."""
    side, space, below = panels[0][0].width, EYE.space, EYE.below
    wide = len(panels) * (side + space) - space
    frame = Image.new("RGB", (wide + 2 * space, side + below + space), EYE.ground)
    draw = ImageDraw.Draw(frame)
    font = ImageFont.truetype(font_manager.findfont("DejaVu Sans"), EYE.text)
    for k, (image, caption) in enumerate(panels):
        left = space + k * (side + space)
        frame.paste(image, (left, space))
        draw.text(
            (left + side / 2, space + side + below * 0.3), caption, EYE.ink, font, anchor="mm"
        )
    middle, half, y = frame.width / 2, 0.3 * side, space + side + below * 0.74
    draw.line([(middle - half, y), (middle + half, y)], EYE.rail, 2)
    x = middle + half * at
    draw.ellipse([x - 6, y - 6, x + 6, y + 6], EYE.eye)
    for word, end, anchor in (("eye left", -1, "rm"), ("eye right", 1, "lm")):
        draw.text((middle + end * (half + 16), y), word, EYE.rail, font, anchor=anchor)
    return frame
