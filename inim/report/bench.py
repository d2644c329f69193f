"""The report of a bench: `bench.json`, `bench.md`, `bench.html` and the plots."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from inim.report.files import from_strict, list_files, to_strict, write_forms
from inim.report.markup import bullets, element, saved_plot, text, text_table
from inim.report.page import Section, data_note, how_to_reproduce, render_page, timestamp
from inim.report.plots import (
    LINES,
    Name,
    across,
    draw_front,
    draw_point,
    new_figure,
    plain_ticks,
    point_name,
    save,
    set_apart,
    style,
)
from inim.report.summary import markdown_command, markdown_line, markdown_section
from inim.report.wording import MISSING, is_number, items, number, part, per_cent, plain

SCHEMA = "inim.bench/1"
#: The label of a time axis.
TIME = "milliseconds per EIA"
#: The heads of `time_cells`.
TIME_HEADS = ("ms per EIA", "fastest", "spread", "runs", "Mpx/s", "yardsticks", "by fastest")
# Below this share of wrong pixels the axis is linear, so that zero has a place on it.
_LINEAR_SHARE = 1e-3
_STYLE = """
.plot img { max-width: 1160px; }
.bench th, .bench td { white-space: nowrap; }
.bench th:not(:first-child), .bench td { text-align: right; }
.bench thead th { white-space: normal; vertical-align: bottom; overflow-wrap: normal; }
.bench table { font-size: 13px; width: auto; min-width: min(100%, 700px); }
.bench th, .bench td { padding-left: 5px; padding-right: 5px; }
.bench { margin-bottom: 24px; }
.claims { padding-left: 1.2em; max-width: 90ch; }
.claims li { margin-bottom: 8px; }
.remarks { max-width: 90ch; padding-left: 1.2em; }
"""


@dataclass(frozen=True)
class Table:
    """Text cells under heads; the first cell of a row names it.

    Attributes
    ----------
    caption : str
    heads : sequence of str
    rows : sequence of sequence of str
    """

    caption: str
    heads: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class Part:
    """A part of a bench, or of a study that times something else.

    Attributes
    ----------
    name, title, lead : str
        Its anchor, its heading and the words below that.
    tables : sequence of Table
    plot : str
        The plot's files are ``PLOT.svg`` and ``PLOT.png``.
    figure : matplotlib Figure, optional
    remarks : sequence of str
        How it was measured; shown among the page's conditions.
    claims : (str, sequence of str)
        A heading and sentences below it; none if empty.
    """

    name: str
    title: str
    lead: str
    tables: Sequence[Table]
    plot: str = ""
    figure: Any = None
    remarks: Sequence[str] = ()
    claims: tuple[str, Sequence[str]] = ("", ())


#: What a bench shows, from the contents of bench.json.
PartsOf = Callable[[Mapping[str, Any]], Sequence[Part]]


def scene_parts(data: Mapping[str, Any]) -> list[Part]:
    """Time against error, where methods were timed on a scene."""
    if not data.get("contenders"):
        return []
    lead = (
        "Down and left is better. Coloured: no other is as fast and as good. Grey: another is "
        "both. The picture scored is the very one that was timed, display-ready 8-bit sRGB. "
        "A point's whisker ends at its fastest run."
    )
    tables = [_scene_table(data)]
    return [Part("scene", "Time against error", lead, tables, "pareto", _draw_scene(data))]


def write_bench(data: Mapping[str, Any], folder: Path, parts_of: PartsOf = scene_parts) -> None:
    """Write all forms of a bench into a folder, `bench.json` last: it marks a whole one.

    Parameters
    ----------
    data : mapping
        Schema `inim.bench/1`; `files` is added here.
    folder : Path
        Empty; the plots are written first, for the page shows them.
    parts_of : callable
        What is shown of the data, which are as they are read from `bench.json`.
    """
    parts = parts_of(from_strict(to_strict(data)))
    for one in parts:
        if one.figure is not None:
            save(one.figure, folder, one.plot)
    forms = {
        "bench.md": lambda data: render_markdown(data, parts),
        "bench.html": lambda data: _page(data, parts, folder),
    }
    write_forms(list_files(data, folder, "bench.json", *forms), folder, "bench.json", forms)


def milliseconds(value: object) -> str:
    """A time with three significant digits or so: no run repeats itself to more."""
    if not is_number(value):
        return MISSING
    return number(value, 3 if value < 1 else 2 if value < 100 else 0 if value >= 1000 else 1)


def times(value: object) -> str:
    """A ratio."""
    if not is_number(value):
        return MISSING
    return f"{number(value, 2 if value < 100 else 0)} ×"


def time_cells(method: Mapping[str, Any]) -> list[str]:
    """A method's times, from its entry in bench.json."""
    return [
        milliseconds(method.get("median_ms")),
        milliseconds(method.get("min_ms")),
        f"± {per_cent(method.get('spread'), 1)}",
        plain(method.get("runs", MISSING)),
        number(method.get("mpx_per_s"), 1 if method.get("mpx_per_s", 0) < 100 else 0),
        times(method.get("ratio")),
        times(method.get("ratio_min")),
    ]


