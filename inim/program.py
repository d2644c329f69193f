"""What `inim`, `python -m inim` and its kin run: the command line, as a process of its own.

Nothing is imported before SIGINT is heeded, and nothing of the current folder.
"""

import os
import sys

TYPE_CHECKING = False  # `typing` takes longer to load than all else here
if TYPE_CHECKING:
    from typing import NoReturn


def run(*words: str) -> "NoReturn":
    """Carry out the command that these words and the process's own arguments name, and exit."""
    import _signal  # type: ignore[import-not-found]  # built in; `signal` loads a dozen modules

    if _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler:  # else it is ignored
        _signal.signal(_signal.SIGINT, lambda number, _: os._exit(128 + number))
    by_module = sys.modules["__main__"].__spec__ is not None
    if by_module and not getattr(sys.flags, "safe_path", False):
        del sys.path[0]  # the current folder, where `python -m` looks first
    if sys.version_info < (3, 10):  # noqa: UP036 (in its own folder inim runs uninstalled)
        print("inim: error: Python 3.10 or newer is needed, not", sys.executable, file=sys.stderr)
        sys.exit(2)
    from inim.process import interruption

    interruption.install()
    from inim.cli import main

    try:
        code = main([*words, *sys.argv[1:]])
    finally:
        interruption.too_late()
    sys.exit(code)
