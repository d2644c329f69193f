"""Properties of an algorithm are in its own file and are read without loading it."""

from dataclasses import dataclass
from importlib.metadata import EntryPoint
from types import SimpleNamespace

import pytest

from inim.generators import (
    algorithm,
    algorithm_names,
    is_own,
    option,
    parse_algorithm,
    registry,
)
from inim.image.rgbd import RGBD, LayeredRGBD
from inim.system import plugins
from inim.system.errors import UsageError
from tests.conftest import run_python

OWN = ["template", "cameras", "gu2020", "layered", "li2012", "wang2024"]


def prepare_plain(display, shape, pixel_mm, *, brightness=1.0):
    """Without properties."""


@algorithm(exact=True, color="#123456")
def prepare_stated(display, shape, pixel_mm, *, mask=None, slow="no"):
    """Generator with properties."""


@dataclass(frozen=True)
class Declared:
    z_mm: float = option(10.0, "depth", lambda name, value: float(value))


@algorithm(Declared)
def prepare_rays(rays, options):
    """Rays with a declared option."""


@pytest.fixture
def announced(monkeypatch):
    """Three algorithms of another package."""
    points = [
        EntryPoint(name, f"{__name__}:prepare_{name}", registry._ENTRY_POINTS)._for(
            SimpleNamespace(name="theirs")
        )
        for name in ("plain", "rays", "stated")
    ]

    def entry_points(*, group, name=None):
        assert group == registry._ENTRY_POINTS
        return [p for p in points if name in (None, p.name)]

    monkeypatch.setattr(plugins, "metadata", SimpleNamespace(entry_points=entry_points))
    monkeypatch.syspath_prepend("another search path")


def test_an_algorithm_of_our_own_is_found_by_its_file():
    assert [n for n in algorithm_names() if is_own(n)] == OWN
    assert not is_own("base") and not is_own("raycast")


def test_properties_of_our_own_load_no_compiler_and_no_renderer():
    code = (
        "import sys; from inim.generators import algorithm_names, is_own, parse_algorithm\n"
        "for n in filter(is_own, algorithm_names()): parse_algorithm(n)\n"
        "print([m for m in ('numba', 'mitsuba', 'scipy', 'skimage') if m in sys.modules])"
    )
    assert run_python(code) == "[]"


def test_options_in_a_mapping_are_refused_with_the_keyword_form():
    with pytest.raises(UsageError, match=r'is a dict; .*generate\(..., "gu2020", samples=4\)'):
        parse_algorithm({"gu2020": {"samples": 4}})


def test_what_our_own_state():
    assert {n for n in OWN if parse_algorithm(n).exact} == {"template", "layered", "cameras"}
    assert {n for n in OWN if parse_algorithm(n).portable} == {"template"}
    assert {n for n in OWN if parse_algorithm(n).reads is LayeredRGBD} == {"layered"}
    assert parse_algorithm("cameras:views=3x3").input == "3x3"
    colors = [parse_algorithm(n).color for n in OWN]
    assert None not in colors and len(set(colors)) == len(colors)


@pytest.mark.usefixtures("announced")
def test_another_package_states_its_properties_or_does_not():
    assert algorithm_names() == [*OWN, "plain", "rays", "stated"]
    plain, stated = parse_algorithm("plain:brightness=2"), parse_algorithm("stated:slow=yes")
    assert not (plain.own or plain.exact or plain.takes_mask)
    assert plain.reads is RGBD
    assert plain.color is None
    assert stated.exact and stated.color == "#123456" and stated.takes_mask
    assert not stated.own
    assert registry.algorithm_summary("stated") == ("stated:slow=no", "Generator with properties.")


@pytest.mark.usefixtures("announced")
def test_an_invalid_option_of_another_package_is_a_usage_error_that_names_it():
    expected = "'rays:z_mm=abc' of package theirs failed: ValueError: could not convert string"
    with pytest.raises(UsageError, match=expected):
        parse_algorithm("rays:z_mm=abc")


def test_properties_of_an_unknown_algorithm_are_refused():
    with pytest.raises(UsageError, match="use template or cameras or"):
        parse_algorithm("nobody's")
