"""Page of the paper's experiments and of the growth of time, from bench.json."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from inim.apps.bench.page import TIME, TIME_HEADS, milliseconds, time_cells, times
from inim.report.labels import MISSING, is_number, number, per_cent
from inim.report.plots import colour_of, marker_of, new_figure, plain_ticks, style
from inim.report.study import PagePart, Table
from reports.bench.paper.plain_python import PLAIN_PYTHON
from reports.study import Results, table

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
    claims = "The paper's claims", _claim_lines(paper)
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
        **{head: partial(_time_cell, i) for i, head in enumerate(TIME_HEADS)},
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


def _time_cell(index: int, point: Mapping[str, Any]) -> str:
    return time_cells(point)[index]


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
    heads = [
        "pixels per lens", "P_I mm", "smallest step mm", "2 g P_I / P mm", "largest step mm",
        "g P_I in panel pixels, mm", "g P_I in mm", "columns of pixels", "without a step",
        "above g P_I",
    ]  # fmt: skip
    lengths = ("scene_pixel", "least", "lower", "most", "upper")
    rows = [
        [
            s["display"].partition(" ")[0],
            *(number(s[f"{key}_mm"], 3) for key in lengths),
            number(s["upper_in_mm"], 3),
            *(f"{s[key]:,}" for key in ("columns", "endless", "beyond")),
        ]
        for s in steps
    ]
    return Table("Depth steps of Eq. 5 and the paper's bounds", heads, rows)


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
            _ratio(ms, f"gu2020{PLAIN_PYTHON}", f"wang2024{PLAIN_PYTHON}"),
            _ratio(ms, "gu2020", "wang2024"),
            _ratio(ms, f"wang2024{PLAIN_PYTHON}", "template"),
        ]
        cells = [milliseconds(ms[name]) for name in names]
        rows.append([f"{point[experiment['size']]:,}", *cells, *map(times, ratios)])
    caption = (
        f"As the paper's {experiment['figure']}: ms per EIA against {experiment['name']}; "
        f"{experiment['kept']}"
    )
    return Table(caption, heads, rows)


def _ratio(ms: Mapping[str, float], above: str, below: str) -> float | None:
    """Ratio of two medians; None if one is missing."""
    return ms[above] / ms[below] if above in ms and below in ms else None


def _same_input(same: Mapping[str, Any]) -> Table:
    heads = [
        "algorithm", "ms per EIA", "runs", "× template", "wrong source", "EIA PSNR dB",
        "view SSIM to reference", "middle view SSIM", "paper's SSIM, other scenes",
    ]  # fmt: skip
    methods = same["algorithms"]
    ms = {c["name"]: c["median_ms"] for c in methods}
    rows = [
        [
            c["name"].replace(PLAIN_PYTHON, ", Python"),
            milliseconds(c["median_ms"]),
            str(c["runs"]),
            times(_ratio(ms, c["name"], "template")),
            per_cent(c["wrong_source"], 2),
            number(math.inf if c["eia_psnr_db"] is None else c["eia_psnr_db"], 2),
            number(c["view_ssim_to_reference"], 4),
            number(c["middle_view_ssim"], 3),
            number(c["published_ssim"], 2),
        ]
        for c in methods
    ]
    rows.append(["reference", *[MISSING] * 6, number(same.get("reference_ssim"), 3), MISSING])
    caption = (
        f"Common input: {same['lenses']:,} lenses, {same['display_pixels']:,} display pixels, "
        f"{same['scene_pixels']:,} scene pixels"
    )
    return Table(caption, heads, rows)


def _claim_lines(paper: Mapping[str, Any]) -> list[str]:
    """Each claim with its measurement and the reason if it is not reproduced."""
    lines = []
    for claim in paper["claims"]:
        verdict = "Reproduced" if claim["holds"] else "Not reproduced"
        lines.append(
            f"{verdict}: {claim['claim']} ({claim['source']}). Measured: {claim['found']}. "
            f"{claim['why']}".rstrip()
        )
    return lines


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
        power = scaling["growth"][size]
        growth = f": power {power:.2f}" if is_number(power) else ""
        _finish_sizes(axis, f"{label.capitalize()}{growth}", label)
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
