"""Jitter: what an algorithm's EIA changes if its depth changes a little.

One ulp, or one quantum of 8, 10 or 16 bits of depth, is not an arithmetic error: the exact answer
to a slightly different question differs. `measure_jitter` measures the share of an image that
depends on the last digits of its depth.
"""

from collections.abc import Sequence

import numpy as np

from inim.apps.stress.document import Jitter
from inim.apps.stress.pictures import eia_of
from inim.display import Display
from inim.image.rgbd import RGBD
from inim.scores import metrics

#: Usual bit depths of depth maps.
BITS = (8, 10, 16)


def quantise_depth(rgbd: RGBD, display: Display, bits: int, offset: int = 0) -> RGBD:
    """Round depths to 2^bits steps over the display's range, then move them by `offset` steps."""
    low, high = display.depth_range_mm
    steps = 2**bits - 1
    code = np.clip(np.rint((rgbd.depth_mm.astype(float) - low) / (high - low) * steps), 0, steps)
    code = np.clip(code + offset, 0, steps)
    depth = (low + code / steps * (high - low)).astype(np.float32)
    return RGBD(rgbd.color, depth, rgbd.covered, rgbd.pixel_mm)


def _jitters(rgbd: RGBD, display: Display) -> dict[str, tuple[RGBD, RGBD]]:
    """Pictures before and after each kind of jitter, in the table's order."""
    up, down = (np.nextafter(rgbd.depth_mm, np.float32(end)) for end in (np.inf, -np.inf))
    sign = np.random.default_rng(0).integers(-1, 2, rgbd.shape)
    random = np.where(sign > 0, up, np.where(sign < 0, down, rgbd.depth_mm))
    ulps = [RGBD(rgbd.color, z, rgbd.covered, rgbd.pixel_mm) for z in (up, down, random)]
    rounded = [quantise_depth(rgbd, display, bits) for bits in BITS]
    names = ("+1 ulp", "-1 ulp", "an ulp by chance", *(f"{bits} bits" for bits in BITS))
    pairs = {name: (rgbd, p) for name, p in zip(names, (*ulps, *rounded), strict=True)}
    for bits, base in zip(BITS, rounded, strict=True):
        for step in (1, -1):
            moved = quantise_depth(rgbd, display, bits, step)
            pairs[f"{step:+d} quantum of {bits} bits"] = base, moved
    return pairs


def measure_jitter(rgbd: RGBD, display: Display, algorithms: Sequence[str]) -> list[Jitter]:
    """Measure the share of changed panel pixels and 1 - SSIM of the EIA, by kind and algorithm.

    The picture has linear float colours. Algorithms that read layers get its front surface only.
    """
    jitters = _jitters(rgbd, display)
    rows = []
    for algorithm in algorithms:
        # Several kinds of jitter share a picture.
        images_by_picture: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        for kind, pair in jitters.items():
            for picture in pair:
                if id(picture) not in images_by_picture:
                    images_by_picture[id(picture)] = eia_of(picture, display, algorithm)
            (a, eia), (b, moved) = (images_by_picture[id(picture)] for picture in pair)
            changed = float((a != b).any(axis=-1)[display.lensed].mean())
            lost = 1 - metrics.ssim(eia, moved) if changed else 0.0
            rows.append(Jitter(jitter=kind, algorithm=algorithm, changed=changed, ssim_loss=lost))
    return rows
