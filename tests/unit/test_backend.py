"""Choosing a backend: what is looked for, in what order, what is run and what is remembered."""

import ctypes
import json
import os
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from inim.cli.info import describe, sys_info
from inim.system import backend
from inim.system.backend import Backend, Verdict, trial
from inim.system.errors import BackendError, UsageError
from inim.system.process import machine

GOOD = Verdict(True, version="19.1.7", device="2 threads", stage="done")
WHEEL_FOLDERS = backend.wheel_folders
X86 = os.uname().machine in ("x86_64", "i686")


@pytest.fixture(autouse=True)
def _alone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """No variable, home or driver of this machine plays a part."""
    for name in ("DRJIT_LIBLLVM_PATH", "INIM_LLVM_SEARCH", "DRJIT_LIBCUDA_PATH", "LD_LIBRARY_PATH"):
        monkeypatch.setenv(name, "")
        monkeypatch.delenv(name)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "venv"))
    monkeypatch.setattr(backend, "wheel_folders", lambda: [])
    monkeypatch.setattr(machine, "linker_cache", lambda name: [])


@pytest.fixture
def tried(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """List of the probed libraries; every probe succeeds."""
    names: list[str] = []

    def answer(variant: str, variables: dict[str, str], needed: object) -> Verdict:
        names.append(Path(variables.get("DRJIT_LIBLLVM_PATH", variant)).name)
        return GOOD

    monkeypatch.setattr(trial, "probe", answer)
    return names


def libraries(folder: Path, *names: str) -> Path:
    """A folder with empty files of these names."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        (folder / name).touch()
    return folder


def refuse(monkeypatch: pytest.MonkeyPatch, **answers: Verdict) -> None:
    """Probes refuse, or answer with the verdict given for the backend's first letters."""
    no = Verdict(False, "it computes wrong numbers")
    monkeypatch.setattr(trial, "probe", lambda variant, env, needed: answers.get(variant[:4], no))


# --- Names and order ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("path", "version"),
    [
        ("/usr/lib/x/libLLVM.so.19.1", (19, 1)),
        ("/usr/lib/x/libLLVM-19.so.1", (19,)),
        ("/usr/lib/x/libLLVM-19.so", (19,)),
        ("/usr/lib/x/libLLVM-15.so.1", (15,)),
        ("/usr/lib/x/libLLVM-14.0.6.so.1", (14, 0, 6)),
        ("/usr/lib/x/libLLVM-14.so", (14,)),
        ("/home/u/lib/libLLVM.so.22.1-rust-1.91.0-stable", (22, 1)),
        ("/usr/lib/llvm-18/lib/libLLVM.so.1", (18,)),
        ("/usr/lib/llvm-18/lib/libLLVM.so", (18,)),
        ("/opt/homebrew/opt/llvm@18/lib/libLLVM.dylib", (18,)),
        ("/opt/homebrew/Cellar/llvm/20.1.8/lib/libLLVM.dylib", (20, 1, 8)),
        ("/opt/homebrew/Cellar/llvm@18/18.1.8/lib/libLLVM.dylib", (18, 1, 8)),
        ("/opt/homebrew/opt/llvm/lib/libLLVM.dylib", None),
        ("/usr/local/lib/libLLVM.so", None),
    ],
)
def test_version_is_read_from_the_name_or_else_the_folder(path, version):
    assert backend.llvm_version(Path(path)) == version


def test_newest_version_comes_first_and_a_nameless_one_last(tmp_path):
    order = ["libLLVM.so.22.1", "libLLVM.so.19.1", "libLLVM-17.so.1", "libLLVM-9.so", "libLLVM.so"]
    in_order = backend.find_libllvm([libraries(tmp_path / "lib", *sorted(order))])
    assert [path.name for path in in_order] == order


def test_missing_folders_and_files_of_similar_names_are_no_candidates(tmp_path):
    names = ["libLLVMX86CodeGen.a", "libLLVM-C.so", "libLLVMgold.so", "libLLVM-19.txt"]
    folders = [tmp_path / "none", Path("/dev/null"), libraries(tmp_path / "lib", *names)]
    assert backend.find_libllvm(folders) == []


def test_aliases_of_one_file_are_one_candidate(tmp_path):
    folder = libraries(tmp_path / "lib", "libLLVM.so.19.1")
    (folder / "libLLVM-19.so").symlink_to("libLLVM.so.19.1")
    (folder / "libLLVM-18.so").symlink_to("nowhere")
    assert backend.find_libllvm([folder, folder]) == [(folder / "libLLVM.so.19.1").resolve()]


