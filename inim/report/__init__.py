"""Reports: the results of a validation, as data, as a page and as text."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from inim.display import Display
from inim.report.document import ReportDocument
from inim.system.cache import ResultCache
from inim.system.document import read_document, write_forms
from inim.system.errors import FileError, UsageError, suggest_words
from inim.system.files import read_file

if TYPE_CHECKING:
    from inim.report.score_table import ScoreTable

__all__ = ["TRUTH", "Report"]

#: Names the ground truth where an algorithm could be named.
TRUTH = "truth"
_WAY_OUT = "make it anew with inim validate"
# Tall enough for verdict, scores and images; the rest scrolls.
_NOTEBOOK_HEIGHT_PX = 900
_MOST_PAGE_BYTES = 2**28


@dataclass(frozen=True)
class Report:
    """A finished validation: its folder and the content of its `report.json`.

    Attributes
    ----------
    folder : Path
        Holds `report.json`, `report.html`, `junit.xml`, `summary.md` and the images.
    data : ReportDocument
        Schema `inim.report/2`.

    Notes
    -----
    JSON has no number that is not finite. `write` puts null in its place; the paths of those that
    were NaN or −infinity it lists under the top-level key ``not_finite``, each as the list of keys
    that lead there, and `load` puts NaN back at them. They show as "–" and pass no check. A null
    PSNR that is not listed was +infinity, of two identical images, and shows as "∞"; any other
    null is a value there was none of.
    """

    folder: Path
    data: ReportDocument

    @property
    def passed(self) -> bool:
        """True if every check passed; False without a verdict or any check."""
        verdict = self.data.verdict
        return verdict.passed and bool(verdict.checks)

    @property
    def html_path(self) -> Path:
        """The file to open in a browser."""
        return self.folder / "report.html"

    def __repr__(self) -> str:
        return f"Report({str(self.folder)!r}: {self.data.verdict.word})"

    def __str__(self) -> str:
        """The scores of each algorithm and view as a small table, and the verdict."""
        from inim.report.summary import render_text

        return render_text(self.data)

    @classmethod
    def load(cls, folder: Path | str) -> Report:
        """Read a report from its folder.

        Raises
        ------
        FileError
            The folder has no report, or one that is invalid against its schema.
        """
        path = Path(folder) / "report.json"
        return cls(path.parent, read_document(path, _WAY_OUT, ReportDocument))

    @property
    def display(self) -> Display:
        """The display as designed."""
        return self.data.display.parameters

    def eia_path(self, name: str, option: str) -> Path:
        """Path of the linear EIA of an algorithm, or of the ground-truth EIA.

        Parameters
        ----------
        name : str
        option : str
            Option that gave the name, for error messages.

        Raises
        ------
        UsageError
            The report has no such algorithm.
        """
        names = [TRUTH, *self.data.algorithms]
        if name not in names:
            raise UsageError(f"{option} {name}: {suggest_words(name, names)}")
        place = ("truth", "eia") if name == TRUTH else ("eia", name)
        return Path(self.folder, place[0], f"{place[1]}.exr")

    def table(self, *scores: str) -> ScoreTable:
        """Scores of all algorithms and views, for pandas, CSV and LaTeX.

        Parameters
        ----------
        *scores : str
            Names such as ``ssim_on_relic_to_reference``; by default all.

        Raises
        ------
        UsageError
            The report has no such score.
        """
        from inim.report.score_table import ScoreTable

        return ScoreTable.of(self, scores)

    def write(self, cache: ResultCache | None = None, out: Path | None = None) -> None:
        """Write all forms, `report.json` last: it marks a whole report, to be moved to `out`."""
        from inim.report.sections import render_html
        from inim.report.summary import render_junit, render_summary

        forms = {
            "report.html": lambda data: render_html(data, self.folder, cache),
            "junit.xml": render_junit,
            "summary.md": lambda data: render_summary(data, out or self.folder),
        }
        write_forms(self.data, self.folder, "report.json", forms)

    def page(self) -> ReportPage:
        """The whole page with the virtual display, for a notebook: 5 to 9 MB in its file."""
        return ReportPage(self.html_path)

    def _repr_html_(self) -> str:
        """The scores as a table, with a link to the page, for notebooks."""
        from inim.report.summary import render_table

        path = self.html_path
        link = (
            quote(path.as_posix(), errors="surrogateescape")
            if not path.is_absolute()
            else path.as_uri()
        )
        return render_table(self.data, link)


@dataclass(frozen=True)
class ReportPage:
    """Page of a report, shown in a notebook; see `Report.page`."""

    path: Path

    def _repr_html_(self) -> str | None:
        """The page in an isolated frame, so that its styles do not affect the notebook.

        Its scripts run, so that the virtual display is interactive, but in a separate origin: they
        cannot access the notebook's page, cookies or kernel, nor open windows, and the page's
        policy allows only the report's own scripts.
        """
        try:
            page = read_file(self.path, _MOST_PAGE_BYTES).decode("utf-8")
        except (FileError, ValueError):
            return None
        # Without a base of its own, a framed page's links are relative to the notebook.
        page = page.replace("<head>", '<head><base href="about:srcdoc">', 1)
        return (
            f'<iframe srcdoc="{escape(page)}" title="inim report" sandbox="allow-scripts" '
            f'style="width:100%;height:{_NOTEBOOK_HEIGHT_PX}px;border:0"></iframe>'
        )
