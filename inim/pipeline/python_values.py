"""What the command line takes as text, written from Python values.

A request is text: it travels to a worker, decides cache keys, and becomes the command that repeats
it. So Python values are written as that text, here and nowhere else.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from numbers import Integral, Real
from os import PathLike
from pathlib import Path
from typing import Any

from inim.display import DISPLAYS, Display
from inim.display.viewpoint import Viewpoint
from inim.errors import UsageError
from inim.scene.file import read_scene_settings
from inim.settings import DISPLAY_KEYS, PREFIX, Settings

_PUPIL = ("pupil_mm", "focus_mm")


def request_values(
    scene: Path,
    *,
    definitions: Mapping[str, Any] | None,
    display: str | Path | Display | None,
    algorithms: Any,
    viewpoints: Any,
    lens_model: str | None,
    misalign: Any,
) -> dict[str, Any]:
    """The texts of a request: what `inim.validate` takes, as `Request` has it.

    Parameters
    ----------
    scene : Path
        Whose settings a display or an eye has to override.
    definitions, display, algorithms, viewpoints, lens_model, misalign :
        See `inim.validate`.

    Raises
    ------
    UsageError
        A value of a wrong type, or one that the scene's settings leave no way to state.
    """
    given = _definitions_text(definitions)
    if isinstance(display, PathLike):
        display = str(path("display", display))
    name = _word("display", display) if not isinstance(display, Display) else None
    if isinstance(display, Display):
        name, settings = _display_text(display, scene, given)
        given |= settings
    eyes, pupil = _viewpoints_text(viewpoints)
    if pupil is not None:
        given |= _pupil_text(pupil, scene, given)
    return {
        "definitions": tuple(f"{key}={text}" for key, text in given.items()),
        "display": name,
        "algorithms": _algorithms_text(algorithms),
        "viewpoints": eyes,
        "lens_model": _word("lens_model", lens_model),
        "misalign": _misalign_text(misalign),
    }


def _definitions_text(definitions: Mapping[str, Any] | None) -> dict[str, str]:
    """`-D` items: names and texts or numbers.

    Raises
    ------
    UsageError
        Not a mapping, or a value that is neither.
    """
    if definitions is None:
        return {}
    if not isinstance(definitions, Mapping):
        raise UsageError(
            f"definitions: is a {type(definitions).__name__}; give a mapping such as "
            "{'inim.pitch_mm': 0.5}"
        )
    return {str(key): _scalar(f"definitions[{key!r}]", value) for key, value in definitions.items()}


def _algorithms_text(algorithms: Any) -> str | None:
    """Algorithms with their options, separated by commas.

    Parameters
    ----------
    algorithms : str, sequence or mapping, optional
        The text itself; names, with options or without, such as ``"template:samples=2"``; or
        options by name, ``{"template": {"samples": 2}, "wang2024": {}}``. A sequence may hold
        mappings.

    Raises
    ------
    UsageError
        Anything else.
    """
    return _listed("algorithms", algorithms, _algorithms_of)


def _algorithms_of(what: str, one: Any) -> list[str]:
    if not isinstance(one, Mapping):
        return [_text(what, one)]
    texts = []
    for name, options in one.items():
        if not isinstance(options, Mapping):
            raise UsageError(
                f"{what}[{name!r}]: is a {type(options).__name__}; give options as a mapping, "
                "which may be empty"
            )
        items = (f"{key}={_scalar(f'{what}[{name!r}]', value)}" for key, value in options.items())
        texts.append(":".join([str(name), *items]))
    return texts


def _misalign_text(misalign: Any) -> str | None:
    """How far an array is off, ``"rotation_deg=0.5"`` or ``{"rotation_deg": 0.5}``, as text.

    Raises
    ------
    UsageError
        Neither text nor mapping.
    """
    if isinstance(misalign, Mapping):
        return ", ".join(f"{key}={_scalar('misalign', value)}" for key, value in misalign.items())
    return _word("misalign", misalign)


def paths(what: str, given: Any) -> tuple[Path, ...]:
    """A path, or several.

    Raises
    ------
    UsageError
        What is no path.
    """
    several = [given] if isinstance(given, (str, PathLike)) else given
    if not isinstance(several, Iterable):
        raise UsageError(f"{what}: is a {type(given).__name__}; give a path, or a list of them")
    return tuple(path(what, one) for one in several)


def path(what: str, given: Any) -> Path:
    """A path.

    Raises
    ------
    UsageError
        What is none.
    """
    if not isinstance(given, (str, PathLike)):
        raise UsageError(f"{what}: is a {type(given).__name__}; give a path")
    return Path(given)


def _viewpoints_text(viewpoints: Any) -> tuple[str | None, Viewpoint | None]:
    """Viewpoints, separated by commas; and one of those that are values, whose pupil all have."""
    several = (
        viewpoints if isinstance(viewpoints, Sequence) and not isinstance(viewpoints, str) else ()
    )
    eyes = [one for one in (*several, viewpoints) if isinstance(one, Viewpoint)]
    if len({(eye.pupil_mm, eye.focus_mm) for eye in eyes}) > 1:
        raise UsageError("viewpoints: have different pupils or focus; a run has one for all")
    return _listed("viewpoints", viewpoints, _viewpoints_of), eyes[0] if eyes else None


def _viewpoints_of(what: str, one: Any) -> list[str]:
    if isinstance(one, Viewpoint):
        return [f"{one.name}={' '.join(_number(value) for value in one.position_mm)}"]
    return [_text(what, one)]


def _pupil_text(eye: Viewpoint, scene: Path, given: Mapping[str, str]) -> dict[str, str]:
    """The settings that give all eyes this one's pupil and focus."""
    settings = _settings(scene, given)
    texts = {}
    for name in _PUPIL:
        wanted, found = getattr(eye, name), getattr(settings, name)
        # A pinhole has no focus.
        if wanted == found or (name == "focus_mm" and not eye.pupil_mm):
            continue
        key = f"{PREFIX}{name}"
        if wanted is None or key in given:
            raise UsageError(f"viewpoint {eye.name}: {name} = {wanted}, and {key} is {found}")
        texts[key] = _number(wanted)
    return texts


