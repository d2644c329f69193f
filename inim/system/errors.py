"""The error tree: one class per way a run can end badly, each with its exit code.

Every message is one line that names the thing (file, option, plugin), the offending
value and the way out. The command line prints it as is and exits with `exit_code`. A check that
failed, code 1, is a verdict and no exception.
"""

import errno
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

EXIT_PASSED = 0
EXIT_CHECK_FAILED = 1
EXIT_USAGE = 2
EXIT_BACKEND = 3
EXIT_BASELINE = 4
EXIT_INTERNAL = 5


class InimError(Exception):
    """Base class of all deliberate errors; `exit_code` is the command's exit code."""

    exit_code = EXIT_INTERNAL


class UsageError(InimError):
    """A command line, setting or argument that cannot be acted on."""

    exit_code = EXIT_USAGE


class FileError(InimError):
    """A file or folder that is missing, unreadable, damaged or not writable."""

    exit_code = EXIT_USAGE


class SceneError(InimError):
    """A scene that loads but cannot be used: unknown key, empty, impossible fit."""

    exit_code = EXIT_USAGE


class DisplayError(InimError, ValueError):
    """Display parameters that describe no possible integral-imaging display."""

    exit_code = EXIT_USAGE


class ViewpointError(InimError, ValueError):
    """A viewpoint from which the display shows flipped (repeated) views."""

    exit_code = EXIT_USAGE


class BackendError(InimError):
    """No renderer backend works here; the message holds the line to type."""

    exit_code = EXIT_BACKEND


class OutOfMemoryError(InimError):
    """The job needs more memory than there is; the message holds the figures."""

    exit_code = EXIT_BACKEND


class BaselineError(InimError):
    """A baseline that is missing or was made under other conditions."""

    exit_code = EXIT_BASELINE


def missing_package(error: Exception) -> UsageError | None:
    """Error message for a missing dependency, usually caused by the wrong Python."""
    module = str(getattr(error, "name", None))
    if not isinstance(error, ModuleNotFoundError) or module.startswith("inim."):
        return None
    return UsageError(
        f"{sys.executable} has no package {module.partition('.')[0]}: use the Python that inim is "
        "installed for (in its repository .venv/bin/python, which `make demo` makes)"
    )


def unexpected_error(error: Exception) -> InimError:
    """Error message for a missing dependency or for a defect of this program, in one line."""
    text = " ".join(str(error).split())[:400]
    if isinstance(error, UnicodeEncodeError) and any(
        "\udc80" <= c <= "\udcff" for c in error.object
    ):
        return FileError(f"{error.object}: the name is not UTF-8; rename the file or its folder")
    if isinstance(error, OSError) and error.errno == errno.ENAMETOOLONG:
        return FileError(f"{error.filename}: the name is too long; choose a shorter one")
    return missing_package(error) or InimError(
        f"internal error: {type(error).__name__}: {text}; "
        "run again with --debug for the traceback, and report it"
    )


@contextmanager
def naming(source: object) -> Iterator[None]:
    """Put a file's name before the errors of the block that name neither it nor an option."""
    try:
        yield
    except InimError as error:
        text = str(error)
        if error.exit_code != EXIT_USAGE or str(source) in text or text.startswith("-"):
            raise
        raise type(error)(f"{source}: {text}") from error.__cause__


class WorkerError(InimError):
    """The worker process ended without a result (crash in native code, kill)."""


# Looking for a likeness takes as long as a word is.
_LONGEST_WORD = 80


def suggest_words(
    word: object, allowed: Iterable[str], otherwise: str = "", prefix: str = "", most: int = 1
) -> str:
    """Remedy for an unknown word: "did you mean X?", or a list of all allowed words.

    * `otherwise`: text instead of "use A or B" if no allowed word is similar.
    * `prefix`: text before each suggested word.
    * `most`: number of similar words to suggest.
    """
    import difflib

    allowed = list(allowed)
    near = difflib.get_close_matches(str(word)[:_LONGEST_WORD], allowed, n=most)
    if near:
        return f"did you mean {' or '.join(prefix + word for word in near)}?"
    return otherwise or f"use {' or '.join(allowed)}"
