"""Page of the paper's experiments and of the growth of time, from bench.json."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from inim.apps.bench.page import TIME, milliseconds
from inim.report.labels import number, per_cent
from inim.report.plots import colour_of, marker_of, new_figure, plain_ticks, style
from inim.report.study import PagePart, Table
from reports.bench.paper.plain_python import PLAIN_PYTHON
from reports.bench.study import TIME_COLUMNS, times
from reports.study import Results, entry, table

_GIB = 2**30


def page(results: Results) -> tuple[list[str], list[PagePart]]:
    """Conditions, growth of time, and the paper's experiments with its claims."""
    scaling, paper = results["scaling"], results["paper"]
    memory = scaling["memory"]
    is_within = memory["above_import_bytes"] < memory["limit_bytes"]
    remarks = [
        "Two spheres in closed form, 17 × 17 pixels per lens. Powers of growth are fitted to the "
        "fastest runs, on the left only to the larger half. The number of pixels that a ray "
        "crosses is proportional to the picture's side, which is a power of 0.5.",
        f"Peak memory for {memory['lenses']} × {memory['lenses']} lenses "
        f"{'is below' if is_within else 'EXCEEDS'} {memory['limit_bytes'] / _GIB:g} GiB in "
        "addition to the imports.",
        "Wang et al., Heritage Science 2024, timed plain Python on one thread (dashed). Solid: the "
        "same code compiled, on all threads. The scene is not one of the paper's scenes. Plain "
        "Python: at most 3 runs if a run takes more than 2 s, one above 10 s.",
    ]
    tables = [
        *map(_experiment, paper["experiments"]), _same_input(paper["same_input"]),
        _readings(paper["readings"]), _steps(paper["steps"]),
    ]  # fmt: skip
    claims = "The paper's claims", [*map(_claim_line, paper["claims"])]
    return remarks, [
        PagePart(
            "scaling", "Growth of time", "", _scaling_tables(scaling), "scaling",
            _draw_scaling(scaling),
        ),
        PagePart(
            "paper", "The paper's experiments", "", tables, "paper", _draw_paper(paper),
            claims=claims,
        ),
    ]  # fmt: skip


def _scaling_tables(scaling: Mapping[str, Any]) -> list[Table]:
    columns: dict[str, Callable[[Any], str]] = {
        "lenses": lambda p: f"{p['lenses']} × {p['lenses']}",
        "picture pixels per pitch": lambda p: str(p["pixels_per_pitch"]),
        "display pixels": lambda p: f"{p['display_pixels']:,}",
        "scene pixels": lambda p: f"{p['scene_pixels']:,}",
        **TIME_COLUMNS,
        "kernel ms": lambda p: milliseconds(p["yardstick"]["median_ms"]),
    }
    memory = {
        "lenses": lambda m: f"{m['lenses']} × {m['lenses']}",
        "after imports": lambda m: _gib(m["imported_bytes"]),
        "peak": lambda m: _gib(m["peak_bytes"]),
        "in addition to imports": lambda m: _gib(m["above_import_bytes"]),
        "limit": lambda m: _gib(m["limit_bytes"]),
        "EIA": lambda m: _gib(m["eia_bytes"]),
    }
    return [
        table(f"{scaling['algorithm']} against display pixels", scaling["display"], columns),
        table(f"{scaling['algorithm']} against scene pixels", scaling["scene"], columns),
        table("Peak memory of a new process that generates one EIA", [scaling["memory"]], memory),
    ]


def _gib(count: int) -> str:
    return f"{number(count / _GIB, 3)} GiB"


def _readings(readings: Sequence[Mapping[str, Any]]) -> Table:
    """Table with a row for each scene and matching; the reading as printed is first."""
    rows: dict[str, list[str]] = {}
    heads = ["scene, matching"]
    for reading in readings:
        _, matching, option = (*reading["name"].split(":"), "")[:3]
        row = rows.setdefault(f"{reading['scene']}, {matching.partition('=')[2]}", [])
        cells = {"EIA PSNR dB": number(reading["eia_psnr_db"], 2)}
        if option:
            cells = {"other sources": per_cent(reading["changed"], 3)} | cells
        if len(rows) == 1:
            heads += [f"{option or 'as printed'}, {label}" for label in cells]
        row += cells.values()
    caption = (
        "Other readings of Eq. 5 and 6 on the bundled scenes: panel pixels whose source differs "
        "from the reading as printed, and PSNR of the EIA to the ground truth"
    )
    return Table(caption, heads, [[name, *row] for name, row in rows.items()])


def _steps(steps: Sequence[Mapping[str, Any]]) -> Table:
    lengths = {
        "P_I mm": "scene_pixel_mm",
        "smallest step mm": "least_mm",
        "2 g P_I / P mm": "lower_mm",
        "largest step mm": "most_mm",
        "g P_I in panel pixels, mm": "upper_mm",
        "g P_I in mm": "upper_in_mm",
    }
    counts = {"columns of pixels": "columns", "without a step": "endless", "above g P_I": "beyond"}
    columns = {
        "pixels per lens": lambda s: s["display"].partition(" ")[0],
        **{head: entry(key, text=partial(number, digits=3)) for head, key in lengths.items()},
        **{head: entry(key, text="{:,}".format) for head, key in counts.items()},
    }
    return table("Depth steps of Eq. 5 and the paper's bounds", steps, columns)


