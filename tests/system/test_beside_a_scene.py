"""Files in the current folder and next to a scene have no effect, unless the user names them.

Expected: whatever modules, settings, renderer plugins and data are there, a run is as elsewhere.
"""

import os
import re
import shutil
import sys
import time
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from inim.image.files.image import read_exr, write_rgbd
from inim.image.rgbd import RGBD
from inim.system.errors import EXIT_PASSED, EXIT_USAGE
from inim.system.process.python_process import child_environment, python_code, python_module
from tests.conftest import scene_text, square
from tests.system.conftest import (
    ALONE,
    TINY,
    Ended,
    assert_one_line,
    definitions,
    run_child,
    write_scene,
)

ONE_VIEW = TINY | {f"inim.{key}": value for key, value in ALONE.items()}
#: Of the standard library, of what is installed, what Python itself looks for, and the package.
MODULES = ("json", "numpy", "scipy", "mitsuba", "usercustomize", "sitecustomize", "inim")


@pytest.fixture
def trapped(tmp_path):
    """A folder with a scene, and modules that leave a mark and end whoever imports them."""
    write_scene(tmp_path)
    for name in MODULES:
        mark = f"open({str(tmp_path / 'executed')!r}, 'a').write('{name} ')"
        (tmp_path / f"{name}.py").write_text(f"{mark}\nraise SystemExit('{name} was executed')\n")
    return configured(tmp_path)


def configured(folder: Path) -> Path:
    """A folder with configuration files that hang, crash or redirect the packages reading them."""
    lines = ("num_threads: 1000000", "threading_layer: no_such_layer", "disable_jit: 1")
    text = "\n".join([f"cache_dir: {folder / 'kernels'}", *lines])
    (folder / ".numba_config.yaml").write_text(text, "utf-8")
    os.mkfifo(folder / "matplotlibrc")
    return folder


def run_configured(words: list[str], folder: Path) -> Ended:
    """Run a child whose numba cache folder a configuration file could name."""
    variables = {k: v for k, v in child_environment().items() if k != "NUMBA_CACHE_DIR"}
    ended = run_child(words, 600, cwd=folder, env=variables)
    assert not (folder / "kernels").exists()
    return ended


@pytest.mark.parametrize("start", [pytest.param("script", marks=pytest.mark.slow), "module"])
def test_modules_in_the_current_folder_are_not_executed(trapped, start):
    if start == "script":  # as the one that pip installs
        words = [sys.executable, str(trapped / "bin" / "inim"), "validate", "-o", "out"]
        (trapped / "bin").mkdir()
        script = "import sys\nfrom inim.cli.main import main\nsys.exit(main())\n"
        (trapped / "bin" / "inim").write_text(script)
    else:  # Python itself has found the package by then; the worker is that of the script
        words = [sys.executable, "-m", "inim.validate", "-o", "tiny.xml"]
        (trapped / "inim.py").unlink()
    ended = run_configured([*words, "tiny.xml", *definitions(ONE_VIEW)], trapped)
    assert not (trapped / "executed").exists(), (trapped / "executed").read_text()
    if start == "script":
        assert ended.code == EXIT_PASSED, ended.stderr
        assert (trapped / "out" / "report.json").exists()
    else:  # the plan, with the scene's file in the place of the folder
        assert ended.code == EXIT_USAGE
        assert_one_line(ended.stderr, ["tiny.xml"])


@pytest.mark.parametrize(("value", "expected"), [("kept", "{}/kept"), ("/a", "/a"), ("OFF", "OFF")])
def test_a_child_elsewhere_has_the_same_result_cache(monkeypatch, tmp_path, value, expected):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("INIM_CACHE", value)
    assert child_environment()["INIM_CACHE"] == expected.format(tmp_path)


def test_pictures_are_drawn_without_the_current_folder_s_configuration(tmp_path):
    small = definitions({"inim.lens_columns": "6", "inim.lens_rows": "6"})
    words = python_module("inim", "inspect", "nominal", "-o", "out", *small)
    ended = run_configured(words, configured(tmp_path))
    assert ended.code == EXIT_PASSED, ended.stderr
    assert list((tmp_path / "out").rglob("*.png"))


CHILD = """
import os, time
from inim.system.worker.serve import exit_with_parent, read_job
print(os.getcwd(), os.listdir(), flush=True)
WAITING
time.sleep(60)
"""
PARENT = """
import os, signal, subprocess, sys
from inim.system.process.python_process import python_code, rendering_process
pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
with rendering_process(python_code(sys.argv[1]), {}, **pipes) as process:
    print(process.stdout.readline().decode(), flush=True)
    END
"""


@pytest.mark.parametrize("waiting", ["exit_with_parent()", "read_job()"])
@pytest.mark.parametrize("end", ["pass", "os.kill(os.getpid(), signal.SIGKILL)"])
def test_the_empty_folder_of_a_renderer_is_removed_however_its_parent_ends(tmp_path, end, waiting):
    env = child_environment() | {"TMPDIR": str(tmp_path)}
    child = CHILD.replace("WAITING", waiting)
    ended = run_child(python_code(PARENT.replace("END", end), child), env=env)
    folder, content = ended.stdout.split()
    assert (Path(folder).parent, content) == (tmp_path, "[]")
    deadline = time.monotonic() + 60
    while list(tmp_path.iterdir()) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert list(tmp_path.iterdir()) == []


# --- Files that the renderer looks up ------------------------------------------------------------

MITSUBA = Path(str(find_spec("mitsuba").origin)).parent
GOLD = """<shape type="sphere"><bsdf type="conductor"><string name="material" value="Au"/></bsdf>
    </shape><emitter type="constant"/>"""


