"""`inim view`: the virtual display in a real browser shows what the ray tracer shows."""

import base64
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from inim.display import Display, Viewpoint
from inim.display.lens import white_exposure
from inim.image.color import linear_from_srgb, srgb_from_linear, srgb_to_uint8
from inim.report.view_page import view_eia
from inim.report.virtual_display import live_lens_models, still_view
from inim.scores.metrics import ssim
from tests.chromium import NO_WEBGL, WEBGL, Tab, browser
from tests.conftest import small_display
from tests.schemas import report_document
from tests.skewed_layout import Skewed
from tests.system.conftest import Ended, assert_refused, definitions, run_here
from tests.unit.test_report_html import render_html, report

# Lenses of a whole number of pixels, seen with 4 view pixels to the lens.
DISPLAY = small_display(24, 20, 17)
NAMES = {"inim.lens_columns": "24", "inim.lens_rows": "20", "inim.pixel_pitch_mm": str(1 / 17)}
ALGORITHMS = {"template": 0.97, "wang2024": 0.92}
# The ray tracer's own noise and 8-bit rounding leave more than this.
LEAST_SSIM = 0.99
# Between two renderings in exact and in float32 arithmetic, of samples on a pixel's border.
MOST_CHANGED = 0.002


_CYLINDERS = {
    "lattice": "lenticular", "lens_rows": 1, "panel_columns": 408, "panel_rows": 340,
    "rotation_deg": -8.0,
}  # fmt: skip


def tilted_plane(display: Display, seed: int = 0) -> np.ndarray:
    """The EIA of a patterned plane through the depth range, like no mirror image of itself.

    (rows, columns, 3) uint8: a large F, dots of seeded colours, brighter to the right and above.
    """
    rows, columns = display.eia_shape
    if not display.is_separable:  # some picture of the panel's size will do
        display = DISPLAY.replace(panel_rows=rows, panel_columns=columns)
    z = 12.0
    x = (display.columns.centre_mm + display.columns.slope * z)[None, :] / display.width_mm
    y = (display.rows.centre_mm + display.rows.slope * z)[:, None] / display.height_mm
    stem = (abs(x + 0.2) < 0.06) & (abs(y) < 0.4)
    bars = (x > -0.2) & (x < 0.25) & ((abs(y - 0.34) < 0.06) | ((abs(y) < 0.06) & (x < 0.1)))
    dots = np.random.default_rng(seed).uniform(0.1, 0.9, (9, 9, 3))
    places = np.clip(((y + 0.5) * 9).astype(int), 0, 8), np.clip(((x + 0.5) * 9).astype(int), 0, 8)
    ramp = (0.5 + 0.4 * x + 0.2 * y)[..., None]
    color = np.where((stem | bars)[..., None], [1.0, 0.8, 0.2], ramp * dots[places])
    return srgb_to_uint8(srgb_from_linear(color))


def save(path: Path, codes: np.ndarray) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(codes).save(path)
    return path


def view(*words: str | Path, folder: Path) -> Ended:
    """`inim view`, run to its end in a folder."""
    return run_here("view", *words, folder=folder)


def show_eia(tab: Tab, folder: Path, codes: np.ndarray, **settings: object) -> None:
    """Open the live display of an EIA, on a small screen that is soon drawn."""
    eia = save(folder / "eia.png", codes)
    definitions = NAMES | {f"inim.{name}": str(value) for name, value in settings.items()}
    tab.size(150, 300)
    view_eia(eia, folder / "page.html", "nominal", definitions)
    tab.open(folder / "page.html")
    assert tab.evaluate("inimDisplay.ready") is True


def report_data(display: Display = DISPLAY) -> dict[str, Any]:
    data = report(ALGORITHMS, seconds=0.5)
    data["display"] = {"parameters": display.parameters(), "derived": display.derived_quantities()}
    places = {"centre": (0, 0), "left": (-20, 0), "right": (20, 0), "up": (0, 15), "down": (0, -15)}
    data["viewpoints"] = [{"name": n, "position_mm": [*p, 180.0]} for n, p in places.items()]
    return data


