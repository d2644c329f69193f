"""Identities of plugins: any change of their packages, or of what these require, is detected."""

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from inim.system.errors import FileError
from inim.system.plugins import PluginModule, identity

GROUP = "inim.metrics"


class Site:
    """A folder of installed packages, and a folder with a project's code."""

    def __init__(self, folder: Path) -> None:
        self.installed, self.project = folder / "site-packages", folder / "project"
        self.installed.mkdir()
        self.project.mkdir()

    def write(self, folder: Path, **files: str) -> None:
        """Write modules and, with a prefix ``PACKAGE_of_``, those of packages."""
        for name, text in files.items():
            path = folder.joinpath(*name.split("_of_")).with_suffix(".py")
            path.parent.mkdir(exist_ok=True)
            path.write_text(text)

    def describe(
        self,
        name: str,
        *,
        version: str = "1.0",
        requires: str = "",
        entry: str = "",
        records: str | None = None,
        folder: Path | None = None,
    ) -> None:
        """Write the metadata of a distribution; `records` are its files, separated by spaces."""
        info = (folder or self.installed) / f"{name}.dist-info"
        info.mkdir(exist_ok=True)
        lines = [f"Requires-Dist: {requires}\n"] if requires else []
        (info / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n{''.join(lines)}"
        )
        if entry:
            (info / "entry_points.txt").write_text(f"[{GROUP}]\ntheirs = {entry}\n")
        if records is not None:
            (info / "RECORD").write_text("".join(f"{file},,\n" for file in records.split()))


@pytest.fixture
def site(tmp_path, monkeypatch) -> Site:
    site = Site(tmp_path)
    for folder in (site.project, site.installed):
        monkeypatch.syspath_prepend(folder)
    return site


def installed_modules(site: Site) -> Path:
    """A distribution of two modules."""
    site.write(site.installed, their_metric="import their_maths", their_maths="FACTOR = 1")
    site.describe("theirs", entry="their_metric:m", records="their_metric.py their_maths.py")
    return site.installed / "their_maths.py"


def installed_packages(site: Site) -> Path:
    """A distribution of two packages."""
    files = {"theirs_of___init__": "", "theirs_of_metric": "", "maths_of___init__": "FACTOR = 1"}
    site.write(site.installed, **files)
    records = "theirs/__init__.py theirs/metric.py maths/__init__.py"
    site.describe("theirs", entry="theirs.metric:m", records=records)
    return site.installed / "maths" / "__init__.py"


def weights(site: Site) -> Path:
    """Data of a package."""
    installed_packages(site)
    path = site.installed / "theirs" / "weights.bin"
    path.write_bytes(b"1")
    return path


def namespace(site: Site) -> Path:
    """A distribution whose package has no `__init__.py`."""
    site.write(site.installed, **{"shared_of_metric": "", "shared_of_maths": "FACTOR = 1"})
    records = "shared/metric.py shared/maths.py"
    site.describe("theirs", entry="shared.metric:m", records=records)
    return site.installed / "shared" / "maths.py"


def editable_modules(site: Site) -> Path:
    """An editable distribution of modules, which records only a path."""
    site.write(site.project, their_metric="import their_maths", their_maths="FACTOR = 1")
    site.describe("theirs", entry="their_metric:m", records="_theirs.pth")
    return site.project / "their_maths.py"


def editable_packages(site: Site) -> Path:
    """An editable distribution of packages."""
    files = {"theirs_of___init__": "", "theirs_of_metric": "", "maths_of___init__": "FACTOR = 1"}
    site.write(site.project, **files)
    site.describe("theirs", entry="theirs.metric:m", records="_theirs.pth")
    return site.project / "maths" / "__init__.py"


def editable_namespace(site: Site) -> Path:
    """An editable distribution whose package has no `__init__.py`."""
    site.write(site.project, **{"shared_of_metric": "", "shared_of_maths": "FACTOR = 1"})
    site.describe("theirs", entry="shared.metric:m", records="_theirs.pth")
    return site.project / "shared" / "maths.py"


def on_the_search_path(site: Site) -> Path:
    """Metadata next to the modules, without a record."""
    site.write(site.project, their_metric="import their_maths", their_maths="FACTOR = 1")
    site.describe("theirs", entry="their_metric:m", folder=site.project)
    return site.project / "their_maths.py"


LAYOUTS = [
    installed_modules, installed_packages, weights, namespace, editable_modules,
    editable_packages, editable_namespace, on_the_search_path,
]  # fmt: skip


@pytest.mark.parametrize("install", LAYOUTS, ids=lambda install: install.__name__)
def test_a_change_of_another_file_of_the_distribution_is_detected(
    site: Site, install: Callable[[Site], Path]
):
    file = install(site)
    before = identity(GROUP, "theirs")
    assert identity(GROUP, "theirs") == before
    file.write_bytes(file.read_bytes() + b"2")
    assert identity(GROUP, "theirs")["sha256"] != before["sha256"]


def test_versions_of_direct_and_indirect_dependencies_count(site, monkeypatch):
    installed_modules(site)
    site.describe("Base_Maths", version="1.0", records="")
    site.describe("middle", requires="base-maths (>=1) ; python_version > '3'", records="")
    site.describe(
        "theirs", entry="their_metric:m", requires="middle[fast]>=1", records="their_metric.py"
    )
    state = identity(GROUP, "theirs")
    assert state["version"] == state["requires middle"] == state["requires base-maths"] == "1.0"


def test_identity_is_independent_of_the_folder(tmp_path, monkeypatch):
    identities = []
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        site = Site(tmp_path / name)
        installed_packages(site)
        with monkeypatch.context() as patch:
            patch.syspath_prepend(site.installed)
            identities.append(identity(GROUP, "theirs"))
    assert identities[0] == identities[1]


def test_a_folder_that_cannot_be_listed_is_an_error(site, monkeypatch):
    """Its modules can be imported, so it must not count as empty. Root may list any folder."""
    installed_packages(site)
    listed = Path.iterdir

    def refuse(folder: Path):
        if folder.name == "theirs":
            raise PermissionError(13, "Permission denied", str(folder))
        return listed(folder)

    monkeypatch.setattr(Path, "iterdir", refuse)
    with pytest.raises(FileError, match=r"theirs: a plugin's file cannot be read .*; make it read"):
        identity(GROUP, "theirs")


@pytest.mark.parametrize("by_path", [True, False])
def test_modules_of_scene_plugins_include_what_they_import(site, by_path):
    site.write(site.project, own_paints="import pigments", pigments="RED = 1")
    text = str(site.project / "own_paints.py") if by_path else "own_paints"
    before = PluginModule.of(text)
    try:
        before.load()
    finally:
        for name in ("own_paints", "pigments"):
            sys.modules.pop(name, None)
    site.write(site.project, pigments="RED = 22")
    assert PluginModule.of(text).sha256 != before.sha256
