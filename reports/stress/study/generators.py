"""Comparison of every generator with its oracle: sources, or mean colours of several rays."""

from __future__ import annotations

import hashlib
import math
import time
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from inim.apps.stress.pictures import solids_of
from inim.display import Display
from inim.display.pixels import PixelOffset, exact_length
from inim.generators import HOLE, NO_LENS, find_sources, generate, prepare
from inim.generators.accuracy_limits import accuracy_warnings
from inim.generators.raycast.cell_lists import shares_directions
from inim.generators.raycast.phases import cells_per_pitch
from inim.generators.template import ray_by_ray
from inim.image.rgbd import RGBD
from inim.system.errors import InimError
from reports.stress.study.cases import Case, Family, Size, every
from reports.stress.study.oracles import answer, with_rational_ties
from reports.stress.study.rays import Rays, chosen_pixels, rays_over


@dataclass(frozen=True)
class Variant:
    """A generator in one floating-point type.

    Attributes
    ----------
    algorithm : str
        Name with options, as for `inim.generators.prepare`.
    oracle : str
        Name of the definition.
    dtype : float type
    exact : bool
        True if every pixel must agree with the definition, including ties.
    ray_by_ray : bool
        True to trace each ray separately, without tables.
    samples : int
        Rays per panel pixel. For several rays, colours are compared instead of sources.
    """

    algorithm: str
    oracle: str
    dtype: type
    exact: bool = False
    ray_by_ray: bool = False
    samples: int = 1

    @property
    def is_first_hit(self) -> bool:
        """True if rational arithmetic can compute the sources."""
        return self.oracle in ("template", _SOLID, "layered")


