"""Plugins: entry points of other packages, modules of Mitsuba plugins, and errors that name them.

Generators, metrics and lens models of other packages are entry points of the groups
``inim.generators``, ``inim.metrics`` and ``inim.lens_models``.
"""

from __future__ import annotations

import hashlib
import os
import re
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from importlib import import_module, metadata, util
from pathlib import Path
from typing import Any

from inim.system.errors import FileError, InimError, OutOfMemoryError, UsageError

_CODE = (".py", ".so", ".pyd")
# Folders in which modules of different distributions are neighbours.
_SHARED = ("site-packages", "dist-packages")


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
            f"{' '.join(str(error).split())[:400]}; update or uninstall its package"
        ) from error


def identity(group: str, name: str) -> dict[str, str]:
    """Identity of a plugin's state: its entry point, and `_state` of the module there."""
    point = next(iter(metadata.entry_points(group=group, name=name)))
    return {"entry_point": point.value, **_state(point.module, point.dist)}


def _state(module: str, distribution: metadata.Distribution | None) -> dict[str, str]:
    """SHA-256 of all files of a module's distribution, its version, and those of its dependencies.

    The hash detects changes of files without a new version.
    """
    record = {"sha256": _digest(_plugin_files(module, distribution))}
    if distribution is None:
        return record
    dependencies = _dependencies(tuple(distribution.requires or ()))
    requires = {f"requires {package}": version for package, version in dependencies.items()}
    return {**record, "version": distribution.version, **requires}


def _module_digest(name: str, file: Path) -> str:
    """SHA-256 of the state of a module's distribution, or of its folder if it is not installed."""
    top, folders = name.partition(".")[0], {folder.name for folder in file.parents}
    owners = None if folders.isdisjoint(_SHARED) else _owners(tuple(sys.path)).get(top)
    if not owners:
        return _digest(_module_files(file))
    state = _state(top, metadata.distribution(owners[0]))
    return hashlib.sha256(repr(state).encode()).hexdigest()


@cache  # takes 0.2 s
def _owners(_search_path: tuple[str, ...]) -> Mapping[str, list[str]]:
    """Distributions by their top-level modules."""
    return metadata.packages_distributions()


@cache
def _dependencies(requirements: tuple[str, ...]) -> dict[str, str]:
    """Versions of the installed packages that requirements name, directly or indirectly."""
    versions: dict[str, str] = {}
    remaining = list(requirements)
    while remaining:
        package = re.split(r"[^\w.-]", remaining.pop(), maxsplit=1)[0]
        package = re.sub(r"[-_.]+", "-", package).lower()
        if package in versions or package == "inim":  # inim's own code is part of every key
            continue
        with suppress(metadata.PackageNotFoundError):  # an optional one
            distribution = metadata.distribution(package)
            versions[package] = distribution.version
            indirect = distribution.requires or ()
            remaining += (line for line in indirect if "extra ==" not in line)
    return dict(sorted(versions.items()))


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
    """A module that registers Mitsuba plugins, with the digest of its distribution's state.

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
        return cls(name, file.resolve(), _module_digest(name, file.resolve()))

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
                f"{' '.join(str(error).split())[:400]}; correct the module"
            ) from error
        if _module_digest(self.name, self.file) != self.sha256:
            raise FileError(f"{self.file}: was saved while the run read it; run it again")


def _plugin_files(module: str, distribution: metadata.Distribution | None) -> set[Path]:
    """Files of a plugin's distribution: recorded ones, and all of its top-level modules.

    An editable installation records none of its code. All that can be imported from the folder of
    such a module then counts.
    """
    tops, recorded = {module.partition(".")[0]}, set[Path]()
    if distribution is not None:
        tops.update((distribution.read_text("top_level.txt") or "").split())
        recorded = {Path(str(file.locate())).resolve() for file in distribution.files or ()}
    files = {file for file in recorded if file.is_file() and not _is_ignored(file)}
    for top in tops:
        spec = util.find_spec(top)
        if spec is not None and spec.has_location and spec.origin:
            files |= _module_files(Path(spec.origin).resolve(), recorded)
        elif spec is not None and spec.submodule_search_locations:  # a namespace package
            folders = [Path(place).resolve() for place in spec.submodule_search_locations]
            if not any(folder in file.parents for folder in folders for file in recorded):
                files.update(*map(_files_below, folders))
    return files


def _module_files(file: Path, recorded: Iterable[Path] = ()) -> set[Path]:
    """Files of a top-level module or package and, unless it is recorded, of its neighbours."""
    is_package = (file.parent / "__init__.py").is_file()
    folder = file.parent.parent if is_package else file.parent
    files = _files_below(file.parent) if is_package else {file}
    if file not in recorded and folder.name not in _SHARED:
        for path in _listed(folder):
            if path.suffix in _CODE and path.is_file():
                files.add(path)
            elif (path / "__init__.py").is_file():
                files |= _files_below(path)
    return files


def _files_below(folder: Path) -> set[Path]:
    files = set()
    for path in _listed(folder):
        if path.is_dir() and not path.is_symlink():
            files |= _files_below(path)
        elif path.is_file() and not _is_ignored(path):
            files.add(path)
    return files


def _listed(folder: Path) -> list[Path]:
    """Entries of a folder; raises `FileError` if it cannot be listed, as its modules still load."""
    with _reading():
        return list(folder.iterdir())


@contextmanager
def _reading() -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise FileError(
            f"{error.filename}: a plugin's file cannot be read ({error.strerror}); make it readable"
        ) from error


def _is_ignored(file: Path) -> bool:
    """True for modules that Python compiled, and for records of an installation."""
    return file.parent.name == "__pycache__" or file.parent.suffix in (".dist-info", ".egg-info")


def _digest(files: Iterable[Path]) -> str:
    """SHA-256 of the names and contents of files, independent of their common folder."""
    ordered = sorted(files)
    home = os.path.commonpath([file.parent for file in ordered])
    digest = hashlib.sha256()
    for file in ordered:
        status = file.stat()
        content = _content_digest(file, status.st_size, status.st_mtime_ns)
        digest.update(file.relative_to(home).as_posix().encode() + b"\0" + content)
    return digest.hexdigest()


@cache  # each score asks for the identities of all metrics
def _content_digest(file: Path, _size: int, _mtime_ns: int) -> bytes:
    with _reading():
        return hashlib.sha256(file.read_bytes()).digest()
