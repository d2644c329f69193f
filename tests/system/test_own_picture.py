"""`inim validate` on a fitted picture: what it determines itself is scored, the rest is named.

Expected: exact algorithms show no wrong source, others do; views show the parallax of the picture's
own depth; what would need a scene is refused or listed with its reason.
"""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from inim.cli.main import main
from inim.display import Viewpoint
from inim.generators import warp_to_viewpoint
from inim.image.files.image import read_rgbd, write_rgbd
from inim.image.rgbd import RGBD
from inim.report import Report
from inim.system.errors import EXIT_PASSED
from tests.schemas import read_document
from tests.system.conftest import (
    assert_refused,
    files_in,
    nothing_left,
    without_page,
    worker_here,
)
from tests.system.test_generate import (
    CAMERA,
    DISPLAY,
    EYES,
    FEWER_LENSES,
    SQUARES,
    camera,
    expected_place,
    place_seen,
    the_display,
)

ALGORITHMS = "template,wang2024:matching=ray"
QUICK = [*DISPLAY, "-D", "inim.reconstruction_spp=4", "--algorithms", ALGORITHMS, "--quiet"]
EYE_WORDS = ["--viewpoints", "l=-14 0 400, r=14 0 400"]


def photo(folder: Path) -> list[str]:
    files = [str(folder / "color.png"), "--depth", str(folder / "depth.png")]
    return [*files, "--depth-unit", "mm", *CAMERA]


@pytest.fixture(scope="module", autouse=True)
def _in_this_process():
    with worker_here():
        yield


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("picture")
    camera.__wrapped__(folder)
    fitted = str(folder / "fitted.exr")
    assert (
        main(
            [
                "generate",
                *photo(folder),
                *DISPLAY,
                "--save-rgbd",
                fitted,
                "-o",
                str(folder / "e.png"),
            ]
        )
        == EXIT_PASSED
    )
    assert main(["validate", fitted, *QUICK, *EYE_WORDS, "-o", str(folder / "out")]) == EXIT_PASSED
    return folder, read_document(folder / "out" / "report.json")


def test_exact_first_hits_are_never_wrong_and_others_sometimes(finished):
    algorithms = finished[1]["algorithms"]
    assert list(algorithms) == ALGORITHMS.split(",")
    assert algorithms["template"]["wrong_source"] == 0
    assert 0 < algorithms["wang2024:matching=ray"]["wrong_source"] < 1


def test_views_are_scored_against_the_picture_and_the_exact_eia(finished):
    own = {name: own["ssim"] for name, own in finished[1]["reference"]["views"].items()}
    assert own.keys() == {"l", "r"}
    worse = finished[1]["algorithms"]["wang2024:matching=ray"]["views"]
    assert all(worse[name]["ssim"] < own[name] for name in own)
    exact = finished[1]["algorithms"]["template"]["views"]
    for name in own:
        assert worse[name]["ssim_to_reference"] < exact[name]["ssim_to_reference"] <= 1


def test_scores_of_a_picture_without_noise_have_intervals_without_width(finished):
    worse = finished[1]["algorithms"]["wang2024:matching=ray"]
    for view, scores in worse["views"].items():
        low, high = worse["precision"][view]["ssim_on_relic_to_reference"]["interval"]
        assert low == scores["ssim_on_relic_to_reference"] == high


def test_steps_that_need_a_scene_are_recorded_with_the_reason(finished):
    folder, data = finished
    assert "noise_floor" not in data and "scene" not in data
    step = next(step for step in data["skipped"] if step["step"] == "ground truth")
    assert step["performed"] == "nothing" and "no scene" in step["why"]
    assert step["why"] in (folder / "out" / "report.html").read_text("utf-8")
    for result in data["algorithms"].values():
        assert result["eia"].keys() > {"ssim"} and result["eia"]["ssim"] is None


