"""`inim validate` on a picture of one's own: what it says itself is scored, the rest is named.

Expected: exact algorithms show no wrong source, others do; views show the parallax of the picture's
own depth; what would need a scene is refused or listed with its reason.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from inim.cli.main import main
from inim.display import Viewpoint
from inim.generators import warp_to_viewpoint
from inim.image.files.image import read_rgbd
from inim.system.errors import EXIT_PASSED
from tests.schemas import read_document
from tests.system.conftest import assert_refused, files_in, nothing_left, worker_here
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
    words = ["validate", *photo(folder), *QUICK, *EYE_WORDS, "-o", str(folder / "out")]
    assert main(words) == EXIT_PASSED
    return folder, read_document(folder / "out" / "report.json")


def test_exact_first_hits_are_never_wrong_and_others_sometimes(finished):
    algorithms = finished[1]["algorithms"]
    assert list(algorithms) == ALGORITHMS.split(",")
    assert finished[1]["oracle_pixels"] == 2000
    assert algorithms["template"]["wrong_source"] == 0
    assert 0 < algorithms["wang2024:matching=ray"]["wrong_source"] < 1


def test_views_are_scored_against_the_picture_and_the_exact_eia(finished):
    metrics = {"ssim", "psnr_db", "flip", "ssim_on_relic", "psnr_on_relic_db", "flip_on_relic"}
    for row in finished[1]["algorithms"].values():
        for view in row["views"].values():
            assert view["to_picture"].keys() == view["to_exact"].keys() == metrics
    own = {name: own["ssim"] for name, own in finished[1]["exact"].items()}
    assert own.keys() == {"l", "r"}
    worse = finished[1]["algorithms"]["wang2024:matching=ray"]["views"]
    assert all(worse[name]["to_picture"]["ssim"] < own[name] for name in own)


def test_every_file_listed_is_there_and_nothing_else(finished):
    out = finished[0] / "out"
    files = files_in(out)
    assert files == set(finished[1]["files"])
    assert {"eia/template.png", "views/picture/l.png", "views/exact/r.png", "rgbd.exr"} <= files
    assert nothing_left(finished[0])


def test_a_fitted_picture_gives_the_same_scores(finished):
    folder, data = finished
    words = [str(folder / "out" / "rgbd.exr"), *QUICK, *EYE_WORDS]
    assert main(["validate", *words, "-o", str(folder / "again")]) == EXIT_PASSED
    again = read_document(folder / "again" / "report.json")
    for row in (*data["algorithms"].values(), *again["algorithms"].values()):
        row.pop("seconds", None)
    assert again["algorithms"] == data["algorithms"]
    assert again["exact"] == data["exact"]


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
    words = [*photo(finished[0]), *FEWER_LENSES, "-D", "inim.lattice=hexagonal", "--quiet"]
    words += ["-D", "inim.reconstruction_spp=4", "--algorithms", "template"]
    words += ["--viewpoints", "centre", "-o", str(tmp_path / "out")]
    assert main(["validate", *words]) == EXIT_PASSED
    data = read_document(tmp_path / "out" / "report.json")
    assert data["algorithms"]["template"]["wrong_source"] is None
    assert any("rows and columns" in line for line in data["not_scored"])


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ((), ["required: INPUT"]),
        (("x.exr",), ["x.exr"]),
        (("x.exr", "--eia", "a=b.png"), ["--eia", "ground truth"]),
        (("x.exr", "--baseline", "here"), ["--baseline", "ground truth"]),
        (("c.png", "--orthographic"), ["c.png"]),
        (("x.exr", "--algorithms", "pickup"), ["pickup"]),
        (("x.exr", "--preview"), ["--preview", "scene"]),
    ],
)
def test_mistakes_are_one_line_and_leave_nothing(words, says, tmp_path):
    assert_refused("validate", *words, folder=tmp_path, says=says)


def test_a_picture_fitted_to_another_display_is_refused(finished, tmp_path, capsys):
    fitted = finished[0] / "out" / "rgbd.exr"
    words = [str(fitted), "-D", "inim.gap_mm=2.7", "-o", str(tmp_path / "out")]
    says = ["rgbd.exr", "depth range", "inim generate --save-rgbd"]
    assert_refused("validate", *words, folder=tmp_path, says=says)
