"""The variant borrowed from a program that has an active one, and its return."""

import pytest

from inim.system.backend import Backend
from inim.system.errors import UsageError

pytestmark = pytest.mark.usefixtures("renderer")


@pytest.mark.parametrize(
    ("active", "borrowed", "used"),
    [
        ("llvm_ad_rgb", "auto", "llvm_ad_rgb"),
        ("llvm_ad_spectral_polarized", "auto", "llvm_ad_rgb"),
        ("cuda_ad_mono", "auto", "cuda_ad_rgb"),
        ("cuda_ad_rgb", "cuda", "cuda_ad_rgb"),
        ("cuda_ad_rgb", "llvm", "chosen for llvm"),
        ("llvm_ad_rgb", "cuda", "chosen for cuda"),
        ("scalar_rgb", "auto", "chosen for auto"),
        ("", "auto", "chosen for auto"),
    ],
)
def test_the_active_backend_is_kept_where_it_may_be(monkeypatch, active, borrowed, used):
    from inim.render import variant

    def choose(borrowed: str) -> Backend:
        return Backend("chosen", f"chosen for {borrowed}", None, None, "")

    monkeypatch.setattr(variant.backends, "choose_backend", choose)
    monkeypatch.setattr(variant.backends, "activate", lambda backend: None)
    assert variant._choose_variant(active, borrowed) == used


def test_variant_and_threads_come_back_after_any_exception():
    import drjit as dr
    import mitsuba as mi

    from inim.render import variant

    before, threads = mi.variant(), dr.thread_count()
    try:
        mi.set_variant("llvm_ad_mono")
        dr.set_thread_count(1)
        with pytest.raises(KeyboardInterrupt), variant.temporary():
            assert (mi.variant(), dr.thread_count()) == ("llvm_ad_rgb", 2)
            raise KeyboardInterrupt
        assert (mi.variant(), dr.thread_count()) == ("llvm_ad_mono", 1)
        with pytest.raises(UsageError, match="backend 'gpu' is unknown"), variant.temporary("gpu"):
            pass
    finally:
        dr.set_thread_count(threads)
        mi.set_variant(before)
