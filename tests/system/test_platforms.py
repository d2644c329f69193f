"""Systems without what Linux and macOS have: each command works, or says in one line what it needs.

Played here by taking away the modules and names that Windows lacks, in a process of its own.
"""

import sys

import numpy as np
import pytest

from inim.display import DISPLAYS
from inim.image.files.image import write_png, write_rgbd
from inim.image.rgbd import RGBD
from inim.system.errors import EXIT_BACKEND
from tests.system.conftest import Ended, assert_one_line, run_child, write_scene

WITHOUT_POSIX = """
import os, shutil, signal, sys
for name in ("fcntl", "resource", "pwd", "grp", "termios"):
    sys.modules[name] = None
for place, names in {
    os: "getuid geteuid sysconf O_DIRECTORY O_NOFOLLOW O_NONBLOCK O_NOCTTY "
        "sched_getaffinity fork",
    signal: "SIGALRM setitimer pthread_sigmask SIGKILL",
}.items():
    for name in names.split():
        if hasattr(place, name):
            delattr(place, name)
# Where no call takes a folder's descriptor, `shutil.rmtree` needs no O_NONBLOCK.
shutil._use_fd_functions = False
"""
RUN = "from inim.cli.program import run\nrun()"
#: Run each command, whose words are parted by commas, and end its answer with its exit code.
RUN_EACH = """
from inim.cli.main import main
for words in sys.argv[1:]:
    print(main(words.split(",")), file=sys.stderr)
"""


@pytest.fixture
def inim(tmp_path):
    """Run a command in a folder with a scene, an RGB-D picture and a photograph."""
    write_scene(tmp_path)
    display = DISPLAYS["nominal"]
    shape = (display.lens_rows, display.lens_columns)
    color = np.full((*shape, 3), 0.5, np.float32)
    depth = np.full(shape, 1.0, np.float32)
    write_rgbd(tmp_path / "rgbd.exr", RGBD(color, depth, depth > 0, display.pitch_mm))
    write_png(tmp_path / "color.png", color)

    def run(*words: str, code: str = RUN) -> Ended:
        return run_child([sys.executable, "-c", WITHOUT_POSIX + code, *words], cwd=tmp_path)

    return run


def test_commands_without_a_worker_succeed(inim, tmp_path):
    text = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
    text += "property float z\nelement face 1\nproperty list uchar int vertex_indices\n"
    (tmp_path / "ball.ply").write_text(text + "end_header\n0 0 0\n9 0 0\n0 9 1\n3 0 1 2\n")
    small = "inspect,phone,-D,inim.lens_columns=6,-D,inim.lens_rows=6"
    commands = ("info,settings", "info,algorithms", "info,cache", small)
    ended = inim(*commands, "new-scene,ball.ply,--unit,mm,--up,y", code=RUN_EACH)
    assert ended.stderr.split() == ["0"] * 5


def test_commands_with_workers_name_the_required_platform(inim):
    commands = ("validate,tiny.xml", "validate,rgbd.exr", "demo", "bench,tiny.xml")
    commands += ("stress,--quick", "compare,a,b", "sweep,study.toml")
    lines = inim(*commands, code=RUN_EACH).stderr.splitlines()
    assert len(lines) == 2 * len(commands), lines
    for line, code in zip(lines[::2], lines[1::2], strict=True):
        assert int(code) == EXIT_BACKEND
        assert_one_line(f"{line}\n", ["need Linux or macOS", "WSL"])
