"""Every generator on every case, against its oracle."""

from __future__ import annotations

import hashlib
import math
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from inim import metrics
from inim.display import Display
from inim.errors import InimError
from inim.generators import HOLE, NO_LENS, colour_of, find_sources
from inim.generators.direction_lists import cells_per_pitch, shares_directions
from inim.jobs.stress.cases import Case, Family, Size, all_cases
from inim.jobs.stress.oracle import Rays, answer, exact_template, lensed_pixels, rays_of
from inim.jobs.stress.ulps import deciding_ulps
from inim.rgbd import RGBD
from inim.trust import trust_warnings

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
    masked : bool
        Whether all panel pixels are asked for by a mask, which `template` walks ray by ray.
    """

    algorithm: str
    oracle: str
    dtype: type
    exact: bool = False
    masked: bool = False


_ROUNDED = ("gu2020", "wang2024", "wang2024:matching=ray", "li2012")
CONTENDERS = [
    # float64 before float32: the one is what the other is compared with.
    Contender("template", "template", np.float64, exact=True, masked=True),
    # What users get: exits as float32 tables where the picture allows.
    Contender("template", "template", np.float32, exact=True),
    Contender("template:dtype=float32", "template", np.float32),
    *(Contender(name, name, np.float64) for name in _ROUNDED),
    *(Contender(f"{name}:dtype=float32", name, np.float32) for name in _ROUNDED),
]
# More pixels than this are not settled in fractions: only where rounding would decide.
_MOST_EXACT = 400
# Panel pixels of a case that each oracle is asked for: some take long.
_MOST_PIXELS = {"template": 1000, "gu2020": 200, "wang2024": 60, "li2012": 120}
# Landings that the oracle of `li2012` computes.
_MOST_LANDINGS = 1_000_000
# Panel pixels above which the EIA is not scored.
_LARGEST_SCORED = 100_000
# Samples of rays that the oracle of `gu2020` looks at.
_MOST_SAMPLES = 300_000
# A case that takes longer than this counts as hanging.
_LONGEST_S = 60.0


def form_of(contender: Contender, display: Display, rgbd: RGBD) -> str:
    """How `template` goes about it: lists, strips, or ray by ray."""
    if contender.oracle != "template":
        return ""
    if contender.masked or "dtype" in contender.algorithm:
        return "ray by ray"
    if not cells_per_pitch(display, rgbd.pixel_mm):
        return "ray by ray"
    return "lists" if shares_directions(display) else "strips"


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
    pixels = _chosen(display, most_pixels)
    rays = rays_of(display, rgbd, pixels)
    doubles: dict[str, np.ndarray] = {}
    return [common | _run(c, case, (display, rgbd), rays, doubles) for c in CONTENDERS]


def _chosen(display: Display, most: int) -> np.ndarray:
    """All lensed panel pixels, or a sample of them, the middle and the corners included."""
    pixels = lensed_pixels(display)
    if len(pixels) <= most:
        return pixels
    rng = np.random.default_rng(len(pixels))
    kept = rng.choice(len(pixels), most - 5, replace=False)
    ends = [0, len(pixels) - 1, len(pixels) // 2, len(pixels) // 2 + 1, len(pixels) // 3]
    chosen: np.ndarray = pixels[np.unique(np.concatenate([kept, ends]))]
    return chosen


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
    options = {"mask": np.ones(display.eia_shape, bool)} if contender.masked else {}
    started = time.perf_counter()
    try:
        found = find_sources(rgbd, display, contender.algorithm, **options)
        took = time.perf_counter() - started
        if contender.dtype is np.float64:
            doubles[contender.oracle] = found
        double = doubles.get(contender.oracle)
        row = said | _compare(contender, found, double, display, rgbd, rays)
        row["seconds"] = took
    except InimError as error:
        return _refused(said["algorithm"], said["dtype"], error) | {
            "passed": case.refused is not False or not contender.exact
        }
    except Exception as error:
        return said | _crashed(error)
    safe = not (row["changed"] if contender.exact else row["outside"])
    guards = trust_warnings(display, pixel_mm=rgbd.pixel_mm)
    return row | {
        "outcome": "ran",
        "message": "",
        "safe": safe,
        "guards": guards,
        "passed": (safe or bool(guards)) and took < _LONGEST_S,
    }


def _compare(
    contender: Contender,
    found: np.ndarray,
    double: np.ndarray | None,
    display: Display,
    rgbd: RGBD,
    rays: Rays,
) -> dict[str, Any]:
    """Found sources against the oracle's, and against those in float64."""
    rays = _affordable(rays, contender, display, rgbd.depth_mm.size)
    oracle = answer(contender.oracle, rays, rgbd, display, contender.dtype)
    truth, settled = oracle.sources.copy(), 0
    shown = found[rays.pixels[:, 0], rays.pixels[:, 1]].astype(np.int64)
    if contender.oracle == "template":
        # The float64 oracle rounds too: wherever that may have decided, ask the exact one.
        fine = answer("template", rays, rgbd, display, np.float64).uncertain
        doubt = np.flatnonzero(fine | (shown != truth))
        settled = min(len(doubt), _MOST_EXACT)
        step = max(1, len(doubt) // _MOST_EXACT)
        which = np.unique(np.concatenate([doubt[::step], np.flatnonzero(shown != truth)]))
        truth[which] = exact_template(rays, rgbd, display, which)
    changed = shown != truth
    outside = changed & ~oracle.uncertain
    worst, mean = deciding_ulps(contender.algorithm, contender.dtype, display, rgbd)
    bad = (found < HOLE) & (found != NO_LENS) | (found >= rgbd.depth_mm.size)
    return {
        "form": form_of(contender, display, rgbd),
        "pixels": len(shown),
        "changed": int(changed.sum()),
        "uncertain": int(oracle.uncertain.sum()),
        "outside": int(outside.sum()) + int(bad.sum()),
        "settled_exactly": int(settled),
        "ssim_loss": None if double is None else _loss_of_type(double, found, display, rgbd),
        "worst_ulp": worst,
        "mean_ulp": mean,
        "digest": hashlib.sha256(found.tobytes()).hexdigest()[:16],
    }


def _affordable(rays: Rays, contender: Contender, display: Display, cells: int) -> Rays:
    """All rays, or an even choice of them where the oracle takes long for each."""
    most = _MOST_PIXELS[contender.oracle.partition(":")[0]]
    if contender.oracle == "gu2020" and not math.isinf(display.scene_pixel_mm):
        low, high = display.depth_range_mm
        most = min(most, max(8, int(_MOST_SAMPLES * display.scene_pixel_mm / (high - low))))
    if contender.oracle == "li2012":
        most = min(most, max(6, _MOST_LANDINGS // cells))
    if contender.oracle == "template":
        low, high = display.depth_range_mm
        crossed = float(np.abs([rays.du, rays.dv]).max(initial=0)) * (high - low)
        most = min(most, max(8, int(_MOST_SAMPLES / (crossed + 1))))
    if len(rays.pixels) <= most:
        return rays
    kept = np.unique(np.linspace(0, len(rays.pixels) - 1, most).astype(int))
    one = {name: getattr(rays, name)[kept] for name in ("pixels", "v0", "dv", "u0", "du")}
    return replace(rays, **one)


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
