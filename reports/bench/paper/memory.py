"""Peak memory of a process that generates one EIA.

``python -m reports.bench.paper.memory LENSES`` prints one JSON object for `scaling`.
"""

from __future__ import annotations

import json
import sys
from typing import Any

from reports.bench.process import peak_bytes


def measure(lenses: int, pixels_per_pitch: int = 2) -> dict[str, Any]:
    """Peak memory before and after the generation for a display of `lenses` by `lenses` [bytes].

    The first peak is that of the imports. Everything after it counts: the compilation or loading of
    the kernels, the picture, the prepared tables and the EIA.
    """
    import numpy as np

    from inim.generators.raycast import strips  # noqa: F401
    from inim.pipeline.timing import prepare_method
    from reports.bench.study import picture_of, square_display

    imported = peak_bytes()
    display = square_display(lenses)
    rgbd = picture_of(display, pixels_per_pitch)
    pictured = peak_bytes()
    method = prepare_method("template", rgbd, display)
    method.run()
    return {
        "lenses": lenses,
        "display_pixels": int(np.prod(display.eia_shape)),
        "scene_pixels": int(np.prod(rgbd.shape)),
        "imported_bytes": imported,
        "pictured_bytes": pictured,
        "peak_bytes": peak_bytes(),
        "above_import_bytes": peak_bytes() - imported,
        "eia_bytes": method.out.nbytes,
    }


if __name__ == "__main__":
    print(json.dumps(measure(int(sys.argv[1]))))
