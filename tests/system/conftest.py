"""A scene small enough to validate in seconds, and the command run as a user runs it."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.conftest import scene_text, sphere, square

TINY = {
    "inim.lens_columns": "8",
    "inim.lens_rows": "6",
    "inim.capture_spp": "2",
    "inim.eia_spp": "2",
    "inim.view_spp": "2",
    "inim.reconstruction_spp": "4",
}
SHAPES = (
    sphere((0, 0, 1), 1.2),
    square((-1, 1, 0), 1.5, "0.9,0.1,0.1"),
    square((1, -1, 2), 0.7, "0.1,0.9,0.1"),
)


def definitions(settings: Mapping[str, str]) -> list[str]:
    """Settings as the command line's words."""
    return [word for key, value in settings.items() for word in ("-D", f"{key}={value}")]


def command(*words: str | Path, **settings: str) -> list[str]:
    """`python -m inim.validate` with the tiny display, whose settings can be overridden."""
    tiny = definitions(TINY | {f"inim.{key}": value for key, value in settings.items()})
    return [sys.executable, "-m", "inim.validate", *map(str, words), *tiny]


@dataclass(frozen=True)
class Ended:
    """How a command ended."""

    code: int
    stdout: str
    stderr: str


def assert_one_line(text: str, words: Sequence[str]) -> None:
    """One line, from the program itself, with these words in it."""
    assert "Traceback" not in text
    assert text.startswith("inim: error: ")
    assert text.count("\n") == 1, text
    assert text.endswith("\n")
    for word in words:
        assert word in text


def nothing_left(folder: Path) -> bool:
    """Whether no half-written folder or file is left."""
    return not [p for p in folder.rglob("*") if p.name.endswith((".partial", ".tmp"))]


@pytest.fixture(scope="session")
def run_inim() -> Callable[..., Ended]:
    """Run the command to its end in a folder; keyword arguments are tiny settings to override."""

    def run(
        *words: str | Path,
        folder: Path,
        variables: Mapping[str, str | None] | None = None,
        prefix: Sequence[str] = (),
        **settings: str,
    ) -> Ended:
        changed = {**os.environ, **(variables or {})}
        ended = subprocess.run(
            [*prefix, *command(*words, **settings)],
            cwd=folder,
            env={key: value for key, value in changed.items() if value is not None},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            timeout=120,
        )
        return Ended(ended.returncode, ended.stdout, ended.stderr)

    return run


@pytest.fixture
def tiny_scene(tmp_path: Path) -> Path:
    """A sphere and two squares in a folder of their own."""
    return write_scene(tmp_path)


def write_scene(folder: Path, *shapes: str, name: str = "tiny.xml", text: str = "") -> Path:
    """Write a lit scene of these shapes, or of the usual three."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / name
    path.write_text(text or scene_text(*(shapes or SHAPES)), encoding="utf-8")
    return path


@contextmanager
def small_disk(folder: Path, size: str, *, read_only: bool = False) -> Iterator[Path]:
    """A file system of its own; skips the test where this user may not mount one."""
    if os.geteuid() != 0:
        pytest.skip("only root can mount a small disk")
    folder.mkdir()
    options = f"size={size}" + (",ro" if read_only else "")
    done = subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", folder], check=False)
    if done.returncode != 0:
        pytest.skip("mounting is not allowed here")
    try:
        yield folder
    finally:
        subprocess.run(["umount", folder], check=True)
