"""Runner for the commands and the code on the documentation's pages.

The blocks of a page run in their order, in a new copy of the project: `sh` blocks in one shell in
its root, `python` blocks in one Python process. A block below the line `<!-- file: PATH -->` is
written to PATH. A block below `<!-- not run: REASON -->` is skipped. Samples that scores decide are
a quarter of the usual ones in the copy, because a page is tested for its commands, not its scores.

`python -m tests.documents [PAGE ...]` runs pages and prints the time of each block.
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
    "__pycache__", "build", "out", ".venv", ".git", ".*_cache", ".hypothesis", "*.nb[ic]",
)  # fmt: skip


@dataclass(frozen=True)
class Block:
    """A fenced block of a page.

    Attributes
    ----------
    page : str
        Path relative to the project.
    line : int
        Number of the first line of text.
    language, text : str
    file : str or None
        File to which the block is written.
    not_run : str or None
        Reason why the block is skipped.
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
    """Paths of README, CONTRIBUTING and the site's pages, without generated ones."""
    generated = {"generated", "images", "out"}
    paths = [p.relative_to(ROOT) for p in sorted((ROOT / "docs").rglob("*.md"))]
    hand_written = [str(p) for p in paths if not generated & set(p.parts)]
    return ["README.md", "CONTRIBUTING.md", *hand_written]


def blocks(page: str) -> list[Block]:
    """Fenced blocks of a page, in their order."""
    text = (ROOT / page).read_text("utf-8")
    page_blocks = []
    for match in _BLOCK.finditer(text):
        indent, mark = len(match["indent"]), match["mark"]
        page_blocks.append(
            Block(
                page,
                text.count("\n", 0, match.start("text")) + 1,
                match["language"],
                "".join(line[indent:] or "\n" for line in match["text"].splitlines(True)),
                file=match["value"] if mark == "file" else None,
                not_run=match["value"] if mark == "not run" else None,
            )
        )
    return page_blocks


def commands(block: Block) -> list[str]:
    """Commands of a shell block, one per line, with variables replaced and without comments."""
    joined = block.text.replace("\\\n", " ")
    for name, value in _VARIABLE.findall(joined):
        joined = joined.replace(f"${name}", " ".join(value.split()))
    joined = _VARIABLE.sub("", joined)
    lines = (re.sub(r"\s+#.*", "", line).strip() for line in joined.splitlines())
    return [line for line in lines if line and not line.startswith("#")]


class _Child:
    """A process that executes pieces of code from its input."""

    def __init__(self, words: list[str], folder: Path, environment: dict[str, str]) -> None:
        self._process = subprocess.Popen(
            words, cwd=folder, env=environment, text=True, stdin=subprocess.PIPE,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        )  # fmt: skip

    def run(self, code: str, mark: str) -> str:
        """Execute `code`, which prints `mark` last; return its output before the mark."""
        assert self._process.stdin and self._process.stdout
        self._process.stdin.write(code)
        self._process.stdin.flush()
        lines = []
        for line in self._process.stdout:
            if line.rstrip("\n") == mark:
                return "".join(lines)
            lines.append(line)
        raise AssertionError("".join(lines)[-3000:] or f"ended with {self._process.wait()}")

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
    """Simulated reader, who executes the blocks of a page in a copy of the project.

    Parameters
    ----------
    folder : Path
        Folder for the copy.
    cache : Path
        Folder of the result cache: pages that validate the same scene render it once.
    """

    def __init__(self, folder: Path, cache: Path) -> None:
        self.project = folder / "inim"
        shutil.copytree(ROOT, self.project, ignore=shutil.ignore_patterns(*_NOT_COPIED))
        self._use_few_samples()
        (self.project / ".venv").symlink_to(sys.prefix)
        tools = Path(sys.executable).parent
        environment = os.environ | {
            "PATH": f"{tools}{os.pathsep}{os.environ['PATH']}",
            "INIM_CACHE": str(cache),
            "MPLBACKEND": "agg",
            "PYTHONUNBUFFERED": "1",
            # Packages are installed into the folder, without the network.
            "PIP_TARGET": str(folder / "site"),
            "PIP_NO_DEPS": "1",
            "PIP_UPGRADE": "1",  # a changed package replaces its files
            "PIP_NO_BUILD_ISOLATION": "0",  # pip's spelling of: no isolation
            "PYTHONPATH": f"{self.project}{os.pathsep}{folder / 'site'}",
        }
        self._environment = environment
        self._shell = _Child(["bash", "-e", "-o", "pipefail"], self.project, environment)
        self._python: _Child | None = None

    def _use_few_samples(self) -> None:
        """Let the copy's first round of samples be its last one, of a quarter of the samples."""
        changes = {
            "pipeline/adaptive_sampling.py": (r"^MOST = .+$", "MOST = 1"),
            "display/layouts/layout.py": (
                r'"capture_spp": 64, "eia_spp": 32, "view_spp": 64',
                '"capture_spp": 16, "eia_spp": 8, "view_spp": 16',
            ),
        }
        for name, (pattern, replacement) in changes.items():
            path = self.project / "inim" / name
            text, count = re.subn(pattern, replacement, path.read_text("utf-8"), flags=re.M)
            assert count == 1, f"{path}: the number of samples has another form"
            path.write_text(text, "utf-8")

    def follow(self, block: Block) -> str:
        """Write or run a block; return its output, or raise AssertionError if it fails."""
        if block.not_run:
            return ""
        if block.file:
            path = self.project / block.file
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(block.text, "utf-8")
            return ""
        if block.language == "sh":
            script = self.project.parent / "block.sh"  # a command may consume the whole input
            script.write_text(block.text, "utf-8")
            return self._shell.run(f". '{script}' </dev/null\necho '{_MARK}'\n", _MARK)
        if block.language == "python":
            if self._python is None:
                words = [sys.executable, "-c", _READ_AND_EXECUTE]
                self._python = _Child(words, self.project, self._environment)
            return self._python.run(f"{(str(block), block.text, _MARK)!r}\n", _MARK)
        return ""

    def end(self) -> None:
        """End the shell and the Python process."""
        for child in filter(None, (self._shell, self._python)):
            child.end()


def run_page(page: str, folder: Path, cache: Path) -> Iterator[tuple[Block, str, float]]:
    """Run a page; yield each executed block with its output and its time in seconds."""
    reader = Reader(folder, cache)
    try:
        for block in blocks(page):
            started = time.monotonic()
            try:
                output = reader.follow(block)
            except AssertionError as error:
                raise AssertionError(f"{block}:\n{block.text}\n{error}") from None
            if block.language in _RUN and not (block.file or block.not_run):
                yield block, output, time.monotonic() - started
    finally:
        reader.end()


def check_syntax(block: Block) -> None:
    """Compile a Python block."""
    ast.parse(block.text, str(block))


def _main(chosen: list[str]) -> int:
    failed = 0
    with tempfile.TemporaryDirectory() as cache:
        for page in chosen or pages():
            with tempfile.TemporaryDirectory() as folder:
                try:
                    for block, output, seconds in run_page(page, Path(folder), Path(cache)):
                        print(f"{seconds:6.1f} s  {block}", flush=True)
                        if chosen:
                            print(output, end="")
                except AssertionError as error:
                    failed += 1
                    print(f"FAILED    {error}", flush=True)
    return failed


if __name__ == "__main__":
    sys.exit(_main(sys.argv[1:]))
