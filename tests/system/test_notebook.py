"""A report in a notebook: live in a frame of its own, from which nothing reaches the notebook."""

from pathlib import Path
from typing import Any

import pytest

from inim.report import Report
from tests.chromium import WEBGL, Tab, browser
from tests.schemas import report_document
from tests.system.test_view import report_data, report_folder


@pytest.fixture(scope="module")
def tab(tmp_path_factory):
    # In a process of its own the frame would be out of this pipe's reach, too.
    flags = (*WEBGL, "--disable-features=IsolateSandboxedIframes")
    with browser(flags) as tab:
        tab.size(1100, 1000)
        yield tab


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    result = Report(
        report_folder(tmp_path_factory.mktemp("report")), report_document(report_data())
    )
    result.write()
    return result


def notebook(tab: Tab, report: Report, folder: Path) -> None:
    """A page that shows the report as a notebook does, and has something to steal."""
    path = folder / "notebook.html"
    cell = report.page()._repr_html_()
    path.write_text(
        f"<!doctype html><title>mine</title><script>secret = 42</script>{cell}", encoding="utf-8"
    )
    tab.complaints.clear()
    tab.open(path)


def inside(tab: Tab, expression: str) -> Any:
    """The value of an expression in the frame, whatever it may reach from there."""
    frame = tab.send("Page.getFrameTree")["frameTree"]["childFrames"][0]["frame"]["id"]
    world = tab.send("Page.createIsolatedWorld", frameId=frame)["executionContextId"]
    answer = tab.send(
        "Runtime.evaluate",
        expression=expression,
        contextId=world,
        awaitPromise=True,
        returnByValue=True,
    )
    assert "exceptionDetails" not in answer, answer["exceptionDetails"]
    return answer["result"].get("value")


def test_frame_reaches_nothing_of_the_notebook(tab, report, tmp_path):
    notebook(tab, report, tmp_path)
    for attempt in (
        "parent.secret",
        "parent.document.title",
        "document.cookie",
        "localStorage.length",
        "(top.location = 'about:blank', 'gone')",
    ):
        tried = f"try {{ return {attempt} ?? 'undefined'; }} catch (e) {{ return e.name; }}"
        assert inside(tab, f"(() => {{ {tried} }})()") == "SecurityError", attempt
        assert tab.evaluate("secret") == 42


def test_script_that_got_into_a_report_does_not_run_in_the_frame(tab, report, tmp_path):
    page = report.html_path.read_text(encoding="utf-8")
    folder = tmp_path / "tampered"
    folder.mkdir()
    evil = "<script>document.title = 'ran'</script><img src=x onerror=\"document.title = 'ran'\">"
    (folder / "report.html").write_text(page.replace("</main>", f"{evil}</main>"))
    notebook(tab, Report(folder, report.data), tmp_path)
    assert inside(tab, "document.title") != "ran"
    assert any("Content Security Policy" in complaint for complaint in tab.complaints)
    assert tab.evaluate("document.title") == "mine"
