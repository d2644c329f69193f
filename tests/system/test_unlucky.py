"""Machines that are not kind: no home, broken caches, two runs at once, kills, little memory.

Expected: the run succeeds, or says in one line what to do; no report is ever of mixed origin, and
what a killed run leaves behind is no obstacle to the next, which clears it away.
"""

import json
import os
import resource
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import inim
from inim.system.backend import kernels
from inim.system.errors import EXIT_BACKEND, EXIT_PASSED
from inim.system.worker.output import hidden_folder
from tests.system.conftest import (
    ALONE,
    SMALLEST,
    TINY,
    Ended,
    assert_one_line,
    command,
    files_in,
    nothing_left,
    run_child,
    small_disk,
    write_scene,
)

Run = Callable[..., Ended]


# --- Caches -------------------------------------------------------------------------------------

NOWHERE = Path("/dev/null/nowhere")  # not even root can make it


@pytest.fixture
def nothing_to_write(monkeypatch, tmp_path):
    """Neither the home nor the package can be written, only the folder for temporary files."""
    for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.setenv(name, "")  # so that whatever the test sets is undone
        monkeypatch.delenv(name)
    monkeypatch.setenv("HOME", str(NOWHERE))
    monkeypatch.setattr(kernels.tempfile, "tempdir", str(tmp_path))
    return tmp_path


def test_kernels_find_a_private_folder_where_nothing_else_can_be_written(nothing_to_write):
    folder = kernels.cache_folder()
    assert folder.parent == nothing_to_write
    assert folder.stat().st_mode & 0o777 == 0o700
    assert kernels.cache_folder() == folder  # a second run takes the same


@pytest.mark.slow
def test_read_only_package_and_no_home_is_enough(tmp_path):
    """Installation by root for a user without a home: the first run compiles, the second not."""
    if os.geteuid() != 0 or not shutil.which("setpriv"):
        pytest.skip("gives up root's right to write anywhere, for which it needs root and setpriv")
    source = Path(inim.__file__).parent
    package = tmp_path / "package" / "inim"
    shutil.copytree(source, package, ignore=shutil.ignore_patterns("__pycache__"))
    for path in [package, *package.rglob("*")]:
        path.chmod(0o555 if path.is_dir() else 0o444)
    scene = write_scene(tmp_path / "scene")
    (tmp_path / "tmp").mkdir()
    rights = "-dac_override,-dac_read_search"
    variables = {
        **os.environ, "HOME": str(NOWHERE), "TMPDIR": str(tmp_path / "tmp"),
        "PYTHONPATH": str(package.parent),
    }  # fmt: skip
    for name in ("XDG_CACHE_HOME", "XDG_DATA_HOME", "NUMBA_CACHE_DIR"):
        variables.pop(name, None)
    files = []
    for _ in range(2):
        words = ["setpriv", f"--bounding-set={rights}", f"--inh-caps={rights}"]
        words += command(scene, "-o", tmp_path / "out", **SMALLEST)
        ended = run_child(words, env=variables, cwd=tmp_path)
        assert (ended.code, ended.stderr) == (EXIT_PASSED, "")
        kernels_of = (tmp_path / "tmp").rglob("*.nb[ci]")
        files.append({path: path.stat().st_mtime_ns for path in kernels_of})
    assert files[0]
    assert files[1] == files[0]
    assert list((tmp_path / "tmp").glob("inim-*/**/*.nbi"))
    assert not list(package.rglob("*.nbi"))


# --- Surroundings -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def earlier(tmp_path_factory, run_inim):
    """A report as small as can be."""
    folder = tmp_path_factory.mktemp("earlier")
    first = run_inim(write_scene(folder), "-o", "out", folder=folder, **SMALLEST)
    assert first.code == EXIT_PASSED, first.stderr
    return folder / "out"


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.2, 0.9])
def test_disk_that_fills_at_any_time_leaves_the_earlier_report(
    tmp_path, earlier, run_process, share
):
    scene = write_scene(tmp_path / "scene")
    with small_disk(tmp_path / "disk", "2m") as disk:
        shutil.copytree(earlier, disk / "out")
        before = {name: (disk / "out" / name).read_bytes() for name in files_in(disk / "out")}
        free = os.statvfs(disk).f_bavail * os.statvfs(disk).f_frsize
        left = int(share * sum(map(len, before.values())))  # of what a second report takes
        (disk / "fill").write_bytes(bytes(free - left))
        second = run_process(scene, "-o", disk / "out", folder=tmp_path, seed="1", **SMALLEST)
        assert second.code == 2
        assert_one_line(second.stderr, ["No space left"])
        after = {name: (disk / "out" / name).read_bytes() for name in files_in(disk / "out")}
        assert after == before
        assert nothing_left(disk)


