"""Lens models are found by name, other packages' too, which give a view or one clear line."""

from pathlib import Path

import numpy as np
import pytest

from inim.display import Viewpoint
from inim.display.lens import (
    check_lens_model,
    drawn_model,
    foreign_identity,
    lens_model,
    lens_models,
    trace_to_panel,
    white_exposure,
)
from inim.system.errors import DisplayError, InimError, UsageError
from tests.conftest import small_display
from tests.system.conftest import install_metadata

OWN = ["pinhole", "thin", "thick", "full"]
DISPLAY = small_display(4, 4)
# A pinhole that loses half of the light: like the project's own, but for its exposure.
THEIRS = """
from inim.system.errors import DisplayError
from inim.display.lens import LensModel, PanelRay, lens_centre


def trace(array, traits, ops, x, y, sx, sy, index):
    centre_x, centre_y, inside = lens_centre(array, traits, ops, x, y)
    weight = ops.where(inside, 0.5, 0.0)
    return PanelRay(centre_x + array.gap * sx, centre_y + array.gap * sy, sx, sy, weight)


def check(display):
    if display.gap_mm > 5:
        raise DisplayError(f"gap_mm = {display.gap_mm:g}: too far")


model = LensModel("theirs", summary="a grey pinhole", trace=trace, check=check,
                  transmittance=lambda display: 0.5, refracts=False, stand_in="pinhole")
"""


@pytest.fixture
def plant(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Install a package that announces a lens model called `theirs`."""
    count = 0

    def planted(source: str, *, value: str = "model") -> None:
        nonlocal count
        count += 1
        module = f"planted_lens_{tmp_path.name}_{count}".replace("-", "_")
        (tmp_path / f"{module}.py").write_text(source, encoding="utf-8")
        install_metadata(tmp_path, module, f"[inim.lens_models]\ntheirs = {module}:{value}\n")
        lens_model.cache_clear()

    monkeypatch.syspath_prepend(tmp_path)
    yield planted
    lens_model.cache_clear()


def refusal(model: str = "theirs") -> str:
    """Message for a model that cannot trace a ray."""
    with pytest.raises(InimError) as caught:
        trace_to_panel(DISPLAY, model, np.zeros(3), 0.1, 0.2, 0.0)
    text = str(caught.value)
    assert "\n" not in text and f"lens model {model!r}" in text
    return text


def test_the_project_s_own_models_describe_themselves():
    assert lens_models() == OWN
    for name in OWN:
        model = lens_model(name)
        assert model.name == name and model.summary
        assert (model.trace is None) == (name == "full") == (model.mesh is not None)
        assert foreign_identity(name) == {}


def test_an_unknown_model_is_refused_with_the_names_there_are():
    with pytest.raises(UsageError, match="lens model 'magic': use pinhole or thin or thick or fu"):
        check_lens_model("magic", DISPLAY)


def test_another_package_s_model_is_one_of_them(plant):
    plant(THEIRS)
    assert lens_models() == [*OWN, "theirs"]
    rays = np.linspace(-1.9, 1.9, 50), np.linspace(-1.5, 1.8, 50), 0.1, np.linspace(-0.2, 0.2, 50)
    x, y, weight = trace_to_panel(DISPLAY, "theirs", *rays)
    own_x, own_y, own_weight = trace_to_panel(DISPLAY, "pinhole", *rays)
    assert np.array_equal(x, own_x) and np.array_equal(y, own_y)
    assert np.array_equal(weight, own_weight / 2) and weight.max() == 0.5
    assert white_exposure(DISPLAY, "theirs") == 2
    assert drawn_model("theirs") == "pinhole"
    assert foreign_identity("theirs")["version"] == "1.0"
    assert len(foreign_identity("theirs")["sha256"]) == 64
    with pytest.raises(
        DisplayError, match=r"lens model 'theirs' of package .*: gap_mm = 6: too far"
    ):
        check_lens_model("theirs", DISPLAY.replace(gap_mm=6))


MESH = """from dataclasses import replace
from inim.display.lens import lens_model
model = replace(lens_model('full'), name='theirs')
"""


@pytest.mark.parametrize(("source", "own"), [(THEIRS, "pinhole"), (MESH, "full")])
def test_the_renderer_shows_a_display_through_another_package_s_model(plant, renderer, source, own):
    """Bit for bit as through the own model, the pinhole at half the light; the same pixels, too."""
    from inim.render.reconstruct import DisplayScene
    from inim.render.view_matrix import observed_columns, view_matrices

    plant(source)
    eia = np.random.default_rng(1).uniform(0, 1, (*DISPLAY.eia_shape, 3)).astype(np.float32)
    eye, sampling = Viewpoint("eye", 3, -2, 300), {"pixels_per_lens": 4, "spp": 8}
    views = [
        DisplayScene(eia, DISPLAY, model).view(eye, **sampling, seed=1) for model in ("theirs", own)
    ]
    assert views[1].max() > 0.1
    exposure = white_exposure(DISPLAY, "theirs") if own == "pinhole" else 1
    assert np.array_equal(views[0] * exposure, views[1])
    if own == "full":
        with pytest.raises(UsageError, match="rays scatter between the lenses"):
            view_matrices(DISPLAY, eye, "theirs", **sampling, seed=1)
        return
    observed = [
        observed_columns(view_matrices(DISPLAY, eye, model, **sampling, seed=1))[0]
        for model in ("theirs", own)
    ]
    assert 0 < observed[0].mean() < 1
    assert np.array_equal(*observed)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (THEIRS.replace("    centre_x, c", "    1 / 0\n    c, c"), "failed: ZeroDivisionError"),
        (THEIRS.replace("return PanelRay", "return list"), "failed: TypeError"),
        (THEIRS.replace("return PanelRay(", "return list(("), "cannot be loaded: SyntaxError"),
        (THEIRS.replace("sy, weight)", "sy, weight[:2])"), "failed: ValueError"),
        (THEIRS.replace('"theirs"', '"others"'), "has the name 'others'; make the names equal"),
        (THEIRS.replace('"pinhole"', '"magic"'), "its stand_in is 'magic'; use pinhole or"),
        (THEIRS.replace("trace=trace, ", ""), "define exactly one of trace and mesh"),
        (THEIRS.replace("    if display", "    1 / 0\n    if display"), "failed: ZeroDivisionErr"),
        ("model = 3", "is a int; register an inim.display.lens.LensModel"),
        ("import no_such_package", "cannot be loaded: ModuleNotFoundError"),
        ("raise SystemExit(0)", "cannot be loaded: SystemExit"),
    ],
)
def test_a_model_that_fails_is_named_in_one_line(plant, wrong, message):
    plant(wrong)
    assert message in refusal()
    check_lens_model("thin", DISPLAY)  # others are served as ever
