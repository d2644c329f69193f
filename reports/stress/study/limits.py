"""Safe ranges of parameters and verdicts, from the results of all cases."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from inim.apps.stress.document import RelationResult
from inim.generators.accuracy_limits import LANDING_PIXELS

Rows = Sequence[Mapping[str, Any]]


def regions_of(generators: Rows, lens_models: Rows, parameters: Mapping[str, str]) -> list[dict]:
    """Safe range of each family with a parameter, for each generator or lens model and type.

    `parameters` has the parameter of each family; empty if its values have no order. `low`, `high`:
    ends of the widest range without an unsafe value; None if no value is safe. `tried`: ends of all
    tested values.
    """
    groups: dict[tuple[str, str, str], list[Mapping[str, Any]]] = {}
    for row in (*generators, *lens_models):
        if row["value"] is not None and row["outcome"] == "ran" and parameters.get(row["family"]):
            name = row["model"] if "model" in row else row["algorithm"]
            groups.setdefault((row["family"], name, row["dtype"]), []).append(row)
    regions = []
    for (family, name, dtype), members in groups.items():
        low, high = _widest_safe(members)
        tried = [end(m["value"] for m in members) for end in (min, max)]
        common = {"family": family, "name": name, "dtype": dtype}
        regions.append({**common, "low": low, "high": high, "tried": tried})
    return regions


def _is_safe(row: Mapping[str, Any]) -> bool:
    return bool(row["safe"]) and row.get("worst_pixels", 0.0) <= LANDING_PIXELS


def _safe_values(rows: Rows) -> dict[float, bool]:
    """True for each value that is safe in all rows."""
    is_safe: dict[float, bool] = {}
    for row in rows:
        is_safe[row["value"]] = is_safe.get(row["value"], True) and _is_safe(row)
    return is_safe


def _widest_safe(rows: Rows) -> tuple[float | None, float | None]:
    """Ends of the longest series of adjacent safe values."""
    is_safe = _safe_values(rows)
    best: list[float] = []
    current: list[float] = []
    for value in sorted(is_safe):
        current = [*current, value] if is_safe[value] else []
        best = current if len(current) > len(best) else best
    return (best[0], best[-1]) if best else (None, None)


def accuracy_limits_of(generators: Rows, lens_models: Rows, pixels_per_lens: int) -> dict[str, Any]:
    """Measured values for the constants of `inim.generators.accuracy_limits`.

    Returns
    -------
    dict
        `slope` by lens model, `panel_pixels`, `least_index`: last safe values.
        `changed_by_rounding`: largest share of pixels changed by lengths with too many digits.
        `changed_by_ties`: the same for displays with float64 rays, with and without the warning
        about corners. `exact`: rows, pixels and changed pixels of exact paths without a warning.
    """
    ran = [r for r in generators if r["outcome"] == "ran"]
    exact = [r for r in ran if r["exact"]]
    unguarded = [r for r in exact if not r["guards"]]
    nonseparable = [r for r in ran if r["form"] == "non-separable"]
    optics = [r for r in lens_models if r["outcome"] == "ran"]
    return {
        "slope": {
            model: _last_safe(optics, "incidence", model, math.inf)
            for model in ("pinhole", "thin", "thick")
        },
        "panel_pixels": pixels_per_lens
        * min(_last_safe(optics, "array width", m, math.inf) for m in ("pinhole", "thin", "thick")),
        # The thick lens is refused: its face cannot be that flat.
        "least_index": _last_safe(optics, "index", "thin", -math.inf),
        "changed_by_rounding": _most_changed(r for r in exact if not r["safe"]),
        "changed_by_ties": {
            "warned": _most_changed(r for r in nonseparable if r["guards"]),
            "unwarned": _most_changed(r for r in nonseparable if not r["guards"]),
        },
        "exact": {
            "rows": len(unguarded),
            "pixels": sum(r["pixels"] for r in unguarded),
            "changed": sum(r["changed"] for r in unguarded),
        },
    }


def _most_changed(rows: Iterable[Mapping[str, Any]]) -> float:
    """Largest share of a case's pixels with another source."""
    return max((r["changed"] / r["pixels"] for r in rows), default=0.0)


def _last_safe(rows: Rows, family: str, model: str, towards: float) -> float:
    """Last value before the first unsafe one, in increasing (towards inf) or decreasing order."""
    is_safe = _safe_values([r for r in rows if r["family"] == family and r["model"] == model])
    last = math.nan
    for value in sorted(is_safe, reverse=towards < 0):
        if not is_safe[value]:
            break
        last = value
    return last


def checks_of(
    generators: Rows, optics: Rows, relations: Sequence[RelationResult]
) -> list[dict[str, Any]]:
    """Check the claims of the verdict."""
    ran = [r for r in generators if r["outcome"] == "ran"]
    exact = [r for r in ran if r["exact"]]
    equal_types = _equal_pairs(r for r in exact if r["algorithm"] == "template")
    return [
        _check(
            "exact paths: every pixel agrees with the definition unless there is a warning",
            [r["safe"] for r in exact if not r["guards"]],
        ),
        _check("exact path: float32 and float64 are equal unless there is a warning", equal_types),
        _check(
            "generators: only pixels decided by rounding change unless there is a warning",
            [r["safe"] or r["guards"] for r in ran if not r["exact"]],
        ),
        _check(
            "lens models: landing points agree within rounding unless there is a warning",
            [r["safe"] or r["guards"] for r in optics if r["outcome"] == "ran"],
        ),
        _check(
            f"lens models: errors up to {LANDING_PIXELS:g} panel pixels unless there is a warning",
            [
                r["worst_pixels"] <= LANDING_PIXELS or r["guards"]
                for r in optics
                if r["outcome"] == "ran"
            ],
        ),
        _check(
            "no case crashes or exceeds the time limit, and invalid cases are refused",
            [r["outcome"] in ("ran", "refused") and r["passed"] for r in (*generators, *optics)],
        ),
        _check(
            "relations hold, or their violation has an explanation",
            [relation.passed for relation in relations],
        ),
    ]


def _check(name: str, holds: Sequence[object]) -> dict[str, Any]:
    broken = sum(not claim_holds for claim_holds in holds)
    passed = bool(holds) and not broken
    return {"name": name, "cases": len(holds), "broken": broken, "passed": passed}


def _equal_pairs(exact: Iterable[Mapping[str, Any]]) -> list[bool]:
    """Agreement of float32 and float64 in each case that ran in both without a warning."""
    pairs: dict[tuple[str, str], dict[str, str]] = {}
    for row in exact:
        if not row["guards"]:
            pairs.setdefault((row["family"], row["case"]), {})[row["dtype"]] = row["digest"]
    return [p["float32"] == p["float64"] for p in pairs.values() if len(p) == 2]
