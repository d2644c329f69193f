"""Commands under memory limits of the shell: each ends soon, with success or exit code 3.

OpenBLAS repeats a failed allocation forever while it loads, and the process then ignores SIGTERM.
"""

import resource
import sys
from functools import partial

import numpy as np
import pytest
from PIL import Image

from inim.cli.main import COMMANDS
from inim.system.errors import EXIT_BACKEND, EXIT_PASSED
from tests.system.conftest import Ended, assert_one_line, run_child

KINDS = {"ulimit -v": resource.RLIMIT_AS, "ulimit -d": resource.RLIMIT_DATA}
WITHIN_S = 120
#: Arguments that each command's parser accepts.
WORDS = {
    "accept": ("out",),
    "bench": ("scene.xml",),
    "benchmark": ("check",),
    "compare": ("a", "b"),
    "export": ("eia.png",),
    "figure": ("out",),
    "generate": ("photo.png",),
    "info": ("system",),
    "inspect": ("nominal",),
    "new-scene": ("relic.ply",),
    "pickup": ("photo.png",),
    "stress": ("template",),
    "sweep": ("study.toml",),
    "validate": ("scene.xml",),
    "view": ("eia.png",),
}


def run_limited(kind: str, mib: int, *words: str, **options: object) -> Ended:
    """Run `inim` in a process that may have so much memory."""
    limit = partial(resource.setrlimit, KINDS[kind], (mib * 2**20, mib * 2**20))
    words = (sys.executable, "-m", "inim", *words)
    return run_child(words, WITHIN_S, preexec_fn=limit, **options)


def assert_refused(ended: Ended, kind: str, mib: int) -> None:
    assert (ended.code, ended.stdout) == (EXIT_BACKEND, "")
    assert_one_line(ended.stderr, [f"{kind}: {mib} MiB, below the ", f"raise it: {kind} "])


@pytest.mark.parametrize("command", sorted(COMMANDS))
def test_every_command_is_refused_below_what_its_libraries_need(command, tmp_path):
    ended = run_limited("ulimit -v", 390, command, *WORDS.get(command, ()), cwd=tmp_path)
    assert_refused(ended, "ulimit -v", 390)


@pytest.mark.parametrize("mib", [50, 100, 150, 200, 300])
@pytest.mark.parametrize("kind", KINDS)
def test_small_limits_are_refused(kind, mib, tmp_path):
    assert_refused(run_limited(kind, mib, "inspect", "nominal", cwd=tmp_path), kind, mib)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_command_works_with_the_limit_that_the_message_gives(kind, tmp_path):
    """The quilt loads NumPy, SciPy, numba and Mitsuba."""
    message = run_limited(kind, 50, "info", "system").stderr
    kib = int(message.rpartition(f"{kind} ")[2])
    depth = np.tile(np.arange(1000, 2000, 10, np.uint16), (80, 1))
    Image.fromarray(depth).save(tmp_path / "depth.png")
    Image.fromarray((depth % 251).astype(np.uint8)).save(tmp_path / "photo.png")
    words = ("generate", "photo.png", "--depth", "depth.png", "--depth-unit", "mm")
    words = (*words, "--orthographic", "-o", "eia.png")
    generated = run_limited(kind, kib // 1024, *words, cwd=tmp_path)
    assert generated.code == EXIT_PASSED, generated.stderr
    quilt = run_limited(kind, kib // 1024, "export", "eia.png", "--quilt", "q.png", cwd=tmp_path)
    assert quilt.code == EXIT_PASSED, quilt.stderr
