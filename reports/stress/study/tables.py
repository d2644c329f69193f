"""Parts of the accuracy study's page."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from inim.apps.stress.page import (
    count,
    jitter_part,
    relations_part,
    small,
    verdict_part,
)
from inim.report.labels import MISSING, is_number, per_cent, short
from inim.report.study import PagePart, Table
from reports.stress.study.document import StudyDocument

Rows = Sequence[Mapping[str, Any]]


_LIMITS = (
    "Error against parameter. Solid: single precision. Dashed: double precision. Points at the "
    "bottom of a generator's plot are cases without a changed pixel."
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
    """Results of the run, in sentences."""
    trust = data.trust
    exact, slope, ties = trust["exact"], trust["slope"], trust["changed_by_ties"]
    changed = per_cent(trust["changed_by_rounding"], 0)
    return [
        "Exact paths (template, its means of 2 and 4 rays, layered): "
        f"{exact['changed']} of {count(exact['pixels'])} pixels in "
        f"{exact['rows']} runs without a warning differ from the definition, both with float32 "
        "tables and with float64 rays.",
        "Lengths with more digits than float64 can multiply exactly are outside the proof: at most "
        f"{changed} of a noise picture's pixels then have a neighbour as source, all within "
        "rounding.",
        "Hexagonal, turned and tilted arrays have rays in float64. Rays of regular arrays meet "
        f"corners: at most {per_cent(ties['warned'], 0)} of a picture's pixels have a neighbour as "
        f"source, with a warning; in other arrays {per_cent(ties['unwarned'], 0)}, near the axis.",
        "The landing points of the lens models have an error below a hundredth of a panel pixel in "
        f"float32 up to a slope of {short(slope['pinhole'])} (pinhole), {short(slope['thin'])} "
        f"(thin) and {short(slope['thick'])} (thick), and up to {count(trust['panel_pixels'])} "
        "panel pixels per side.",
        f"The oracle of the lens models has a mantissa of {data.oracle_mantissa_bits} bits. The "
        "oracle of the generators uses float64, and fractions where rounding may decide.",
        "A pixel or a ray is uncertain if rounding in its type may decide it. Displays are "
        "regular, so that many rays meet corners; the exact path decides these by a rule.",
    ]


def grouped(rows: Rows, keys: Sequence[str]) -> dict[tuple[str, ...], list[Mapping[str, Any]]]:
    """Rows by the values of some keys, in order of first appearance."""
    groups: dict[tuple[str, ...], list[Mapping[str, Any]]] = {}
    for row in rows:
        groups.setdefault(tuple(row[key] for key in keys), []).append(row)
    return groups


def _regions(data: StudyDocument) -> Table:
    """Table of safe ranges; algorithms with equal ranges share a row."""
    groups: dict[tuple[str, str, str], list[str]] = {}
    for r in data.regions:
        name = f"{r['name']}, {_form_label(r['name'], r['dtype'])}"
        ranges = (_range(r["low"], r["high"]), _range(*r["tried"]))
        groups.setdefault((f"{r['family']}: {r['parameter']}", *ranges), []).append(name)
    rows = [
        [parameter, "; ".join(names), safe, tested]
        for (parameter, safe, tested), names in groups.items()
    ]
    heads = ["parameter", "generator or lens model", "safe", "tested"]
    return Table("Accuracy limits: safe ranges", heads, rows)


def _range(low: float | None, high: float | None) -> str:
    if not is_number(low) and not is_number(high):
        return "none"
    return f"{_end(low)} … {_end(high)}"


def _end(value: float | None) -> str:
    return f"{value:.6g}".replace("-", "−") if is_number(value) else "∞"


def _max(
    rows: Iterable[Mapping[str, Any]], value_of: Callable[[Mapping[str, Any]], Any]
) -> float | None:
    values = [v for v in map(value_of, rows) if is_number(v)]
    return max(values) if values else None


def _mean(rows: Rows, value_of: Callable[[Mapping[str, Any]], Any]) -> float | None:
    values = [v for v in map(value_of, rows) if is_number(v)]
    return sum(values) / len(values) if values else None


def _share(key: str) -> Callable[[Mapping[str, Any]], Any]:
    return lambda row: row[key] / row["pixels"] if row.get("pixels") else None


def _loss(row: Mapping[str, Any]) -> Any:
    return row.get("ssim_loss")


def _families(rows: Rows) -> Table:
    """Table of the exact path, one row per family."""
    rows_of_table = []
    for (family,), members in grouped(rows, ["family"]).items():
        cases = len({m["case"] for m in members})
        refused = len({m["case"] for m in members if m["algorithm"] == "all"})
        ran = [m for m in members if m["outcome"] == "ran" and m["algorithm"] == "template"]
        cells = [family, str(cases), str(refused)]
        for dtype in ("float32", "float64"):
            typed = [m for m in ran if m["dtype"] == dtype]
            cells += [
                per_cent(_max(typed, _share("changed")), 1),
                _ulp(_max(typed, lambda m: m["worst_ulp"])),
                _ulp(_mean(typed, lambda m: m["mean_ulp"])),
            ]
        cells += [
            per_cent(_max(ran, _share("uncertain")), 0),
            small(_max(ran, _loss)),
        ]
        rows_of_table.append(cells)
    heads = [
        "family", "cases", "refused", "float32: changed", "worst ulp", "mean ulp",
        "float64: changed", "worst ulp", "mean ulp", "uncertain", "SSIM loss",
    ]  # fmt: skip
    return Table("template, worst case of each family", heads, rows_of_table)


def _variants(rows: Rows) -> Table:
    rows_of_table = []
    for (algorithm, dtype), members in grouped(rows, ["algorithm", "dtype"]).items():
        ran = [m for m in members if m["outcome"] == "ran"]
        if not ran:
            continue
        pixels = sum(m["pixels"] for m in ran)
        rows_of_table.append(
            [
                f"{algorithm}, {_form_label(algorithm, dtype)}",
                str(len(ran)),
                str(len(members) - len(ran)),
                per_cent(sum(m["changed"] for m in ran) / pixels, 3),
                per_cent(_max(ran, _share("changed")), 1),
                per_cent(sum(m["uncertain"] for m in ran) / pixels, 1),
                str(sum(m["outside"] for m in ran)),
                small(_max(ran, _loss)),
                _ulp(_max(ran, lambda m: m["worst_ulp"])),
                _ulp(_mean(ran, lambda m: m["mean_ulp"])),
            ]
        )
    heads = [
        "generator", "cases", "refused", "changed, all", "changed, worst case", "uncertain, all",
        "changed and certain", "worst SSIM loss", "worst ulp", "mean ulp",
    ]  # fmt: skip
    return Table("All generators, all cases", heads, rows_of_table)


def _form_label(algorithm: str, dtype: str) -> str:
    if ":samples" in algorithm:
        return "default" if algorithm.endswith("=1") else "mean colours"
    if algorithm.startswith("template"):
        return "float32 tables" if dtype == "float32" else "float64 rays"
    return dtype


def _ulp(value: float | None) -> str:
    if value is None:
        return MISSING
    return f"{value:.2g}" if value < 1000 else f"{value:.1e}"


def _optics(rows: Rows) -> Table:
    rows_of_table = []
    for (family, model), members in grouped(rows, ["family", "model"]).items():
        ran = [m for m in members if m["outcome"] == "ran"]
        if not ran:
            continue
        cells = [family, model, str(len({m["case"] for m in ran}))]
        for dtype in ("float32", "float64"):
            typed = [m for m in ran if m["dtype"] == dtype]
            cells += [
                _ulp(_max(typed, lambda m: m["worst_ulp"])),
                _ulp(_mean(typed, lambda m: m["mean_ulp"])),
                small(_max(typed, lambda m: m["worst_pixels"])),
            ]
        single = [m for m in ran if m["dtype"] == "float32"]
        rays = sum(m["rays"] for m in single)
        cells += [
            per_cent(sum(m["changed"] for m in single) / rays, 2),
            per_cent(sum(m["uncertain"] for m in single) / rays, 1),
            str(sum(m["outside"] for m in ran)),
        ]
        rows_of_table.append(cells)
    heads = [
        "family", "lens model", "cases", "float32: worst ulp", "mean ulp", "worst, panel pixels",
        "float64: worst ulp", "mean ulp", "worst, panel pixels", "float32: rays on another pixel",
        "uncertain", "changed and certain",
    ]  # fmt: skip
    return Table("Landing points of the lens models", heads, rows_of_table)


def _guarded(generators: Rows, optics: Rows) -> Table:
    rows_of_table = []
    for row in [*generators, *optics]:
        if row["outcome"] != "ran" or row["safe"]:
            continue
        total = row.get("pixels", row.get("rays"))
        name = row.get("algorithm", row.get("model"))
        violation = f"{row['changed']} of {total} changed"
        if "worst_pixels" in row:
            violation += f", error {row['worst_pixels']:.2g} panel pixels"
        warning = row["guards"][0] if row["guards"] else "NO WARNING"
        type_name = f"{name}, {row['dtype']}"
        rows_of_table.append([row["family"], row["case"], type_name, violation, warning])
    heads = ["family", "case", "generator or lens model", "violation", "warning of a validation"]
    return Table("Violations with their warnings", heads, rows_of_table)


def _refusals(generators: Rows, optics: Rows) -> Table:
    messages: dict[str, list[str]] = {}
    for row in [*generators, *optics]:
        if row["outcome"] == "refused":
            kind = row["message"].partition(":")[0]
            group = messages.setdefault(f"{row['family']}: {kind}", [])
            group.append(f"{row['case']} → {row['message']}")
    rows = [[name, str(len(group)), group[0]] for name, group in messages.items()]
    heads = ["family and error", "refused", "example"]
    return Table("Refused cases and their messages", heads, rows)