def test_every_file_listed_is_there_and_nothing_else(finished):
    out = finished[0] / "out"
    files = files_in(out)
    assert files == set(finished[1]["files"])
    expected = {"eia/template.exr", "truth/l.png", "truth/eia.png", "views/reference/r.png"}
    assert expected | {"rgbd.exr"} <= files
    assert nothing_left(finished[0])


def test_the_saved_picture_gives_the_same_scores(finished):
    folder, data = finished
    words = [str(folder / "out" / "rgbd.exr"), *QUICK, *EYE_WORDS]
    with without_page():
        assert main(["validate", *words, "-o", str(folder / "again")]) == EXIT_PASSED
    again = read_document(folder / "again" / "report.json")
    for row in (*data["algorithms"].values(), *again["algorithms"].values()):
        row.pop("seconds", None)
    assert again["algorithms"] == data["algorithms"]
    assert again["reference"] == data["reference"]


def test_other_commands_read_the_report_as_that_of_a_scene(finished, tmp_path):
    """Comparison, table and EIA exist, and an unchanged picture has no significant change."""
    folder = finished[0]
    report = Report.load(folder / "out")
    assert {row["algorithm"] for row in report.table().rows} == {
        *ALGORITHMS.split(","),
        "reference",
    }
    assert report.eia_path("template", "-a").is_file()
    words = ["compare", str(folder / "out"), str(folder / "out"), "-o", str(tmp_path / "same")]
    assert main(words) == EXIT_PASSED


def test_the_warped_picture_shows_each_square_at_its_place_for_the_eye(finished):
    """Against the line from the eye to the square's middle, in closed form."""
    display = the_display()
    rgbd = read_rgbd(finished[0] / "out" / "rgbd.exr")
    for eye in EYES.values():
        view, is_covered = warp_to_viewpoint(rgbd, display, Viewpoint("eye", *eye), 8)
        assert np.array_equal(is_covered > 0, view.any(axis=-1))
        for channel, square in enumerate(SQUARES):
            place = place_seen(view, channel, display)
            # The median distance of the picture's pixels, where it fits the array.
            expected = expected_place(square, eye, 2000.0, display)
            # Half a pixel of the picture at either side, and the column's side that is seen.
            assert place == pytest.approx(expected, abs=0.6)


def test_a_hexagonal_array_is_not_set_against_the_oracle(finished, tmp_path):
    fitted = tmp_path / "fitted.exr"
    display = [*FEWER_LENSES, "-D", "inim.lattice=hexagonal"]
    words = [
        *photo(finished[0]),
        *display,
        "--save-rgbd",
        str(fitted),
        "-o",
        str(tmp_path / "e.png"),
    ]
    assert main(["generate", *words]) == EXIT_PASSED
    words = [*display, "-D", "inim.reconstruction_spp=4", "--algorithms", "template", "--quiet"]
    words += ["--viewpoints", "centre", "-o", str(tmp_path / "out")]
    assert main(["validate", str(fitted), *words]) == EXIT_PASSED
    data = read_document(tmp_path / "out" / "report.json")
    assert "wrong_source" not in data["algorithms"]["template"]
    step = next(step for step in data["skipped"] if step["step"] == "wrong sources")
    assert "rows and columns" in step["why"]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ((), ["required: INPUT"]),
        (("x.exr",), ["x.exr"]),
        (("c.png",), ["c.png", "inim generate c.png", "inim validate fitted.exr"]),
        (
            ("c.png", "--depth", "d.png", "--depth-unit", "mm"),
            ["inim generate c.png --depth d.png --depth-unit mm --save-rgbd fitted.exr, then"],
        ),
        (("c.exr", "--depth", "d.exr"), ["inim generate c.exr --depth d.exr --save-rgbd"]),
        (
            ("c.png", "--display", "phone", "-D", "inim.gap_mm=3.2"),
            ["inim generate c.png -D inim.gap_mm=3.2 --display phone --save-rgbd", "fitted.exr -D"],
        ),
        (("x.xml", "--orthographic"), ["unrecognized arguments: --orthographic"]),
    ],
)
def test_mistakes_are_one_line_and_leave_nothing(words, says, tmp_path):
    assert_refused("validate", *words, folder=tmp_path, says=says)


