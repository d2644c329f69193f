"""What small errors of the depth cost: one ulp, one quantum, 8, 10 and 16 bits.

No arithmetic is at fault here: the exact answer to a slightly other question is another answer.
The figures say how much of a picture hangs on the last digits of its depth.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from inim import metrics
from inim.display import Display
from inim.pipeline.plugin_guard import blamed
from inim.rgbd import RGBD
from inim.stress.algorithm import eia_of

__all__ = ["JITTERS", "measure_jitter", "quantised"]

#: Bits of depth that cameras and files come with.
BITS = (8, 10, 16)


def quantised(rgbd: RGBD, display: Display, bits: int, offset: int = 0) -> RGBD:
    """Depths rounded to 2^bits steps over the display's range, then moved by so many steps."""
    low, high = display.depth_range_mm
    steps = 2**bits - 1
    code = np.clip(np.rint((rgbd.depth_mm.astype(float) - low) / (high - low) * steps), 0, steps)
    code = np.clip(code + offset, 0, steps)
    depth = (low + code / steps * (high - low)).astype(np.float32)
    return RGBD(rgbd.color, depth, rgbd.covered, rgbd.pixel_mm)


def _moved(rgbd: RGBD, towards: float) -> RGBD:
    depth = np.nextafter(rgbd.depth_mm, np.float32(towards))
    return RGBD(rgbd.color, depth, rgbd.covered, rgbd.pixel_mm)


def _scattered(rgbd: RGBD) -> RGBD:
    """Each pixel an ulp up or down, or left alone, by chance."""
    by = np.random.default_rng(0).integers(-1, 2, rgbd.shape)
    depth = rgbd.depth_mm
    up, down = (np.nextafter(depth, np.float32(s)) for s in (np.inf, -np.inf))
    moved = np.where(by > 0, up, np.where(by < 0, down, depth))
    return RGBD(rgbd.color, moved, rgbd.covered, rgbd.pixel_mm)


def _jitters(rgbd: RGBD, display: Display) -> dict[str, tuple[RGBD, RGBD]]:
    """For each kind, the picture before and after."""
    found = {
        "+1 ulp": (rgbd, _moved(rgbd, np.inf)),
        "-1 ulp": (rgbd, _moved(rgbd, -np.inf)),
        "an ulp by chance": (rgbd, _scattered(rgbd)),
    }
    for bits in BITS:
        base = quantised(rgbd, display, bits)
        found[f"{bits} bits"] = (rgbd, base)
        for sign in (1, -1):
            moved = quantised(rgbd, display, bits, sign)
            found[f"{sign:+d} quantum of {bits} bits"] = (base, moved)
    return found


#: Kinds of jitter, in the order of the table.
JITTERS = (
    "+1 ulp",
    "-1 ulp",
    "an ulp by chance",
    *(f"{b} bits" for b in BITS),
    *(f"{sign:+d} quantum of {b} bits" for b in BITS for sign in (1, -1)),
)


def measure_jitter(rgbd: RGBD, display: Display, algorithms: Sequence[str]) -> list[dict[str, Any]]:
    """A row for each kind and algorithm: share of changed panel pixels, and 1 - SSIM of the EIA.

    Parameters
    ----------
    rgbd : RGBD
        Linear float colours.
    display : Display
    algorithms : sequence of str
        Those that read layers are given the picture's front alone.
    """
    jitters = _jitters(rgbd, display)
    rows = []
    for algorithm in algorithms:
        # Pictures that several kinds of jitter start from are shown once.
        seen: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        for kind in JITTERS:
            for picture in jitters[kind]:
                if id(picture) not in seen:
                    with blamed(algorithm, "generate"):
                        seen[id(picture)] = eia_of(picture, display, algorithm)
            (a, eia), (b, moved) = (seen[id(picture)] for picture in jitters[kind])
            changed = float((a != b).any(axis=-1)[display.lensed].mean())
            lost = 1 - metrics.ssim(eia, moved) if changed else 0.0
            rows.append(
                {
                    "jitter": kind,
                    "algorithm": algorithm,
                    "changed": changed,
                    "ssim_loss": lost,
                }
            )
    return rows
