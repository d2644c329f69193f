"""Memory that is short: passes shrink before a run is refused, and never exceed what there is."""

import pytest

from inim.pipeline.plan import LEAST_BYTES, make_plan, rays_in_flight
from inim.pipeline.request import Request
from inim.system.errors import OutOfMemoryError
from tests.system.conftest import write_scene

GIB = 2**30


def test_passes_shrink_by_halves_as_memory_goes_and_then_there_are_none():
    limits = range(4 * GIB, GIB, -(2**20))
    rays = [rays_in_flight(limit, GIB // 4) for limit in limits]
    assert rays[0] == 2**22
    assert sorted(set(rays), reverse=True) == [*(2**n for n in range(22, 15, -1)), 0]
    assert rays == sorted(rays, reverse=True)


def test_pictures_and_rays_together_stay_below_the_limit():
    """Checks the plan's own figure for a ray: the memory of one more beyond the fewest."""
    bytes_per_ray = (LEAST_BYTES - 2 * GIB) / 2**16
    for limit in range(2 * GIB, 4 * GIB, 2**24):
        for pictures in (0, GIB // 3, GIB):
            rays = rays_in_flight(limit, pictures)
            if rays:
                assert 2 * GIB + pictures + rays * bytes_per_ray <= limit
            else:
                assert LEAST_BYTES + pictures > limit


def test_unknown_memory_limits_nothing():
    assert rays_in_flight(0, 10**15) == 2**22


@pytest.mark.parametrize("spare", [-1, 0, 2**26])
def test_a_plan_is_refused_only_where_the_smallest_passes_do_not_fit(spare, tmp_path, monkeypatch):
    request = Request(write_scene(tmp_path), tmp_path / "out", algorithms=("template",))
    plenty = make_plan(request)
    assert plenty.rays_in_flight == 2**22
    least = LEAST_BYTES + plenty.images_bytes
    monkeypatch.setattr("inim.system.process.machine.memory_limit_bytes", lambda: least + spare)
    if spare < 0:
        with pytest.raises(OutOfMemoryError, match=r"available \d.\d GiB; lower inim.view"):
            make_plan(request)
    else:
        assert make_plan(request).rays_in_flight == (2**16 if spare == 0 else 2**20)