def _scene_table(data: Mapping[str, Any]) -> Table:
    """Times and errors of all methods, of the reference kernel and of the noise floor."""
    scores = items(data, "scores")
    heads = [
        "algorithm", *TIME_HEADS, "prepare s", "cold s", "wrong source", "holes",
        *(score["label"] for score in scores), "front",
    ]  # fmt: skip
    rows = [
        [m["name"], *time_cells(m), *_error_cells(m, scores)] for m in items(data, "contenders")
    ]
    yardstick = time_cells({**part(data, "yardstick"), "ratio": 1.0, "ratio_min": 1.0})
    yardstick[TIME_HEADS.index("Mpx/s")] = MISSING
    rows.append(["yardstick", *yardstick, *[MISSING] * (len(heads) - 1 - len(yardstick))])
    floor = _score_cells(part(data, "noise_floor"), scores)
    rows.append(["noise floor", *[MISSING] * (len(heads) - 2 - len(floor)), *floor, MISSING])
    return Table("Time against error, medians", heads, rows)


def _error_cells(method: Mapping[str, Any], scores: Sequence[Mapping[str, Any]]) -> list[str]:
    return [
        number(method.get("prepare_s"), 3),
        number(method.get("cold_s"), 2),
        per_cent(method.get("wrong_source"), 3),
        per_cent(method.get("hole_fraction"), 2),
        *_score_cells(method, scores),
        "yes" if method.get("pareto") else "no",
    ]


def _score_cells(found: Mapping[str, Any], scores: Sequence[Mapping[str, Any]]) -> list[str]:
    """One cell for each of bench.json's `scores`; JSON has null for an infinite one."""
    return [
        number(math.inf, 0)
        if score["best"] is None and score["key"] in found and found[score["key"]] is None
        else number(found.get(score["key"]), score["digits"])
        for score in scores
    ]


def _thread_words(data: Mapping[str, Any]) -> str:
    """The number of threads with its noun."""
    count = data.get("threads", MISSING)
    return f"{count} thread" if count == 1 else f"{count} threads"


def _remarks(data: Mapping[str, Any], parts: Sequence[Part]) -> list[str]:
    """Conditions, in sentences."""
    load, rounds = part(data, "load"), part(data, "rounds")
    slow = [m["name"] for m in items(data, "contenders") if m.get("slow")]
    lines = [
        f"{_thread_words(data)}, {part(data, 'backend').get('device', MISSING)}; load average "
        f"{number(load.get('start'), 2)} at the start, {number(load.get('end'), 2)} at the end, on "
        f"{load.get('cores', MISSING)} cores.",
        f"Medians of {rounds.get('runs')} runs after {rounds.get('warmups')} warm-ups, all in turn "
        "with the reference kernel: one 4-byte gather per display pixel where its ray meets the "
        "central depth plane. A yardstick is the time of that kernel. Spread: half the distance "
        "between the quartiles.",
    ]
    if slow:
        lines.append(f"Fewer runs, being slow: {', '.join(slow)}.")
    lines += [line for one in parts for line in one.remarks]
    return [*lines, *map(str, items(data, "notes"))]


def render_markdown(data: Mapping[str, Any], parts: Sequence[Part]) -> str:
    """The bench as Markdown: conditions, tables, claims."""
    blocks = [f"## {markdown_line(data.get('title', 'Bench'))}"]
    blocks += [f"⚠ {markdown_line(w)}" for w in items(data, "warnings")]
    blocks.append(_listed(_remarks(data, parts)))
    for table in (table for one in parts for table in one.tables):
        blocks.append(markdown_section(table.caption, table.heads, table.rows))
    for heading, lines in (one.claims for one in parts if one.claims[1]):
        blocks += [f"### {markdown_line(heading)}", _listed(lines)]
    return "\n\n".join([*blocks, markdown_command(data["command"])])


def _listed(lines: Sequence[str]) -> str:
    return "\n".join(f"* {markdown_line(line)}" for line in lines)


