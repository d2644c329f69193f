"""Layers between panel and lenses: the parameter, its files, and what lens models do with it."""

import numpy as np
import pytest

from inim.display import DISPLAYS
from inim.display.lens import check_lens_model, trace_to_panel, white_exposure
from inim.render.scene_files.file import choose_display
from inim.system.errors import DisplayError

NOMINAL = DISPLAYS["nominal"]
GLASS = NOMINAL.replace(layers=[(0.5, 1.52), (0.1, 1.41)])
RAYS = (0.1, -0.2, 0.15, 0.1)
TOUCHING = "{:.17g} 1.52"


def test_display_files_and_definitions_have_layers(tmp_path):
    GLASS.save(tmp_path / "glass.xml")
    text = (tmp_path / "glass.xml").read_text()
    assert '<default name="inim.layers" value="0.5 1.52, 0.1 1.41"/>' in text
    display, _ = choose_display(tmp_path / "glass.xml")
    assert display.layers == GLASS.layers
    for words, layers in (("0.7 1.5", ((0.7, 1.5),)), ("none", ()), ([[1, 1.5]], ((1.0, 1.5),))):
        display, _ = choose_display(tmp_path / "glass.xml", {"inim.layers": words})
        assert display.layers == layers


@pytest.mark.parametrize(
    ("layers", "message"),
    [
        ("0.5", "write thickness in mm and refractive index of each layer"),
        ("0.5 glass", "write thickness"),
        (0.5, "write thickness"),
        ("-0.5 1.5", "must be a positive length"),
        ("nan 1.5", "must be a positive length"),
        ("0.5 0.9", "refractive index 0.9: must be from 1 to 3"),
        ("0.5 nan", "must be from 1 to 3"),
        (",".join(["0.1 1.5"] * 9), "9 layers; at most 8"),
    ],
)
def test_impossible_layers_are_refused_in_a_line(layers, message):
    with pytest.raises(DisplayError, match=message) as error:
        NOMINAL.replace(layers=layers)
    assert "\n" not in str(error.value)


def test_layers_must_fit_behind_the_thick_lens():
    thick_glass = NOMINAL.replace(layers="4.2 1.5")  # 2.8 mm of air; 2.63 mm are behind the lens
    with pytest.raises(DisplayError, match=r"leaves 2\.63 mm behind the lens; use a larger gap"):
        check_lens_model("thick", thick_glass)
    check_lens_model("thick", thick_glass.replace(curved_side="panel"))
    with pytest.raises(DisplayError, match="full lens model: layers"):
        check_lens_model("full", GLASS)


@pytest.mark.parametrize("model", ["pinhole", "thin"])
def test_paraxial_models_use_the_air_equivalent_gap_alone(model):
    assert trace_to_panel(GLASS, model, *RAYS) == trace_to_panel(NOMINAL, model, *RAYS)


@pytest.mark.parametrize("side", ["viewer", "panel"])
def test_layers_of_air_are_air(side):
    plain = NOMINAL.replace(curved_side=side)
    air = trace_to_panel(plain.replace(layers="0.5 1, 1 1"), "thick", *RAYS)
    assert np.array(air) == pytest.approx(
        np.array(trace_to_panel(plain, "thick", *RAYS)), rel=1e-13
    )


@pytest.mark.parametrize("side", ["viewer", "panel"])
def test_layers_leave_the_image_where_it_is_and_bend_steep_rays(side):
    """Paraxially nothing moves; a steep ray moves with the third power of its slope."""
    display, glass = (d.replace(curved_side=side) for d in (NOMINAL, GLASS))
    slopes = np.array([0.05, 0.1, 0.2])
    shift = [
        trace_to_panel(glass, "thick", 0.5, 0.5, s, 0.0)[0]
        - trace_to_panel(display, "thick", 0.5, 0.5, s, 0.0)[0]
        for s in slopes
    ]
    assert shift[0] / shift[1] == pytest.approx(1 / 8, rel=0.05)
    sine = slopes / np.sqrt(1 + slopes**2)
    expected = sum(t * (sine / np.sqrt(n**2 - sine**2) - slopes / n) for t, n in GLASS.layers)
    # The ray through a lens's middle leaves it under nearly its own angle.
    assert shift == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize(
    ("side", "layers"),
    [
        ("viewer", "0.5 1.52, 0.1 1.41"), ("panel", "0.5 1.52, 0.1 1.41"),
        ("viewer", TOUCHING.format((3.3 - 1 / 1.4917) * 1.52)),
        ("panel", TOUCHING.format(3.3 * 1.52)),
    ],
)  # fmt: skip
def test_white_is_white_on_the_axis(side, layers):
    display = NOMINAL.replace(curved_side=side, layers=layers)
    weight = trace_to_panel(display, "thick", 0.5, 0.5, 0.0, 0.0)[2]
    assert weight * white_exposure(display, "thick") == pytest.approx(1, abs=1e-7)


def test_glue_without_air_loses_no_light_at_its_faces():
    glued = NOMINAL.replace(layers=f"{(3.3 - 1 / 1.4917) * 1.4917:.17g} 1.4917")
    n = NOMINAL.refractive_index
    assert 1 / white_exposure(glued, "thick") == pytest.approx(4 * n / (n + 1) ** 2)
