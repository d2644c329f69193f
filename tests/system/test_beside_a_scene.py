"""Python and configuration files next to a scene have no effect.

Expected: whatever modules lie in the current folder, a run there is as anywhere else.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import inim
from inim.errors import EXIT_PASSED, EXIT_USAGE, SceneError
from inim.process.python_process import child_environment, python_code, python_module
from inim.render import variant
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
        script = "import sys\nfrom inim.cli import main\nsys.exit(main())\n"
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


PICTURE = """
import numpy as np
import inim
depth = np.zeros((24, 24), np.float32)
rgbd = inim.RGBD(np.ones((24, 24, 3), np.float32), depth, depth == 0, 0.5)
display = inim.DISPLAYS["nominal"].replace(lens_rows=4, lens_columns=4)
eia = inim.generate(rgbd, display, "gu2020")
"""


def test_python_functions_ignore_the_current_folder_s_configuration(tmp_path):
    script = PICTURE + "import sys\nassert 'matplotlib' not in sys.modules\nprint(eia.shape)"
    ended = run_configured(python_code(script), configured(tmp_path))
    assert ended.code == EXIT_PASSED, ended.stderr


def test_a_program_s_own_kernels_obey_its_configuration(tmp_path):
    script = PICTURE + (
        "import numba\n"
        "assert not numba.config.BOUNDSCHECK\n"
        "numba.njit(lambda: 1)()\n"
        "assert numba.config.BOUNDSCHECK\n"
        "open('.numba_config.yaml', 'w').write('[')\n"
        "inim.generate(rgbd, display, 'wang2024')\n"
        "assert numba.config.BOUNDSCHECK\n"
    )
    (tmp_path / ".numba_config.yaml").write_text("boundscheck: 1", "utf-8")
    nothing_compiled = child_environment() | {"NUMBA_CACHE_DIR": str(tmp_path / "kernels")}
    subprocess.run(python_code(script), cwd=tmp_path, env=nothing_compiled, check=True, timeout=300)


def test_pictures_are_drawn_without_the_current_folder_s_configuration(tmp_path):
    small = definitions({"inim.lens_columns": "6", "inim.lens_rows": "6"})
    words = python_module("inim", "inspect", "nominal", "-o", "out", *small)
    ended = run_configured(words, configured(tmp_path))
    assert ended.code == EXIT_PASSED, ended.stderr
    assert list((tmp_path / "out").rglob("*.png"))


def test_children_do_not_search_the_current_folder(trapped):
    code = "import json, sys; print(json.dumps(sys.argv[1:]))"
    path = subprocess.check_output(
        python_code(code, "a", "b"), cwd=trapped, env=child_environment(), text=True
    )
    assert path == '["a", "b"]\n'
    module = python_module("inim.validate", "--help")
    origin = subprocess.check_output(module, cwd=trapped, env=child_environment(), text=True)
    assert origin.startswith("usage: inim validate")
    assert not (trapped / "executed").exists()


def test_the_caller_s_own_path_stays(tmp_path, monkeypatch):
    (tmp_path / "mine.py").write_text("print('found')\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    printed = subprocess.check_output(
        python_code("import mine"), env=child_environment(), text=True
    )
    assert printed == "found\n"


@pytest.mark.parametrize("before", ["", "rmdir ../current; "], ids=["kept", "deleted"])
def test_a_module_s_path_is_the_caller_s_without_the_current_folder(tmp_path, before):
    site, current = tmp_path / "site", tmp_path / "current"
    site.mkdir()
    current.mkdir()
    code = "import atexit, sys\natexit.register(lambda: print(*sys.path, sep='\\n'))\n"
    (site / "sitecustomize.py").write_text(code)
    ended = run_child(
        ["sh", "-c", f'{before}exec "$@"', "sh", sys.executable, "-m", "inim", "info", "settings"],
        cwd=current,
        env=child_environment() | {"PYTHONPATH": str(site)},
    )
    assert ended.code == EXIT_PASSED, ended.stderr
    places = ended.stdout.splitlines()
    assert str(site) in places
    assert str(current) not in places


def test_renderer_plugins_in_the_current_folder_are_refused(tmp_path, monkeypatch):
    (tmp_path / "plugins").mkdir()
    (tmp_path / "plugins" / "inim_rays.so").write_text("")
    monkeypatch.chdir(tmp_path)
    display = inim.DISPLAYS["nominal"]
    eia = np.zeros((1088, 1088, 3), np.float32)
    with pytest.raises(SceneError, match=r"plugins/inim_rays\.so would be loaded"):
        inim.reconstruct(eia, display, "centre")
    with pytest.raises(SceneError, match=r"plugins/inim_rays\.so would be loaded"):
        variant.use()