def report_folder(folder: Path, display: Display = DISPLAY) -> Path:
    """A report's pictures: three different EIAs, and views of them."""
    for seed, place in enumerate(("truth/eia", "eia/template", "eia/wang2024")):
        save(folder / f"{place}.png", tilted_plane(display, seed))
    for viewpoint in report_data()["viewpoints"]:
        for place in ("truth", "views/reference", "views/template", "views/wang2024"):
            codes = still_view(
                tilted_plane(display), display, tuple(viewpoint["position_mm"]), grid=1
            )
            save(folder / place / f"{viewpoint['name']}.png", codes)
    return folder


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A whole report."""
    folder = report_folder(tmp_path_factory.mktemp("report"))
    path = folder / "report.html"
    path.write_text(render_html(report_data(), folder), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def shared_tab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tab]:
    with browser(WEBGL) as tab:
        yield tab


@pytest.fixture
def tab(shared_tab: Tab) -> Tab:
    shared_tab.size(280, 420)  # every pixel of its canvases is drawn in software
    shared_tab.send("Emulation.setEmulatedMedia", media="", features=[])
    shared_tab.complaints.clear()
    return shared_tab


def show(tab: Tab, path: Path) -> None:
    """Open a page and wait for its display."""
    tab.open(path)
    assert tab.evaluate("inimDisplay.ready") is True
    rest(tab)


def rest(tab: Tab) -> None:
    tab.until("inimDisplay.state().isResting")


def eye(tab: Tab) -> tuple[float, float, float]:
    x, y, z = tab.evaluate("inimDisplay.eye()")
    return x, y, z


def canvas(tab: Tab, side: int, shape: tuple[int, int]) -> np.ndarray:
    """The picture on a canvas, (rows, columns, 3) uint8, drawn at this size."""
    answer = tab.evaluate(f"inimDisplay.pixels({side}, {shape[1]}, {shape[0]})")
    rgba = np.frombuffer(base64.b64decode(answer["data"]), np.uint8)
    return rgba.reshape(answer["height"], answer["width"], 4)[..., :3]


@pytest.fixture(scope="module")
def traced(renderer: object) -> Any:
    """Views of the report's ground truth by the ray tracer, linear."""
    from inim.render.reconstruct import reconstruct

    light = linear_from_srgb(tilted_plane(DISPLAY).astype(np.float32) / 255)

    def view_from(place: tuple[float, float, float], lens_model: str = "pinhole") -> np.ndarray:
        return reconstruct(light, DISPLAY, Viewpoint("eye", *place), lens_model, spp=256)

    return view_from


@pytest.mark.parametrize("by", [(0, 0), (50, -30), pytest.param((-50, 35), marks=pytest.mark.slow)])
def test_dragging_the_eye_agrees_with_the_ray_tracer(tab, page, traced, by):
    show(tab, page)
    tab.click("input[value=pinhole]")
    tab.drag("#virtual-display canvas", by)
    place = eye(tab)
    assert np.sign(place[:2]).tolist() == np.sign([by[0], -by[1]]).tolist()
    expected = traced(place)
    drawn_light = linear_from_srgb(canvas(tab, 0, expected.shape[:2]).astype(np.float32) / 255)
    assert ssim(expected, drawn_light) >= LEAST_SSIM
    # A picture that is mirrored, moved by a lens or seen from elsewhere would not pass.
    mirrored = drawn_light[:, ::-1], drawn_light[::-1]
    for wrong in (*mirrored, *(np.roll(drawn_light, 4, axis) for axis in (0, 1))):
        assert ssim(expected, wrong) < 0.9
    elsewhere = (place[0] + (12 if place[0] <= 0 else -12), place[1], place[2])
    assert ssim(traced(elsewhere), drawn_light) < 0.97
    assert tab.complaints == []


_GLUED = f"0.4 1.41, {(3.3 - 1 / 1.4917 - 0.4 / 1.41) * 1.52} 1.52"
_CLEAR = {"aperture": "round", "fill_factor": 0.8, "between_lenses": "clear"}
_LIGHT = {"black_level": 0.02, "ambient_reflection": 0.03, "white_point_k": 9300.0}


