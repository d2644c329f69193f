"""What the gallery of the documents shows, and the two pictures of README.

    python -m reports.gallery.run            # every entry, into reports/gallery/NAME
    python -m reports.gallery.run jade zone  # some
    python -m reports.gallery.run readme     # docs/images

Each entry keeps the reports of its runs, as they were written, and a few small pictures. The runs
themselves are made below out/gallery. `docs/generate.py` makes the page of what is kept.
`zone` and `readme` need Chromium; `museum_room` takes some minutes.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
from PIL import Image

from inim.metrics.headline import HEADLINE
from reports.gallery.entries import ENTRIES, EYE, ROOM, Entry
from reports.gallery.eye import eye_viewpoints, film_beyond_zone, film_eye, photograph_report
from reports.gallery.pictures import LENSES_MAGNIFIED, keep, magnified, middle, picture

HERE = Path(__file__).parent
RUNS = Path("out", "gallery")
IMAGES = Path("docs", "images")
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
    runs = {}
    for label, options in entry.runs.items():
        runs[label] = validate(RUNS / name / file_name(label), entry.scene, options)
        shown.reports[label] = f"{file_name('report', label)}.json"
        shutil.copy(runs[label] / "report.json", folder / shown.reports[label])
    if name == "zone":
        far, end = film_beyond_zone(runs[""], folder / "zone.webp")
        words = f"the eye goes {far:.0f} mm to the right and back; the zone ends at {end:.1f} mm"
        shown.pictures.append(Picture("zone.webp", words))
    elif name == "museum_room":
        render_room(runs[""], folder / "room.webp")
        shown.pictures.append(Picture("room.webp", "the room, path traced with the display in it"))
    elif "" in runs:
        shown.pictures.extend(pictures_of_run(runs[""], folder, entry))
    else:
        if entry.shows_scene:
            keep(middle(next(iter(runs.values())) / "truth/centre.png"), folder / "scene.webp")
            shown.pictures.append(Picture("scene.webp", "the scene from the eye"))
        for label, run in runs.items():
            file = f"{file_name(label)}.webp"
            keep(middle(run / "views" / entry.view / "centre.png"), folder / file)
            shown.pictures.append(Picture(file, label))
    (folder / "entry.json").write_text(json.dumps(asdict(shown), indent=1) + "\n", "utf-8")


def file_name(*words: str) -> str:
    """Words as part of a path that needs no quotes."""
    return "-".join(filter(None, words)).translate({ord("°"): "deg", ord(" "): "-", ord(","): None})


def pictures_of_run(run: Path, folder: Path, entry: Entry) -> list[Picture]:
    """The scene, the reference, elemental images, and each algorithm, the worst first."""
    data = json.loads((run / "report.json").read_text("utf-8"))
    score = {name: found["views"]["centre"][HEADLINE] for name, found in data["algorithms"].items()}
    order = sorted(score, key=score.__getitem__)
    reference = middle(run / "views/reference/centre.png")
    shown = {
        "scene": (middle(run / "truth/centre.png"), "the scene from the eye"),
        "reference": (reference, "the reference: the true EIA through the lenses"),
        "lenses": (
            magnified(run / "truth/eia.png", data["display"]["derived"], entry.lens),
            f"{LENSES_MAGNIFIED} × {LENSES_MAGNIFIED} elemental images of the panel",
        ),
    }
    for name in order:
        view = middle(run / "views" / name / "centre.png")
        shown[name] = view, f"{name}: SSIM {score[name]:.3f} to the reference"
    away = np.abs(np.asarray(reference, float) - np.asarray(shown[order[0]][0], float))
    shown["difference"] = (
        Image.fromarray((away * _DIFFERENCE_TIMES).clip(0, 255).astype(np.uint8)),
        f"difference of {order[0]} and reference, {_DIFFERENCE_TIMES} times",
    )
    for name, (image, _) in shown.items():
        keep(image, folder / f"{name}.webp")
    return [Picture(f"{name}.webp", caption) for name, (_, caption) in shown.items()]


def render_room(run: Path, out: Path) -> None:
    """The museum's room, a run's EIA on its phone."""
    import inim

    inim.register_plugins()
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    room = mi.load_file(ROOM["scene"], eia=str((run / ROOM["eia"]).resolve()), spp=ROOM["spp"])
    shot = run / "room.png"
    mi.util.write_bitmap(str(shot), mi.render(room), write_async=False)
    keep(picture(shot), out)


def make_readme() -> None:
    """README's two pictures."""
    IMAGES.mkdir(exist_ok=True)
    run = validate(RUNS / "readme", EYE.report_scene, EYE.report_options)
    photograph_report(run, IMAGES / "report.webp")
    run = validate(RUNS / "eye", EYE.scene, [*EYE.options, "--viewpoints", eye_viewpoints()])
    film_eye(run, IMAGES / "eye.webp")


def main(names: Sequence[str]) -> None:
    """Make what is named, or every entry."""
    for name in names or ENTRIES:
        if name == "readme":
            make_readme()
        else:
            make_entry(name)
    made = [name for name in ENTRIES if (HERE / name / "entry.json").exists()]
    (HERE / "gallery.json").write_text(json.dumps(made, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