def test_search_variable_replaces_the_usual_folders(monkeypatch, tmp_path):
    library = libraries(tmp_path / "one", "libLLVM-17.so.1")
    two = libraries(tmp_path / "two", "libLLVM-18.so.1")
    monkeypatch.setenv("INIM_LLVM_SEARCH", f"{library}{os.pathsep}{two}")
    names = [path.name for path in backend.find_libllvm()]
    assert names == ["libLLVM-18.so.1", "libLLVM-17.so.1"]


def test_linker_cache_is_searched(monkeypatch, tmp_path):
    odd = libraries(tmp_path / "odd", "libLLVM.so.97.1") / "libLLVM.so.97.1"
    monkeypatch.setattr(machine, "linker_cache", lambda name: [str(odd)])
    assert backend.find_libllvm()[0].name == "libLLVM.so.97.1"


@pytest.mark.parametrize(
    ("packages", "library"),
    [
        ("venv/lib/python3.12/site-packages", "venv/lib/libLLVM.so.22.1"),
        ("target", "target/lib/libLLVM.so.22.1"),
    ],
)
def test_installed_package_is_preferred_and_its_libraries_are_loaded_by_their_files(
    monkeypatch, tmp_path, packages, library
):
    monkeypatch.setattr(backend, "wheel_folders", WHEEL_FOLDERS)
    monkeypatch.setattr(sys, "path", ["", str(tmp_path / packages)])
    libraries(tmp_path / packages / "karellen_llvm_core-22.1.8.dist-info")
    packaged = libraries((tmp_path / library).parent, "libLLVM.so.22.1") / "libLLVM.so.22.1"
    needed = ("libunwind.so.1.0", "libc++abi.so.1.0", "libc++.so.1.0")
    folder = libraries(packaged.parent / "x86_64-unknown-linux-gnu", *needed)
    newer = libraries(tmp_path / "newer", "libLLVM.so.97.1") / "libLLVM.so.97.1"
    monkeypatch.setattr(machine, "linker_cache", lambda name: [str(newer)])
    monkeypatch.setattr(backend, "_system_has_libatomic", lambda: True)
    assert backend.find_libllvm()[:2] == [packaged, newer]
    assert backend.required_libraries(packaged) == [str(folder / name) for name in needed]
    assert backend.required_libraries(newer) == []


@pytest.mark.skipif(
    (sys.platform, os.uname().machine) != ("linux", "x86_64"), reason="a library for Linux, x86-64"
)
def test_own_libatomic_serves_where_the_system_has_none(monkeypatch):
    monkeypatch.setattr(backend, "_system_has_libatomic", lambda: False)
    (path,) = backend.required_libraries(None)
    exchange = ctypes.CDLL(path)["__atomic_compare_exchange_16"]
    exchange.argtypes = [ctypes.c_void_p] * 2 + [ctypes.c_uint64] * 2 + [ctypes.c_int] * 2
    exchange.restype = ctypes.c_bool
    memory = (ctypes.c_uint64 * 4)()
    start = (-ctypes.addressof(memory)) % 16  # the instruction needs this alignment
    place = (ctypes.c_uint64 * 2).from_buffer(memory, start)
    place[:] = (1, 2)
    expected = (ctypes.c_uint64 * 2)(1, 3)
    assert not exchange(ctypes.addressof(place), ctypes.addressof(expected), 5, 6, 5, 5)
    assert (list(place), list(expected)) == ([1, 2], [1, 2])
    assert exchange(ctypes.addressof(place), ctypes.addressof(expected), 5, 6, 5, 5)
    assert list(place) == [5, 6]


def test_library_named_by_the_user_alone_is_tried(monkeypatch, tmp_path, tried):
    folder = libraries(tmp_path / "lib", "libLLVM.so.22.1", "libLLVM.so.19.1")
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(folder / "libLLVM.so.19.1"))
    assert backend.choose_backend("llvm", [folder]).libllvm == folder / "libLLVM.so.19.1"
    assert tried == ["libLLVM.so.19.1"]


def test_refusal_of_the_library_named_by_the_user_names_it(monkeypatch, tmp_path):
    refuse(monkeypatch)
    folder = libraries(tmp_path / "lib", "libLLVM.so.22.1", "libLLVM.so.19.1")
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(folder / "libLLVM.so.19.1"))
    with pytest.raises(BackendError, match=r"DRJIT_LIBLLVM_PATH names .*libLLVM.so.19.1 .*wrong"):
        backend.choose_backend("llvm")


# --- Choice -------------------------------------------------------------------------------


