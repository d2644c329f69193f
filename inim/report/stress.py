"""The report of a stress run: `stress.json`, `stress.md` and `stress.html`."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from inim.report.files import list_files, write_forms
from inim.report.markup import bullets, saved_plot, text, text_table
from inim.report.page import Section, data_note, how_to_reproduce, render_page, timestamp
from inim.report.summary import markdown_command, markdown_line, markdown_section
from inim.report.wording import MISSING, is_number, items, number, part, per_cent

SCHEMA = "inim.stress/2"
# Digits of figures in the file: enough for any table, and a third of its size.
_DIGITS = 6
_STYLE = """
.plot img { max-width: 1240px; }
.stress table { font-size: 13px; width: auto; min-width: min(100%, 700px); }
.stress th, .stress td { text-align: left; vertical-align: top; padding: 3px 8px; }
.stress thead th { vertical-align: bottom; }
.stress { margin-bottom: 24px; }
.remarks { max-width: 95ch; padding-left: 1.2em; }
"""
_PARTS = {
    "verdict": "Verdict",
    "hits": "First hits",
    "limits": "Accuracy limits",
    "generators": "Generators",
    "lenses": "Lens models",
    "relations": "Relations",
    "jitter": "Jitter",
    "guarded": "Violations and their warnings",
    "refused": "Refused",
}

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


def write_stress(
    data: Mapping[str, Any],
    folder: Path,
    *,
    tables: Callable[[Mapping[str, Any]], Sequence[Table]] = tables_of,
    lines: Callable[[Mapping[str, Any]], Sequence[str]] = summary_lines,
) -> None:
    """Write all forms of a stress run into a folder, `stress.json` last: it marks a whole one.

    Parameters
    ----------
    data : mapping
        Schema `inim.stress/2`, or another that `tables` and `lines` know; `files` is added here.
    folder : Path
        Empty but for figures; the page shows `stress.svg`.
    tables, lines : callable
        Tables and sentences of the page and of the Markdown, made from what was written.
    """
    forms = {
        "stress.md": lambda data: _markdown(data, tables(data), lines(data)),
        "stress.html": lambda data: _page(data, folder, tables(data), lines(data)),
    }
    listed = _short(list_files(data, folder, "stress.json", *forms))
    write_forms(listed, folder, "stress.json", forms, encode=_as_text)


def _short(value: Any) -> Any:
    """Floats to so many significant digits."""
    if isinstance(value, Mapping):
        return {key: _short(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [_short(one) for one in value]
    return float(f"{value:.{_DIGITS}g}") if isinstance(value, float) else value


def _as_text(strict: Mapping[str, Any]) -> str:
    """JSON with one row to a line: readable, and differences of two runs show."""
    parts = []
    for key, value in strict.items():
        if isinstance(value, list) and value and isinstance(value[0], dict):
            rows = ",\n  ".join(_compact(row) for row in value)
            parts.append(f" {_compact(key)}: [\n  {rows}\n ]")
        else:
            parts.append(f" {_compact(key)}: {_compact(value)}")
    return "{\n" + ",\n".join(parts) + "\n}"


def _compact(value: Any) -> str:
    return json.dumps(value, allow_nan=False, ensure_ascii=False)


def _markdown(data: Mapping[str, Any], tables: Sequence[Table], lines: Sequence[str]) -> str:
    """A run as Markdown: sentences, then tables."""
    seconds = number(data.get("seconds"), 0)
    return "\n\n".join(
        [
            f"## {markdown_line(data.get('title', 'Stress'))}",
            f"{data.get('mode', '')} run, {seconds} s, inim {data.get('inim_version', '')}",
            "\n".join(f"* {markdown_line(line)}" for line in lines),
            *(markdown_section(t.caption, t.heads, t.rows) for t in tables if t.rows),
            markdown_command(data),
        ]
    )


def _page(
    data: Mapping[str, Any], folder: Path, tables: Sequence[Table], lines: Sequence[str]
) -> str:
    """A run as one HTML page: `lines` above the verdict, the figure above the limits."""
    above = {"verdict": bullets(lines, "remarks"), "limits": _figure(folder)}
    bodies: dict[str, str] = {}
    for one in tables:
        if one.rows:
            body = bodies.setdefault(one.part, above.get(one.part, ""))
            bodies[one.part] = body + text_table(one.caption, one.heads, one.rows, "stress")
    title = data.get("title", "Stress")
    return render_page(
        title,
        _facts(data),
        [*(Section(k, _PARTS[k], body) for k, body in bodies.items()), how_to_reproduce(data)],
        window_title=f"{title} – inim",
        footer=data_note(data, "stress.json"),
        style=_STYLE,
    )


def _facts(data: Mapping[str, Any]) -> list[str]:
    return [
        "passed" if data.get("passed") is True else "FAILED",
        f"{text(data.get('mode', MISSING))} run",
        f"{number(data.get('seconds'), 0)} s",
        text(part(data, "backend").get("device", MISSING)),
        timestamp(data),
    ]


def _figure(folder: Path) -> str:
    words = "Error against parameter, single precision solid, double precision dashed"
    caption = f"{words}. Generators at the foot of an axis: no pixel at all."
    return saved_plot(folder / "stress.svg", words, caption)
