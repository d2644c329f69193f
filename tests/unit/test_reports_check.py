"""Committed results become stale when the code that decides them changes, with their sentences.

Each test changes a copy: the pages, the generators, and the results with present digests.
"""

import json
import shutil

import pytest

from inim.system.cache import computation_digests
from tests import reports_check
from tests.documents import ROOT, pages

GENERATORS, WANG = "inim/generators", "inim/generators/wang2024.py"


@pytest.fixture
def copy(tmp_path):
    """Copy of pages and generators; `bench/paper` depends on these, `bench/views` on a lens."""
    for place in (GENERATORS, "inim/display/lens", "docs", "reports/bench/paper"):
        shutil.copytree(ROOT / place, tmp_path / place)
    for page in ("README.md", "CONTRIBUTING.md"):
        shutil.copy(ROOT / page, tmp_path)
    record(tmp_path, "bench/paper", GENERATORS)
    record(tmp_path, "bench/views", "inim/display/lens")
    return tmp_path


def record(root, name, *places):
    """Write a result with the digests of the present code."""
    path = root / "reports" / name / "bench.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"code": computation_digests(places, root)}), "utf-8")


def edit(root, old, new, place=WANG):
    path = root / place
    text = path.read_text("utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), "utf-8")


def test_a_change_of_the_loop_of_wang2024_names_the_result_and_the_sentences(copy):
    assert reports_check.report(copy) == (
        ["fresh   reports/bench/paper", "fresh   reports/bench/views"], True,
    )  # fmt: skip
    edit(copy, "if mismatch < best:", "if mismatch <= best:")
    (first, *sentences, last), is_clean = reports_check.report(copy)
    assert first == f"stale   reports/bench/paper: changed {GENERATORS}"
    assert last == "fresh   reports/bench/views"
    assert not is_clean
    text = "\n".join(sentences)
    for page in ("README.md", "docs/theory/speed.md", "docs/theory/paper.md"):
        assert f"        {page}:" in text
    for sentence in sentences:  # each stands on the line that is named
        page, line, words = sentence.strip().split(":", 2)
        assert words.split()[0] in (copy / page).read_text("utf-8").splitlines()[int(line) - 1]


def test_comments_docstrings_and_layout_decide_nothing(copy):
    path = copy / WANG
    text = path.read_text("utf-8").replace('"""', '"""Other words. ', 1)
    path.write_text(f"# A comment.\n{text}\n\n# Another.\n", "utf-8")
    assert [r.state for r in reports_check.results(copy)] == ["fresh", "fresh"]


@pytest.mark.parametrize(("old", "new"), [("0", "1"), ("0", "False"), ("None", "''"), ("1", "1.0")])
def test_every_constant_decides(tmp_path, old, new):
    digests = []
    for value in (old, new):
        (tmp_path / "a.py").write_text(f"x = {value}\n", "utf-8")
        digests.append(computation_digests(["a.py"], tmp_path))
    assert digests[0] != digests[1]


def test_removed_and_added_code_is_a_change(copy):
    (copy / "inim/display/lens/new.py").write_text("x = 1\n", "utf-8")
    shutil.rmtree(copy / GENERATORS)
    assert [r.changed for r in reports_check.results(copy)] == [
        [GENERATORS], ["inim/display/lens"],
    ]  # fmt: skip


def test_a_result_without_digests_is_unknown_and_fails_nothing(copy):
    (copy / "reports/bench/paper/bench.json").write_text("{}", "utf-8")
    lines, is_clean = reports_check.report(copy)
    assert (lines[0], is_clean) == ("unknown reports/bench/paper", True)


PAGE = """# Title

<!-- reports/whole -->

Whole 1. Without a number.

## Next

See `reports/own`: 2 ms. [Link](../reports/linked/a.md) has 3 ms.

| row | 4 |
| --- | --- |
| `reports/cell` | 5 |

<!-- reports/table -->
| row | 6 |
| --- | --- |
| row | 7 |

By `python -m reports.bench.module.run -o out`, in ms:

| row | 8 |

`reports/old` of commit 12ab has 9. `reports/word` has `10`.
"""


def test_quotes_are_those_of_the_paragraph_the_row_or_the_table(tmp_path, monkeypatch):
    (tmp_path / "page.md").write_text(PAGE, "utf-8")
    monkeypatch.setattr(reports_check, "pages", lambda: ["page.md"])
    quotes = {}
    for name, sentence in reports_check.quotes(tmp_path):
        quotes.setdefault(name, []).append(sentence)
    assert quotes["whole"] == ["page.md:5: Whole 1."]
    cited = [
        "page.md:9: See `reports/own`: 2 ms.",
        "page.md:9: [Link](../reports/linked/a.md) has 3 ms.",
    ]
    assert quotes["own"] == quotes["linked/a.md"] == cited
    assert quotes["cell"] == ["page.md:13: | `reports/cell` | 5 |"]
    assert quotes["table"] == ["page.md:16: | row | 6 |", "page.md:18: | row | 7 |"]
    assert quotes["bench.module.run"] == ["page.md:22: | row | 8 |"]
    assert "old" not in quotes and quotes["word"] == [
        "page.md:24: `reports/old` of commit 12ab has 9."
    ]


@pytest.mark.slow
def test_no_sentence_quotes_a_stale_result(capsys):
    """The list of all results is part of the output of the slow tier."""
    lines, is_clean = reports_check.report()
    with capsys.disabled():
        print("", "Committed results:", *lines, sep="\n")
    assert is_clean, "\n".join(lines)
    assert {"README.md", "docs/theory/speed.md"} <= {*pages()}