def test_newest_that_works_is_chosen(tmp_path, tried):
    folder = libraries(tmp_path / "lib", "libLLVM-18.so.1", "libLLVM.so.19.1")
    chosen = backend.choose_backend("llvm", [folder])
    assert (chosen.name, chosen.variant, chosen.libllvm_version) == (
        "llvm",
        "llvm_ad_rgb",
        "19.1.7",
    )
    assert tried == ["libLLVM.so.19.1"]


def test_next_is_tried_when_the_newest_is_refused(monkeypatch, tmp_path):
    folder = libraries(tmp_path / "lib", "libLLVM-18.so.1", "libLLVM.so.19.1")

    def answer(variant: str, variables: dict[str, str], needed: object) -> Verdict:
        name = Path(variables["DRJIT_LIBLLVM_PATH"]).name  # folders may have a 19 in theirs
        return Verdict(False, "bad") if "19" in name else GOOD

    monkeypatch.setattr(trial, "probe", answer)
    assert backend.choose_backend("llvm", [folder]).libllvm == folder / "libLLVM-18.so.1"


@pytest.mark.skipif(not X86, reason="these versions die on x86 only")
def test_versions_known_to_be_bad_are_never_run(tmp_path, tried):
    names = ("libLLVM-14.so.1", "libLLVM-15.so.1", "libLLVM-16.so.1")
    with pytest.raises(BackendError, match="LLVM 15 aborts the process"):
        backend.choose_backend("llvm", [libraries(tmp_path / "lib", *names)])
    assert tried == []


def test_refusal_is_one_line_with_every_reason_and_the_fix(monkeypatch, tmp_path):
    refuse(monkeypatch)
    folder = libraries(tmp_path / "lib", "libLLVM-14.so.1", "libLLVM.so.19.1")
    with pytest.raises(BackendError) as caught:
        backend.choose_backend("llvm", [folder])
    message = str(caught.value)
    assert "\n" not in message
    for part in ("libLLVM.so.19.1 (it computes", "libLLVM-14.so.1 (LLVM 14 is too old"):
        assert part in message
    assert "sudo apt-get install libllvm19 libatomic1" in message


def test_an_empty_search_is_reported(tmp_path):
    with pytest.raises(BackendError, match="found none; install one: pip install karellen"):
        backend.choose_backend("auto", [tmp_path])


def test_unknown_backend_is_a_usage_error():
    with pytest.raises(UsageError, match="'metal' is unknown: choose one of auto, cuda, llvm"):
        backend.choose_backend("metal")


def test_renderer_that_cannot_be_imported_is_not_blamed_on_llvm(monkeypatch, tmp_path):
    broken = Verdict(False, "libatomic.so.1: cannot open", stage="import", lasting=False)
    refuse(monkeypatch, llvm=broken)
    with pytest.raises(BackendError, match=r"Mitsuba cannot be imported: libatomic.so.1"):
        backend.choose_backend("llvm", [libraries(tmp_path / "lib", "libLLVM.so.19.1")])


# --- CUDA ---------------------------------------------------------------------------------


def test_no_cuda_is_tried_without_its_driver(tried):
    with pytest.raises(BackendError, match=r"no usable CUDA: the driver library libcuda.so.1 was"):
        backend.choose_backend("cuda")
    assert tried == []


def test_working_cuda_is_preferred(monkeypatch, tmp_path, tried):
    folder = libraries(tmp_path / "lib", "libcuda.so.1", "libLLVM.so.19.1")
    monkeypatch.setenv("LD_LIBRARY_PATH", str(folder))
    assert backend.choose_backend("auto", [folder]).variant == "cuda_ad_rgb"
    assert backend.choose_backend("llvm", [folder]).variant == "llvm_ad_rgb"
    assert tried == ["cuda_ad_rgb", "libLLVM.so.19.1"]


def test_broken_cuda_falls_back_to_llvm_unless_asked_for(monkeypatch, tmp_path):
    refuse(monkeypatch, llvm=GOOD)
    folder = libraries(tmp_path / "lib", "libcuda.so.1", "libLLVM.so.19.1")
    monkeypatch.setenv("DRJIT_LIBCUDA_PATH", str(folder / "libcuda.so.1"))
    assert backend.choose_backend("auto", [folder]).name == "llvm"
    with pytest.raises(BackendError, match="no usable CUDA: it computes wrong numbers"):
        backend.choose_backend("cuda", [folder])


# --- Probe --------------------------------------------------------------------------------


