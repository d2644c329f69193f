"""The whole report in a real browser, for those who do not see it, and on any screen or paper."""

import base64
import io
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from tests.chromium import Tab, browser
from tests.system.test_view import report_data, report_folder
from tests.unit.test_report_html import render_html, report

WORKED_BY_HAND = ("button", "link", "checkbox", "radio", "slider", "combobox", "application")

UNFOLD = "document.querySelectorAll('details').forEach((d) => {{ d.open = {}; }})"


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = report_folder(tmp_path_factory.mktemp("report"))
    data = report_data()
    data["skipped"] = [
        {"step": "samples", "performed": "3", "skipped": "5", "why": "no noise there"}
    ]
    path = folder / "report.html"
    path.write_text(render_html(data, folder), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def shared_tab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tab]:
    with browser() as tab:
        yield tab


@pytest.fixture(scope="module")
def opened(shared_tab: Tab, page: Path) -> Tab:
    """The page, opened once for the tests that only read it."""
    shared_tab.size(1000, 700)
    shared_tab.open(page)
    assert shared_tab.evaluate("inimDisplay.ready") is True
    assert shared_tab.complaints == []
    return shared_tab


@pytest.fixture
def tab(opened: Tab) -> Tab:
    opened.size(1000, 700)
    opened.send("Emulation.setEmulatedMedia", media="", features=[])
    opened.complaints.clear()
    return opened


def spoken(tab: Tab) -> list[dict[str, Any]]:
    """Text for a screen reader: role and name of every node it does not pass over."""
    nodes = tab.send("Accessibility.getFullAXTree")["nodes"]
    return [
        {"role": node["role"]["value"], "name": node.get("name", {}).get("value", "").strip()}
        for node in nodes
        if not node["ignored"] and "role" in node
    ]


def test_every_control_and_picture_has_a_name(tab):
    nodes = spoken(tab)
    roles = {node["role"] for node in nodes}
    assert {*WORKED_BY_HAND, "image", "navigation", "main", "table"} <= roles
    nameless = [n for n in nodes if n["role"] in (*WORKED_BY_HAND, "image") and not n["name"]]
    assert nameless == []


def test_keyboard_reaches_every_control_and_leaves_it_again(tab):
    """The Tab key alone reaches each control of display and slider, and the page's last link."""
    expected = tab.evaluate(
        "[...document.querySelectorAll(':is(a, button, select, input, canvas, [tabindex])')]"
        ".filter((e) => e.checkVisibility() && !e.disabled && (e.type !== 'radio' || e.checked))"
        ".map((e, i) => { e.dataset.place = i; return String(i); })"
    )
    assert len(expected) > 40
    reached = []
    for _ in range(len(expected) + 5):
        for kind in ("rawKeyDown", "keyUp"):
            tab.send("Input.dispatchKeyEvent", type=kind, key="Tab", code="Tab",
                     windowsVirtualKeyCode=9)  # fmt: skip
        reached.append(tab.evaluate("document.activeElement.dataset.place ?? ''"))
    assert set(expected) <= set(reached)


@pytest.mark.parametrize(("width", "theme"), [(320, "light"), (390, "dark"), (1280, "light")])
def test_the_page_fits_the_width_of_the_screen(tab, theme, width):
    tab.size(width, 800)
    scheme = [{"name": "prefers-color-scheme", "value": theme}]
    tab.send("Emulation.setEmulatedMedia", media="", features=scheme)
    out = tab.evaluate(
        "[...document.querySelectorAll('body *')].filter((e) => e.checkVisibility() && "
        "!e.closest('.scroll, nav, svg, pre, .skip, .spoken, #overview > h2') && "
        "e.getBoundingClientRect().right > innerWidth + 1).map((e) => e.outerHTML.slice(0, 80))"
    )
    assert out == []
    assert tab.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert tab.complaints == []


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_text_has_enough_contrast(tab, theme):
    """Contrast of 4.5 at least, as WCAG 2.1, 1.4.3 asks, by its formula on computed colours."""
    scheme = [{"name": "prefers-color-scheme", "value": theme}]
    tab.send("Emulation.setEmulatedMedia", media="", features=scheme)
    tab.evaluate(UNFOLD.format("true"))
    pairs = tab.evaluate(
        """[...document.querySelectorAll('body *')].filter((e) => e.checkVisibility() &&
          !e.closest('svg, .stage, option') &&
          [...e.childNodes].some((n) => n.nodeType === 3 && n.data.trim())).map((e) => {
            let behind = e;
            while (behind && getComputedStyle(behind).backgroundColor === 'rgba(0, 0, 0, 0)')
              behind = behind.parentElement;
            return [getComputedStyle(e).color,
              getComputedStyle(behind || document.body).backgroundColor, e.textContent.trim()];
          })"""
    )
    tab.evaluate(UNFOLD.format("false"))
    assert len(pairs) > 200
    weak = {(ink, paper, words[:40]) for ink, paper, words in pairs if contrast(ink, paper) < 4.5}
    assert weak == set()


