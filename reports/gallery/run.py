"""Pictures of the gallery, of README and of a tutorial.

    python -m reports.gallery.run            # pictures of all examples of docs/gallery.md
    python -m reports.gallery.run zone gap   # some of them
    python -m reports.gallery.run readme     # README's moving picture, and others in docs/images

The code of an example runs as printed, in a folder with a copy of `scenes`. `readme` needs
Chromium.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from PIL import Image

from reports.gallery.examples import PAGE, Example, read_examples
from reports.gallery.eye import EYE
from reports.gallery.pictures import (
    eye_viewpoints,
    film_eye,
    photograph_report,
    picture,
    save_small,
)

RUNS = Path("out", "gallery")
IMAGES = PAGE.parent / "images"
#: Width of the largest picture of an example.
_WIDEST_PX = 1024
_QUALITY = 75


def make_picture(example: Example) -> None:
    """Run an example's code, and store its picture for the page."""
    print(example.name, flush=True)
    words = [sys.executable, "-c"] if example.language == "python" else ["bash", "-e", "-c"]
    tools = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    with tempfile.TemporaryDirectory() as folder:
        shutil.copytree(PAGE.parents[1] / "scenes", Path(folder, "scenes"))
        environment = {**os.environ, "PATH": tools, "MPLBACKEND": "agg"}
        subprocess.run([*words, example.code], cwd=folder, env=environment, check=True)
        (result,) = Path(folder).rglob(f"{example.name}.png")
        image = picture(result)
        image.thumbnail((_WIDEST_PX, _WIDEST_PX))
        save_small(image, PAGE.parent / example.picture, _QUALITY)


def validate(folder: Path, scene: str, options: Sequence[str]) -> Path:
    """Run the command that a user would type, with its output in `folder`."""
    command = ["-m", "inim.validate", scene, *options, "-o", folder.as_posix(), "--quiet"]
    print(*command[1:-1], flush=True)
    subprocess.run([sys.executable, *command], check=True)
    return folder


def make_readme() -> None:
    """Make the picture of a report, that of README, and the EIA of the site's first page."""
    run = validate(RUNS / "readme", EYE.report_scene, EYE.report_options)
    photograph_report(run, IMAGES / "report.webp")
    run = validate(RUNS / "eye", EYE.scene, [*EYE.options, "--viewpoints", eye_viewpoints()])
    film_eye(run, IMAGES / "eye.webp")
    with Image.open(run / "eia" / f"{EYE.algorithm}.png") as eia:
        eia.save(IMAGES / "goblet-eia.webp", quality=90, method=6)


def main(names: Sequence[str]) -> None:
    """Make the pictures of the named examples, or of all."""
    examples = {example.name: example for example in read_examples()}
    for name in names or examples:
        if name == "readme":
            make_readme()
        else:
            make_picture(examples[name])


if __name__ == "__main__":
    main(sys.argv[1:])
