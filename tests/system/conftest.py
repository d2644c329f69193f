"""A scene that validates in seconds, and functions that run commands.

A command with a worker takes four times as long in separate processes. Therefore tests run commands
in the test process (`run_here`, `run_inim`). Tests of processes use `run_process`: signals,
crashes, exit codes, damaged input for native code, and environments.
"""

import io
import json
import os
import re
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from importlib import import_module, invalidate_caches
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import pytest

from inim.cli.main import main
from inim.image.files.image import read_exr_channels
from inim.pipeline import timing
from inim.report import sections
from inim.system.process import atomic_file
from inim.system.worker import supervisor
from inim.system.worker.serve import answer
from tests.conftest import scene_text, sphere, square
from tests.schemas import read_document

ALONE = {"algorithms": "template", "viewpoints": "centre"}
#: Settings of the smallest run that writes all kinds of files.
SMALLEST = ALONE | {"pixel_pitch_mm": "0.125", "view_pixels_per_lens": "2"}
SMALLEST |= {"capture_pixels_per_pitch": "4", "lens_model": "pinhole"}
TINY = {
    "inim.lens_columns": "8", "inim.lens_rows": "6", "inim.capture_spp": "2", "inim.eia_spp": "2",
    "inim.view_spp": "2", "inim.reconstruction_spp": "4",
}  # fmt: skip
SHAPES = (
    sphere((0, 0, 1), 1.2),
    square((-1, 1, 0), 1.5, "0.9,0.1,0.1"),
    square((1, -1, 2), 0.7, "0.1,0.9,0.1"),
)


def definitions(settings: Mapping[str, str | None]) -> list[str]:
    """Command-line options of settings; None: not given."""
    stated = {key: value for key, value in settings.items() if value is not None}
    return [word for key, value in stated.items() for word in ("-D", f"{key}={value}")]


def command(*words: str | Path, **settings: str | None) -> list[str]:
    """Command line of `python -m inim.validate` with the tiny display and changed settings."""
    tiny = definitions(TINY | {f"inim.{key}": value for key, value in settings.items()})
    return [sys.executable, "-m", "inim.validate", *map(str, words), *tiny]


@dataclass(frozen=True)
class Ended:
    """Exit code and output of a command."""

    code: int
    stdout: str
    stderr: str


def run_child(words: Sequence[str | Path], timeout: float = 300, **options: Any) -> Ended:
    """Run a command in a process of its own, without input; `options` are those of `subprocess`."""
    ended = subprocess.run(
        words, stdin=subprocess.DEVNULL, capture_output=True, encoding="utf-8", errors="replace",
        timeout=timeout, check=False, **options,
    )  # fmt: skip
    return Ended(ended.returncode, ended.stdout, ended.stderr)


@contextmanager
def without_pauses() -> Iterator[None]:
    """Take times without the pauses that make them comparable."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("_SETTLE_S", "_LEAD_IN_S"):
            patch.setattr(timing, name, 0.0)
        yield


def assert_one_line(text: str, words: Sequence[str]) -> None:
    """Assert that a text is one error line of the program and contains these words."""
    assert "Traceback" not in text
    assert text.startswith("inim: error: ")
    assert text.count("\n") == 1, text
    assert text.endswith("\n")
    for word in words:
        assert word in text


def nothing_left(folder: Path) -> bool:
    """True if there are no partially written folders and files."""
    return not [p for p in folder.rglob("*") if ".partial" in p.name]


def files_in(folder: Path) -> set[str]:
    """Names of all files, without the lists of written files."""
    names = (str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file())
    return {name for name in names if not re.fullmatch(r"\.\w+-files\.json", name)}


def assert_whole(out: Path) -> dict:
    """Assert that all files in the report's list exist and are readable; return the report."""
    from PIL import Image

    data = read_document(out / "report.json")
    for name in data["files"]:
        path = out / name
        assert path.stat().st_size > 0, name
        if path.suffix == ".exr":
            read_exr_channels(path)
        elif path.suffix == ".png":
            Image.open(path).load()
    assert (out / "report.html").read_text("utf-8").rstrip().endswith("</html>")
    ElementTree.parse(out / "junit.xml")
    return data


_ONE_AT_A_TIME = threading.Lock()


@contextmanager
def _worker_here(target: str, *_: object) -> Iterator[tuple[Any, io.StringIO]]:
    process = SimpleNamespace(
        returncode=0, target=target, stdin=io.BytesIO(), terminate=int, wait=lambda *_: 0
    )
    yield process, io.StringIO()


def _carry_out_here(process: Any, _: object, job: Any, *__: object) -> dict[str, Any]:
    """Execute a worker's job in this process and return its last message."""
    messages = io.StringIO()
    module, _, function = process.target.partition(":")
    with _ONE_AT_A_TIME, pytest.MonkeyPatch.context() as patch:
        patch.setattr(atomic_file, "_unpublished", None)  # files of a worker process are its own
        answer(job, messages, getattr(import_module(module), function))
    return dict(json.loads(messages.getvalue().splitlines()[-1]))


