"""A report on disk: strict JSON that loses no number silently, and safe wherever it is shown."""

import html
import json
import math
import re
from pathlib import Path
from typing import Any

import pytest

from inim.report import Report
from inim.report.document import ReportDocument
from tests.schemas import report_document

PSNR = ("algorithms", "template", "views", "centre", "psnr_to_reference_db")


def data(psnr: float, **changes: Any) -> ReportDocument:
    scores = {"ssim_to_reference": 0.97, "psnr_to_reference_db": psnr}
    return report_document(
        {
            "title": "Coin",
            "viewpoints": [{"name": "centre"}],
            "algorithms": {"template": {"views": {"centre": scores}}},
            **changes,
        }
    )


def psnr_of(report: Report) -> float | None:
    return report.data.algorithms["template"].views["centre"]["psnr_to_reference_db"]


def at(text: Any, path: tuple[str, ...]) -> Any:
    for key in path:
        text = text[key]
    return text


def write(folder: Path, content: ReportDocument) -> dict[str, Any]:
    Report(folder, content).write()
    text = (folder / "report.json").read_text(encoding="utf-8")
    assert not re.search(r"\bNaN\b|Infinity", text)
    return json.loads(text)


def shown_psnr(folder: Path) -> str | None:
    page = html.unescape((folder / "report.html").read_text(encoding="utf-8"))
    match = re.search(r"<dt>Whole image, to reference</dt>.*?PSNR <b>(.*?)</b>", page)
    return match and match[1].replace("\u00a0", " ")


def test_infinite_psnr_is_null_and_shows_as_infinite(tmp_path):
    document = write(tmp_path, data(math.inf))
    assert at(document, PSNR) is None
    assert "not_finite" not in document
    assert shown_psnr(tmp_path) == "∞ dB"


@pytest.mark.parametrize("lost", [math.nan, -math.inf])
def test_psnr_that_is_not_a_number_is_null_but_listed_and_never_shows_as_infinite(tmp_path, lost):
    document = write(tmp_path, data(lost))
    assert at(document, PSNR) is None
    assert document["not_finite"] == [list(PSNR)]
    assert shown_psnr(tmp_path) == "–"


def test_nan_survives_loading_and_writing_again(tmp_path):
    write(tmp_path, data(math.nan))
    first = (tmp_path / "report.html").read_text(encoding="utf-8")
    again = Report.load(tmp_path)
    assert math.isnan(psnr_of(again) or 0)
    again.write()
    assert (tmp_path / "report.html").read_text(encoding="utf-8") == first
    assert math.isnan(psnr_of(Report.load(tmp_path)) or 0)


def test_path_that_is_no_utf8_is_written_and_read_back(tmp_path):
    path = b"scenes/\xff\xe5.xml".decode("utf-8", "surrogateescape")
    write(tmp_path, data(30.0, title=path, command=path, scene={"path": path}))
    assert Report.load(tmp_path).data.scene.path == path
    for name in ("report.html", "junit.xml", "summary.md"):
        (tmp_path / name).read_text(encoding="utf-8")


def test_notebook_shows_the_page_in_a_frame_that_nothing_leaves(tmp_path):
    write(tmp_path, data(30.0, title="\"'></iframe><script>alert(1)</script>"))
    page_frame = Report.load(tmp_path).page()._repr_html_()
    match = re.fullmatch(r'<iframe srcdoc="([^"]*)"[^<>]*></iframe>', page_frame or "")
    assert match
    assert "<" not in match[1]
    page = html.unescape(match[1])
    based = '<base href="about:srcdoc">'  # or the page's own links would open the notebook in it
    assert page.replace(based, "") == (tmp_path / "report.html").read_text(encoding="utf-8")
    assert page.index(based) < page.index("Content-Security-Policy")


def test_notebook_shows_the_scores_with_a_link_to_the_page(tmp_path, monkeypatch):
    evil, no_utf8 = "'\"><script>alert(1)</script>", b"\xff".decode("utf-8", "surrogateescape")
    write(tmp_path, data(30.0, title=f"{evil}{no_utf8}"))
    table = Report.load(tmp_path)._repr_html_()
    assert len(table) < 5000 and "<script" not in table
    table.encode("utf-8")
    assert f'href="{tmp_path.as_uri()}/report.html"' in table
    monkeypatch.chdir(tmp_path.parent)
    assert f'href="{tmp_path.name}/report.html"' in Report.load(tmp_path.name)._repr_html_()
    for line in str(Report.load(tmp_path)).splitlines()[2:]:
        for cell in line.split("  "):
            assert html.escape(cell.strip()) in table
