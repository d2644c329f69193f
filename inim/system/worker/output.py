"""Output folders that appear complete or not at all.

A result is built in a hidden folder next to its final folder, and then moved. A list of its files
marks an output folder: a later run replaces and deletes the files in that list, and no others.
"""

import fcntl
import json
import os
from collections.abc import Collection, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from inim.system.errors import FileError
from inim.system.process.atomic_file import file_errors
from inim.system.process.interrupts import delayed_interrupts
from inim.system.process.locked_folder import lock_folder, locked_folder

#: Files and folders of every report; the first marks a whole report.
REPORT = ("report.json", "report.html", "junit.xml", "summary.md", "eia/", "truth/", "views/")


@contextmanager
def hidden_folder(out: Path) -> Iterator[Path]:
    """Yield an empty folder next to `out`, on the same file system; remove it afterwards.

    Its path is absolute. Removes the folders that killed processes left for the same `out`. Raises
    `FileError` if the folder cannot be written.
    """
    with ExitStack() as stack:
        with file_errors(out):
            out.parent.mkdir(parents=True, exist_ok=True)
            # A name may be as long as the file system allows.
            folder = stack.enter_context(locked_folder(out.parent, f".{out.name[:32]}."))
        yield folder


@contextmanager
def staging_folder(out: Path, names: Sequence[str] = REPORT) -> Iterator[Path]:
    """Yield an empty folder next to `out` to build a result in; move the result into `out` if the
    block ends without error.

    `names` are files and folders/ that the result will contain, its JSON first. Raises `FileError`
    if `out` is a file or cannot be written, or if a file of other origin is in the way.
    """
    with file_errors(out):
        if os.path.lexists(out) and not out.is_dir():
            raise FileError(f"{out}: is a file; choose a folder with -o")
        if out.is_dir() and not os.access(out, os.W_OK):
            raise FileError(f"{out}: the folder is read-only; choose another with -o")
        if out.is_dir():
            with lock_folder(out.parent, fcntl.LOCK_SH):  # not while another run publishes
                listed = _read_list(out, names[0])
                for name in names:
                    _check_replaceable(out, name, listed)
    with hidden_folder(out) as staging:
        yield staging
        _publish(staging, out, names[0])


@contextmanager
def output_files(out: Path, names: Sequence[str]) -> Iterator[Path]:
    """Yield a folder as `staging_folder` does; an `OSError` in the block becomes a `FileError`."""
    remedy = "free some space or choose another folder with -o"
    with staging_folder(out, names) as staging, file_errors(out, remedy):
        yield staging


def _publish(staging: Path, out: Path, marker: str) -> None:
    """Move a finished result into `out`, replacing the files of an earlier run.

    The result's JSON, `marker`, is moved last and its predecessor is removed first: a killed run
    never leaves a report of mixed origin. Of two runs into one folder, the later one remains.
    Raises `FileError` if a file of other origin is in the way.
    """
    with file_errors(out), delayed_interrupts(), lock_folder(out.parent):
        files = (str(p.relative_to(staging)) for p in staging.rglob("*") if p.is_file())
        names = sorted(files, key=lambda name: (name == marker, name))
        if not os.path.lexists(out):
            _write_list(staging, staging, marker, names)
            staging.chmod(0o755)  # a temporary folder is private
            staging.replace(out)
            return
        listed = _read_list(out, marker)
        for name in names:
            _check_replaceable(out, name, listed)
        _write_list(staging, out, marker, {*listed, *names})
        if marker in listed:
            (out / marker).unlink(missing_ok=True)
        for name in listed.difference(names):
            with suppress(FileError, OSError, ValueError):
                _check_replaceable(out, name, listed)
                (out / name).unlink()
        for name in names:
            (out / name).parent.mkdir(parents=True, exist_ok=True)
            (staging / name).replace(out / name)
        _write_list(staging, out, marker, names)


def list_name(marker: str) -> str:
    """File name of the list of a result's files, one list for each kind of result."""
    return f".{Path(marker).stem}-files.json"


def _write_list(staging: Path, out: Path, marker: str, names: Collection[str]) -> None:
    (staging / list_name(marker)).write_text(json.dumps(sorted(names), indent=1) + "\n", "utf-8")
    (staging / list_name(marker)).replace(out / list_name(marker))


def _read_list(out: Path, marker: str) -> set[str]:
    """Names of the files that earlier runs moved into `out`, without paths outside it."""
    path = out / list_name(marker)
    if not os.path.lexists(path):
        return set()
    try:
        if path.is_symlink() or not path.is_file():
            raise ValueError
        content = json.loads(path.read_text("utf-8"))
        # Earlier versions wrote a mapping of names to digests.
        names = content if isinstance(content, list) else content["files"]
        return {n for n in names if not Path(n).is_absolute() and ".." not in Path(n).parts}
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        raise _foreign_output_error(path) from None


def _check_replaceable(out: Path, name: str, listed: Collection[str]) -> None:
    """Raise a `FileError` if a link or a file of other origin is at the target of a file."""
    place = out
    for part in Path(name).parts:
        place /= part
        if not os.path.lexists(place):
            return
        is_folder = place != out / name or name.endswith("/")
        is_own = place.is_dir() if is_folder else name in listed and place.is_file()
        if place.is_symlink() or not is_own:
            raise _foreign_output_error(place)


def _foreign_output_error(path: Path) -> FileError:
    return FileError(
        f"{path}: is in the way, and not from an earlier run; remove it, or choose another folder "
        "with -o"
    )