def install_metadata(folder: Path, name: str, entry_points: str) -> None:
    """Write a package's metadata as pip does, without the network."""
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(entry_points)


@contextmanager
def worker_here() -> Iterator[None]:
    """Execute the workers' jobs of commands and of `inim.validate` in this process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(supervisor, "_worker", _worker_here)
        patch.setattr(supervisor, "_carry_out", _carry_out_here)
        yield


@contextmanager
def without_page() -> Iterator[None]:
    """Give reports an empty page: drawing it takes as long as the rest of a tiny run."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sections, "_page", lambda *_: "<html></html>")
        yield


@pytest.fixture(scope="module")
def no_page() -> Iterator[None]:
    """No page for all runs of a module in this process."""
    with without_page():
        yield


@contextmanager
def _packages(folders: Sequence[str]) -> Iterator[None]:
    """Make the packages of these folders importable; unload them afterwards."""
    path = list(sys.path)
    sys.path[:0] = [folder for folder in folders if folder not in path]
    invalidate_caches()
    try:
        yield
    finally:
        new = [folder for folder in folders if folder not in path]
        sys.path[:] = path
        for name, module in list(sys.modules.items()):
            if (getattr(module, "__file__", None) or "").startswith(tuple(new) or ("\0",)):
                del sys.modules[name]


def run_here(
    *words: str | Path, folder: Path, variables: Mapping[str, str | None] | None = None
) -> Ended:
    """Run `inim WORDS` in this process, in a folder and with changed environment variables."""
    out, err = io.StringIO(), io.StringIO()
    before = Path.cwd()
    changed = dict(variables or {})
    paths = (changed.pop("PYTHONPATH", None) or "").split(os.pathsep)
    os.chdir(folder)
    try:
        with (
            pytest.MonkeyPatch.context() as patch,
            worker_here(),
            _packages([path for path in paths if path]),
            redirect_stdout(out),
            redirect_stderr(err),
        ):
            for name, value in changed.items():
                if value is None:
                    patch.delenv(name, raising=False)
                else:
                    patch.setenv(name, value)
            try:
                code = main([str(word) for word in words])
            except SystemExit as end:  # argparse
                code = int(end.code or 0)
    finally:
        os.chdir(before)
    return Ended(code, out.getvalue(), err.getvalue())


def assert_refused(*words: str | Path, folder: Path, says: Sequence[str], code: int = 2) -> None:
    """Assert that `inim WORDS` fails with one line and this code and changes no file."""
    before = sorted(folder.rglob("*"))
    ended = run_here(*words, folder=folder)
    assert (ended.code, ended.stdout) == (code, ""), ended
    assert_one_line(ended.stderr, says)
    assert sorted(folder.rglob("*")) == before


@pytest.fixture(scope="session")
def run_inim():
    """Validate in this process; keyword arguments are tiny settings to override."""

    def run(
        *words: str | Path,
        folder: Path,
        variables: Mapping[str, str | None] | None = None,
        **settings: str,
    ) -> Ended:
        whole = command(*words, **settings)[3:]
        return run_here("validate", *whole, folder=folder, variables=variables)

    return run


@pytest.fixture(scope="session")
def run_process():
    """Validate in separate processes, as from a shell; otherwise like `run_inim`."""

    def run(
        *words: str | Path,
        folder: Path,
        variables: Mapping[str, str | None] | None = None,
        prefix: Sequence[str] = (),
        **settings: str,
    ) -> Ended:
        changed = {**os.environ, **(variables or {})}
        env = {key: value for key, value in changed.items() if value is not None}
        return run_child([*prefix, *command(*words, **settings)], 120, cwd=folder, env=env)

    return run


@pytest.fixture
def tiny_scene(tmp_path):
    """Scene file with a sphere and two squares, in a new folder."""
    return write_scene(tmp_path)


def write_scene(folder: Path, *shapes: str, name: str = "tiny.xml", text: str = "") -> Path:
    """Write a lit scene with these shapes, by default `SHAPES`."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / name
    path.write_text(text or scene_text(*(shapes or SHAPES)), encoding="utf-8")
    return path


@contextmanager
def small_disk(folder: Path, size: str, *, read_only: bool = False) -> Iterator[Path]:
    """Mount a small file system; skip the test without the permission to mount."""
    if os.geteuid() != 0:
        pytest.skip("only root can mount a small disk")
    folder.mkdir()
    options = f"size={size}" + (",ro" if read_only else "")
    mount = subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", folder], check=False)
    if mount.returncode != 0:
        pytest.skip("mounting is not allowed here")
    try:
        yield folder
    finally:
        subprocess.run(["umount", folder], check=True)
