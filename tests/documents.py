"""The documents: their pages, and the commands and code on them, run as a reader would.

On a page, in the order printed: `sh` blocks run in one shell in the root of a fresh copy of the
project, `python` blocks in one Python process. A block below the line `<!-- file: PATH -->` is
written to PATH; one below `<!-- not run: REASON -->` is left out.

`python -m tests.documents [PAGE ...]` runs pages and says what each block took.
"""

import ast
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
_BLOCK = re.compile(
    r"(?:^<!-- (?P<mark>file|not run): (?P<value>.+?) -->\n+)?"
    r"^(?P<indent> *)```(?P<language>\S+)\n(?P<text>.*?)^(?P=indent)```$",
    re.M | re.S,
)
_VARIABLE = re.compile(r'^([A-Z]+)="([^"]*)"$', re.M)
_RUN = ("sh", "python")
_NOT_COPIED = (
    "__pycache__",
    "build",
    "out",
    ".venv",
    ".git",
    ".*_cache",
    ".hypothesis",
    "*.nb[ic]",
)


@dataclass(frozen=True)
class Block:
    """A fenced block of a page.

    Attributes
    ----------
    page : str
        Relative to the project.
    line : int
        Of its first line of text.
    language, text : str
    file : str or None
        Where a reader saves it.
    not_run : str or None
        Why it cannot be run here.
    """

    page: str
    line: int
    language: str
    text: str
    file: str | None = None
    not_run: str | None = None

    def __str__(self) -> str:
        return f"{self.page}:{self.line}"


def pages() -> list[str]:
    """README first, then the site's own pages."""
    made = {"generated", "images"}
    found = [p.relative_to(ROOT) for p in sorted((ROOT / "docs").rglob("*.md"))]
    return ["README.md", "CONTRIBUTING.md"] + [str(p) for p in found if not made & set(p.parts)]


def blocks(page: str) -> list[Block]:
    """The fenced blocks of a page, in the order printed."""
    text = (ROOT / page).read_text("utf-8")
    found = []
    for match in _BLOCK.finditer(text):
        indent, mark = len(match["indent"]), match["mark"]
        found.append(
            Block(
                page,
                text.count("\n", 0, match.start("text")) + 1,
                match["language"],
                "".join(line[indent:] or "\n" for line in match["text"].splitlines(True)),
                file=match["value"] if mark == "file" else None,
                not_run=match["value"] if mark == "not run" else None,
            )
        )
    return found


def commands(block: Block) -> list[str]:
    """The commands of a shell block, each on one line, its variables in it, without comments."""
    joined = block.text.replace("\\\n", " ")
    for name, value in _VARIABLE.findall(joined):
        joined = joined.replace(f"${name}", " ".join(value.split()))
    joined = _VARIABLE.sub("", joined)
    lines = (re.sub(r"\s+#.*", "", line).strip() for line in joined.splitlines())
    return [line for line in lines if line and not line.startswith("#")]


class _Child:
    """A process that reads pieces of code and says after each how it went."""

    def __init__(self, words: list[str], folder: Path, environment: dict[str, str]) -> None:
        self._process = subprocess.Popen(
            words, cwd=folder, env=environment, text=True, stdin=subprocess.PIPE,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        )  # fmt: skip

    def run(self, code: str, mark: str) -> str:
        """Carry `code` out, which prints `mark` last; returns what it printed before."""
        assert self._process.stdin and self._process.stdout
        self._process.stdin.write(code)
        self._process.stdin.flush()
        said = []
        for line in self._process.stdout:
            if line.rstrip("\n") == mark:
                return "".join(said)
            said.append(line)
        raise AssertionError("".join(said)[-3000:] or f"ended with {self._process.wait()}")

    def end(self) -> None:
        assert self._process.stdin
        self._process.stdin.close()
        self._process.wait()


_READ_AND_EXECUTE = """
import ast, sys
import __main__
for line in sys.stdin:
    where, code, mark = ast.literal_eval(line)
    exec(compile(code, where, "exec"), __main__.__dict__)
    print(mark, flush=True)
"""
_MARK = "--- block done ---"


class Reader:
    """Somebody who does all that a page says, in a copy of the project.

    Parameters
    ----------
    folder : Path
        Holds the copy, and the home folder that commands find.
    """

    def __init__(self, folder: Path) -> None:
        self.project = folder / "inim"
        shutil.copytree(ROOT, self.project, ignore=shutil.ignore_patterns(*_NOT_COPIED))
        (self.project / ".venv").symlink_to(sys.prefix)
        tools = Path(sys.executable).parent
        environment = os.environ | {
            "PATH": f"{tools}{os.pathsep}{os.environ['PATH']}",
            "INIM_CACHE": str(folder / "cache"),
            "MPLBACKEND": "agg",
            "PYTHONUNBUFFERED": "1",
            # What a page installs stays in its folder, and comes without the network.
            "PIP_TARGET": str(folder / "site"),
            "PIP_NO_DEPS": "1",
            "PIP_NO_BUILD_ISOLATION": "0",  # as pip reads it: no isolation
            "PYTHONPATH": f"{self.project}{os.pathsep}{folder / 'site'}",
        }
        self._environment = environment
        self._shell = _Child(["bash", "-e", "-o", "pipefail"], self.project, environment)
        self._python: _Child | None = None

    def follow(self, block: Block) -> str:
        """Save or run a block; returns what it printed, and fails as it failed."""
        if block.not_run:
            return ""
        if block.file:
            path = self.project / block.file
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(block.text, "utf-8")
            return ""
        if block.language == "sh":
            script = self.project.parent / "block.sh"  # commands may read their input to its end
            script.write_text(block.text, "utf-8")
            return self._shell.run(f". '{script}' </dev/null\necho '{_MARK}'\n", _MARK)
        if block.language == "python":
            if self._python is None:
                words = [sys.executable, "-c", _READ_AND_EXECUTE]
                self._python = _Child(words, self.project, self._environment)
            return self._python.run(f"{(str(block), block.text, _MARK)!r}\n", _MARK)
        return ""

    def end(self) -> None:
        """Let the shell and Python end."""
        for child in filter(None, (self._shell, self._python)):
            child.end()


def run_page(page: str, folder: Path) -> Iterator[tuple[Block, str, float]]:
    """Follow a page: each block that was run, what it printed and the seconds it took."""
    reader = Reader(folder)
    try:
        for block in blocks(page):
            begun = time.monotonic()
            try:
                said = reader.follow(block)
            except AssertionError as error:
                raise AssertionError(f"{block}:\n{block.text}\n{error}") from None
            if block.language in _RUN and not (block.file or block.not_run):
                yield block, said, time.monotonic() - begun
    finally:
        reader.end()


def check_syntax(block: Block) -> None:
    """Python that compiles."""
    ast.parse(block.text, str(block))


def _main(chosen: list[str]) -> int:
    failed = 0
    for page in chosen or pages():
        with tempfile.TemporaryDirectory() as folder:
            try:
                for block, said, seconds in run_page(page, Path(folder)):
                    print(f"{seconds:6.1f} s  {block}", flush=True)
                    if chosen:
                        print(said, end="")
            except AssertionError as error:
                failed += 1
                print(f"FAILED    {error}", flush=True)
    return failed


if __name__ == "__main__":
    sys.exit(_main(sys.argv[1:]))