@pytest.mark.parametrize(
    "words",
    [
        ("--algorithms", "pickup"),
        ("--algorithms", "template,optimal"),
        ("--cameras", "5"),
        ("--allow-folder", "here"),
        ("--plugin", "math"),
    ],
)
def test_choices_that_need_a_scene_are_refused(finished, words, tmp_path):
    fitted = str(finished[0] / "fitted.exr")
    assert_refused("validate", fitted, *DISPLAY, *words, folder=tmp_path, says=["needs a scene"])


def test_other_commands_refuse_a_picture_in_place_of_a_scene(finished, tmp_path):
    fitted = str(finished[0] / "fitted.exr")
    for command in ("bench", "stress"):
        assert_refused(command, fitted, *DISPLAY, folder=tmp_path, says=["fitted.exr"])


def test_the_page_has_the_sections_of_a_scene_that_apply(finished):
    page = (finished[0] / "out" / "report.html").read_text("utf-8")
    sections = re.findall(r'<section id="([\w-]+)"', page)
    assert sections[:3] == ["overview", "virtual-display", "scores"]
    assert "splats" not in sections and "views" in sections
    panels = json.loads(re.search(r'id="virtual-display-data">(.*?)</script>', page)[1])["panels"]
    assert [panel["name"] for panel in panels] == ["Reference", *ALGORITHMS.split(",")]
    scores = page[page.index('id="scores"') : page.index('id="parallax"')]
    assert ">–<" not in scores and "Wrong source" in scores and "Noise floor" not in scores
    assert "round truth" not in page[
        page.index('id="overview"') : page.index('id="checks"')
    ].replace("There is no ground truth", "")


def warnings_of(rgbd, folder, *display):
    """Warnings of a report on a picture."""
    write_rgbd(folder / "x.exr", rgbd)
    words = ["validate", str(folder / "x.exr"), *display, *QUICK, "--viewpoints", "centre"]
    words += ["--algorithms", "template"]
    with without_page():
        assert main([*words, "-o", str(folder / "out")]) == EXIT_PASSED
    return read_document(folder / "out" / "report.json")["warnings"]


def test_a_mostly_empty_picture_names_the_options(finished, tmp_path):
    rgbd = read_rgbd(finished[0] / "fitted.exr")
    (warning,) = warnings_of(rgbd, tmp_path)
    assert "of the lens array is empty" in warning and "--fit cover" in warning


def test_a_picture_of_the_size_for_another_display_is_warned_of(finished, tmp_path):
    """A picture of half the width; a picture of the display on its side fits."""
    rgbd = read_rgbd(finished[0] / "fitted.exr")
    half = np.s_[:, : rgbd.shape[1] // 2]
    full = np.ones(rgbd.shape, bool)[half]
    depth = np.full(rgbd.shape, 30, np.float32)[half]
    (warning,) = warnings_of(RGBD(rgbd.color[half], depth, full, rgbd.pixel_mm), tmp_path)
    assert "give the picture's display" in warning
    color = np.ascontiguousarray(rgbd.color.swapaxes(0, 1))
    depth = np.full(rgbd.shape[::-1], 30, np.float32)
    upright = RGBD(color, depth, np.ones(depth.shape, bool), rgbd.pixel_mm)
    assert warnings_of(upright, tmp_path) == []


def test_a_picture_fitted_to_another_display_is_refused(finished, tmp_path, capsys):
    fitted = finished[0] / "fitted.exr"
    words = [str(fitted), "-D", "inim.gap_mm=2.7", "-o", str(tmp_path / "out")]
    says = ["fitted.exr", "depth range", "inim generate --save-rgbd"]
    assert_refused("validate", *words, folder=tmp_path, says=says)
