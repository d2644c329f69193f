"""Whatever a user names is a regular file, or refused at once: no pipe waits, no device is read.

Expected: at every door, in place of the file each of a pipe, a device, a socket, a folder, a circle
of links, nothing at all, and files that cannot be read or never end, gives one line with the file's
name and exit code 2 (4 for a baseline), in far less than ten seconds.
"""

import json
import os
import signal
import socket
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from inim.system.document import write_document
from inim.system.errors import EXIT_BASELINE, EXIT_USAGE, FileError
from inim.system.files import open_file
from tests.conftest import scene_text
from tests.schemas import completed, report_document
from tests.system.conftest import assert_one_line, run_here, write_scene

# Of processor time, which does not depend on other programs; and until a call counts as hanging.
MOST_SECONDS, HANGS_SECONDS = 20, 300
HUGE = 2**36
MESH = '<shape type="ply"><string name="filename" value="x.ply"/></shape>'
TEXTURE = (
    '<shape type="rectangle"><bsdf type="diffuse"><texture type="bitmap" name="reflectance">'
    '<string name="filename" value="x.png"/></texture></bsdf></shape>'
)
INCLUDE = '<include filename="x.xml"/>'
STUDY = '[study]\nscenes = ["x.xml"]\nalgorithms = ["template"]\n'
TAKEN = ("--orthographic", "--depth-unit", "mm", "-o", "made.png")

# What is typed, the file that is none, its exit code, and what stands beside it.
Beside = Callable[[Path], object]
Door = tuple[list[str], str, int, Beside]


def no_output(folder: Path) -> None:
    """No other file."""


def scene(shape: str) -> Beside:
    return lambda folder: write_scene(folder, text=scene_text(shape))


def report(folder: Path) -> None:
    """A sound report, for what lies in its folder."""
    (folder / "OUT/regression").mkdir(parents=True)
    document = report_document({"verdict": {"passed": True, "checks": []}})
    write_document(folder / "OUT/report.json", document)


def candidate(folder: Path) -> None:
    report(folder)
    document = completed("baseline", {})
    (folder / "OUT/regression/candidate.json").write_text(json.dumps(document))


def baseline(folder: Path) -> None:
    write_scene(folder)
    (folder / "base").mkdir()


def arrays(folder: Path) -> None:
    baseline(folder)
    (folder / "base/baseline.json").write_text(json.dumps(completed("baseline", {})))


def picture(folder: Path) -> None:
    Image.fromarray(np.zeros((9, 9, 3), np.uint8)).save(folder / "color.png")


def views(folder: Path, numbers: Sequence[int] = (1, 2, 3)) -> None:
    """A light field of four views but for its first, or of some."""
    (folder / "views").mkdir()
    for number in numbers:
        image = Image.fromarray(np.zeros((9, 9, 3), np.uint8))
        image.save(folder / f"views/input_Cam{number:03}.png")


def two_views(folder: Path) -> None:
    """Two views, which make no square: their grid must be read."""
    views(folder, (0, 1))


ACCEPT = ["accept", "OUT", "--reason", "because"]
VALIDATE = ["validate", "tiny.xml", "-o", "made"]
DOORS: dict[str, Door] = {
    "a scene": (["validate", "x.xml", "-o", "made"], "x.xml", EXIT_USAGE, no_output),
    "a scene to inspect": (["inspect", "x.xml"], "x.xml", EXIT_USAGE, no_output),
    "an include": (VALIDATE, "x.xml", EXIT_USAGE, scene(INCLUDE)),
    "a scene's mesh": (VALIDATE, "x.ply", EXIT_USAGE, scene(MESH)),
    "a scene's texture": (VALIDATE, "x.png", EXIT_USAGE, scene(TEXTURE)),
    "a finished EIA": ([*VALIDATE, "--eia", "mine=x.png"], "x.png", EXIT_USAGE, write_scene),
    "a finished EXR": ([*VALIDATE, "--eia", "mine=x.exr"], "x.exr", EXIT_USAGE, write_scene),
    "an RGB-D picture": (["validate", "x.exr"], "x.exr", EXIT_USAGE, no_output),
    "a colour picture": (
        ["generate", "x.png", "--depth", "color.png", *TAKEN],
        "x.png", EXIT_USAGE, picture,
    ),
    "a photograph with depth inside": (["generate", "x.jpg"], "x.jpg", EXIT_USAGE, no_output),
    "a photograph to validate": (["validate", "x.jpg"], "x.jpg", EXIT_USAGE, no_output),
    "a depth picture": (
        ["generate", "color.png", "--depth", "x.png", *TAKEN],
        "x.png", EXIT_USAGE, picture,
    ),
    "a depth array": (
        ["generate", "color.png", "--depth", "x.npy", *TAKEN],
        "x.npy", EXIT_USAGE, picture,
    ),
    "a light field's view": (
        ["generate", "views", "-o", "made.png"],
        "views/input_Cam000.png", EXIT_USAGE, views,
    ),
    "a light field's grid": (
        ["generate", "views", "-o", "made.png"],
        "views/parameters.cfg", EXIT_USAGE, two_views,
    ),
    "a photograph": (
        ["generate", "x.png", "--estimate-depth", "m", "-o", "made.png"],
        "x.png", EXIT_USAGE, no_output,
    ),
    "a study": (["sweep", "x.toml", "-o", "made"], "x.toml", EXIT_USAGE, no_output),
    "a study's scene": (
        ["sweep", "study.toml", "-o", "made"],
        "x.xml", EXIT_USAGE, lambda folder: (folder / "study.toml").write_text(STUDY),
    ),
    "a mesh": (
        ["new-scene", "x.ply", "-o", "made.xml", "--unit", "mm", "--up", "y"],
        "x.ply", EXIT_USAGE, no_output,
    ),
    "an EIA to export": (["export", "x.png", "--pdf", "made.pdf"], "x.png", EXIT_USAGE, no_output),
    "an EIA to view": (["view", "x.exr"], "x.exr", EXIT_USAGE, no_output),
    "a display": (
        ["export", "color.png", "--display", "x.xml", "--pdf", "made.pdf"],
        "x.xml", EXIT_USAGE, picture,
    ),
    "a report to export": (
        ["export", "OUT", "--pdf", "made.pdf"], "OUT/report.json", EXIT_USAGE, no_output,
    ),
    "a report to view": (["view", "OUT"], "OUT/report.json", EXIT_USAGE, no_output),
    "a report to accept": (ACCEPT, "OUT/report.json", EXIT_USAGE, no_output),
    "a report to compare": (["compare", "OUT", "OUT"], "OUT/report.json", EXIT_USAGE, no_output),
    "a candidate": (ACCEPT, "OUT/regression/candidate.json", EXIT_BASELINE, report),
    "a candidate's arrays": (ACCEPT, "OUT/regression/candidate.npz", EXIT_BASELINE, candidate),
    "a baseline": (
        [*VALIDATE, "--baseline", "base"], "base/baseline.json", EXIT_BASELINE, baseline,
    ),
    "a baseline's arrays": (
        [*VALIDATE, "--baseline", "base"], "base/baseline.npz", EXIT_BASELINE, arrays,
    ),
}  # fmt: skip


