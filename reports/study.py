"""Studies: scripts that answer a question of this project, all in one form.

A study declares its arguments, its cases, the measurement of a case and the page of the results.
``python -m MODULE ... -o FOLDER`` measures the cases and writes JSON, Markdown and a page. Finished
cases are kept in ``out/NAME``. A kept case is used again if its digest is unchanged: the digest of
the code and of the options that decide its result.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import re
import shlex
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from inim.report.study import PagePart, StudyPage, Table
from inim.scores.document_parts import Files, TitledDocument, Versions, Warnings, origin
from inim.system.cache import computation_digests, value_digest
from inim.system.document import decode, encode, write_text
from inim.system.errors import EXIT_CHECK_FAILED, EXIT_PASSED, InimError
from inim.system.process.machine import cpu_model

HERE = Path(__file__).parent
ROOT = HERE.parent
#: Code that decides results, in the core.
CODE = (
    "inim/display", "inim/generators", "inim/image", "inim/pipeline", "inim/render",
    "inim/scores/metrics", "inim/scores/regression/noise_free.py",
    "inim/scores/regression/scores.py", "inim/system/backend",
)  # fmt: skip
# Modules next to a study that decide no results.
_NO_MEASUREMENT = re.compile(r"test_|conftest|page\.py|__init__")
#: Results by case.
Results = Mapping[str, Any]


class StudyDocument(TitledDocument, tag="inim.study/1"):
    """Results of a study of this project."""

    versions: Versions
    digest: str  #: Digest of the code and of the options that decide the results.
    warnings: Warnings
    results: dict[str, Any]  #: Results, by case.
    passed: bool  #: False if the results contradict a claim of the study.
    files: Files


@dataclass(frozen=True)
class Study:
    """A study."""

    module: str  #: Module of its command, ``reports.NAME.run``.
    title: str
    description: str  #: Text of its command's help.
    arguments: Callable[[argparse.ArgumentParser], object]  #: Adds its arguments to a parser.
    #: Returns the options of `measure` by case, for parsed arguments. Options are JSON values and
    #: paths. The content of a file, and the names and sizes of a folder's files, decide a result.
    cases: Callable[[argparse.Namespace], Mapping[str, Mapping[str, Any]]]
    measure: Callable[..., Any]  #: Measures a case; returns JSON values.
    #: Returns remarks and parts of the page for the results, as they are read from the JSON file:
    #: infinite values are None.
    page: Callable[[Results], tuple[Sequence[str], Sequence[PagePart]]]
    stem: str = ""  #: Name of its files; default: the last part of NAME.
    #: Files and folders of the project that decide the results. The modules next to `measure`,
    #: and those above them, always do, except pages.
    code: tuple[str, ...] = CODE
    #: Returns reasons to doubt the measurements that follow, such as a busy machine.
    doubts: Callable[[], list[str]] = list
    #: Returns False if the results contradict a claim of the study.
    passed: Callable[[Results], bool] = lambda _: True

    @property
    def name(self) -> Path:
        """Folder of its results below ``reports``, and of its kept cases below ``out``."""
        return Path(*self.module.split(".")[1:-1])

    def main(self, words: Sequence[str] | None = None) -> int:
        """Run the study with the words of a command line; return the exit code."""
        words = sys.argv[1:] if words is None else words
        args = self.parse(words)
        try:
            document = self.run(args, words)
        except InimError as error:
            print(f"{self.module}: error: {error}", file=sys.stderr)
            return error.exit_code
        print(f"{'passed' if document.passed else 'FAILED'}; {args.out / self._stem}.html")
        return EXIT_PASSED if document.passed else EXIT_CHECK_FAILED

    def parse(self, words: Sequence[str]) -> argparse.Namespace:
        """Parse the words of a command line."""
        summary = self.description.partition("\n")[0]
        parser = argparse.ArgumentParser(prog=f"python -m {self.module}", description=summary)
        self.arguments(parser)
        folder = Path("reports", self.name)
        parser.add_argument("-o", "--out", type=Path, default=folder, help=f"folder ({folder})")
        return parser.parse_args(words)

    def run(self, args: argparse.Namespace, words: Sequence[str] = ()) -> StudyDocument:
        """Measure all cases that are not kept, and write the results into the folder `args.out`."""
        doubts, cases, code = self.doubts(), self.cases(args), self.code_digests()
        records = {name: self._record(name, cases[name], code, doubts) for name in cases}
        results = {name: record["result"] for name, record in records.items()}
        warnings = dict.fromkeys(w for record in records.values() for w in record["warnings"])
        document = StudyDocument(
            title=self.title,
            **origin(shlex.join(["python", "-m", self.module, *words]), ("mitsuba", "numpy")),
            code=code,
            digest=self.digest(cases, code),
            warnings=list(warnings),
            results=results,
            passed=self.passed(results),
            files=[],
        )
        document = decode(encode(document), StudyDocument)
        args.out.mkdir(parents=True, exist_ok=True)
        self.document_page(document).write(document, args.out, self._stem)
        return document

    def document_page(self, document: StudyDocument) -> StudyPage:
        """Page of the results in a document."""
        remarks, parts = self.page(document.results)
        facts = [cpu_model(), f"inim {document.inim_version}"]
        return StudyPage("Summary", facts, remarks, parts, document.warnings)

    def digest(
        self, cases: Mapping[str, Mapping[str, Any]], code: Mapping[str, str] | None = None
    ) -> str:
        """Digest of the code, by default the present one, and of the options of the cases."""
        code = self.code_digests() if code is None else code
        return value_digest({name: _case_digest(cases[name], code) for name in cases})

    def code_digests(self) -> dict[str, str]:
        """Digests of the files and folders of the project that decide the results."""
        own = Path(sys.modules[self.measure.__module__].__file__ or "").parent
        above = (path for folder in own.parents for path in folder.glob("*.py"))
        scripts = {path for path in (*own.rglob("*.py"), *above) if path.is_relative_to(HERE)}
        scripts -= {Path(__file__)}
        modules = [path for path in sorted(scripts) if not _NO_MEASUREMENT.match(path.name)]
        return computation_digests([*self.code, *(str(p.relative_to(ROOT)) for p in modules)])

    @property
    def _stem(self) -> str:
        return self.stem or self.name.name

    def _record(
        self, name: str, options: Mapping[str, Any], code: Mapping[str, str], doubts: Sequence[str]
    ) -> dict[str, Any]:
        """Digest, warnings and result of a case, kept or measured."""
        path = Path("out", self.name, re.sub(r"[^\w.+-]+", "-", name) + ".json")
        digest = _case_digest(options, code)
        record: dict[str, Any] = json.loads(path.read_text("utf-8")) if path.is_file() else {}
        if record.get("digest") != digest:
            print(f"{self.name}: {name}", file=sys.stderr, flush=True)
            result = self.measure(**options)
            text = json.dumps({"digest": digest, "warnings": doubts, "result": result})
            path.parent.mkdir(parents=True, exist_ok=True)
            write_text(path, text)
            record = json.loads(text)
        return record


def _case_digest(options: Mapping[str, Any], code: Mapping[str, str]) -> str:
    return value_digest([code, {key: _contents(value) for key, value in options.items()}])


def _contents(value: Any) -> Any:
    """An option with paths replaced by what they contain."""
    if isinstance(value, (list, tuple)):
        return [_contents(entry) for entry in value]
    if not isinstance(value, Path):
        return value
    if value.is_dir():
        return sorted((p.name, p.stat().st_size) for p in value.rglob("*") if p.is_file())
    return hashlib.sha256(value.read_bytes()).hexdigest()


def table(caption: str, rows: Iterable[Any], columns: Mapping[str, Callable[[Any], str]]) -> Table:
    """Table with a row for each of `rows`; `columns` return the cell of a row, by head."""
    cells = [[cell_of(row) for cell_of in columns.values()] for row in rows]
    return Table(caption, list(columns), cells)


def entry(*keys: Any, text: Callable[[Any], str] = str) -> Callable[[Any], str]:
    """Column of `table` with the entry of a row under nested keys, as text."""

    def cell_of(row: Any) -> str:
        for key in keys:
            row = row[key]
        return text(row)

    return cell_of


def add_scenes(parser: argparse.ArgumentParser) -> None:
    """Add the scenes to the arguments of a study."""
    parser.add_argument("scenes", nargs="+", type=Path, metavar="SCENE", help="Mitsuba scenes")
