"""Figures and error maps of a report, from the command line."""

import shutil
from itertools import combinations

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text
from msgspec.structs import replace
from PIL import Image

from inim.image.files.image import read_exr
from inim.report import Report
from inim.report.figure import FigureRequest, draw_figure
from inim.report.plots import colour_of, marker_of
from inim.scores.metrics import ssim_map
from inim.system.errors import EXIT_PASSED
from tests.system.conftest import assert_refused, run_here, write_scene

ALGORITHMS = ("template:samples=1:colour=smooth:fill=none", "gu2020:samples=1:fill=none")


@pytest.fixture(scope="module")
def out(tmp_path_factory, run_inim):
    """Report of two algorithms and two viewpoints."""
    folder = tmp_path_factory.mktemp("figure")
    options = ("--algorithms", ",".join(ALGORITHMS), "--viewpoints", "centre,left")
    ended = run_inim(write_scene(folder), "-o", folder / "out", *options, folder=folder)
    assert ended.code == EXIT_PASSED, ended.stderr
    return folder / "out"


@pytest.mark.parametrize(
    "form", ["pdf", *(pytest.param(form, marks=pytest.mark.slow) for form in ("svg", "png"))]
)
def test_each_format_is_written_the_same_twice(out, tmp_path, form):
    paths = [tmp_path / f"{name}.{form}" for name in ("first", "second")]
    for path in paths:
        ended = run_here("figure", out, "-o", path, "--inset", "0.5,0.5,0.3", folder=tmp_path)
        assert (ended.code, ended.stderr) == (EXIT_PASSED, "")
    first, second = (path.read_bytes() for path in paths)
    assert len(first) > 10_000
    assert first == second
    if form == "pdf":
        assert b"/Type3" not in first
        assert b"/CIDFontType2" in first  # TrueType


def test_views_of_one_viewpoint_have_the_width_asked_for(out, tmp_path):
    path = tmp_path / "views.png"
    options = ("--parts", "views", "--width", "90", "--viewpoints", "left", "-a", ALGORITHMS[1])
    assert run_here("figure", out, "-o", path, *options, folder=tmp_path).code == EXIT_PASSED
    with Image.open(path) as image:
        assert image.width == pytest.approx(90 / 25.4 * 300, abs=1)
        pixels = np.asarray(image.convert("RGB"))
    assert (pixels < 128).any(axis=-1).mean() > 0.2  # three views on black


def test_several_reports_have_views_each_and_one_plot_of_scores(out, tmp_path):
    other = tmp_path / "other"
    shutil.copytree(out, other)
    path, heights = tmp_path / "views.png", []
    for reports in ((out,), (out, other)):
        height = 0
        for parts, sign in (("views,scores", 1), ("scores", -1)):
            options = ("-o", path, "--parts", parts, "--width", "90")
            assert run_here("figure", *reports, *options, folder=tmp_path).code == EXIT_PASSED
            with Image.open(path) as image:
                height += sign * image.height
        heights.append(height)
    assert 2 * heights[0] < heights[1] < 2.6 * heights[0]
    assert_refused(
        "figure", out, other, "--maps", tmp_path / "maps", folder=tmp_path, says=["single report"]
    )


def test_all_text_of_a_narrow_figure_is_inside_and_apart(out, monkeypatch):
    report = Report.load(out)
    reports = [Report(out, replace(report.data, title=title)) for title in ("Jade disc", "Ibex")]
    figure, boxes, draw = draw_figure(reports, FigureRequest(width_mm=85)), {}, Text.draw

    def record(text, renderer):
        draw(text, renderer)
        if text.get_text() and text.get_visible():
            boxes[f"{len(boxes)} {text.get_text()}"] = text.get_window_extent(renderer)

    monkeypatch.setattr(Text, "draw", record)
    FigureCanvasAgg(figure).draw()
    for words, box in boxes.items():
        assert all(figure.bbox.contains(*corner) for corner in (box.min, box.max)), words
    assert not [pair for pair in combinations(boxes, 2) if boxes[pair[0]].overlaps(boxes[pair[1]])]
    words = {text.partition(" ")[2] for text in boxes}
    assert {"template:colour=smooth", "gu2020"} <= words


def test_plots_name_their_views_and_have_one_colour_per_algorithm(out):
    report = Report.load(out)
    reports = [Report(out, replace(report.data, title=title)) for title in ("Jade disc", "Ibex")]

    def axes_of(*reports):
        return draw_figure(reports, FigureRequest(("scores", "time"))).axes

    scores, time, _ = axes_of(*reports)
    assert scores.get_ylabel().endswith("centre view")
    assert scores.get_xlabel() == "relic, with 95 % intervals"
    assert time.get_ylabel().endswith("mean of 2 views")
    marks = {(line.get_color(), line.get_marker()) for line in time.lines[:2]}
    assert marks == {(colour_of(name), marker_of(name)) for name in ALGORITHMS}
    for algorithm in report.data.algorithms.values():
        algorithm.precision.clear()
    assert axes_of(report)[0].get_xlabel() == "viewpoint"


def test_error_maps_are_those_of_the_views(out, tmp_path):
    options = ("-o", tmp_path / "figure.pdf", "--maps", tmp_path / "maps")
    assert run_here("figure", out, *options, folder=tmp_path).code == EXIT_PASSED
    names = {path.relative_to(tmp_path / "maps").as_posix() for path in tmp_path.rglob("*.exr")}
    methods = ("reference", *ALGORITHMS)
    assert names == {f"{name}/{view}.exr" for name in methods for view in ("centre", "left")}
    reference, view = (
        read_exr(out / "views" / name / "left.exr") for name in ("reference", ALGORITHMS[1])
    )
    error = read_exr(tmp_path / "maps" / ALGORITHMS[1] / "left.exr")[..., 0]
    np.testing.assert_allclose(error, 1 - ssim_map(reference, view), atol=1e-6)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("-o", "a.bmp"), "ends in .pdf"),
        (("--parts", "view"), "did you mean views"),
        (("--viewpoints", "right"), "--viewpoints right"),
        (("-a", "li2012"), "--algorithms li2012"),
        (("--inset", "0,0,2"), "leaves the view"),
        (("--inset", "1,2"), "write X,Y,SIDE"),
        (("--width", "0"), "20 to 2000 mm"),
    ],
)
def test_mistakes_end_in_one_line(out, tmp_path, options, message):
    assert_refused("figure", out, *options, folder=tmp_path, says=[message])
