"""Every generator on every case, against its oracle: sources, or mean colours of several rays."""

from __future__ import annotations

import hashlib
import math
import time
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from inim import metrics
from inim.display import Display
from inim.display.pixels import exact_length
from inim.errors import InimError
from inim.generators import HOLE, NO_LENS, colour_of, find_sources, generate, prepare
from inim.generators.oracle import PixelOffset
from inim.generators.raycast.polyphase import cells_per_pitch, shares_directions
from inim.generators.template import ray_by_ray
from inim.image.rgbd import RGBD
from inim.inspect.accuracy_limits import accuracy_warnings
from inim.stress.pictures import solids_of
from reports.stress.study.cases import FAMILIES, Case, Family, Size, cases_of
from reports.stress.study.oracles import answer, with_rational_ties
from reports.stress.study.rays import Rays, chosen_pixels, rays_over
from reports.stress.study.ulps import deciding_ulps


@dataclass(frozen=True)
class Variant:
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
        """Whether fractions can decide it."""
        return self.oracle in ("template", _SOLID, "layered")


_SOLID = "template:columns=solid"
_ROUNDED = ("gu2020", "wang2024", "wang2024:matching=ray", "li2012")
VARIANTS = [
    # float64 before float32: the one is what the other is compared with.
    Variant("template", "template", np.float64, exact=True, alone=True),
    # What users get: exits as float32 tables where the picture allows.
    Variant("template", "template", np.float32, exact=True),
    Variant(_SOLID, _SOLID, np.float32, exact=True),
    Variant("layered:samples=1", "layered", np.float32, exact=True),
    Variant("template:samples=2:colour=nearest", "template", np.float32, exact=True, samples=2),
    Variant("template:samples=4:colour=nearest", "template", np.float32, exact=True, samples=4),
    Variant("layered:samples=4:colour=nearest", "layered", np.float32, exact=True, samples=4),
    *(Variant(name, name, np.float64) for name in _ROUNDED),
]
_QUARTER = Fraction(1, 4)
_LEFT_AND_UP = (-_QUARTER, -_QUARTER)
_RAY_PLACES: dict[int, tuple[PixelOffset, ...]] = {
    2: (_LEFT_AND_UP, (_QUARTER, _QUARTER)),
    4: (_LEFT_AND_UP, (-_QUARTER, _QUARTER), (_QUARTER, -_QUARTER), (_QUARTER, _QUARTER)),
}
# Roundings of a mean of four float32 colours: a sum's three, each by half an ulp of at most 4.
_MEAN_ROUNDINGS = 2
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


def _form_of(variant: Variant, display: Display, rgbd: RGBD) -> str:
    """How first hits are found: by lists, ray by ray, or rays of a mounted array."""
    if not variant.is_first_hit:
        return ""
    if not display.is_separable:
        return "mounted"
    if variant.alone or not cells_per_pitch(display, rgbd.pixel_mm):
        return "ray by ray"
    return "lists" if shares_directions(display) else "ray by ray"


def run_cases(size: Size, listener: Any) -> list[dict[str, Any]]:
    """A row for every variant on every case."""
    rows: list[dict[str, Any]] = []
    for family in FAMILIES:
        listener.stage(f"generators: {family.name}")
        for case in cases_of(family, size):
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
    for variant in VARIANTS:
        picture = solid if variant.oracle == "layered" else rgbd
        rows.append(common | _run(variant, case, (display, picture), rays, doubles))
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
    variant: Variant,
    case: Case,
    made: tuple[Display, RGBD],
    rays: Rays,
    doubles: dict[str, np.ndarray],
) -> dict[str, Any]:
    """One variant's row; float64's sources are kept for float32's to be compared with."""
    display, rgbd = made
    said = {"algorithm": variant.algorithm, "dtype": np.dtype(variant.dtype).name}
    started = time.perf_counter()
    try:
        if variant.samples > 1:
            found = generate(rgbd, display, variant.algorithm)
        elif variant.alone and display.is_separable:
            prepare(display, variant.algorithm, shape=rgbd.shape, pixel_mm=rgbd.pixel_mm)
            found = ray_by_ray(display, rgbd.shape, rgbd.pixel_mm).sources(rgbd)
        else:
            found = find_sources(rgbd, display, variant.algorithm)
        took = time.perf_counter() - started
        row = said | _judged(variant, found, doubles, display, rgbd, rays)
        row["seconds"] = took
    except InimError as error:
        return _refused(said["algorithm"], said["dtype"], error) | {
            "passed": case.refused is not False or not variant.exact
        }
    except Exception as error:
        return said | _crashed(error)
    # Rays of the other arrays are float64: what meets a corner exactly may go either way.
    exact = variant.exact and display.is_separable
    safe = not (row["changed"] if exact else row["outside"])
    guards = accuracy_warnings(display, pixel_mm=rgbd.pixel_mm)
    return row | {
        "outcome": "ran",
        "message": "",
        "safe": safe,
        "guards": guards,
        "exact": exact,
        "passed": (safe or bool(guards)) and took < _LONGEST_S,
    }


