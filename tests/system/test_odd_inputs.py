"""Odd numbers, colours and file names: one line that names the file, and exit code 2.

Commands and what they render run in the test's own process.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from inim.cli.main import main
from inim.generators import algorithm_names, prepare
from inim.image.files.eia_file import write_eia
from inim.image.files.image import write_exr_parts
from inim.image.rgbd import RGBD
from inim.report.page import text
from inim.report.summary import markdown_text
from inim.system.errors import FileError, OutOfMemoryError, UsageError
from inim.system.files import utf8_name
from inim.system.process.atomic_file import published_together, write_atomically
from inim.system.process.printing import printable
from tests.conftest import scene_text, small_display, sphere
from tests.system.conftest import worker_here

DISPLAY = small_display()
KEYS = ("pitch_mm", "focal_length_mm", "gap_mm", "pixel_pitch_mm", "lens_columns", "lens_rows")


def on(**changes: float) -> list[str]:
    """Words that set the display, with other values of some of its parameters."""
    values = {key: getattr(DISPLAY, key) for key in KEYS} | changes
    return [word for key, value in values.items() for word in ("-D", f"inim.{key}={value!r}")]


TINY = on()
SHAPE, PIXEL_MM = DISPLAY.capture_shape(3), DISPLAY.capture_pixel_mm(3)


def rgbd(depth: float = 20.0, pixel_mm: float = PIXEL_MM) -> RGBD:
    color = np.full((*SHAPE, 3), 0.5, np.float32)
    return RGBD(color, np.full(SHAPE, depth, np.float32), np.ones(SHAPE, bool), pixel_mm)


def write_parts(
    path: Path, color: float = 0.5, depth: float = 20.0, pixel: float = PIXEL_MM
) -> Path:
    """An RGB-D picture of inim with any numbers."""
    plane = np.ones(SHAPE, np.float32)
    parts = [
        ({"R": plane * color, "G": plane * color, "B": plane * color, "A": plane}, "color"),
        ({"Z": plane * depth}, "depth"),
    ]
    write_exr_parts(path, parts, {"inim:pixel_mm": repr(pixel)})
    return path


def write_white(path: Path) -> None:
    write_exr_parts(path, [({"RGB": np.ones((8, 8, 3), np.float32)}, "color")], {})


def refused(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """The only line of a command that ends with exit code 2."""
    code = main([str(word) for word in words])
    out, err = capsys.readouterr()
    assert code == 2, (code, err)
    assert out == "" and err.count("\n") == 1, (out, err)
    return err


# -- numbers ------------------------------------------------------------------------------------


@pytest.mark.parametrize("depth", [1e30, -1e30, 3e38, 1e13])
def test_a_depth_beyond_all_displays_is_refused(depth, tmp_path, capsys):
    path = write_parts(tmp_path / "far.exr", depth=depth)
    line = refused(capsys, "generate", path, *TINY, "-o", tmp_path / "eia.png")
    assert str(path) in line and "mm" in line
    assert not (tmp_path / "eia.png").exists()


@pytest.mark.parametrize(
    ("command", "move"),
    [
        ("generate", '<translate x="1e30"/>'),
        ("validate", '<translate z="-1e15"/>'),
        ("validate", '<scale value="1e-20"/>'),
    ],
)
def test_a_shape_that_the_renderer_cannot_resolve_is_refused(command, move, tmp_path, capsys):
    scene = tmp_path / "far.xml"
    shape = f'<shape type="rectangle"><transform name="to_world">{move}</transform></shape>'
    beside = "" if "scale" in move else sphere((0, 0, 0), 1)
    scene.write_text(scene_text(shape, beside))
    # By default, a shape far away is left out.
    chosen = ["-D", "inim.relic=rectangle,sphere"] if beside else []
    with worker_here():
        words = [command, scene, *TINY, *chosen, "-o", tmp_path / "out.png"]
        assert str(scene) in refused(capsys, *words)


@pytest.mark.parametrize("algorithm", algorithm_names())
@pytest.mark.parametrize("pixel_mm", [1e30, 1e4, 1e-30, 1e-6])
def test_a_picture_without_a_pixel_for_a_lens_is_refused(algorithm, pixel_mm):
    with pytest.raises(UsageError, match="picture"):
        prepare(DISPLAY, algorithm, shape=SHAPE, pixel_mm=pixel_mm)


@pytest.mark.parametrize("pitch_mm", [1e4, 1e9])
def test_a_display_of_huge_lenses_is_blamed_itself(pitch_mm, tmp_path, capsys):
    path = write_parts(tmp_path / "good.exr")
    words = ["generate", str(path), *on(pitch_mm=pitch_mm), "-o", str(tmp_path / "eia.png")]
    assert main(words) == OutOfMemoryError.exit_code
    line = capsys.readouterr().err
    assert line.count("\n") == 1 and "pitch_mm" in line and str(path) not in line


# -- colours and libraries ----------------------------------------------------------------------


def run(*words: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "inim", *map(str, words)]
    return subprocess.run(
        command, capture_output=True, text=True, errors="surrogateescape", check=False
    )


def test_warnings_and_logs_of_libraries_stay_off_the_terminal(tmp_path):
    np.save(tmp_path / "depth.npy", np.full((8, 8), 5.0))
    write_exr_parts(
        tmp_path / "color.exr", [({"RGB": np.ones((8, 8, 3), np.float32)}, "color")], {}
    )
    broken = tmp_path / "broken.ply"
    broken.write_bytes(
        b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
        b"property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
        b"0 0 0\n1 0 nan\n0 1e39 0\n3 0 1 7\n"
    )
    for words in (
        ("generate", tmp_path / "color.exr", "--depth", tmp_path / "depth.npy", "--depth-unit",
         "1e-300", "--orthographic", "-o", tmp_path / "eia.png"),
        ("new-scene", broken, "-o", tmp_path / "new.xml", "--unit", "mm", "--up", "y"),
    ):  # fmt: skip
        ended = run(*words)
        assert ended.returncode == 2, ended.stderr
        assert ended.stderr.startswith("inim: error: ") and ended.stderr.count("\n") == 1


# -- lines that name the file -------------------------------------------------------------------


@pytest.mark.parametrize(
    "intrinsics", [[0.0, 5.0, 3.5, 3.5], [5.0, 5.0, 900.0, 3.5], [5e5, 5.0, 3.5, 3.5]]
)
def test_intrinsics_of_a_document_are_blamed_on_it(intrinsics, tmp_path, capsys):
    write_white(tmp_path / "c.exr")
    np.save(tmp_path / "d.npy", np.full((8, 8), 500.0))
    picture = {"color": "c.exr", "depth": "d.npy", "position_mm": [0, 0, 0],
               "rotation": np.eye(3).tolist()}  # fmt: skip
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps(
        {"schema": "inim.cameras/1", "intrinsics": intrinsics, "pictures": [picture, picture]}
    ))  # fmt: skip
    line = refused(capsys, "generate", path, "--depth-unit", "mm", *TINY, "-o", tmp_path / "e.png")
    assert str(path) in line and "--intrinsics" not in line and "c.exr" in line


# -- names --------------------------------------------------------------------------------------

ODD_NAMES = [
    b"\xff\xfe", b"a\nb", b"\x1b[31mred\x1b[0m", "\u202eexr.txt".encode(), b"x" * 251,
    "\U0001f3fa".encode() * 62, b" ", b"-x", b"\x7f", "\u2028".encode(),
]  # fmt: skip


@pytest.mark.parametrize("name", ODD_NAMES)
def test_any_name_works_or_gives_one_line(name, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)  # where `view` writes
    stem = os.fsdecode(name)
    source = write_parts(tmp_path / "good.exr").rename(tmp_path / f"{stem}.exr")
    for words in (
        ["generate", source, *TINY, "-o", tmp_path / "e.png", "--save-rgbd", tmp_path / "r.exr"],
        ["generate", tmp_path / f"{stem}.exr", *TINY, "-o", tmp_path / f"{stem}.png"],
        ["view", tmp_path / f"{stem}.png", *TINY, "-o", tmp_path / "v.html"],
        ["view", tmp_path / f"{stem}.png", *TINY],
        ["export", tmp_path / f"{stem}.png", *TINY, "--views", tmp_path / stem],
        ["inspect", tmp_path / f"{stem}.xml"],
        ["validate", tmp_path / f"{stem}.xml"],
    ):
        code = main([str(word) for word in words])
        out, err = capsys.readouterr()
        assert code in (0, 2), (words, err)
        assert (err.count("\n") == 1) if code else not err, err
        for line in (out + err).split("\n"):
            assert line == printable(line), line


def test_lines_show_control_characters_escaped():
    assert printable("a\x1b[31m\nb\u202e\u2028") == r"a\x1b[31m\nb\u202e\u2028"
    assert printable(os.fsdecode(b"\xff.xml")) == r"\xff.xml"
    assert printable("Löwe 像 🏺") == "Löwe 像 🏺"
    for document in (text, markdown_text):
        page = document("a\x1b\x9b\u202e\udcff")
        assert not set("\x1b\x9b\u202e\udcff") & set(page)
    with pytest.raises(FileError, match="UTF-8"):
        utf8_name(Path(os.fsdecode(b"\xff")))


# -- several files ------------------------------------------------------------------------------


def test_files_of_a_block_appear_together_or_not_at_all(tmp_path):
    paths = [tmp_path / name for name in ("a.txt", "b.txt")]
    paths[0].write_text("before")

    def write(last: BaseException | None) -> None:
        with published_together():
            for path in paths:
                write_atomically(path, lambda p: p.write_text("after"))
            assert paths[0].read_text() == "before" and not paths[1].exists()
            if last:
                raise last

    for error in (KeyboardInterrupt(), OSError(28, "full")):
        with pytest.raises(type(error)):
            write(error)
        assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]
        assert paths[0].read_text() == "before"
    write(None)
    assert [path.read_text() for path in paths] == ["after"] * 2
    assert len(list(tmp_path.iterdir())) == 2


def commands_of_several_files(folder: Path) -> dict[str, tuple[list[object], str]]:
    """Words of commands that write several files in this process, with the last writer's module."""
    picture = write_parts(folder / "in.exr")
    eia = folder / "eia.png"
    write_eia(eia, np.full((*DISPLAY.eia_shape, 3), 0.5, np.float32), None, 0.1)
    out = folder / "out"
    return {
        "generate": (["generate", picture, *TINY, "-o", out / "e.png", "--pdf", out / "e.pdf",
                      "--save-rgbd", out / "r.exr"], "inim.image.files.image.write_rgbd"),
        "export": (["export", eia, *TINY, "--pdf", out / "e.pdf", "--views", out / "views"],
                   "inim.apps.export.lenslet_forms._write_views"),
        "inspect": (["inspect", "nominal", "-o", out / "i", "--save", out / "d.xml"],
                    "inim.display.Display.save"),
    }  # fmt: skip


@pytest.mark.parametrize("command", ["generate", "export", "inspect"])
def test_a_command_that_is_interrupted_leaves_none_of_its_files(command, tmp_path, monkeypatch):
    words, last = commands_of_several_files(tmp_path)[command]

    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(last, interrupt)
    with pytest.raises(KeyboardInterrupt):
        main([str(word) for word in words])
    assert not [path for path in (tmp_path / "out").rglob("*") if path.is_file()]