def contrast(ink: str, paper: str) -> float:
    dark, light = sorted(map(luminance, (ink, paper)))
    return (light + 0.05) / (dark + 0.05)


def luminance(color: str) -> float:
    codes = [float(number) / 255 for number in re.findall(r"[\d.]+", color)[:3]]
    linear = [c / 12.92 if c <= 0.03928 else ((c + 0.055) / 1.055) ** 2.4 for c in codes]
    return float(sum(w * c for w, c in zip((0.2126, 0.7152, 0.0722), linear, strict=True)))


def test_page_prints_and_reads_whole_without_scripts(tab, page):
    sections = "[...document.querySelectorAll('main section')].map((s) => s.id)"
    live = tab.evaluate(sections)
    assert {"virtual-display", "views", "time", "skipped", "warnings", "reproduce"} <= set(live)
    pdf = base64.b64decode(tab.send("Page.printToPDF", preferCSSPageSize=True)["data"])
    assert 3 <= len(re.findall(rb"/Type\s*/Page\b", pdf)) <= 30
    tab.send("Emulation.setScriptExecutionDisabled", value=True)
    try:
        tab.open(page)
        assert tab.evaluate(sections) == live
        broken = "[...document.images].filter((i) => !i.naturalWidth).length"
        assert tab.evaluate(broken) == 0
        for height, kind in ((60, "section:not(:has(> details))"), (20, "section")):
            empty = f"[...document.querySelectorAll('main {kind}')]"
            assert tab.evaluate(f"{empty}.filter((s) => s.clientHeight < {height}).length") == 0
        tab.click("#reproduce summary")
        assert tab.evaluate("document.querySelector('#reproduce pre').checkVisibility()")
    finally:
        tab.send("Emulation.setScriptExecutionDisabled", value=False)
        tab.open(page)  # as the other tests expect it
    assert tab.complaints == []


FIRST_CELLS = (
    "[...document.querySelectorAll('#scores tbody th')].map((c) => c.firstChild.textContent)"
)
HEAD = "#scores thead th:nth-child(2)"


def test_tables_are_sorted_from_their_heads_by_mouse_and_keyboard(tab):
    references = ["Reference", "Noise floor"]
    assert tab.evaluate(FIRST_CELLS) == ["template", "wang2024", *references]
    tab.click(f"{HEAD} button")
    assert tab.evaluate(f"document.querySelector('{HEAD}').ariaSort") == "ascending"
    # By number, what algorithms are measured against below them.
    assert tab.evaluate(FIRST_CELLS) == ["wang2024", "template", *references]
    tab.evaluate(f"document.querySelector('{HEAD} button').focus()")
    tab.key("Enter")
    assert tab.evaluate(f"document.querySelector('{HEAD}').ariaSort") == "descending"
    assert tab.evaluate(FIRST_CELLS) == ["template", "wang2024", *references]
    assert tab.evaluate("document.querySelectorAll('#scores [aria-sort]').length") == 1


# --- The comparison slider: two views over each other -------------------------------------------
# Left of the border is the first picture and right of it the second, pixel for pixel; a flip shows
# either; the difference is that of the page.

NAME = "<img src=x onerror=document.title='ran'>"
ALGORITHMS = {"template": 0.97, NAME: 0.92}
SIZE = 160
PLACES = {"Ground truth": "truth", "Reference": "views/reference", "template": "views/template"}


