"""Calls in a program that uses Mitsuba itself: any order, any variant, and its state afterwards."""

import json
from functools import cache

import pytest

from inim.system.backend import choose_backend
from tests.conftest import run_python

PROGRAM = """
import json, random, sys
import numpy as np
{before}
import inim

def state():
    import drjit as dr
    import mitsuba as mi
    return [mi.variant(), dr.thread_count(), str(mi.log_level()),
            np.random.get_state()[1].tolist(), list(random.getstate()[1])]

display = inim.Display(pitch_mm=1, focal_length_mm=3, gap_mm=3.3, pixel_pitch_mm=0.125,
                       lens_columns=4, lens_rows=3)
eia = np.linspace(0, 1, 24 * 32 * 3, dtype=np.float32).reshape(24, 32, 3)
eye = inim.Viewpoint("eye", 1, 2, 200)
was = state() if "mitsuba" in sys.modules else None
view = inim.reconstruct(eia, display, eye, spp=4, backend="{backend}")
after = state()
try:
    inim.reconstruct(eia, display, eye, "{wrong_model}", spp=4)
except inim.system.errors.InimError:
    failed = state()
{more}
print(json.dumps({{"before": was, "after": after, "failed": failed, "view": view.tolist()}}))
"""
NOT_MADE = "no such lens model"
# It names the LLVM for children that load Mitsuba before inim could.
pytestmark = pytest.mark.usefixtures("renderer")


def run(before: str, more: str = "", backend: str = "auto") -> dict:
    code = PROGRAM.format(before=before, more=more, wrong_model=NOT_MADE, backend=backend)
    code = code.replace("import inim\n", "import inim, inim.system.errors\n", 1)
    return json.loads(run_python(code).splitlines()[-1])


@cache
def inim_first(backend: str) -> dict:
    return run("", backend=backend)


def test_without_mitsuba_before_the_variant_used_stays():
    backend = choose_backend()
    state = inim_first(backend.name)
    assert state["before"] is None
    assert state["after"][0] == backend.variant


@pytest.mark.parametrize(
    "before",
    [
        pytest.param("import mitsuba", marks=pytest.mark.slow),
        pytest.param("import drjit", marks=pytest.mark.slow),
        pytest.param("import mitsuba as mi; mi.set_variant('llvm_ad_rgb')", marks=pytest.mark.slow),
        "import mitsuba as mi; mi.set_log_level(mi.LogLevel.Info)"
        "; mi.set_variant('llvm_ad_spectral')",
        pytest.param(
            "import mitsuba as mi; mi.set_variant('llvm_ad_mono_polarized')", marks=pytest.mark.slow
        ),
        "import mitsuba as mi, drjit as dr; mi.set_variant('scalar_rgb'); dr.set_thread_count(1)",
        pytest.param(
            "import mitsuba as mi; mi.set_variant('scalar_spectral_polarized')",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_mitsuba_s_state_is_restored(before):
    state = run(before)
    if state["before"] and state["before"][0]:
        assert state["after"] == state["before"], "a variant was active"
        assert state["failed"] == state["before"], "after an error, too"
    elif state["before"]:
        assert state["after"][1:] == state["before"][1:], "there is no way back to no variant"
    # The active variant's backend is kept, and backends round differently.
    backend = "llvm" if "'llvm_" in before else choose_backend().name
    assert state["view"] == inim_first(backend)["view"], "the same view, to the bit"


def test_a_program_s_own_objects_and_plugins_live_on():
    before = """
import mitsuba as mi
mi.set_variant("llvm_ad_spectral")
class Mine(mi.BSDF):
    pass
mi.register_bsdf("mine", Mine)
scene = mi.load_dict({"type": "scene", "light": {"type": "constant"}, "ball": {"type": "sphere"},
                      "sensor": {"type": "perspective", "film": {"type": "hdrfilm", "width": 4,
                                 "height": 4}}, "integrator": {"type": "path"}})
image = np.array(mi.render(scene, spp=4))
"""
    more = """
assert np.array_equal(np.array(mi.render(scene, spp=4)), image)
assert type(mi.load_dict({"type": "mine"})).__name__ == "Mine"
"""
    run(before, more)
