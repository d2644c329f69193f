"""`layered`: first hits in pictures that know what lies behind their front surface."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from inim.display import Display
from inim.errors import UsageError
from inim.generators import find_sources, generate, prepare
from inim.generators.raycast.columns import LAYERS
from inim.generators.raycast.ray_by_ray import NonSeparable, RayByRay
from inim.generators.raycast.shared_directions import SharedDirections
from inim.image.rgbd import RGBD, Layer, LayeredRGBD
from inim.stress.pictures import noise, solids_of
from reports.stress.study.cases import ties
from tests import oracle
from tests.conftest import small_display

VIRTUAL = {"focal_length_mm": 3.3, "gap_mm": 3.0}


def picture(display: Display, per_pitch: int, layers: int, *, seed: int = 1, rgba: bool = False):
    """Random solids, most of them thin, behind one another; each layer sparser than the one before.

    Depths are float32 numbers, exact for the oracle.
    """
    rows, columns = display.capture_shape(per_pitch)
    random = np.random.default_rng(seed)
    low, high = display.depth_range_mm
    covered = random.random((rows, columns)) < 0.6
    above = np.full((rows, columns), high)
    made = []
    for _ in range(layers):
        front = np.float32(low + (above - low) * random.random((rows, columns)))
        back = np.float32(front - (front - low) * random.random((rows, columns)) ** 3)
        back = np.minimum(back, front)
        color = random.random((rows, columns, 3), dtype=np.float32)
        if rgba:
            color = random.integers(1, 256, (rows, columns, 4), dtype=np.uint8)
        made.append(Layer(color, front, back, covered))
        above, covered = back, covered & (random.random((rows, columns)) < 0.6)
    first = made[0]
    return LayeredRGBD(
        first.color, first.front_mm, first.covered, display.pitch_mm / per_pitch,
        first.back_mm, tuple(made[1:]),
    )  # fmt: skip


def exact(rgbd: RGBD, display: Display) -> np.ndarray:
    """Sources by the definition, in rational numbers."""
    return oracle.exact_sources(rgbd, display, "layers")


@pytest.mark.parametrize("layers", [1, 2, 4])
@pytest.mark.parametrize("mode", [{}, VIRTUAL], ids=["real", "virtual"])
@pytest.mark.parametrize(("lenses", "pixels"), [((5, 4), 7), ((4, 3), 6)])
def test_every_pixel_shows_the_solid_of_the_definition(layers, mode, lenses, pixels):
    display = small_display(*lenses, pixels=pixels, **mode)
    rgbd = picture(display, 2, layers)
    found = find_sources(rgbd, display, "layered", samples=1)
    wanted = exact(rgbd, display)
    assert np.array_equal(found, wanted)
    if layers > 1:  # or the test says nothing about layers
        assert (wanted >= rgbd.shape[0] * rgbd.shape[1]).mean() > 0.02


@pytest.mark.parametrize("ulps", [-1, 0, 1])
def test_backs_at_the_very_depth_where_a_ray_enters_are_exact(ulps):
    """Fronts and backs at the float32 nearest to a border's depth, or next to it.

    Entries rounded up, as exits are, took a solid for begun an ulp before it was.
    """
    display = small_display(3, 3, pixels=8, gap_mm=4.0)
    plain = tied(display, ulps)
    rgbd = solids_of(plain, display)
    wanted = exact(rgbd, display)
    assert np.array_equal(find_sources(rgbd, display, "layered", samples=1), wanted)
    assert len(np.unique(wanted // plain.depth_mm.size)) > 2  # two layers and holes at least


def tied(display: Display, ulps: int) -> RGBD:
    """Every picture pixel at a depth at which some ray leaves it, to the ulp."""
    (case,) = [c for c in ties() if c.label == f"lists, binary lengths, {ulps:+d} ulp"]
    made, rgbd = case.make()
    assert made == display
    return rgbd


def test_rays_and_tables_without_end_are_refused_or_walked():
    """A picture of 50,000 pixels per pitch took 894 GiB as tables."""
    fine = small_display(3, 3, pixels=5, depth_min_mm=1e-3, depth_max_mm=1.5e-3)
    rgbd = solids_of(noise(fine, (16, 16), 2e-5), fine)
    assert (find_sources(rgbd, fine, "layered", samples=1) >= 0).any()
    far = small_display(2, 2, pixels=3, gap_mm=3.0 * (1 + 2.0**-24))
    for display in (far, far.replace(rotation_deg=4.0)):
        for algorithm in ("layered", "template"):
            with pytest.raises(UsageError, match=f"{algorithm}: a ray crosses .* make sense"):
                prepare(display, algorithm, shape=(9, 9), pixel_mm=0.5)


@pytest.mark.parametrize("per_pitch", [1, 2, 5])
@pytest.mark.parametrize("lenses", [(1, 1), (7, 5), (33, 3), (70, 2)])
@pytest.mark.parametrize("layers", [1, 3])
def test_lists_shared_by_all_lenses_and_single_rays_agree(per_pitch, lenses, layers):
    display = small_display(*lenses, pixels=7)
    rgbd = picture(display, per_pitch, layers, seed=per_pitch)
    shared = SharedDirections(display, rgbd.shape, rgbd.pixel_mm, LAYERS)
    alone = RayByRay(display, rgbd.shape, rgbd.pixel_mm, LAYERS)
    assert np.array_equal(shared.sources(rgbd), alone.sources(rgbd))


def test_rays_that_share_nothing_agree_but_for_ties():
    display = small_display(9, 7, pixels=7)
    # Of an odd size: rays along diagonals meet no corners of cells.
    rgbd = replace(picture(display, 3, 3), pixel_mm=0.2717)
    free = NonSeparable(display, rgbd.shape, rgbd.pixel_mm, LAYERS).sources(rgbd)
    exact_rays = RayByRay(display, rgbd.shape, rgbd.pixel_mm, LAYERS).sources(rgbd)
    assert (free != exact_rays).mean() < 0.02


def test_a_prepared_generator_takes_pictures_with_more_and_fewer_layers():
    display = small_display(6, 5, pixels=7)
    pictures = [picture(display, 2, layers, seed=layers) for layers in (1, 3, 2)]
    made = prepare(
        display, "layered:samples=1", shape=pictures[0].shape, pixel_mm=pictures[0].pixel_mm
    )
    for rgbd in pictures:
        alone = RayByRay(display, rgbd.shape, rgbd.pixel_mm, LAYERS)
        assert np.array_equal(made.sources(rgbd), alone.sources(rgbd))


@pytest.mark.parametrize("samples", [1, 2, 4])
@pytest.mark.parametrize("rgba", [False, True])
def test_a_picture_without_layers_shows_what_template_shows(samples, rgba):
    display = small_display(8, 6, pixels=7)
    layered = picture(display, 2, 1, rgba=rgba)
    plain = RGBD(layered.color, layered.depth_mm, layered.covered, layered.pixel_mm)
    assert np.array_equal(
        generate(plain, display, "layered", samples=samples),
        generate(plain, display, "template", samples=samples),
    )


def test_other_generators_see_the_front_surface_alone():
    display = small_display(6, 5, pixels=7)
    layered = picture(display, 2, 3)
    plain = RGBD(layered.color, layered.depth_mm, layered.covered, layered.pixel_mm)
    for name in ("template", "gu2020", "li2012"):
        assert np.array_equal(generate(layered, display, name), generate(plain, display, name))


def test_a_ray_passes_under_a_floating_plate_and_shows_what_is_behind():
    display = small_display(9, 9, pixels=9)
    rows, columns = display.capture_shape(2)
    low, high = display.depth_range_mm
    middle = np.zeros((rows, columns), bool)
    middle[rows // 2 - 4 : rows // 2 + 4, columns // 2 - 4 : columns // 2 + 4] = True
    red, blue = np.zeros((2, rows, columns, 3), np.float32)
    red[..., 0], blue[..., 2] = 1, 1
    wall = np.full((rows, columns), low + 0.1 * (high - low), np.float32)
    plate = np.full((rows, columns), high - 0.1 * (high - low), np.float32)
    everywhere = np.ones((rows, columns), bool)
    # Where the plate is, it is the front and the wall lies behind; elsewhere the wall is the front.
    front = np.where(middle, plate, wall)
    back = np.where(middle, plate - np.float32(0.5), -np.inf).astype(np.float32)
    color = np.where(middle[..., None], red, blue)
    behind = Layer(blue, wall, np.full_like(wall, -np.inf), middle)
    layered = LayeredRGBD(color, front, everywhere, display.pitch_mm / 2, back, (behind,))
    solid = RGBD(color, front, everywhere, display.pitch_mm / 2)
    floating = generate(layered, display, "layered", samples=1)
    column = generate(solid, display, "template")
    # Taken for a column, the plate shows its sides; floating, it hides the wall only with its face.
    assert (floating[..., 0] > 0).sum() < 0.8 * (column[..., 0] > 0).sum()
    # No pixel looks into nothing: the wall goes on behind the plate.
    lensed = display.lensed
    assert (floating[lensed].sum(axis=-1) > 0).all()


@pytest.mark.parametrize("samples", [0, 3, "many"])
def test_other_sample_counts_are_refused(samples):
    with pytest.raises(UsageError, match="layered: samples"):
        prepare(small_display(2, 2), "layered", shape=(8, 8), pixel_mm=0.5, samples=samples)
