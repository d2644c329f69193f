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
from inim.image.files.image import read_rgbd, write_rgbd
from inim.image.rgbd import RGBD
from inim.report import sections as report_html
from inim.report.diagram import column_depths, describe_plan, plan_view
from inim.report.page import package_text
from inim.report.sections import all_sections
from inim.report.sections.views import COMPARISON_SLIDER
from inim.scores.document_parts import EyePosition
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

    def all_alts(self) -> str:
        return "; ".join(image["alt"] for image in self.tags("img"))

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


def test_depth_of_the_relic_is_stated_with_the_display(folder):
    """13.2 mm, at 2 mm of depth and 5 mm of width for one unit of the scene."""
    data = report(ALGORITHMS)
    data["scene"]["fit"] = {"depth_mm": None}
    assert "deep here" not in render_html(data, folder)
    data["scene"]["fit"] = {"scale_xy": 5.0, "scale_z": 2.0, "depth_mm": 13.2}
    html = render_html(data, folder).replace("\xa0", " ")
    assert "The relic is 13.2 mm deep here, 40 % of its own depth" in html


def test_first_screen_names_the_best_algorithm_and_the_next(folder):
    html = render_html(report({"template": 0.958, "gu2020": 0.871}), folder).replace("\xa0", " ")
    assert "template keeps 96 % of what this display can show; the next, gu2020, 87 %." in html


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


def test_picture_smaller_than_ssim_s_window_has_no_map(folder):
    for place in ("views/reference", "views/template"):
        save(folder / place / "centre.png", noise(1, 10))
    text = Page(render_html(report(ALGORITHMS), folder)).text
    assert [f"missing {name} from centre" in text for name in COMPARED] == [False, True]


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


def test_eia_crop_shows_the_same_busiest_lenses_of_every_array_unscaled(folder):
    truth = np.full((1088, 1088, 3), 128, np.uint8)
    top, left, size = 17 * 30, 17 * 22, 5 * 17
    truth[top : top + size, left : left + size] = noise(5, size)
    eia = noise(6, 1088)
    save(folder / "truth/eia.png", truth)
    save(folder / "eia/template.png", eia)
    page = Page(render_html(report(ALGORITHMS), folder))
    cut = np.s_[top : top + size, left : left + size]
    crop = page.picture("Magnified elemental images, Ground-truth EIA")
    np.testing.assert_array_equal(crop, truth[cut])
    crop = page.picture("Magnified elemental images, template")
    np.testing.assert_array_equal(crop, eia[cut])


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


def test_first_pictures_are_ground_truth_reference_and_best_algorithm(folder):
    page = Page(render_html(report({"wang2024": 0.91, "template": 0.97}), folder))
    assert [image["alt"] for image in page.tags("img")][:3] == [
        "Ground truth, viewpoint centre",
        "Reference, viewpoint centre",
        "template, viewpoint centre",
    ]


def test_parallax_strips_go_by_position_not_by_order(folder):
    page = Page(render_html(report(ALGORITHMS), folder))
    thumbnails = [image["alt"] for image in page.tags("img") if " from " in image["alt"]]
    across = [f"Ground truth from {view}" for view in ("left", "centre", "right")]
    down = [f"Ground truth from {view}" for view in ("up", "centre", "down")]
    html = " ".join(thumbnails)
    assert " ".join(across) in html
    assert " ".join(down) in html


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


def test_pictures_are_left_out_with_a_note_as_the_last_resort(folder, monkeypatch):
    monkeypatch.setattr(report_html, "LARGEST_PAGE_BYTES", 60_000)
    page = Page(render_html(report(ALGORITHMS), folder))
    drawings = ("Plan view", "Captured surface")
    assert all(image["alt"].startswith(drawings) for image in page.tags("img"))
    assert "left out, the page would be too large Ground truth from centre" in page.text


def test_parallax_is_left_out_with_its_link_without_views_in_a_line(folder):
    page = Page(render_html(report(ALGORITHMS, views=("centre",)), folder))
    assert "parallax" not in {section["id"] for section in page.tags("section")}
    assert "#parallax" not in {link["href"] for link in page.tags("a")}


def test_timings_say_how_much_the_renderer_took_and_do_not_count_it_as_a_stage(folder):
    data = report(ALGORITHMS)
    data["timings"] = {"pickup": 6.0, "score": 2.0, "mitsuba_render": 4.0, "total": 8.0}
    text = Page(render_html(data, folder)).text
    assert "8.00 s in total, of which the renderer took 4.00 s (50 %)." in text
    assert "pickup 6.00 75.0 %" in text
    assert "mitsuba render" not in text


def depth_step(folder: Path, near_mm: float) -> dict[str, Any]:
    """A report whose relic is a step: its left half at 20 mm, its right half at `near_mm`."""
    depth = np.full((40, 40), 20.0, np.float32)
    depth[:, 20:] = near_mm
    covered = np.zeros((40, 40), bool)
    covered[10:30, 10:30] = True
    write_rgbd(folder / "rgbd.exr", RGBD(np.ones((40, 40, 3)), depth, covered, 2.0))
    data = report(ALGORITHMS)
    data["rgbd"] |= {"depth_min_mm": 20.0, "depth_max_mm": near_mm}
    return data


