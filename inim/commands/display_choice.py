"""The display a command is told with --display and -D, for commands without a scene."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from inim.errors import SceneError

if TYPE_CHECKING:
    import argparse

    from inim.display import Display
    from inim.settings import Settings

__all__ = ["add_display_arguments", "chosen_display"]


def add_display_arguments(parser: argparse.ArgumentParser) -> None:
    """Add --display and -D."""
    parser.add_argument(
        "--display", help="a preset, nominal or phone, or an .xml with inim.* settings"
    )
    parser.add_argument(
        "-D",
        dest="definitions",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="override an inim.* setting of the display; may be repeated",
    )


def chosen_display(
    display: str | None, definitions: list[str], command: str
) -> tuple[Display, Settings]:
    """The display as designed, and all settings.

    Parameters
    ----------
    display : str or None
        A preset, or the path of an XML file with `inim.*` settings; None: the settings' default.
    definitions : list of str
        `KEY=VALUE` overrides.
    command : str
        What to name in an error where there is no file.

    Raises
    ------
    InimError
        Unknown settings, or values that describe no possible display.
    """
    from inim.scene.file import parse_definitions, read_scene_file
    from inim.settings import PREFIX, Settings

    given = parse_definitions(definitions)
    if display is not None and display.lower().endswith(".xml"):
        settings = Settings.parse(read_scene_file(Path(display), given).settings, display)
        return settings.make_display(display), settings
    for key in given:
        if not key.startswith(PREFIX):
            raise SceneError(f"-D {key}: a display has inim.* settings only; see `inim settings`")
    if display is not None:
        given = {f"{PREFIX}display": display} | given
    settings = Settings.parse(given, command)
    return settings.make_display(command), settings
