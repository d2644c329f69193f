"""How translucent a relic of splats is: where along the depth camera's rays its light is lost."""

from __future__ import annotations

from typing import Any

import numpy as np

from inim.pipeline.stages.capture import DepthCamera
from inim.pipeline.stages.stage import RENDERING, stage

# What takes less than this of the light counts as nothing: it changes no 8-bit picture by much.
_LEAST_COVERAGE = 0.01
_BINS = 10


@stage("translucency of the splats", code=RENDERING, timed="translucency")
def translucency(camera: DepthCamera) -> dict[str, Any]:
    """What a depth map of the splats cannot hold, as `scene.splats` in report.json."""
    from inim.render.ground_truth import capture_absorption

    fitted = camera.scene.fitted
    lost, mm_per_unit = capture_absorption(
        fitted, camera.scene.display, pixels_per_pitch=camera.pixels_per_pitch
    )
    coverage = 1 - lost.left.astype(np.float64)
    touched = coverage >= _LEAST_COVERAGE
    pixels = max(1, int(np.count_nonzero(touched)))

    def share(where: np.ndarray) -> float:
        return int(np.count_nonzero(where & touched)) / pixels

    counts = np.histogram(coverage[touched], _BINS, (0, 1))[0]
    dense = touched & np.isfinite(lost.most)
    spread = np.abs(lost.most[dense] - lost.tenth[dense]).astype(np.float64) * mm_per_unit
    return {
        "count": fitted.splats,
        "touched_fraction": float(touched.mean()),
        "mean_coverage": float(coverage[touched].mean()) if touched.any() else None,
        "coverage_histogram": (counts / pixels).tolist(),
        "without_depth_fraction": share(~np.isfinite(lost.half)),
        "never_opaque_fraction": share(~np.isfinite(lost.most)),
        "depth_spread_mm": float(np.median(spread)) if dense.any() else None,
        "depth_spread_p95_mm": float(np.quantile(spread, 0.95)) if dense.any() else None,
        "counted_twice_fraction": share(lost.twice),
    }
