"""Entry point of `inim`, `python -m inim` and `python -m inim.validate`."""

import os
import sys
from contextlib import suppress

TYPE_CHECKING = False  # `typing` takes longer to load than all else here
if TYPE_CHECKING:
    from typing import NoReturn


def run(*words: str) -> "NoReturn":
    """Run the command that these words and the process's own arguments name, and exit."""
    try:
        by_module = sys.modules["__main__"].__spec__ is not None
        if by_module and not getattr(sys.flags, "safe_path", False):
            # `python -m` looks first in the current folder, unless that was deleted.
            with suppress(OSError):
                if sys.path[0] == os.getcwd():  # noqa: PTH109
                    del sys.path[0]
        if sys.version_info < (3, 10):  # noqa: UP036 (in its own folder inim runs uninstalled)
            print(
                "inim: error: Python 3.10 or newer is needed, not", sys.executable, file=sys.stderr
            )
            sys.exit(2)
        from inim.system.process.interrupts import ignore_interrupts, raise_interrupts

        raise_interrupts()
        from inim.cli.main import main

        code = main([*words, *sys.argv[1:]])
        ignore_interrupts()
    except KeyboardInterrupt as interrupt:
        while True:
            with suppress(KeyboardInterrupt):  # a second signal
                _end(*interrupt.args)
    sys.exit(code)


def _end(number: int = 2, note: str = "unfinished results were discarded") -> "NoReturn":
    """Clean up and end the process after a signal, without waiting for its threads."""
    from inim.system.process.interrupts import clean_up_blocks

    clean_up_blocks()
    if number == 2:  # SIGINT; SIGTERM needs no message
        with suppress(OSError):
            os.write(2, f"inim: interrupted; {note}\n".encode())
    os._exit(128 + number)
