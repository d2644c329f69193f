"""Display files: XML with the `inim.*` settings of a display."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from inim.display import Display
from inim.errors import UsageError
from inim.files.image import write_atomically
from inim.settings import DISPLAY_KEYS, PREFIX, Settings, value_text


def display_xml(
    values: Mapping[str, str], comments: Mapping[str, str] | None = None, about: Sequence[str] = ()
) -> str:
    """Display file with the texts of settings, and a comment after some of them.

    `about` are lines of XML before the settings.
    """
    lines = ['<scene version="3.0.0">', *about]
    for key, text in values.items():
        comment = f" <!-- {comments[key]} -->" if comments and key in comments else ""
        lines.append(f'    <default name="{PREFIX}{key}" value="{text}"/>{comment}')
    return "\n".join([*lines, "</scene>"]) + "\n"


def save_display(display: Display, path: Path) -> None:
    """Write a display file: the nearest preset, and the parameters that differ from it."""
    if path.suffix.lower() != ".xml":
        raise UsageError(f"{path}: a display file is an .xml; name it {path.stem}.xml")
    settings = Settings().with_display(display)
    values = {key: getattr(settings, key) for key in ("display", *DISPLAY_KEYS)}
    xml = display_xml({k: value_text(k, v) for k, v in values.items() if v is not None})
    write_atomically(path, lambda temporary: temporary.write_text(xml, encoding="utf-8"))
