"""Films of an eye that moves, and README's pictures.

The scene and its display are seen from every place of the eye by one `inim validate` with a
viewpoint for each. `inim film` and `inim validate` keep the eye in the viewing zone; where it
leaves, the report's own live display is asked, in Chromium.
"""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Sequence
from pathlib import Path

from matplotlib import font_manager
from PIL import Image, ImageDraw, ImageFont

from reports.gallery.entries import EYE
from reports.gallery.pictures import keep, magnified, picture
from tests.chromium import Tab, browser


def photograph_report(run: Path, out: Path) -> None:
    """The first screen of a report."""
    shot = out.with_suffix(".png")
    with browser() as tab:
        tab.send("Emulation.setDeviceMetricsOverride", **EYE.report_window, mobile=False)
        tab.open(run / "report.html")
        assert tab.evaluate("inimDisplay.ready")
        tab.screenshot(shot, whole=False)
    keep(picture(shot), out)
    shot.unlink()


def _eye_places() -> list[tuple[float, float]]:
    """Places of the eye on its way round, each -1 to 1: left to right, down to up."""
    turns = (2 * math.pi * k / EYE.frames for k in range(EYE.frames))
    return [(math.sin(turn), math.cos(turn)) for turn in turns]


def eye_viewpoints() -> str:
    """The same as `--viewpoints`, named by their numbers."""
    return ", ".join(
        f"{k}={EYE.across_mm * x:.2f} {EYE.up_mm * y:.2f} {EYE.distance_mm:g}"
        for k, (x, y) in enumerate(_eye_places())
    )


def film_eye(run: Path, out: Path) -> None:
    """The scene, some of the panel, and the panel through its lenses, from `eye_viewpoints`."""
    data = json.loads((run / "report.json").read_text("utf-8"))
    first = picture(run / "truth/0.png")
    panel = magnified(run / "eia" / f"{EYE.algorithm}.png", data["display"]["derived"], EYE.lens)
    panel = panel.crop((0, 0, *first.size))
    frames = []
    for k, (x, _) in enumerate(_eye_places()):
        scene = picture(run / f"truth/{k}.png")
        shown = picture(run / f"views/{EYE.algorithm}/{k}.png")
        frames.append(_labelled(list(zip((scene, panel, shown), EYE.words, strict=True)), x))
    _film(out, frames, EYE.frame_ms)


def film_beyond_zone(run: Path, out: Path) -> tuple[float, float]:
    """A report's live display, its eye moved to the next viewing zone and back.

    Returns
    -------
    (float, float)
        How far the eye goes, and where the zone ends, millimetres.
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
            at = EYE.zone_way * (1 - abs(1 - 2 * k / EYE.zone_frames))
            tab.evaluate(f"inimDisplay.setEye({at * limit}, 0, {z})")
            panel = _live_view(tab), EYE.zone_words
            frames.append(_labelled([panel], (at - middle) / half, zones))
    _film(out, frames, EYE.zone_ms)
    return EYE.zone_way * limit, limit


def _live_view(tab: Tab) -> Image.Image:
    """What the left screen of the virtual display shows, 64 samples a pixel."""
    side = EYE.zone_px
    said = tab.evaluate(f"inimDisplay.pixels(0, {side}, {side})")
    return Image.frombytes("RGBA", (side, side), base64.b64decode(said["data"])).convert("RGB")


def _labelled(
    panels: Sequence[tuple[Image.Image, str]],
    at: float,
    zones: Sequence[tuple[float, float]] = (),
) -> Image.Image:
    """Panels side by side, their names below, and where the eye is, -1 left to 1 right.

    `zones` are the parts of the line that lie in viewing zones; without, its ends have words.
    """
    side, space, below = panels[0][0].width, EYE.space, EYE.below
    wide = len(panels) * (side + space) - space
    frame = Image.new("RGB", (wide + 2 * space, side + below + space), EYE.ground)
    draw = ImageDraw.Draw(frame)
    font = ImageFont.truetype(font_manager.findfont("DejaVu Sans"), EYE.text)
    for k, (image, words) in enumerate(panels):
        left = space + k * (side + space)
        frame.paste(image, (left, space))
        draw.text((left + side / 2, space + side + below * 0.3), words, EYE.ink, font, anchor="mm")
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
    """An animated WebP that runs for ever."""
    frames[0].save(
        path,
        save_all=True,
        append_images=frames[1:],
        duration=milliseconds,
        loop=0,
        quality=EYE.quality,
        method=6,
    )
