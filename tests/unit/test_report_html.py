"""The HTML report: one safe, self-contained page that never shows more than was measured."""

import base64
import hashlib
import io
import re
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from skimage.metrics import structural_similarity

from inim.display import DISPLAYS
from inim.report import sections as report_html
from inim.report.page import package_text
from inim.report.sections import all_sections
from inim.report.sections.views import COMPARISON_SLIDER
from inim.system.cache import ResultCache, Store
from tests.schemas import report_document

PAGE_SCRIPT = package_text("page.js")
HOSTILE = "</style><script>alert(1)</script>\"'`$\n&amp; 双耳陶罐 \x00\ud800"
VIEWS = ("centre", "left", "right", "up", "down")
VOID = {"meta", "img", "br", "link", "input", "hr"}


def render_html(data: dict[str, Any], folder: Path) -> str:
    return report_html.render_html(report_document(data), folder)


class Page(HTMLParser):
    """The page's elements and words, and a record of tags that do not pair up."""

    def __init__(self, page: str) -> None:
        super().__init__(convert_charrefs=True)
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.scripts: list[str] = []
        self.open: list[str] = []
        self.feed(page)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] == "script":
            self.scripts.append(data)
        elif self.open and self.open[-1] != "style":
            self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())

    def tags(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.elements if name == tag]

    def picture(self, alt: str) -> np.ndarray:
        source = next(i["src"] for i in self.tags("img") if i["alt"] == alt)
        return np.asarray(Image.open(io.BytesIO(base64.b64decode(source.split(",")[1]))))


def scores(ssim: float | None) -> dict[str, Any]:
    return {"ssim": ssim, "psnr_db": 27.125, "flip": 0.1234}


def view_scores(ssim: float) -> dict[str, Any]:
    own = {"ssim_to_reference": 0.98, "psnr_to_reference_db": 31.0, "flip_to_reference": 0.02}
    return {**scores(0.8), **own, "ssim_on_relic": 0.75, "ssim_on_relic_to_reference": ssim}


def displayed(**changes: Any) -> dict[str, Any]:
    display = DISPLAYS["nominal"].replace(**changes)
    return {"parameters": display.parameters(), "derived": display.derived_quantities()}


def report(
    algorithms: dict[str, float], views: tuple[str, ...] = VIEWS, *, seconds: float | None = None
) -> dict[str, Any]:
    places = dict(zip(VIEWS, [(0, 0), (-10, 0), (10, 0), (0, 10), (0, -10)], strict=True))
    return {
        "title": "Painted amphora",
        "created": "2026-11-20T09:00:00Z",
        "inim_version": "0.1.0",
        "versions": {"mitsuba": "3.9.1"},
        "command": "python -m inim.validate scenes/amphora.xml -o OUT",
        "scene": {"path": "scenes/amphora.xml", "shapes": 3},
        "settings": {"seed": 7},
        "display": displayed(),
        "backend": {"variant": "llvm_ad_rgb"},
        "lens_model": "thick",
        "viewpoints": [
            {"name": v, "position_mm": [*places.get(v, (0.0, 0.0)), 416.0]} for v in views
        ],
        "rgbd": {"rows": 64, "columns": 64, "pixel_mm": 0.25, "covered_fraction": 0.25},
        "noise_floor": {"eia": scores(0.9931), "views": {v: scores(0.9962) for v in views}},
        "reference": {"views": {v: scores(0.881) for v in views}},
        "algorithms": {
            name: {
                "seconds": seconds,
                "eia": {**scores(0.97), "hole_fraction": 0.0142},
                "views": {v: view_scores(ssim) for v in views},
            }
            for name, ssim in algorithms.items()
        },
        "timings": {"pickup": 6.0, "total": 8.0},
        "warnings": ["the capture was widened"],
        "verdict": {"passed": True, "checks": [check("template/centre: SSIM to reference", 0.97)]},
        "files": [],
    }


def check(name: str, value: float | None, passed: bool = True) -> dict[str, Any]:
    return {"name": name, "value": value, "limit": 0.9, "relation": ">=", "passed": passed}


def save(path: Path, pixels: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).save(path)


def noise(seed: int, size: int = 64) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (size, size, 3), dtype=np.uint8)


