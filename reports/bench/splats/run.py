"""Time and memory of a validation against the number of splats.

    python -m reports.bench.splats.run 10000 100000 1000000 -o reports/bench/splats

Each relic is a bumpy ball, evenly covered with opaque splats. They have harmonics of all degrees
and overlap as in trained models: their size decreases with their number. `inim new-scene` and
`inim validate` run as whole commands with few lenses and samples, without the result cache.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from inim.cache import FOLDER_VARIABLE
from inim.errors import EXIT_PASSED, WorkerError
from inim.files.splat_ply import Splats, write_splats
from inim.report.labels import number
from inim.report.study import PagePart, Table
from reports.bench.parts import items, part
from reports.bench.process import run_measured
from reports.bench.study import new_parser, run_study

# Stages in `timings` of a validation's report.
_STAGES = ("open scene", "capture RGB-D", "ground-truth EIA", "ground-truth views")
_SETTINGS = {
    "lens_columns": 24, "lens_rows": 24, "capture_spp": 2, "eia_spp": 2, "view_spp": 2,
    "reconstruction_spp": 2, "score_error": 0,
}  # fmt: skip


def ball(count: int) -> Splats:
    """Bumpy ball of radius 1: `count` splats parallel to its surface, three layers on average."""
    k = np.arange(count) + 0.5
    height, turn = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    out = np.sqrt(1 - height**2)
    normal = np.stack([out * np.cos(turn), out * np.sin(turn), height], -1)
    radius = 1 + 0.05 * np.sin(9 * normal[:, 0]) * np.sin(8 * normal[:, 1])
    sigma = np.sqrt(4 * np.pi / count)
    # Quaternion of the rotation from +z to the normal.
    rotation = np.column_stack([1 + height, -normal[:, 1], normal[:, 0], 0 * height])
    random = np.random.default_rng(1)
    harmonics = random.normal(0, 0.05, (count, 16, 3))
    harmonics[:, 0] += 1.5 * np.sin(7 * normal)
    return Splats(
        (normal * radius[:, None]).astype(np.float32),
        np.log(np.tile([sigma, sigma, sigma / 5], (count, 1))).astype(np.float32),
        (rotation / np.linalg.norm(rotation, axis=1, keepdims=True)).astype(np.float32),
        random.uniform(-2, 3, count).astype(np.float32),
        harmonics.astype(np.float32),
    )


def bench_splats(
    counts: Sequence[int], listener: Any, folder: Path, variables: Mapping[str, str]
) -> list[dict[str, Any]]:
    """Create and validate a relic with each number of splats.

    Returns
    -------
    list of dict
        Under the names of bench.json: `splats`, `file_bytes`; `processor_seconds`, `seconds` and
        `peak_bytes` of both commands; `stages` of the validation, in seconds.
    """
    variables = dict(variables) | {FOLDER_VARIABLE: "off"}
    results = []
    for count in counts:
        listener.stage(f"{count} splats")
        source, scene, out = (folder / name for name in ("relic.ply", "scene.xml", "report"))
        write_splats(source, ball(count))
        inim = [sys.executable, "-m", "inim"]
        new_scene = _run([*inim, "new-scene", str(source), "--up=y", "-o", str(scene)], variables)
        options = [f"-Dinim.{name}={value}" for name, value in _SETTINGS.items()]
        options += ["--algorithms", "template", "--viewpoints", "centre", "--quiet"]
        validation = _run([*inim, "validate", str(scene), *options, "-o", str(out)], variables)
        report = json.loads((out / "report.json").read_text("utf-8"))
        stages = {name: report["timings"][name] for name in _STAGES}
        size = source.stat().st_size
        results.append(
            {"splats": count, "file_bytes": size, "new_scene": new_scene, "validate": validation}
            | {"stages": stages}
        )
        listener.line(
            f"{count:9}  {validation['processor_seconds']:7.1f} processor seconds, "
            f"{validation['peak_bytes'] / 2**30:.2f} GiB"
        )
        for path in (source, scene, scene.with_suffix(".ply")):
            path.unlink()
        shutil.rmtree(out)
    return results


def _run(words: Sequence[str], variables: Mapping[str, str]) -> dict[str, Any]:
    measurement = run_measured(words, variables)
    code, message = measurement.pop("code"), measurement.pop("message")
    if code != EXIT_PASSED:
        raise WorkerError(f"inim {words[3]} ended with exit code {code}: {message}")
    return measurement


def parts_of(data: Mapping[str, Any]) -> list[PagePart]:
    """Part of the page: a table with one row per number of splats."""
    lead = (
        "Whole commands by the number of splats: processor seconds of all processes, wall-clock "
        "seconds of the stages, and the peak memory of the largest process."
    )
    heads = ["splats", "file MiB", "new-scene s", "validate s", "GiB", *(f"{s} s" for s in _STAGES)]
    rows = [
        [
            f"{run['splats']}",
            number(run["file_bytes"] / 2**20, 0),
            number(part(run, "new_scene")["processor_seconds"], 1),
            number(part(run, "validate")["processor_seconds"], 1),
            number(max(run[name]["peak_bytes"] for name in ("new_scene", "validate")) / 2**30, 2),
            *(number(part(run, "stages")[name], 1) for name in _STAGES),
        ]
        for run in items(data, "splats")
    ]
    remark = "Each command ran once in a separate process, without the reference kernel."
    table = Table("By the number of splats", heads, rows)
    return [PagePart("splats", "Splats", lead, [table], remarks=[remark])]


def main() -> int:
    """Run the study and return the exit code."""
    variables = dict(os.environ)  # copied before the backend adds its variables
    parser = new_parser(__doc__, "bench-splats")
    parser.add_argument("counts", type=int, nargs="+", metavar="N", help="numbers of splats")
    args = parser.parse_args()

    def measure(_rounds: Any, listener: Any, folder: Path) -> dict[str, Any]:
        return {"splats": bench_splats(args.counts, listener, folder, variables)}

    return run_study(args, "reports.bench.splats.run", "Bench: splats", measure, parts_of)


if __name__ == "__main__":
    sys.exit(main())
