"""`inim.score_error` keeps its word: scores lie within it of those with many times the samples."""

from pathlib import Path
from typing import Any

import msgspec
import pytest

from inim.pipeline.launch import validate

pytestmark = pytest.mark.slow

SCENES = Path(__file__).parents[2] / "scenes"
SMALL = {"inim.lens_columns": 24, "inim.lens_rows": 24, "inim.viewpoints": "left,centre,up"}
MANY = {f"inim.{kind}_spp": 512 for kind in ("capture", "eia", "reconstruction")}
MANY["inim.view_spp"] = 2048


def ssim_scores(data: dict[str, Any]) -> dict[str, float]:
    scores = {
        f"reference/{view}": score["ssim"] for view, score in data["reference"]["views"].items()
    }
    for name, result in data["algorithms"].items():
        for view, score in result["views"].items():
            scores[f"{name}/{view}"] = score["ssim"]
            scores[f"{name}/{view} to reference"] = score["ssim_to_reference"]
    return scores


@pytest.mark.parametrize("scene", ["amphora", "wine_coin", "tripod", "jade", "ibex", "altar"])
def test_scores_are_as_accurate_as_stated(scene, tmp_path, monkeypatch):
    monkeypatch.setenv("INIM_CACHE", str(tmp_path / "cache"))

    def run(**settings: Any) -> dict[str, Any]:
        file = SCENES / f"{scene}.xml"
        options = {f"inim.{k}": v for k, v in settings.items()}
        report = validate(file, tmp_path / "out", definitions=SMALL | options)
        return msgspec.to_builtins(report.data)

    counts = {name.removeprefix("inim."): count for name, count in MANY.items()}
    best = ssim_scores(run(**counts))
    for error_bound in (0.2, 0.1, 0.05):
        data = run(score_error=error_bound)
        scores = ssim_scores(data)
        assert scores.keys() == best.keys()
        off = max(abs(scores[name] - best[name]) for name in best)
        (row,) = [row for row in data["skipped"] if row["step"] == "samples"]
        print(f"{scene}: {error_bound} asked for, {off:.3f} off; {row['performed']}; {row['why']}")
        assert off <= error_bound
    assert data["settings"]["eia_spp"] >= 32