def _experiment(experiment: Mapping[str, Any]) -> Table:
    """Table of the milliseconds at each size, with the ratios of the paper's claims."""
    points = experiment["points"]
    names = [c["name"] for c in points[0]["algorithms"]]
    heads = [
        experiment["name"],
        *(name.replace(PLAIN_PYTHON, ", Python") for name in names),
        "gu2020 / wang2024, Python", "gu2020 / wang2024", "wang2024, Python / template",
    ]  # fmt: skip
    rows = []
    for point in points:
        ms = {c["name"]: c["median_ms"] for c in point["algorithms"]}
        ratios = [
            ms[f"gu2020{PLAIN_PYTHON}"] / ms[f"wang2024{PLAIN_PYTHON}"],
            ms["gu2020"] / ms["wang2024"],
            ms[f"wang2024{PLAIN_PYTHON}"] / ms["template"],
        ]
        cells = [milliseconds(ms[name]) for name in names]
        rows.append([f"{point[experiment['size']]:,}", *cells, *map(times, ratios)])
    caption = (
        f"As the paper's {experiment['figure']}: ms per EIA against {experiment['name']}; "
        f"{experiment['kept']}"
    )
    return Table(caption, heads, rows)


def _same_input(same: Mapping[str, Any]) -> Table:
    (template,) = (c["median_ms"] for c in same["algorithms"] if c["name"] == "template")
    columns = {
        "algorithm": lambda c: c["name"].replace(PLAIN_PYTHON, ", Python"),
        "ms per EIA": entry("median_ms", text=milliseconds),
        "runs": entry("runs"),
        "× template": lambda c: times(c["median_ms"] / template),
        "wrong source": lambda c: per_cent(c["wrong_source"], 2),
        "EIA PSNR dB": lambda c: number(math.inf if (p := c["eia_psnr_db"]) is None else p, 2),
        "view SSIM to reference": entry("view_ssim_to_reference", text=partial(number, digits=4)),
        "middle view SSIM": entry("middle_view_ssim", text=partial(number, digits=3)),
        "paper's SSIM, other scenes": entry("published_ssim", text=partial(number, digits=2)),
    }
    caption = (
        f"Common input: {same['lenses']:,} lenses, {same['display_pixels']:,} display pixels, "
        f"{same['scene_pixels']:,} scene pixels; the middle view of the reference has SSIM "
        f"{number(same['reference_ssim'], 3)}"
    )
    return table(caption, same["algorithms"], columns)


def _claim_line(claim: Mapping[str, Any]) -> str:
    """A claim with its measurement and the reason if it is not reproduced."""
    verdict = "Reproduced" if claim["holds"] else "Not reproduced"
    text = f"{verdict}: {claim['claim']} ({claim['source']}). Measured: {claim['found']}. "
    return f"{text}{claim['why']}".rstrip()


# -- plots --------------------------------------------------------------------------------------


def _draw_scaling(scaling: Mapping[str, Any]) -> Any:
    """Plot the times of the algorithm and the reference kernel over both sizes."""
    figure, axes = new_figure(2, 4.2, sharey=True)
    panels = [("display", "display_pixels"), ("scene", "scene_pixels")]
    for axis, (key, size) in zip(axes, panels, strict=True):
        points = scaling[key]
        sizes = [p[size] for p in points]
        _line(axis, sizes, points, scaling["algorithm"])
        _line(axis, sizes, [p["yardstick"] for p in points], "reference kernel")
        label = size.replace("_", " ")
        title = f"{label.capitalize()}: power {scaling['growth'][size]:.2f}"
        _finish_sizes(axis, title, label)
    axes[0].set_ylabel(TIME)
    axes[0].legend(fontsize=8, frameon=False, loc="upper left")
    return figure


def _draw_paper(paper: Mapping[str, Any]) -> Any:
    """Plot the three experiments side by side, with a common time axis."""
    experiments = paper["experiments"]
    figure, axes = new_figure(len(experiments), 4.6, sharey=True)
    for axis, experiment in zip(axes, experiments, strict=True):
        points = experiment["points"]
        sizes = [p[experiment["size"]] for p in points]
        for index, method in enumerate(points[0]["algorithms"]):
            _line(axis, sizes, [p["algorithms"][index] for p in points], method["name"])
        _line(axis, sizes, [p["yardstick"] for p in points], "reference kernel")
        _finish_sizes(axis, f"As {experiment['figure']}", experiment["name"])
    axes[0].set_ylabel(TIME)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    return figure


def _finish_sizes(axis: Any, title: str, label: str) -> None:
    style(axis, title, label, "")
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.margins(0.08, 0.08)
    plain_ticks(axis)


def _line(axis: Any, sizes: Sequence[float], points: Sequence[Any], name: str) -> None:
    """Draw a series of medians with whiskers to the fastest runs; dashed for plain Python."""
    is_plain = PLAIN_PYTHON in name
    algorithm = name.removesuffix(PLAIN_PYTHON).partition(":")[0]
    colour = colour_of(algorithm)
    medians, fastest = ([p[key] for p in points] for key in ("median_ms", "min_ms"))
    axis.vlines(sizes, fastest, medians, color=colour, linewidth=1, alpha=0.5)
    axis.plot(
        sizes,
        medians,
        marker_of(algorithm),
        color=colour,
        label=name.replace(PLAIN_PYTHON, ", plain Python"),
        markersize=4.5,
        markerfacecolor="white" if is_plain else colour,
        linestyle="--" if is_plain else ":" if name == "reference kernel" else "-",
        alpha=0.35 if "matching=ray" in name else 0.6 if "step_pixel" in name else 1,
        linewidth=1.4,
    )
