"""Colours: the sRGB curve, the colours of rays, and the fill of holes."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from inim.apps.stress.oracles.colours import (
    COLOURS,
    HoleFill,
    code_from_linear,
    expected_colours,
    linear_from_code,
)
from inim.apps.stress.oracles.rays import chosen_pixels, rays_over
from inim.apps.stress.pictures import (
    KINDS,
    displays,
    noise,
    noise_pictures,
    small_display,
    solids_of,
)
from inim.apps.stress.relation import EPS32, Deviation, difference, excess, is_true, relation
from inim.display import Display
from inim.generators import HOLE, find_sources, generate, prepare
from inim.generators.steps import RayGenerator
from inim.image.color import (
    linear_from_srgb,
    srgb_from_linear,
    srgb_slope,
    srgb_to_uint8,
    to_srgb,
)
from inim.image.rgbd import RGBD, Layer, LayeredRGBD

_COVERS = "generators image.color image.rgbd display.pixels display.layouts"
# Thickness of a surface of unknown back, in picture pixels (docs/theory/templates.md).
_THICKNESS_PX = 10


@relation(
    "the sRGB curve", covers="image.color", limit=8, unit="ulp of float32 at 1",
    source="roundings of float32 and of a power",
)  # fmt: skip
def _curve(_: str, effort: int) -> Iterator[Deviation]:
    """Codes and linear light follow IEC 61966-2-1 in both directions, with its derivative."""
    light = np.unique(np.concatenate([np.linspace(0, 1, 4001), np.geomspace(1e-7, 1, 500),
                                      0.0031308 + np.linspace(-1e-5, 1e-5, 101)]))  # fmt: skip
    light = light.astype(np.float32)
    yield difference("codes", srgb_from_linear(light), code_from_linear(light.astype(float)), EPS32)
    codes = np.concatenate([light, np.float32(0.04045) + np.linspace(-1e-5, 1e-5, 101)])
    codes = codes.astype(np.float32)
    expected = linear_from_code(codes.astype(float))
    yield difference("light", linear_from_srgb(codes), expected, EPS32)
    every = np.arange(256, dtype=np.uint8)
    back = srgb_to_uint8(srgb_from_linear(linear_from_srgb(every / np.float32(255))))
    yield difference("all codes", back, every)
    yield difference(
        "image of codes", to_srgb(linear_from_srgb(every[:, None] / 255)), every[:, None]
    )
    outside = np.array([-1.0, 2.0, np.inf], np.float32)
    yield difference("clipped", srgb_from_linear(outside), [0, 1, 1])
    halves = (np.arange(255) + np.array([[0.499], [0.501]])) / 255
    rounded = np.stack([np.arange(255), np.arange(255) + 1]).astype(np.uint8)
    yield difference("nearest code", srgb_to_uint8(halves), rounded)
    smooth = np.array([1e-4, 0.002, 0.0032, 0.01, 0.2, 0.7, 1.0])
    step = 1e-6 * smooth
    slope = (code_from_linear(smooth + step) - code_from_linear(smooth - step)) / (2 * step)
    yield difference("slope", srgb_slope(smooth), slope, EPS32 * 100)


def _pictured(display: Display, seed: int, *, layered: bool) -> RGBD:
    """Smooth hills with jumps and gaps, so that surfaces join; with layers or not."""
    shape, pixel = display.capture_shape(2), display.capture_pixel_mm(2)
    rgbd = noise(display, shape, pixel, seed, 0.9)
    rows, columns = np.indices(shape)
    low, high = display.depth_range_mm
    wave = 0.5 + 0.2 * np.sin(columns / 3 + seed) + 0.2 * np.cos(rows / 4)
    # Noise in one half, where few neighbours are on one surface.
    wave = np.where(
        columns < shape[1] // 2, wave, 0.3 * wave + 0.6 * (rgbd.depth_mm - low) / (high - low)
    )
    hills = RGBD(rgbd.color, (low + (high - low) * wave).astype(np.float32), rgbd.covered, pixel)
    return solids_of(hills, display) if layered else hills


def _as_codes(rgbd: RGBD) -> RGBD:
    """The picture with random sRGB codes and alphas instead of its colours."""
    random = np.random.default_rng(rgbd.depth_mm.size)

    def codes() -> np.ndarray:
        return random.integers(0, 256, (*rgbd.shape, 4), np.uint8)

    if not isinstance(rgbd, LayeredRGBD):
        return RGBD(codes(), rgbd.depth_mm, rgbd.covered, rgbd.pixel_mm)
    deeper = tuple(Layer(codes(), *(getattr(layer, n) for n in ("front_mm", "back_mm", "covered")))
                   for layer in rgbd.deeper)  # fmt: skip
    return replace(rgbd, color=codes(), deeper=deeper)


@relation(
    "colours of rays", covers=_COVERS, limit=1, unit="1e-5 of white, or 8-bit codes",
    source="docs/theory/templates.md; light in 1/16383 and float32",
)  # fmt: skip
def _rays(_: str, effort: int) -> Iterator[Deviation]:
    """Nearest, interpolated and averaged colours are those of plain loops, in both types."""
    turn = 0
    for seed, (name, display) in enumerate(displays()):
        pixels = chosen_pixels(display, 6 + 4 * effort)
        mask = np.zeros(display.eia_shape, bool)
        mask[tuple(pixels.T)] = True
        for algorithm in ("template", "layered"):
            for colour in (*COLOURS, "nearest"):
                for samples in (1, 2, 4):
                    turn += 1
                    if turn % (23 if effort == 1 else 5):
                        continue
                    plain = _pictured(display, seed, layered=algorithm == "layered")
                    rgbd = plain if turn % 4 else _as_codes(plain)
                    spec = f"{algorithm}:samples={samples}:colour={colour}:fill=none"
                    yield from _against_oracle(f"{name}, {spec}", spec, display, rgbd, pixels, mask)


def _against_oracle(
    case: str, spec: str, display: Display, rgbd: RGBD, pixels: np.ndarray, mask: np.ndarray
) -> Iterator[Deviation]:
    words = dict(word.split("=") for word in spec.split(":")[1:])
    size = {"shape": rgbd.shape, "pixel_mm": rgbd.pixel_mm}
    generator = prepare(display, spec, **size)
    assert isinstance(generator, RayGenerator)
    expected = expected_colours(generator, rgbd, pixels, words["colour"], int(words["samples"]))
    whole = generator.generate(rgbd)
    eia = whole[tuple(pixels.T)]
    if rgbd.color.dtype == np.uint8:
        expected[:, :3] = code_from_linear(np.minimum(expected[:, :3], 1))
        yield difference(case, eia, 255 * expected)
    else:
        yield difference(case, eia, expected, 1e-5 * np.maximum(expected, 0.05))
    masked = prepare(display, spec, **size, mask=mask).generate(rgbd)
    yield is_true(f"{case}: masked", masked == whole * mask[..., None], masked.size)


@relation(
    "light is linear", covers=_COVERS, limit=1, unit="1e-5 of white", source="float32",
)  # fmt: skip
def _linear(_: str, effort: int) -> Iterator[Deviation]:
    """Constants stay constant, powers of two scale bits, channels can change places."""
    for display, rgbd in noise_pictures():
        for spec in ("template:fill=none", "layered:fill=none", "gu2020:samples=4",
                     "template:colour=averaged:fill=none"):  # fmt: skip
            hits = prepare(display, spec, shape=rgbd.shape, pixel_mm=rgbd.pixel_mm)
            whole = hits.generate(rgbd)
            double = hits.generate(replace(rgbd, color=rgbd.color * np.float32(0.25)))
            yield difference(f"{spec}: a quarter", double, whole * np.float32(0.25), 1e-6)
            turned = hits.generate(replace(rgbd, color=rgbd.color[..., ::-1]))
            yield difference(f"{spec}: channels", turned, whole[..., ::-1], 1e-30)
            white = hits.generate(replace(rgbd, color=np.ones_like(rgbd.color)))
            assert isinstance(hits, RayGenerator)
            hit_share = np.mean([s >= 0 for _, s in hits.sources_of_rays(rgbd)], axis=0)
            yield difference(f"{spec}: white", white, hit_share[..., None] + 0 * white, 1e-5)


def _two_planes(display: Display) -> RGBD:
    """A near plate before a far wall that covers all of the array and no more."""
    shape = display.lens_rows * 4, display.lens_columns * 4
    low, high = display.depth_range_mm
    depth = np.full(shape, low + 0.05 * (high - low), np.float32)
    color = np.full((*shape, 3), (0.1, 0.6, 0.2), np.float32)
    near = np.s_[shape[0] // 3 : shape[0] // 2, shape[1] // 4 : shape[1] // 2]
    depth[near], color[near] = high, (0.9, 0.1, 0.1)
    return RGBD(color, depth, np.ones(shape, bool), display.pitch_mm / 4)


def _meets_plate(display: Display, rgbd: RGBD) -> np.ndarray:
    """Pixels whose rays meet the plate of `_two_planes`, twice as thick as a surface is taken."""
    pixels = np.argwhere(np.ones(display.eia_shape, bool))
    rays = rays_over(display, rgbd, pixels)
    rows, columns = np.nonzero(rgbd.depth_mm == rgbd.depth_mm.max())
    front = float(rgbd.depth_mm.max())
    meets = np.zeros(len(pixels), bool)
    for z in np.linspace(front - 2 * _THICKNESS_PX * rgbd.pixel_mm, front, 80):
        v, u = rays.v0 + rays.dv * z, rays.u0 + rays.du * z
        meets |= (
            (v > rows.min() - 0.1) & (v < rows.max() + 1.1)
            & (u > columns.min() - 0.1) & (u < columns.max() + 1.1)
        )  # fmt: skip
    return meets.reshape(display.eia_shape)


@relation(
    "filled holes", covers="generators", limit=1, unit="1e-5 of white", source="float32",
)  # fmt: skip
def _filled(_: str, effort: int) -> Iterator[Deviation]:
    """Holes beside a plate show the wall behind it, and the picture's edge is continued."""
    for number, changes in enumerate(({}, {"pixel_pitch_mm": 0.0636},
                                      {"elemental_pitch_mm": 1.013, "shift_x_mm": 0.2},
                                      {"pitch_y_mm": 1.25})):  # fmt: skip
        display = small_display(
            lens_columns=16, lens_rows=15, depth_min_mm=10.0, depth_max_mm=40.0,
            **{"pixel_pitch_mm": 0.125, **changes},
        )  # fmt: skip
        rgbd = _two_planes(display)
        edge = ((20, 20), (20, 20))
        parts = (rgbd.color, rgbd.depth_mm, rgbd.covered)
        padded = (np.pad(v, (*edge, (0, 0))[: v.ndim], mode="edge") for v in parts)
        wide = RGBD(*padded, rgbd.pixel_mm)
        for samples in (1, 4):
            spec = f"template:samples={samples}:colour=nearest"
            filled = generate(rgbd, display, f"{spec}:fill=hidden")
            again = generate(wide, display, f"{spec}:fill=hidden")
            yield difference(f"{number}, {samples}: larger", filled, again, 1e-5)
            mask = np.indices(filled.shape[:2]).sum(axis=0) % 3 == 0
            part = generate(rgbd, display, f"{spec}:fill=hidden", mask=mask)
            yield difference(f"{number}, {samples}: masked", part, filled * mask[..., None], 1e-30)
            lit = filled[display.lensed]
            # Two colours only, and mixtures of both.
            share = (lit[:, 0] - 0.1) / 0.8
            mixed = np.stack([0.1 + 0.8 * share, 0.6 - 0.5 * share, 0.2 - 0.1 * share], axis=-1)
            yield difference(f"{number}, {samples}: no black", lit, mixed, 1e-5)
            if samples == 1:
                red = filled[..., 0] > 0.5
                yield is_true(f"{number}: no plate behind it", ~red | _meets_plate(display, rgbd))
            yield is_true("dark beside lenses", not filled[~display.lensed].any())
            sources = find_sources(rgbd, display, f"{spec}:columns=solid")
            outside = (sources == HOLE) & display.lensed
            yield difference(f"{number}: beyond the edge", filled[outside],
                             np.broadcast_to(np.float32((0.1, 0.6, 0.2)), filled[outside].shape),
                             1e-5 if samples == 1 else 1.0)  # fmt: skip
        opaque = np.full((*rgbd.shape, 1), 255, np.uint8)
        codes = replace(rgbd, color=np.concatenate([to_srgb(rgbd.color), opaque], axis=-1))
        filled = generate(codes, display, "template:samples=1:colour=nearest:fill=hidden")
        light = generate(rgbd, display, "template:samples=1:colour=nearest:fill=hidden")
        there = display.lensed
        far = np.abs(filled[there][:, :3].astype(float) - to_srgb(light)[there].astype(float))
        yield excess(f"{number}: codes", far, 1.0)
        yield is_true(f"{number}: opaque", filled[there][:, 3] == 255)
    yield from _between_two_colours()
    uncovered = replace(rgbd, covered=np.zeros(rgbd.shape, bool))
    yield is_true("nothing to fill", not generate(uncovered, display, "template:fill=all").any())
    background = small_display(**KINDS["real"], lens_columns=9, lens_rows=9)
    scene = noise(background, background.capture_shape(2), 0.5, 3, covered=0.4)
    for fill in ("auto", "none", "hidden"):
        eia = generate(scene, background, f"template:colour=nearest:fill={fill}")
        unfilled = generate(scene, background, "template:colour=nearest:fill=none")
        if fill != "hidden":
            yield difference(f"relics keep holes: {fill}", eia, unfilled, 1e-5)


