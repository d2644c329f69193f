"""The analytic `thick` model against the lens array as a mesh that Mitsuba traces.

Expected behaviour: for lenses that bulge either way, seen obliquely, both give the same view of an
EIA without any symmetry. Views are compared lens by lens, with Welch's t-test on the means over
independent seeds, and by their brightness as a whole; the level is 1 per cent, after Sidak, over
all comparisons of a view. The same comparison rejects a model that is 1 per cent too bright and
one that lands half a panel pixel aside.
"""

import numpy as np
import pytest
from scipy import stats

from inim.display import Viewpoint
from inim.display.lens.full import facets_per_lens, sheet_mesh
from inim.display.settings import Settings
from tests.conftest import small_display

pytestmark = pytest.mark.usefixtures("renderer")

LENSES = (7, 9)
PER_LENS = 4
SEEDS = range(12)
SPP = 256
LEVEL = 0.01
EYE = Viewpoint("oblique", 11.0, -8.0, 120.0)
BULGES = pytest.mark.parametrize("bulge", ["viewer", "panel"])
PECULIAR = {
    "conic": {"conic": -0.6, "asphere_a4": 0.02},
    "mounted askew": {
        "rotation_deg": 4.0, "shift_x_mm": 0.21, "tilt_x_deg": 3.0, "tilt_y_deg": -2.0,
    },
    "colours": {"abbe_number": 20.0},
    "cylinders": {
        "lattice": "lenticular", "lens_rows": 1, "panel_columns": 72, "panel_rows": 56,
        "rotation_deg": -8.0, "shift_x_mm": 0.21, "subpixels": "rgb-stripe", "tilt_x_deg": 1.0,
    },
}  # fmt: skip


def display_of(**changes):
    columns, rows = LENSES[1], changes.pop("lens_rows", LENSES[0])
    return small_display(columns, rows, pixels=8, **changes)


def picture_for(display):
    """Random colours: no symmetry, and neighbours as unlike as can be."""
    return np.random.default_rng(11).random((*display.eia_shape, 3)).astype(np.float32)


def by_lens(view):
    """Means of a view over each lens, (lenses, 3) float64."""
    rows, columns = LENSES
    cells = view.astype(np.float64).reshape(rows, PER_LENS, columns, PER_LENS, 3)
    return cells.mean(axis=(1, 3)).reshape(-1, 3)


def calculated(eia, display):
    """Light by lens, for each seed, through `thick` lenses: (seeds, lenses, 3)."""
    from inim.render.reconstruct import DisplayScene

    scene = DisplayScene(eia, display, "thick")
    looks = [scene.view(EYE, pixels_per_lens=PER_LENS, spp=SPP, seed=5000 + seed) for seed in SEEDS]
    return np.stack([by_lens(look) for look in looks])


def traced(eia, display, finer=4, spp=SPP):
    """The same through the mesh, its facets finer than a validation's so many times along a side.

    Sobol' points leave so little noise that a validation's own facets, which depart from the curve
    by hundredths of a panel pixel, would be seen; their error falls with the square of their size.
    """
    from inim.render.rays import eye_rays
    from inim.render.reconstruct import LensMesh
    from inim.render.trace import FilmCamera, mean_light

    mesh = LensMesh(eia, display, sheet_mesh(display, finer * facets_per_lens(display)))
    rays = eye_rays(display, EYE, PER_LENS, mesh.start_mm)
    light = mesh.light(FilmCamera(rays, np.eye(4)))
    looks = [mean_light(light, rays.shape, spp, seed) for seed in SEEDS]
    return np.stack([by_lens(look) for look in looks])


