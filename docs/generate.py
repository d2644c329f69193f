"""Pages made of the program itself: settings, commands, algorithms, sweep columns, documents.

`python docs/generate.py` writes them into docs/generated, as each build of the site does first.
"""

from __future__ import annotations

import argparse
import os
from importlib import import_module
from pathlib import Path

from inim.cli import COMMANDS
from inim.pipeline.method import algorithm_table
from inim.settings import setting_table
from inim.sweep.table import columns_as_markdown

__all__ = ["write"]


def write(docs: Path) -> None:
    """Write every generated page below `docs`/generated."""
    folder = docs / "generated"
    folder.mkdir(exist_ok=True)
    for name, text in {
        "settings.md": setting_table(),
        "commands.md": _commands(),
        "algorithms.md": f"```text\n{algorithm_table()}\n```",
        "sweep-columns.md": columns_as_markdown(),
    }.items():
        path, text = folder / name, text.rstrip() + "\n"
        if not path.exists() or path.read_text("utf-8") != text:  # else pages are made anew
            path.write_text(text, "utf-8")


def _commands() -> str:
    """The help of every command, as its parser prints it."""
    os.environ["COLUMNS"] = "88"
    parts = []
    for name, module in COMMANDS.items():
        command = import_module(f"inim.commands.{module}").COMMANDS[name]
        parser = argparse.ArgumentParser(prog=f"inim {name}")
        command.add_arguments(parser)
        parts.append(f"## inim {name}\n\n{command.summary}\n\n```text\n{parser.format_help()}```\n")
    return "\n".join(parts)


if __name__ == "__main__":
    write(Path(__file__).parent)