def listening(path: Path) -> None:
    """A socket's name may have a hundred bytes only."""
    with socket.socket(socket.AF_UNIX) as listener:
        here = Path.cwd()
        os.chdir(path.parent)
        listener.bind(path.name)
        os.chdir(here)


def sparse(path: Path) -> None:
    """Large, and of nothing."""
    with path.open("wb") as file:
        file.truncate(HUGE)


KINDS: dict[str, Callable[[Path], object]] = {
    "nothing": lambda path: None,
    "a pipe": os.mkfifo,
    "a device": lambda path: path.symlink_to("/dev/zero"),
    "a terminal's end": lambda path: path.symlink_to("/dev/stdin"),
    "a socket": listening,
    "a folder": Path.mkdir,
    "a circle": lambda path: path.symlink_to(path.name),
    "unreadable": lambda path: path.symlink_to("/proc/self/mem"),
    "huge": sparse,
}


@pytest.fixture(autouse=True)
def at_once():
    """No call reads or waits for long on any input."""

    def late(number: int, _: object) -> None:
        raise AssertionError("waits forever" if number == signal.SIGALRM else "reads for long")

    timers = {signal.SIGALRM: signal.ITIMER_REAL, signal.SIGPROF: signal.ITIMER_PROF}
    before = {number: signal.signal(number, late) for number in timers}
    signal.setitimer(signal.ITIMER_REAL, HANGS_SECONDS)
    signal.setitimer(signal.ITIMER_PROF, MOST_SECONDS)
    yield
    for number, timer in timers.items():
        signal.setitimer(timer, 0)
        signal.signal(number, before[number])


#: Kinds for all doors; the others, which `open_file` tells apart, are for one door of each reader.
EVERYWHERE = ("nothing", "a pipe", "a folder", "huge")
READERS = (
    *("a scene", "a scene's mesh", "a finished EIA", "a finished EXR", "a depth array"),
    *("a photograph with depth inside", "a study", "a report to view", "a baseline's arrays"),
)
# A photograph is opened by name before the model is, and read by it.
CASES = [
    (door, kind)
    for door in DOORS
    for kind in KINDS
    if (door in READERS or kind in EVERYWHERE) and (door, kind) != ("a photograph", "huge")
]


@pytest.mark.parametrize(("door", "kind"), CASES)
def test_paths_that_are_no_file_are_refused_in_one_line(door, kind, tmp_path):
    words, name, code, beside = DOORS[door]
    beside(tmp_path)
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    KINDS[kind](path)
    ended = run_here(*words, folder=tmp_path)
    assert_one_line(ended.stderr, [path.name])
    assert ended.code == code, ended.stderr
    assert not (tmp_path / "made").exists()


# --- What a file may hold -----------------------------------------------------------------------


def test_a_file_that_is_put_in_place_of_another_is_looked_at_once_it_is_open(tmp_path, monkeypatch):
    """Whatever the name meant before, the pipe itself is found out."""
    path = tmp_path / "x"
    path.write_bytes(b"a file")
    opened = os.open

    def replaced(name: Path, flags: int) -> int:
        path.unlink()
        os.mkfifo(path)
        return opened(name, flags)

    monkeypatch.setattr(os, "open", replaced)
    with pytest.raises(FileError, match="not a regular file"), open_file(path):
        pass


@pytest.mark.parametrize("flipped", [8, 120, 300])
@pytest.mark.parametrize("kind", ["color", "depth"])
def test_a_damaged_tiff_is_one_line(kind, flipped, tmp_path, capfd):
    """Expected: libtiff's own words on descriptor 2, up to hundreds of lines, are not heard."""
    from inim.apps.own_picture.picture_files import read_color, read_depth

    path = tmp_path / "x.tif"
    codes = np.random.default_rng(1).integers(0, 255, (64, 64, 3)).astype(np.uint8)
    Image.fromarray(codes).save(path, compression="tiff_lzw")
    data = bytearray(path.read_bytes())
    data[flipped : len(data) : 97] = b"\xff" * len(data[flipped : len(data) : 97])
    path.write_bytes(data)
    with pytest.raises(FileError, match=r"x\.tif"):
        (read_color if kind == "color" else read_depth)(path)
    assert capfd.readouterr() == ("", "")
    os.write(2, b"heard again")
    assert capfd.readouterr().err == "heard again"
