"""A libLLVM that cannot be used never takes the program down with it.

Expected: whatever the library would do to a process (it cannot be loaded, is no LLVM, aborts), the
user gets one line and exit code 3.
"""

import _ctypes
import os
import sys
from pathlib import Path

import pytest

from inim.system.backend import LLVM_VARIABLE
from inim.system.errors import EXIT_BACKEND
from tests.system.conftest import Ended, assert_one_line, run_child

RENDER = """
import sys
from inim.system.errors import InimError
try:
    from inim.render import variant
    from inim.render.library import mi
    variant.use("llvm")
    print(mi.Float(1) + 1)
except InimError as error:
    print(f"inim: error: {error}", file=sys.stderr)
    sys.exit(error.exit_code)
"""
ABORTS = Path("/usr/lib/x86_64-linux-gnu/libLLVM-15.so.1")


def render_with(library: Path | None) -> Ended:
    """Add two numbers in the renderer, with a named libLLVM or the chosen one."""
    variables = {name: value for name, value in os.environ.items() if name != LLVM_VARIABLE}
    named = {LLVM_VARIABLE: str(library)} if library else {}
    return run_child([sys.executable, "-c", RENDER], env=variables | named)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"not a library", "no libLLVM"),
        (Path(_ctypes.__file__).read_bytes(), "no libLLVM"),
        (b"LLVM version 19.1.7", "cannot be loaded"),
    ],
    ids=["text", "other", "damaged"],
)
def test_file_that_is_no_llvm_is_refused_with_exit_code_3(tmp_path, content, reason):
    library = tmp_path / "libLLVM.so.19.1"
    library.write_bytes(content)
    ended = render_with(library)
    assert ended.code == EXIT_BACKEND
    assert_one_line(ended.stderr, [str(library), reason])


@pytest.mark.skipif(not ABORTS.is_file(), reason=f"needs {ABORTS}")
def test_version_that_aborts_is_refused_whatever_its_name(tmp_path):
    library = tmp_path / "libLLVM.so.19.1"
    library.symlink_to(ABORTS)
    ended = render_with(library)
    assert ended.code == EXIT_BACKEND
    assert_one_line(ended.stderr, ["LLVM 15 aborts the process"])


def test_chosen_library_is_the_loaded_one():
    ended = render_with(None)
    assert ended.stdout.strip() == "[2]", ended.stderr
