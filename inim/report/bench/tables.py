"""Time against error as a table, and a bench's words: conditions and Markdown."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from inim.report.bench.part import TIME_HEADS, Part, Table, time_cells
from inim.report.wording import MISSING, items, number, part, per_cent, plain

__all__ = ["remarks", "render_markdown", "scene_table", "score_cells", "thread_words"]


def scene_table(data: Mapping[str, Any]) -> Table:
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
    floor = score_cells(part(data, "noise_floor"), scores)
    rows.append(["noise floor", *[MISSING] * (len(heads) - 2 - len(floor)), *floor, MISSING])
    return Table("Time against error, medians", heads, rows)


def _error_cells(method: Mapping[str, Any], scores: Sequence[Mapping[str, Any]]) -> list[str]:
    return [
        number(method.get("prepare_s"), 3),
        number(method.get("cold_s"), 2),
        per_cent(method.get("wrong_source"), 3),
        per_cent(method.get("hole_fraction"), 2),
        *score_cells(method, scores),
        "yes" if method.get("pareto") else "no",
    ]


def score_cells(found: Mapping[str, Any], scores: Sequence[Mapping[str, Any]]) -> list[str]:
    """One cell for each of bench.json's `scores`; JSON has null for an infinite one."""
    return [
        number(math.inf, 0)
        if score["best"] is None and score["key"] in found and found[score["key"]] is None
        else number(found.get(score["key"]), score["digits"])
        for score in scores
    ]


def thread_words(data: Mapping[str, Any]) -> str:
    """The number of threads with its noun."""
    count = data.get("threads", MISSING)
    return f"{count} thread" if count == 1 else f"{count} threads"


def remarks(data: Mapping[str, Any], parts: Sequence[Part] = ()) -> list[str]:
    """Conditions, in sentences."""
    load, rounds = part(data, "load"), part(data, "rounds")
    slow = [m["name"] for m in items(data, "contenders") if m.get("slow")]
    lines = [
        f"{thread_words(data)}, {part(data, 'backend').get('device', MISSING)}; load average "
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
    blocks = [f"## {_cell(data.get('title', 'Bench'))}"]
    blocks += [f"⚠ {_cell(w)}" for w in items(data, "warnings")]
    blocks.append("\n".join(f"* {_cell(line)}" for line in remarks(data, parts)))
    for table in (table for one in parts for table in one.tables):
        head = [list(table.heads), [":--", *["--:"] * (len(table.heads) - 1)]]
        rows = [f"| {' | '.join(map(_cell, row))} |" for row in [*head, *table.rows]]
        blocks += [f"### {_cell(table.caption)}", "\n".join(rows)]
    for heading, lines in (one.claims for one in parts if one.claims[1]):
        blocks += [f"### {_cell(heading)}", "\n".join(f"* {_cell(line)}" for line in lines)]
    blocks.append(f"`{plain(data.get('command', '')).replace('`', '')}`")
    return "\n\n".join(blocks)


def _cell(value: object) -> str:
    """One line that cannot break a table."""
    line = " ".join(plain(value).split())
    return line.replace("&", "&amp;").replace("<", "&lt;").replace("|", "\\|")
