"""Read public files, and compare with what other programs find in them.

``python -m reports.zoo.run FOLDER`` reads the files of ``reports/zoo/zoo.jsonl`` and writes
``reports/zoo/zoo.md``. FOLDER is filled as `reports.zoo.expect` describes; the project has none of
the files. A file is *right* if its size or the mean of its colours is that of the expectation, or
if it is refused as expected.
"""

import hashlib
import json
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from inim.apps.own_picture.depth_photo import read_depth_photo
from inim.apps.own_picture.depth_values import DepthConvention, interpret_depth
from inim.apps.own_picture.picture_files import read_depth
from inim.display import DISPLAYS
from inim.image.files.image import read_exr
from inim.render import variant
from inim.render.meshes.account import mesh_account
from inim.render.meshes.mesh import mesh_kind, read_mesh
from inim.render.meshes.triangle_mesh import read_bytes
from inim.render.scene import open_scene
from inim.render.scene_files.file import AUTO, read_scene_file
from inim.report.summary import markdown_section
from inim.system.errors import InimError
from reports.zoo.expect import kind_of, quantiles

ZOO = Path(__file__).with_name("zoo.jsonl")
RIGHT, WARNED, REFUSED, WRONG, CRASHED = (
    "read and right", "read and right, with a warning", "refused with the reason", "wrong",
    "internal error",
)  # fmt: skip
# Relative differences: of sizes, of means of colours (half floats, or chroma in fewer pixels), of
# quantiles, of photographs (conversions of colour and chroma), and of numbers of shapes.
_LIMITS = {"mesh": 2e-3, "EXR": 5e-3, "RGB-D": 1e-4, "photograph": 1e-2, "scene": 1e-9}


def result_of(path: Path, expected: Any) -> tuple[str, str]:
    """Verdict on a file, and what was read or said."""
    heard: list[str] = []
    try:
        numbers = _numbers(path, heard)
    except InimError as error:
        is_expected = expected is None or isinstance(expected, str)
        return REFUSED if is_expected else WRONG, str(error).partition(": ")[2]
    except Exception as error:  # the table names it
        return CRASHED, f"{type(error).__name__}: {error}"
    words = ", ".join(f"{number:.6g}" for number in numbers)
    if isinstance(expected, str):
        return WRONG, f"{words}, but {expected}"
    if expected is not None:
        limit = _LIMITS[kind_of(path) or ""]
        if not np.allclose(numbers, expected, rtol=limit, atol=1e-5 * max(map(abs, expected))):
            return WRONG, f"{words} instead of {expected}"
    return (WARNED, heard[0].partition(": ")[2]) if heard else (RIGHT, words)


def _numbers(path: Path, heard: list[str]) -> list[float]:
    """Numbers of a file that `reports.zoo.expect` lists for its kind."""
    kind = kind_of(path)
    if kind == "EXR":
        light = read_exr(path).astype(np.float64)
        finite = np.where(np.isfinite(light), light, np.nan)
        return [float(mean) for mean in np.nanmean(finite, axis=(0, 1))]
    if kind == "RGB-D":
        convention = DepthConvention(float(path.suffix == ".png"))
        values = interpret_depth(read_depth(path), convention, str(path))
        heard += values.warnings
        return quantiles(values.depth, np.isnan(values.depth))
    if kind == "photograph":
        photo = read_depth_photo(path)
        heard += photo.values.warnings
        depth = photo.values.depth
        unit = (depth - np.nanmin(depth)) / (np.nanmax(depth) - np.nanmin(depth))
        return [*map(float, photo.color.mean(axis=(0, 1))), *quantiles(unit, np.isnan(unit))]
    if kind == "scene":
        variant.use()
        scene = open_scene(read_scene_file(path, {}, (AUTO,)), DISPLAYS["phone"], 0.9)
        heard += scene.warnings
        return [float(scene.shapes + len(scene.left_out))]
    data = read_bytes(path)
    meshes = read_mesh(path, heard.append, data)
    account = mesh_account(data, mesh_kind(path, data), meshes)
    heard += account.lost(meshes, 1.0)
    return account.size


def check_folder(folder: Path) -> list[list[str]]:
    """Rows of the files that a folder has: verdict, file, what was read or said; worst first."""
    rows = []
    for entry in map(json.loads, ZOO.read_text("utf-8").splitlines()):
        path = folder / entry["repository"].replace("/", "+") / entry["path"]
        if path.is_file() and hashlib.sha256(path.read_bytes()).hexdigest() == entry["sha256"]:
            verdict, text = result_of(path, entry["expected"])
            name = f"{entry['repository']}: {entry['path']}"
            text = text.replace(f"{folder}/", "")[:150]
            rows.append([verdict, str(kind_of(path)), name, text])
    order = [CRASHED, WRONG, WARNED, REFUSED, RIGHT]
    return sorted(rows, key=lambda row: order.index(row[0]))


def main(words: list[str]) -> int:
    """Write the table; 1 if a file is wrong."""
    rows = check_folder(Path(words[0]))
    counts = Counter(row[0] for row in rows)
    kinds = Counter((row[1], row[0]) for row in rows)
    heads = ["verdict", *(names := sorted({row[1] for row in rows})), "all", "share"]
    summary = [
        [verdict, *(str(kinds[name, verdict]) for name in names), str(n), f"{n / len(rows):.1%}"]
        for verdict, n in counts.most_common()
    ]
    text = [
        "# Public files",
        "What `python -m reports.zoo.run` reads of public files. Expectations are those of other "
        "programs (`reports/zoo/expect.py`).",
        markdown_section("Verdicts", heads, summary),
        markdown_section("Files, worst first", ["verdict", "kind", "file", "read, or said"], rows),
    ]
    Path(__file__).with_name("zoo.md").write_text("\n\n".join(text) + "\n", "utf-8")
    print(*(f"{count:4} {verdict}" for verdict, count in counts.most_common()), sep="\n")
    return int(bool(counts[WRONG] + counts[CRASHED]))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