def test_depth_profile_has_the_nearer_half_to_the_right(folder):
    depth_step(folder, 40.0)
    x, far, near = column_depths(read_rgbd(folder / "rgbd.exr"))
    covered = np.isfinite(far)
    assert covered.sum() == 20
    assert x[covered] == pytest.approx(2 * (np.arange(20) - 9.5))
    assert far[covered] == pytest.approx([20.0] * 10 + [40.0] * 10)
    assert near[covered] == pytest.approx(far[covered])


@pytest.mark.parametrize(("near_mm", "words"), [(40.0, "is inside"), (60.0, "extends beyond")])
def test_depth_profile_states_if_the_relic_is_in_the_depth_range(folder, near_mm, words):
    data = depth_step(folder, near_mm)
    text = Page(render_html(data, folder)).text
    assert f"the relic {words} the display's depth range" in text


@pytest.mark.parametrize("content", [None, b"not a picture"])
def test_depth_profile_without_a_depth_picture_is_left_out(folder, content):
    if content is not None:
        (folder / "rgbd.exr").write_bytes(content)
    assert "Depth along the array" not in Page(render_html(report(ALGORITHMS), folder)).text


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: None, "lighter is nearer to the viewer"),
        (lambda d: None, "in front of the lens array"),
        (lambda d: d["display"].update(displayed(gap_mm=2.7)), "behind the lens array"),
        (lambda d: d["display"]["derived"].update(depth_range_is_cut=True), "Depth range cut."),
        (lambda d: d["display"]["derived"].update(central_depth_mm=None),
         "It is focused (gap = focal length)"),
        (lambda d: d.update(settings={"fit_share": 0.123456789}), "0.123456789"),
    ],
)  # fmt: skip
def test_page_agrees_with_the_report(folder, change, words):
    data = report(ALGORITHMS)
    plain = render_html(data, folder)
    change(data)
    page = render_html(data, folder)
    assert words in Page(page).text
    assert page == plain or words not in Page(plain).text


def test_plan_view_names_the_eyes_and_escapes_them():
    display = DISPLAYS["nominal"]
    places = {"<b>": (0.0, 0.0, 416.0), "up $": (0.0, 9.0, 416.0)}
    eyes = [EyePosition(name=name, position_mm=place) for name, place in places.items()]
    drawing = Page(plan_view(display, eyes).decode())
    assert "<b>, up $" in drawing.text
    assert drawing.tags("b") == []
    assert "eyes: <b> at 416 mm; up $ at 416 mm" in describe_plan(display, eyes)


# --- Time against error, what was skipped -------------------------------------------------------


def plot_words(page: Page) -> str:
    source = next(i["src"] for i in page.tags("img") if i["alt"].startswith("Time against error"))
    return Page(base64.b64decode(source.split(",")[1]).decode()).text


def test_time_against_error_has_every_algorithm_and_its_numbers(folder):
    data = report(ALGORITHMS, seconds=0.5)
    data["algorithms"]["wang2024"]["seconds"] = 12.0
    page = Page(render_html(data, folder))
    alt = next(i["alt"] for i in page.tags("img") if i["alt"].startswith("Time against error"))
    assert "template 0.5 seconds, 1 − SSIM on the relic, to the reference 0.027" in alt
    assert "wang2024 12 seconds, 1 − SSIM on the relic, to the reference 0.079" in alt
    words = plot_words(page)
    assert words.count("template") == words.count("wang2024") == 2
    assert "noise floor" in words


def test_algorithm_without_a_time_has_no_point(folder):
    data = report(ALGORITHMS)
    assert "time" not in {s["id"] for s in Page(render_html(data, folder)).tags("section")}
    data["algorithms"]["template"]["seconds"] = 0.5
    assert "wang2024" not in plot_words(Page(render_html(data, folder)))


def test_times_in_yardsticks_are_taken_where_all_have_them(folder):
    data = report(ALGORITHMS, seconds=0.5)
    data["algorithms"]["template"]["yardsticks"] = 1.5
    assert "template 0.5 seconds" in Page(render_html(data, folder)).all_alts()
    data["algorithms"]["wang2024"]["yardsticks"] = 60.0
    page = Page(render_html(data, folder))
    assert "template 1.5 kernel times" in page.all_alts()
    assert "medians of warm runs" in page.text


def test_skipped_steps_are_listed_with_their_reason(folder):
    rows = [{"step": HOSTILE, "performed": "3 of 5", "skipped": "2", "why": "nothing moves there"}]
    page = Page(render_html({**report(ALGORITHMS), "skipped": rows}, folder))
    assert "3 of 5 2 nothing moves there" in page.text
    assert page.scripts == [PAGE_SCRIPT, COMPARISON_SLIDER.script]
