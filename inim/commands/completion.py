"""What a shell proposes while a command is typed; argcomplete does all but the words of options."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable

import argcomplete

Completer = Callable[..., list[str]]


def complete(parser: argparse.ArgumentParser) -> None:
    """Answer a shell's question about the line being typed, and exit."""
    for own in _parsers(parser):
        for action in own._actions:
            for option in action.option_strings:
                if option in _WORDS:
                    action.completer = _completer(_WORDS[option])  # type: ignore[attr-defined]
    argcomplete.autocomplete(parser)


def _parsers(parser: argparse.ArgumentParser) -> Iterable[argparse.ArgumentParser]:
    """A parser and those of its commands."""
    yield parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for own in action.choices.values():
                yield from _parsers(own)


def _completer(words: Callable[[], Iterable[str]]) -> Completer:
    """Proposes words; in a list with commas, one more."""

    def propose(prefix: str, **_: object) -> list[str]:
        before, comma, _last = prefix.rpartition(",")
        return [f"{before}{comma}{word}" for word in words()]

    return propose


def _algorithms() -> Iterable[str]:
    from inim.generators import algorithm_names

    return algorithm_names()


def _displays() -> Iterable[str]:
    from inim.display import DISPLAYS

    return DISPLAYS


def _lens_models() -> Iterable[str]:
    from inim.lens import lens_models

    return lens_models()


def _viewpoints() -> Iterable[str]:
    from inim.display.viewpoint import DEFAULT_VIEWPOINTS

    return DEFAULT_VIEWPOINTS


def _settings() -> Iterable[str]:
    from dataclasses import fields

    from inim.settings import PREFIX, Settings

    return [f"{PREFIX}{field.name}=" for field in fields(Settings)]


_WORDS: dict[str, Callable[[], Iterable[str]]] = {
    "--algorithms": _algorithms,
    "--display": _displays,
    "--lens-model": _lens_models,
    "--viewpoints": _viewpoints,
    "-D": _settings,
}