@pytest.mark.parametrize(
    "changes",
    [
        {"panel_columns": 377, "panel_rows": 301, "pixel_pitch_mm": 0.0636, **_LIGHT},
        {"lattice": "hexagonal"},
        {"subpixels": "pentile", "pixel_fill": 0.8},
        {"lattice": Skewed.name, "rotation_deg": 3.0, "shift_x_mm": 0.31, "shift_y_mm": -0.2},
        _CLEAR,
        {"fill_factor": 0.7, "pitch_y_mm": 1.2, "elemental_pitch_mm": 1.01, "gap_mm": 2.8},
        {"abbe_number": 30.0, "veiling_glare": 0.1, "black_level": 0.01},
        {"curved_side": "panel", "layers": "0.5 1.52, 0.1 1.41"},
        {"layers": "0.5 1.52, 0.1 1.41", "tilt_x_deg": 2.0, "tilt_y_deg": -1.5},
        {"layers": _GLUED},
        {"subpixels": "rgb-stripe", **_CYLINDERS},
        {
            "subpixels": "cells",
            "cell_pattern": "staggered",
            "curved_side": "panel",
            "subpixel_cells": "-0.3 0.25 0.3 0.25 0 -0.25, -0.3 -0.25 0.3 -0.25 0 0.25",
            **_CYLINDERS,
        },
    ],
    ids=" ".join,
)
def test_every_kind_of_array_is_drawn_as_the_lens_models_trace_it(tab, tmp_path, changes):
    display = DISPLAY.replace(**changes)
    codes = tilted_plane(display)
    show_eia(tab, tmp_path, codes, **changes)
    # What is compared is drawn at a size of its own; the page's canvas would take longer.
    tab.evaluate("document.querySelector('canvas').style.cssText = 'width: 8px; height: 8px'")
    assert_flip_limits(tab, display)
    tab.evaluate("inimDisplay.setEye(23, -14, 190)")
    shape = tuple(4 * n for n in display.layout.grid)
    models = live_lens_models(display)
    assert ("thick" in models) == ("fill_factor" not in changes and "aperture" not in changes)
    for lens_model in models:
        tab.click(f"input[value={lens_model}]")
        expected = still_view(codes, display, eye(tab), lens_model, grid=8).astype(int)
        drawn_view = canvas(tab, 0, shape).astype(int)
        assert expected.max() > 150
        # A sample on the border of two panel pixels may fall to either side.
        assert (abs(drawn_view - expected).max(axis=-1) > 2).mean() < MOST_CHANGED, lens_model
    assert tab.complaints == []


def test_thick_lenses_live_are_those_that_are_scored(tab, page, traced):
    """Against `inim.reconstruct`, brightness and all: closer than thin lenses are."""
    show(tab, page)
    assert tab.evaluate("inimDisplay.state().lensModel") == "thick"  # as the report's
    tab.evaluate("inimDisplay.setEye(14, -9, 180)")
    # As reports do, the loss on the axis is set right.
    expected = traced((14, -9, 180), "thick") * white_exposure(DISPLAY, "thick")
    errors = {}
    for model in ("thick", "thin"):
        tab.click(f"input[value={model}]")
        drawn_light = linear_from_srgb(canvas(tab, 0, expected.shape[:2]).astype(np.float32) / 255)
        errors[model] = float(np.sqrt(((drawn_light - expected) ** 2).mean()))
        if model == "thick":
            assert ssim(expected, drawn_light) >= LEAST_SSIM
            assert drawn_light.mean() == pytest.approx(float(expected.mean()), rel=0.01)
    assert errors["thick"] < 0.5 * errors["thin"]