@pytest.fixture(scope="module", autouse=True)
def kept_images(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Equal images are packed and compared once for all pages of this module."""
    cache = ResultCache(Store(tmp_path_factory.mktemp("cache"), 2**30))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(report_html, "ResultCache", lambda: cache)
        yield


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """All the pictures of a report on `template` and `wang2024`."""
    folder = tmp_path / "report"
    for name in ("truth/eia", "eia/template", "eia/wang2024", "rgbd_color"):
        save(folder / f"{name}.png", noise(1, 136))
    save(folder / "rgbd_depth.png", noise(2)[..., 0])
    for seed, place in enumerate(("truth", "views/reference", "views/template", "views/wang2024")):
        for view in VIEWS:
            save(folder / place / f"{view}.png", noise(seed, 32))
    return folder


ALGORITHMS = {"template": 0.9731, "wang2024": 0.9211}
COMPARED = ["Difference of template and reference", "SSIM map of template and reference"]


def test_sections_are_in_order_and_every_link_has_a_target(folder):
    listed = all_sections()
    assert len({s.place for s in listed}) == len({s.anchor for s in listed}) == len(listed)
    page = Page(render_html(report(ALGORITHMS), folder))
    assert page.open == []
    assert page.tags("html") == [{"lang": "en"}]
    places = {attributes.get("id") for _, attributes in page.elements}
    assert {link["href"][1:] for link in page.tags("a")} <= places
    anchors = [section["id"] for section in page.tags("section")]
    assert anchors == [s.anchor for s in listed if s.anchor in anchors]
    assert (anchors[0], anchors[-1]) == ("overview", "meaning")


def test_page_needs_nothing_from_outside_and_forbids_it(folder):
    html = render_html(report(ALGORITHMS), folder)
    page = Page(html)
    assert not re.search(r"https?://|@import|url\(", html)
    assert not {"link", "iframe", "object"} & {name for name, _ in page.elements}
    policy = [m["content"] for m in page.tags("meta") if "http-equiv" in m]
    assert len(policy) == 1
    assert policy[0].startswith("default-src 'none'; img-src data:;")
    assert page.scripts == [PAGE_SCRIPT, COMPARISON_SLIDER.script]
    digests = [hashlib.sha256(script.encode()).digest() for script in page.scripts]
    allowed = " ".join(f"'sha256-{base64.b64encode(code).decode()}'" for code in digests)
    assert f"script-src {allowed};" in policy[0]


def test_hostile_names_are_shown_as_text_and_never_run(folder):
    name = "".join(c for c in HOSTILE if c.isprintable() and c != "/")  # names files
    data = report({name: 0.9}, views=(name,))
    data |= {"title": HOSTILE, "command": HOSTILE, "warnings": [HOSTILE], "lens_model": HOSTILE}
    data["settings"] = {"algorithms": HOSTILE}
    data["versions"] = {"python": HOSTILE, HOSTILE: HOSTILE}
    data["timings"] = {HOSTILE: 1.0}
    data["backend"] = {"variant": HOSTILE, "libllvm": HOSTILE, "device": HOSTILE}
    data["verdict"]["checks"] = [{**check(HOSTILE, 0.95), "detail": HOSTILE}]
    data["display"]["parameters"]["name"] = HOSTILE
    html = render_html(data, folder)
    page = Page(html)
    html.encode("utf-8")
    assert page.open == []
    assert page.scripts == [PAGE_SCRIPT]  # and no slider, for there are no pictures
    assert len(page.tags("style")) == 1
    assert "<script>alert(1)</script>" in page.text
    assert "双耳陶罐" in page.text
    assert "\x00" not in html
    allowed = {"src", "alt", "width", "height", "class", "style", "data-shows", "data-viewpoint"}
    assert {key for image in page.tags("img") for key in image} <= allowed


def png(size):
    stream = io.BytesIO()
    Image.fromarray(noise(1, size)).save(stream, "PNG")
    return stream.getvalue()


@pytest.mark.parametrize(
    ("content", "missing"),
    [
        (None, ["template", *COMPARED]),
        (b"not a picture", ["template", *COMPARED]),
        (b"\x89PNG\r\n\x1a\n cut", ["template", *COMPARED]),
        (png(48), COMPARED),  # of another size than the reference's
    ],
)
def test_missing_pictures_have_a_box(folder, content, missing):
    path = folder / "views/template/centre.png"
    path.unlink() if content is None else path.write_bytes(content)
    text = Page(render_html(report(ALGORITHMS), folder)).text
    for name in ("template", *COMPARED):
        assert (f"missing {name} from centre" in text) == (name in missing)


def test_difference_is_the_absolute_srgb_difference_times_four_as_captioned(folder):
    reference = np.full((48, 48, 3), 100, np.uint8)
    test = reference.copy()
    test[:16, :16] = (90, 103, 250)
    save(folder / "views/reference/centre.png", reference)
    save(folder / "views/template/centre.png", test)
    page = Page(render_html(report(ALGORITHMS), folder))
    difference = page.picture("Difference of template and reference from centre").astype(int)
    assert difference[:12, :12].mean(axis=(0, 1)) == pytest.approx([40, 12, 255], abs=4), (
        "with loss"
    )
    assert difference[24:].max() <= 2
    assert "amplified × 4" in page.text


def test_ssim_map_is_black_where_equal_and_its_mean_is_the_score(folder):
    """The colours, read backwards on their own scale, hold what scikit-image says."""
    reference = np.full((64, 64, 3), 100, np.uint8)
    test = reference.copy()
    test[20:40, 20:40] += np.random.default_rng(1).integers(0, 60, (20, 20, 3), np.uint8)
    save(folder / "views/reference/centre.png", reference)
    save(folder / "views/template/centre.png", test)
    page = Page(render_html(report(ALGORITHMS), folder))
    map_picture = page.picture("SSIM map of template and reference from centre").astype(int)
    scale = page.picture("Colours of the SSIM maps, from black for 1 to pale yellow for 0")
    places = abs(map_picture[:, :, None] - scale[0].astype(int)).sum(axis=-1).argmin(axis=-1)
    assert scale[0, 0].max() < 10
    assert places[:10].max() == 0
    assert places[30, 30] > 100
    score = structural_similarity(
        reference, test, data_range=255, channel_axis=-1, gaussian_weights=True,
        sigma=1.5, use_sample_covariance=False,
    )  # fmt: skip
    # Edges apart, which scikit-image leaves out of its mean; 256 colours, and none below 0.
    assert 1 - places[5:-5, 5:-5].mean() / 255 == pytest.approx(score, abs=4e-3)


@pytest.mark.parametrize(
    ("intervals", "words"),
    [
        ([(0.04, 0.06), (0.05, 0.07)], "template is better than wang2024 by 0.050 [0.045, 0.065]."),
        ([(-0.02, 0.1), (0.01, 0.2)], "do not differ significantly: 0.050 [−0.005, 0.150]."),
        ([(None, None), (0.01, 0.2)], ""),
    ],
)
def test_the_sentence_has_the_difference_of_the_best_to_the_next(folder, intervals, words):
    data = report({"template": 0.98, "wang2024": 0.93}, VIEWS[:2])
    data["differences"] = [
        {"algorithm": "template", "other": "wang2024", "viewpoint": view, "value": 0.05,
         "interval": interval}
        for view, interval in zip(VIEWS, intervals, strict=False)
    ]  # fmt: skip
    text = Page(render_html(data, folder)).text
    assert "Mean SSIM to the reference: template 0.98, wang2024 0.93." in text
    assert words in text
    assert ("better than" in text or "differ significantly" in text) is bool(words)


def test_a_score_above_the_noise_floor_has_a_footnote(folder):
    data = report({"template": 0.98, "wang2024": 0.96})
    for floor in data["noise_floor"]["views"].values():
        floor["ssim_on_relic"] = 0.97
    page = render_html(data, folder)
    assert page.count("0.980<sup>1</sup>") == page.count("<sup>1</sup>") == len(VIEWS)
    assert "¹ Above the noise floor" in page
    assert "¹" not in render_html(report(ALGORITHMS), folder)


def test_verdict_is_a_word_and_not_only_a_colour(folder):
    data = report(ALGORITHMS)
    text = Page(render_html(data, folder)).text
    assert "– Ran clean 1 of 1 checks passed; no criteria set" in text
    assert "-D 'inim.min_ssim_to_reference=" in text
    data["verdict"]["checks"][0]["criterion"] = True
    assert "✓ Passed 1 of 1 checks passed" in Page(render_html(data, folder)).text
    data["verdict"] = {"passed": False, "checks": [check("template: SSIM", 0.85, passed=False)]}
    text = Page(render_html(data, folder)).text
    assert "✕ Failed 0 of 1 checks passed" in text
    assert "template: SSIM 0.8500, required ≥ 0.9000" in text


@pytest.mark.parametrize("share", [0.8, 0.3])
def test_page_too_large_is_built_again_with_smaller_pictures(folder, monkeypatch, share):
    for place in ("truth", "views/reference", "views/template"):
        save(folder / place / "centre.png", noise(3, 256))
    data = report({"template": 0.97}, views=("centre",))
    limit = round(share * len(render_html(data, folder)))
    monkeypatch.setattr(report_html, "LARGEST_PAGE_BYTES", limit)
    page = render_html(data, folder)
    assert len(page.encode()) < limit
    assert page.count("data:image/webp") >= 10


# --- Time against error, what was skipped -------------------------------------------------------
