"""What `inim`, `python -m inim` and its kin run: the command line, as a process of its own.

Nothing that takes time is imported before signals are heeded, and nothing of the current folder.
"""

from __future__ import annotations

import sys

from inim import interruption

# `typing` takes longer to load than all else here.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import NoReturn

__all__ = ["run"]


def run(*words: str) -> NoReturn:
    """Carry out the command that these words and the process's own arguments name, and exit."""
    interruption.install()
    by_module = sys.modules["__main__"].__spec__ is not None
    if by_module and not getattr(sys.flags, "safe_path", False):
        del sys.path[0]  # the current folder, where `python -m` looks first
    from inim.cli import main

    try:
        code = main([*words, *sys.argv[1:]])
    finally:
        interruption.too_late()
    sys.exit(code)
