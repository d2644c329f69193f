"""From rows to ranges: between which values of a parameter everything was safe."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from inim.documents.stress import Claim, RelationResult
from inim.inspect.accuracy_limits import LANDING_PIXELS

Rows = Sequence[Mapping[str, Any]]


def regions_of(generators: Rows, lens_models: Rows, parameters: Mapping[str, str]) -> list[dict]:
    """The safe range of each family with a parameter, for each generator or lens model.

    Parameters
    ----------
    generators, lens_models : rows
        See `generators` and `lens_models`.
    parameters : mapping
        Of family names to what their values are; empty where they have no order.

    Returns
    -------
    list of dict
        `low`, `high`: ends of the widest range without an unsafe value between; None: none is
        safe. `tried`: the ends of all values that ran.
    """
    found = _regions(generators, "generator", "algorithm", parameters)
    return found + _regions(lens_models, "lens model", "model", parameters)


def _regions(rows: Rows, kind: str, key: str, parameters: Mapping[str, str]) -> list[dict]:
    groups: dict[tuple[str, str, str], list[Mapping[str, Any]]] = {}
    for row in rows:
        if row["value"] is not None and row["outcome"] == "ran" and parameters.get(row["family"]):
            groups.setdefault((row["family"], row[key], row["dtype"]), []).append(row)
    found = []
    for (family, name, dtype), members in groups.items():
        low, high = _widest_safe(members)
        values = [m["value"] for m in members]
        found.append(
            {
                "kind": kind,
                "family": family,
                "parameter": parameters[family],
                "name": name,
                "dtype": dtype,
                "low": low,
                "high": high,
                "tried": [min(values), max(values)],
            }
        )
    return found


def _safe(row: Mapping[str, Any]) -> bool:
    return bool(row["safe"]) and row.get("worst_pixels", 0.0) <= LANDING_PIXELS


def _widest_safe(rows: Rows) -> tuple[float | None, float | None]:
    """Ends of the longest run of safe values in order."""
    verdict: dict[float, bool] = {}
    for row in rows:
        verdict[row["value"]] = verdict.get(row["value"], True) and _safe(row)
    best: list[float] = []
    now: list[float] = []
    for value in sorted(verdict):
        now = [*now, value] if verdict[value] else []
        best = now if len(now) > len(best) else best
    return (best[0], best[-1]) if best else (None, None)


def accuracy_limits_of(generators: Rows, lens_models: Rows, pixels_per_lens: int) -> dict[str, Any]:
    """What `inim.inspect.accuracy_limits` states as constants, as this run measured it.

    Returns
    -------
    dict
        `slope` by lens model, `panel_pixels`, `least_index`: the last safe values;
        `changed_by_rounding`: the largest share of pixels changed where lengths are too long to be
        exact; `changed_by_ties`: the same of arrays whose rays are float64, with the warning of
        corners and without; `exact`: how many rows of exact paths without a warning, and pixels
        they changed.
    """
    ran = [r for r in generators if r["outcome"] == "ran"]
    exact = [r for r in ran if r["exact"]]
    unguarded = [r for r in exact if not r["guards"]]
    misaligned = [r for r in ran if r["form"] == "mounted"]
    optics = [r for r in lens_models if r["outcome"] == "ran"]
    return {
        "slope": {
            model: _last_safe(optics, "incidence", model, math.inf)
            for model in ("pinhole", "thin", "thick")
        },
        "panel_pixels": pixels_per_lens
        * min(_last_safe(optics, "array width", m, math.inf) for m in ("pinhole", "thin", "thick")),
        # The thick lens cannot be ground so flat, and is refused.
        "least_index": _last_safe(optics, "index", "thin", -math.inf),
        "changed_by_rounding": _most_changed(r for r in exact if not r["safe"]),
        "changed_by_ties": {
            "warned": _most_changed(r for r in misaligned if r["guards"]),
            "unwarned": _most_changed(r for r in misaligned if not r["guards"]),
        },
        "exact": {
            "rows": len(unguarded),
            "pixels": sum(r["pixels"] for r in unguarded),
            "changed": sum(r["changed"] for r in unguarded),
        },
    }


def _most_changed(rows: Iterable[Mapping[str, Any]]) -> float:
    """The largest share of a case's pixels that show another source."""
    return max((r["changed"] / r["pixels"] for r in rows), default=0.0)


def _last_safe(rows: Rows, family: str, model: str, towards: float) -> float:
    """The last value, going up (towards inf) or down, before the first unsafe one."""
    mine = [r for r in rows if r["family"] == family and r["model"] == model]
    verdict: dict[float, bool] = {}
    for row in mine:
        verdict[row["value"]] = verdict.get(row["value"], True) and _safe(row)
    last = math.nan
    for value in sorted(verdict, reverse=towards < 0):
        if not verdict[value]:
            break
        last = value
    return last


def checks_of(generators: Rows, optics: Rows, relations: Sequence[RelationResult]) -> list[Claim]:
    """The claims of the verdict."""
    ran = [r for r in generators if r["outcome"] == "ran"]
    exact = [r for r in ran if r["exact"]]
    alike = _alike_pairs(r for r in exact if r["algorithm"] == "template")
    return [
        _check(
            "exact paths: every pixel as defined, where no warning is given",
            [r["safe"] for r in exact if not r["guards"]],
        ),
        _check("exact path: float32 and float64 alike, where no warning is given", alike),
        _check(
            "generators: changes only where the type's rounding decides, or a warning is given",
            [r["safe"] or r["guards"] for r in ran if not r["exact"]],
        ),
        _check(
            "lens models: landing as defined within rounding, or a warning is given",
            [r["safe"] or r["guards"] for r in optics if r["outcome"] == "ran"],
        ),
        _check(
            f"lens models: within {LANDING_PIXELS:g} panel pixels, or a warning is given",
            [
                r["worst_pixels"] <= LANDING_PIXELS or r["guards"]
                for r in optics
                if r["outcome"] == "ran"
            ],
        ),
        _check(
            "nothing crashes or hangs, and what makes no sense is refused",
            [r["outcome"] in ("ran", "refused") and r["passed"] for r in (*generators, *optics)],
        ),
        _check(
            "relations hold, or their violation is explained",
            [relation.passed for relation in relations],
        ),
    ]


def _check(name: str, holds: Sequence[object]) -> Claim:
    broken = sum(not one for one in holds)
    return Claim(name=name, cases=len(holds), broken=broken, passed=bool(holds) and not broken)


def _alike_pairs(exact: Iterable[Mapping[str, Any]]) -> list[bool]:
    """Of cases in which both types of the exact path ran unwarned: whether they agree."""
    pairs: dict[tuple[str, str], dict[str, str]] = {}
    for row in exact:
        if not row["guards"]:
            pairs.setdefault((row["family"], row["case"]), {})[row["dtype"]] = row["digest"]
    return [p["float32"] == p["float64"] for p in pairs.values() if len(p) == 2]
