"""The report of a stress run: `stress.json`, `stress.md` and `stress.html`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from inim.apps.stress.document import GrowthPoint, RelationResult, StressDocument
from inim.report.labels import MISSING, number, per_cent
from inim.report.study import PagePart, StudyPage, Table

Results = Sequence[RelationResult]


def parts_of(data: StressDocument) -> list[PagePart]:
    """All parts, in the order of the page."""
    topics = list(dict.fromkeys(r.topic for r in data.relations))
    grown = [r for r in data.relations if r.growth]
    return [
        PagePart("verdict", "Verdict", "", [_verdicts(data.relations), _broken(data.relations)]),
        *(
            PagePart(topic, topic.capitalize(), "", [_table(topic, data.relations)])
            for topic in topics
        ),
        PagePart(
            "growth", "Growth of error", "", [_growth(grown)], plot="growth",
            figure=growth_figure(grown) if grown else None,
        ),
        jitter_part(data),
    ]  # fmt: skip


def summary_lines(data: StressDocument) -> list[str]:
    """Results of the run, in sentences."""
    binding = [r for r in data.relations if not r.explained]
    broken = sum(not r.passed for r in binding)
    compared = sum(r.compared for r in binding)
    lines = [
        f"{broken} of {len(binding)} relations are broken; {compared:,} numbers, rays and pixels "
        "were compared. Each relation states its tolerance, its source, and how close it came.",
    ]
    for hits in data.relations:
        if hits.relation == "first hits" and hits.explained and hits.compared:
            lines.append(f"{hits.subject}: {share_text(hits)}.")
    lines.append(
        "The figures on depth errors show the part of a picture that depends on the last digits of "
        "its depth. They do not indicate errors of the arithmetic."
    )
    return lines


def share_text(hits: RelationResult) -> str:
    """Sources of an algorithm that differ from the first hits, with its own promise."""
    share = f"{per_cent(hits.share, 2)} of its sources differ from the exact first hits"
    share += f", the farthest by {number(hits.farthest, 1)} picture pixels"
    if hits.explained:
        return f"{share}; its own definition is another, and holds unless a line says otherwise"
    return f"{share}, where rounding decides or a validation warns; it promises all others"


def small(value: float | None) -> str:
    """A number to two digits; without one, infinite."""
    if value is None:
        return MISSING
    return "0" if value == 0 else f"{value:.2g}".replace("-", "−")


def verdict_of(result: RelationResult) -> str:
    """Verdict on a relation."""
    if not result.passed:
        return f"FAILS: {result.message or result.worst_case}"
    if result.explained:
        return f"not promised: {result.explained}"
    return "holds" if not result.message else result.message


def _verdicts(results: Results) -> Table:
    rows = []
    for topic in dict.fromkeys(r.topic for r in results):
        members = [r for r in results if r.topic == topic and not r.explained]
        broken = sum(not r.passed for r in members)
        counts = len(members), sum(r.cases for r in members), sum(r.compared for r in members)
        cells = [f"{n:,}" for n in (*counts, broken)]
        rows.append([topic, *cells, "FAILS" if broken else "holds"])
    heads = ["topic", "relations", "cases", "compared", "broken", "verdict"]
    return Table("Relations by topic", heads, rows)


def _broken(results: Results) -> Table:
    rows = [
        [r.relation, r.subject, r.claim, small(r.worst), f"{r.limit:g} {r.unit}", verdict_of(r)]
        for r in results
        if not r.passed
    ]
    heads = ["relation", "of", "claim", "worst", "limit", "verdict"]
    return Table("Broken relations", heads, rows)


def _table(topic: str, results: Results) -> Table:
    rows = [
        [
            r.relation, r.subject, f"{r.compared:,}", per_cent(r.share, 2) if r.broken else "0 %",
            small(r.worst), f"{r.limit:g} {r.unit}", r.source, verdict_of(r),
        ]
        for r in results
        if r.topic == topic
    ]  # fmt: skip
    heads = ["relation", "of", "compared", "differ", "worst", "limit", "source", "verdict"]
    return Table(f"Relations of {topic}", heads, rows)


def _growth(results: Results) -> Table:
    rows = []
    for r in results:
        within = [p.position for p in r.growth if not p.warned and _worst(p) <= r.limit]
        ends = f"{min(within):g} to {max(within):g}" if within else "none"
        tried = f"{r.growth[0].position:g} to {r.growth[-1].position:g}"
        rows.append([r.relation, r.subject, r.axis, tried, ends])
    heads = ["relation", "of", "parameter", "tried", "within the limit without a warning"]
    return Table("Ranges of parameters", heads, rows)


def _worst(point: GrowthPoint) -> float:
    return float("inf") if point.worst is None else point.worst


def growth_figure(results: Results) -> Any:
    """Deviations along the parameters of the relations of growth, with their limits."""
    from inim.report.plots import LEGEND, LINES, blank_figure, colour_of, style

    with_limit = [r for r in results if r.limit > 0]
    axes_of = list(dict.fromkeys(r.relation for r in with_limit))
    if not with_limit:
        return None
    figure = blank_figure((5.2 * len(axes_of), 3.6), "constrained")
    lens_colours = {"pinhole": "#0072b2", "thin": "#d55e00", "thick": "#009e73"}
    for number_of_axis, name in enumerate(axes_of):
        axis = figure.add_subplot(1, len(axes_of), number_of_axis + 1)
        members = [r for r in with_limit if r.relation == name]
        style(axis, name, members[0].axis, members[0].unit)
        axis.set_xscale("log")
        axis.set_yscale("log")
        for r in members:
            colour = lens_colours.get(r.subject) or colour_of(r.subject)
            points = [p for p in r.growth if 0 < _worst(p) < float("inf") and p.position > 0]
            axis.plot([p.position for p in points], [_worst(p) for p in points], color=colour,
                      label=r.subject, linewidth=1.2)  # fmt: skip
            for is_warned, filled in ((False, colour), (True, "none")):
                part = [p for p in points if p.warned == is_warned]
                axis.plot([p.position for p in part], [_worst(p) for p in part], "o",
                          markersize=4, color=colour, markerfacecolor=filled)  # fmt: skip
        axis.axhline(members[0].limit, **LINES["floor"])
        axis.legend(**LEGEND)
    return figure


def jitter_part(data: StressDocument) -> PagePart:
    """Effects of depth errors, algorithm by algorithm."""
    names = list(dict.fromkeys(row.algorithm for row in data.jitter))
    rows = []
    for kind in dict.fromkeys(row.jitter for row in data.jitter):
        by_name = {row.algorithm: row for row in data.jitter if row.jitter == kind}
        cells = [kind]
        for name in names:
            cells += [per_cent(by_name[name].changed, 3), small(by_name[name].ssim_loss)]
        rows.append(cells)
    heads = ["depth"] + [h for n in names for h in (f"{n}: changed", "SSIM loss")]
    caption = "Effect of small depth errors"
    if data.picture is not None:
        size = f"{data.picture.columns} × {data.picture.rows} pixels"
        caption += f": {data.picture.name}, {size}"
    return PagePart("jitter", "Depth errors", "", [Table(caption, heads, rows)])


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
