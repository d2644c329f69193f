"""Python files beside a scene are never executed.

Expected: whatever modules lie in the current folder, a run there is as anywhere else.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from inim.errors import EXIT_PASSED
from inim.process.python_process import child_environment, python_code, python_module
from tests.system.conftest import TINY, definitions, write_scene

#: Of the standard library, of what is installed, what Python itself looks for, and the package.
MODULES = ("json", "numpy", "scipy", "mitsuba", "usercustomize", "sitecustomize", "inim")


@pytest.fixture
def trapped(tmp_path: Path) -> Path:
    """A folder with a scene, and modules that leave a mark and end whoever imports them."""
    write_scene(tmp_path)
    for name in MODULES:
        mark = f"open({str(tmp_path / 'executed')!r}, 'a').write('{name} ')"
        (tmp_path / f"{name}.py").write_text(f"{mark}\nraise SystemExit('{name} was executed')\n")
    return tmp_path


@pytest.mark.parametrize("start", ["script", "module"])
def test_modules_in_the_current_folder_are_not_executed(trapped: Path, start: str) -> None:
    words = [sys.executable, "-m", "inim.validate"]
    if start == "script":  # as the one that pip installs
        words = [sys.executable, str(trapped / "bin" / "inim"), "validate"]
        (trapped / "bin").mkdir()
        script = "import sys\nfrom inim.cli import main\nsys.exit(main())\n"
        (trapped / "bin" / "inim").write_text(script)
    else:  # Python itself has found the package by then
        (trapped / "inim.py").unlink()
    ended = subprocess.run(
        [*words, "tiny.xml", "-o", "out", *definitions(TINY)],
        cwd=trapped,
        env=child_environment(),
        capture_output=True,
        text=True,
    )
    assert not (trapped / "executed").exists(), (trapped / "executed").read_text()
    assert ended.returncode == EXIT_PASSED, ended.stderr
    assert (trapped / "out" / "report.json").exists()


def test_children_do_not_search_the_current_folder(trapped: Path) -> None:
    code = "import json, sys; print(json.dumps(sys.argv[1:]))"
    said = subprocess.check_output(
        python_code(code, "a", "b"), cwd=trapped, env=child_environment(), text=True
    )
    assert said == '["a", "b"]\n'
    module = python_module("inim.validate", "--help")
    shown = subprocess.check_output(module, cwd=trapped, env=child_environment(), text=True)
    assert shown.startswith("usage: inim validate")
    assert not (trapped / "executed").exists()


def test_the_caller_s_own_path_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mine.py").write_text("print('found')\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    said = subprocess.check_output(python_code("import mine"), env=child_environment(), text=True)
    assert said == "found\n"
