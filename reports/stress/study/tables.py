"""The parts of the accuracy study, for its page and its Markdown alike."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from inim.report.labels import MISSING, is_number, per_cent, short
from inim.report.stress import (
    count,
    jitter_part,
    relations_part,
    small,
    verdict_part,
)
from inim.report.study import PagePart, Table
from reports.stress.study.document import StudyDocument

Rows = Sequence[Mapping[str, Any]]


_LIMITS = (
    "Error against parameter, single precision solid, double precision dashed. Generators at the "
    "foot of an axis: no pixel at all."
)


def parts_of(data: StudyDocument) -> list[PagePart]:
    """All parts, in the order of the page."""
    generators, optics = data.generators, data.lens_models
    tables = [_families(generators), _variants(generators)]
    return [
        verdict_part(data),
        PagePart("limits", "Accuracy limits", _LIMITS, [_regions(data)], "stress"),
        PagePart("generators", "Generators", "", tables),
        PagePart("lenses", "Lens models", "", [_optics(optics)]),
        relations_part(data.relations),
        jitter_part(data),
        PagePart("guarded", "Violations and their warnings", "", [_guarded(generators, optics)]),
        PagePart("refused", "Refused", "", [_refusals(generators, optics)]),
    ]


def summary_lines(data: StudyDocument) -> list[str]:
    """What the run says, in sentences."""
    trust = data.trust
    exact, slope, ties = trust["exact"], trust["slope"], trust["changed_by_ties"]
    changed = per_cent(trust["changed_by_rounding"], 0)
    return [
        "Exact paths (template, its means of 2 and 4 rays, layered): "
        f"{exact['changed']} of {count(exact['pixels'])} pixels in "
        f"{exact['rows']} runs differ from the definition, in float32 tables and "
        "float64 rays alike, wherever no warning is given.",
        f"Lengths of more digits than float64 can multiply exactly leave the proof: at worst "
        f"{changed} of a noise picture then go to a neighbour, all within rounding.",
        "Hexagonal, turned and tilted arrays have rays in float64. Rays of regular ones meet "
        f"corners: at worst {per_cent(ties['warned'], 0)} of a picture's pixels go to a "
        f"neighbour, with a warning; of the others {per_cent(ties['unwarned'], 0)}, near the "
        "axis.",
        "Lens models land within a hundredth of a panel pixel in float32 up to a slope of "
        f"{short(slope['pinhole'])} (pinhole), {short(slope['thin'])} (thin) and "
        f"{short(slope['thick'])} (thick), and up to {count(trust['panel_pixels'])} panel "
        "pixels across.",
        f"Oracle of the lens models: {data.oracle_mantissa_bits} bits of mantissa; "
        "of the generators: float64, and fractions wherever rounding might decide.",
        "Uncertain: the decision of a pixel or a ray lies within the rounding of its type. Many "
        "are, for displays are regular and rays meet corners; the exact path decides them by rule.",
    ]


def grouped(rows: Rows, keys: Sequence[str]) -> dict[tuple[str, ...], list[Mapping[str, Any]]]:
    """Rows by the values of some keys, in order of first appearance."""
    groups: dict[tuple[str, ...], list[Mapping[str, Any]]] = {}
    for row in rows:
        groups.setdefault(tuple(row[key] for key in keys), []).append(row)
    return groups


def _regions(data: StudyDocument) -> Table:
    """Alike ranges of one family share a row."""
    alike: dict[tuple[str, str, str], list[str]] = {}
    for r in data.regions:
        name = f"{r['name']}, {_dress(r['name'], r['dtype'])}"
        ranges = (_range(r["low"], r["high"]), _range(*r["tried"]))
        alike.setdefault((f"{r['family']}: {r['parameter']}", *ranges), []).append(name)
    rows = [[what, "; ".join(names), safe, tried] for (what, safe, tried), names in alike.items()]
    heads = ["parameter", "what", "safe", "tried"]
    return Table("Accuracy limits: measured safe between", heads, rows)


def _range(low: float | None, high: float | None) -> str:
    if not is_number(low) and not is_number(high):
        return "none"
    return f"{_end(low)} … {_end(high)}"


def _end(value: float | None) -> str:
    return f"{value:.6g}".replace("-", "−") if is_number(value) else "∞"


def _most(
    rows: Iterable[Mapping[str, Any]], of: Callable[[Mapping[str, Any]], Any]
) -> float | None:
    known = [v for v in map(of, rows) if is_number(v)]
    return max(known) if known else None


def _mean(rows: Rows, of: Callable[[Mapping[str, Any]], Any]) -> float | None:
    known = [v for v in map(of, rows) if is_number(v)]
    return sum(known) / len(known) if known else None


def _share(key: str) -> Callable[[Mapping[str, Any]], Any]:
    return lambda row: row[key] / row["pixels"] if row.get("pixels") else None


def _loss(row: Mapping[str, Any]) -> Any:
    return row.get("ssim_loss")


def _families(rows: Rows) -> Table:
    """The exact path, family by family."""
    found = []
    for (family,), members in grouped(rows, ["family"]).items():
        cases = len({m["case"] for m in members})
        refused = len({m["case"] for m in members if m["algorithm"] == "all"})
        ran = [m for m in members if m["outcome"] == "ran" and m["algorithm"] == "template"]
        cells = [family, str(cases), str(refused)]
        for dtype in ("float32", "float64"):
            mine = [m for m in ran if m["dtype"] == dtype]
            cells += [
                per_cent(_most(mine, _share("changed")), 1),
                _ulp(_most(mine, lambda m: m["worst_ulp"])),
                _ulp(_mean(mine, lambda m: m["mean_ulp"])),
            ]
        cells += [
            per_cent(_most(ran, _share("uncertain")), 0),
            small(_most(ran, _loss)),
        ]
        found.append(cells)
    heads = [
        "family", "cases", "refused", "float32: changed", "worst ulp", "mean ulp",
        "float64: changed", "worst ulp", "mean ulp", "uncertain", "SSIM loss",
    ]  # fmt: skip
    return Table("template, worst case of each family", heads, found)


def _variants(rows: Rows) -> Table:
    found = []
    for (algorithm, dtype), members in grouped(rows, ["algorithm", "dtype"]).items():
        ran = [m for m in members if m["outcome"] == "ran"]
        if not ran:
            continue
        pixels = sum(m["pixels"] for m in ran)
        found.append(
            [
                f"{algorithm}, {_dress(algorithm, dtype)}",
                str(len(ran)),
                str(len(members) - len(ran)),
                per_cent(sum(m["changed"] for m in ran) / pixels, 3),
                per_cent(_most(ran, _share("changed")), 1),
                per_cent(sum(m["uncertain"] for m in ran) / pixels, 1),
                str(sum(m["outside"] for m in ran)),
                small(_most(ran, _loss)),
                _ulp(_most(ran, lambda m: m["worst_ulp"])),
                _ulp(_mean(ran, lambda m: m["mean_ulp"])),
            ]
        )
    heads = [
        "generator", "cases", "refused", "changed, all", "changed, worst case", "uncertain, all",
        "changed though certain", "worst SSIM loss", "worst ulp", "mean ulp",
    ]  # fmt: skip
    return Table("Every generator over all cases", heads, found)


def _dress(algorithm: str, dtype: str) -> str:
    if ":samples" in algorithm:
        return "as run" if algorithm.endswith("=1") else "mean colours"
    if algorithm.startswith("template"):
        return "float32 tables" if dtype == "float32" else "float64 rays"
    return dtype


def _ulp(value: float | None) -> str:
    if value is None:
        return MISSING
    return f"{value:.2g}" if value < 1000 else f"{value:.1e}"


def _optics(rows: Rows) -> Table:
    found = []
    for (family, model), members in grouped(rows, ["family", "model"]).items():
        ran = [m for m in members if m["outcome"] == "ran"]
        if not ran:
            continue
        cells = [family, model, str(len({m["case"] for m in ran}))]
        for dtype in ("float32", "float64"):
            mine = [m for m in ran if m["dtype"] == dtype]
            cells += [
                _ulp(_most(mine, lambda m: m["worst_ulp"])),
                _ulp(_mean(mine, lambda m: m["mean_ulp"])),
                small(_most(mine, lambda m: m["worst_pixels"])),
            ]
        single = [m for m in ran if m["dtype"] == "float32"]
        rays = sum(m["rays"] for m in single)
        cells += [
            per_cent(sum(m["changed"] for m in single) / rays, 2),
            per_cent(sum(m["uncertain"] for m in single) / rays, 1),
            str(sum(m["outside"] for m in ran)),
        ]
        found.append(cells)
    heads = [
        "family", "lens model", "cases", "float32: worst ulp", "mean ulp", "worst, panel pixels",
        "float64: worst ulp", "mean ulp", "worst, panel pixels", "float32: rays on another pixel",
        "uncertain", "changed though certain",
    ]  # fmt: skip
    return Table("Landing points of the lens models", heads, found)


def _guarded(generators: Rows, optics: Rows) -> Table:
    found = []
    for row in [*generators, *optics]:
        if row["outcome"] != "ran" or row["safe"]:
            continue
        total = row.get("pixels", row.get("rays"))
        who = row.get("algorithm", row.get("model"))
        figure = f"{row['changed']} of {total} changed"
        if "worst_pixels" in row:
            figure += f", off by {row['worst_pixels']:.2g} panel pixels"
        why = row["guards"][0] if row["guards"] else "NOT GUARDED"
        found.append([row["family"], row["case"], f"{who}, {row['dtype']}", figure, why])
    heads = ["family", "case", "what", "figure", "the warning a run of it gives"]
    return Table("Violations, each with its warning", heads, found)


def _refusals(generators: Rows, optics: Rows) -> Table:
    seen: dict[str, list[str]] = {}
    for row in [*generators, *optics]:
        if row["outcome"] == "refused":
            kind = row["message"].partition(":")[0]
            where = seen.setdefault(f"{row['family']}: {kind}", [])
            where.append(f"{row['case']} → {row['message']}")
    rows = [[name, str(len(said)), said[0]] for name, said in seen.items()]
    heads = ["family and error", "refused", "for example"]
    return Table("What is refused, and with which sentence", heads, rows)
