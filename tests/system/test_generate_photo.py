"""`inim generate PHOTO`, of a folder, and validation: as the user types them."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from inim.cli.main import main
from inim.image.files.eia_file import read_eia
from inim.image.files.image import read_rgbd
from inim.system.errors import EXIT_CHECK_FAILED, EXIT_PASSED, EXIT_USAGE
from tests.conftest import small_display
from tests.depth_photographs import apple_xml, gdepth, heic, picture
from tests.system.conftest import assert_refused, worker_here

SIZES = {"lens_columns": 24, "lens_rows": 12, "pixel_pitch_mm": 0.125}
DISPLAY = [word for k, v in SIZES.items() for word in ("-D", f"inim.{k}={v}")]


def subject(rows=96, columns=128):
    """A red square before a green wall; its codes are those of RangeInverse, near 0, far 255."""
    color = np.zeros((rows, columns, 3), np.uint8)
    color[..., 1] = 160
    codes = np.full((rows, columns), 230, np.uint8)
    color[40:70, 50:90], codes[40:70, 50:90] = (220, 0, 0), 20
    return color, codes


COLOR, CODES = subject()
METRIC = gdepth(picture(COLOR), picture(CODES, "PNG"), Units="m", Near=0.5, Far=4)


def generate(*words: object) -> int:
    return main(["generate", *map(str, words), *DISPLAY])


def line(text: str, name: str) -> str:
    return next(row for row in text.splitlines() if row.startswith(name))


def test_a_photograph_needs_nothing_but_its_name(tmp_path, capsys):
    photo, out, fitted = (tmp_path / name for name in ("photo.jpg", "eia.png", "fitted.exr"))
    photo.write_bytes(METRIC)
    assert generate(photo, "-o", out, "--save-rgbd", fitted) == EXIT_PASSED
    output = capsys.readouterr()
    assert output.err == ""
    assert "units m: metric" in line(output.out, "photo")
    assert "nearer than" in line(output.out, "subject")
    assert " mm," in line(output.out, "depth")
    display = small_display(columns=24, rows=12, pixels=8)
    eia, _ = read_eia(out, display)
    assert eia[..., 0].max() > 0.5
    rgbd = read_rgbd(fitted)
    low, high = display.depth_range_mm
    red = rgbd.covered & (rgbd.color[..., 0] > 0.5)
    green = rgbd.covered & (rgbd.color[..., 1] > 0.3)
    # The subject at the front; the wall, beyond the range, a backdrop at its end.
    np.testing.assert_allclose(rgbd.depth_mm[red], high, atol=0.01)
    np.testing.assert_allclose(rgbd.depth_mm[green], low, atol=0.01)


def folder_of(tmp_path: Path) -> Path:
    pytest.importorskip("pillow_heif")
    folder = tmp_path / "phone"
    folder.mkdir()
    (folder / "a.jpg").write_bytes(METRIC)
    (folder / "b.JPG").write_bytes(METRIC[:-300])
    (folder / "c.heic").write_bytes(heic(COLOR, 255 - CODES, apple_xml()))
    (folder / "c.jpeg").write_bytes(METRIC)
    (folder / "notes.txt").write_text("not a photograph")
    return folder


def test_a_broken_file_of_a_folder_is_named_and_the_others_are_generated(tmp_path, capsys):
    folder, out = folder_of(tmp_path), tmp_path / "eias"
    assert generate(folder, "-o", out) == EXIT_CHECK_FAILED
    output = capsys.readouterr()
    assert sorted(p.name for p in out.iterdir()) == ["a.png", "c.heic.png", "c.jpeg.png"]
    assert output.out.count("\nsubject ") == 3
    assert output.out.splitlines()[-1] == f"3 of 4 photographs converted; EIAs: {out}"
    assert re.fullmatch(rf"inim: failed: {folder / 'b.JPG'}: .*truncated.*\n", output.err)
    # As alone.
    assert generate(folder / "a.jpg", "-o", tmp_path / "a.png") == EXIT_PASSED
    assert (tmp_path / "a.png").read_bytes() == (out / "a.png").read_bytes()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["phone", "-o", "eia.png"], "-o eia.png: phone is a folder; name a folder"),
        (
            ["phone", "-o", "o", "--pdf", "a.pdf"],
            "--pdf: does not apply to a folder of photographs",
        ),
        (["phone", "-o", "o", "--display", "wall"], "wall"),
        (["empty", "-o", "o"], "empty: no photograph in it; give a folder with some"),
        (["phone/a.jpg", "--depth-unit", "m"], "--depth-unit: does not apply to a photograph"),
        (["phone/a.jpg", "--intrinsics", "photo"], "contains no camera"),
        (
            ["phone/a.jpg", "--frame-at", "300"],
            "--frame-at: has no effect on an orthographic picture",
        ),
        (["phone/a.jpg", "--all-views"], "--all-views: does not apply to a photograph"),
        (["phone/a.jpg", "-o", "phone/a.jpg"], "-o phone/a.jpg"),
        (["a.png", "--depth", "b.png", "--intrinsics", "photo"], "--intrinsics photo"),
    ],
)
def test_a_mistake_is_one_line_and_nothing_is_written(tmp_path, words, says):
    folder_of(tmp_path)
    (tmp_path / "empty").mkdir()
    assert_refused("generate", *words, *DISPLAY, folder=tmp_path, says=[says])


def test_a_fitted_photograph_is_validated(tmp_path, capsys, renderer):
    photo, fitted, out = tmp_path / "photo.jpg", tmp_path / "fitted.exr", tmp_path / "report"
    photo.write_bytes(METRIC)
    words = [str(photo), "--save-rgbd", str(fitted), "-o", str(tmp_path / "eia.png"), *DISPLAY]
    assert main(["generate", *words]) == EXIT_PASSED
    output = capsys.readouterr()
    assert "units m: metric" in line(output.out, "photo")
    assert "nearer than" in line(output.out, "subject")
    words = [str(fitted), "-o", str(out), "--algorithms", "template:samples=4", *DISPLAY]
    words += ["-D", "inim.reconstruction_spp=4", "--viewpoints", "centre"]
    with worker_here():
        assert main(["validate", *words]) == EXIT_PASSED
    assert json.loads((out / "report.json").read_text())["warnings"] == []
    assert main(["validate", str(photo), "-o", str(out)]) == EXIT_USAGE
    assert f"inim generate {photo} --save-rgbd" in capsys.readouterr().err
