"""What `python -m inim` and its kin run: the command line, without the current folder's modules.

Nothing but `sys` is imported before that folder is off the path.
"""

from __future__ import annotations

import sys
from typing import NoReturn

__all__ = ["run"]


def run(*words: str) -> NoReturn:
    """Carry out the command that these words and the process's own arguments name, and exit."""
    if not getattr(sys.flags, "safe_path", False):
        del sys.path[0]  # the current folder, where `python -m` looks first
    from inim.cli import main

    sys.exit(main([*words, *sys.argv[1:]]))
