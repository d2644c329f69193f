"""Nothing that a file can hold brings the program down.

Expected: each of the mutated files is read or refused in one clear line (exit code 2), within 10 s
and 1 GiB, in a process that lives on. The fast run tries fifty of each format, the slow one
2,000; `tests/fuzz/batch.py` says by which doors.
"""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from tests.fuzz.batch import MOST_BYTES, MOST_SECONDS
from tests.fuzz.specimens import SPECIMENS

FEW, MANY = 50, 2000
MOST_FINDINGS = 20


@dataclass
class Answers:
    """What became of a run of mutations."""

    sound: list[str] = field(default_factory=list)
    read: int = 0
    refused: int = 0
    slowest_seconds: float = 0.0
    most_bytes: int = 0
    findings: list[str] = field(default_factory=list)


def read_mutations(kind: str, first: int, end: int) -> Answers:
    """Mutations `first` to `end` in children; one that dies is followed by another."""
    answers = Answers()
    while first < end and len(answers.findings) < MOST_FINDINGS:
        read_end, write_end = os.pipe()
        words = [sys.executable, "-m", "tests.fuzz.batch", kind, str(first), str(end)]
        with subprocess.Popen(
            [*words, str(write_end)],
            cwd=Path(__file__).parents[2],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            pass_fds=(write_end,),
            text=True,
            errors="replace",
        ) as child:
            os.close(write_end)
            with os.fdopen(read_end, encoding="utf-8", errors="replace") as lines:
                last = _take(kind, lines, answers)
            said = child.stderr.read() if child.stderr else ""
        if child.returncode == 0:
            break
        answers.findings.append(f"{kind}-{last}: died, {child.returncode}: {said[-300:]}")
        first = end if last is None else last + 1
    return answers


def _take(kind: str, lines: object, answers: Answers) -> int | None:
    """Add the answers up; the number of the last file begun."""
    last = None
    for line in lines:  # type: ignore[attr-defined]
        word, *rest = line.split(" ", 1)
        if word == "sound":
            answers.sound.append(rest[0].strip())
        elif word == "begin":
            last = int(rest[0])
        else:
            _, seconds, grown, said = rest[0].split(" ", 3)
            answers.slowest_seconds = max(answers.slowest_seconds, float(seconds))
            answers.most_bytes = max(answers.most_bytes, int(grown))
            answers.read += said.startswith("read")
            answers.refused += said.startswith("refused")
            if said.startswith("WRONG"):
                answers.findings.append(f"{kind}-{last}: {said.strip()}")
    return last


def check(kind: str, answers: Answers, count: int) -> None:
    assert answers.sound, answers.findings
    assert set(answers.sound) == {"read"}, "the specimen itself must be read by every door"
    assert answers.findings == []
    assert answers.read + answers.refused == count * len(answers.sound)
    assert answers.refused > count // 10, "mutations that harm nothing test nothing"
    assert answers.slowest_seconds < MOST_SECONDS
    assert answers.most_bytes < MOST_BYTES


@pytest.mark.parametrize("kind", SPECIMENS)
def test_mutated_files_are_read_or_refused(kind: str) -> None:
    check(kind, read_mutations(kind, 0, FEW), FEW)


@pytest.mark.slow
@pytest.mark.parametrize("kind", SPECIMENS)
def test_thousands_of_mutated_files_are_read_or_refused(kind: str) -> None:
    check(kind, read_mutations(kind, 0, MANY), MANY)
