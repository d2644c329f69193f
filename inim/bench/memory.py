"""A process that does nothing but generate once, and says how much memory that took.

``python -m inim.bench.memory LENSES`` prints one JSON object; see `inim.bench.scaling`.
"""

from __future__ import annotations

import json
import re
import resource
import sys
from pathlib import Path
from typing import Any

__all__ = ["measure", "peak_bytes", "resident_bytes"]


def peak_bytes() -> int:
    """Largest resident size of this process so far.

    The system's own ru_maxrss starts at that of the parent, from before this program was loaded;
    Linux's VmHWM does not.
    """
    try:
        found = re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text("ascii"))
    except OSError:
        found = None
    if found:
        return 1024 * int(found[1])
    return resident_bytes(resource.getrusage(resource.RUSAGE_SELF))


def resident_bytes(usage: resource.struct_rusage) -> int:
    """The largest resident size that the system's account of a process names."""
    return (1 if sys.platform == "darwin" else 1024) * usage.ru_maxrss


def measure(lenses: int, pixels_per_pitch: int = 2) -> dict[str, Any]:
    """Generate once on a display of `lenses` by `lenses`; peaks before and after, bytes.

    The first peak is that of the imports. All that follows counts: compiling or loading the
    kernels, the picture, the tables prepared for the display, and the EIA itself.
    """
    import numpy as np

    from inim.bench.scaling import picture_of, square_display
    from inim.generators.raycast import polyphase  # noqa: F401
    from inim.pipeline.timing import prepare_method

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
