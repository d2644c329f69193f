"""Choice of a backend: candidates, their order, versions and refusals."""

import ctypes
import os
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from inim.system import backend
from inim.system.backend import Backend
from inim.system.errors import BackendError
from inim.system.process import machine

WHEEL_FOLDERS = backend.wheel_folders
X86 = os.uname().machine in ("x86_64", "i686")


@pytest.fixture(autouse=True)
def _alone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """No library, variable or driver of this machine plays a part."""
    for name in ("DRJIT_LIBLLVM_PATH", "CONDA_PREFIX"):
        monkeypatch.setenv(name, "")  # what `activate` sets is undone
    monkeypatch.setenv("DRJIT_LIBCUDA_PATH", str(tmp_path / "no libcuda"))
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "venv"))
    monkeypatch.setattr(backend, "wheel_folders", lambda: [])
    monkeypatch.setattr(backend, "_system_folders", lambda: [tmp_path / "system"])
    monkeypatch.setattr(machine, "linker_cache", lambda name: [])


def library(path: Path, version: str) -> Path:
    """A file that contains the text by which a libLLVM prints its version."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(bytes(100) + f"LLVM version {version}".encode() + bytes(100))
    return path


# --- Versions, names and order --------------------------------------------------------------


@pytest.mark.parametrize("version", ["22.1.8", "19.1.7", "15.0.6", "9.0.1"])
def test_version_is_read_from_the_file_whatever_its_name(tmp_path, version):
    assert backend.llvm_version(library(tmp_path / "libLLVM-18.so.1", version)) == version


def test_version_of_the_library_in_use_is_the_loaded_one(renderer, monkeypatch):
    if renderer.name != "llvm":
        pytest.skip("the backend is CUDA")
    import drjit

    loaded = ".".join(map(str, drjit.detail.llvm_version()))
    assert backend.llvm_version(renderer.libllvm) == renderer.libllvm_version == loaded


def test_newest_version_comes_first_and_a_nameless_one_last(tmp_path):
    order = ["libLLVM.so.22.1", "libLLVM.so.19.1", "libLLVM-17.so.1", "libLLVM-9.so", "libLLVM.so"]
    for name in sorted(order):
        library(tmp_path / "system" / name, "19.1.7")
    assert [path.name for path in backend.find_libllvm()] == order


@pytest.mark.parametrize(
    ("packages", "name"),
    [
        ("venv/lib/python3.12/site-packages", "venv/lib/libLLVM.so.22.1"),
        ("target", "target/lib/libLLVM.so.22.1"),
    ],
)
def test_installed_package_is_preferred_and_its_libraries_are_loaded_by_their_files(
    monkeypatch, tmp_path, packages, name
):
    monkeypatch.setattr(backend, "wheel_folders", WHEEL_FOLDERS)
    monkeypatch.setattr(sys, "path", ["", str(tmp_path / packages)])
    (tmp_path / packages / "karellen_llvm_core-22.1.8.dist-info").mkdir(parents=True)
    packaged = library(tmp_path / name, "22.1.8")
    needed = ("libunwind.so.1.0", "libc++abi.so.1.0", "libc++.so.1.0")
    folder = packaged.parent / "x86_64-unknown-linux-gnu"
    for file in needed:
        library(folder / file, "")
    newer = library(tmp_path / "system/libLLVM.so.97.1", "97.1.0")
    monkeypatch.setattr(backend, "_system_has_libatomic", lambda: True)
    assert list(backend.find_libllvm()) == [packaged, newer]
    assert backend.required_libraries(packaged) == [str(folder / file) for file in needed]
    assert backend.required_libraries(newer) == []


def test_library_named_by_the_user_is_the_only_candidate(monkeypatch, tmp_path):
    library(tmp_path / "system/libLLVM.so.22.1", "22.1.8")
    named = library(tmp_path / "libLLVM.so.19.1", "19.1.7")
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(named))
    assert backend.choose_backend("llvm").libllvm == named
    named.unlink()
    backend.llvm_version.cache_clear()
    with pytest.raises(BackendError, match=r"DRJIT_LIBLLVM_PATH names .*libLLVM.so.19.1 .*missing"):
        backend.choose_backend("llvm")


# --- Choice -------------------------------------------------------------------------------


def test_newest_usable_version_is_chosen(tmp_path):
    library(tmp_path / "system/libLLVM-18.so.1", "18.1.8")
    library(tmp_path / "system/libLLVM.so.19.1", "19.1.7")
    (tmp_path / "system/libLLVM.so.97.1").write_text("no library")
    chosen = backend.choose_backend("llvm")
    assert (chosen.name, chosen.variant, chosen.libllvm_version) == (
        "llvm", "llvm_ad_rgb", "19.1.7"
    )  # fmt: skip
    assert "LLVM 19.1.7" in chosen.device


@pytest.mark.skipif(not X86, reason="these versions abort on x86 only")
def test_refusal_is_one_line_with_every_reason_and_the_remedy(tmp_path):
    for number in (14, 15, 16):
        library(tmp_path / f"system/libLLVM-{number}.so.1", f"{number}.0.6")
    with pytest.raises(BackendError) as caught:
        backend.choose_backend("llvm")
    message = str(caught.value)
    assert "\n" not in message
    for part in (
        "libLLVM-14.so.1 (LLVM 14 is too old for Dr.Jit)",
        "libLLVM-15.so.1 (LLVM 15 aborts the process on x86 CPUs)",
        "libLLVM-16.so.1 (LLVM 16 aborts the process on x86 CPUs)",
        "sudo apt-get install libllvm19 libatomic1",
    ):
        assert part in message


# --- CUDA ---------------------------------------------------------------------------------


class Driver:
    """CUDA's driver library with one card, or none."""

    def __init__(self, cards: int) -> None:
        self._cards = cards

    def cuInit(self, _: int) -> int:  # noqa: N802
        return 0 if self._cards else 100

    def cuDeviceGetName(self, name: ctypes.Array, size: int, number: int) -> int:  # noqa: N802
        name.value = b"A card"
        return 0 if number < self._cards else 101


