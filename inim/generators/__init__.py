"""Generators: from one RGB-D picture to an elemental image array.

A generator is one file with one function, ``prepare(display, shape, pixel_mm, **options)``, which
returns a `Generator`, and one line in `GENERATORS`. Other packages announce theirs through the
entry-point group ``inim.generators``, by the same function::

    [project.entry-points."inim.generators"]
    mine = "my_package.eia:prepare"

One whose `prepare` also has a parameter ``mask`` is given which panel pixels are asked for, and
need make no others; see `prepare` here.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from importlib import import_module, metadata
from pathlib import Path
from typing import Any

import numpy as np

from inim.backend.numba_cache import settle_cache
from inim.display import Display
from inim.errors import UsageError
from inim.generators.base import Generator, PictureShape, SourceGenerator, check_mask
from inim.generators.sources import HOLE, NO_LENS, NOT_ASKED, Sources, colour_of, hole_fraction
from inim.rgbd import RGBD

__all__ = [
    "GENERATORS",
    "HOLE",
    "NOT_ASKED",
    "NO_LENS",
    "PICKUP",
    "Generator",
    "SourceGenerator",
    "Sources",
    "algorithm_names",
    "algorithm_summary",
    "check_algorithm",
    "colour_of",
    "find_sources",
    "generate",
    "hole_fraction",
    "parse_algorithm",
    "prepare",
]

Prepare = Callable[..., Generator]

# Before any of the modules below is imported: numba would refuse to where nothing can be written.
settle_cache(Path(__file__).parent)

# Loaded when used: numba takes half a second to import, and not every run needs it.
GENERATORS: dict[str, str] = {
    "template": "inim.generators.template",
    "layered": "inim.generators.layered",
    "li2012": "inim.generators.li2012",
    "gu2020": "inim.generators.gu2020",
    "wang2024": "inim.generators.wang2024",
    "template_jit": "inim.render.template_jit",
}
_ENTRY_POINTS = "inim.generators"
#: Ray tracing the scene itself, which a validation can score beside the generators.
PICKUP = "pickup"
# The parameter of a `prepare` that is no option of the algorithm.
_MASK = "mask"


def algorithm_names() -> list[str]:
    """All generators there are: the project's own, then those other packages announce."""
    others = sorted({point.name for point in metadata.entry_points(group=_ENTRY_POINTS)})
    return [*GENERATORS, *(n for n in others if n not in GENERATORS and n != PICKUP)]


def algorithm_summary(name: str) -> tuple[str, str]:
    """How to write a generator with all its options' defaults, and its docstring's first line.

    Raises
    ------
    UsageError
        Unknown, or cannot be loaded.
    """
    found = _find(name)
    unsaid = (inspect.Parameter.empty, None)
    defaults = ((p.name, "..." if p.default in unsaid else p.default) for p in _options(found))
    written = ":".join([name, *(f"{key}={value}" for key, value in defaults)])
    return written, (inspect.getdoc(found) or "").partition("\n")[0]


def parse_algorithm(text: str) -> tuple[str, dict[str, str]]:
    """An algorithm with options, ``name`` or ``name:key=value:key=value``.

    Raises
    ------
    UsageError
        An option without a value, or given twice.
    """
    name, *items = (part.strip() for part in text.split(":"))
    options: dict[str, str] = {}
    for item in items:
        key, equals, value = item.partition("=")
        if not (equals and key.strip() and value.strip()):
            raise UsageError(f"algorithm {text!r}: write options as name:key=value")
        if key.strip() in options:
            raise UsageError(f"algorithm {text!r}: option {key.strip()!r} is given twice; drop one")
        options[key.strip()] = value.strip()
    return name, options


def check_algorithm(text: str) -> None:
    """Raise `UsageError` unless a generator of that name exists and has those options."""
    name, options = parse_algorithm(text)
    if name not in GENERATORS or options:
        _check_options(name, _find(name), options)


def _find(name: str) -> Prepare:
    """The `prepare` of a name.

    Raises
    ------
    UsageError
        Unknown, announced twice, or an announced one that cannot be loaded.
    """
    if name in GENERATORS:
        prepare_own: Prepare = import_module(GENERATORS[name]).prepare
        return prepare_own
    if name == PICKUP:
        raise UsageError(f"algorithm {name!r} needs the scene, not a picture: use `inim validate`")
    points = list(metadata.entry_points(group=_ENTRY_POINTS, name=name))
    if not points:
        raise UsageError(f"algorithm {name!r}: use {' or '.join(algorithm_names())}")
    if len({point.value for point in points}) > 1:
        raise UsageError(
            f"algorithm {name!r} is announced by several packages "
            f"({', '.join(sorted(point.value for point in points))}); uninstall all but one"
        )
    try:
        announced: Prepare = points[0].load()
        _options(announced)
    except (Exception, SystemExit) as error:
        raise UsageError(
            f"algorithm {name!r} ({points[0].value}) cannot be loaded: "
            f"{type(error).__name__}: {error}"
        ) from error
    return announced