_SOLID = "template:columns=solid"
_ROUNDED = ("gu2020", "wang2024", "wang2024:matching=ray", "li2012")
VARIANTS = [
    # float64 before float32, which is compared with it.
    Variant("template", "template", np.float64, exact=True, ray_by_ray=True),
    # The default: float32 tables of exits if the picture allows them.
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
_RAY_OFFSETS: dict[int, tuple[tuple[Fraction, Fraction], ...]] = {
    2: (_LEFT_AND_UP, (_QUARTER, _QUARTER)),
    4: (_LEFT_AND_UP, (-_QUARTER, _QUARTER), (_QUARTER, -_QUARTER), (_QUARTER, _QUARTER)),
}
# Rounding error of a mean of four float32 colours: three sums with half an ulp of at most 4 each.
_MEAN_ROUNDINGS = 2
# Largest number of panel pixels of a case for each oracle; some oracles are slow.
_MAX_PIXELS = {"template": 1000, "layered": 400, "gu2020": 200, "wang2024": 60, "li2012": 120}
# Largest number of landing points in the oracle of `li2012`.
_MAX_LANDINGS = 1_000_000
# Largest number of ray samples in the oracle of `gu2020`.
_MAX_SAMPLES = 300_000
# Time limit of a case.
_TIMEOUT_S = 60.0


def _form_of(variant: Variant, display: Display, rgbd: RGBD) -> str:
    """Implementation of first hits; empty for other algorithms."""
    if not variant.is_first_hit:
        return ""
    if not display.is_separable:
        return "non-separable"
    if variant.ray_by_ray or not cells_per_pitch(display, rgbd.pixel_mm):
        return "ray by ray"
    return "lists" if shares_directions(display) else "ray by ray"


def run_family(family: Family, **size: int) -> list[dict[str, Any]]:
    """Results of every variant for every case of a `Size`."""
    of_size = Size(**size)
    cases = every(of_size.stride, family.cases(of_size))
    return [row for case in cases for row in run_case(family, case, of_size.max_pixels)]


def run_case(family: Family, case: Case, max_pixels: int) -> list[dict[str, Any]]:
    """Results of every variant for one case."""
    common = {"family": family.name, "case": case.label, "value": case.value}
    try:
        display, rgbd = case.make()
    except InimError as error:
        passed = case.refused is not False
        return [common | _refused("all", "", error) | {"passed": passed}]
    except Exception as error:
        return [common | {"algorithm": "all", "dtype": ""} | _crashed(error)]
    if case.refused:
        accepted = {"algorithm": "all", "dtype": "", "outcome": "accepted", "passed": False}
        return [common | accepted | {"message": "should have been refused"}]
    pixels = chosen_pixels(display, max_pixels)
    rays = rays_over(display, rgbd, pixels)
    solid = solids_of(rgbd, display)
    return [
        common | _run(variant, case, display, solid if variant.oracle == "layered" else rgbd, rays)
        for variant in VARIANTS
    ]


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


def _run(variant: Variant, case: Case, display: Display, rgbd: RGBD, rays: Rays) -> dict[str, Any]:
    """Result of one variant."""
    names = {"algorithm": variant.algorithm, "dtype": np.dtype(variant.dtype).name}
    started = time.perf_counter()
    try:
        if variant.samples > 1:
            output = generate(rgbd, display, variant.algorithm)
        elif variant.ray_by_ray and display.is_separable:
            prepare(display, variant.algorithm, shape=rgbd.shape, pixel_mm=rgbd.pixel_mm)
            output = ray_by_ray(display, rgbd.shape, rgbd.pixel_mm).sources(rgbd)
        else:
            output = find_sources(rgbd, display, variant.algorithm)
        seconds = time.perf_counter() - started
        affordable = _affordable(rays, variant, display, rgbd.depth_mm.size)
        compare = _compare_means if variant.samples > 1 else _compare
        row = names | compare(variant, output, display, rgbd, affordable)
        row["form"] = _form_of(variant, display, rgbd)
        row["digest"] = hashlib.sha256(output.tobytes()).hexdigest()[:16]
        row["seconds"] = seconds
    except InimError as error:
        return _refused(names["algorithm"], names["dtype"], error) | {
            "passed": case.refused is not False or not variant.exact
        }
    except Exception as error:
        return names | _crashed(error)
    # Non-separable displays have float64 rays: rounding decides rays that meet a corner exactly.
    exact = variant.exact and display.is_separable
    safe = not (row["changed"] if exact else row["outside"])
    guards = accuracy_warnings(display, pixel_mm=rgbd.pixel_mm)
    return row | {
        "outcome": "ran",
        "message": "",
        "safe": safe,
        "guards": guards,
        "exact": exact,
        "passed": (safe or bool(guards)) and seconds < _TIMEOUT_S,
    }


def _compare(
    variant: Variant, output: np.ndarray, display: Display, rgbd: RGBD, rays: Rays
) -> dict[str, Any]:
    """Compare sources with the oracle."""
    sources = output[rays.pixels[:, 0], rays.pixels[:, 1]].astype(np.int64)
    oracle = answer(variant.oracle, rays, rgbd, display, variant.dtype)
    truth = oracle.sources
    if variant.is_first_hit:
        is_float64 = variant.dtype is np.float64
        fine = oracle if is_float64 else answer(variant.oracle, rays, rgbd, display, np.float64)
        truth, _ = with_rational_ties(variant.oracle, fine, sources, rays, rgbd, display)
    changed = sources != truth
    outside = changed & ~oracle.uncertain
    cells = rgbd.palette.shape[0] * rgbd.palette.shape[1]
    invalid = (output < HOLE) & (output != NO_LENS) | (output >= cells)
    return {
        "pixels": len(sources),
        "changed": int(changed.sum()),
        "uncertain": int(oracle.uncertain.sum()),
        "outside": int(outside.sum()) + int(invalid.sum()),
    }


def _compare_means(
    variant: Variant, eia: np.ndarray, display: Display, rgbd: RGBD, rays: Rays
) -> dict[str, Any]:
    """Count the panel pixels of a linear EIA whose colour is not the mean of their rays."""
    pixels = rays.pixels
    colours = eia[pixels[:, 0], pixels[:, 1]].astype(float)
    mean, uncertain = np.zeros(colours.shape), np.zeros(len(pixels), bool)
    palette = rgbd.palette.reshape(-1, 3).astype(float)
    fill = exact_length(display.pixel_fill)
    for down, right in _RAY_OFFSETS[variant.samples]:
        rays = rays_over(display, rgbd, pixels, PixelOffset(down * fill, right * fill))
        oracle = answer(variant.oracle, rays, rgbd, display, np.float64)
        # The EIA has no sources to compare with: fractions decide all uncertain rays.
        sources, _ = with_rational_ties(variant.oracle, oracle, oracle.sources, rays, rgbd, display)
        uncertain |= oracle.uncertain
        mean += (
            np.where((sources >= 0)[:, None], palette[np.maximum(sources, 0)], 0) / variant.samples
        )
    error = np.abs(colours - mean)
    eps = float(np.finfo(np.float32).eps)
    changed = (error > _MEAN_ROUNDINGS * eps).any(axis=1)
    return {
        "pixels": len(colours),
        "changed": int(changed.sum()),
        "uncertain": int(uncertain.sum()),
        "outside": int((changed & ~uncertain).sum()),
    }


def _affordable(rays: Rays, variant: Variant, display: Display, cells: int) -> Rays:
    """All rays, or evenly chosen ones if the oracle is slow."""
    limit = _MAX_PIXELS[variant.oracle.partition(":")[0]]
    if variant.oracle == "gu2020" and not math.isinf(display.scene_pixel_mm):
        low, high = display.depth_range_mm
        limit = min(limit, max(8, int(_MAX_SAMPLES * display.scene_pixel_mm / (high - low))))
    if variant.oracle == "li2012":
        limit = min(limit, max(6, _MAX_LANDINGS // cells))
    if variant.is_first_hit:
        low, high = display.depth_range_mm
        cells_crossed = float(np.abs([rays.du, rays.dv]).max(initial=0)) * (high - low)
        limit = min(limit, max(8, int(_MAX_SAMPLES / (cells_crossed + 1)))) // variant.samples
    if len(rays.pixels) <= limit:
        return rays
    return rays.take(np.unique(np.linspace(0, len(rays.pixels) - 1, limit).astype(int)))
