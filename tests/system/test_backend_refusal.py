"""A libLLVM that cannot be used never takes the program down with it.

Expected: whatever the library does to a process (cannot be loaded, is no LLVM, aborts),
only a child dies; the user gets one line and exit code 3.
"""

from __future__ import annotations

import _ctypes
import os
import sys
from pathlib import Path

import pytest

from inim.system.backend import LLVM_VARIABLE, SEARCH_VARIABLE, choose_backend, environment
from inim.system.backend.trial import probe
from inim.system.errors import EXIT_BACKEND, BackendError
from tests.system.conftest import Ended, run_child

CHOOSE = """
import sys
from inim.system.backend import choose_backend
from inim.system.errors import InimError
try:
    print(choose_backend("llvm").libllvm)
except InimError as error:
    print(error, file=sys.stderr)
    sys.exit(error.exit_code)
"""
ABORTS = Path("/usr/lib/x86_64-linux-gnu/libLLVM-15.so.1")


@pytest.fixture(autouse=True)
def _fresh(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv(LLVM_VARIABLE, raising=False)
    monkeypatch.delenv(SEARCH_VARIABLE, raising=False)


def run(*arguments: str, **variables: str) -> Ended:
    return run_child([sys.executable, *arguments], env={**os.environ, **variables})


@pytest.mark.parametrize(
    "content", [b"not a library", Path(_ctypes.__file__).read_bytes()], ids=["text", "other"]
)
def test_file_that_is_no_llvm_is_refused_with_exit_code_3(tmp_path, content):
    (tmp_path / "libLLVM.so.19.1").write_bytes(content)
    ended = run("-c", CHOOSE, INIM_LLVM_SEARCH=str(tmp_path))
    assert ended.code == EXIT_BACKEND
    assert ended.stderr.count("\n") == 1
    assert f"{tmp_path / 'libLLVM.so.19.1'} (jit" in ended.stderr
    assert "install one: " in ended.stderr


@pytest.mark.skipif(not ABORTS.is_file(), reason=f"needs {ABORTS}")
def test_version_that_aborts_is_refused_by_name(monkeypatch, tmp_path):
    (tmp_path / ABORTS.name).symlink_to(ABORTS)
    monkeypatch.setenv(SEARCH_VARIABLE, str(tmp_path))
    with pytest.raises(BackendError, match="LLVM 15 aborts the process"):
        choose_backend("llvm")


@pytest.mark.skipif(not ABORTS.is_file(), reason=f"needs {ABORTS}")
def test_version_that_aborts_kills_only_the_child():
    # A CPU that happens to live with it computes correctly; no third outcome.
    verdict = probe("llvm_ad_rgb", {LLVM_VARIABLE: str(ABORTS)})
    assert verdict.usable or "SIGABRT" in verdict.reason


def test_chosen_backend_renders_in_a_child_that_chooses_nothing():
    backend = choose_backend()
    script = f"import mitsuba as mi; mi.set_variant({backend.variant!r}); print(mi.Float(1) + 1)"
    ended = run("-c", script, **environment(backend))
    assert ended.stdout.strip() == "[2]", ended.stderr


def test_activated_backend_renders_in_the_same_process():
    script = (
        "from inim.system.backend import activate, choose_backend; b = choose_backend(); "
        "activate(b); "
        "import mitsuba as mi; mi.set_variant(b.variant); print(mi.Float(1) + 1)"
    )
    ended = run("-c", script)
    assert ended.stdout.strip() == "[2]", ended.stderr
