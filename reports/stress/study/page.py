"""Page of the accuracy study: verdict, limits, errors, relations and small depth errors."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from inim.apps.stress.document import RelationResult
from inim.apps.stress.page import count, relations_part, small
from inim.generators.accuracy_limits import LANDING_PIXELS
from inim.report.labels import MISSING, is_number, per_cent, short
from inim.report.plots import LINES, across, colour_of, new_figure, style
from inim.report.study import PagePart, Table
from reports.stress.study.cases import FAMILIES, INFINITE
from reports.stress.study.lens_cases import LENS_FAMILIES, display_of
from reports.stress.study.limits import accuracy_limits_of, checks_of, regions_of
from reports.study import Results, entry, table

#: Beginnings of the names of cases with generators and with lens models.
GENERATORS, LENSES = "generators: ", "lens models: "
Rows = Sequence[Mapping[str, Any]]
# Position of zero on the logarithmic axis of shares.
_NO_ERROR = 1e-4
_LENS_COLOURS = {"pinhole": "#009e73", "thin": "#0072b2", "thick": "#d55e00"}
# Families in the figure, with the labels of their axes.
_LENS_PANELS = {
    "incidence": "sideways travel of a ray per mm",
    "array width": "lenses across the array",
    "eye distance": "distance of the eye from the array, mm",
}
_GENERATOR_PANELS = {
    "distance in front": "distance of the nearest surface, mm",
    "depth span": "log2 of distance / depth range",
    "g to f from above, default range": "log2 of f / (g - f)",
}


def rows_of(results: Results, part: str) -> list[Mapping[str, Any]]:
    """Rows of all families of generators or lens models."""
    return [row for name, rows in results.items() if name.startswith(part) for row in rows]


def checks(results: Results) -> list[dict[str, Any]]:
    """Claims of the verdict."""
    relations = [RelationResult(**row) for row in results["relations"]]
    return checks_of(rows_of(results, GENERATORS), rows_of(results, LENSES), relations)


def page(results: Results) -> tuple[list[str], list[PagePart]]:
    """Sentences and parts of the page."""
    generators, lenses = rows_of(results, GENERATORS), rows_of(results, LENSES)
    verdict = {
        "check": entry("name"),
        "cases": entry("cases"),
        "broken": entry("broken"),
        "verdict": lambda check: "holds" if check["passed"] else "FAILS",
    }
    lead = (
        "Error against parameter. Solid: single precision. Dashed: double precision. Points at the "
        "bottom of a generator's plot are cases without a changed pixel."
    )
    relations = [RelationResult(**row) for row in results["relations"]]
    return _sentences(generators, lenses), [
        PagePart("verdict", "Verdict", "", [table("Checked claims", checks(results), verdict)]),
        PagePart(
            "limits", "Accuracy limits", lead, [_regions(generators, lenses)], "stress",
            _draw(generators, lenses),
        ),
        PagePart("generators", "Generators", "", [_generators(generators)]),
        PagePart("lenses", "Lens models", "", [_lenses(lenses)]),
        relations_part(relations),
        PagePart("jitter", "Depth errors", "", [_jitter(results["jitter"])]),
        PagePart("guarded", "Violations", "", [_guarded(generators, lenses)]),
    ]  # fmt: skip


def _sentences(generators: Rows, lenses: Rows) -> list[str]:
    """Results of the run, in sentences."""
    limits = accuracy_limits_of(generators, lenses, round(display_of().pixels_per_lens))
    exact, slope, ties = limits["exact"], limits["slope"], limits["changed_by_ties"]
    return [
        "Exact paths (template, its means of 2 and 4 rays, layered): "
        f"{exact['changed']} of {count(exact['pixels'])} pixels in "
        f"{exact['rows']} runs without a warning differ from the definition, both with float32 "
        "tables and with float64 rays.",
        "Lengths with more digits than float64 can multiply exactly are outside the proof: at most "
        f"{per_cent(limits['changed_by_rounding'], 0)} of a noise picture's pixels then have a "
        "neighbour as source, all within rounding.",
        "Hexagonal, turned and tilted arrays have rays in float64. Rays of regular arrays meet "
        f"corners: at most {per_cent(ties['warned'], 0)} of a picture's pixels have a neighbour as "
        f"source, with a warning; in other arrays {per_cent(ties['unwarned'], 0)}, near the axis.",
        "The landing points of the lens models have an error below a hundredth of a panel pixel in "
        f"float32 up to a slope of {', '.join(f'{short(s)} ({m})' for m, s in slope.items())}, and "
        f"up to {count(limits['panel_pixels'])} panel pixels per side. Least refractive index: "
        f"{short(limits['least_index'])}.",
        f"The oracle of the lens models has a mantissa of {np.finfo(np.longdouble).nmant + 1} bits "
        "on this machine. That of the generators uses float64, and fractions where rounding may "
        "decide. A pixel or a ray is uncertain if rounding in its type may decide it.",
    ]


def grouped(rows: Rows, *keys: str) -> dict[tuple[str, ...], list[Mapping[str, Any]]]:
    """Rows that ran by the values of some keys, in order of first appearance."""
    groups: dict[tuple[str, ...], list[Mapping[str, Any]]] = {}
    for row in rows:
        if row["outcome"] == "ran":
            groups.setdefault(tuple(row[key] for key in keys), []).append(row)
    return groups


def _regions(generators: Rows, lenses: Rows) -> Table:
    """Table of safe ranges; algorithms with equal ranges share a row."""
    parameters = {f.name: f.parameter for f in FAMILIES}
    parameters |= {f.name: f.parameter for f in LENS_FAMILIES}
    groups: dict[tuple[str, str, str], list[str]] = {}
    for r in regions_of(generators, lenses, parameters):
        ranges = (_range(r["low"], r["high"]), _range(*r["tried"]))
        family = f"{r['family']}: {parameters[r['family']]}"
        groups.setdefault((family, *ranges), []).append(f"{r['name']}, {r['dtype']}")
    rows = [
        [parameter, "; ".join(names), safe, tested]
        for (parameter, safe, tested), names in groups.items()
    ]
    heads = ["parameter", "generator or lens model", "safe", "tested"]
    return Table("Accuracy limits: safe ranges", heads, rows)


def _range(low: float | None, high: float | None) -> str:
    if low is None or high is None:
        return "none"
    ends = ("∞" if end == INFINITE else f"{end:.6g}".replace("-", "−") for end in (low, high))
    return " … ".join(ends)


def _generators(rows: Rows) -> Table:
    """All cases of each family, and of all families, by algorithm and type."""
    groups = {("all", *key): rows for key, rows in grouped(rows, "algorithm", "dtype").items()}
    groups |= grouped([r for r in rows if r.get("exact")], "family", "algorithm", "dtype")

    def total(key: str) -> Callable[[Any], int]:
        return lambda item: sum(row[key] for row in item[1])

    columns = {
        "family": lambda item: item[0][0],
        "generator": lambda item: ", ".join(item[0][1:]),
        "cases": lambda item: str(len(item[1])),
        "changed, all": lambda item: per_cent(total("changed")(item) / total("pixels")(item), 3),
        "changed, worst case": lambda item: per_cent(
            max(row["changed"] / row["pixels"] for row in item[1]), 1
        ),
        "uncertain, all": lambda item: per_cent(
            total("uncertain")(item) / total("pixels")(item), 1
        ),
        "changed and certain": lambda item: str(total("outside")(item)),
    }
    return table("Sources of the generators", groups.items(), columns)


def _lenses(rows: Rows) -> Table:
    """Errors of the landing points, by family, model and type."""

    def worst(key: str) -> Callable[[Any], float]:
        return lambda item: max(row[key] for row in item[1])

    columns = {
        "family": lambda item: item[0][0],
        "lens model": lambda item: ", ".join(item[0][1:]),
        "cases": lambda item: str(len(item[1])),
        "worst ulp": lambda item: f"{worst('worst_ulp')(item):.2g}",
        "worst, panel pixels": lambda item: small(worst("worst_pixels")(item)),
        "rays on another pixel": lambda item: per_cent(
            sum(r["changed"] for r in item[1]) / sum(r["rays"] for r in item[1]), 2
        ),
        "uncertain": lambda item: per_cent(
            sum(r["uncertain"] for r in item[1]) / sum(r["rays"] for r in item[1]), 1
        ),
        "changed and certain": lambda item: str(sum(r["outside"] for r in item[1])),
    }
    groups = grouped(rows, "family", "model", "dtype")
    return table("Landing points of the lens models", groups.items(), columns)


def _jitter(rows: Rows) -> Table:
    """Effects of small depth errors on two spheres, algorithm by algorithm."""
    by_key = {(r["jitter"], r["algorithm"]): r for r in rows}
    columns: dict[str, Callable[[Any], str]] = {"depth": str}
    for name in dict.fromkeys(r["algorithm"] for r in rows):
        columns[f"{name}: changed"] = _of_pair(by_key, name, "changed", lambda v: per_cent(v, 3))
        columns[f"{name}: SSIM loss"] = _of_pair(by_key, name, "ssim_loss", small)
    kinds = dict.fromkeys(r["jitter"] for r in rows)
    return table("Effect of small depth errors on two spheres", kinds, columns)


def _of_pair(
    rows: Mapping[tuple[str, str], Any], name: str, key: str, text: Callable[[Any], str]
) -> Callable[[Any], str]:
    return lambda kind: text(rows[kind, name][key])


def _guarded(generators: Rows, lenses: Rows) -> Table:
    """Violations, with the warning of a validation."""
    columns = {
        "family": entry("family"),
        "case": entry("case"),
        "generator or lens model": lambda r: f"{r.get('algorithm', r.get('model'))}, {r['dtype']}",
        "changed": lambda r: f"{r['changed']} of {r.get('pixels', r.get('rays'))}",
        "error, panel pixels": lambda r: small(r["worst_pixels"]) if "rays" in r else MISSING,
        "warning": lambda r: r["guards"][0] if r["guards"] else "NO WARNING",
    }
    rows = [r for r in (*generators, *lenses) if r["outcome"] == "ran" and not r["safe"]]
    return table("Violations with their warnings", rows, columns)


# -- the figure ---------------------------------------------------------------------------------


def _draw(generators: Rows, lenses: Rows) -> Any:
    """Plot the largest error over the parameter of six families."""
    figure, axes = new_figure(6, 4.6)
    figure.set_figwidth(26)
    for axis, (family, label) in zip(axes, (_LENS_PANELS | _GENERATOR_PANELS).items(), strict=True):
        is_lens = family in _LENS_PANELS
        rows = [r for r in (lenses if is_lens else generators) if r["family"] == family]
        key = "model" if is_lens else "algorithm"
        for (name, dtype), group in grouped(rows, key, "dtype").items():
            if is_lens or ":" not in name:
                colour = _LENS_COLOURS[name] if is_lens else colour_of(name)
                _line(axis, _worst(group, is_lens), f"{name}, {dtype}", colour, dtype)
        words = "worst landing point, panel pixels" if is_lens else "share of changed pixels"
        style(axis, family.capitalize(), label, words)
        axis.set_xscale("linear" if label.startswith("log2") else "log")
        axis.set_yscale("log")
        if is_lens:
            axis.axhline(LANDING_PIXELS, **LINES["floor"])
        else:
            across(axis, "no pixel", y=_NO_ERROR)
        axis.legend(fontsize=7, frameon=False)
    return figure


def _worst(rows: Iterable[Mapping[str, Any]], is_lens: bool) -> list[tuple[float, float]]:
    """Largest error of each value of the parameter.

    An error of exactly 0 of a landing point means that no light passes or that rounding decides the
    lens.
    """
    worst: dict[float, float] = {}
    for row in rows:
        error = row["worst_pixels"] if is_lens else row["changed"] / row["pixels"]
        if is_number(row["value"]) and row["value"] < INFINITE and (error or not is_lens):
            worst[row["value"]] = max(worst.get(row["value"], _NO_ERROR * (not is_lens)), error)
    return sorted(worst.items())


def _line(
    axis: Any, points: Sequence[tuple[float, float]], label: str, colour: str, dtype: str
) -> None:
    marker, line = ("o", "-") if dtype == "float32" else ("s", "--")
    options = {"color": colour, "linestyle": line, "linewidth": 1.2, "markersize": 3.5}
    axis.plot([x for x, _ in points], [y for _, y in points], marker, label=label, **options)
