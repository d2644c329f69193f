"""A whole validation of an 8K panel, in bounded memory.

Expected behaviour: 480 x 270 lenses of 16 x 16 pixels, 7680 x 4320 in all, are captured, traced,
generated, looked at, scored and written by a process that stays under 4 GiB. The system's own
account of the processes that ended says how much it was. Quality is not what this is about: few
samples are enough, for pictures take what they take whatever the samples. The backend is LLVM: on
one machine, CUDA, with its driver, took 0.8 GiB more of the processor's memory.
"""

import os
import sys
from pathlib import Path

import pytest

from inim.image.files.image import read_exr
from inim.system.errors import EXIT_PASSED
from reports.bench.process import run_measured
from tests.schemas import read_document
from tests.system.conftest import TINY, definitions

SCENE = Path(__file__).parents[2] / "scenes" / "jade.xml"
LENSES = {"inim.lens_columns": "480", "inim.lens_rows": "270", "inim.pixel_pitch_mm": "0.0625"}
SHAPE = (4320, 7680)
MOST_GIB = 4.0


@pytest.mark.slow
def test_an_8k_panel_is_validated_under_4_gib(tmp_path, capsys):
    out = tmp_path / "out"
    words = [sys.executable, "-m", "inim.validate", str(SCENE), "-o", str(out), "--quiet"]
    words += ["--backend", "llvm", "--algorithms", "template", "--viewpoints", "centre"]
    words += definitions(TINY | LENSES)
    # Nothing is found again: that would take no memory.
    ended = run_measured(words, {**os.environ, "INIM_CACHE": "off"})
    peak_gib = ended["peak_bytes"] / 2**30
    with capsys.disabled():
        print(f"\n8K: {peak_gib:.2f} GiB at most, {ended['seconds']:.0f} s", file=sys.stderr)
    assert ended["code"] == EXIT_PASSED, ended["message"]
    report = read_document(out / "report.json")
    derived = report["display"]["derived"]
    assert (derived["eia_rows"], derived["eia_columns"]) == SHAPE
    assert read_exr(out / "eia" / "template.exr").shape[:2] == SHAPE
    assert peak_gib < MOST_GIB