def with_renderer_files(folder: Path, *parts: str) -> Path:
    """A folder with files in the place of each of Mitsuba's plugins, or data files.

    The libraries cannot be loaded, and gold is nearly black.
    """
    for path in (p for part in parts for p in (MITSUBA / part).rglob("*") if p.is_file()):
        target = folder / path.relative_to(MITSUBA)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text("360 1\n830 1\n")
    return folder


def test_renderer_files_in_the_current_folder_change_no_image_and_no_cached_result(tmp_path):
    write_scene(tmp_path / "scene", text=f'<scene version="3.0.0">{GOLD}</scene>')
    env = child_environment() | {"INIM_CACHE": str(tmp_path / "cache")}
    words = python_module(
        "inim", "validate", str(tmp_path / "scene" / "tiny.xml"), *definitions(ONE_VIEW)
    )
    (tmp_path / "empty").mkdir()
    means = []
    for folder in (with_renderer_files(tmp_path / "here", "data"), tmp_path / "empty"):
        ended = run_child([*words, "-o", "out"], cwd=folder, env=env)
        assert ended.code == EXIT_PASSED, ended.stderr
        means.append(read_exr(folder / "out" / "truth" / "centre.exr").mean(axis=(0, 1)))
    np.testing.assert_array_equal(means[0], means[1])
    red, _, blue = means[0]
    assert red > 1.5 * blue  # gold


# --- Every file that is opened -------------------------------------------------------------------

DECOYS = (
    *(f"{name}.py" for name in MODULES),
    *(".numba_config.yaml", "matplotlibrc", "dask.yaml", "distributed.yaml", "pip.conf", ".env"),
    *("a.pth", "pyvenv.cfg", "setup.cfg", "pyproject.toml", "tox.ini", "conftest.py", ".netrc"),
    *("libLLVM.so", "libatomic.so.1", "libcuda.so.1", "libmitsuba.so", "libgomp.so.1"),
)
FEW_LENSES = definitions({"inim.lens_columns": "6", "inim.lens_rows": "6"})
STUDY = """[study]
scenes = ["tiny.xml"]
algorithms = ["template"]
viewpoints = ["centre"]
[settings]
"""
COMMANDS = {
    "info": ["info", "system"],
    "validate": ["validate", "../inputs/tiny.xml", *definitions(ONE_VIEW)],
    "picture": ["validate", "../inputs/picture.exr", "-a", "template", "--viewpoints", "centre"],
    "generate": ["generate", "../inputs/picture.exr", "-a", "wang2024"],
    "generate from a scene": ["generate", "../inputs/tiny.xml", "-a", "gu2020", *definitions(TINY)],
    "stress": ["stress", "../inputs/tiny.xml", "--quick", "-a", "template", *definitions(TINY)],
    "bench": ["bench", "../inputs/tiny.xml", "--runs", "1", "--warmups", "1", "-a", "template",
              *definitions(TINY)],
    "sweep": ["sweep", "../inputs/study.toml", "--workers", "1"],
    "inspect": ["inspect", "nominal", *FEW_LENSES],
}  # fmt: skip
_CALL = re.compile(r'(?:open|openat|execve)\((?:[^<",]*<([^>]*)>, )?"((?:[^"\\]|\\.)*)"')


def opened_paths(log: str) -> set[Path]:
    """Absolute paths of all calls in the output of strace; a path is relative to its folder."""
    calls = re.findall(_CALL, log)
    assert calls
    return {Path(os.path.normpath(Path(folder) / name)) for folder, name in calls}


def write_inputs(folder: Path) -> set[Path]:
    """Write a scene, a study and a picture; return their paths."""
    write_scene(folder, text=scene_text(square((0, 0, 1), 1, "0.8"), GOLD.split("<emitter")[0]))
    settings = "".join(f"{k.removeprefix('inim.')} = {v}\n" for k, v in TINY.items())
    (folder / "study.toml").write_text(STUDY + settings)
    depth = np.full((24, 24), 33, np.float32)
    color, covered = np.ones((24, 24, 3), np.float32), depth > 0
    write_rgbd(folder / "picture.exr", RGBD(color, depth, covered, 1))
    return {path for path in folder.iterdir() if path.is_file()}


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("strace") is None, reason="strace is not installed")
@pytest.mark.parametrize("name", COMMANDS)
def test_only_the_inputs_are_opened(tmp_path, name):
    here, beside = tmp_path / "here", tmp_path / "inputs"
    inputs = write_inputs(beside)
    with_renderer_files(here, "plugins", "data")
    for folder in (here, beside):
        for decoy in DECOYS:
            (folder / decoy).write_text("[")
    out = [] if name == "info" else ["-o", "out.png" if name.startswith("generate") else "out"]
    env = child_environment() | {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    trace = ["strace", "-f", "-y", "--seccomp-bpf", "-e", "trace=open,openat,execve"]
    log = tmp_path / "log"
    words: Sequence[str] = python_module("inim", *COMMANDS[name], *out)
    ended = run_child([*trace, "-o", str(log), *words], 600, cwd=here, env=env)
    assert ended.code == EXIT_PASSED, ended.stderr
    opened = {
        path
        for path in opened_paths(log.read_text(errors="replace"))
        if here in path.parents or beside in path.parents
    }
    allowed = re.compile(rf"{here}/(out|\.(out|inim)[^/]*\.partial)\b.*")
    assert {p for p in opened - inputs if not allowed.fullmatch(str(p))} == set()
    assert name in ("info", "inspect") or opened & inputs
