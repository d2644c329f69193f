"""Scenes that use the caller's own Mitsuba plugins, and progress, through `inim.validate`.

Expected: the worker imports the named module from its file and nothing else from its folder; the
callback receives every stage, and shares that grow to 1.
"""

import sys

from tests.system.conftest import run_child

PLUGIN = """
import mitsuba as mi
paint = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.05}}
mi.register_bsdf("own_paint", lambda props: mi.load_dict(paint))
"""
RUN = """
import inim
few = {f"inim.{name}_spp": 2 for name in ("capture", "eia", "view", "reconstruction")}
few |= {"inim.lens_columns": 8, "inim.lens_rows": 6, "inim.lens_model": "pinhole"}
shares = []
report = inim.validate(
    "own.xml", "out", algorithms="template", viewpoints="centre", definitions=few,
    plugins="own_paint", progress=lambda stage, share: shares.append((share, stage)))
assert "own_paint.py" in report.data.command
is_sorted = shares == sorted(shares, key=lambda pair: pair[0])
print(is_sorted, shares[0][0], shares[-1], len(shares) > 6)
print(float(inim.read_rgbd("out/rgbd.exr").color.max()))
"""


def test_worker_imports_the_plugin_and_reports_its_progress(tmp_path):
    (tmp_path / "own.xml").write_text(
        """<scene version="3.0.0"><emitter type="constant"/>
        <shape type="sphere"><bsdf type="own_paint"/></shape></scene>"""
    )
    (tmp_path / "numpy.py").write_text("raise AssertionError('a file next to the plugin is run')")
    code = f"import sys; import numpy; sys.path.insert(0, {str(tmp_path)!r}){RUN}"
    (tmp_path / "own_paint.py").write_text(PLUGIN)
    ended = run_child([sys.executable, "-P", "-c", code], cwd=tmp_path)
    assert ended.code == 0, ended.stderr
    progress, brightest = ended.stdout.strip().splitlines()
    assert progress == "True 0.0 (1.0, 'finished') True"
    assert 0.02 < float(brightest) < 0.1, "the paint reflects 5 % of an even light, with noise"
