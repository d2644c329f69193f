"""Algorithms against the exact first hits: how many panel pixels show another pixel of a picture.

For an algorithm that shows first hits by definition every one must agree, ties included, but on
displays whose lengths have too many digits (`inim.accuracy_limits` warns of them). Of others it
says how far their definition, or its arithmetic, is from what a viewer would see.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

from inim.accuracy_limits import accuracy_warnings
from inim.errors import InimError
from inim.generators import SourceGenerator, prepare
from inim.generators.oracle import exact_hits
from inim.stress.algorithm import input_of, is_first_hit
from inim.stress.pictures import (
    DISPLAYS,
    SHAPES,
    Made,
    noise,
    random_picture,
    shaped,
    small_display,
    tied,
)

__all__ = ["Case", "cases", "check_first_hits"]

# Panel pixels of a case that are followed in fractions.
_MOST_PIXELS = 100
# Random displays: of a full run, of a quick one.
_RANDOM = {False: 8, True: 3}


@dataclass(frozen=True)
class Case:
    """A display and a picture, made when it is run; `family` is what it is one of."""

    family: str
    name: str
    make: Callable[[], Made]


def cases(quick: bool = False) -> Iterator[Case]:
    """Noise, shapes, ties, shifted arrays and random displays.

    Ties are depths at which rays leave picture pixels, or the float32 next to one on either side.
    """
    for number, changes in enumerate(DISPLAYS):
        named = ", ".join(f"{k} = {v}" for k, v in changes.items()) or "real mode"
        yield Case("noise", named, partial(_noisy, changes, number))
        for ulps in (0,) if quick else (-1, 0, 1):
            yield Case("ties", f"{named}, {ulps:+d} ulp", partial(_tied, changes, ulps))
    for kind in SHAPES[:1] if quick else SHAPES:
        yield Case("shapes", kind, partial(_shaped, kind))
    for shift in (0.5, 0.1):  # half a pitch, half a pixel
        yield Case("shifted array", f"by {shift:g} mm", partial(_noisy, {"shift_x_mm": shift}, 11))
    for seed in range(_RANDOM[quick]):
        yield Case("random displays", f"seed {seed}", partial(random_picture, seed))


def _noisy(changes: dict[str, object], seed: int) -> Made:
    display = small_display(**changes)
    return display, noise(display, display.capture_shape(2), 0.5, seed)


def _tied(changes: dict[str, object], ulps: int) -> Made:
    display = small_display(**changes)
    return display, tied(display, display.capture_shape(2), 0.5, ulps)


def _shaped(kind: str) -> Made:
    display = small_display()
    return display, shaped(kind, display, display.capture_shape(2), 0.5)


def check_first_hits(algorithm: str, case: Case) -> dict[str, Any]:
    """Run an algorithm on a case and compare its sources with the oracle's.

    Returns
    -------
    dict
        `algorithm`, `family`, `case`; `outcome`: "ran", "refused", "crashed", or "no sources" of an
        algorithm that does not say where its colours come from; `pixels` compared, `wrong` ones;
        `exact`: whether none may be wrong; `warnings` that a validation of the display would give;
        `message` of an error; `seconds`; `passed`.
    """
    display, rgbd = case.make()
    exact = is_first_hit(algorithm)
    picture = input_of(rgbd, display, algorithm)
    row = {"algorithm": algorithm, "family": case.family, "case": case.name, "exact": exact}
    warnings = accuracy_warnings(display, pixel_mm=rgbd.pixel_mm)
    row |= {"pixels": 0, "wrong": 0, "warnings": warnings, "message": ""}
    started = time.perf_counter()
    try:
        made = prepare(display, algorithm, shape=rgbd.shape, pixel_mm=rgbd.pixel_mm)
        if not isinstance(made, SourceGenerator):
            made.generate(picture)
            return row | {"outcome": "no sources", "passed": True}
        sources = made.sources(picture)
    except InimError as error:
        return row | {"outcome": "refused", "message": str(error), "passed": not exact}
    except Exception as error:
        said = " ".join(f"{type(error).__name__}: {error}".split())[:300]
        return row | {"outcome": "crashed", "message": said, "passed": False}
    seconds = time.perf_counter() - started
    hits = exact_hits(picture, display, _MOST_PIXELS)
    wrong = round(hits.wrong_share(sources) * len(hits.sources))
    return row | {
        "outcome": "ran",
        "pixels": len(hits.sources),
        "wrong": wrong,
        "seconds": seconds,
        "passed": not (exact and wrong) or bool(warnings),
    }
