"""Command line: `inim COMMAND ...`.

The commands are those of this package and of the applications (`inim.apps`). A command's module has
one or several commands in its `COMMANDS`. Only the module of the requested command is imported, and
its `run` imports large packages, so that `--help` is fast.
"""

import argparse
import io
import os
import shlex
import sys
import traceback
from collections.abc import Iterable
from contextlib import nullcontext
from functools import partial
from importlib import import_module
from textwrap import fill
from typing import Any, NoReturn

from inim.apps import APPS, COMPARISONS, FIRST, GROUPS, INFORMATION
from inim.pipeline.options import EXIT_CODES, Command, print_warning
from inim.system.errors import EXIT_PASSED, EXIT_USAGE, InimError, suggest_words, unexpected_error
from inim.system.process.interrupts import delayed_interrupts, raise_again
from inim.system.process.machine import check_memory
from inim.system.process.printing import quiet_libraries
from inim.system.process.python_process import configuration_hidden
from inim.system.version import __version__

# Commands of this package, with their groups in the help and their modules.
_OWN = {
    "demo": (FIRST, "inim.cli.validate"),
    "new-scene": (FIRST, "inim.cli.new_scene"),
    "validate": (FIRST, "inim.cli.validate"),
    "compare": (COMPARISONS, "inim.cli.validate"),
    "accept": (COMPARISONS, "inim.cli.validate"),
    "figure": (COMPARISONS, "inim.cli.validate"),
    "info": (INFORMATION, "inim.cli.info"),
}
_TABLE = _OWN | {
    name: (group, f"inim.apps.{folder}.command")
    for folder, app in APPS.items()
    for name, group in app["commands"].items()
}
#: Commands, with their modules.
COMMANDS = {name: module for name, (_, module) in _TABLE.items()}

_DEBUG = "--debug"
_DESCRIPTION = (
    "Simulate integral-imaging displays. An elemental image array (EIA) is the image on the panel\n"
    "behind the lens array."
)


class _Parser(argparse.ArgumentParser):
    """One line per mistake instead of a page of usage."""

    #: Command named in errors, if not this parser's own.
    about = ""

    def error(self, message: str) -> NoReturn:
        print_warning(f"{message}; see {self.about or self.prog} --help", "error")
        self.exit(EXIT_USAGE)


