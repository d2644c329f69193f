"""Page of the paper's experiments and of the growth of time, from bench.json."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import product
from statistics import fmean, median
from typing import Any

from inim.apps.bench.page import TIME, milliseconds
from inim.generators.registry import DEFAULT
from inim.report.labels import MISSING, number, per_cent
from inim.report.plots import colour_of, marker_of, new_figure, plain_ticks, style
from inim.report.study import PagePart, Table
from reports.bench.paper.claims import FORMS, LEVEL, RIVALS, claims, ratio_interval
from reports.bench.paper.experiments import (
    COMPILED,
    FIGURES,
    GU,
    LI,
    LOOPS,
    NUMPY,
    TEMPLATE,
)
from reports.bench.paper.inputs import COVERED, EMPTY, WAVES
from reports.bench.paper.readings import READINGS, RECOMMENDED, STRICT
from reports.bench.study import TIME_COLUMNS
from reports.study import Results, table

_WITH_SOURCES = (*READINGS, GU, LI, TEMPLATE)
_METHODS = (*_WITH_SOURCES, DEFAULT)


def page(results: Results) -> tuple[list[str], list[PagePart]]:
    """Conditions, readings, quality, times and verdicts; growth of `template`'s time."""
    scaling, paper = results["scaling"], results["figures"]
    inputs = {name: results[name] for name in (*COVERED, EMPTY) if name in results}
    left_out = ", ".join(name for name in (*COVERED, EMPTY) if name not in inputs) or "nothing"
    remarks = [
        f"{paper['runs']} rounds on {paper['processor']}. Every round runs every method once. "
        f"Times are compared within a round. Intervals are of the median, at {1 - LEVEL:.0%}.",
        f"Left out for want of files: {left_out}.",
        "A covered picture has 200 x 200 pixels, each with a surface. The ground truth of the "
        "photograph and of the waves is the picture itself, shown by template as it comes.",
        "Loops and NumPy run on one thread and find sources only; loops read lists. Compiled "
        "methods also copy colours, for all lenses and on all threads.",
    ]
    rows = [([name], result["times"]) for name, result in inputs.items()]
    tables = [
        *_verdicts(claims(inputs, paper["figures"])), _deviations(inputs), *_quality(inputs),
        *_ratios(inputs), _default_ratios(inputs),
        *_times("Pictures of 200 x 200 pixels", ["picture"], rows),
    ]  # fmt: skip
    for figure, pictures in paper["figures"].items():
        heads = ["picture", FIGURES[figure], "covered"]
        rows = [
            ([name, f"{p['size']:,}", per_cent(p["covered"], 1)], p["times"])
            for name, points in pictures.items()
            for p in points
        ]
        tables += _times(f"As the paper's {figure}", heads, rows)
    drawing = _draw_paper(paper["figures"])
    return remarks, [
        PagePart("paper", "The paper's experiments", "", tables, "paper", drawing),
        PagePart("scaling", "Growth of template's time", "", _scaling_tables(scaling)),
    ]


def _range(low: float, high: float, digits: int = 2) -> str:
    return f"{number(low, digits)} to {number(high, digits)}"


def _interval(ends: Sequence[float], digits: int = 2) -> str:
    return f"[{', '.join(number(end, digits) for end in ends)}]"


def _estimate(value: float, *ends: float) -> str:
    return f"{number(value, 3)} {_interval(ends, 3)}"


def _verdicts(checked: Sequence[Mapping[str, Any]]) -> Iterator[Table]:
    """Verdicts by claim and reading, with a column for each form; conditions; other claims."""
    rows: dict[tuple[str, str], list[str]] = {}
    others = []
    for claim in checked:
        text = f"{claim['verdict']}: {_range(claim['low'], claim['high'])}"
        if claim["form"] in FORMS:
            head = f"{claim['claim']} ({claim['source']})", claim["reading"]
            rows.setdefault(head, ["–"] * len(FORMS))[[*FORMS].index(claim["form"])] = text
        else:
            others.append([claim["claim"], claim["source"], claim["reading"], claim["form"], text])
    caption = (
        "Verdicts on time, with the lowest and highest end of all intervals: rival's time divided "
        "by that of the reading, or rival's exponent minus that of the reading; figures: waves"
    )
    by_claim = sorted(rows.items(), key=lambda row: row[0][0])
    heads = ["claim", "reading"]
    yield Table(caption, [*heads, *FORMS], [[*head, *texts] for head, texts in by_claim])
    yield Table("Other verdicts", ["claim", "source", "reading", "form", "verdict"], others)
    conditions = [[c[key] for key in (*heads, "form", "condition")] for c in checked]
    heads += ["form", "conditions (open: the interval contains the limit)"]
    yield Table("Conditions of verdicts", heads, [row for row in conditions if row[-1]])


def _deviations(inputs: Mapping[str, Any]) -> Table:
    rows = []
    for name in inputs[EMPTY]["quality"]["deviations"]:
        cells = {key: result["quality"]["deviations"][name] for key, result in inputs.items()}
        of_covered = [cell for key, cell in cells.items() if key != EMPTY]
        mean = {key: fmean(cell[key] for cell in of_covered) for key in ("changed", "db")}
        texts = (
            f"{per_cent(c['changed'], 1)}, {number(c['db'], 2)}" for c in (mean, *cells.values())
        )
        rows.append([name, *texts])
    caption = (
        "Deviations from the recommended reading, one at a time: share of panel pixels with "
        "another source, and change of the EIA's PSNR in dB"
    )
    return Table(caption, ["deviation", "mean of covered", *inputs], rows)


