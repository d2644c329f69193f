"""Every generator on every case, against its oracle."""

from __future__ import annotations

import hashlib
import math
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from inim import metrics
from inim.accuracy_limits import trust_warnings
from inim.display import Display
from inim.errors import InimError
from inim.generators import HOLE, NO_LENS, colour_of, find_sources, generate, prepare
from inim.generators.raycast.direction_lists import cells_per_pitch, shares_directions
from inim.generators.template import ray_by_ray
from inim.rgbd import RGBD
from inim.stress.averages import compare_colours
from inim.stress.case import Case, Family, Size
from inim.stress.families import all_cases
from inim.stress.free_rays import chosen_pixels, rays_over
from inim.stress.oracle import answer
from inim.stress.rays import Rays
from inim.stress.settled import settle
from inim.stress.solids import solids_of
from inim.stress.ulps import deciding_ulps

__all__ = ["CONTENDERS", "Contender", "run_case", "run_cases"]


@dataclass(frozen=True)
class Contender:
    """A generator in one type.

    Attributes
    ----------
    algorithm : str
        With options, as `inim.generators.prepare` takes it.
    oracle : str
        The definition it is held to.
    dtype : float type
    exact : bool
        Whether it must agree with the definition in every pixel, ties included.
    alone : bool
        Whether it walks each ray by itself, where it would not.
    samples : int
        Rays per panel pixel; where there are several, colours are compared in place of sources.
    """

    algorithm: str
    oracle: str
    dtype: type
    exact: bool = False
    alone: bool = False
    samples: int = 1

    @property
    def is_first_hit(self) -> bool:
        """Whether fractions can settle it."""
        return self.oracle in ("template", "layered")


_ROUNDED = ("gu2020", "wang2024", "wang2024:matching=ray", "li2012")
CONTENDERS = [
    # float64 before float32: the one is what the other is compared with.
    Contender("template", "template", np.float64, exact=True, alone=True),
    # What users get: exits as float32 tables where the picture allows.
    Contender("template", "template", np.float32, exact=True),
    Contender("layered:samples=1", "layered", np.float32, exact=True),
    Contender("template:samples=2", "template", np.float32, exact=True, samples=2),
    Contender("template:samples=4", "template", np.float32, exact=True, samples=4),
    Contender("layered:samples=4", "layered", np.float32, exact=True, samples=4),
    *(Contender(name, name, np.float64) for name in _ROUNDED),
]
# Panel pixels of a case that each oracle is asked for: some take long.
_MOST_PIXELS = {"template": 1000, "layered": 400, "gu2020": 200, "wang2024": 60, "li2012": 120}
# Landings that the oracle of `li2012` computes.
_MOST_LANDINGS = 1_000_000
# Panel pixels above which the EIA is not scored.
_LARGEST_SCORED = 100_000
# Samples of rays that the oracle of `gu2020` looks at.
_MOST_SAMPLES = 300_000
# A case that takes longer than this counts as hanging.
_LONGEST_S = 60.0


def form_of(contender: Contender, display: Display, rgbd: RGBD) -> str:
    """How first hits are gone about: lists, strips, or ray by ray."""
    if not contender.is_first_hit:
        return ""
    if not display.is_separable:
        return "free rays"
    if contender.alone:
        return "ray by ray"
    if not cells_per_pitch(display, rgbd.pixel_mm):
        return "ray by ray"
    if shares_directions(display):
        return "lists"
    return "strips" if contender.oracle == "template" else "ray by ray"


def run_cases(size: Size, listener: Any) -> list[dict[str, Any]]:
    """A row for every contender on every case."""
    rows: list[dict[str, Any]] = []
    family_before = None
    for family, case in all_cases(size):
        if family.name != family_before:
            listener.stage(f"generators: {family.name}")
            family_before = family.name
        rows += run_case(family, case, size.most_pixels)
    return rows


def run_case(family: Family, case: Case, most_pixels: int) -> list[dict[str, Any]]:
    """Make one case and run everything on it."""
    common = {"family": family.name, "case": case.label, "value": case.value}
    try:
        display, rgbd = case.make()
    except InimError as error:
        passed = case.refused is not False
        return [common | _refused("all", "", error) | {"passed": passed}]
    except Exception as error:
        return [common | {"algorithm": "all", "dtype": ""} | _crashed(error)]
    if case.refused:
        missed = {"algorithm": "all", "dtype": "", "outcome": "accepted", "passed": False}
        return [common | missed | {"message": "should have been refused"}]
    pixels = chosen_pixels(display, most_pixels)
    rays = rays_over(display, rgbd, pixels)
    solid = solids_of(rgbd, display)
    doubles: dict[str, np.ndarray] = {}
    rows = []
    for contender in CONTENDERS:
        picture = solid if contender.oracle == "layered" else rgbd
        rows.append(common | _run(contender, case, (display, picture), rays, doubles))
    return rows


def _refused(algorithm: str, dtype: str, error: InimError) -> dict[str, Any]:
    return {
        "algorithm": algorithm,
        "dtype": dtype,
        "outcome": "refused",
        "message": f"{type(error).__name__}: {error}",
    }


def _crashed(error: Exception) -> dict[str, Any]:
    text = " ".join(f"{type(error).__name__}: {error}".split())[:300]
    return {"outcome": "crashed", "message": text, "passed": False}


