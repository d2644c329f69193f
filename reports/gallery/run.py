"""Runs and pictures of the gallery, and the pictures of README and of a tutorial.

    python -m reports.gallery.run            # all entries, into reports/gallery/NAME
    python -m reports.gallery.run jade zone  # some entries
    python -m reports.gallery.run readme     # into docs/images

Each entry contains the unchanged reports of its runs and a few small pictures. The runs are in
out/gallery. `docs/generate.py` builds the page. `zone` and `readme` need Chromium; `museum_room`
takes some minutes.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from inim.scores.metrics import HEADLINE
from reports.gallery.entries import ENTRIES, EYE, ROOM, Entry
from reports.gallery.pictures import (
    LENSES_MAGNIFIED,
    eye_viewpoints,
    film_beyond_zone,
    film_eye,
    magnified,
    middle,
    photograph_report,
    picture,
    save_small,
)

HERE = Path(__file__).parent
RUNS = Path("out", "gallery")
IMAGES = Path("docs", "images")
_DIFFERENCE_TIMES = 4
# Files of pictures, with their captions.
_Captions = dict[str, str]


def validate(folder: Path, scene: str, options: Sequence[str]) -> Path:
    """Run the command that a user would type, with its output in `folder`."""
    command = ["-m", "inim.validate", scene, *options, "-o", folder.as_posix(), "--quiet"]
    print(*command[1:-1], flush=True)
    subprocess.run([sys.executable, *command], check=True)
    return folder


def make_entry(name: str) -> None:
    """Run an entry's commands, and store their reports and pictures for the page."""
    entry, folder = ENTRIES[name], HERE / name
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    runs, reports = {}, {}
    for label, options in entry.runs.items():
        runs[label] = validate(RUNS / name / file_name(label), entry.scene, options)
        reports[label] = f"{file_name('report', label)}.json"
        shutil.copy(runs[label] / "report.json", folder / reports[label])
    if name == "zone":
        far, end = film_beyond_zone(runs[""], folder / "zone.webp")
        caption = f"the eye moves {far:.0f} mm to the right and back; the zone ends at {end:.1f} mm"
        captions = {"zone.webp": caption}
    elif name == "museum_room":
        render_room(runs[""], folder / "room.webp")
        captions = {"room.webp": "the room, path traced with the display in it"}
    elif "" in runs:
        captions = pictures_of_run(runs[""], folder, entry)
    else:
        captions = pictures_of_runs(runs, folder, entry)
    content = {
        "name": name,
        "title": entry.title,
        "text": entry.text,
        "pictures": [{"file": file, "caption": text} for file, text in captions.items()],
        "reports": reports,
    }
    (folder / "entry.json").write_text(json.dumps(content, indent=1) + "\n", "utf-8")


def file_name(*words: str) -> str:
    """Join words to a part of a path that needs no quotes."""
    return "-".join(filter(None, words)).translate({ord("°"): "deg", ord(" "): "-", ord(","): None})


def pictures_of_run(run: Path, folder: Path, entry: Entry) -> _Captions:
    """Save the ground truth, the reference, elemental images, and each algorithm's view."""
    data = json.loads((run / "report.json").read_text("utf-8"))
    score = {n: result["views"]["centre"][HEADLINE] for n, result in data["algorithms"].items()}
    order = sorted(score, key=score.__getitem__)
    views = {name: middle(run / "views" / name / "centre.png") for name in ("reference", *order)}
    lenses = magnified(run / "truth/eia.png", data["display"]["derived"], entry.lens)
    difference = np.abs(np.subtract(views["reference"], views[order[0]], dtype=float))
    amplified = (difference * _DIFFERENCE_TIMES).clip(0, 255).astype(np.uint8)
    pictures = {
        "scene": (middle(run / "truth/centre.png"), "ground truth: the scene"),
        "reference": (views["reference"], "reference: the ground-truth EIA through the lenses"),
        "lenses": (
            lenses,
            f"{LENSES_MAGNIFIED} × {LENSES_MAGNIFIED} elemental images of the panel",
        ),
        **{n: (views[n], f"{n}: SSIM {score[n]:.3f} to the reference") for n in order},
        "difference": (
            Image.fromarray(amplified),
            f"difference between {order[0]} and the reference, magnified {_DIFFERENCE_TIMES} times",
        ),
    }
    for name, (image, _) in pictures.items():
        save_small(image, folder / f"{name}.webp")
    return {f"{name}.webp": caption for name, (_, caption) in pictures.items()}


def pictures_of_runs(runs: dict[str, Path], folder: Path, entry: Entry) -> _Captions:
    """Save the view of each run from the centre, after the ground truth if it is shown."""
    files = {f"{file_name(label)}.webp": label for label in runs}
    for file, label in files.items():
        save_small(middle(runs[label] / "views" / entry.view / "centre.png"), folder / file)
    if not entry.shows_scene:
        return files
    save_small(middle(next(iter(runs.values())) / "truth/centre.png"), folder / "scene.webp")
    return {"scene.webp": "ground truth: the scene", **files}


def render_room(run: Path, out: Path) -> None:
    """Render the museum room with a run's EIA on the phone."""
    import inim

    inim.register_plugins()
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    room = mi.load_file(ROOM["scene"], eia=str((run / ROOM["eia"]).resolve()), spp=ROOM["spp"])
    shot = run / "room.png"
    mi.util.write_bitmap(str(shot), mi.render(room), write_async=False)
    save_small(picture(shot), out)


def make_readme() -> None:
    """Make the picture of a report, that of README, and the EIA of the site's first page."""
    IMAGES.mkdir(exist_ok=True)
    run = validate(RUNS / "readme", EYE.report_scene, EYE.report_options)
    photograph_report(run, IMAGES / "report.webp")
    run = validate(RUNS / "eye", EYE.scene, [*EYE.options, "--viewpoints", eye_viewpoints()])
    film_eye(run, IMAGES / "eye.webp")
    with Image.open(run / "eia" / f"{EYE.algorithm}.png") as eia:
        eia.save(IMAGES / "goblet-eia.webp", quality=90, method=6)


def main(names: Sequence[str]) -> None:
    """Make the named entries, or all."""
    for name in names or ENTRIES:
        if name == "readme":
            make_readme()
        else:
            make_entry(name)
    complete = [name for name in ENTRIES if (HERE / name / "entry.json").exists()]
    (HERE / "gallery.json").write_text(json.dumps(complete, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
