"""The site builds without a warning and fits a phone; what documents say to type works.

Expected: no broken link or picture, no page wider than a phone, no block that fails.
"""

import os
import re
import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote

import pytest

from reports.gallery.examples import read_examples
from tests.chromium import browser
from tests.documents import ROOT, pages, run_page

PHONE = (390, 844)
_TARGET = re.compile(r'(?:href|src)="([^"]+)"')
_ANCHOR = re.compile(r'\bid="([^"]+)"')


def build(folder: Path, *options: str) -> Path:
    """The site of the project's documents, every warning an error."""
    process = subprocess.run(
        [sys.executable, "-m", "sphinx", "--fail-on-warning", "--keep-going", "--quiet",
         *options, "-d", str(folder / "doctrees"), "docs", str(folder / "site")],
        cwd=ROOT, capture_output=True, text=True,
    )  # fmt: skip
    assert process.returncode == 0, process.stderr[-4000:]
    return folder / "site"


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    pytest.importorskip("myst_nb")
    return build(tmp_path_factory.mktemp("site"), "-D", "nb_execution_mode=off")


@pytest.mark.slow
def test_every_link_and_picture_of_the_site_is_there(site):
    texts = {p.resolve(): p.read_text("utf-8") for p in site.rglob("*.html")}
    anchors = {path: set(_ANCHOR.findall(text)) for path, text in texts.items()}
    count = 0
    display = (site / "virtual-display.html").resolve()
    assert display in texts and f'src="{display.name}"' in texts[(site / "index.html").resolve()]
    for path, text in texts.items():
        # A page of one element, whose script forms links, and source code with texts of links.
        if path == display or "_modules" in path.parts:
            continue
        for target in map(unquote, _TARGET.findall(text)):
            if re.match(r"[a-z]+:|//", target):
                continue
            page, _, anchor = target.partition("#")
            file = (path.parent / page.partition("?")[0]).resolve() if page else path
            assert file.exists(), f"{path.name}: {target}"
            if anchor and file in anchors:
                assert anchor in anchors[file], f"{path.name}: {target}"
            count += 1
    assert count > 1000


@pytest.mark.slow
def test_no_page_is_wider_than_a_phone(site, tmp_path):
    with browser() as tab:
        tab.size(*PHONE, mobile=True)
        for path in sorted(site.rglob("*.html")):
            if path.name in {"genindex.html", "search.html"} or "_static" in path.parts:
                continue
            tab.open(path)
            width = tab.evaluate("document.documentElement.scrollWidth")
            assert width <= PHONE[0], path
        assert not tab.complaints


@pytest.mark.slow
def test_search_finds_the_page_about_the_words_first(site):
    with browser() as tab:
        tab.open(site / "search.html", "?q=looking+glass")
        tab.until("document.querySelector('#search-results li a') !== null")
        first = tab.evaluate("document.querySelector('#search-results li a').textContent")
    assert first in {"Pictures for a Looking Glass", "Gallery > A Looking Glass"}


@pytest.mark.slow
def test_notebooks_run(tmp_path):
    pytest.importorskip("myst_nb")
    pages = build(tmp_path, "-D", "nb_execution_mode=force")
    for page in pages.glob("notebooks/*.html"):
        pictures = re.findall(
            r'<img alt="[^"]*" src="\.\./(_images/\w+\.png)"', page.read_text("utf-8")
        )
        assert pictures, f"{page.name} shows no picture of its cells"
        assert all((pages / picture).is_file() for picture in pictures)


@pytest.mark.slow
@pytest.mark.parametrize("page", pages())
def test_commands_of_a_page_work(page, tmp_path, tmp_path_factory):
    base = tmp_path_factory.getbasetemp()
    shared = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    for _ in run_page(page, tmp_path, shared / "cache of pages"):
        pass
    if page == "docs/gallery.md":
        for example in read_examples():
            assert list((tmp_path / "inim").rglob(f"{example.name}.png")), example.title
