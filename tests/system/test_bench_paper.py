"""The study of the paper's experiments at small sizes, on the two spheres."""

from __future__ import annotations

import pytest

from inim.apps.bench.page import write_bench
from inim.pipeline.timing import Rounds
from inim.system.process.observer import Observer
from reports.bench.paper.experiments import Sizes, bench_paper
from reports.bench.paper.report import parts_of
from reports.bench.paper.scaling import bench_scaling
from tests.unit.test_bench_report import bench


@pytest.mark.slow
def test_scaling_and_paper_at_small_sizes(tmp_path, renderer):
    rounds, listener = Rounds(runs=2, warmups=1), Observer()
    scaling = bench_scaling(rounds, listener, (1, 4), (1, 3), 2)
    sizes = Sizes(2, (1, 2), (3, 5), (1, 2), 3, 2)
    paper = bench_paper(rounds, listener, sizes)
    assert [p["display_pixels"] for p in scaling["display"]] == [17**2, 68**2]
    assert len({p["display_pixels"] for p in scaling["scene"]}) == 1
    memory = scaling["memory"]
    assert memory["imported_bytes"] + memory["eia_bytes"] < memory["peak_bytes"]
    assert [p["lenses"] for p in paper["experiments"][2]["points"]] == [1, 4]
    assert [p["elemental_pixels"] for p in paper["experiments"][1]["points"]] == [9, 25]
    forms = {c["name"]: c for c in paper["same_input"]["algorithms"]}
    for name in ("li2012", "gu2020", "wang2024"):
        # Compiled or not, it is the same algorithm.
        python, compiled = forms[f"{name} in plain Python"], forms[name]
        same = ("wrong_source", "eia_psnr_db", "middle_view_ssim")
        assert [python[k] for k in same] == [compiled[k] for k in same]
    document = bench(scaling=scaling, paper=paper)
    write_bench(document, tmp_path, lambda document: parts_of(document.study))
    assert {p.stem for p in tmp_path.glob("*.svg")} == {"scaling", "paper"}
