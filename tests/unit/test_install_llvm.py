"""Getting a libLLVM: what is asked of apt, in what order, and what is left where.

No test runs apt: a runner of scripted answers stands in for it.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from inim.backend import Backend, known_bad
from inim.backend import install_llvm as installer
from inim.backend.install_llvm import install_llvm, packages_in_order, unpack
from inim.errors import BackendError, FileError, UsageError

OFFER = "libllvm18 - Modular compiler\nlibllvm19 - Modular compiler\n"


class Apt:
    """Answers commands as apt would, and keeps them."""

    def __init__(self, offer: str = OFFER, broken: Sequence[str] = (), empty: bool = False) -> None:
        self.offer, self.broken, self.empty = offer, broken, empty
        self.commands: list[list[str]] = []

    def __call__(self, command: Sequence[str]) -> subprocess.CompletedProcess[str]:
        self.commands.append(list(command))
        if "search" in command:
            return self.answer(self.offer)
        if set(self.broken) & set(command):
            return self.answer("reading\nE: Unable to fetch some archives\n", 100)
        if "--download-only" in command and not self.empty:
            (Path(self.option("Dir::Cache")) / "archives/libllvm_1_amd64.deb").touch()
        if command[0] == "dpkg-deb":
            package(Path(command[3]), "libLLVM.so.19.1")
        return self.answer("")

    def answer(self, said: str, code: int = 0) -> subprocess.CompletedProcess[str]:
        return subprocess.CompletedProcess([], code, said)

    def option(self, name: str) -> str:
        (value,) = {part for part in self.commands[-1] if part.startswith(f"{name}=")}
        return value.partition("=")[2]

    def verbs(self) -> list[str]:
        known = ("update", "search", "install", "-x")
        return [word for command in self.commands for word in command if word in known]


def package(root: Path, *names: str, links: dict[str, str] | None = None) -> None:
    """What unpacking a package leaves under `root`."""
    folder = root / "usr/lib/x86_64-linux-gnu"
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        (folder / name).write_text(name)
    for name, target in (links or {}).items():
        (folder / name).symlink_to(target)


@pytest.fixture(autouse=True)
def _machine(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A machine with apt and a virtual environment, without a libLLVM and without root."""
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    monkeypatch.delenv("INIM_LLVM_SEARCH", raising=False)
    monkeypatch.setattr(installer, "private_folders", lambda: [tmp_path / "venv/lib/inim-llvm"])
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "venv"))
    monkeypatch.setattr(shutil, "which", lambda name: f"/usr/bin/{name}")
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    (tmp_path / "venv").mkdir()
    works_after(monkeypatch, 1)


def works_after(monkeypatch: pytest.MonkeyPatch, refusals: int) -> None:
    """`choose_backend` refuses so many times before it finds a library."""
    left = [BackendError("none works")] * refusals

    def choose(wanted: str, search: Sequence[Path] | None = None) -> Backend:
        if left:
            raise left.pop()
        library = (search[0] if search else Path("/found")) / "libLLVM.so.19.1"
        return Backend("llvm", "llvm_ad_rgb", library, "19.1.7", "a processor")

    monkeypatch.setattr(installer, "choose_backend", choose)


def silent(line: str) -> None:
    """Report to nobody."""


# --- Planning -----------------------------------------------------------------------------


def test_tested_version_comes_first_then_the_newest() -> None:
    listing = "".join(f"libllvm{number} - x\n" for number in (17, 18, 19, 20, 21))
    order = ["libllvm19", "libllvm21", "libllvm20", "libllvm18", "libllvm17"]
    assert packages_in_order(listing) == order


def test_untested_and_unusable_versions_are_left_out() -> None:
    assert known_bad((14,))
    assert packages_in_order("libllvm14 - x\nlibllvm99 - x\nlibllvm-dev - x\n") == []


def test_package_renamed_for_64_bit_time_is_known() -> None:
    assert packages_in_order("libllvm17t64 - x\nlibllvm18 - x\n") == ["libllvm18", "libllvm17t64"]


# --- Nothing to do, or nothing that could be done -----------------------------------------


