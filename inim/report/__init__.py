"""Reports: what a validation found, as data and in the forms people and machines read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from inim.cache.result_cache import ResultCache
from inim.display import Display
from inim.errors import FileError, InimError, UsageError, known_words
from inim.files.json_file import read_json
from inim.files.regular_file import read_file
from inim.report.files import from_strict, write_forms
from inim.report.wording import verdict

__all__ = ["SCHEMA", "TRUTH", "Report"]

SCHEMA = "inim.report/1"
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
    data : mapping
        Schema `inim.report/1`: `inim/schemas/report.schema.json`.

    Notes
    -----
    JSON has no number that is not finite. `write` puts null in its place; the paths of those that
    were NaN or −infinity it lists under the top-level key ``not_finite``, each as the list of keys
    that lead there, and `load` puts NaN back at them. They show as "–" and pass no check. A null
    PSNR that is not listed was +infinity, of two identical images, and shows as "∞"; any other
    null is a value there was none of.
    """

    folder: Path
    data: Mapping[str, Any]

    @property
    def passed(self) -> bool:
        """Whether every check passed; False too when there is no verdict or no check at all."""
        return verdict(self.data) in ("passed", "ran clean")

    @property
    def html_path(self) -> Path:
        """The file to open in a browser."""
        return self.folder / "report.html"

    def __repr__(self) -> str:
        return f"Report({str(self.folder)!r}: {verdict(self.data)})"

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
            No report there, or not one as its schema says.
        """
        path = Path(folder) / "report.json"
        data = read_json(path, _WAY_OUT, "report", "picture")
        if data["schema"] != SCHEMA:
            raise FileError(
                f"{path}: is of a picture without a scene; take one of its EIAs, such as "
                f"{path.parent / 'eia'}, with --display"
            )
        try:
            _check_names(data)
            return cls(path.parent, from_strict(data))
        except ValueError as error:
            raise FileError(f"{path}: {error}; {_WAY_OUT}") from None

    def design(self) -> Display:
        """The display as designed.

        Raises
        ------
        FileError
            The report's parameters describe no possible display.
        """
        try:
            return Display(**self.data["display"]["given"])
        except InimError as error:
            raise FileError(f"{self.folder / 'report.json'}: {error}; {_WAY_OUT}") from None

    def eia_path(self, name: str, option: str, *, true: str = TRUTH) -> Path:
        """The EIA of an algorithm, or the true one, linear.

        Parameters
        ----------
        name : str
        option : str
            What named it.
        true : str
            What names the true one.

        Raises
        ------
        UsageError
            The report has no such algorithm.
        """
        names = [true, *self.data["algorithms"]]
        if name not in names:
            raise UsageError(f"{option} {name}: {known_words(name, names)}")
        place = ("truth", "eia") if name == true else ("eia", name)
        return Path(self.folder, place[0], f"{place[1]}.exr")

    def write(self, cache: ResultCache | None = None) -> None:
        """Write all four forms into the folder, `report.json` last: it marks a whole report.

        Parameters
        ----------
        cache : ResultCache, optional
            Of the page's pictures.
        """
        from inim.report.sections import render_html
        from inim.report.summary import render_junit, render_summary

        forms = {
            "report.html": lambda data: render_html(data, self.folder, cache),
            "junit.xml": render_junit,
            "summary.md": render_summary,
        }
        write_forms(self.data, self.folder, "report.json", forms)

    def _repr_html_(self) -> str | None:
        """The page in a frame of its own: its styles must not reach the notebook around it.

        Scripts run in it, so that the virtual display is live, but in an origin of its own: they
        cannot reach the notebook's page, cookies or kernel, nor open windows, and the page's
        policy allows no script but the report's.
        """
        try:
            page = read_file(self.html_path, _MOST_PAGE_BYTES).decode("utf-8")
        except (FileError, ValueError):
            return None
        # Without a base of its own, a framed page's links are relative to the notebook.
        page = page.replace("<head>", '<head><base href="about:srcdoc">', 1)
        return (
            f'<iframe srcdoc="{escape(page)}" title="inim report" sandbox="allow-scripts" '
            f'style="width:100%;height:{_NOTEBOOK_HEIGHT_PX}px;border:0"></iframe>'
        )


def _check_names(data: Mapping[str, Any]) -> None:
    """Raise ValueError for a name that leads out of the folder, or a view from nowhere.

    Algorithms and viewpoints name files; scores are of the report's own viewpoints.
    """
    viewpoints = {one["name"] for one in data["viewpoints"]}
    for name in (*viewpoints, *data["algorithms"]):
        if not name or name.startswith(".") or any(c in "/\\" or not c.isprintable() for c in name):
            raise ValueError(f"{name[:40]!a} names no file of the report")
    scored = {f"algorithms.{n}": one for n, one in data["algorithms"].items()}
    for place, one in {**scored, "ceiling": data["ceiling"]}.items():
        for name in (*one["views"], *one["precision"]):
            if name not in viewpoints:
                raise ValueError(f"{place}: has scores of {name[:40]!a}, which is no viewpoint")
