"""The report of a stress run: `stress.json`, `stress.md` and `stress.html`."""

from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

from inim.apps.stress.document import FirstHitsResult, RelationResult, StressDocument
from inim.report.labels import MISSING, number, per_cent
from inim.report.study import PagePart, StudyPage, Table
from inim.system.document import Part

Hits = Sequence[FirstHitsResult]
_P = TypeVar("_P", bound=Part)


def parts_of(data: StressDocument) -> list[PagePart]:
    """All parts, in the order of the page."""
    return [
        verdict_part(data),
        PagePart("hits", "First hits", "", [_hits(data.first_hits), _wrong(data.first_hits)]),
        relations_part(data.relations),
        jitter_part(data),
        PagePart("refused", "Refused", "", [_errors(data.first_hits)]),
    ]


def summary_lines(data: StressDocument) -> list[str]:
    """Results of the run, in sentences."""
    exact = [hits for hits in data.first_hits if hits.exact and not hits.warnings]
    wrong = sum(hits.wrong for hits in exact)
    pixels = sum(hits.pixels for hits in exact)
    broken = sum(not relation.passed for relation in data.relations)
    return [
        f"{wrong} of {count(pixels)} panel pixels differ from the first hits in rational "
        "arithmetic, in algorithms that promise first hits and in cases without a warning. For "
        "the other algorithms, the tables give the share.",
        f"{broken} of {len(data.relations)} relations fail. A pixel is uncertain if it also "
        "changes after a change of lengths or depths by a ten-millionth: rounding may decide it.",
        "The figures on depth errors show the part of a picture that depends on the last digits of "
        "its depth. They do not indicate errors of the arithmetic.",
    ]


def count(value: float | None) -> str:
    """Format a whole number with separated thousands."""
    return MISSING if value is None else f"{value:,.0f}"


def small(value: float | None) -> str:
    """A number near zero, to two digits."""
    if value is None:
        return MISSING
    return "0" if value == 0 else f"{value:.1e}".replace("-", "−")


def _group_rows(rows: Sequence[_P], field: str) -> dict[str, list[_P]]:
    """Rows by the value of a field, in order of first appearance."""
    groups: dict[str, list[_P]] = {}
    for row in rows:
        groups.setdefault(getattr(row, field), []).append(row)
    return groups


def verdict_part(data: StressDocument) -> PagePart:
    """The verdict, claim by claim."""
    rows = [
        [c.name, count(c.cases), count(c.broken), "holds" if c.passed else "FAILS"]
        for c in data.checks
    ]
    table = Table("Checked claims", ["check", "cases", "broken", "verdict"], rows)
    return PagePart("verdict", "Verdict", "", [table])


def _hits(rows: Hits) -> Table:
    """Wrong sources of each algorithm, family by family."""
    families = list(dict.fromkeys(r.family for r in rows))
    table_rows = []
    for algorithm, members in _group_rows(rows, "algorithm").items():
        cells = [algorithm]
        for family in families:
            ran = [r for r in members if r.family == family and r.outcome == "ran"]
            pixels = sum(r.pixels for r in ran)
            cells.append(per_cent(sum(r.wrong for r in ran) / pixels, 2) if pixels else MISSING)
        refused = sum(r.outcome == "refused" for r in members)
        table_rows.append([*cells, str(len(members)), str(refused)])
    heads = ["algorithm", *(f"{family}: wrong" for family in families), "cases", "refused"]
    return Table("Panel pixels that show another source than the first hit", heads, table_rows)


def _wrong(rows: Hits) -> Table:
    """Cases in which an exact algorithm is wrong, with the warning that a validation would give."""
    table_rows = [
        [
            r.algorithm,
            f"{r.family}: {r.case}",
            f"{r.wrong} of {r.pixels}",
            r.warnings[0] if r.warnings else "NONE",
        ]
        for r in rows
        if r.exact and r.wrong
    ]
    heads = ["algorithm", "case", "wrong pixels", "warning that a validation gives"]
    return Table("First hits by definition that are wrong", heads, table_rows)


def _errors(rows: Hits) -> Table:
    table_rows = [
        [r.algorithm, f"{r.family}: {r.case}", r.outcome, r.message]
        for r in rows
        if r.outcome in ("refused", "crashed")
    ]
    heads = ["algorithm", "case", "outcome", "message"]
    return Table("Refused, or crashed", heads, table_rows)


def relations_part(rows: Sequence[RelationResult]) -> PagePart:
    """Relations, algorithms with one verdict in one row."""
    groups: dict[tuple[str, str, bool], list[RelationResult]] = {}
    for row in rows:
        key = (row.relation, row.explained, row.passed and not row.broken)
        groups.setdefault(key, []).append(row)
    table_rows = []
    for (name, _, _), members in groups.items():
        algorithms = ", ".join(member.algorithm for member in members)
        compared, broken, uncertain = (
            sum(getattr(member, field) for member in members)
            for field in ("compared", "broken", "uncertain")
        )
        verdict = _relation_verdict(members)
        table_rows.append([name, algorithms, count(compared), str(broken), str(uncertain), verdict])
    heads = ["relation", "of", "pixels or rays", "broken", "of these uncertain", "verdict"]
    table = Table("Relations that need no oracle", heads, table_rows)
    return PagePart("relations", "Relations", "", [table])


def _relation_verdict(members: Sequence[RelationResult]) -> str:
    """Verdict on a relation for algorithms with the same explanation."""
    first = members[0]
    if not all(member.passed for member in members):
        return "FAILS"
    if not any(member.compared for member in members):
        return f"refused: {first.message}"
    if not any(member.broken for member in members):
        return "holds"
    return f"not promised: {first.explained}" if first.explained else "holds but for rounding"


def jitter_part(data: StressDocument) -> PagePart:
    """Effects of depth errors, algorithm by algorithm."""
    names = list(dict.fromkeys(row.algorithm for row in data.jitter))
    table_rows = []
    for kind, members in _group_rows(data.jitter, "jitter").items():
        by_name = {member.algorithm: member for member in members}
        cells = [kind]
        for name in names:
            cells += [per_cent(by_name[name].changed, 3), small(by_name[name].ssim_loss)]
        table_rows.append(cells)
    heads = ["depth"] + [h for n in names for h in (f"{n}: changed", "SSIM loss")]
    picture = data.picture
    caption = (
        f"Effect of small depth errors: {picture.name}, {picture.columns} × {picture.rows} pixels"
    )
    return PagePart("jitter", "Depth errors", "", [Table(caption, heads, table_rows)])


def write_stress(data: StressDocument, folder: Path) -> None:
    """Write all forms into a folder, `stress.json` last, as a mark of completeness.

    * `data`: its `files` are set here.
    """
    facts = [
        "passed" if data.passed else "FAILED",
        f"{data.mode} run",
        f"{number(data.seconds, 0)} s",
        data.backend.device,
        f"inim {data.inim_version}",
    ]
    StudyPage("Summary", facts, summary_lines(data), parts_of(data)).write(data, folder, "stress")
