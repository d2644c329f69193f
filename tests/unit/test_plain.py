"""The algorithms of the paper give one result, compiled or plain, on any number of threads."""

from __future__ import annotations

import importlib
from types import FunctionType

import numba
import numpy as np
import pytest

from inim.display import Display
from inim.errors import UsageError
from inim.generators import (
    HOLE,
    NO_LENS,
    SourceGenerator,
    check_algorithm,
    find_sources,
    generate,
    plain,
    prepare,
)
from inim.generators.plain import compiled
from inim.image.rgbd import RGBD
from tests.conftest import small_display

ALGORITHMS = [
    "li2012",
    "li2012:fill=hidden",
    "gu2020",
    "gu2020:step_mm=0.9",
    "wang2024",
    "wang2024:matching=ray",
]
DISPLAYS = {
    "integer": small_display(3, 2, pixels=5, depth_min_mm=26.0, depth_max_mm=41.0),
    # 15.7 pixels per lens, and a panel larger than the array.
    "phone": small_display(3, 2, pixel_pitch_mm=0.0636, panel_columns=60),
    "virtual": small_display(3, 2, pixels=4, focal_length_mm=3.6, gap_mm=3.3),
}


def rough(shown: Display, as_shown: bool = False, shape: tuple[int, int] = (25, 30)) -> RGBD:
    random = np.random.default_rng(7)
    depth = random.uniform(*shown.depth_range_mm, shape)
    covered = random.random(shape) < 0.8
    color = random.random((*shape, 3))
    if as_shown:
        color = np.concatenate([1 + 250 * color, np.full((*shape, 1), 255)], axis=2)
    return RGBD(color.astype(np.uint8) if as_shown else color, depth, covered, 0.2717)


@pytest.mark.parametrize("name", DISPLAYS)
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_plain_python_and_compiled_code_agree_to_the_bit(
    algorithm: str, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = DISPLAYS[name]
    rgbd = rough(shown)
    sources, eia = find_sources(rgbd, shown, algorithm), generate(rgbd, shown, algorithm)
    assert sources.dtype == np.int32 and (sources >= 0).any()
    # As with NUMBA_DISABLE_JIT, but without another process.
    monkeypatch.setattr(plain, "compiled", lambda kernel: kernel)
    assert np.array_equal(find_sources(rgbd, shown, algorithm), sources)
    assert np.array_equal(generate(rgbd, shown, algorithm), eia)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_plain_python_calls_nothing_compiled(algorithm: str) -> None:
    module = importlib.import_module(f"inim.generators.{algorithm.split(':')[0]}")
    functions = [v for v in vars(module).values() if isinstance(v, FunctionType)]
    kernels = [f for f in functions if "prange" in f.__code__.co_names]
    assert kernels
    reached = set(kernels)
    while True:
        called = {f.__globals__.get(n) for f in reached for n in f.__code__.co_names}
        assert not any(isinstance(c, numba.core.dispatcher.Dispatcher) for c in called)
        found = reached | {c for c in called if isinstance(c, FunctionType)}
        if found == reached:
            break
        reached = found
    assert len(reached) > len(kernels)


def test_a_kernel_is_compiled_once_with_the_functions_it_calls() -> None:
    from inim.generators import gu2020

    assert compiled(gu2020._search_all) is compiled(gu2020._search_all)
    assert compiled(gu2020._search_all).py_func is not gu2020._search_all
    within = compiled(gu2020._search_all).py_func.__globals__
    assert within["_first_crossing"] is compiled(gu2020._first_crossing)
    assert within["prange"] is numba.prange


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_number_of_threads_changes_nothing(algorithm: str) -> None:
    shown = small_display(9, 8, pixels=7)
    rgbd = rough(shown, shape=(60, 60))
    at_first = numba.get_num_threads()
    found = []
    try:
        for threads in (1, min(2, numba.config.NUMBA_NUM_THREADS)):
            numba.set_num_threads(threads)
            found.append(generate(rgbd, shown, algorithm))
    finally:
        numba.set_num_threads(at_first)
    assert np.array_equal(*found)


@pytest.mark.parametrize("name", DISPLAYS)
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_uncovered_is_never_shown_whatever_its_depth(algorithm: str, name: str) -> None:
    shown = DISPLAYS[name]
    rgbd = rough(shown)
    sources = find_sources(rgbd, shown, algorithm)
    assert rgbd.covered.ravel()[sources[sources >= 0]].all()
    for depth in (np.nan, np.inf, -np.inf, 0.0):
        strange = np.where(rgbd.covered, rgbd.depth_mm, np.float32(depth))
        other = RGBD(rgbd.color, strange, rgbd.covered, rgbd.pixel_mm)
        assert np.array_equal(find_sources(other, shown, algorithm), sources)
    nothing = RGBD(rgbd.color, rgbd.depth_mm, np.zeros(rgbd.shape, bool), rgbd.pixel_mm)
    assert (find_sources(nothing, shown, algorithm) < 0).all()
    assert (generate(nothing, shown, algorithm) == 0).all()


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_panel_pixels_beside_the_array_have_no_lens(algorithm: str) -> None:
    shown = DISPLAYS["phone"]
    assert shown.pixels_per_lens == pytest.approx(15.72, abs=0.01)
    sources = find_sources(rough(shown), shown, algorithm)
    beside = shown.columns.lens < 0
    assert beside.any()
    assert (sources[:, beside] == NO_LENS).all() and (sources[:, ~beside] >= HOLE).all()


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_display_ready_colours_come_out_as_they_are(algorithm: str) -> None:
    shown = DISPLAYS["phone"]
    rgbd = rough(shown, as_shown=True)
    made = prepare(shown, algorithm, shape=rgbd.shape, pixel_mm=rgbd.pixel_mm)
    assert isinstance(made, SourceGenerator)
    out = np.full((*shown.eia_shape, 4), 99, np.uint8)
    assert made.generate(rgbd, out) is out
    sources = made.sources(rgbd)
    assert np.array_equal(out[sources >= 0], rgbd.color.reshape(-1, 4)[sources[sources >= 0]])
    assert (out[sources == NO_LENS] == 0).all()
    assert set(np.unique(out[..., 3])) == {0, 255}
    with pytest.raises(UsageError, match="out is"):
        made.generate(rgbd, np.zeros((3, 3, 4), np.uint8))


@pytest.mark.parametrize(
    ("text", "choices"),
    [
        ("wang2024:matching=diagonal", "matrix or ray"),
        ("li2012:fill=telea", "none or hidden or all"),
    ],
)
def test_value_an_option_does_not_have_is_refused_by_name(text: str, choices: str) -> None:
    option, value = text.split(":")[1].split("=")
    with pytest.raises(UsageError, match=f"{option} = '{value}': use {choices}"):
        prepare(DISPLAYS["integer"], text, shape=(4, 4), pixel_mm=1.0)


def test_options_are_those_of_the_algorithm() -> None:
    for text in ALGORITHMS:
        check_algorithm(text)
    with pytest.raises(UsageError, match="'gu2020' has no option 'samples'"):
        check_algorithm("gu2020:samples=4")
