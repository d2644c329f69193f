"""Compiled kernels on disk are those of the code that runs."""

from importlib import util

from inim.backend import kernels

SOURCE = """from inim.backend.kernels import compiled

@compiled
def twice(x):
    return 2 * x
"""


def loads_from_disk(path):
    """Whether a kernel of this module, imported and called afresh, was found on disk."""
    spec = util.spec_from_file_location("planted", path)
    module = util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.twice(3) == 6
    return bool(sum(module.twice.stats.cache_hits.values()))


def test_kernels_are_compiled_again_if_functions_in_other_files_change(tmp_path, monkeypatch):
    path = tmp_path / "planted.py"
    path.write_text(SOURCE)
    assert not loads_from_disk(path)
    assert loads_from_disk(path)
    monkeypatch.setattr(kernels, "code_digest", lambda *_: "of other code")
    assert not loads_from_disk(path)
    assert loads_from_disk(path)
