"""The virtual display on a page of its own: `inim view`."""

from __future__ import annotations

from importlib import resources

from inim.report.markup import element, section, text
from inim.report.scripts import script_element, script_policy
from inim.report.virtual_display.body import ANCHOR, TITLE
from inim.report.virtual_display.scripts import script, style
from inim.version import __version__

__all__ = ["display_page"]

_POLICY = (
    f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; {script_policy([script()])}; "
    "base-uri 'none'; form-action 'none'"
)


def display_page(title: str, facts: str, content: str) -> str:
    """One HTML file that needs nothing else.

    Parameters
    ----------
    title, facts : str
        Plain text: what is shown, and on which display.
    content : str
        HTML, from `inim.report.virtual_display.body.live_display`.
    """
    sheet = resources.files("inim.report").joinpath("report.css").read_text("utf-8") + style()
    head = element("h1", text(title)) + element("p", text(facts), class_="facts")
    footer = element("footer", element("p", text(f"inim {__version__}")))
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{text(_POLICY)}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<title>{text(title)} – inim virtual display</title>\n<style>\n{sheet}</style>\n</head>\n"
        f"<body>\n{element('header', element('div', head))}\n"
        f"<main>\n{section(ANCHOR, TITLE, content)}\n</main>\n{footer}\n"
        f"{script_element(script())}\n</body>\n</html>\n"
    )