def least_p(first, second):
    """The smallest p of all comparisons, and the one below which they disagree."""
    apart = stats.ttest_ind(first, second, axis=0, equal_var=False).pvalue
    whole = stats.ttest_ind(
        first.mean(axis=(1, 2)), second.mean(axis=(1, 2)), equal_var=False
    ).pvalue
    p_values = np.append(apart.ravel(), whole)
    assert np.isfinite(p_values).all(), "every lens is seen, and every seed is another"
    return float(p_values.min()), 1 - (1 - LEVEL) ** (1 / p_values.size)


def test_a_view_through_full_lenses_is_that_of_a_validation_s_mesh():
    from inim.render.reconstruct import DisplayScene

    display = display_of()
    eia = picture_for(display)
    scene = DisplayScene(eia, display, "full")
    view = scene.view(EYE, pixels_per_lens=PER_LENS, spp=16, seed=SEEDS[3])
    assert np.array_equal(by_lens(view), traced(eia, display, finer=1, spp=16)[3])


def test_each_glass_is_traced_by_a_kernel_of_its_own():
    """A card's kernel traces rays in one scene: in a second one they would hit nothing."""
    import drjit as dr

    from inim.render.rays import eye_rays
    from inim.render.reconstruct import LensMesh
    from inim.render.trace import FilmCamera, trace_samples

    display = display_of(**PECULIAR["colours"])
    mesh = LensMesh(picture_for(display), display, sheet_mesh(display, 2))
    rays = eye_rays(display, EYE, PER_LENS, mesh.start_mm)
    light = mesh.light(FilmCamera(rays, np.eye(4)))
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        trace_samples(light, np.arange(50), 0, 15, 0)
        kernels = dr.kernel_history([dr.KernelType.JIT])
    assert [kernel["size"] for kernel in kernels].count(50 * 15) == 3


@pytest.mark.parametrize(
    ("bulge", "kind"),
    [
        ("viewer", "plain"),
        pytest.param("panel", "plain", marks=pytest.mark.slow),
        *(
            pytest.param(bulge, kind, marks=pytest.mark.slow)
            for bulge in ("viewer", "panel")
            for kind in PECULIAR
        ),
    ],
)
def test_thick_and_full_agree(bulge, kind):
    display = display_of(curved_side=bulge, **PECULIAR.get(kind, {}))
    eia = picture_for(display)
    smallest, threshold = least_p(traced(eia, display), calculated(eia, display))
    assert smallest > threshold


@pytest.mark.slow
@BULGES
def test_one_per_cent_and_half_a_pixel_would_be_seen(bulge):
    display = display_of(curved_side=bulge)
    eia = picture_for(display)
    mesh = traced(eia, display)
    smallest, threshold = least_p(mesh, 1.01 * calculated(eia, display))
    assert smallest < threshold, "1 per cent of weight"
    # The same panel in pixels of half the size, moved by one of them.
    finer = display.replace(pixel_pitch_mm=display.pixel_pitch_mm / 2)
    fine = eia.repeat(2, axis=0).repeat(2, axis=1)
    smallest, threshold = least_p(mesh, calculated(fine, finer))
    assert smallest > threshold, "finer pixels of equal colours are the same panel"
    for axis in (0, 1):
        smallest, threshold = least_p(mesh, calculated(np.roll(fine, 1, axis), finer))
        assert smallest < threshold, "half a panel pixel"


@pytest.mark.slow
@BULGES
def test_finer_facets_change_less_than_the_noise(bulge):
    """A view has as many samples as a validation's; equal seeds make equal choices.

    So what is left of the difference is the facets'.
    """
    display = display_of(curved_side=bulge)
    eia = picture_for(display)
    spp = Settings().reconstruction_spp
    coarse, fine = (traced(eia, display, finer, spp) for finer in (1, 4))
    noise = coarse.std(axis=0, ddof=1)
    change = np.abs(coarse.mean(axis=0) - fine.mean(axis=0))
    assert (noise > 0).all()
    # Half of the noise, added in squares, makes it an eighth larger.
    assert np.sqrt((change**2).mean()) < 0.5 * np.sqrt((noise**2).mean())