def _between_two_colours() -> Iterator[Deviation]:
    """Behind a bar, a wall turns from its colour on the left to that on the right, lens by lens."""
    display = small_display(
        lens_columns=24, lens_rows=15, pixel_pitch_mm=0.125, depth_min_mm=10.0, depth_max_mm=60.0
    )
    rgbd = _two_planes(display)
    columns = rgbd.shape[1]
    depth, color = np.full(rgbd.shape, 12.0, np.float32), np.zeros_like(rgbd.color)
    color[:, : columns // 2, 0], color[:, columns // 2 :, 1] = 0.5, 0.5
    bar = np.s_[:, 3 * columns // 8 : 5 * columns // 8]
    depth[bar], color[bar] = 60.0, (0.0, 0.0, 0.5)
    wall = RGBD(color, depth, rgbd.covered, rgbd.pixel_mm)
    eia = generate(wall, display, "template:samples=1:colour=nearest:fill=hidden")
    rows, pixels = eia.shape[0], round(1 / 0.125)
    by_lens = eia.reshape(rows, -1, pixels, 3)  # each pixel of an elemental image is one view
    share = by_lens[..., 1] / np.maximum(by_lens[..., 0] + by_lens[..., 1], 1e-6)
    is_mixed = (by_lens[..., :2] > 1e-3).all(axis=-1)
    is_pair = is_mixed[:, :-1] & is_mixed[:, 1:]
    yield is_true("wide holes", is_pair.sum() > 100)
    yield is_true(
        "nearer colours count more", np.diff(share, axis=1)[is_pair] > 1e-4, is_pair.sum()
    )


@relation(
    "the fill of every hole", covers="generators display.pixels", limit=1, unit="1e-5 of white",
    source="docs/theory/templates.md; float32",
)  # fmt: skip
def _fill_of_holes(_: str, effort: int) -> Iterator[Deviation]:
    """A hole has the mean light of the surfaces of its view that the picture could not see."""
    kinds: dict[str, dict[str, object]] = {
        "whole pitch": {}, "broken pitch": {"pixel_pitch_mm": 0.19}, "aimed": {
            "elemental_pitch_mm": 1.013, "shift_x_mm": 0.2}, "rows apart": {"pitch_y_mm": 1.3},
    }  # fmt: skip
    for seed, (name, changes) in enumerate(kinds.items()):
        display = small_display(
            lens_columns=9, lens_rows=7, depth_min_mm=8.0, depth_max_mm=30.0, **changes
        )
        for covered in (1.0, 0.85):
            rgbd, spec = _sheets(display, seed, covered), "layered:samples=1:colour=nearest"
            eia = generate(rgbd, display, f"{spec}:fill=hidden")
            sources = find_sources(rgbd, display, f"{spec}:fill=none")
            oracle = HoleFill(display, rgbd, sources)
            holes = np.argwhere(sources == HOLE)[:: 1 + 4 // effort]
            light = [oracle.light(row, column) for row, column in holes]
            expected = [np.zeros(3) if color is None else color for color in light]
            yield is_true(f"{name}, {covered}: holes", len(holes) > 50, len(holes))
            case = f"{name}, {covered}"
            yield difference(case, eia[tuple(holes.T)], np.array(expected), 1e-5)


def _sheets(display: Display, seed: int, covered: float) -> LayeredRGBD:
    """Squares of 4 x 4 pixels, thin and rough, at random depths; some are missing."""
    rng = np.random.default_rng(seed)
    shape = display.capture_shape(2)
    blocks = tuple(-(-n // 4) for n in shape)
    low, high = display.depth_range_mm

    def spread(values: np.ndarray) -> np.ndarray:
        return np.kron(values, np.ones((4, 4)))[: shape[0], : shape[1]]

    depth = spread(low + 2 + (high - low - 4) * rng.random(blocks)) + rng.uniform(-2, 2, shape)
    front = depth.astype(np.float32)
    color = rng.random((*shape, 3)).astype(np.float32)
    mask = spread((rng.random(blocks) < covered).astype(float)) > 0
    return LayeredRGBD(color, front, mask, display.pitch_mm / 2, front - np.float32(0.5), ())