def install(monkeypatch: pytest.MonkeyPatch, cards: int, *missing: str) -> None:
    """Replace the driver's libraries."""

    def load(name: str) -> Driver:
        if name in missing:
            raise OSError(f"{name}: cannot open shared object file")
        return Driver(cards)

    monkeypatch.setenv("DRJIT_LIBCUDA_PATH", "")
    monkeypatch.setattr(ctypes, "CDLL", load)


def test_card_is_preferred_to_llvm(monkeypatch, tmp_path):
    library(tmp_path / "system/libLLVM.so.19.1", "19.1.7")
    install(monkeypatch, 1)
    assert backend.choose_backend() == Backend("cuda", "cuda_ad_rgb", None, None, "A card")
    assert backend.choose_backend("llvm").variant == "llvm_ad_rgb"


@pytest.mark.parametrize(
    ("cards", "missing", "reason"),
    [
        (0, (), "the driver finds no card"),
        (1, ("libcuda.so.1",), "libcuda.so.1: cannot open"),
        (1, ("libnvoptix.so.1",), "libnvoptix.so.1: cannot open"),
    ],
)
def test_llvm_is_used_without_a_card_or_a_library_of_its_driver(
    monkeypatch, tmp_path, cards, missing, reason
):
    library(tmp_path / "system/libLLVM.so.19.1", "19.1.7")
    install(monkeypatch, cards, *missing)
    assert backend.choose_backend().name == "llvm"
    with pytest.raises(BackendError, match=f"no usable CUDA: .*{reason}.*use --backend llvm"):
        backend.choose_backend("cuda")


# --- Use ----------------------------------------------------------------------------------


def chosen(library: Path | None) -> Backend:
    return Backend("llvm", "llvm_ad_rgb", library, "19.1.7", "a processor")


def test_activate_names_the_library_for_dr_jit(monkeypatch, tmp_path):
    loaded: list[str] = []
    monkeypatch.delitem(sys.modules, "drjit", raising=False)
    monkeypatch.setattr(backend, "load", loaded.extend)
    backend.activate(chosen(tmp_path / "libLLVM.so.19.1"))
    assert os.environ["DRJIT_LIBLLVM_PATH"] == loaded[-1] == str(tmp_path / "libLLVM.so.19.1")


def test_library_that_cannot_be_loaded_is_refused(monkeypatch, tmp_path):
    monkeypatch.delitem(sys.modules, "drjit", raising=False)
    with pytest.raises(BackendError, match=r"libLLVM.so.19.1: cannot be loaded .*; install one"):
        backend.activate(chosen(library(tmp_path / "libLLVM.so.19.1", "19.1.7")))


class Loaded:
    """Dr.Jit as it may be found loaded."""

    class JitBackend:
        CUDA, LLVM = "cuda", "llvm"

    def __init__(self, version: tuple[int, ...], *has: str) -> None:
        self.detail, self._has = SimpleNamespace(llvm_version=lambda: version), has

    def has_backend(self, name: str) -> bool:
        return name in self._has


@pytest.mark.parametrize(
    ("loaded", "says"),
    [
        (Loaded((-1, -1, -1)), "found no usable libLLVM; import inim.render.library"),
        (Loaded((14, 0, 6), "llvm"), "LLVM 14 is too old for Dr.Jit; import inim.render.library"),
    ],
)
def test_activate_refuses_to_be_late(monkeypatch, tmp_path, loaded, says):
    monkeypatch.setitem(sys.modules, "drjit", loaded)
    with pytest.raises(BackendError, match=f"Dr.Jit is loaded already, and {says}"):
        backend.activate(chosen(tmp_path / "libLLVM.so.19.1"))


# --- Facts about the machine --------------------------------------------------------------


@pytest.mark.parametrize(
    ("membership", "files", "limits"),
    [
        (
            "0::/a/b\n",
            {"a/b/memory.max": "max\n", "a/memory.max": "5000\n", "memory.max": "7000\n"},
            [5000, 7000],
        ),
        (
            "4:cpu,cpuacct:/a\n3:memory:/a\n",
            {"memory/a/memory.limit_in_bytes": "5000\n", "cpu/a/memory.limit_in_bytes": "1\n"},
            [5000],
        ),
        ("0::/\n", {"memory.max": "5000\n"}, [5000]),
        ("0::/not/here\n", {"memory.max": "5000\n"}, [5000]),
    ],
    ids=["enclosing groups", "older groups", "a container's root", "no such group"],
)
def test_every_control_group_limits_the_memory(tmp_path, membership, files, limits):
    (tmp_path / "membership").write_text(membership)
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    paths = machine._limit_files(tmp_path / "membership", tmp_path)
    assert [number for number in map(machine._number_in, paths) if number] == limits


def test_memory_limit_is_never_above_what_the_machine_has(monkeypatch, tmp_path):
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    assert 0 < machine.memory_limit_bytes() <= total
    (tmp_path / "limit").write_text("123456789")
    monkeypatch.setattr(machine, "_limit_files", lambda path: [tmp_path / "limit"])
    assert machine.memory_limit_bytes() == 123456789