def codes(seed: int) -> np.ndarray:
    """Blocks of colour, which a browser that scales them leaves alone but for their borders."""
    blocks = np.random.default_rng(seed).integers(0, 256, (8, 8, 3), np.uint8)
    return np.kron(blocks, np.ones((SIZE // 8, SIZE // 8, 1), np.uint8))


def seed_of(name: str, view: str) -> int:
    return 10 * list(PLACES).index(name) + ("centre", "left").index(view)


@pytest.fixture(scope="module")
def slider_page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A report whose reference was lost from the left, and one algorithm has no pictures at all."""
    folder = tmp_path_factory.mktemp("slider")
    for name, place in PLACES.items():
        for view in ("centre", "left"):
            if (name, view) != ("Reference", "left"):
                path = folder / place / f"{view}.png"
                path.parent.mkdir(parents=True, exist_ok=True)
                Image.fromarray(codes(seed_of(name, view))).save(path)
    path = folder / "report.html"
    path.write_text(render_html(report(ALGORITHMS, ("centre", "left")), folder), encoding="utf-8")
    return path


@pytest.fixture
def slider(shared_tab: Tab, slider_page: Path) -> Tab:
    shared_tab.size(1000, 900)
    shared_tab.send("Emulation.setEmulatedMedia", media="", features=[])
    shared_tab.complaints.clear()
    shared_tab.open(slider_page)
    shared_tab.evaluate(
        "Promise.all([...document.querySelectorAll('#slider img')].map((i) => i.decode()))"
    )
    return shared_tab


def choose(tab: Tab, name: str, value: str) -> None:
    tab.evaluate(
        f"(s => {{ s.value = {json.dumps(value)}; s.dispatchEvent(new Event('change')); }})"
        f"(document.querySelector('#slider [name={name}]'))"
    )


def stage(tab: Tab) -> np.ndarray:
    """The stage without its names and its line, at the pictures' own size, uint8."""
    tab.middle("#slider .stage")
    hide = "document.querySelectorAll('#slider .stage i, #slider .stage b')"
    box: dict[str, Any] = tab.evaluate(
        f"(() => {{ {hide}.forEach((e) => {{ e.style.visibility = 'hidden'; }});"
        "const b = document.querySelector('#slider .stage').getBoundingClientRect();"
        "return {x: b.x + scrollX, y: b.y + scrollY, width: b.width, height: b.height}; })()"
    )
    shot = tab.send("Page.captureScreenshot", clip={**box, "scale": 1}, captureBeyondViewport=True)
    picture = Image.open(io.BytesIO(base64.b64decode(shot["data"]))).convert("RGB")
    return np.asarray(picture.resize((SIZE, SIZE), Image.Resampling.BOX))


def assert_alike(picture: np.ndarray, expected: np.ndarray) -> None:
    """But for the borders of the blocks, where scaling mixes them."""
    inner = (np.arange(SIZE) % (SIZE // 8) > 3) & (np.arange(SIZE) % (SIZE // 8) < SIZE // 8 - 4)
    change = abs(picture.astype(int) - expected)[inner][:, inner]
    assert change.max() <= 2


def picture(name: str, view: str = "centre") -> np.ndarray:
    return codes(seed_of(name, view))


def slider_picture(first: str, second: str, share: float, view: str = "centre") -> np.ndarray:
    return np.where(
        (np.arange(SIZE) + 0.5 < share * SIZE)[None, :, None],
        picture(first, view),
        picture(second, view),
    )


def words(tab: Tab) -> str:
    return str(tab.evaluate("document.querySelector('#slider .stage').ariaLabel"))


def test_border_parts_ground_truth_from_the_best_algorithm(slider):
    assert_alike(stage(slider), slider_picture("Ground truth", "template", 0.5))
    assert words(slider) == ("Ground truth up to 50 % of the width, template beyond, from centre")
    x, y = slider.middle("#slider .stage")
    width = slider.evaluate("document.querySelector('#slider .stage').clientWidth")
    slider.mouse("mousePressed", (x, y))
    slider.mouse("mouseMoved", (x + width / 4, y))
    slider.mouse("mouseReleased", (x + width / 4, y))
    slider.mouse("mouseMoved", (x, y))  # let go: no more
    assert_alike(stage(slider), slider_picture("Ground truth", "template", 0.75))
    assert slider.complaints == []


def test_difference_is_the_one_the_page_prints(slider):
    slider.click("#slider [value=difference]")
    change = abs(picture("Ground truth").astype(int) - picture("template"))
    assert_alike(stage(slider), np.minimum(4 * change, 255))


def test_any_two_pictures_from_any_viewpoint(slider):
    choose(slider, "first", "Reference")
    assert_alike(stage(slider), slider_picture("Reference", "template", 0.5))
    choose(slider, "viewpoint", "left")
    # The reference is lost there: the first picture that is not takes its place.
    assert_alike(stage(slider), slider_picture("Ground truth", "template", 0.5, "left"))
    offered = "[...document.querySelector('#slider [name=first]').options].map((o) => !o.disabled)"
    assert slider.evaluate(offered) == [True, False, True, False]
    names = "[...document.querySelector('#slider [name=first]').options].map((o) => o.text)"
    assert slider.evaluate(names) == [*PLACES, NAME]
    assert slider.evaluate("document.title") != "ran"
    assert slider.complaints == []
