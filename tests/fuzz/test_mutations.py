"""No file content crashes the program.

Expected: each of the mutated files is read or refused in one clear line (exit code 2), within 10 s
and 1 GiB, in a process that lives on. The fast run tries 8 of each format, the slow one
2,000; `tests/fuzz/batch.py` says by which doors. Reports, studies, scenes and baselines are also
changed by their structure (`tests/fuzz/documents.py`) and read by whole commands: 400 of each kind
in the slow run.
"""

import os
import subprocess
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from tests.fuzz.batch import MOST_BYTES, MOST_SECONDS
from tests.fuzz.specimens import SPECIMENS

FEW, MANY, MANY_DOCUMENTS = 8, 2000, 400
MOST_FINDINGS = 20


@dataclass
class Answers:
    """Outcome of a run of mutations."""

    sound: list[str] = field(default_factory=list)
    read_files: int = 0
    refused: int = 0
    slowest_seconds: float = 0.0
    most_bytes: int = 0
    findings: list[str] = field(default_factory=list)


def read_mutations(kinds: Sequence[str], count: int) -> dict[str, Answers]:
    """So many mutations of each format, in one child; one that dies is followed by another."""
    answers = {kind: Answers() for kind in kinds}
    left, first = list(kinds), 0
    while left:
        read_end, write_end = os.pipe()
        words = [sys.executable, "-m", "tests.fuzz.batch", ",".join(left), str(first), str(count)]
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
                kind, last = _take(lines, answers, left[0])
            errors = child.stderr.read() if child.stderr else ""
        if child.returncode == 0:
            break
        findings = answers[kind].findings
        findings.append(f"{kind}-{last}: died, {child.returncode}: {errors[-300:]}")
        left, first = left[left.index(kind) :], count if last is None else last + 1
        if first >= count or len(findings) >= MOST_FINDINGS:
            left, first = left[1:], 0
    return answers


def _take(lines: Iterable[str], every: dict[str, Answers], kind: str) -> tuple[str, int | None]:
    """Add the answers up; the format and the number of the last file begun."""
    last, answers = None, every[kind]
    for line in lines:
        word, *rest = line.split(" ", 1)
        if word == "format":
            kind, last = rest[0].strip(), None
            answers = every[kind]
        elif word == "sound":
            answers.sound.append(rest[0].strip())
        elif word == "begin":
            last = int(rest[0])
        else:
            _, seconds, grown, answer = rest[0].split(" ", 3)
            answers.slowest_seconds = max(answers.slowest_seconds, float(seconds))
            answers.most_bytes = max(answers.most_bytes, int(grown))
            answers.read_files += answer.startswith("read")
            answers.refused += answer.startswith("refused")
            if answer.startswith("WRONG"):
                answers.findings.append(f"{kind}-{last}: {answer.strip()}")
    return kind, last


def check(answers: Answers, count: int) -> None:
    assert answers.sound, answers.findings
    assert set(answers.sound) == {"read"}, "the specimen itself must be read by every door"
    assert answers.findings == []
    assert answers.read_files + answers.refused == count * len(answers.sound)
    assert answers.refused > count // 10, "mutations that harm nothing test nothing"
    assert answers.slowest_seconds < MOST_SECONDS
    assert answers.most_bytes < MOST_BYTES


def test_mutated_files_are_read_or_refused():
    """The fast run: one child, and so one test, for all formats."""
    for kind, answers in read_mutations(list(SPECIMENS), FEW).items():
        print(kind, answers)
        check(answers, FEW)


@pytest.mark.slow
@pytest.mark.parametrize("kind", SPECIMENS)
def test_thousands_of_mutated_files_are_read_or_refused(kind):
    count = MANY_DOCUMENTS if kind.startswith("document") else MANY
    check(read_mutations([kind], count)[kind], count)
