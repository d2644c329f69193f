"""All generators on all displays and pictures of one matrix, against independent oracles.

Expected: first hits are those of the definition, in rational numbers, ties included; `gu2020`,
`wang2024` and `li2012` show what their definitions say wherever rounding does not decide; and every
way to ask for an EIA gives the same bits.
"""

from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from inim.apps.stress.oracles.generators import answer, with_rational_ties
from inim.apps.stress.oracles.rays import chosen_pixels, rays_over
from inim.display import Display
from inim.display.pixels import CENTRE, PixelOffset, exact_length
from inim.display.pixels import SUBPIXELS as PATTERNS
from inim.generators import (
    HOLE,
    MASKED,
    NO_LENS,
    PanelRays,
    base,
    colour_of,
    find_sources,
    generate,
    hole_fraction,
    prepare,
)
from inim.generators.oracle import exact_hits
from inim.generators.raycast.ray_by_ray import RayByRay
from inim.generators.raycast.strips import Strips
from inim.generators.steps import RayGenerator
from inim.image.color import linear_from_srgb, srgb_from_linear, srgb_to_uint8
from inim.image.rgbd import RGBD
from inim.system.backend.kernels import limited_threads
from tests import oracle
from tests.generator_cases import (
    ALGORITHMS,
    DISPLAYS,
    NON_SEPARABLE,
    SEPARABLE,
    SUBPIXELS,
    coded,
    picture,
    pictures_for,
    single_ray,
)

FIRST_HITS = [name for name, case in ALGORITHMS.items() if case.columns]
OF_PAPER = [name for name, case in ALGORITHMS.items() if not case.columns]


def pairs(algorithms: list[str], displays: dict[str, Any]) -> list[Any]:
    """Each algorithm with each display that it serves, and every second of the pictures.

    The fast tier has each separable display with one algorithm in three, and each algorithm with
    whole and with fractional numbers of pixels per lens; other displays with one in two.
    """
    return [
        case((row - column) % (3 if device.is_separable else 2) == 0 and half == column % 2,
             algorithm, display, half)
        for row, algorithm in enumerate(algorithms)
        for column, (display, device) in enumerate(displays.items())
        for half in (0, 1)
        if device.is_separable or ALGORITHMS[algorithm].anywhere
    ]  # fmt: skip


def case(is_fast: bool, *values: object) -> Any:
    """Parameters of a test; the full product of them is slow."""
    return pytest.param(*values, marks=() if is_fast else pytest.mark.slow)


# -- sources ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("algorithm", "display", "half"), pairs(FIRST_HITS, SEPARABLE))
def test_every_pixel_shows_the_first_hit_of_the_definition(algorithm, display, half):
    device, columns = DISPLAYS[display], ALGORITHMS[algorithm].columns
    assert columns is not None
    for name in pictures_for(display)[half::2]:
        rgbd = picture(display, name)
        sources = find_sources(rgbd, device, single_ray(algorithm))
        right = oracle.exact_sources(rgbd, device, columns)
        wrong = np.argwhere(sources != right)
        assert len(wrong) == 0, f"{name}: {len(wrong)} pixels, the first {wrong[0]}"
        assert np.array_equal(sources == NO_LENS, ~device.lensed)
        # The product's own oracle, written apart.
        assert exact_hits(rgbd, device, columns, most=20).wrong_share(sources) == 0


@pytest.mark.parametrize(
    ("algorithm", "display", "half"),
    pairs(FIRST_HITS, NON_SEPARABLE) + pairs(OF_PAPER, SEPARABLE | NON_SEPARABLE),
)
def test_other_sources_follow_the_definition_wherever_rounding_does_not_decide(
    algorithm, display, half
):
    device, exact = DISPLAYS[display], []
    for name in pictures_for(display)[half::2]:
        rgbd = picture(display, name)
        pixels = chosen_pixels(device, ALGORITHMS[algorithm].most_pixels)
        sources = find_sources(rgbd, device, single_ray(algorithm))
        expected = answer(algorithm, rays_over(device, rgbd, pixels), rgbd, device, np.float64)
        sure = ~expected.uncertain
        assert np.array_equal(sources[tuple(pixels.T)][sure], expected.sources[sure]), name
        assert (sources[~device.lensed] == NO_LENS).all()
        exact.append(sure.mean())
    # Rays straight ahead run along borders: with one pixel per lens, all do.
    assert np.mean(exact) > 0.2, "or the test says little"