def test_memory_limit_of_the_shell_counts(tmp_path):
    """`ulimit -v`: what does not fit is said with its figure before it is tried."""
    scene = write_scene(tmp_path)
    limit = 2 * 2**30

    def limited() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))

    ended = run_child(command(scene, "-o", "out"), cwd=tmp_path, preexec_fn=limited)
    assert ended.code == EXIT_BACKEND
    assert_one_line(ended.stderr, ["available 2.0 GiB", "capture_pixels_per_pitch"])
    assert list(tmp_path.iterdir()) == [scene]


# --- Two at once --------------------------------------------------------------------------------


MOVES = """
import sys
from pathlib import Path
import json
from inim.system.worker.output import staging_folder
out, name, count = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])
for k in range(count):
    with staging_folder(out) as staging:
        names = [f"{name}/{j}.txt" for j in range(30)] + ["report.json"]
        for file in names[:-1]:
            (staging / file).parent.mkdir(exist_ok=True)
            (staging / file).write_text(name)
        (staging / "report.json").write_text(json.dumps({"files": names, "of": name}))
"""


def test_reports_published_at_once_never_mix(tmp_path):
    out = tmp_path / "out"
    words = [sys.executable, "-c", MOVES, str(out)]
    runs = [subprocess.Popen([*words, name, "20"]) for name in ("one", "two", "three")]
    assert [run.wait(timeout=60) for run in runs] == [0, 0, 0]
    data = json.loads((out / "report.json").read_text())
    assert files_in(out) == set(data["files"])
    assert {p.read_text() for p in out.rglob("*.txt")} == {data["of"]}
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


# --- Kills --------------------------------------------------------------------------------------


def test_hidden_folder_of_a_dead_run_is_cleared_away_and_of_a_living_one_is_not(tmp_path):
    out = tmp_path / "o*ut"
    code = "import sys, os; from pathlib import Path\n"
    code += "from inim.system.worker.output import hidden_folder"
    code += "; hidden_folder(Path(sys.argv[1])).__enter__(); os.kill(os.getpid(), 9)"
    for _ in range(3):
        assert subprocess.run([sys.executable, "-c", code, str(out)]).returncode == -9
    others = tmp_path / ".oXut.mine.partial"
    others.mkdir()
    with hidden_folder(out) as mine, hidden_folder(out) as again:
        assert sorted(tmp_path.iterdir()) == sorted([mine, again, others])
    assert list(tmp_path.iterdir()) == [others]


def test_folder_of_a_renderer_killed_with_its_parent_is_removed_by_the_next_run(tmp_path):
    code = "import os, signal, sys; from inim.system.process.python_process import *\n"
    code += "command = [sys.executable, '-c', 'input()']\n"
    code += "with rendering_process(command, {{}}) as child:\n"
    code += "    child.kill(); child.wait(); {}"
    variables = os.environ | {"TMPDIR": str(tmp_path)}

    def run(last: str) -> int:
        return subprocess.run([sys.executable, "-c", code.format(last)], env=variables).returncode

    assert run("os.kill(os.getpid(), 9)") == -9
    (left,) = tmp_path.iterdir()
    other = tmp_path / "inim-mesh-1.partial"  # of another kind, and not locked
    other.mkdir()
    assert run("pass") == 0
    assert list(tmp_path.iterdir()) == [other] and left != other


# --- Many in one process ------------------------------------------------------------------------

MANY_RUNS = """
import ctypes, gc, sys
from pathlib import Path
from inim.pipeline.plan import make_plan
from inim.pipeline.request import Request
from inim.pipeline.job import run
from inim.render.scene_files.file import parse_definitions
folder, count = Path(sys.argv[1]), int(sys.argv[2])
for k in range(count):
    definitions = parse_definitions(sys.argv[3:], "tiny")
    plan = make_plan(Request(folder / "tiny.xml", folder / "out", definitions=definitions))
    staging = folder / f"run-{k}"
    staging.mkdir()
    assert run(plan, staging).passed
    gc.collect()
    if hasattr(ctypes.CDLL(None), "malloc_trim"):  # in glibc, which keeps a heap for each thread
        ctypes.CDLL(None).malloc_trim(0)
    fields = Path("/proc/self/statm").read_text().split()
    print(int(fields[1]) * 4096, flush=True)
"""


@pytest.mark.skipif(not Path("/proc/self/statm").is_file(), reason="finds it in /proc")
@pytest.mark.slow
def test_fifty_validations_in_one_process_take_no_more_memory_than_twenty(tmp_path):
    """Memory in use: what the heaps keep for later differs by the number of threads."""
    write_scene(tmp_path)
    settings = [f"{key}={value}" for key, value in TINY.items()]
    settings += [f"inim.{key}={value}" for key, value in ALONE.items()]
    ended = run_child([sys.executable, "-c", MANY_RUNS, str(tmp_path), "50", *settings], 900)
    assert ended.code == 0, ended.stderr
    resident = [int(line) for line in ended.stdout.split()]
    warm, last = max(resident[18:22]), max(resident[-4:])
    print(f"{warm / 2**20:.0f} MiB after twenty runs, {last / 2**20:.0f} MiB after fifty")
    assert last < 1.02 * warm