def _page(data: Mapping[str, Any], parts: Sequence[Part], folder: Path) -> str:
    """The whole bench as one HTML page, the plots that lie in `folder` embedded."""
    conditions = bullets(items(data, "warnings"), "cautions")
    conditions += bullets(_remarks(data, parts), "remarks")
    sections = [Section("conditions", "Conditions", conditions)]
    for one in parts:
        body = element("p", text(one.lead), class_="lead")
        body += saved_plot(folder / f"{one.plot}.svg", one.title)
        body += _claims(*one.claims)
        body += "".join(text_table(t.caption, t.heads, t.rows, "bench") for t in one.tables)
        sections.append(Section(one.name, one.title, body))
    title = data.get("title", "Bench")
    return render_page(
        title,
        _facts(data),
        [*sections, how_to_reproduce(data)],
        window_title=f"{title} – inim",
        footer=data_note(data, "bench.json"),
        style=_STYLE,
    )


def _facts(data: Mapping[str, Any]) -> list[str]:
    display = part(data, "display", "given").get("name")
    return [
        *([f"Display {text(display)}"] if display else []),
        text(_thread_words(data)),
        text(part(data, "backend").get("device", MISSING)),
        f"inim {text(data.get('inim_version', MISSING))}",
        timestamp(data),
    ]


def _claims(heading: str, lines: Sequence[str]) -> str:
    return element("h3", text(heading)) + bullets(lines, "claims") if lines else ""


def _draw_scene(data: Mapping[str, Any]) -> Any:
    """Small multiples over one time axis: wrong sources, then the scores that are plotted."""
    plotted = [score for score in items(data, "scores") if score["plotted"]]
    figure, axes = new_figure(1 + len(plotted), 4.6, sharex=True)
    axes[0].set_xscale("log")  # of all of them
    title, label = "Wrong source", "panel pixels of a wrong source, %"
    names = [_panel(axes[0], data, "wrong_source", lambda share: 100 * share)]
    style(axes[0], title, f"{TIME} (↙ better)", label)
    for axis, score in zip(axes[1:], plotted, strict=True):
        names.append(_score_panel(axis, data, score))
    _share_scale(axes[0])
    for axis in axes:
        plain_ticks(axis)
    figure.canvas.draw()  # now all has its place, and names can be set apart in it
    for axis, texts in zip(axes, names, strict=True):
        set_apart(axis, texts)
    return figure


def _score_panel(axis: Any, data: Mapping[str, Any], score: Mapping[str, Any]) -> list[Name]:
    """A panel whose better end is below, whatever a score's better end is; the names for it."""
    key, label, best = score["key"], score["label"], score["best"]
    is_distance = score["better"] == "higher" and best is not None
    if is_distance:
        names = _panel(axis, data, key, lambda value: best - value)
        label = f"{best:g} − {label}"
    else:
        names = _panel(axis, data, key, lambda value: value)
    style(axis, score["title"], f"{TIME} (↙ better)", label)
    values = [m[key] for m in data["contenders"] if is_number(m.get(key))]
    if is_distance and all(value < best for value in values):
        axis.set_yscale("log")
    if score["better"] == "higher" and not is_distance:
        axis.invert_yaxis()
    return names


def _share_scale(axis: Any) -> None:
    """Logarithmic with a place for zero."""
    linear = 100 * _LINEAR_SHARE
    axis.set_yscale("symlog", linthresh=linear, linscale=0.5)
    axis.set_ylim(-0.3 * linear, max(10 * linear, 2.5 * axis.get_ylim()[1]))


def _panel(
    axis: Any, data: Mapping[str, Any], key: str, shown: Callable[[float], float]
) -> list[Name]:
    """Draw one panel; the names that go into it."""
    known = [
        (m["name"], m["median_ms"], shown(m[key]), key in m["fronts"], m["min_ms"])
        for m in data["contenders"]
        if is_number(m.get(key))
    ]
    for name, time, value, on_front, fastest in sorted(known, key=lambda m: m[3]):
        draw_point(axis, name, time, value, on_front, fastest)
    draw_front(axis, [(time, value) for _, time, value, on_front, _ in known if on_front])
    yardstick = part(data, "yardstick").get("median_ms")
    if is_number(yardstick):
        axis.axvline(yardstick, **LINES["yardstick"])
        across(axis, "yardstick", x=yardstick)
    floor = part(data, "noise_floor").get(key)
    if is_number(floor):
        axis.axhline(shown(floor), **LINES["floor"])
        across(axis, "noise floor", y=shown(floor))
    axis.margins(0.12, 0.12)
    return [point_name(*method[:4]) for method in known]