def test_the_matrix_has_hits_holes_and_deeper_layers():
    display, layered = DISPLAYS["odd pixels"], picture("odd pixels", "layers")
    for algorithm in ALGORITHMS:
        sources = find_sources(layered, display, single_ray(algorithm))
        assert (sources >= 0).any() and (sources == HOLE).any(), algorithm
    sources = find_sources(layered, display, "layered:samples=1")
    assert len(np.unique(sources[sources >= 0] // layered.depth_mm.size)) == 3


def first_hits(tracer: RayByRay | Strips, rgbd: RGBD, display: Display) -> np.ndarray:
    """Sources of the centres of all pixels."""
    sources = np.empty(display.eia_shape, np.int32)
    tracer.take(rgbd)(0, slice(0, len(sources)), sources)
    return np.where(display.lensed, sources, NO_LENS)


@pytest.mark.parametrize("columns", ["surface", "solid", "layers"])
@pytest.mark.parametrize("display", SEPARABLE)
def test_strips_single_rays_and_free_rays_find_the_same(display, columns):
    """Bit for bit, but for the rounding of free rays; in the order of a stream of pictures."""
    device = DISPLAYS[display]
    for name in ("layers", "layers, odd size", "hills", "ties", "ties of solids"):
        rgbd = picture(display, name)
        rays = PanelRays(device, rgbd.shape, rgbd.pixel_mm, (CENTRE,))
        alone = first_hits(RayByRay(rays, columns), rgbd, device)
        whole = exact_length(device.pitch_mm) / exact_length(rgbd.pixel_mm)
        if whole.denominator == 1 and device.row_pitch_mm == device.pitch_mm:
            lists = Strips(rays, columns)
            for before in (rgbd, RGBD(rgbd.color, rgbd.depth_mm, rgbd.covered, rgbd.pixel_mm)):
                lists.take(before)
                assert np.array_equal(first_hits(lists, rgbd, device), alone)
        # Where pixels are on borders between lenses, free rays go either way.
        if name == "layers, odd size" and display in ("odd pixels", "virtual", "phone", "moved"):
            turned = device.replace(rotation_deg=1e-9)
            assert not turned.is_separable
            free = first_hits(RayByRay(replace(rays, display=turned), columns), rgbd, turned)
            assert (free != alone)[device.lensed].mean() < 0.02


# -- colours ------------------------------------------------------------------------------------

_QUARTERS = {
    1: [(Fraction(0), Fraction(0))],
    2: [(Fraction(-1, 4), Fraction(-1, 4)), (Fraction(1, 4), Fraction(1, 4))],
    4: [(Fraction(a, 4), Fraction(b, 4)) for a in (-1, 1) for b in (-1, 1)],
}


COLOURED = [
    *((a, d) for a in ("template", "layered") for d in SUBPIXELS),
    *((a, d) for a in ("template", "layered") for d in ("odd pixels", "phone", "hexagonal")),
    ("template:columns=solid", "virtual"),
]


@pytest.mark.parametrize(
    ("algorithm", "display", "samples"),
    [
        case((row + column) % 3 == 0, *pair, samples)
        for row, pair in enumerate(COLOURED)
        for column, samples in enumerate(_QUARTERS)
    ],
)
def test_a_pixel_shows_the_mean_of_the_rays_from_its_lit_area(algorithm, display, samples):
    device = DISPLAYS[display]
    fill = exact_length(device.pixel_fill)
    pixels = chosen_pixels(device, 60)
    for name in ("random, sparse, odd size", "layers"):
        rgbd = picture(display, name)
        eia = generate(rgbd, device, f"{algorithm}:samples={samples}:colour=nearest")[
            tuple(pixels.T)
        ]
        palette = np.concatenate([rgbd.palette.reshape(-1, 3), np.zeros((1, 3), np.float32)])
        for channel, place in enumerate(PATTERNS[device.subpixels]):
            mean, sure = np.zeros(len(pixels)), np.ones(len(pixels), bool)
            for down, right in _QUARTERS[samples]:
                pixel_offset = PixelOffset(down * fill, place.right + right * place.width * fill)
                rays = rays_over(device, rgbd, pixels, pixel_offset)
                expected = answer(algorithm, rays, rgbd, device, np.float64)
                sources, _ = with_rational_ties(
                    algorithm, expected, expected.sources, rays, rgbd, device
                )
                if not device.is_separable:
                    sure &= ~expected.uncertain
                mean += palette[np.where(sources >= 0, sources, -1), channel] / samples
            assert sure.mean() > 0.2
            assert np.abs(eia[sure, channel] - mean[sure]).max() < 1e-6


@pytest.mark.parametrize("samples", [2, 4])
def test_codes_are_those_of_the_mean_light_to_the_last_bit(samples):
    """Against the colour module's formulas on every pixel's rays; alpha is no light."""
    display, linear = DISPLAYS["both sides"], picture("both sides", "spikes")
    color = np.random.default_rng(1).integers(1, 256, (*linear.shape, 4)).astype(np.uint8)
    rgbd = RGBD(color, linear.depth_mm, linear.covered, linear.pixel_mm)
    algorithm = f"template:samples={samples}:colour=nearest"
    generator = prepare(display, algorithm, shape=rgbd.shape, pixel_mm=rgbd.pixel_mm)
    sources = np.stack([of_ray for _, of_ray in generator.sources_of_rays(rgbd)])
    palette = np.append(rgbd.color.reshape(-1, 4), np.zeros((1, 4), np.uint8), axis=0)
    codes = palette[np.where(sources >= 0, sources, -1)]
    # In 16383 steps of light, as the definition counts.
    steps = np.rint(linear_from_srgb(codes[..., :3] / np.float32(255)) * 16383).astype(int)
    mean = (steps.sum(axis=0) / (samples * 16383)).astype(np.float32)
    eia = generator.generate(rgbd)
    assert np.array_equal(eia[..., :3], srgb_to_uint8(srgb_from_linear(mean)))
    alpha = codes[..., 3].sum(axis=0, dtype=int)
    assert np.array_equal(eia[..., 3], (2 * alpha + samples) // (2 * samples))
    agree = (sources == sources[0]).all(axis=0)
    assert 0.1 < agree.mean() < 0.9, "or the test says nothing"
    assert np.array_equal(eia[agree], palette[np.where(sources[0] >= 0, sources[0], -1)][agree])


# -- one result for every way to ask --------------------------------------------------------------

METHODS = {
    **{name: single_ray(name) for name in ALGORITHMS},
    "four rays": "template:samples=4",
    "layers, two rays": "layered:samples=2",
    "filled": "li2012:fill=hidden",
    "two rays, filled": "template:samples=2:fill=all",
}


def served(method: str, display: str) -> bool:
    """True if a method of the matrix serves a display."""
    rows_and_columns = DISPLAYS[display].is_separable
    return rows_and_columns or ("fill" not in method and method.partition(":")[0] not in (
        "wang2024", "li2012"))  # fmt: skip


@pytest.mark.parametrize(
    ("method", "display"),
    [
        # Each method in the fast tier: phone's tables, and one display in three of the others.
        case(display == "phone" or (row + column) % 3 == 0, method, display)
        for row, method in enumerate(METHODS)
        for column, display in enumerate(
            ("odd pixels", "three strips", "off the panel", "turned", "hexagonal",
             "stripes, turned", "larger panel", "stripes", "phone"))
        if served(METHODS[method], display)
    ],
)  # fmt: skip
def test_masks_threads_codes_and_earlier_pictures_change_no_pixel(method, display):
    device, algorithm = DISPLAYS[display], METHODS[method]
    rgbd, other = picture(display, "layers"), picture(display, "layers")
    other = RGBD(other.color[::-1], other.depth_mm[::-1], other.covered[::-1], other.pixel_mm)
    size: dict[str, Any] = {"shape": rgbd.shape, "pixel_mm": rgbd.pixel_mm}
    whole, sources = generate(rgbd, device, algorithm), find_sources(rgbd, device, algorithm)
    assert whole.dtype == np.float32 and whole.shape == (*device.eia_shape, 3)
    assert sources.dtype == np.int32 and not whole[~device.lensed].any()
    generator = prepare(device, algorithm, **size)
    assert isinstance(generator, RayGenerator)
    if generator.shows_sources(rgbd):
        assert np.array_equal(whole, colour_of(sources, rgbd))
    out = np.full_like(whole, 7)
    generator.generate(other)
    generator.generate(coded(rgbd))
    assert generator.generate(rgbd, out) is out and np.array_equal(out, whole)
    assert np.array_equal(generator.sources(rgbd), sources)
    if generator.shows_sources(rgbd):
        index = generate(coded(rgbd), device, algorithm).view(np.uint32)[..., 0].astype(np.int64)
        assert np.array_equal(index - 1, np.maximum(sources, HOLE))
    # What is not covered means nothing.
    plain = generate(
        RGBD(rgbd.color, rgbd.depth_mm, rgbd.covered, rgbd.pixel_mm), device, algorithm
    )
    for depth in (np.nan, 6.0):
        strange = np.where(rgbd.covered, rgbd.depth_mm, np.float32(depth))
        same = RGBD(rgbd.color, strange, rgbd.covered, rgbd.pixel_mm)
        assert np.array_equal(generate(same, device, algorithm), plain)
    with limited_threads(1):
        assert np.array_equal(generator.generate(rgbd), whole)
    for share in (0.0, 0.3, 1.0):
        mask = np.random.default_rng(4).random(device.eia_shape) < share
        masked = prepare(device, algorithm, mask=mask, **size)
        part = masked.generate(rgbd, out)
        assert part is out
        assert np.array_equal(part[mask], whole[mask]) and not part[~mask].any()
        masked_sources = masked.sources(rgbd)
        assert np.array_equal(masked_sources[mask], sources[mask])
        assert (masked_sources[~mask & device.lensed] == MASKED).all()
        assert (masked_sources[~device.lensed] == NO_LENS).all()
        lensed = np.count_nonzero(mask & device.lensed)
        empty = np.count_nonzero(sources[mask] == HOLE)
        assert hole_fraction(masked_sources) == (empty / lensed if lensed else 0.0)


@pytest.mark.parametrize(
    ("algorithm", "display"),
    [
        (algorithm, display)
        for algorithm in ("template", "layered:samples=1", "gu2020", "li2012")
        for display in ("odd pixels", "phone", "turned")
        if served(algorithm, display)
    ],
)
def test_nothing_covered_is_all_holes_and_a_picture_without_layers_is_its_front(algorithm, display):
    device, rgbd = DISPLAYS[display], picture(display, "layers")
    front = RGBD(rgbd.color, rgbd.depth_mm, rgbd.covered, rgbd.pixel_mm)
    uncovered = RGBD(rgbd.color, rgbd.depth_mm, np.zeros(rgbd.shape, bool), rgbd.pixel_mm)
    empty = find_sources(uncovered, device, algorithm)
    assert (empty[device.lensed] == HOLE).all() and not generate(uncovered, device, algorithm).any()
    same, by = (front, "template") if algorithm == "layered:samples=1" else (rgbd, algorithm)
    expected = find_sources(same, device, by)
    assert np.array_equal(find_sources(front, device, algorithm), expected)


# -- kernels in plain Python ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("algorithm", "display"),
    [(a, d) for a in OF_PAPER for d in ("both sides", "virtual", "turned") if served(a, d)],
)
def test_plain_python_and_compiled_code_agree_to_the_bit(algorithm, display, monkeypatch):
    device, rgbd = DISPLAYS[display], picture(display, "random, sparse, odd size")
    sources = find_sources(rgbd, device, algorithm)
    # As with NUMBA_DISABLE_JIT, but without another process.
    monkeypatch.setattr(base, "compile_kernel", lambda kernel: kernel)
    assert np.array_equal(find_sources(rgbd, device, algorithm), sources)