def probe_of(monkeypatch: pytest.MonkeyPatch, script: str, seconds: float = 20.0) -> Verdict:
    monkeypatch.setattr(trial, "PROBE", script)
    return trial.probe("llvm_ad_rgb", {}, (), seconds)


@pytest.mark.parametrize(
    ("script", "words", "lasting"),
    [
        ("import os; os.abort()", "SIGABRT", True),
        # Killed from outside or hung: another time it may do.
        ("import os, signal; os.kill(os.getpid(), signal.SIGKILL)", "SIGKILL", False),
        ("import time; time.sleep(600)", "hung", False),
        ("print('all is well')", "", False),
    ],
)
def test_child_without_an_answer_is_refused(monkeypatch, script, words, lasting):
    verdict = probe_of(monkeypatch, script, seconds=0.2 if words == "hung" else 20.0)
    assert (verdict.usable, verdict.lasting) == (False, lasting)
    assert words in verdict.reason


def test_noise_around_the_answer_does_no_harm(monkeypatch):
    answer = 'INIM-PROBE {"stage": "done", "reason": "", "version": "19", "device": "d"}'
    script = f"print('hello'); print({answer!r}); print('bye')"
    assert probe_of(monkeypatch, script) == Verdict(True, "", "19", "d", "done")


def test_cause_is_taken_from_the_log_when_the_exception_hides_it():
    answer = 'INIM-PROBE {"stage": "start", "reason": "could not be found!"}'
    log = 'jit_find_library(): Unable to load "x": file too short!\n'
    assert "file too short" in trial._read_answer(0, answer, log).reason


# --- Memory of verdicts -------------------------------------------------------------------


def test_another_library_or_processor_is_tried_again(monkeypatch, tmp_path, tried):
    folder = libraries(tmp_path / "lib", "libLLVM.so.19.1")
    backend.choose_backend("llvm", [folder])
    (folder / "libLLVM.so.19.1").write_bytes(b"upgraded")
    backend.choose_backend("llvm", [folder])
    assert len(tried) == 2
    monkeypatch.setattr(machine, "cpu_text", lambda *names: "another")
    backend.choose_backend("llvm", [folder])
    assert len(tried) == 3


def test_cuda_is_tried_again_when_its_cards_are_hidden(monkeypatch, tmp_path, tried):
    folder = libraries(tmp_path / "lib", "libcuda.so.1", "libLLVM.so.19.1")
    monkeypatch.setenv("LD_LIBRARY_PATH", str(folder))
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    for _ in range(2):
        assert backend.choose_backend("auto", [folder]).name == "cuda"
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "")
    refuse(monkeypatch, llvm=GOOD)
    assert backend.choose_backend("auto", [folder]).name == "llvm"
    assert tried == ["cuda_ad_rgb"]


def test_a_reinstalled_renderer_is_tried_again(monkeypatch, tmp_path, tried):
    folder = libraries(tmp_path / "lib", "libLLVM.so.19.1")
    monkeypatch.setattr(sys, "path", [str(tmp_path / "site"), *sys.path])
    metadata = libraries(tmp_path / "site/drjit-1.5.0.dist-info")
    backend.choose_backend("llvm", [folder])
    backend.choose_backend("llvm", [folder])
    assert len(tried) == 1
    metadata.rename(tmp_path / "site/drjit-1.5.1.dist-info")
    backend.choose_backend("llvm", [folder])
    assert len(tried) == 2


@pytest.mark.parametrize("content", ["", "{", "[]", "null", '{"a": 1}', "\0\xff", "42"])
def test_damaged_memory_is_ignored_and_replaced(tmp_path, tried, content):
    folder = libraries(tmp_path / "lib", "libLLVM.so.19.1")
    path = libraries(tmp_path / "cache/inim") / "backends.json"
    path.write_text(content, "latin-1")
    backend.choose_backend("llvm", [folder])
    assert backend.choose_backend("llvm", [folder]).name == "llvm"
    assert len(tried) == 1


@pytest.mark.parametrize("entry", [None, 7, [], {}, {"usable": "yes"}, {"usable": True, "odd": 1}])
def test_entry_of_another_shape_is_tried_again(tmp_path, tried, entry):
    folder = libraries(tmp_path / "lib", "libLLVM.so.19.1")
    backend.choose_backend("llvm", [folder])
    path = tmp_path / "cache/inim/backends.json"
    path.write_text(json.dumps(dict.fromkeys(json.loads(path.read_text()), entry)))
    backend.choose_backend("llvm", [folder])
    assert len(tried) == 2


