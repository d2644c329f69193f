"""Submissions: one picture for each case, and `submission.json`; what is wrong with the files."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from inim.apps.benchmark.definition import TIERS
from inim.apps.benchmark.document import SubmissionDocument
from inim.apps.benchmark.make import file_digest
from inim.apps.benchmark.protocol import PROTOCOL, TRACKS
from inim.apps.benchmark.suite import MadeCase
from inim.generators import algorithm_names
from inim.system.document import read_document, write_document
from inim.system.errors import FileError, UsageError, suggest_words

DESCRIPTION = "submission.json"
#: Authors of entries of this program, and its entries that are no algorithms.
OWN_AUTHORS, RESERVED = ["inim"], ("copy", "optimal", "optimal-blind", "traced", "reference")
_SUFFIXES = (".png", ".exr")


def read_submission(folder: Path) -> SubmissionDocument:
    """Read the description of a submission; raises `FileError` if it is missing or damaged."""
    if not folder.is_dir():
        raise FileError(f"{folder}: no such folder; name one with pictures and {DESCRIPTION}")
    remedy = "write it as docs/how-to/submit-to-the-benchmark.md describes"
    return read_document(folder / DESCRIPTION, remedy, SubmissionDocument)


def write_submission(folder: Path, **fields: object) -> None:
    """Write the description of the pictures that are in a folder."""
    files = {
        path.name: file_digest(path)
        for path in sorted(folder.iterdir())
        if path.suffix in _SUFFIXES
    }
    write_document(
        folder / DESCRIPTION,
        SubmissionDocument(protocol=PROTOCOL, files=files, **fields),  # type: ignore[arg-type]
    )


def picture_of(folder: Path, case: str) -> Path | None:
    """The picture of a case, if there is one."""
    paths = (folder / f"{case}{suffix}" for suffix in _SUFFIXES)
    return next((path for path in paths if path.is_file()), None)


def file_mistakes(
    folder: Path, submission: SubmissionDocument, cases: Sequence[MadeCase]
) -> list[str]:
    """Sentences on what is wrong with the files of a submission, each with its remedy."""
    mistakes = []
    if submission.protocol != PROTOCOL:
        mistakes.append(
            f"{DESCRIPTION}: protocol is {submission.protocol!r}, and this suite is {PROTOCOL}; "
            "make the pictures again from its inputs"
        )
    if not submission.tracks:
        mistakes.append(f"{DESCRIPTION}: tracks is empty; name some of {', '.join(TRACKS)}")
    for track in submission.tracks:
        if track not in TRACKS:
            mistakes.append(f"{DESCRIPTION}: track {track!r}: {suggest_words(track, TRACKS)}")
    for field in ("name", "licence"):
        if not getattr(submission, field).strip():
            mistakes.append(f"{DESCRIPTION}: {field} is empty; fill it in")
    if not any(author.strip() for author in submission.authors):
        mistakes.append(f"{DESCRIPTION}: authors is empty; name the authors")
    own = submission.name.partition(":")[0]
    if submission.authors != OWN_AUTHORS and own in (*algorithm_names(), *RESERVED):
        mistakes.append(f"{DESCRIPTION}: name {own!r} is an algorithm of inim; choose another")
    names = [case.case.name for case in cases]
    for case, seconds in submission.seconds.items():
        if case not in TIERS["full"]:
            mistakes.append(f"{DESCRIPTION}: seconds of {case!r}: {suggest_words(case, names)}")
        elif not 0 < seconds < math.inf:
            mistakes.append(
                f"{DESCRIPTION}: seconds of {case} is {seconds:g}; give a positive time"
            )
    for name in names:
        if picture_of(folder, name) is None:
            mistakes.append(f"{name}: has no picture; add {name}.png or {name}.exr")
        elif all((folder / f"{name}{suffix}").is_file() for suffix in _SUFFIXES):
            mistakes.append(f"{name}: has two pictures, .png and .exr; keep one")
    for path in sorted(folder.iterdir()):
        if path.suffix in _SUFFIXES:
            mistakes += _picture_mistakes(path, submission.files, names)
    for name in submission.files:
        if not (folder / name).is_file():
            mistakes.append(f"{name}: is listed in {DESCRIPTION} and missing; add it, or its case")
    return mistakes


def _picture_mistakes(path: Path, digests: Mapping[str, str], names: Sequence[str]) -> list[str]:
    if path.stem not in TIERS["full"]:
        return [f"{path.name}: no case of that name; {suggest_words(path.stem, names)}"]
    if path.name not in digests:
        return [f"{path.name}: is not listed in {DESCRIPTION}; add its SHA-256 to files"]
    if file_digest(path) != digests[path.name]:
        return [
            f"{path.name}: is not the file of {DESCRIPTION}: its SHA-256 differs; submit the "
            "original, or update files"
        ]
    return []


def check_name(name: str) -> str:
    """A name for files, from that of an algorithm; raises `UsageError` if it has no letters."""
    text = "".join(letter if letter.isalnum() or letter in "-_.=" else "-" for letter in name)
    if not text.strip("-."):
        raise UsageError(f"name {name!r}: has no letters or digits; add one")
    return text
