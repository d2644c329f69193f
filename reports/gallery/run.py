"""What the gallery of the documents shows, and the two pictures of README.

    python -m reports.gallery.run            # every entry, into reports/gallery/NAME
    python -m reports.gallery.run jade zone  # some
    python -m reports.gallery.run readme     # docs/images

Each entry keeps the reports of its runs, as they were written, and a few small pictures. The runs
themselves are made below out/gallery. `docs/generate.py` makes the page of `gallery.json`.
`zone` and `readme` need Chromium.
"""

from __future__ import annotations

import base64
import json
import math
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
from matplotlib import font_manager
from PIL import Image, ImageDraw, ImageFont

from reports.gallery.entries import ENTRIES, EYE, Entry
from tests.chromium import Tab, browser

HERE = Path(__file__).parent
RUNS = Path("out", "gallery")
IMAGES = Path("docs", "images")
_QUALITY = 85
_LENSES_MAGNIFIED = 12
_DIFFERENCE_TIMES = 4


@dataclass(frozen=True)
class Picture:
    """A file of an entry's folder, and what it is."""

    file: str
    caption: str


@dataclass
class Shown:
    """What the page says of an entry; `reports` by label."""

    name: str
    title: str
    text: str
    pictures: list[Picture] = field(default_factory=list)
    reports: dict[str, str] = field(default_factory=dict)


# ---- runs


def validate(folder: Path, scene: str, options: Sequence[str]) -> Path:
    """Run the command that a user would type; what it writes lies in `folder`."""
    command = ["-m", "inim.validate", scene, *options, "-o", folder.as_posix(), "--quiet"]
    print(*command[1:-1], flush=True)
    subprocess.run([sys.executable, *command], check=True)
    return folder


def make_entry(name: str) -> None:
    """Make an entry's runs, and keep of them what the page shows."""
    entry, folder = ENTRIES[name], HERE / name
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    shown = Shown(name, entry.title, entry.text)
    for label, options in entry.runs.items():
        run = validate(RUNS / name / (label or "run"), entry.scene, options)
        file = f"report-{label.replace(' ', '-')}.json" if label else "report.json"
        shutil.copy(run / "report.json", folder / file)
        shown.reports[label] = file
    first = RUNS / name / (next(iter(entry.runs)) or "run")
    if name == "zone":
        shown.pictures.append(leave_the_zone(first, folder))
    elif len(entry.runs) == 1:
        shown.pictures.extend(pictures_of_run(first, folder, entry))
    else:
        keep(picture(first / "truth/centre.png"), folder / "scene.webp")
        shown.pictures.append(Picture("scene.webp", "the scene from the eye"))
        for label in entry.runs:
            file = f"{label.replace(' ', '-')}.webp"
            keep(picture(RUNS / name / label / "views" / entry.view / "centre.png"), folder / file)
            shown.pictures.append(Picture(file, label))
    (folder / "entry.json").write_text(json.dumps(asdict(shown), indent=1) + "\n", "utf-8")


def pictures_of_run(run: Path, folder: Path, entry: Entry) -> list[Picture]:
    """The scene, the ceiling, elemental images, and each algorithm, the worst first."""
    data = json.loads((run / "report.json").read_text("utf-8"))
    score = {
        name: found["views"]["centre"]["ssim_to_ceiling"]
        for name, found in data["algorithms"].items()
    }
    order = sorted(score, key=score.__getitem__)
    ceiling = picture(run / "views/ceiling/centre.png")
    shown = {
        "scene": (picture(run / "truth/centre.png"), "the scene from the eye"),
        "ceiling": (ceiling, "the best this display can show"),
        "lenses": (
            magnified(run / "truth/eia.png", data["display"]["derived"], entry.lens),
            f"{_LENSES_MAGNIFIED} × {_LENSES_MAGNIFIED} elemental images of the panel",
        ),
    }
    for name in order:
        view = picture(run / "views" / name / "centre.png")
        shown[name] = view, f"{name}: SSIM {score[name]:.3f} to the best"
    away = np.abs(np.asarray(ceiling, float) - np.asarray(shown[order[0]][0], float))
    shown["difference"] = (
        Image.fromarray((away * _DIFFERENCE_TIMES).clip(0, 255).astype(np.uint8)),
        f"difference of {order[0]} and the best, {_DIFFERENCE_TIMES} times",
    )
    for name, (image, _) in shown.items():
        keep(image, folder / f"{name}.webp")
    return [Picture(f"{name}.webp", caption) for name, (_, caption) in shown.items()]


# ---- pictures


def picture(path: Path) -> Image.Image:
    """A picture of a report."""
    with Image.open(path) as image:
        return image.convert("RGB")


def keep(image: Image.Image, path: Path) -> None:
    """Write it small."""
    image.save(path, quality=_QUALITY, method=6)