def _run(
    contender: Contender,
    case: Case,
    made: tuple[Display, RGBD],
    rays: Rays,
    doubles: dict[str, np.ndarray],
) -> dict[str, Any]:
    """One contender's row; float64's sources are kept for float32's to be compared with."""
    display, rgbd = made
    said = {"algorithm": contender.algorithm, "dtype": np.dtype(contender.dtype).name}
    started = time.perf_counter()
    try:
        if contender.samples > 1:
            found = generate(rgbd, display, contender.algorithm)
        elif contender.alone and display.is_separable:
            prepare(display, contender.algorithm, shape=rgbd.shape, pixel_mm=rgbd.pixel_mm)
            found = ray_by_ray(display, rgbd.shape, rgbd.pixel_mm).sources(rgbd)
        else:
            found = find_sources(rgbd, display, contender.algorithm)
        took = time.perf_counter() - started
        row = said | _judged(contender, found, doubles, display, rgbd, rays)
        row["seconds"] = took
    except InimError as error:
        return _refused(said["algorithm"], said["dtype"], error) | {
            "passed": case.refused is not False or not contender.exact
        }
    except Exception as error:
        return said | _crashed(error)
    # Rays of the other arrays are float64: what meets a corner exactly may go either way.
    exact = contender.exact and display.is_separable
    safe = not (row["changed"] if exact else row["outside"])
    guards = trust_warnings(display, pixel_mm=rgbd.pixel_mm)
    return row | {
        "outcome": "ran",
        "message": "",
        "safe": safe,
        "guards": guards,
        "exact": exact,
        "passed": (safe or bool(guards)) and took < _LONGEST_S,
    }


def _judged(
    contender: Contender,
    found: np.ndarray,
    doubles: dict[str, np.ndarray],
    display: Display,
    rgbd: RGBD,
    rays: Rays,
) -> dict[str, Any]:
    """What was found against the oracle, and against float64's."""
    few = _affordable(rays, contender, display, rgbd.depth_mm.size)
    common = {
        "form": form_of(contender, display, rgbd),
        "digest": hashlib.sha256(found.tobytes()).hexdigest()[:16],
    }
    if contender.samples > 1:
        oracle = (contender.oracle, contender.samples)
        return common | compare_colours(oracle, found, few.pixels, rgbd, display)
    if contender.dtype is np.float64:
        doubles[contender.oracle] = found
    double = doubles.get(contender.oracle)
    loss = None if double is None else _loss_of_type(double, found, display, rgbd)
    return common | {"ssim_loss": loss} | _compare(contender, found, display, rgbd, few)


def _compare(
    contender: Contender, found: np.ndarray, display: Display, rgbd: RGBD, rays: Rays
) -> dict[str, Any]:
    """Found sources against the oracle's."""
    shown = found[rays.pixels[:, 0], rays.pixels[:, 1]].astype(np.int64)
    oracle = answer(contender.oracle, rays, rgbd, display, contender.dtype)
    truth, settled = oracle.sources, 0
    if contender.is_first_hit:
        double = contender.dtype is np.float64
        fine = oracle if double else answer(contender.oracle, rays, rgbd, display, np.float64)
        truth, settled = settle(fine, shown, rays, rgbd, display)
    changed = shown != truth
    outside = changed & ~oracle.uncertain
    worst, mean = deciding_ulps(contender.algorithm, contender.dtype, display, rgbd)
    most = rgbd.palette.shape[0] * rgbd.palette.shape[1]
    bad = (found < HOLE) & (found != NO_LENS) | (found >= most)
    return {
        "pixels": len(shown),
        "changed": int(changed.sum()),
        "uncertain": int(oracle.uncertain.sum()),
        "outside": int(outside.sum()) + int(bad.sum()),
        "settled_exactly": settled,
        "worst_ulp": worst,
        "mean_ulp": mean,
    }


def _affordable(rays: Rays, contender: Contender, display: Display, cells: int) -> Rays:
    """All rays, or an even choice of them where the oracle takes long for each."""
    most = _MOST_PIXELS[contender.oracle.partition(":")[0]]
    if contender.oracle == "gu2020" and not math.isinf(display.scene_pixel_mm):
        low, high = display.depth_range_mm
        most = min(most, max(8, int(_MOST_SAMPLES * display.scene_pixel_mm / (high - low))))
    if contender.oracle == "li2012":
        most = min(most, max(6, _MOST_LANDINGS // cells))
    if contender.is_first_hit:
        low, high = display.depth_range_mm
        crossed = float(np.abs([rays.du, rays.dv]).max(initial=0)) * (high - low)
        most = min(most, max(8, int(_MOST_SAMPLES / (crossed + 1)))) // contender.samples
    if len(rays.pixels) <= most:
        return rays
    return rays.chosen(np.unique(np.linspace(0, len(rays.pixels) - 1, most).astype(int)))


def _loss_of_type(double: np.ndarray, single: np.ndarray, display: Display, rgbd: RGBD) -> Any:
    """1 - SSIM of the EIA in float32 against that in float64; None for panels that are no picture.

    Sums of equal pictures round to a little off 1: equal sources lose nothing.
    """
    high, wide = display.eia_shape
    if min(high, wide) < metrics.SSIM_WINDOW or high * wide > _LARGEST_SCORED:
        return None
    if np.array_equal(double, single):
        return 0.0
    return 1 - metrics.ssim(*(colour_of(sources, rgbd) for sources in (double, single)))
