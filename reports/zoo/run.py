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

from inim.image.files.image import read_exr
from inim.render.meshes.account import mesh_account
from inim.render.meshes.mesh import mesh_kind, read_mesh
from inim.render.meshes.triangle_mesh import read_bytes
from inim.report.summary import markdown_section
from inim.system.errors import FileError

ZOO = Path(__file__).with_name("zoo.jsonl")
RIGHT, WARNED, REFUSED, WRONG, CRASHED = (
    "read and right", "read and right, with a warning", "refused with the reason", "wrong",
    "internal error",
)  # fmt: skip
# Relative differences of sizes, and of means of colours (half floats, or chroma in fewer pixels).
_OF_SIZES, _OF_MEANS = 2e-3, 5e-3


def result_of(path: Path, expected: Any) -> tuple[str, str]:
    """Verdict on a file, and what was read or said."""
    heard: list[str] = []
    try:
        numbers = _numbers(path, heard)
    except FileError as error:
        is_expected = expected is None or isinstance(expected, str)
        return REFUSED if is_expected else WRONG, str(error).partition(": ")[2]
    except Exception as error:  # the table names it
        return CRASHED, f"{type(error).__name__}: {error}"
    words = ", ".join(f"{number:.6g}" for number in numbers)
    if isinstance(expected, str):
        return WRONG, f"{words}, but {expected}"
    if expected is not None:
        limit = _OF_MEANS if path.suffix.lower() == ".exr" else _OF_SIZES
        if not np.allclose(numbers, expected, rtol=limit, atol=1e-5 * max(map(abs, expected))):
            return WRONG, f"{words} instead of {expected}"
    return (WARNED, heard[0].partition(": ")[2]) if heard else (RIGHT, words)


def _numbers(path: Path, heard: list[str]) -> list[float]:
    """Size of a mesh, or mean of the finite colours of a picture."""
    if path.suffix.lower() == ".exr":
        light = read_exr(path).astype(np.float64)
        finite = np.where(np.isfinite(light), light, np.nan)
        return [float(mean) for mean in np.nanmean(finite, axis=(0, 1))]
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
            rows.append([verdict, f"{entry['repository']}: {entry['path']}", text[:150]])
    order = [CRASHED, WRONG, WARNED, REFUSED, RIGHT]
    return sorted(rows, key=lambda row: order.index(row[0]))


def main(words: list[str]) -> int:
    """Write the table; 1 if a file is wrong."""
    rows = check_folder(Path(words[0]))
    counts = Counter(row[0] for row in rows)
    summary = [[verdict, str(n), f"{n / len(rows):.1%}"] for verdict, n in counts.most_common()]
    text = [
        "# Public files",
        "What `python -m reports.zoo.run` reads of public files. Expectations are those of other "
        "programs (`reports/zoo/expect.py`).",
        markdown_section("Verdicts", ["verdict", "files", "share"], summary),
        markdown_section("Files, worst first", ["verdict", "file", "read, or said"], rows),
    ]
    Path(__file__).with_name("zoo.md").write_text("\n\n".join(text) + "\n", "utf-8")
    print(*(f"{count:4} {verdict}" for verdict, count in counts.most_common()), sep="\n")
    return int(bool(counts[WRONG] + counts[CRASHED]))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
