"""The system's Chromium, headless, controlled by Playwright."""

import atexit
import json
import shutil
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import pytest

_NAMES = ("chromium", "chromium-browser", "google-chrome")
_FLAGS = (
    "--disable-gpu",
    "--disable-dev-shm-usage",
    "--force-prefers-reduced-motion",  # no animated display unless a test requests it
)
#: WebGL in software.
WEBGL = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader")
NO_WEBGL = ("--disable-3d-apis",)
_TIMEOUT_MS = 90_000


class Tab:
    """A page with its errors and warnings.

    Attributes
    ----------
    complaints : list of str
        Errors and warnings of the console, uncaught exceptions and log entries.
    """

    def __init__(self, page: Any) -> None:
        self.complaints: list[str] = []
        self._page, self._devtools = page, page.context.new_cdp_session(page)
        page.set_default_timeout(_TIMEOUT_MS)
        page.on("console", lambda message: self._note(message.type, message.text))
        page.on("pageerror", lambda error: self._note("error", str(error)))
        self._devtools.on(
            "Log.entryAdded",
            lambda event: self._note(event["entry"]["level"], event["entry"]["text"]),
        )
        for domain in ("Log", "Page"):
            self.send(f"{domain}.enable")
        self.evaluate, self.click = page.evaluate, page.click

    def _note(self, level: str, text: str) -> None:
        # Software rendering always warns that reading pixels is slow.
        slow = "GL Driver Message (OpenGL, Performance" in text
        if level in ("error", "warning", "assert") and not slow:
            self.complaints.append(f"{level}: {text}")

    def _note_log(self, level: str, text: str, **_: Any) -> None:
        self._note(level, text)

    def send(self, method: str, **params: Any) -> Any:
        """Send a DevTools command and return its result."""
        return self._devtools.send(method, params)

    def open(self, path: Path, query: str = "") -> None:
        """Load a file with its pictures."""
        self._page.goto(path.resolve().as_uri() + query)

    def size(self, width: int, height: int, *, mobile: bool = False) -> None:
        """Set the viewport size in CSS pixels."""
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": mobile}
        self.send("Emulation.setDeviceMetricsOverride", **size)

    def until(self, expression: str, seconds: float = 30.0) -> None:
        """Wait until a JavaScript expression is true."""
        end = time.monotonic() + seconds
        while not self.evaluate(expression):
            assert time.monotonic() < end, f"never came true: {expression}"
            self._page.wait_for_timeout(50)

    def middle(self, selector: str) -> tuple[float, float]:
        """Scroll an element into view and return its middle in window coordinates."""
        script = (
            f"(() => {{ const e = document.querySelector({json.dumps(selector)});"
            "e.scrollIntoView({block: 'center', behavior: 'instant'});"
            "const b = e.getBoundingClientRect();"
            "return [b.x + b.width / 2, b.y + b.height / 2]; })()"
        )
        x, y = self.evaluate(script)
        return x, y

    def drag(self, selector: str, by: tuple[float, float]) -> None:
        """Press in the middle of an element, move in ten steps, and release."""
        x, y = self.middle(selector)
        mouse = self._page.mouse
        mouse.move(x, y)
        mouse.down()
        mouse.move(x + by[0], y + by[1], steps=10)
        mouse.up()

    def mouse(self, kind: str, at: tuple[float, float], **more: Any) -> None:
        """Send a mouse event: `mousePressed`, `mouseMoved`, `mouseReleased`, `mouseWheel`."""
        button = {"button": "left", "buttons": 1, "clickCount": 1} if kind != "mouseWheel" else {}
        self.send("Input.dispatchMouseEvent", type=kind, x=at[0], y=at[1], **(button | more))

    def key(self, name: str) -> None:
        """Press and release a key."""
        self._page.keyboard.press(name)

    def screenshot(self, path: Path, *, whole: bool = True) -> None:
        """Save the page as PNG."""
        self._page.screenshot(path=path, full_page=whole)


@cache
def _playwright() -> Any:
    """Start Playwright once per process."""
    from playwright.sync_api import sync_playwright

    playwright = sync_playwright().start()
    atexit.register(playwright.stop)
    return playwright


@contextmanager
def browser(flags: Sequence[str] = WEBGL) -> Iterator[Tab]:
    """Open a tab in a new browser; skip the test without Chromium."""
    program = next(filter(None, map(shutil.which, _NAMES)), None)
    if program is None:
        pytest.skip(f"none of {', '.join(_NAMES)} is installed")
    chromium = _playwright().chromium.launch(executable_path=program, args=[*_FLAGS, *flags])
    # "null" leaves these to the flags and the tests.
    media = dict.fromkeys(("color_scheme", "reduced_motion", "forced_colors"), "null")
    try:
        yield Tab(chromium.new_page(no_viewport=True, **media))
    finally:
        chromium.close()
