"""`inim film`: each frame is what the eye sees from its place on the path."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageSequence

from inim.display.viewpoint import eye_path
from inim.files.image import write_exr
from inim.image.color import linear_from_srgb
from inim.metrics import ssim
from inim.report import Report
from tests.schemas import report_document
from tests.system.conftest import Ended, assert_refused, nothing_left, run_here
from tests.system.test_view import DISPLAY, report_data, tilted_plane

PATH = "-12 0 180, 12 0 180"
LABEL = 28  # rows of the names above the panes


@pytest.fixture
def folder(tmp_path):
    """A report with two algorithms' panels, each of its own picture."""
    folder = tmp_path / "OUT"
    for seed, place in enumerate(("truth/eia", "eia/template", "eia/wang2024")):
        write_exr(folder / f"{place}.exr", panel(seed))
    Report(folder, report_document(report_data() | {"lens_model": "pinhole"})).write()
    return folder


def panel(seed: int) -> np.ndarray:
    return linear_from_srgb(tilted_plane(DISPLAY, seed).astype(np.float32) / 255)


def film(*words: str | Path, folder: Path) -> Ended:
    return run_here("film", *words, folder=folder.parent)


def read_film(path: Path) -> list[np.ndarray]:
    with Image.open(path) as film:
        return [np.asarray(f.convert("RGB")) for f in ImageSequence.Iterator(film)]


def test_frames_are_views_along_the_path_side_by_side(folder, renderer):
    from inim.render.reconstruct import reconstruct

    ended = film("OUT", "-o", "made/film.webp", "--path", PATH, "--frames", "6", "--rate", "10",
                 folder=folder)  # fmt: skip
    assert (ended.code, ended.stdout) == (0, "made/film.webp\n"), ended.stderr
    frames = read_film(folder.parent / "made/film.webp")
    assert len(frames) == 6
    times = 5  # 80 rows of view
    assert frames[0].shape == (LABEL + 80 * times, 2 * 96 * times + 8, 3)
    eyes = eye_path(PATH, DISPLAY, 6)
    for frame, eye in list(zip(frames, eyes, strict=True))[::2]:
        views = frame[LABEL:]
        parts = views[:, : 96 * times], views[:, 96 * times + 8 :]
        for seed, part in enumerate(parts):
            light = linear_from_srgb(part[times // 2 :: times, times // 2 :: times] / 255)
            expected = reconstruct(panel(seed), DISPLAY, eye, "pinhole")
            elsewhere = reconstruct(panel(seed), DISPLAY, eyes[eyes.index(eye) - 3], "pinhole")
            # What WebP loses; another place of the path or the other panel loses much more.
            assert ssim(expected, light) > 0.95
            assert ssim(elsewhere, light) < 0.9
            assert ssim(reconstruct(panel(1 - seed), DISPLAY, eye, "pinhole"), light) < 0.9
        # Each under its name: another one's pixels.
        names = frame[:LABEL, : 96 * times], frame[:LABEL, 96 * times + 8 :]
        assert all((name.max(axis=-1) > 128).sum() > 50 for name in names)
        assert abs(names[0].astype(int) - names[1]).max() > 128
    assert nothing_left(folder.parent)


def test_one_panel_by_name(folder):
    ended = film("OUT", "-o", "film.gif", "--algorithms", "wang2024", "--frames", "2",
                 "--view-spp", "4", "--quiet", folder=folder)  # fmt: skip
    assert (ended.code, ended.stdout) == (0, ""), ended.stderr
    frames = read_film(folder.parent / "film.gif")
    assert [f.shape for f in frames] == [(LABEL + 400, 480, 3)] * 2
    assert abs(frames[0].astype(int) - frames[1]).mean() > 1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["-o", "film.avi"], ["film.avi", ".gif"]),
        (["-o", "OUT"], ["OUT"]),
        (["--algorithms", "magic"], ["magic", "template", "wang2024"]),
        (["--path", "0 0 180, 80 0 180"], ["outside the viewing zone"]),
        (["--frames", "0"], ["--frames 0"]),
        (["--rate", "nan"], ["--rate nan"]),
        (["--lens-model", "magic"], ["magic", "pinhole"]),
    ],
)
def test_mistakes_are_one_line_before_anything_is_rendered(folder, words, message):
    assert_refused("film", "OUT", *words, folder=folder.parent, says=message)


@pytest.mark.parametrize("name", ["truth/eia.exr", "report.json"])
def test_report_that_lacks_a_file_is_one_line(folder, name):
    (folder / name).unlink()
    assert_refused("film", "OUT", "--frames", "2", folder=folder.parent, says=[Path(name).name])