def test_nothing_is_done_where_one_works(monkeypatch: pytest.MonkeyPatch) -> None:
    works_after(monkeypatch, 0)
    apt, said = Apt(), list[str]()
    assert install_llvm(report=said.append, run=apt) == Path("/found/libLLVM.so.19.1")
    assert apt.commands == []
    assert said == ["libLLVM 19.1.7 works already: /found/libLLVM.so.19.1"]


@pytest.mark.parametrize(
    ("name", "error"), [("DRJIT_LIBLLVM_PATH", BackendError), ("INIM_LLVM_SEARCH", UsageError)]
)
@pytest.mark.parametrize("user", [0, 1000])
def test_nothing_is_done_where_it_could_not_be_found(
    monkeypatch: pytest.MonkeyPatch, name: str, error: type[Exception], user: int
) -> None:
    monkeypatch.setenv(name, "/some/where")
    monkeypatch.setattr(os, "geteuid", lambda: user)
    apt = Apt()
    with pytest.raises(error):
        install_llvm(report=silent, run=apt)
    assert apt.commands == []


def test_machine_without_apt_is_told_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(BackendError, match=r"there is no apt .*dnf install .*brew install"):
        install_llvm(report=silent, run=Apt())


# --- As root ------------------------------------------------------------------------------


def test_root_installs_for_all(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    apt = Apt()
    assert install_llvm(report=silent, run=apt) == Path("/found/libLLVM.so.19.1")
    assert apt.verbs() == ["search", "install"]
    assert apt.commands[-1][-2:] == ["libllvm19", "libatomic1"]


def test_root_reads_the_lists_first_where_there_are_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    apt = Apt(offer="")
    with pytest.raises(BackendError):
        install_llvm(report=silent, run=apt)
    assert apt.verbs()[:3] == ["search", "update", "search"]


def test_root_whose_apt_fails_gets_a_private_copy(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    apt = Apt(broken=["DPkg::Lock::Timeout=120"])
    install_llvm(report=silent, run=apt)
    assert (tmp_path / "venv/lib/inim-llvm/libLLVM.so.19.1").is_file()


def test_root_may_ask_for_a_private_copy(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    apt, said = Apt(), list[str]()
    library = install_llvm(tmp_path / "mine", said.append, apt)
    assert library == tmp_path / "mine/libLLVM.so.19.1"
    assert all("--download-only" in command for command in apt.commands if "install" in command)
    assert said[-1] == f"to use it, set DRJIT_LIBLLVM_PATH={library}"


# --- Without root -------------------------------------------------------------------------


def test_all_of_apts_state_is_private(tmp_path: Path) -> None:
    apt = Apt()
    install_llvm(report=silent, run=apt)
    for command in apt.commands:
        if command[0] != "dpkg-deb":
            settings = [part for part in command if part.startswith(("Dir::State=", "Dir::Cache="))]
            assert len(settings) == 2
            assert all(str(tmp_path) in setting for setting in settings)
            assert "Debug::NoLocking=1" in command


def test_private_copy_lies_in_the_virtual_environment_and_nothing_else_stays(
    tmp_path: Path,
) -> None:
    install_llvm(report=silent, run=Apt())
    assert [path.name for path in (tmp_path / "venv/lib").iterdir()] == ["inim-llvm"]
    names = {path.name for path in (tmp_path / "venv/lib/inim-llvm").iterdir()}
    assert names == {"libLLVM.so.19.1", "inim-llvm.json"}


def test_home_is_used_outside_a_virtual_environment(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(sys, "base_prefix", sys.prefix)
    folders = [tmp_path / "venv/lib/inim-llvm", tmp_path / "home/llvm"]
    monkeypatch.setattr(installer, "private_folders", lambda: folders)
    install_llvm(report=silent, run=Apt())
    assert (tmp_path / "home/llvm/libLLVM.so.19.1").is_file()
    assert not folders[0].exists()


def test_no_home_and_no_virtual_environment_asks_for_a_folder(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sys, "base_prefix", sys.prefix)
    with pytest.raises(FileError, match=r"no home folder .* give --prefix"):
        install_llvm(report=silent, run=Apt())


def test_folder_that_cannot_be_written_is_named() -> None:
    with pytest.raises(FileError, match="/dev/null/llvm cannot be written"):
        install_llvm(Path("/dev/null/llvm"), silent, Apt())


def test_next_version_is_tried_when_one_does_not_work(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    works_after(monkeypatch, 2)
    apt = Apt()
    install_llvm(report=silent, run=apt)
    asked = [command[-2] for command in apt.commands if "install" in command]
    assert asked == ["libllvm19", "libllvm18"]


@pytest.mark.parametrize(
    ("apt", "why"),
    [
        (Apt(offer=""), "apt offers no usable libllvm package here"),
        (Apt(broken=["libllvm18", "libllvm19"]), "E: Unable to fetch some archives"),
        (Apt(empty=True), "libllvm18 is installed already and does not work"),
    ],
)
def test_failure_says_why_and_what_to_do_and_leaves_nothing(
    tmp_path: Path, apt: Apt, why: str
) -> None:
    with pytest.raises(BackendError) as caught:
        install_llvm(report=silent, run=apt)
    assert why in str(caught.value)
    assert "install it by hand: apt-get install libllvm19" in str(caught.value)
    assert list((tmp_path / "venv/lib").iterdir()) == []


# --- Unpacking ----------------------------------------------------------------------------


def unpacked(tmp_path: Path, archives: Sequence[str], **content: dict[str, str]) -> Path:
    """Unpack packages that hold a library, its alias, and things that are not wanted."""

    def run(command: Sequence[str]) -> subprocess.CompletedProcess[str]:
        root = Path(command[3])
        package(root, "libz3.so.4.8", **content)
        (root / "usr/share/doc").mkdir(parents=True, exist_ok=True)
        (root / "usr/share/doc/notes.so.txt").touch()
        return subprocess.CompletedProcess([], 0, "")

    unpack([Path(name) for name in archives], tmp_path / "flat", tmp_path / "scratch", run)
    return tmp_path / "flat"


def test_libraries_and_their_aliases_lie_side_by_side(tmp_path: Path) -> None:
    links = {"libz3.so.4": "libz3.so.4.8", "libz3.so": "libz3.so.4"}
    folder = unpacked(tmp_path, ["libz3-4_1_amd64.deb"], links=links)
    names = {path.name for path in folder.iterdir()}
    assert names == {"libz3.so.4.8", "libz3.so.4", "libz3.so", "inim-llvm.json"}
    assert (folder / "libz3.so").read_text() == "libz3.so.4.8"


def test_alias_that_leads_outside_the_package_is_dropped(tmp_path: Path) -> None:
    (tmp_path / "outside.so").touch()
    links = {"libout.so.1": str(tmp_path / "outside.so"), "libgone.so.1": "nowhere"}
    folder = unpacked(tmp_path, ["libz3-4_1_amd64.deb"], links=links)
    assert {path.name for path in folder.iterdir()} == {"libz3.so.4.8", "inim-llvm.json"}
    assert (tmp_path / "outside.so").exists()


def test_c_and_cpp_libraries_are_never_private(tmp_path: Path) -> None:
    names = ["libc6_2_amd64.deb", "libstdc++6_1_amd64.deb", "libgcc-s1_1_amd64.deb"]
    folder = unpacked(tmp_path, [*names, "libz3-4_1_amd64.deb"])
    packages = json.loads((folder / "inim-llvm.json").read_text())["packages"]
    assert packages == ["libz3-4_1_amd64.deb"]


def test_earlier_private_copy_is_replaced(tmp_path: Path) -> None:
    old = tmp_path / "flat"
    old.mkdir()
    (old / "inim-llvm.json").touch()
    (old / "libLLVM-17.so.1").touch()
    folder = unpacked(tmp_path, ["libz3-4_1_amd64.deb"])
    assert not (folder / "libLLVM-17.so.1").exists()


def test_folder_with_the_users_own_files_is_left_alone(tmp_path: Path) -> None:
    own = tmp_path / "flat"
    own.mkdir()
    (own / "thesis.tex").touch()
    with pytest.raises(OSError, match="not empty"):
        unpacked(tmp_path, ["libz3-4_1_amd64.deb"])
    assert (own / "thesis.tex").exists()
