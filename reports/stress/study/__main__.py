"""Run the accuracy study: `python -m reports.stress.study`."""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict
from typing import Any

from msgspec import to_builtins

from inim.apps.stress.run import spheres
from reports.stress.study import generators, lens_models
from reports.stress.study.cases import FAMILIES, FULL, QUICK
from reports.stress.study.lens_cases import LENS_FAMILIES
from reports.stress.study.page import GENERATORS, LENSES, checks, page
from reports.study import Study

_JITTERED = ("template", "gu2020", "wang2024:matching=ray", "li2012")


def measure(part: str, family: str = "", **size: int) -> Any:
    """Measure a family of generators or lens models, the relations, or small depth errors."""
    if part == GENERATORS:
        return generators.run_family(next(f for f in FAMILIES if f.name == family), **size)
    if part == LENSES:
        return lens_models.run_family(next(f for f in LENS_FAMILIES if f.name == family), **size)
    if part == "relations":
        from reports.stress.study.lens_relations import run_lens_relations
        from reports.stress.study.relations import run_relations

        return to_builtins([*run_relations(), *run_lens_relations()])
    from inim.apps.stress.checks import measure_jitter

    return to_builtins(measure_jitter(*spheres(size["lenses"]), _JITTERED))


def cases(args: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """All families, then relations and jitter."""
    size = asdict(QUICK if args.quick else FULL)
    rays = {"count": 60, "stride": 8} if args.quick else {"count": 100, "stride": 1}
    jitter = {"part": "jitter", "lenses": 16 if args.quick else 64}
    return {
        **{GENERATORS + f.name: {"part": GENERATORS, "family": f.name, **size} for f in FAMILIES},
        **{LENSES + f.name: {"part": LENSES, "family": f.name, **rays} for f in LENS_FAMILIES},
        "relations": {"part": "relations"},
        "jitter": jitter,
    }


STUDY = Study(
    "reports.stress.study", "Accuracy of generators and lens models", __doc__,
    lambda parser: parser.add_argument("--quick", action="store_true", help="fewer cases"),
    cases, measure, page, code=("apps/stress", "display", "generators", "image", "scores"),
    passed=lambda results: all(check["passed"] for check in checks(results)),
)  # fmt: skip

if __name__ == "__main__":
    sys.exit(STUDY.main())
