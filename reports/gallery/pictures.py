"""Pictures of reports, reduced, and films with a moving eye.

One `inim validate` with a viewpoint for each eye position renders the scene and its display, with
the eye in the viewing zone. The film of an eye that leaves the zone is drawn by the report's
virtual display, in Chromium.
"""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib import font_manager
from PIL import Image, ImageDraw, ImageFont

from reports.gallery.entries import EYE
from tests.chromium import Tab, browser

#: Number of lenses along a side of a picture of `magnified`.
LENSES_MAGNIFIED = 12
_QUALITY = 85


def picture(path: Path) -> Image.Image:
    """Read a picture of a report."""
    with Image.open(path) as image:
        return image.convert("RGB")


def middle(path: Path) -> Image.Image:
    """Read the middle square of a picture, which shows the relic."""
    image = picture(path)
    side = min(image.size)
    left, top = ((length - side) // 2 for length in image.size)
    return image.crop((left, top, left + side, top + side))


def save_small(image: Image.Image, path: Path) -> None:
    """Write a strongly compressed picture."""
    image.save(path, quality=_QUALITY, method=6)


def magnified(
    eia: Path, display: Mapping[str, float], lens: tuple[int, int], width_px: int = 0
) -> Image.Image:
    """Magnify some elemental images, from the lens (column, row); each panel pixel is a square.

    The picture is at least `width_px` wide.
    """
    pixels = display["pixels_per_lens"]
    left, top = (round(pixels * at) for at in lens)
    side = round(pixels * LENSES_MAGNIFIED)
    crop = picture(eia).crop((left, top, left + side, top + side))
    large = side * max(2, math.ceil(width_px / side))
    return crop.resize((large, large), Image.Resampling.NEAREST)


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
    panel = magnified(eia, derived, EYE.lens, first.width)
    panel = panel.crop((0, 0, *first.size))
    frames = []
    for k, (x, _) in enumerate(_eye_positions()):
        scene = picture(run / f"truth/{k}.png")
        view = picture(run / f"views/{EYE.algorithm}/{k}.png")
        frames.append(_labelled(list(zip((scene, panel, view), EYE.captions, strict=True)), x))
    _film(out, frames, EYE.frame_ms)


def film_beyond_zone(run: Path, out: Path) -> tuple[float, float]:
    """Film a report's virtual display while the eye moves to the next viewing zone and back.

    Returns the farthest eye position and the end of the viewing zone, in mm from the centre.
    """
    middle, half = sum(EYE.line) / 2, (EYE.line[1] - EYE.line[0]) / 2
    zones = [((left - middle) / half, (right - middle) / half) for left, right in EYE.zones]
    frames = []
    with browser() as tab:
        tab.open(run / "report.html")
        assert tab.evaluate("inimDisplay.ready")
        tab.evaluate("document.querySelector('input[name=lens-model][value=thin]').click()")
        z = tab.evaluate("inimDisplay.eye()[2]")
        limit = tab.evaluate(f"inimDisplay.flipLimit({z})[0]")
        for k in range(EYE.zone_frames):
            at = EYE.farthest * (1 - abs(1 - 2 * k / EYE.zone_frames))
            tab.evaluate(f"inimDisplay.setEye({at * limit}, 0, {z})")
            panel = _live_view(tab), EYE.zone_caption
            frames.append(_labelled([panel], (at - middle) / half, zones))
    _film(out, frames, EYE.zone_ms)
    return EYE.farthest * limit, limit


def _live_view(tab: Tab) -> Image.Image:
    """Image on the left screen of the virtual display, with 64 samples per pixel."""
    side = EYE.zone_px
    pixels = tab.evaluate(f"inimDisplay.pixels(0, {side}, {side})")
    return Image.frombytes("RGBA", (side, side), base64.b64decode(pixels["data"])).convert("RGB")


def _labelled(
    panels: Sequence[tuple[Image.Image, str]],
    at: float,
    zones: Sequence[tuple[float, float]] = (),
) -> Image.Image:
    """Draw captioned panels side by side, and a line with the eye's position, -1 left to 1 right.

    `zones` are the parts of the line inside viewing zones. Without them, the ends are labelled.
    """
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
    middle, half, y = frame.width / 2, (0.45 if zones else 0.3) * side, space + side + below * 0.74
    draw.line([(middle - half, y), (middle + half, y)], EYE.rail, 2)
    for left, right in zones:
        draw.line([(middle + half * left, y), (middle + half * right, y)], EYE.ink, 5)
    x = middle + half * at
    draw.ellipse([x - 6, y - 6, x + 6, y + 6], EYE.eye)
    for word, end, anchor in () if zones else (("eye left", -1, "rm"), ("eye right", 1, "lm")):
        draw.text((middle + end * (half + 16), y), word, EYE.rail, font, anchor=anchor)
    return frame


def _film(path: Path, frames: Sequence[Image.Image], milliseconds: int) -> None:
    """Write an animated WebP that repeats without end."""
    options = {"duration": milliseconds, "loop": 0, "quality": EYE.quality, "method": 6}
    frames[0].save(path, save_all=True, append_images=frames[1:], **options)