def _display_text(
    display: Display, scene: Path, given: Mapping[str, str]
) -> tuple[str, dict[str, str]]:
    """A preset and the settings that make it this display, in this scene: the fewest that do."""
    stated = {key: getattr(display, key) for key in DISPLAY_KEYS}
    twice = [key for key in DISPLAY_KEYS if f"{PREFIX}{key}" in given]
    if twice:
        raise UsageError(
            f"display: is a Display, and definitions set {PREFIX}{twice[0]}; use display.replace"
        )
    found = _settings(scene, given)
    set_by_scene = {key for key in DISPLAY_KEYS if getattr(found, key) is not None}
    ways = []
    for name, preset in DISPLAYS.items():
        base = {key: getattr(preset, key) for key in DISPLAY_KEYS}
        differing = {key for key in DISPLAY_KEYS if stated[key] != base[key]} | set_by_scene
        ways += [(name, differing), (name, set(DISPLAY_KEYS))]
    for name, keys in sorted(ways, key=lambda way: len(way[1])):
        # What is None cannot be stated; it may be so anyway.
        values = {
            key: stated[key] for key in DISPLAY_KEYS if key in keys and stated[key] is not None
        }
        made = replace(found, display=name, **values).make_display(str(scene))
        if made.replace(name=display.name) == display:
            return name, {f"{PREFIX}{key}": _number(value) for key, value in values.items()}
    open_ones = ", ".join(f"{PREFIX}{k}" for k in sorted(set_by_scene) if stated[k] is None)
    raise UsageError(
        f"display: the scene sets {open_ones}, which the Display leaves open; give it a value"
    )


def _settings(scene: Path, given: Mapping[str, str]) -> Settings:
    return Settings.parse(read_scene_settings(scene, given), str(scene))


def _listed(what: str, given: Any, texts: Any) -> str | None:
    """Text as it is, or the texts of one value or several, separated by commas."""
    if given is None or isinstance(given, str):
        return given
    several = given if isinstance(given, Sequence) else [given]
    if not several:
        raise UsageError(f"{what}: none given; leave it out, or name at least one")
    return ",".join(text for one in several for text in texts(what, one))


def _word(what: str, given: Any) -> str | None:
    return None if given is None else _text(what, given)


def _text(what: str, given: Any) -> str:
    if isinstance(given, str):
        return given
    raise UsageError(
        f"{what}: {given!r} is a {type(given).__name__}; see inim.validate for its types"
    )


def _scalar(what: str, given: Any) -> str:
    """Text, or a number's."""
    if isinstance(given, bool) or not isinstance(given, (str, Real, PathLike)):
        raise UsageError(f"{what}: {given!r} is a {type(given).__name__}; give text or a number")
    return _number(given) if isinstance(given, Real) else str(given)


def _number(value: Any) -> str:
    """Shortest text that is read as the same number; words stay words."""
    if isinstance(value, str):
        return value
    if isinstance(value, Integral) or (float(value).is_integer() and abs(value) < 1e15):
        return str(int(value))
    return repr(float(value))
