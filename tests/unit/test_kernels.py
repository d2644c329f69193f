"""Compiled kernels on disk are those of the code that runs."""

import os
from importlib import util

from inim.system.backend import kernels

SOURCE = """from inim.system.backend.kernels import compiled

@compiled
def twice(x):
    return 2 * x
"""


def load(path):
    """The kernel of this module, imported afresh."""
    spec = util.spec_from_file_location("planted", path)
    module = util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.twice


def loads_from_disk(path):
    """True if a kernel of this module, imported and called again, was loaded from disk."""
    kernel = load(path)
    assert kernel(3) == 6
    return bool(sum(kernel.stats.cache_hits.values()))


def test_kernels_are_compiled_again_if_functions_in_other_files_change(tmp_path, monkeypatch):
    path = tmp_path / "planted.py"
    path.write_text(SOURCE)
    assert not loads_from_disk(path)
    assert loads_from_disk(path)
    monkeypatch.setattr(kernels, "code_digest", lambda *_: "of other code")
    assert not loads_from_disk(path)
    assert loads_from_disk(path)


def test_kernels_of_old_versions_are_removed(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    folders = []
    for version in range(kernels._KEPT + 2):
        monkeypatch.setattr(kernels, "code_digest", lambda *_, version=version: str(version))
        folders.append(kernels.cache_folder())
        os.utime(folders[-1], (version, version))
        assert kernels.cache_folder() == folders[-1]
    assert sorted(tmp_path.iterdir()) == sorted(folders[2:])
