"""Importing the package, and its names in any order, in fresh processes."""

from types import ModuleType

import inim
from tests.conftest import run_python


def test_importing_the_package_loads_no_large_module_and_sets_no_variant():
    loaded = run_python(
        "import sys, inim; dir(inim); print([m for m in "
        "('numpy', 'mitsuba', 'drjit', 'numba', 'skimage', 'trimesh') if m in sys.modules])"
    )
    assert loaded == "[]"


VIEW = """
import numpy as np
display = inim.Display(pitch_mm=1, focal_length_mm=3, gap_mm=3.3, pixel_pitch_mm=0.125,
                       lens_columns=4, lens_rows=3)
eia = np.ones((24, 32, 3), np.float32)
print(inim.reconstruct(eia, display, inim.Viewpoint("eye", 0, 0, 200), spp=4).shape)
"""


def test_a_view_can_be_asked_for_after_another_choice_of_the_variant():
    before = """
import inim
from inim.system import backend
backend.activate(backend.choose_backend())
import mitsuba
mitsuba.set_variant("llvm_ad_rgb")
"""
    assert run_python(before + VIEW) == "(12, 16, 3)"


def test_static_list_of_names_is_that_of_the_loaded_ones():
    assert sorted([*inim._HOME, "__version__"]) == sorted(inim.__all__)
    for name in inim._HOME:
        value = getattr(inim, name)
        assert not isinstance(value, ModuleType) and (name == "DISPLAYS" or value.__doc__)