def magnified(eia: Path, display: dict[str, float], lens: tuple[int, int]) -> Image.Image:
    """Some lenses of an EIA from a lens (column, row) on, each panel pixel a square."""
    pixels = display["pixels_per_lens"]
    left, top = (round(pixels * at) for at in lens)
    side = round(pixels * _LENSES_MAGNIFIED)
    crop = picture(eia).crop((left, top, left + side, top + side))
    return crop.resize((2 * side, 2 * side), Image.Resampling.NEAREST)


def film(path: Path, frames: Sequence[Image.Image], milliseconds: int) -> None:
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


def labelled(
    panels: Sequence[tuple[Image.Image, str]], at: float, zone: tuple[float, float] | None = None
) -> Image.Image:
    """Panels side by side, their names below, and where the eye is, -1 left to 1 right.

    `zone` is the part of the way that lies in the viewing zone.
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
    middle, half, y = frame.width / 2, 0.3 * side, space + side + below * 0.74
    draw.line([(middle - half, y), (middle + half, y)], EYE.rail, 2)
    if zone:
        draw.line([(middle + half * zone[0], y), (middle + half * zone[1], y)], EYE.ink, 4)
    x = middle + half * at
    draw.ellipse([x - 6, y - 6, x + 6, y + 6], EYE.eye)
    for word, end, anchor in (("eye left", -1, "rm"), ("eye right", 1, "lm")):
        draw.text((middle + end * (half + 16), y), word, EYE.rail, font, anchor=anchor)
    return frame


# ---- the eye moves


def leave_the_zone(run: Path, folder: Path) -> Picture:
    """The report's live display, its eye moved to the next zone and back; `inim film` stays in."""
    frames = []
    with browser(RUNS / "profile") as tab:
        tab.open(run / "report.html")
        assert tab.evaluate("inimDisplay.ready")
        tab.evaluate("document.querySelector('input[name=lens-model][value=thin]').click()")
        z = tab.evaluate("inimDisplay.eye()[2]")
        limit = tab.evaluate(f"inimDisplay.flipLimit({z})[0]")
        farthest = EYE.zones * limit
        for k in range(EYE.zone_frames):
            at = math.sin(2 * math.pi * k / EYE.zone_frames)
            tab.evaluate(f"inimDisplay.setEye({at * farthest}, 0, {z})")
            seen = live_view(tab, EYE.zone_px)
            frames.append(labelled([(seen, EYE.zone_words)], at, (-1 / EYE.zones, 1 / EYE.zones)))
    film(folder / "zone.webp", frames, EYE.zone_ms)
    return Picture("zone.webp", f"±{farthest:.0f} mm; the zone ends at ±{limit:.1f} mm")


def live_view(tab: Tab, side: int) -> Image.Image:
    """What the left screen of the virtual display shows, 64 samples a pixel."""
    said = tab.evaluate(f"inimDisplay.pixels(0, {side}, {side})")
    return Image.frombytes("RGBA", (side, side), base64.b64decode(said["data"])).convert("RGB")


def make_readme() -> None:
    """The first screen of a report, and the scene and its display seen by an eye that moves."""
    IMAGES.mkdir(exist_ok=True)
    run = validate(RUNS / "readme", EYE.report_scene, EYE.report_options)
    with browser(RUNS / "profile") as tab:
        tab.send("Emulation.setDeviceMetricsOverride", **EYE.report_window, mobile=False)
        tab.open(run / "report.html")
        assert tab.evaluate("inimDisplay.ready")
        tab.screenshot(RUNS / "report.png", whole=False)
    keep(picture(RUNS / "report.png"), IMAGES / "report.webp")

    places = [(math.sin(turn), math.cos(turn)) for turn in EYE.turns]
    viewpoints = ", ".join(
        f"{k}={EYE.across_mm * x:.2f} {EYE.up_mm * y:.2f} {EYE.distance_mm}"
        for k, (x, y) in enumerate(places)
    )
    run = validate(RUNS / "eye", EYE.scene, [*EYE.options, "--viewpoints", viewpoints])
    data = json.loads((run / "report.json").read_text("utf-8"))
    panel = magnified(run / "eia" / f"{EYE.algorithm}.png", data["display"]["derived"], EYE.lens)
    first = picture(run / "truth/0.png")
    panel = panel.crop((0, 0, *first.size))
    frames = [
        labelled(
            [
                (picture(run / f"truth/{k}.png"), "the scene"),
                (panel, "the panel, magnified"),
                (picture(run / f"views/{EYE.algorithm}/{k}.png"), "the panel through its lenses"),
            ],
            x,
        )
        for k, (x, _) in enumerate(places)
    ]
    film(IMAGES / "eye.webp", frames, EYE.frame_ms)


def main(names: Sequence[str]) -> None:
    """Make what is named, or every entry."""
    for name in names or ENTRIES:
        if name == "readme":
            make_readme()
        else:
            make_entry(name)


if __name__ == "__main__":
    main(sys.argv[1:])
