"""The virtual display's page: exact panels, one script that may run, and nothing from outside."""

import base64
import hashlib
import io
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from inim.display import Display
from inim.image.color import linear_from_srgb, srgb_from_linear, srgb_to_uint8
from inim.report.page import package_text
from inim.report.virtual_display import LIVE, still_view
from tests.conftest import small_display
from tests.unit.test_report_html import Page, noise, render_html, report, save

DISPLAY = small_display(12, 10, 8)
PAGE_SCRIPT = package_text("page.js")


def shown_report(folder: Path, names=("template",), display: Display = DISPLAY) -> dict[str, Any]:
    """A report of a small display whose EIAs are there."""
    data = report(dict.fromkeys(names, 0.9) | {names[0]: 0.95})
    data["display"] = {"parameters": display.parameters(), "derived": display.derived_quantities()}
    for seed, place in enumerate(["truth/eia", *(f"eia/{name}" for name in names)]):
        rows, columns = display.eia_shape
        save(folder / f"{place}.png", noise(seed, max(rows, columns))[:rows, :columns])
    return data


def block(page: str) -> dict[str, Any]:
    """Data that the page hands to its script."""
    whole = Page(page)
    ids = [tag.get("id") for tag in whole.tags("script")]
    assert ids.count("virtual-display-data") == 1
    return json.loads(whole.scripts[ids.index("virtual-display-data")])


def picture(source: str) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(source.split(",")[1]))))


def test_every_panel_is_embedded_once_and_exactly(tmp_path):
    page = render_html(shown_report(tmp_path, ("template", "wang2024")), tmp_path)
    data = block(page)
    assert [panel["name"] for panel in data["panels"]] == ["Reference", "template", "wang2024"]
    for seed, panel in enumerate(data["panels"]):
        np.testing.assert_array_equal(picture(panel["source"]), noise(seed, 96)[:80, :96])
        assert page.count(panel["source"]) == 1
    assert data["start"] == [0, 1]


def test_only_the_display_s_own_script_may_run(tmp_path):
    page = render_html(shown_report(tmp_path), tmp_path)
    whole = Page(page)
    tags = zip(whole.tags("script"), whole.scripts, strict=True)
    running = [text for attributes, text in tags if "type" not in attributes]
    assert running == [PAGE_SCRIPT, LIVE.script]
    digests = [
        base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in running
    ]
    policy = next(m["content"] for m in whole.tags("meta") if "http-equiv" in m)
    directives = dict(d.split(" ", 1) for d in policy.split("; "))
    assert directives["default-src"] == "'none'"
    assert directives["script-src"] == " ".join(f"'sha256-{script}'" for script in digests)
    assert directives["img-src"] == "data:"
    assert not re.search(r"https?://|@import|url\(|\beval\b|Function\(|fetch\(", page)


def panel_of_places(display: Display) -> np.ndarray:
    """An EIA whose red is the lens column's parity and whose green counts pixels under a lens."""
    columns = np.arange(display.eia_shape[1])
    codes = np.zeros((*display.eia_shape, 3), np.uint8)
    codes[..., 0] = 255 * (columns // 8 % 2)
    codes[..., 1] = 30 * (columns % 8)
    return codes


def test_eye_far_off_sees_one_pixel_column_of_every_lens():
    """x = centre + g (X - e) / V: an eye at e sees, in each lens, what lies -g e / V off centre."""
    codes = panel_of_places(DISPLAY)
    distance = 1e6
    for pixel in range(8):
        pixel_offset = (pixel + 0.5 - 4) / 8  # mm from the lens's centre
        eye = (-pixel_offset * distance / DISPLAY.gap_mm, 0.0, distance)
        view = still_view(codes, DISPLAY, eye, pixels_per_lens=1, grid=2)
        assert (view[..., 1] == 30 * pixel).all()
        assert (view[..., 0] == 255 * (np.arange(12) % 2)).all()


def test_half_lit_pixel_is_the_mean_of_its_light_not_of_its_codes():
    """A lens's height, one gap away, spans eight panel pixels, every other one lit."""
    codes = np.zeros((*DISPLAY.eia_shape, 3), np.uint8)
    codes[::2] = 255
    view = still_view(codes, DISPLAY, (0, 0, DISPLAY.gap_mm), pixels_per_lens=1, grid=8)
    half = srgb_to_uint8(srgb_from_linear(linear_from_srgb(np.array([0, 1])).mean()))
    assert half == 188
    assert (view[3:7, 4:8] == half).all()
