"""Several rays per pixel, for every algorithm.

Expected: the four rays of a pixel are the centres of the pixels of a panel twice as fine; forward
mapping keeps the picture pixel that lands nearest to each sample point; and an algorithm's own
sources are those of the centres, whatever the samples.
"""

import pickle
from dataclasses import dataclass, replace

import numpy as np
import pytest

from inim.display.pixels import pixel_rays
from inim.generators import (
    HOLE,
    Algorithm,
    SourceGenerator,
    algorithm,
    each_ray,
    find_sources,
    generate,
    option,
    parse_algorithm,
    prepare,
    registry,
)
from inim.generators.options import positive_mm
from inim.image.rgbd import RGBD
from inim.system.errors import UsageError
from tests.conftest import small_display
from tests.generator_cases import DISPLAYS, REAL, picture

RAYS = ["template:columns=solid", "gu2020:step_mm=0.4", "wang2024:matching=ray"]


@pytest.mark.parametrize("algorithm", RAYS)
def test_four_rays_of_a_pixel_are_the_centres_of_a_panel_twice_as_fine(algorithm):
    display, rgbd = DISPLAYS["even pixels"], picture("even pixels", "random, sparse, odd size")
    fine = display.replace(pixel_pitch_mm=display.pixel_pitch_mm / 2)
    one_by_one = generate(rgbd, fine, algorithm, samples=1, colour="nearest")
    rows, columns = display.eia_shape
    mean = one_by_one.reshape(rows, 2, columns, 2, 3).mean(axis=(1, 3))
    four = generate(rgbd, display, algorithm, samples=4, colour="nearest")
    np.testing.assert_allclose(four, mean, atol=1e-6)
    assert (four != generate(rgbd, display, algorithm, samples=1, colour="nearest")).any()


def test_forward_mapping_keeps_the_pixel_that_lands_nearest_to_each_sample_point():
    display, z = small_display(5, 4, 8, **REAL), 20.0
    shape, pixel = display.capture_shape(16), display.pitch_mm / 16
    color = np.random.default_rng(3).random((*shape, 3), dtype=np.float32)
    rgbd = RGBD(color, np.full(shape, z, np.float32), np.ones(shape, bool), pixel)
    generator = prepare(display, "li2012:samples=4", shape=shape, pixel_mm=pixel)
    centre = np.arange(display.eia_shape[1]) - (display.eia_shape[1] - 1) / 2
    for ray, sources in generator.sources_of_rays(rgbd):
        at_mm = (centre + float(ray.pixel_offset.right)) * display.pixel_pitch_mm
        x0 = display.columns.centre_mm
        column = sources % shape[1]
        lands_mm = x0 + (x0 - (column + 0.5 - shape[1] / 2) * pixel) * display.gap_mm / z
        spacing_mm = pixel * display.gap_mm / z
        off = np.abs(lands_mm - at_mm)[sources >= 0]
        assert (sources >= 0).mean() > 0.5
        assert off.max() <= spacing_mm / 2 + 1e-9


@pytest.mark.parametrize(
    ("algorithm", "display"),
    [
        (algorithm, display)
        for algorithm in ("gu2020", "wang2024:matching=ray", "li2012", "template")
        for display in ("stripes", "turned", "phone", "pentile, moved")
        if algorithm != "li2012" or DISPLAYS[display].is_separable
    ],
)
def test_samples_and_colours_change_no_source(algorithm, display):
    device, rgbd = DISPLAYS[display], picture(display, "layers")
    sources = find_sources(rgbd, device, algorithm)
    for words in ({"samples": "2", "colour": "smooth"}, {"samples": 4}, {"samples": "auto"}):
        assert np.array_equal(find_sources(rgbd, device, algorithm, **words), sources)
        assert generate(rgbd, device, algorithm, **words).any()


@dataclass(frozen=True)
class Options:
    z_mm: float = option(10.0, "depth of the whole picture", positive_mm)


@algorithm(Options)
def prepare_plane(rays, options):
    """The whole picture at one depth."""

    def find(rgbd, pixel_offset):
        block = pixel_rays(rays.display, slice(0, rays.display.eia_shape[0]), pixel_offset)
        x, y = block.x0 + block.slope_x * options.z_mm, block.y0 + block.slope_y * options.z_mm
        column = np.floor(x / rays.pixel_mm + rays.shape[1] / 2).astype(np.int32)
        row = np.floor(rays.shape[0] / 2 - y / rays.pixel_mm).astype(np.int32)
        inside = (row >= 0) & (row < rays.shape[0]) & (column >= 0) & (column < rays.shape[1])
        return np.where(inside, row * rays.shape[1] + column, HOLE).astype(np.int32)

    return each_ray(rays, find)


@pytest.mark.parametrize("display", ["odd pixels", "stripes", "turned"])
def test_a_package_that_finds_rays_has_all_options(display, monkeypatch):
    """It shows a large picture at that depth as `template` does, up to rounding."""
    declared = replace(prepare_plane.__inim_algorithm__, name="plane")
    find = registry.find_algorithm
    monkeypatch.setattr(registry, "find_algorithm", lambda n: declared if n == "plane" else find(n))
    device, shape = DISPLAYS[display], (95, 115)
    color = np.random.default_rng(3).random((*shape, 3), dtype=np.float32)
    rgbd = RGBD(color, np.full(shape, 12.5, np.float32), np.ones(shape, bool), 0.0931)
    for words in ("samples=4:colour=smooth:fill=none", "samples=2:colour=nearest"):
        plane = generate(rgbd, device, f"plane:z_mm=12.5:{words}")
        exact = generate(rgbd, device, f"template:columns=solid:{words}")
        assert (np.abs(plane - exact).max(axis=-1) > 1e-5)[device.lensed].mean() < 0.02


def test_rays_off_the_centre_are_refused_where_a_package_has_none(monkeypatch):
    class Centre(SourceGenerator):
        def find(self, rgbd):
            return np.zeros(self.display.eia_shape, np.int32)

    plain = Algorithm("plain", Centre, options={})
    monkeypatch.setattr(registry, "find_algorithm", lambda name: plain)
    size = {"shape": (9, 9), "pixel_mm": 0.5}
    assert prepare(small_display(), "plain:colour=smooth:fill=hidden", **size)
    with pytest.raises(UsageError, match=r"'plain' has rays through the centres .* samples=centre"):
        prepare(small_display(), "plain:samples=4", **size)


def test_an_algorithm_is_a_value_that_can_be_sent_to_another_process():
    algorithm = parse_algorithm("gu2020:samples=4", colour="smooth")
    assert pickle.loads(pickle.dumps(algorithm)) == algorithm
    assert str(algorithm) == "gu2020:samples=4:colour=smooth"
    with pytest.raises(UsageError, match="gu2020: step_mm = 'x': it must be a positive length"):
        parse_algorithm("gu2020:step_mm=x")
