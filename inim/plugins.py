"""Plugins: entry points of other packages, modules of Mitsuba plugins, and errors that name them.

Generators, metrics and lens models of other packages are entry points of the groups
``inim.generators``, ``inim.metrics`` and ``inim.lens_models``.
"""

from __future__ import annotations

import hashlib
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib import import_module, metadata, util
from pathlib import Path
from typing import Any

from inim.errors import FileError, InimError, OutOfMemoryError, UsageError


def announced_names(group: str) -> list[str]:
    """Names that other packages register in an entry-point group, sorted, each once.

    A process looks once in each search path: reading all packages' metadata takes 4 ms, and every
    score asks for the metrics.
    """
    return list(_announced_names(group, tuple(sys.path)))


@cache
def _announced_names(group: str, _search_path: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(sorted({point.name for point in metadata.entry_points(group=group)}))


def load(group: str, name: str, kind: str, make: Callable[[Any], Any] = lambda value: value) -> Any:
    """Load the object of an entry point and convert it with `make`, whose errors count as its own.

    The name must be registered; `kind` is the kind of plugin for messages: "metric". Raises
    `UsageError` if several packages register the name, or if it cannot be imported.
    """
    points = list(metadata.entry_points(group=group, name=name))
    values = sorted({point.value for point in points})
    if len(values) > 1:
        raise UsageError(
            f"{kind} {name!r} is registered by several packages ({', '.join(values)}); "
            "uninstall all but one"
        )
    try:
        return make(points[0].load())
    except (Exception, SystemExit) as error:
        raise UsageError(
            f"{kind} {name!r} ({values[0]}) cannot be loaded: {type(error).__name__}: "
            f"{' '.join(str(error).split())[:400]}"
        ) from error


def identity(group: str, name: str) -> dict[str, str]:
    """Identity of a plugin's state: entry point, version, SHA-256 of its module.

    The hash detects changes of the file without a new version.
    """
    point = next(iter(metadata.entry_points(group=group, name=name)))
    record = {"entry_point": point.value}
    if point.dist is not None:
        record["version"] = point.dist.version
    spec = util.find_spec(point.module)
    if spec is not None and spec.origin is not None:
        record["sha256"] = hashlib.sha256(Path(spec.origin).read_bytes()).hexdigest()
    return record


@contextmanager
def attribute_errors(group: str, kind: str, name: str) -> Iterator[None]:
    """Name a plugin and its package in the message of any error in the block.

    `group` and `kind` are as for `load`; `name` may include options. Any exception except
    out-of-memory errors becomes an `InimError` of the same type, or else a `UsageError`.
    """
    try:
        yield
    except (MemoryError, OutOfMemoryError):
        raise
    except (Exception, SystemExit) as error:
        plugin = f"{kind} {name!r}"
        points = metadata.entry_points(group=group, name=name.partition(":")[0])
        packages = [point.dist.name for point in points if point.dist is not None]
        if packages:
            plugin += f" of package {packages[0]}"
        if isinstance(error, InimError):
            if str(error).startswith(kind):  # it names the plugin already
                raise
            raise type(error)(f"{plugin}: {error}") from error
        last = traceback.extract_tb(error.__traceback__)[-1]
        raise UsageError(
            f"{plugin} failed: {type(error).__name__}: {' '.join(str(error).split())[:400]} "
            f"({last.filename}, line {last.lineno}); --debug shows the traceback"
        ) from error


@dataclass(frozen=True)
class PluginModule:
    """A module that registers Mitsuba plugins, with the digest of its code.

    `file` is the file of the top-level module or package. It is loaded from there: its folder is
    not searched for other modules, so a `numpy.py` next to it is not executed.
    """

    name: str
    file: Path
    sha256: str

    @classmethod
    def of(cls, text: str) -> PluginModule:
        """Find a module by its name or by the path of its .py file, without importing it.

        Raises `UsageError` if there is no such module.
        """
        top, file = text.partition(".")[0], Path(text)
        if file.suffix == ".py":
            name, file = file.stem, file.absolute()
        else:
            try:
                spec = util.find_spec(top)
            except (ImportError, ValueError):
                spec = None
            name, file = text, Path(spec.origin) if spec and spec.origin else Path()
        if not file.is_file():
            raise UsageError(f"--plugin {text}: no such module; install it, or give its .py file")
        return cls(name, file.resolve(), _digest(file))

    @property
    def text(self) -> str:
        """Name for `of` that does not depend on the search path; of a package, its name."""
        return self.name if self.file.name == "__init__.py" else str(self.file)

    def load(self) -> None:
        """Import the module from its file.

        Raises `UsageError` if it fails or another module has its name, and `FileError` if its code
        was changed meanwhile.
        """
        top = self.name.partition(".")[0]
        loaded = sys.modules.get(top)
        if loaded is not None and Path(loaded.__file__ or "").resolve() != self.file:
            raise UsageError(f"--plugin {self.name}: another module has this name; rename it")
        try:
            if loaded is None:
                spec = util.spec_from_file_location(top, self.file)
                assert spec is not None and spec.loader is not None
                sys.modules[top] = util.module_from_spec(spec)
                spec.loader.exec_module(sys.modules[top])
            import_module(self.name)
        except (Exception, SystemExit) as error:
            raise UsageError(
                f"--plugin {self.name}: cannot be loaded: {type(error).__name__}: "
                f"{' '.join(str(error).split())[:400]}"
            ) from error
        if _digest(self.file) != self.sha256:
            raise FileError(f"{self.file}: was saved while the run read it; run it again")


def _digest(file: Path) -> str:
    """SHA-256 of a module's file; of a package, of all its code."""
    digest = hashlib.sha256()
    files = [file] if file.name != "__init__.py" else sorted(file.parent.rglob("*"))
    for path in files:
        if path.suffix in (".py", ".so", ".pyd") and path.is_file():
            digest.update(path.relative_to(file.parent).as_posix().encode() + b"\0")
            digest.update(path.read_bytes())
    return digest.hexdigest()
