"""Tests of algorithms against the exact first hits, and against small changes of depth.

If an algorithm shows first hits by definition, every panel pixel must agree, including ties, except
on displays whose lengths have too many digits; `inim.generators.accuracy_limits` warns about these.
For other algorithms `check_first_hits` measures the distance of their definition, or of their
arithmetic, from the correct view.

Jitter, one ulp or one quantum of 8, 10 or 16 bits of depth, is not an arithmetic error: the exact
answer to a slightly different question differs. `measure_jitter` measures the share of an image
that depends on the last digits of its depth.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from msgspec.structs import replace

from inim.apps.stress.document import FirstHitsResult, Jitter
from inim.apps.stress.pictures import (
    DISPLAYS,
    SHAPES,
    PictureCase,
    eia_of,
    input_of,
    is_first_hit,
    noise,
    random_picture,
    shaped_picture,
    small_display,
    tied_picture,
)
from inim.display import Display
from inim.generators import SourceGenerator, parse_algorithm, prepare
from inim.generators.accuracy_limits import accuracy_warnings
from inim.generators.oracle import exact_hits
from inim.image.rgbd import RGBD
from inim.scores import metrics
from inim.system.errors import InimError

# Panel pixels of a case that the oracle checks.
_MOST_PIXELS = 100
# Number of random displays, by the quick mode.
_RANDOM = {False: 8, True: 3}


@dataclass(frozen=True)
class Case:
    """Display and picture of a test, created when it runs; `family` is its kind."""

    family: str
    name: str
    make: Callable[[], PictureCase]


def cases(quick: bool = False) -> Iterator[Case]:
    """Noise, shapes, ties, shifted arrays and random displays.

    Ties are depths at which rays leave picture pixels, or the float32 next to one on either side.
    """
    for number, changes in enumerate(DISPLAYS):
        named = ", ".join(f"{k} = {v}" for k, v in changes.items()) or "real mode"
        yield Case("noise", named, partial(_over, changes, noise, number))
        for ulps in (0,) if quick else (-1, 0, 1):
            yield Case(
                "ties", f"{named}, {ulps:+d} ulp", partial(_over, changes, tied_picture, ulps)
            )
    for kind in SHAPES[:1] if quick else SHAPES:
        yield Case("shapes", kind, partial(_over, {}, shaped_picture, kind))
    for shift in (0.5, 0.1):  # half a pitch, half a pixel
        make = partial(_over, {"shift_x_mm": shift}, noise, 11)
        yield Case("shifted array", f"by {shift:g} mm", make)
    for seed in range(_RANDOM[quick]):
        yield Case("random displays", f"seed {seed}", partial(random_picture, seed))


def _over(changes: dict[str, object], picture: Callable[..., RGBD], *options: Any) -> PictureCase:
    """A changed small display, with a picture of two pixels per pitch over it."""
    display = small_display(**changes)
    return display, picture(display, display.capture_shape(2), 0.5, *options)


def check_first_hits(algorithm: str, case: Case) -> FirstHitsResult:
    """Run an algorithm on a case and compare its sources with the oracle's."""
    display, rgbd = case.make()
    exact = is_first_hit(algorithm)
    picture = input_of(rgbd, display, algorithm)
    hits = FirstHitsResult(
        algorithm=algorithm,
        family=case.family,
        case=case.name,
        exact=exact,
        pixels=0,
        wrong=0,
        message="",
        warnings=accuracy_warnings(display, pixel_mm=rgbd.pixel_mm),
        outcome="ran",
        passed=True,
    )
    started = time.perf_counter()
    try:
        generator = prepare(display, algorithm, shape=rgbd.shape, pixel_mm=rgbd.pixel_mm)
        if not isinstance(generator, SourceGenerator):
            generator.generate(picture)
            return replace(hits, outcome="no sources")
        sources = generator.sources(picture)
    except Exception as error:
        reason = error.__cause__ or error  # an error of another package is the cause of ours
        if isinstance(reason, InimError):
            return replace(hits, outcome="refused", message=str(error), passed=not exact)
        message = " ".join(f"{type(reason).__name__}: {reason}".split())[:300]
        return replace(hits, outcome="crashed", message=message, passed=False)
    seconds = time.perf_counter() - started
    truth = exact_hits(picture, display, parse_algorithm(algorithm).columns, _MOST_PIXELS)
    wrong = round(truth.wrong_share(sources) * len(truth.sources))
    return replace(
        hits,
        pixels=len(truth.sources),
        wrong=wrong,
        seconds=seconds,
        passed=not (exact and wrong) or bool(hits.warnings),
    )


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