def test_unwritable_cache_does_no_harm(monkeypatch, tmp_path, tried):
    monkeypatch.setenv("XDG_CACHE_HOME", "/dev/null")
    folder = libraries(tmp_path / "lib", "libLLVM.so.19.1")
    assert backend.choose_backend("llvm", [folder]).name == "llvm"


def test_missing_home_does_no_harm(monkeypatch, tmp_path, tried):
    def homeless() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr(Path, "home", homeless)
    folder = libraries(tmp_path / "lib", "libLLVM.so.19.1")
    assert backend.choose_backend("llvm", [folder]).name == "llvm"
    assert trial.cache_file() is None


def test_curable_refusal_is_not_remembered(monkeypatch, tmp_path):
    folder = libraries(tmp_path / "lib", "libLLVM.so.19.1")
    refuse(monkeypatch, llvm=Verdict(False, "libz3 is missing", stage="start", lasting=False))
    with pytest.raises(BackendError):
        backend.choose_backend("llvm", [folder])
    refuse(monkeypatch, llvm=GOOD)
    assert backend.choose_backend("llvm", [folder]).name == "llvm"


def test_memory_does_not_grow_without_end(tmp_path, tried):
    folder = libraries(tmp_path / "lib", "libLLVM.so.19.1")
    trial._write_cache({str(number): {} for number in range(5 * trial.REMEMBERED)})
    backend.choose_backend("llvm", [folder])
    (path,) = (tmp_path / "cache/inim").iterdir()
    assert len(json.loads(path.read_text())) == trial.REMEMBERED


# --- Use ----------------------------------------------------------------------------------


def chosen(library: Path | None) -> Backend:
    return Backend("llvm", "llvm_ad_rgb", library, "19.1.7", "a processor")


def test_activate_sets_this_process(monkeypatch, tmp_path):
    monkeypatch.delitem(sys.modules, "drjit", raising=False)
    backend.activate(chosen(tmp_path / "libLLVM.so.19.1"))
    assert os.environ["DRJIT_LIBLLVM_PATH"] == str(tmp_path / "libLLVM.so.19.1")


class Loaded:
    """Dr.Jit as it may be found loaded."""

    class JitBackend:
        CUDA, LLVM = "cuda", "llvm"

    def __init__(self, version: tuple[int, ...], *has: str) -> None:
        self.detail, self._has = SimpleNamespace(llvm_version=lambda: version), has

    def has_backend(self, name: str) -> bool:
        return name in self._has


def test_a_library_that_is_loaded_already_serves(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "drjit", Loaded((19, 1, 7), "llvm"))
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    backend.activate(chosen(tmp_path / "libLLVM.so.21.1"))
    assert "DRJIT_LIBLLVM_PATH" not in os.environ


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
        libraries((tmp_path / name).parent)
        (tmp_path / name).write_text(text)
    paths = machine._limit_files(tmp_path / "membership", tmp_path)
    assert [number for number in map(machine._number_in, paths) if number] == limits


def test_memory_limit_is_never_above_what_the_machine_has(monkeypatch, tmp_path):
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    assert 0 < machine.memory_limit_bytes() <= total
    (tmp_path / "limit").write_text("123456789")
    monkeypatch.setattr(machine, "_limit_files", lambda path: [tmp_path / "limit"])
    assert machine.memory_limit_bytes() == 123456789


def test_description_is_json_and_gives_each_library_its_reason(monkeypatch, tmp_path, tried):
    folder = libraries(tmp_path / "lib", "libLLVM-14.so.1", "libLLVM.so.19.1")
    monkeypatch.setenv("INIM_LLVM_SEARCH", str(folder))
    facts = json.loads(json.dumps(describe()))
    assert [library["usable"] for library in facts["libllvm"]] == [True, False]
    assert facts["libllvm"][1]["reason"] == "LLVM 14 is too old for Dr.Jit"
    assert facts["chosen"]["libllvm"] == str(folder / "libLLVM.so.19.1")
    assert facts["memory_bytes"] == machine.memory_limit_bytes()


def test_text_form_works_with_and_without_a_backend(monkeypatch, tmp_path, tried):
    monkeypatch.setenv("INIM_LLVM_SEARCH", str(tmp_path / "nothing"))
    assert "no usable libLLVM: found none" in sys_info()
    folder = libraries(tmp_path / "lib", "libLLVM-14.so.1", "libLLVM.so.19.1")
    monkeypatch.setenv("INIM_LLVM_SEARCH", str(folder))
    text = sys_info()
    assert "libLLVM.so.19.1  usable" in text
    assert "libLLVM-14.so.1  refused: LLVM 14 is too old" in text