def _options(prepare_one: Prepare) -> list[inspect.Parameter]:
    """What can be written after an algorithm's name: `prepare`'s parameters after the first three.

    Without the mask, which is not the algorithm's.
    """
    parameters = list(inspect.signature(prepare_one).parameters.values())[3:]
    return [p for p in parameters if p.name != _MASK]


def _check_options(name: str, prepare_one: Prepare, options: dict[str, Any]) -> None:
    known = _options(prepare_one)
    if any(p.kind is inspect.Parameter.VAR_KEYWORD for p in known):
        return
    names = [p.name for p in known]
    for key in options:
        if key not in names:
            has = f"its options are {', '.join(names)}" if names else "it has none"
            raise UsageError(f"algorithm {name!r} has no option {key!r}; {has}")


def prepare(
    display: Display,
    algorithm: str = "template",
    *,
    shape: PictureShape,
    pixel_mm: float,
    mask: np.ndarray | None = None,
    **options: Any,
) -> Generator:
    """A generator ready for pictures of one size on one display; reusable for a stream of them.

    Parameters
    ----------
    display : Display
    algorithm : str
        One of `algorithm_names`, with options if need be: ``"template:samples=4"``.
    shape : (rows, columns)
        Of the pictures to come.
    pixel_mm : float
        Their pixel.
    mask : (rows, columns) bool, optional
        Panel pixels asked for. They show what they would without it, bit for bit; the others are
        black, with alpha 0, and `NOT_ASKED` among sources. `template`, `layered`, `gu2020` and
        `wang2024` do the work of these pixels only; others are run in full.
    **options
        The algorithm's own; see its module.

    Raises
    ------
    UsageError
        Unknown algorithm or option, an option's value that makes no sense, or a mask that is not
        the panel's.
    """
    name, written = parse_algorithm(algorithm)
    found = _find(name)
    merged = {**written, **options}
    _check_options(name, found, merged)
    knows = mask is not None and _MASK in inspect.signature(found).parameters
    if mask is not None:
        check_mask(mask, display)
        merged |= {_MASK: mask} if knows else {}
    made = found(display, tuple(shape), float(pixel_mm), **merged)
    if not isinstance(made, Generator):
        raise UsageError(f"algorithm {name!r} made a {type(made).__name__}, which cannot generate")
    if mask is None or knows:
        return made
    from inim.generators.raycast.pixel_mask import masked

    return masked(made, mask)


def find_sources(
    rgbd: RGBD, display: Display, algorithm: str = "template", **options: Any
) -> Sources:
    """Which pixel of the picture each panel pixel shows at its centre.

    Parameters
    ----------
    rgbd : RGBD
        Picture of H x W pixels in the display frame.
    display : Display
    algorithm, **options :
        See `prepare`.

    Returns
    -------
    (rows, columns) int32
        ``row * W + column``, `HOLE` where the ray meets nothing, `NO_LENS` outside the array, and
        `NOT_ASKED` outside a mask.

    Raises
    ------
    UsageError
        As `prepare`; or the algorithm does not say where its colours come from.
    """
    made = prepare(display, algorithm, shape=rgbd.shape, pixel_mm=rgbd.pixel_mm, **options)
    if not isinstance(made, SourceGenerator):
        raise UsageError(f"algorithm {algorithm!r} does not say where its colours come from")
    return made.sources(rgbd)


def generate(
    rgbd: RGBD,
    display: Display,
    algorithm: str = "template",
    *,
    out: np.ndarray | None = None,
    **options: Any,
) -> np.ndarray:
    """The elemental image array of a picture, in its colour's type.

    Parameters
    ----------
    rgbd : RGBD
        Colour and depth in the display frame: float32 linear RGB (verification) or uint8 sRGB RGBA
        (display-ready).
    display : Display
    algorithm : str
        One of `algorithm_names`, with options if need be: ``"template:samples=4"``.
    out : array, optional
        Where to write the result.
    **options
        The algorithm's own; see its module.

    Returns
    -------
    (rows, columns, 3) float32 linear RGB, black at holes and outside the array; or
    (rows, columns, 4) uint8 sRGB, alpha 0 there. Use `find_sources` where black must be told from
    nothing in linear RGB.

    Raises
    ------
    UsageError
        As `prepare`, or an `out` that does not fit.
    """
    made = prepare(display, algorithm, shape=rgbd.shape, pixel_mm=rgbd.pixel_mm, **options)
    return made.generate(rgbd, out)


from typing import NamedTuple  # noqa: E402


class AlgorithmProperties(NamedTuple):
    """Temporary."""

    name: str
    own: bool
    exact: bool
    reads_layers: bool


def properties(text: str) -> AlgorithmProperties:
    """Temporary."""
    name = parse_algorithm(text)[0]
    return AlgorithmProperties(name, name in GENERATORS, name == "template", name == "layered")