def _judged(
    variant: Variant,
    found: np.ndarray,
    doubles: dict[str, np.ndarray],
    display: Display,
    rgbd: RGBD,
    rays: Rays,
) -> dict[str, Any]:
    """What was found against the oracle, and against float64's."""
    few = _affordable(rays, variant, display, rgbd.depth_mm.size)
    common = {
        "form": _form_of(variant, display, rgbd),
        "digest": hashlib.sha256(found.tobytes()).hexdigest()[:16],
    }
    if variant.samples > 1:
        return common | _compare_means(variant, found, few.pixels, rgbd, display)
    if variant.dtype is np.float64:
        doubles[variant.oracle] = found
    double = doubles.get(variant.oracle)
    loss = None if double is None else _loss_of_type(double, found, display, rgbd)
    return common | {"ssim_loss": loss} | _compare(variant, found, display, rgbd, few)


def _compare(
    variant: Variant, found: np.ndarray, display: Display, rgbd: RGBD, rays: Rays
) -> dict[str, Any]:
    """Found sources against the oracle's."""
    algorithm_output = found[rays.pixels[:, 0], rays.pixels[:, 1]].astype(np.int64)
    oracle = answer(variant.oracle, rays, rgbd, display, variant.dtype)
    truth, exact = oracle.sources, 0
    if variant.is_first_hit:
        double = variant.dtype is np.float64
        fine = oracle if double else answer(variant.oracle, rays, rgbd, display, np.float64)
        truth, exact = with_rational_ties(
            variant.oracle, fine, algorithm_output, rays, rgbd, display
        )
    changed = algorithm_output != truth
    outside = changed & ~oracle.uncertain
    worst, mean = deciding_ulps(variant.algorithm, variant.dtype, display, rgbd)
    most = rgbd.palette.shape[0] * rgbd.palette.shape[1]
    bad = (found < HOLE) & (found != NO_LENS) | (found >= most)
    return {
        "pixels": len(algorithm_output),
        "changed": int(changed.sum()),
        "uncertain": int(oracle.uncertain.sum()),
        "outside": int(outside.sum()) + int(bad.sum()),
        "settled_exactly": exact,
        "worst_ulp": worst,
        "mean_ulp": mean,
    }


def _compare_means(
    variant: Variant, found: np.ndarray, pixels: np.ndarray, rgbd: RGBD, display: Display
) -> dict[str, Any]:
    """How many panel pixels show another colour than the mean of their rays.

    Parameters
    ----------
    variant : Variant
    found : (rows, columns, 3) float32
        A generator's EIA, linear RGB.
    pixels : (n, 2) int
        Panel pixels to look at.
    """
    algorithm_output = found[pixels[:, 0], pixels[:, 1]].astype(float)
    mean, uncertain, exact = np.zeros(algorithm_output.shape), np.zeros(len(pixels), bool), 0
    palette = rgbd.palette.reshape(-1, 3).astype(float)
    fill = exact_length(display.pixel_fill)
    for down, right in _RAY_PLACES[variant.samples]:
        rays = rays_over(display, rgbd, pixels, (down * fill, right * fill))
        known = answer(variant.oracle, rays, rgbd, display, np.float64)
        # What is shown has no source to differ by: fractions decide all that rounding may have.
        sources, decided = with_rational_ties(
            variant.oracle, known, known.sources, rays, rgbd, display
        )
        exact += decided
        uncertain |= known.uncertain
        mean += (
            np.where((sources >= 0)[:, None], palette[np.maximum(sources, 0)], 0) / variant.samples
        )
    off = np.abs(algorithm_output - mean)
    eps = float(np.finfo(np.float32).eps)
    changed = (off > _MEAN_ROUNDINGS * eps).any(axis=1)
    ulps = off[~changed] / np.spacing(np.maximum(mean[~changed], eps).astype(np.float32))
    return {
        "pixels": len(algorithm_output),
        "changed": int(changed.sum()),
        "uncertain": int(uncertain.sum()),
        "outside": int((changed & ~uncertain).sum()),
        "settled_exactly": exact,
        "ssim_loss": None,
        "worst_ulp": float(ulps.max(initial=0.0)),
        "mean_ulp": float(ulps.mean()) if ulps.size else 0.0,
    }


def _affordable(rays: Rays, variant: Variant, display: Display, cells: int) -> Rays:
    """All rays, or an even choice of them where the oracle takes long for each."""
    most = _MOST_PIXELS[variant.oracle.partition(":")[0]]
    if variant.oracle == "gu2020" and not math.isinf(display.scene_pixel_mm):
        low, high = display.depth_range_mm
        most = min(most, max(8, int(_MOST_SAMPLES * display.scene_pixel_mm / (high - low))))
    if variant.oracle == "li2012":
        most = min(most, max(6, _MOST_LANDINGS // cells))
    if variant.is_first_hit:
        low, high = display.depth_range_mm
        crossed = float(np.abs([rays.du, rays.dv]).max(initial=0)) * (high - low)
        most = min(most, max(8, int(_MOST_SAMPLES / (crossed + 1)))) // variant.samples
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
