"""The tables of a stress run, for its page and its Markdown alike."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from inim.report.wording import MISSING, is_number, items, number, part, per_cent, plain

__all__ = [
    "Table",
    "checks_table",
    "count",
    "grouped",
    "jitter_table",
    "relations_table",
    "render_markdown",
    "small",
    "summary_lines",
    "tables_of",
]

Rows = Sequence[Mapping[str, Any]]


@dataclass(frozen=True)
class Table:
    """A table of texts; `part` is the section it belongs to."""

    part: str
    caption: str
    heads: Sequence[str]
    rows: Sequence[Sequence[str]]


def tables_of(data: Mapping[str, Any]) -> list[Table]:
    """All tables, in the order of the page."""
    hits = items(data, "first_hits")
    return [
        checks_table(data),
        _hits(hits),
        _wrong(hits),
        relations_table(items(data, "relations")),
        jitter_table(data),
        _errors(hits),
    ]


def summary_lines(data: Mapping[str, Any]) -> list[str]:
    """What the run says, in sentences."""
    hits, relations = items(data, "first_hits"), items(data, "relations")
    wrong = sum(r["wrong"] for r in hits if r["exact"] and not r["warnings"])
    pixels = sum(r["pixels"] for r in hits if r["exact"] and not r["warnings"])
    broken = sum(not r["passed"] for r in relations)
    return [
        f"{wrong} of {count(pixels)} panel pixels of algorithms that show first hits by definition "
        "differ from rational arithmetic, where a validation would give no warning. Of the other "
        "algorithms the share is stated.",
        f"{broken} of {len(relations)} relations fail. Uncertain are pixels that change, too, when "
        "lengths or depths are moved by a ten-millionth: rounding may decide them.",
        "Depth errors: no arithmetic is at fault there. The figures say how much of a picture "
        "hangs on the last digits of its depth.",
    ]


def count(value: object) -> str:
    """A whole number with its thousands apart."""
    return f"{value:,.0f}" if is_number(value) else MISSING


def small(value: float | None) -> str:
    """A number near zero, to two digits."""
    if value is None:
        return MISSING
    return "0" if value == 0 else f"{value:.1e}".replace("-", "−")


def grouped(rows: Rows, keys: Sequence[str]) -> dict[tuple[str, ...], list[Mapping[str, Any]]]:
    """Rows by what they have under some keys, in order of first appearance."""
    groups: dict[tuple[str, ...], list[Mapping[str, Any]]] = {}
    for row in rows:
        groups.setdefault(tuple(row[key] for key in keys), []).append(row)
    return groups


def checks_table(data: Mapping[str, Any]) -> Table:
    """The verdict, claim by claim."""
    rows = [
        [c["name"], count(c["cases"]), count(c["broken"]), "holds" if c["passed"] else "FAILS"]
        for c in items(data, "checks")
    ]
    return Table("verdict", "What is claimed", ["check", "cases", "broken", "verdict"], rows)


def _hits(rows: Rows) -> Table:
    """Wrong sources of each algorithm, family by family."""
    families = list(dict.fromkeys(r["family"] for r in rows))
    found = []
    for (algorithm,), members in grouped(rows, ["algorithm"]).items():
        cells = [algorithm]
        for family in families:
            ran = [r for r in members if r["family"] == family and r["outcome"] == "ran"]
            pixels = sum(r["pixels"] for r in ran)
            cells.append(per_cent(sum(r["wrong"] for r in ran) / pixels, 2) if pixels else MISSING)
        refused = sum(r["outcome"] == "refused" for r in members)
        found.append([*cells, str(len(members)), str(refused)])
    heads = ["algorithm", *(f"{family}: wrong" for family in families), "cases", "refused"]
    return Table("hits", "Panel pixels that show another source than the first hit", heads, found)


def _wrong(rows: Rows) -> Table:
    """Cases in which an exact algorithm is wrong, with the warning that a validation would give."""
    found = [
        [
            r["algorithm"],
            f"{r['family']}: {r['case']}",
            f"{r['wrong']} of {r['pixels']}",
            r["warnings"][0] if r["warnings"] else "NONE",
        ]
        for r in rows
        if r["exact"] and r["wrong"]
    ]
    heads = ["algorithm", "case", "wrong pixels", "warning that a validation gives"]
    return Table("hits", "First hits by definition that are wrong", heads, found)


def _errors(rows: Rows) -> Table:
    found = [
        [r["algorithm"], f"{r['family']}: {r['case']}", r["outcome"], r["message"]]
        for r in rows
        if r["outcome"] in ("refused", "crashed")
    ]
    heads = ["algorithm", "case", "outcome", "message"]
    return Table("refused", "Refused, or crashed", heads, found)


def relations_table(rows: Rows) -> Table:
    """Relations, algorithms with one verdict in one row."""
    found = []
    for (name, explained, _), members in grouped(
        [{**r, "kept": bool(r["passed"]) and not r["broken"]} for r in rows],
        ["relation", "explained", "kept"],
    ).items():
        compared, broken, uncertain = (
            sum(m[key] for m in members) for key in ("compared", "broken", "uncertain")
        )
        verdict = "holds" if not broken else "holds but for rounding"
        if broken and explained:
            verdict = f"not promised: {explained}"
        if not compared:
            verdict = f"refused: {members[0]['message']}"
        if not all(m["passed"] for m in members):
            verdict = "FAILS"
        who = ", ".join(m["algorithm"] for m in members)
        found.append([name, who, count(compared), str(broken), str(uncertain), verdict])
    heads = ["relation", "of", "pixels or rays", "broken", "of these uncertain", "verdict"]
    return Table("relations", "Relations that need no oracle", heads, found)


def jitter_table(data: Mapping[str, Any]) -> Table:
    """What errors of depth change, algorithm by algorithm."""
    rows = items(data, "jitter")
    names = list(dict.fromkeys(r["algorithm"] for r in rows))
    found = []
    for (kind,), members in grouped(rows, ["jitter"]).items():
        by_name = {m["algorithm"]: m for m in members}
        cells = [kind]
        for name in names:
            cells += [per_cent(by_name[name]["changed"], 3), small(by_name[name]["ssim_loss"])]
        found.append(cells)
    heads = ["depth"] + [h for n in names for h in (f"{n}: changed", "SSIM loss")]
    picture = part(data, "picture")
    caption = (
        f"What small errors of depth cost: {picture.get('name', MISSING)}, "
        f"{picture.get('columns', MISSING)} × {picture.get('rows', MISSING)} pixels"
    )
    return Table("jitter", caption, heads, found)


def render_markdown(data: Mapping[str, Any], tables: Sequence[Table], lines: Sequence[str]) -> str:
    """A run as Markdown: sentences, then tables."""
    blocks = [f"## {_cell(data.get('title', 'Stress'))}"]
    seconds = number(data.get("seconds"), 0)
    blocks.append(f"{data.get('mode', '')} run, {seconds} s, inim {data.get('inim_version', '')}")
    blocks.append("\n".join(f"* {_cell(line)}" for line in lines))
    for table in tables:
        if not table.rows:
            continue
        head = [list(table.heads), [":--", *["--:"] * (len(table.heads) - 1)]]
        rows = [f"| {' | '.join(map(_cell, row))} |" for row in [*head, *table.rows]]
        blocks += [f"### {_cell(table.caption)}", "\n".join(rows)]
    blocks.append(f"`{plain(data.get('command', '')).replace('`', '')}`")
    return "\n\n".join(blocks)


def _cell(value: object) -> str:
    """One line that cannot break a table."""
    line = " ".join(plain(value).split())
    return line.replace("&", "&amp;").replace("<", "&lt;").replace("|", "\\|")