def test_every_control_works_without_an_error(tab, page):
    show(tab, page)
    start = eye(tab)
    assert start == (0, 0, 180)
    tab.click("button[data-viewpoint='1']")
    assert eye(tab) == (-20, 0, 180)
    tab.until("document.querySelector('[data-viewpoint=\"1\"]').ariaPressed === 'true'")
    for model in ("pinhole", "thin"):
        tab.click(f"input[value={model}]")
        assert tab.evaluate("inimDisplay.state().lensModel") == model
    tab.click("#virtual-display canvas")  # gives it the keyboard
    at = tab.middle("#virtual-display canvas")
    tab.mouse("mouseWheel", at, deltaX=0, deltaY=200)
    tab.until("inimDisplay.eye()[2] > 200")
    tab.key("Home")
    assert eye(tab) == start
    for name, axis, sign in (
        ("ArrowRight", 0, 1), ("ArrowLeft", 0, -1), ("ArrowUp", 1, 1), ("ArrowDown", 1, -1),
        ("+", 2, -1), ("-", 2, 1),
    ):  # fmt: skip
        before = eye(tab)
        tab.key(name)
        after = eye(tab)
        assert np.sign(after[axis] - before[axis]) == sign, name
        assert after[:axis] + after[axis + 1 :] == before[:axis] + before[axis + 1 :]
    for name in "xyz":
        before = eye(tab)
        tab.click(f"input[name={name}]")  # its middle
        tab.key("ArrowRight")
        assert eye(tab)["xyz".index(name)] > before["xyz".index(name)] - 1e-9
        assert eye(tab) != before
    choose = "(s => { s.value = 2; s.dispatchEvent(new Event('change')); })"
    tab.evaluate(f"{choose}(document.querySelector('#virtual-display select'))")
    tab.until("inimDisplay.state().panels[0] === 2")
    tab.size(700, 900)
    tab.click("input[name=together]")
    rest(tab)
    widths = "[...document.querySelectorAll('canvas')].map((c) => c.clientWidth)"
    wide, narrow = tab.evaluate(widths)
    assert (wide > 600, narrow) == (True, 0)
    tab.click("input[name=together]")
    rest(tab)
    assert min(tab.evaluate(widths)) > 300
    tab.size(500, 800)
    rest(tab)
    assert tab.complaints == []


def test_two_eyes_see_the_panel_from_their_two_places(tab, tmp_path):
    """Equal to `still_view` for each: the left eye's picture left, the right eye's right."""
    codes = tilted_plane(DISPLAY)
    show_eia(tab, tmp_path, codes)
    alone = tab.evaluate("inimDisplay.state().eyes")
    assert alone == [list(eye(tab))] * 2
    tab.click("input[name=pair]")
    tab.evaluate(
        "(e => { e.value = 20; e.dispatchEvent(new Event('input')); })"
        "(document.querySelector('input[name=between]'))"
    )
    tab.evaluate("inimDisplay.setEye(3, 2, 300)")
    rest(tab)
    assert tab.evaluate("inimDisplay.state().eyes") == [[-7, 2, 300], [13, 2, 300]]
    assert "20 mm apart" in tab.evaluate("document.querySelector('.readout').textContent")
    heads = "[...document.querySelectorAll('.screens .side')].map((s) => s.textContent)"
    assert tab.evaluate(heads) == ["Left eye", "Right eye"]
    shape = DISPLAY.lens_rows * 4, DISPLAY.lens_columns * 4
    for side, x in enumerate((-7, 13)):
        expected = still_view(codes, DISPLAY, (x, 2, 300), "thick", grid=8).astype(int)
        drawn_view = canvas(tab, side, shape).astype(int)
        assert (abs(drawn_view - expected).max(axis=-1) > 2).mean() < MOST_CHANGED
    # A pair is outside as soon as one of its eyes is.
    limit = tab.evaluate("inimDisplay.flipLimit(300)")[0]
    tab.evaluate(f"inimDisplay.setEye({limit - 9}, 0, 300)")
    assert tab.evaluate("inimDisplay.state().isOutside") is True
    tab.evaluate(f"inimDisplay.setEye({limit - 11}, 0, 300)")
    assert tab.evaluate("inimDisplay.state().isOutside") is False
    tab.click("input[name=pair]")
    rest(tab)
    hidden = "document.querySelectorAll('.screens figure')[1].hidden"
    assert tab.evaluate(hidden) is True
    assert tab.complaints == []


# Records in each frame whether the pre-rendered views show, and the sizes of the visible canvases:
# pixels, and CSS pixels.
_RECORD = """
window.recorded = [];
(function look() {
  const visible = (e) => e.checkVisibility({visibilityProperty: true}) && e.clientWidth > 0;
  if (document.readyState !== "loading") recorded.push({
    views: visible(document.querySelector(".stand-in")),
    canvases: [...document.querySelectorAll("#virtual-display-live canvas")].filter(visible)
      .map((c) => [c.width, c.height, c.clientWidth, c.clientHeight])});
  requestAnimationFrame(look);
})();"""


