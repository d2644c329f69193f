"""Get a usable libLLVM onto a machine that has none, with or without root.

As root, apt installs the package. Otherwise apt, with its state in a private folder,
downloads the package and those of its dependencies that the system lacks, and the
libraries are unpacked where `inim.backend` looks for them. Nothing outside that folder
changes. libatomic, which Dr.Jit links and bare systems lack, comes along.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

from inim.backend import (
    LLVM_VARIABLE,
    PRIVATE_MARKER,
    SEARCH_VARIABLE,
    choose_backend,
    known_bad,
    private_folders,
)
from inim.errors import BackendError, FileError, InimError, UsageError
from inim.process import interruption
from inim.process.python_process import started

Report = Callable[[str], object]
Run = Callable[[Sequence[str]], "subprocess.CompletedProcess[str]"]

PREFERRED = 19
NEWEST_TRIED = 22
ATTEMPTS = 3
ALONGSIDE = "libatomic1"
# Every process has these loaded already; a second copy beside them would break it.
NEVER_PRIVATE = ("libc6", "libc-bin", "libstdc++", "libgcc", "gcc-")
BY_HAND = (
    "install it by hand: apt-get install libllvm19 libatomic1 (Debian, Ubuntu), "
    "dnf install llvm-libs libatomic (Fedora), brew install llvm (macOS), "
    "conda install -c conda-forge libllvm19 (conda), all but the last two as root"
)


def run_command(command: Sequence[str]) -> subprocess.CompletedProcess[str]:
    """Run a command without a terminal, in English, and keep what it says."""
    quiet = {"LC_ALL": "C", "DEBIAN_FRONTEND": "noninteractive"}
    with started(
        command,
        env={**os.environ, **quiet},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
    ) as child:
        output, _ = child.communicate()
    return subprocess.CompletedProcess(command, child.returncode, output)


def install_llvm(
    prefix: Path | None = None, report: Report = print, run: Run = run_command
) -> Path:
    """Install a libLLVM, unless one works already, and check that it works.

    Parameters
    ----------
    prefix : Path, optional
        Unpack a private copy into this folder, even as root.
    report : callable
        Called with a line for each step.
    run : callable
        Runs a command; the tests give their own.

    Returns
    -------
    Path
        The library that now works.

    Raises
    ------
    BackendError
        None could be installed; the message says what to install by hand.
    FileError
        The private folder cannot be written.
    UsageError
        INIM_LLVM_SEARCH hides what would be installed.
    """
    try:
        backend = choose_backend("llvm")
        report(f"libLLVM {backend.libllvm_version} works already: {backend.libllvm}")
        return backend.libllvm or Path()
    except BackendError:
        if os.environ.get(LLVM_VARIABLE):
            raise
    # What would be installed could not be found: change nothing.
    if os.environ.get(SEARCH_VARIABLE):
        raise UsageError(f"{SEARCH_VARIABLE} limits where libLLVM is looked for: unset it first")
    if not all(map(shutil.which, ("apt-get", "apt-cache", "dpkg-deb"))):
        raise BackendError(f"there is no apt to fetch libLLVM with; {BY_HAND}")
    if prefix is None and hasattr(os, "geteuid") and os.geteuid() == 0:
        try:
            return _install_for_all(report, run)
        except BackendError as error:
            report(f"{error}; trying a private copy")
    return _install_private(prefix, report, run)


def packages_in_order(listing: str) -> list[str]:
    """The libllvm packages to try, best first, from what `apt-cache search` printed.

    The one that is tested most, then the newest; never those known to be unusable.
    """
    found = re.findall(r"^(libllvm(\d+)(?:t64)?) ", listing, re.MULTILINE)
    versions = {int(number): name for name, number in found if int(number) <= NEWEST_TRIED}
    good = [number for number in versions if not known_bad((number,))]
    return [versions[number] for number in sorted(good, key=lambda n: (n != PREFERRED, -n))]


def _offered(run: Run, options: Sequence[str] = ()) -> list[str]:
    pattern = "^libllvm[0-9]+(t64)?$"
    return packages_in_order(run(["apt-cache", *options, "search", "--names-only", pattern]).stdout)


def _last_words(answer: subprocess.CompletedProcess[str]) -> str:
    lines = answer.stdout.strip().splitlines()
    errors = [line for line in lines if line.startswith("E:")]
    return (errors or lines or [f"exit code {answer.returncode}"])[-1]


# --- As root ------------------------------------------------------------------------------


def _install_for_all(report: Report, run: Run) -> Path:
    packages = _offered(run)
    if not packages:
        report("reading the package lists: apt-get update")
        run(["apt-get", "update"])
        packages = _offered(run)
    why = "this release offers no usable libllvm package"
    for package in packages[:ATTEMPTS]:
        report(f"installing {package}: apt-get install {package} {ALONGSIDE}")
        answer = _apt_install(package, run)
        if answer.returncode == 0:
            try:
                return _checked(None, report)
            except BackendError as error:
                why = str(error)
        else:
            why = f"apt-get could not install {package}: {_last_words(answer)}"
    raise BackendError(why)


def _apt_install(package: str, run: Run) -> subprocess.CompletedProcess[str]:
    command = ["apt-get", "install", "-y", "--no-install-recommends"]
    # Somebody else's apt may be at work: wait for it rather than fail.
    command += ["-o", "DPkg::Lock::Timeout=120", package, ALONGSIDE]
    answer = run(command)
    if answer.returncode == 0:
        return answer
    # Lists older than the archive name packages that are gone.
    run(["apt-get", "update"])
    return run(command)


# --- Without root -------------------------------------------------------------------------


def _install_private(prefix: Path | None, report: Report, run: Run) -> Path:
    folder = prefix.absolute() if prefix else _private_folder()
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        # Beside its destination: half a gigabyte that /tmp may not have.
        with interruption.undone_afterwards(
            lambda: tempfile.TemporaryDirectory(prefix=".inim-llvm-", dir=folder.parent),
            lambda made: made.cleanup(),
        ) as made:
            return _fetch_private(folder, Path(made.name), prefix is not None, report, run)
    except OSError as error:
        raise FileError(f"{folder} cannot be written: {error}; give --prefix FOLDER") from error


def _private_folder() -> Path:
    """The virtual environment's folder inside one, the user's data folder otherwise."""
    environment, *home = private_folders()
    inside = sys.prefix != sys.base_prefix and os.access(sys.prefix, os.W_OK)
    folder = environment if inside else next(iter(home), None)
    if folder is None:
        raise FileError("there is no home folder to put libLLVM in; give --prefix FOLDER")
    return folder


def private_options(scratch: Path) -> list[str]:
    """The apt options that keep all of its state under `scratch`, with no lock taken."""
    settings = {
        "Dir::State": scratch / "state",
        "Dir::State::status": "/var/lib/dpkg/status",
        "Dir::Cache": scratch / "cache",
        "Debug::NoLocking": "1",
        "APT::Sandbox::User": "root",
    }
    return [part for name, value in settings.items() for part in ("-o", f"{name}={value}")]


def _fetch_private(folder: Path, scratch: Path, given: bool, report: Report, run: Run) -> Path:
    for part in ("state/lists/partial", "cache/archives/partial"):
        (scratch / part).mkdir(parents=True)
    options = private_options(scratch)
    report("reading the package lists into a private folder (no root needed)")
    update = run(["apt-get", *options, "update"])
    why = f"apt offers no usable libllvm package here ({_last_words(update)})"
    for package in _offered(run, options)[:ATTEMPTS]:
        report(f"downloading {package} and what it needs")
        answer = run(["apt-get", *options, *_download(package)])
        if answer.returncode != 0:
            why = f"apt-get could not download {package}: {_last_words(answer)}"
            continue
        archives = sorted((scratch / "cache/archives").glob("*.deb"))
        if not archives:
            why = f"{package} is installed already and does not work"
            continue
        unpack(archives, folder, scratch / package, run)
        report(f"unpacked {len(archives)} packages into {folder}")
        try:
            return _checked(folder if given else None, report)
        except BackendError as error:
            why = str(error)
    raise BackendError(f"no libLLVM could be installed: {why}; {BY_HAND}")


def _download(package: str) -> list[str]:
    # apt itself works out which of the dependencies the system lacks.
    return ["install", "-y", "--no-install-recommends", "--download-only", package, ALONGSIDE]


def unpack(archives: Sequence[Path], folder: Path, scratch: Path, run: Run) -> None:
    """Unpack Debian packages and leave their shared libraries, alone, in `folder`.

    Parameters
    ----------
    archives : sequence of Path
        The ``.deb`` files.
    folder : Path
        Replaced by a folder with the libraries and a list of the packages.
    scratch : Path
        A folder to unpack in, on the same file system.
    run : callable
        Runs a command.
    """
    wanted = [path for path in archives if not path.name.startswith(NEVER_PRIVATE)]
    flat = scratch / "flat"
    flat.mkdir(parents=True)
    for archive in wanted:
        answer = run(["dpkg-deb", "-x", str(archive), str(scratch / "root")])
        if answer.returncode != 0:
            raise BackendError(f"{archive.name} cannot be unpacked: {_last_words(answer)}")
    _flatten(scratch / "root", flat)
    packages = [path.name for path in wanted]
    (flat / PRIVATE_MARKER).write_text(json.dumps({"packages": packages}, indent=1), "utf-8")
    with interruption.publishing():
        if (folder / PRIVATE_MARKER).is_file():
            shutil.rmtree(folder)
        # An empty folder is replaced; anything else in the way is the user's, and an error.
        flat.rename(folder)


def _flatten(root: Path, flat: Path) -> None:
    """Move the libraries under `root` into `flat`, each with its aliases as links."""
    names = [path for path in root.rglob("*.so*") if _is_library_folder(path.parent)]
    targets = {path.name: path.resolve() for path in names if path.resolve().is_file()}
    inside = {name: target for name, target in targets.items() if root.resolve() in target.parents}
    for target in set(inside.values()):
        target.rename(flat / target.name)
    for name, target in inside.items():
        if name != target.name:
            (flat / name).symlink_to(target.name)


def _is_library_folder(folder: Path) -> bool:
    return "-linux-gnu" in folder.name or folder.parent.name.startswith("llvm-")


def _checked(folder: Path | None, report: Report) -> Path:
    backend = choose_backend("llvm", [folder] if folder else None)
    library = backend.libllvm or Path()
    report(f"libLLVM {backend.libllvm_version} works: {library}")
    if folder:
        report(f"to use it, set {LLVM_VARIABLE}={library}")
    return library


def main() -> int:
    """Install from the command line: what `python -m inim.backend.install_llvm` runs."""
    try:
        install_llvm()
    except InimError as error:
        print(f"inim: {error}", file=sys.stderr)
        return error.exit_code
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
