"""`inim.score_error` holds: mean scores lie within it of those with many times the samples.

Each interval covers its score with 95 %, and the errors of several viewpoints average out, so the
mean over the viewpoints is closer than the mean half width, the target.
"""

from __future__ import annotations

from pathlib import Path
from statistics import fmean
from typing import Any

import msgspec
import pytest

from inim.pipeline.launch import validate

pytestmark = pytest.mark.slow

SCENES = Path(__file__).parents[2] / "scenes"
SMALL = {"inim.lens_columns": 32, "inim.lens_rows": 32, "inim.viewpoints": "left,centre,up"}
MANY = {"inim.capture_spp": 256, "inim.eia_spp": 256, "inim.view_spp": 256}
HEADLINE = "ssim_on_relic_to_reference"


def headlines(data: dict[str, Any]) -> dict[str, float]:
    return {
        name: fmean(scores[HEADLINE] for scores in result["views"].values())
        for name, result in data["algorithms"].items()
    }


@pytest.mark.parametrize("scene", ["amphora", "tripod", "jade"])
def test_scores_are_as_accurate_as_requested(scene, tmp_path, monkeypatch):
    monkeypatch.setenv("INIM_CACHE", str(tmp_path / "cache"))

    def run(**settings: Any) -> dict[str, Any]:
        options = {f"inim.{k}": v for k, v in settings.items()}
        report = validate(SCENES / f"{scene}.xml", tmp_path / "out", definitions=SMALL | options)
        return msgspec.to_builtins(report.data)

    best = headlines(run(**{name.removeprefix("inim."): count for name, count in MANY.items()}))
    used = []
    for error in (0.04, 0.01):
        data = run(score_error=error)
        scores = headlines(data)
        used.append(data["settings"]["eia_spp"])
        widths = {
            name: fmean(
                (p[HEADLINE]["interval"][1] - p[HEADLINE]["interval"][0]) / 2
                for p in result["precision"].values()
            )
            for name, result in data["algorithms"].items()
        }
        off = {name: abs(scores[name] - best[name]) for name in best}
        print(f"{scene}: {error} requested, {used[-1]} samples; off {off}, half widths {widths}")
        assert max(widths.values()) <= error or used[-1] == 128
        assert max(off.values()) <= error
    assert used[0] <= used[1]
