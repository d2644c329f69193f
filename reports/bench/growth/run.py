"""Growth of a whole validation's time and memory with each of its sizes.

    python -m reports.bench.growth.run scenes/amphora.xml -o reports/bench/growth

Each point is a process of its own with an empty result cache, and changes one size of a small
validation: `template`, 32 x 32 lenses of 17 x 17 pixels, one viewpoint, fixed samples.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from inim.report.labels import number
from inim.report.plots import new_figure, plain_ticks, style
from inim.report.study import PagePart
from inim.system.cache import FOLDER_VARIABLE
from reports.bench.paper.scaling import power_law
from reports.bench.study import doubts, run_validation
from reports.study import Results, Study, table

_ALGORITHMS = ("template", "gu2020", "li2012", "wang2024")
_BASE = {
    "lens_columns": "32", "lens_rows": "32", "capture_spp": "16", "eia_spp": "16",
    "view_spp": "16",
}  # fmt: skip


def _definitions(**changes: object) -> list[str]:
    values = {**_BASE, **{name: str(value) for name, value in changes.items()}}
    return [word for name, value in values.items() for word in ("-D", f"inim.{name}={value}")]


def _points() -> dict[str, dict[int, list[str]]]:
    """Options of a validation by name of a size, and by size."""
    centre = ["--algorithms", "template", "--viewpoints", "centre"]

    def lenses(count: int) -> list[str]:
        return [*_definitions(lens_columns=count, lens_rows=count), *centre]

    def pixels(count: int) -> list[str]:
        return [*_definitions(pixel_pitch_mm=1 / count), *centre]

    eyes = [f"e{n}={12 * (n % 4) - 18} {12 * (n // 4) - 12} 400" for n in range(12)]
    per_pitch = (2, 4, 8, 16)
    samples = (8, 32, 128, 512)
    return {
        "lenses": {n * n: lenses(n) for n in (16, 32, 64, 128)},
        "panel pixels per lens": {n * n: pixels(n) for n in (8, 16, 32, 64)},
        "picture pixels": {
            (32 * n) ** 2: [*_definitions(capture_pixels_per_pitch=n), *centre] for n in per_pitch
        },
        "samples per panel pixel": {n: [*_definitions(eia_spp=n), *centre] for n in samples},
        "viewpoints": {
            n: [*_definitions(), *centre[:2], "--viewpoints", ",".join(eyes[:n])]
            for n in (1, 3, 6, 12)
        },
        "algorithms": {
            n: [*_definitions(), "--algorithms", ",".join(_ALGORITHMS[:n]), *centre[2:]]
            for n in (1, 2, 3, 4)
        },
    }


def _run(scene: Path, words: Sequence[str]) -> dict[str, Any]:
    """Seconds and peak memory of a validation."""
    with tempfile.TemporaryDirectory() as out:
        words = ["inim.validate", str(scene), "--quiet", *words, "-o", out]
        run = run_validation(words, {**os.environ, FOLDER_VARIABLE: "off"}, scene.name)
    return {"seconds": run["seconds"], "peak_bytes": run["peak_bytes"]}


def measure(scene: Path, name: str, runs: int) -> list[dict[str, Any]]:
    """Fastest run of each value of a size; an uncounted run of all algorithms compiles kernels."""
    points = _points()
    _run(scene, points["algorithms"][len(_ALGORITHMS)])
    rows: list[dict[str, Any]] = []
    for size, words in points[name].items():
        measured = [_run(scene, words) for _ in range(runs)]
        rows.append({"size": size, **min(measured, key=lambda run: run["seconds"])})
    return rows


def page(results: Results) -> tuple[list[str], list[PagePart]]:
    """Exponents, times and memory by size, and one plot of all sizes."""
    rows = [_growth(name, points) for name, points in results.items()]
    exponents = {
        "size": lambda r: r["name"],
        "from": lambda r: f"{r['sizes'][0]:,}",
        "to": lambda r: f"{r['sizes'][-1]:,}",
        "seconds": lambda r: f"{number(r['seconds'][0], 1)} to {number(r['seconds'][-1], 1)}",
        "exponent of time": lambda r: number(r["time_exponent"], 2),
        "MiB": lambda r: f"{r['mib'][0]:.0f} to {r['mib'][-1]:.0f}",
        "exponent of memory": lambda r: number(r["memory_exponent"], 2),
    }
    tables = [table("Growth, between the two largest of four sizes", rows, exponents)]
    remark = "Exponents are those of the two largest sizes; the start of a process counts, too."
    return [remark], [PagePart("growth", "Growth", "", tables, "growth", _draw(rows))]


def _growth(name: str, points: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    sizes = [point["size"] for point in points]
    seconds = [point["seconds"] for point in points]
    mib = [point["peak_bytes"] / 2**20 for point in points]
    return {
        "name": name,
        "sizes": sizes,
        "seconds": seconds,
        "mib": mib,
        "time_exponent": power_law(sizes[-2:], seconds[-2:]),
        "memory_exponent": power_law(sizes[-2:], mib[-2:]),
    }


def _draw(rows: Sequence[Mapping[str, Any]]) -> Any:
    """Times over sizes, both relative to the smallest."""
    figure, (left, right) = new_figure(2, 4.0)
    for axis, key, label in ((left, "seconds", "time"), (right, "mib", "peak memory")):
        for row in rows:
            relative = [size / row["sizes"][0] for size in row["sizes"]]
            values = [value / row[key][0] for value in row[key]]
            axis.plot(relative, values, marker="o", markersize=4, label=row["name"])
        axis.set_xscale("log", base=2)
        axis.set_yscale("log", base=2)
        style(axis, label.capitalize(), "size, relative to the smallest", "relative to the first")
        plain_ticks(axis)
    left.legend(fontsize=8, frameon=False)
    return figure


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the scene, the number of runs and the sizes."""
    parser.add_argument("scene", type=Path, metavar="SCENE", help="Mitsuba scene")
    parser.add_argument("--runs", type=int, default=1, help="counted runs of each size (1)")


def cases(args: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """One case for each size."""
    return {name: {"scene": args.scene, "name": name, "runs": args.runs} for name in _points()}


STUDY = Study(
    "reports.bench.growth.run", "Bench: growth with sizes", __doc__, arguments, cases, measure,
    page, stem="bench", doubts=doubts,
)  # fmt: skip

if __name__ == "__main__":
    sys.exit(STUDY.main())
