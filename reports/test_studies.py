"""All studies have one form, and pages of committed results can be drawn again."""

import json
import re
from importlib import import_module
from types import SimpleNamespace

import pytest

from inim.report.study import PagePart, StudyPage
from inim.system.document import read_document
from inim.system.errors import EXIT_CHECK_FAILED, EXIT_PASSED, EXIT_USAGE, UsageError
from reports.study import HERE, Study, StudyDocument, table

_NUMBER = re.compile(r"\d[\d.,]*\d")


def measure(number, source=None, code=1):
    if number < 0:
        raise UsageError("number: below zero; give a larger one")
    measure.calls.append(number)
    return {"square": number**2}


def page(results):
    columns = {"number": lambda r: r[0], "square": lambda r: str(r[1]["square"])}
    return ["Remark."], [PagePart("a", "A", "", [table("Squares", results.items(), columns)])]


@pytest.fixture
def study(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    measure.calls = []

    def arguments(parser):
        parser.add_argument("numbers", nargs="+", type=int)

    return Study(
        "reports.squares.run", "Squares", "Squares of numbers.", arguments,
        lambda args: {str(n): {"number": n} for n in args.numbers}, measure, page,
        passed=lambda results: "13" not in results,
    )  # fmt: skip


def test_a_study_writes_all_forms_and_finished_cases_are_not_measured_again(study, tmp_path):
    assert study.main(["2", "3", "-o", "out/a"]) == EXIT_PASSED
    assert study.main(["2", "3", "4", "-o", "out/b"]) == EXIT_PASSED
    assert measure.calls == [2, 3, 4]
    document = read_document(tmp_path / "out/b/squares.json", "", StudyDocument)
    assert document.results == {str(n): {"square": n**2} for n in (2, 3, 4)}
    assert document.command == "python -m reports.squares.run 2 3 4 -o out/b"
    assert set(document.files) == {f"squares.{kind}" for kind in ("json", "md", "html")}
    assert "| 3 | 9 |" in (tmp_path / "out/b/squares.md").read_text("utf-8")
    assert "Remark." in (tmp_path / "out/b/squares.html").read_text("utf-8")


def test_a_digest_follows_the_options_the_files_and_the_code(study, tmp_path, monkeypatch):
    source = tmp_path / "source"
    source.write_text("one", "utf-8")

    def digest(**options):
        return study.digest({"case": {"number": 1, "source": source, **options}})

    first = digest()
    assert first == digest() != digest(code=2)
    source.write_text("two", "utf-8")
    assert digest() != first
    source.write_text("one", "utf-8")
    monkeypatch.setattr("reports.study.computation_digests", lambda *_: {"inim": "changed"})
    assert digest() != first


def test_a_changed_digest_measures_a_kept_case_again(study, monkeypatch):
    study.main(["2", "-o", "out/a"])
    monkeypatch.setattr("reports.study.computation_digests", lambda *_: {"inim": "changed"})
    study.main(["2", "-o", "out/a"])
    assert measure.calls == [2, 2]


def test_an_error_is_one_line_and_a_refuted_claim_has_an_exit_code(study, capsys, tmp_path):
    assert study.main(["-o", "out/a", "--", "-1"]) == EXIT_USAGE
    assert capsys.readouterr().err.splitlines()[-1].startswith("reports.squares.run: error: number")
    assert not (tmp_path / "out/a").exists()
    assert study.main(["13", "-o", "out/a"]) == EXIT_CHECK_FAILED


def committed(name):
    """Committed results by case, in whichever form the study wrote them."""
    (path,) = (HERE / name).glob("[!.]*.json")
    data = json.loads(path.read_text("utf-8"))
    if "light_fields" in data:
        return {result["name"]: result for result in data["light_fields"]}
    if "relics" in data:
        return {row["relic"]: row for row in data["relics"]}
    return data.get("results", data.get("study", data))


@pytest.mark.parametrize("name", ["bench/paper", "bench/views", "bench/cuda", "bench/commands",
                                  "one_picture", "rays", "reality", "scoreboard"])  # fmt: skip
def test_committed_results_are_still_read(name):
    """Their numbers are those of the committed Markdown, which documents quote."""
    study = import_module(f"reports.{name.replace('/', '.')}.run").STUDY
    assert str(study.name) == name
    remarks, parts = study.page(committed(name))
    document = SimpleNamespace(title="", command="")
    text = StudyPage("", [], remarks, parts).markdown(document)
    (path,) = (HERE / name).glob("*.md")
    rows = "\n".join(row for row in text.splitlines() if row.startswith("| "))
    numbers, quoted = (set(_NUMBER.findall(t)) for t in (rows, path.read_text("utf-8")))
    assert len(numbers) > 10 and numbers <= quoted