@configuration_hidden()
def main(argv: list[str] | None = None) -> int:
    """Run one command and return its exit code.

    * `argv`: arguments after the program's name; the process's own otherwise.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a name must not fail for the terminal's encoding
            stream.reconfigure(errors="backslashreplace")
    for number in range(3):  # closed ones would be handed out again, to pipes and files
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
    typed = sys.argv[1:] if argv is None else argv
    argv = [word for word in typed if word != _DEBUG]  # an option of every command, in any place
    if "_ARGCOMPLETE" in os.environ:  # a shell asks how a word goes on
        _complete(_parser(None))
    if not argv:
        argv = ["--help"]
    parser = _parser(argv[0])
    if argv[0] not in COMMANDS and not argv[0].startswith("-"):
        suggestion = suggest_words(argv[0], COMMANDS, f"there are {', '.join(COMMANDS)}")
        parser.error(f"{argv[0]}: no such command; {suggestion}")
    args, unknown = parser.parse_known_args(argv)
    args.command_line = shlex.join(["inim", *argv])
    args.debug |= _DEBUG in typed
    try:
        if unknown:
            getattr(args, "explain_unknown", lambda *_: None)(args, unknown)
            parser.error(f"unrecognized arguments: {' '.join(unknown)}")
        check_memory()  # before large libraries load, which would never end
        with delayed_interrupts():  # an exception during its import is a segmentation fault
            import_module("msgspec")
        with nullcontext() if args.debug else quiet_libraries():
            return int(args.run(args))
    except InimError as error:
        if args.debug and error.__cause__:
            traceback.print_exception(error.__cause__)
        print_warning(str(error), "error")
        return error.exit_code
    except BrokenPipeError:  # the reader of the output has ended
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_PASSED
    except Exception as error:
        raise_again()
        if args.debug:
            raise
        unexpected = unexpected_error(error)
        print_warning(str(unexpected), "error")
        return unexpected.exit_code


def _parser(named: str | None) -> argparse.ArgumentParser:
    """Parser of the named command, or of all commands."""
    layout: dict[str, Any] = {
        "formatter_class": argparse.RawDescriptionHelpFormatter,
        "epilog": EXIT_CODES,
    }
    parser = _Parser(prog="inim", description=_DESCRIPTION, **layout)
    if named not in COMMANDS:
        parser.epilog = f"{_command_list()}\n{EXIT_CODES}"
    parser.add_argument("--version", action="version", version=f"inim {__version__}")
    help_text = "show tracebacks of internal errors; may also follow the command"
    parser.add_argument(_DEBUG, action="store_true", help=help_text)
    # argparse keeps the type of what add_subparsers returns to itself.
    commands: Any = parser.add_subparsers(required=True, metavar="COMMAND")
    if named in COMMANDS:
        parser.about = f"inim {named}"
    for name in [named] if named in COMMANDS else COMMANDS:
        command = _command(name)
        description = f"{command.summary[0].upper()}{command.summary[1:]}."
        own = commands.add_parser(name, description=description, **layout)
        command.add_arguments(own)
        own.usage = _usage(own)
        own.description = f"{fill(own.description)}\n\nexample:\n  {command.example}"
        own.set_defaults(run=command.run)
    return parser


# Usage of a positional argument, by its number of values.
_REPEATED = {"?": "[{}]", "+": "{} ...", "*": "[{} ...]", argparse.PARSER: "{} ..."}


def _usage(parser: argparse.ArgumentParser) -> str:
    """Usage in one line; the help lists the options."""
    words = [
        _REPEATED.get(str(action.nargs), "{}").format(action.metavar or action.dest)
        for action in parser._actions
        if not action.option_strings
    ]
    return " ".join([parser.prog, "[options]", *words])


def _command(name: str) -> Command:
    """Import a command from its module."""
    command: Command = import_module(COMMANDS[name]).COMMANDS[name]
    return command


def _command_list() -> str:
    """Commands and their summaries, by group."""
    lines = []
    for title in GROUPS:
        names = [name for name, (group, _) in _TABLE.items() if group == title]
        lines += [f"{title}:", *(f"  {name:<10} {_command(name).summary}" for name in names), ""]
    return "\n".join(lines)


def _complete(parser: argparse.ArgumentParser) -> None:
    """Answer a shell's question about the line being typed, and exit."""
    import argcomplete

    for own in _parsers(parser):
        for action in own._actions:
            if action.dest in _WORDS:
                action.completer = partial(_propose, action.dest)  # type: ignore[attr-defined]
    argcomplete.autocomplete(parser)


def _parsers(parser: argparse.ArgumentParser) -> Iterable[argparse.ArgumentParser]:
    """A parser and those of its commands."""
    yield parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for own in action.choices.values():
                yield from _parsers(own)


def _propose(argument: str, prefix: str, **_: object) -> list[str]:
    """Words for an argument; in a list with commas, for its last item."""
    from argcomplete.completers import FilesCompleter

    from inim.display.settings import PREFIX

    before, comma, _last = prefix.rpartition(",")
    module, name = _WORDS[argument]
    words = getattr(import_module(module), name)
    if argument == "definitions":
        words = [f"{PREFIX}{field}=" for field in words.__dataclass_fields__]
    if argument == "display":
        words = [*words, *FilesCompleter(("xml", "json"))(prefix)]
    return [f"{before}{comma}{word}" for word in (words() if callable(words) else words)]


# Module and name of an argument's words, or of a function that returns them.
_WORDS = {
    "algorithms": ("inim.generators", "algorithm_names"),
    "display": ("inim.display", "DISPLAYS"),
    "lens_model": ("inim.display.lens", "lens_models"),
    "viewpoints": ("inim.display.viewpoint", "DEFAULT_VIEWPOINTS"),
    "definitions": ("inim.display.settings", "Settings"),
}