def _quality(inputs: Mapping[str, Any]) -> Iterator[Table]:
    """PSNR, other sources than those of `template`, holes, SSIM and its differences."""
    texts: dict[str, tuple[str, Callable[[Any], str]]] = {
        "PSNR of the EIA, dB": ("psnr", lambda db: MISSING if db is None else number(db, 2)),
        "Panel pixels with another source than template": ("wrong", lambda v: per_cent(v, 1)),
        "SSIM of the middle view": ("ssim", lambda v: _estimate(*v)),
    }
    for caption, (key, text) in texts.items():
        methods = _WITH_SOURCES if key == "wrong" else _METHODS
        rows = [
            [name, per_cent(q["covered"], 1), *(text(q[key][method]) for method in methods)]
            for name, q in ((name, result["quality"]) for name, result in inputs.items())
        ]
        yield Table(caption, ["picture", "covered", *methods], rows)
    pairs = [(GU, LI), *product(READINGS, RIVALS)]
    rows = [
        [f"{first} minus {second}"]
        + [_estimate(*r["quality"]["differences"][first][second]) for r in inputs.values()]
        for first, second in pairs
    ]
    yield Table("Differences of the middle view's SSIM", ["difference", *inputs], rows)


def _times(
    caption: str, heads: Sequence[str], rows: Sequence[tuple[Sequence[str], Mapping[str, Any]]]
) -> Iterator[Table]:
    """A table for each form; `rows` are first cells and times."""
    for form in (LOOPS, NUMPY, COMPILED):
        cells = [
            [*first, *(number(median(v), 3) if (v := times[name].get(form)) else "–"
                       for name in _METHODS)]
            for first, times in rows
        ]  # fmt: skip
        yield Table(f"{caption}: microseconds per panel pixel, {form}", [*heads, *_METHODS], cells)


def _ratios(inputs: Mapping[str, Any]) -> Iterator[Table]:
    """Times of each rival divided by those of the readings."""
    for rival in RIVALS:
        rows = []
        for reading, (form, (own, other)) in product(READINGS, FORMS.items()):
            times = [result["times"] for result in inputs.values()]
            if other in times[0][rival]:
                ends = (ratio_interval(t[rival][other], t[reading][own]) for t in times)
                rows.append([reading, form, *map(_interval, ends)])
        yield Table(f"{rival}'s time / reading's time", ["reading", "form", *inputs], rows)


def _default_ratios(inputs: Mapping[str, Any]) -> Table:
    """Time of the default algorithm, divided by the times of three others."""
    rows = []
    for name, result in inputs.items():
        own = result["times"][DEFAULT][COMPILED]
        others = (result["times"][other][COMPILED] for other in (TEMPLATE, GU, RECOMMENDED))
        rows.append([name, *(_interval(ratio_interval(own, other)) for other in others)])
    caption = "Time of template as it comes, four rays and colours between pixels, divided by"
    return Table(caption, ["picture", TEMPLATE, GU, RECOMMENDED], rows)


def _scaling_tables(scaling: Mapping[str, Any]) -> list[Table]:
    columns: dict[str, Callable[[Any], str]] = {
        "lenses": lambda p: f"{p['lenses']} × {p['lenses']}",
        "picture pixels per pitch": lambda p: str(p["pixels_per_pitch"]),
        "display pixels": lambda p: f"{p['display_pixels']:,}",
        "scene pixels": lambda p: f"{p['scene_pixels']:,}",
        **TIME_COLUMNS,
        "kernel ms": lambda p: milliseconds(p["yardstick"]["median_ms"]),
    }
    return [
        table(f"{scaling['algorithm']} against display pixels", scaling["display"], columns),
        table(f"{scaling['algorithm']} against scene pixels", scaling["scene"], columns),
    ]


def _draw_paper(figures: Mapping[str, Any]) -> Any:
    """Plot the loops' times on the covered picture, medians over the sizes of each figure."""
    figure, axes = new_figure(len(figures), 4.6, sharey=True)
    for axis, (name, pictures) in zip(axes, figures.items(), strict=True):
        points = pictures[WAVES]
        for method, line in zip((*READINGS, *RIVALS), ("-", "-", "--", ":", "-", "-"), strict=True):
            algorithm = "wang2024" if method in READINGS else method
            ms = [median(p["times"][method][LOOPS]) * p["pixels"] / 1e3 for p in points]
            axis.loglog(
                [p["size"] for p in points], ms, line, marker=marker_of(algorithm), label=method,
                color="black" if method == STRICT else colour_of(algorithm), markersize=4.5,
            )  # fmt: skip
        style(axis, f"As {name}, loops, {WAVES}", FIGURES[name], "")
        plain_ticks(axis)
    axes[0].set_ylabel(TIME)
    axes[0].legend(fontsize=7, frameon=False)
    return figure
