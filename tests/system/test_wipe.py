"""The wipe in a real browser: two views over each other, as the page's own pictures are.

Expected: what is left of the border is the first picture and what is right of it the second, pixel
for pixel; a flip shows either; the difference is the one the page prints; all of it with mouse and
keyboard alike, and nothing of it without scripts or on paper.
"""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from tests.chromium import Tab, browser
from tests.unit.test_report_html import render_html, report

NAME = "<img src=x onerror=document.title='ran'>"
ALGORITHMS = {"template": 0.97, NAME: 0.92}
SIZE = 160
PLACES = {"Ground truth": "truth", "Ceiling": "views/ceiling", "template": "views/template"}


def codes(seed: int) -> np.ndarray:
    """Blocks of colour, which a browser that scales them leaves alone but for their borders."""
    blocks = np.random.default_rng(seed).integers(0, 256, (8, 8, 3), np.uint8)
    return np.kron(blocks, np.ones((SIZE // 8, SIZE // 8, 1), np.uint8))


def seed_of(name: str, view: str) -> int:
    return 10 * list(PLACES).index(name) + ("centre", "left").index(view)


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A report whose ceiling was lost from the left, and one algorithm has no pictures at all."""
    folder = tmp_path_factory.mktemp("wipe")
    for name, place in PLACES.items():
        for view in ("centre", "left"):
            if (name, view) != ("Ceiling", "left"):
                path = folder / place / f"{view}.png"
                path.parent.mkdir(parents=True, exist_ok=True)
                Image.fromarray(codes(seed_of(name, view))).save(path)
    path = folder / "report.html"
    path.write_text(render_html(report(ALGORITHMS, ("centre", "left")), folder), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def shared_tab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tab]:
    with browser() as tab:
        yield tab


@pytest.fixture
def tab(shared_tab: Tab, page: Path) -> Tab:
    shared_tab.size(1000, 900)
    shared_tab.send("Emulation.setEmulatedMedia", media="", features=[])
    shared_tab.complaints.clear()
    shared_tab.open(page)
    shared_tab.evaluate(
        "Promise.all([...document.querySelectorAll('#wipe img')].map((i) => i.decode()))"
    )
    return shared_tab


def choose(tab: Tab, name: str, value: str) -> None:
    tab.evaluate(
        f"(s => {{ s.value = {json.dumps(value)}; s.dispatchEvent(new Event('change')); }})"
        f"(document.querySelector('#wipe [name={name}]'))"
    )


def stage(tab: Tab) -> np.ndarray:
    """The stage without its names and its line, at the pictures' own size, uint8."""
    tab.middle("#wipe .stage")
    hide = "document.querySelectorAll('#wipe .stage i, #wipe .stage b')"
    box: dict[str, Any] = tab.evaluate(
        f"(() => {{ {hide}.forEach((e) => {{ e.style.visibility = 'hidden'; }});"
        "const b = document.querySelector('#wipe .stage').getBoundingClientRect();"
        "return {x: b.x + scrollX, y: b.y + scrollY, width: b.width, height: b.height}; })()"
    )
    shot = tab.send("Page.captureScreenshot", clip={**box, "scale": 1}, captureBeyondViewport=True)
    picture = Image.open(io.BytesIO(base64.b64decode(shot["data"]))).convert("RGB")
    return np.asarray(picture.resize((SIZE, SIZE), Image.Resampling.BOX))


def assert_alike(seen: np.ndarray, expected: np.ndarray) -> None:
    """But for the borders of the blocks, where scaling mixes them."""
    inner = (np.arange(SIZE) % (SIZE // 8) > 3) & (np.arange(SIZE) % (SIZE // 8) < SIZE // 8 - 4)
    change = abs(seen.astype(int) - expected)[inner][:, inner]
    assert change.max() <= 2


def picture(name: str, view: str = "centre") -> np.ndarray:
    return codes(seed_of(name, view))


def wiped(first: str, second: str, share: float, view: str = "centre") -> np.ndarray:
    return np.where(
        (np.arange(SIZE) + 0.5 < share * SIZE)[None, :, None],
        picture(first, view),
        picture(second, view),
    )


def words(tab: Tab) -> str:
    return str(tab.evaluate("document.querySelector('#wipe .stage').ariaLabel"))


def test_border_parts_ground_truth_from_the_best_algorithm(tab):
    assert_alike(stage(tab), wiped("Ground truth", "template", 0.5))
    assert words(tab) == ("Ground truth up to 50 % of the width, template beyond, from centre")
    x, y = tab.middle("#wipe .stage")
    width = tab.evaluate("document.querySelector('#wipe .stage').clientWidth")
    tab.mouse("mousePressed", (x, y))
    tab.mouse("mouseMoved", (x + width / 4, y))
    tab.mouse("mouseReleased", (x + width / 4, y))
    tab.mouse("mouseMoved", (x, y))  # let go: no more
    assert_alike(stage(tab), wiped("Ground truth", "template", 0.75))
    assert tab.complaints == []


def test_border_moves_from_the_keyboard(tab):
    tab.evaluate("document.querySelector('#wipe [name=border]').focus()")
    tab.key("Home")
    assert_alike(stage(tab), picture("template"))
    tab.key("End")
    assert_alike(stage(tab), picture("Ground truth"))
    tab.key("ArrowLeft")
    assert "up to 99 %" in tab.evaluate("document.activeElement.getAttribute('aria-valuetext')")


def test_flip_shows_either_where_it_lies(tab):
    tab.click("#wipe [value=flip]")
    assert_alike(stage(tab), picture("Ground truth"))
    tab.click("#wipe [name=flip]")
    assert_alike(stage(tab), picture("template"))
    tab.click("#wipe .stage")
    assert_alike(stage(tab), picture("Ground truth"))
    assert tab.evaluate("document.querySelector('#wipe .spoken').textContent") == (
        "Ground truth, from centre"
    )
    tab.click("#wipe [name=by-itself]")
    tab.until("document.querySelector('#wipe .stage').ariaLabel.startsWith('template')")
    tab.until("document.querySelector('#wipe .stage').ariaLabel.startsWith('Ground')")
    tab.click("#wipe [name=by-itself]")
    before = words(tab)
    assert tab.evaluate("new Promise((r) => setTimeout(r, 1000)).then(() => 1)") == 1
    assert words(tab) == before
    assert tab.complaints == []


def test_difference_is_the_one_the_page_prints(tab):
    tab.click("#wipe [value=difference]")
    change = abs(picture("Ground truth").astype(int) - picture("template"))
    assert_alike(stage(tab), np.minimum(4 * change, 255))


def test_any_two_pictures_from_any_viewpoint(tab):
    choose(tab, "first", "Ceiling")
    assert_alike(stage(tab), wiped("Ceiling", "template", 0.5))
    choose(tab, "viewpoint", "left")
    # The ceiling is lost there: the first picture that is not takes its place.
    assert_alike(stage(tab), wiped("Ground truth", "template", 0.5, "left"))
    offered = "[...document.querySelector('#wipe [name=first]').options].map((o) => !o.disabled)"
    assert tab.evaluate(offered) == [True, False, True, False]
    names = "[...document.querySelector('#wipe [name=first]').options].map((o) => o.text)"
    assert tab.evaluate(names) == [*PLACES, NAME]
    assert tab.evaluate("document.title") != "ran"
    assert tab.complaints == []


def test_every_control_has_a_name(tab):
    nameless = tab.evaluate(
        "[...document.querySelectorAll('#wipe :is(input, select, button)')]"
        ".filter((e) => !(e.textContent.trim() || e.closest('label')?.textContent.trim()))"
        ".map((e) => e.name)"
    )
    assert nameless == []


def test_without_scripts_and_on_paper_only_the_views_stand(tab, page):
    height = "document.getElementById('wipe').clientHeight"
    assert tab.evaluate(height) > 300
    tab.send("Emulation.setEmulatedMedia", media="print")
    assert tab.evaluate(height) == 0
    tab.send("Emulation.setEmulatedMedia", media="")
    tab.send("Emulation.setScriptExecutionDisabled", value=True)
    try:
        tab.open(page)
        assert tab.evaluate(height) == 0
    finally:
        tab.send("Emulation.setScriptExecutionDisabled", value=False)


def test_page_without_two_pictures_keeps_it_hidden(tab, tmp_path):
    path = tmp_path / "truth" / "centre.png"
    path.parent.mkdir()
    Image.fromarray(codes(0)).save(path)
    (tmp_path / "report.html").write_text(
        render_html(report(ALGORITHMS, ("centre",)), tmp_path), encoding="utf-8"
    )
    tab.open(tmp_path / "report.html")
    assert tab.evaluate("document.getElementById('wipe').hidden") is True
    assert tab.complaints == []
