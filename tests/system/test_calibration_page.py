"""The page of patterns in a real browser: one panel pixel is one device pixel, and all is shown."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from inim.calibration.patterns import patterns, write_patterns
from tests.chromium import NO_WEBGL, Tab, browser
from tests.conftest import small_display

DISPLAY = small_display(30, 24, 17)
ROWS, COLUMNS = DISPLAY.eia_shape
NAMES = [pattern.name for pattern in patterns(DISPLAY)]


def title(number: int, position: int = 1) -> str:
    """Title of the window while it shows a picture."""
    return f"Position {position}: {number + 1} of 7, {NAMES[number]}"


@pytest.fixture(scope="module")
def tab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tab]:
    with browser(NO_WEBGL) as opened:
        yield opened


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_patterns(DISPLAY, tmp_path_factory.mktemp("patterns"))


def window(tab: Tab, size: tuple[int, int], ratio: float = 1, *, mobile: bool = False) -> None:
    """A screen and window of so many device pixels, of a browser with this ratio."""
    width, height = (math.ceil(pixels / ratio) for pixels in size)
    tab.send(
        "Emulation.setDeviceMetricsOverride",
        width=width,
        height=height,
        deviceScaleFactor=0,  # as it is
        mobile=mobile,
        screenWidth=width,
        screenHeight=height,
    )


def begin(tab: Tab, page: Path) -> None:
    tab.open(page)
    # Full screen would leave the emulated window.
    tab.evaluate("document.documentElement.requestFullscreen = undefined")
    tab.click("#start")
    tab.until(f"document.title === {title(0)!r}")


def warning(tab: Tab) -> str:
    words: str = tab.evaluate(
        "['warning', 'bar'].map(id => document.getElementById(id))"
        ".filter(e => e.checkVisibility()).map(e => e.textContent).join()"
    )
    return words


def shot(tab: Tab, path: Path) -> np.ndarray:
    tab.screenshot(path, whole=False)
    with Image.open(path) as picture:
        return np.asarray(picture.convert("RGB"))


@pytest.mark.parametrize(
    ("ratio", "size"),
    [
        (1, (COLUMNS, ROWS)),
        pytest.param(1, (COLUMNS + 91, ROWS + 34), marks=pytest.mark.slow),
        (2, (COLUMNS, ROWS)),
        pytest.param(2.625, (COLUMNS, ROWS), marks=pytest.mark.slow),
        pytest.param(1.25, (COLUMNS + 50, ROWS + 100), marks=pytest.mark.slow),
    ],
)
def test_a_panel_pixel_is_a_device_pixel_at_any_ratio(page, tmp_path, ratio, size):
    # Of a ratio that is emulated the browser does not say what it rounds.
    flags = (*NO_WEBGL, f"--force-device-scale-factor={ratio}")
    with browser(flags) as tab:
        window(tab, size, ratio)
        check_all_pictures(tab, page, tmp_path)


def in_the_middle(screenshot: np.ndarray, expected: np.ndarray) -> bool:
    """True if a picture stands there unscaled, less than three pixels off the middle."""
    windows = np.lib.stride_tricks.sliding_window_view(screenshot, expected.shape)
    rows, columns = np.nonzero((windows == expected).all(axis=(2, 3)))
    middle = [(size - 1) / 2 for size in windows.shape[:2]]
    off = np.hypot(rows - middle[0], columns - middle[1])
    return bool(off.size and off.min() < 3)


def check_all_pictures(tab: Tab, page: Path, tmp_path: Path) -> None:
    begin(tab, page)
    assert warning(tab) == ""
    for number, name in enumerate(NAMES):
        tab.until(f"document.title === {title(number)!r}")
        if "white" in name or "phase-120" in name:
            screenshot = shot(tab, tmp_path / "shot.png")
            with Image.open(page.with_name(f"{name}.png")) as picture:
                expected = np.asarray(picture)
            assert in_the_middle(screenshot[..., 0], expected), name
            assert (screenshot == screenshot[..., :1]).all()
        tab.key(" ")
    assert tab.evaluate("document.getElementById('end').checkVisibility()")
    assert tab.complaints == []


def test_taps_and_keys_go_on_and_back(tab, page):
    window(tab, (COLUMNS, ROWS))
    begin(tab, page)

    def window_title() -> str:
        return str(tab.evaluate("document.title"))

    tab.click("#panel")
    assert window_title() == title(1)
    tab.key("ArrowRight")
    assert window_title() == title(2)
    tab.key("ArrowLeft")
    tab.key("ArrowLeft")
    tab.key("ArrowLeft")
    assert window_title() == title(0)
    tab.key("Escape")
    assert "Patterns for" in window_title()
    assert not tab.evaluate("document.getElementById('end').checkVisibility()")
    tab.click("#start")
    tab.until(f"document.title === {title(0)!r}")


def test_the_timer_shows_all_pictures_in_order(tab, page):
    window(tab, (COLUMNS, ROWS))
    tab.open(page)
    tab.evaluate(
        "document.documentElement.requestFullscreen = undefined;"
        "document.getElementById('seconds').value = 0.02; window.seen = [];"
        "new MutationObserver(() => seen.push(document.title))"
        ".observe(document.querySelector('title'), { childList: true })"
    )
    tab.click("#start")
    tab.until("document.getElementById('end').checkVisibility()")
    titles = [words for words in tab.evaluate("seen") if words.startswith("Position")]
    assert list(dict.fromkeys(titles)) == [title(number) for number in range(7)]
    words = tab.evaluate("document.getElementById('count').textContent")
    assert words == "Position 1 is complete: 7 pictures."
    tab.click("#start")
    tab.until(f"document.title === {title(0, position=2)!r}")


def test_a_page_magnified_by_fingers_warns(tab, page):
    window(tab, (COLUMNS, ROWS), mobile=True)
    begin(tab, page)
    assert warning(tab) == ""
    tab.send("Emulation.setPageScaleFactor", pageScaleFactor=1.5)
    tab.until("!document.getElementById('bar').hidden")
    assert "magnified 1.50 times" in warning(tab)
    tab.send("Emulation.setPageScaleFactor", pageScaleFactor=1)
    tab.until("document.getElementById('bar').hidden")


def test_a_scaled_picture_warns(tab, page):
    """A browser may not keep to the requested size."""
    window(tab, (COLUMNS, ROWS))
    begin(tab, page)
    tab.evaluate("document.documentElement.style.zoom = 1.1")
    tab.until("!document.getElementById('bar').hidden")
    assert "The browser scales" in warning(tab)


def test_a_window_too_small_warns_while_it_shows_and_a_screen_too_small_before(tab, page):
    window(tab, (COLUMNS - 40, ROWS))
    tab.open(page)
    words = warning(tab)
    assert "do not fit" in words and f"{COLUMNS - 40} × {ROWS}" in words
    begin(tab, page)
    assert f"the window has {COLUMNS - 40} × {ROWS}" in warning(tab)
