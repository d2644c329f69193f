"""Damaged files from others' bug reports, each by the command lines a user would type.

INIM_DAMAGED_SAMPLES names a folder that holds `exr`, `mesh` and `xml`; without it, or without what
it needs, nothing is tried. Expected: success, or one clear line and exit code 2, within 10 s of
work and 1 GiB above a sound run, and nothing left behind.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

from inim.errors import EXIT_CHECK_FAILED, EXIT_PASSED, EXIT_USAGE
from tests.conftest import scene_text
from tests.fuzz.batch import MOST_BYTES, MOST_SECONDS
from tests.system.conftest import assert_one_line, command, nothing_left, write_scene

VARIABLE = "INIM_DAMAGED_SAMPLES"
SAMPLES = Path(os.environ.get(VARIABLE, "/nowhere"))
TEXTURED = (
    '<shape type="rectangle"><bsdf type="diffuse"><texture type="bitmap" name="reflectance">'
    '<string name="filename" value="{}"/></texture></bsdf></shape>'
)
MESH = '<shape type="{}"><string name="filename" value="{}"/></shape>'
ALONE = {"algorithms": "template", "viewpoints": "centre"}

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not SAMPLES.is_dir(), reason=f"{VARIABLE} names no folder of samples"),
]


def samples(kind: str) -> list[Path]:
    return sorted(p for p in (SAMPLES / kind).glob("*") if p.is_file())


@dataclass(frozen=True)
class Cost:
    """How a command ended and what it took."""

    code: int
    stderr: str
    seconds: float
    peak_bytes: int


def spent(words: list[str], folder: Path) -> Cost:
    """Run a command to its end, with what it and its children took."""
    said = folder / "said.txt"
    started = time.perf_counter()
    with said.open("wb") as stderr:
        child = subprocess.Popen(
            words, cwd=folder, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=stderr
        )
        _, status, usage = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
    text = said.read_text(encoding="utf-8", errors="replace")
    said.unlink()
    seconds = time.perf_counter() - started
    return Cost(child.returncode, text, seconds, usage.ru_maxrss * 1024)


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Cost:
    """A run that succeeds: what a damaged file's run is measured against."""
    folder = tmp_path_factory.mktemp("sound")
    cost = spent(command(write_scene(folder), "-o", "out", **ALONE), folder)
    assert cost.code == EXIT_PASSED, cost.stderr
    return cost


def check(cost: Cost, sound: Cost, folder: Path) -> None:
    assert cost.code in (EXIT_PASSED, EXIT_CHECK_FAILED, EXIT_USAGE), cost
    if cost.code == EXIT_USAGE:
        assert_one_line(cost.stderr, [])
    assert cost.seconds < sound.seconds + MOST_SECONDS
    assert cost.peak_bytes < sound.peak_bytes + MOST_BYTES
    assert nothing_left(folder)


@pytest.mark.parametrize("sample", samples("exr"), ids=lambda p: p.name[-30:])
def test_damaged_exr_as_an_eia(sample, tmp_path, sound):
    (tmp_path / "eia.exr").write_bytes(sample.read_bytes())
    words = ("--eia", "mine=eia.exr", "-o", "out")
    cost = spent(command(write_scene(tmp_path), *words, viewpoints="centre"), tmp_path)
    check(cost, sound, tmp_path)
    assert cost.code == EXIT_USAGE, "no sample has this display's size"


@pytest.mark.parametrize("sample", samples("exr"), ids=lambda p: p.name[-30:])
def test_damaged_exr_as_a_texture(sample, tmp_path, sound):
    name = ("a.exr", "a.png")[len(sample.name) % 2]  # the renderer goes by the content
    (tmp_path / name).write_bytes(sample.read_bytes())
    scene = write_scene(tmp_path, text=scene_text(TEXTURED.format(name)))
    check(spent(command(scene, "-o", "out", **ALONE), tmp_path), sound, tmp_path)


@pytest.mark.parametrize("sample", samples("mesh"), ids=lambda p: p.name)
def test_damaged_mesh_in_a_new_scene(sample, tmp_path, sound):
    words = ["new-scene", str(sample), "-o", "made.xml", "--unit", "mm", "--up", "y"]
    cost = spent([sys.executable, "-m", "inim", *words], tmp_path)
    if cost.code == EXIT_PASSED:  # with warnings, such as on a picture it names
        assert "Traceback" not in cost.stderr
        cost = spent(command("made.xml", "-o", "out", **ALONE), tmp_path)
    check(cost, sound, tmp_path)


@pytest.mark.parametrize("sample", samples("mesh"), ids=lambda p: p.name)
def test_damaged_mesh_in_a_scene(sample, tmp_path, sound):
    plugin = "obj" if sample.suffix == ".obj" else "ply"
    (tmp_path / sample.name).write_bytes(sample.read_bytes())
    scene = write_scene(tmp_path, text=scene_text(MESH.format(plugin, sample.name)))
    check(spent(command(scene, "-o", "out", **ALONE), tmp_path), sound, tmp_path)


@pytest.mark.parametrize("sample", samples("xml"), ids=lambda p: p.name)
def test_damaged_xml_as_a_scene(sample, tmp_path, sound):
    (tmp_path / sample.name).write_bytes(sample.read_bytes())
    cost = spent(command(sample.name, "-o", "out", **ALONE), tmp_path)
    check(cost, sound, tmp_path)
    assert cost.code == EXIT_USAGE, "none of them is a scene"
