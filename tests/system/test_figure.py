"""Figures and error maps of a report, from the command line."""

import shutil

import numpy as np
import pytest
from PIL import Image

from inim.image.files.image import read_exr
from inim.scores.metrics import ssim_map
from inim.system.errors import EXIT_PASSED
from tests.system.conftest import assert_refused, run_here, write_scene


@pytest.fixture(scope="module")
def out(tmp_path_factory, run_inim):
    """Report of two algorithms and two viewpoints."""
    folder = tmp_path_factory.mktemp("figure")
    options = ("--algorithms", "template:samples=1,gu2020", "--viewpoints", "centre,left")
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


def test_views_of_one_viewpoint_have_the_width_asked_for(out, tmp_path):
    path = tmp_path / "views.png"
    options = ("--parts", "views", "--width", "90", "--viewpoints", "left", "-a", "gu2020")
    assert run_here("figure", out, "-o", path, *options, folder=tmp_path).code == EXIT_PASSED
    with Image.open(path) as image:
        assert image.width == pytest.approx(90 / 25.4 * 300, abs=1)
        pixels = np.asarray(image.convert("RGB"))
    assert (pixels < 128).any(axis=-1).mean() > 0.2  # three views on black


def test_several_reports_have_views_each_and_one_plot_of_scores(out, tmp_path):
    other = tmp_path / "other"
    shutil.copytree(out, other)
    heights = {}
    for reports in ((out,), (out, other)):
        path = tmp_path / f"{len(reports)}.png"
        options = ("-o", path, "--parts", "views,scores", "--width", "90")
        assert run_here("figure", *reports, *options, folder=tmp_path).code == EXIT_PASSED
        with Image.open(path) as image:
            heights[len(reports)] = image.height
    plot = 0.42 * 90 / 25.4 * 300
    assert 2 * (heights[1] - plot) < heights[2] - plot < 2.6 * (heights[1] - plot)
    assert_refused(
        "figure", out, other, "--maps", tmp_path / "maps", folder=tmp_path, says=["single report"]
    )


def test_error_maps_are_those_of_the_views(out, tmp_path):
    options = ("-o", tmp_path / "figure.pdf", "--maps", tmp_path / "maps")
    assert run_here("figure", out, *options, folder=tmp_path).code == EXIT_PASSED
    names = {path.relative_to(tmp_path / "maps").as_posix() for path in tmp_path.rglob("*.exr")}
    methods = ("reference", "template:samples=1", "gu2020")
    assert names == {f"{name}/{view}.exr" for name in methods for view in ("centre", "left")}
    reference, view = (
        read_exr(out / "views" / name / "left.exr") for name in ("reference", "gu2020")
    )
    error = read_exr(tmp_path / "maps" / "gu2020" / "left.exr")[..., 0]
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
