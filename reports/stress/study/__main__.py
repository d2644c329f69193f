"""Run the accuracy study and write its report: `python -m reports.stress.study`."""

from __future__ import annotations

import argparse
import shlex
import sys
import time
from pathlib import Path

import numpy as np

from inim.apps.stress.document import JitteredPicture
from inim.apps.stress.page import write_stress
from inim.apps.stress.run import record, spheres
from inim.system.document import decode, encode
from inim.system.errors import EXIT_CHECK_FAILED, EXIT_PASSED
from inim.system.process.observer import Observer
from reports.stress.study.document import StudyDocument
from reports.stress.study.tables import parts_of, summary_lines

_VERSIONS = ("drjit", "hypothesis", "matplotlib", "mitsuba", "numba", "numpy")
_JITTERED = ("template", "gu2020", "wang2024:matching=ray", "li2012")
# Rays per lens-model case and stride of the cases, in a quick run and in a full run.
_LENS_SIZE = {True: (60, 8), False: (100, 1)}
# Lenses along each side of the display for depth jitter.
_JITTER_LENSES = {True: 16, False: 64}


class _Stages(Observer):
    """Print the stages of the study to stderr."""

    def stage(self, name: str) -> None:
        """Print the name of a stage when it begins."""
        print(name, file=sys.stderr, flush=True)


def main(argv: list[str] | None = None) -> int:
    """Run the study; the exit code is 0 if all claims hold."""
    parser = argparse.ArgumentParser(prog="python -m reports.stress.study", description=__doc__)
    parser.add_argument("-o", "--out", type=Path, default=Path("reports/stress"))
    parser.add_argument("--quick", action="store_true", help="fewer and smaller cases")
    args = parser.parse_args(argv)
    # Encoded and decoded as in the file, where infinite values are null.
    document = decode(encode(run_study(args.quick, str(args.out), _Stages())), StudyDocument)
    args.out.mkdir(parents=True, exist_ok=True)
    from reports.stress.study.plots import draw_plots

    draw_plots(document, args.out)
    write_stress(document, args.out, parts_of(document), summary_lines(document))
    for check in document.checks:
        verdict = "ok    " if check.passed else "FAILED"
        print(f"{verdict}  {check.name}: {check.cases} cases, {check.broken} broken")
    return EXIT_PASSED if document.passed else EXIT_CHECK_FAILED


def run_study(quick: bool, out: str, listener: Observer) -> StudyDocument:
    """Run the study; return the content of stress.json."""
    started = time.perf_counter()
    from inim.render import variant

    backend = variant.use("llvm")
    from inim.apps.stress.checks import measure_jitter
    from reports.stress.study.cases import FAMILIES, FULL, QUICK
    from reports.stress.study.generators import run_cases
    from reports.stress.study.lens_cases import LENS_FAMILIES, display_of
    from reports.stress.study.lens_models import run_lens_cases
    from reports.stress.study.lens_relations import run_lens_relations
    from reports.stress.study.limits import accuracy_limits_of, checks_of, regions_of
    from reports.stress.study.relations import run_layer_relations, run_relations

    words = ["python", "-m", "reports.stress.study", "-o", out, *(["--quick"] if quick else [])]
    generators = run_cases(QUICK if quick else FULL, listener)
    lenses = run_lens_cases(*_LENS_SIZE[quick], listener)
    listener.stage("relations")
    relations = [*run_relations(), *run_layer_relations(), *run_lens_relations()]
    listener.stage("jitter")
    picture, display = spheres(_JITTER_LENSES[quick])
    parameters = {f.name: f.parameter for f in FAMILIES}
    lens_parameters = {f.name: f.parameter for f in LENS_FAMILIES}
    checks = checks_of(generators, lenses, relations)
    return StudyDocument(
        title="Stress",
        **record(shlex.join(words), quick, backend, _VERSIONS),
        # The oracle of the lens models is wider than float64 on most computers.
        oracle_mantissa_bits=int(np.finfo(np.longdouble).nmant) + 1,
        generators=generators,
        lens_models=lenses,
        relations=relations,
        jitter=measure_jitter(picture, display, _JITTERED),
        picture=JitteredPicture(
            name="two spheres", rows=picture.shape[0], columns=picture.shape[1]
        ),
        regions=regions_of(generators, [], parameters) + regions_of([], lenses, lens_parameters),
        trust=accuracy_limits_of(generators, lenses, round(display_of().pixels_per_lens)),
        checks=checks,
        passed=all(check.passed for check in checks),
        seconds=time.perf_counter() - started,
        files=[],
    )


if __name__ == "__main__":
    sys.exit(main())
