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


def test_kernels_of_the_versions_used_last_are_kept(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))

    def folder_of(version):
        monkeypatch.setattr(kernels, "code_digest", lambda *_: str(version))
        return kernels.cache_folder()

    folders = [folder_of(version) for version in range(kernels._KEPT)]
    for age, folder in enumerate(reversed(folders), start=1):
        os.utime(folder, (1e9 - age, 1e9 - age))
    assert folder_of(0) == folders[0]
    folder_of("new")
    assert folders[0].exists() and not folders[1].exists()
    assert len([*tmp_path.iterdir()]) == kernels._KEPT