@pytest.mark.slow
def test_first_visible_frame_is_sharp_and_moving_ones_show_every_lens(tab, page):
    moving = [{"name": "prefers-reduced-motion", "value": "no-preference"}]
    tab.send("Emulation.setEmulatedMedia", media="", features=moving)
    script = tab.send("Page.addScriptToEvaluateOnNewDocument", source=_RECORD)
    tab.size(1400, 900)
    tab.open(page)
    assert tab.evaluate("inimDisplay.ready") is True
    tab.middle("#virtual-display canvas")
    tab.until("inimDisplay.state().frames > 20")
    frames = tab.evaluate("recorded")
    tab.send("Page.removeScriptToEvaluateOnNewDocument", **script)
    assert tab.evaluate("inimDisplay.state().isSwaying") is True
    assert [frame["views"] for frame in frames] == [not frame["canvases"] for frame in frames]
    sizes = [size for frame in frames for size in frame["canvases"]]
    assert len(sizes) > 20
    assert sizes[0][:2] == sizes[0][2:]
    least = DISPLAY.lens_columns, DISPLAY.lens_rows
    assert all(wide >= least[0] and high >= least[1] for wide, high, *_ in sizes)
    assert tab.complaints == []


def assert_flip_limits(tab: Tab, display: Display) -> None:
    for z in (60.0, 150.0, 400.0):
        assert tab.evaluate(f"inimDisplay.flipLimit({z})") == pytest.approx(
            display.flip_limit_mm(z), abs=1e-9
        )


def stand_in(tab: Tab) -> bool:
    """True if pre-rendered views stand in place of the live display."""
    pictures = tab.evaluate(
        "[...document.querySelectorAll('#virtual-display .stand-in img')]"
        ".map((i) => [i.naturalWidth, i.clientWidth])"
    )
    hidden = tab.evaluate("document.getElementById('virtual-display-live').clientHeight") == 0
    return hidden and len(pictures) == 2 and min(map(min, pictures)) > 50


def test_without_webgl_the_views_replace_the_display_without_an_error(page, tmp_path):
    with browser(NO_WEBGL) as tab:
        tab.size(1000, 800)
        tab.open(page)
        assert tab.evaluate("inimDisplay.ready") is False
        assert stand_in(tab)
        reason = tab.evaluate("document.getElementById('virtual-display-why').textContent")
        assert "no WebGL 2" in reason
        assert tab.complaints == []


def test_view_of_a_report_has_all_its_panels(tab, page, tmp_path):
    folder = tmp_path / "OUT"
    shutil.copytree(page.parent, folder)
    from inim.report import Report

    Report(folder, report_document(report_data())).write()
    ended = view("OUT", folder=tmp_path)
    assert (ended.code, ended.stdout) == (0, "OUT-view.html\n"), ended.stderr
    show(tab, tmp_path / "OUT-view.html")
    names = "[...document.querySelector('select').options].map((o) => o.text)"
    assert tab.evaluate(names) == ["Reference", "template", "wang2024"]
    assert tab.complaints == []


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["eia.png"], ["eia.png", "408 x 340", "needs 1088 x 1088", "--display"]),
        (["eia.png", "--display", "palace"], ["palace", "nominal or phone"]),
        (["eia.png", "-D", "inim.pitsh_mm=1"], ["pitsh_mm", "did you mean inim.pitch_mm"]),
        (["eia.png", "-D", "color=1"], ["color"]),
        (["eia.png", *definitions(NAMES), "-o", "."], ["is a folder", "-o"]),
        (["text.txt"], ["text.txt", ".png"]),
        (["broken.png", *definitions(NAMES)], ["broken.png", "not a readable PNG"]),
        (["."], ["report.json", "no such file"]),
        ([".", "--display", "phone"], ["its own display"]),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(tmp_path, words, message):
    save(tmp_path / "eia.png", tilted_plane(DISPLAY))
    (tmp_path / "text.txt").write_text("no picture")
    (tmp_path / "broken.png").write_bytes(b"\x89PNG\r\n\x1a\n cut")
    assert_refused("view", *words, folder=tmp_path, says=message)
