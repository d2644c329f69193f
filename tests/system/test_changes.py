"""Changes to a repository with a relic, one at a time: what `validate` and `compare` report.

Expected: an edit without effect passes. A change of an input is named. Its effect on the scores
decides the verdict, and a fault of an algorithm fails, however little SSIM sees of it.
"""

import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from inim.cli.main import main
from inim.system.errors import EXIT_CHECK_FAILED, EXIT_PASSED
from tests.schemas import read_document
from tests.system.conftest import Ended, install_metadata

pytestmark = pytest.mark.slow
SCENES = Path(__file__).parents[2] / "scenes"
SETTINGS = {
    "lens_columns": "24", "lens_rows": "24", "capture_spp": "64", "eia_spp": "32",
    "view_spp": "64", "reconstruction_spp": "16", "algorithms": "template,planted",
    "viewpoints": "left",
}  # fmt: skip
PLANTED = '''
import os
from dataclasses import replace

from inim.generators import prepare as prepared

class Planted:
    def __init__(self, generator):
        self.generator = generator

    def generate(self, rgbd, out=None):
        depth = rgbd.depth_mm * type(rgbd.depth_mm.flat[0])(os.environ.get("DEPTH", "1"))
        eia = self.generator.generate(replace(rgbd, depth_mm=depth), out)
        eia *= float(os.environ.get("BRIGHTNESS", "1"))
        return eia

def prepare(display, shape, pixel_mm):
    """A generator of another package, with faults."""
    name = "template:samples=1:colour=nearest"
    return Planted(prepared(display, name, shape=shape, pixel_mm=pixel_mm))
'''
CHANGED, WITHIN = "inputs changed, scores changed", "inputs changed, scores within intervals"


def _replace(old: str, new: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        scene = folder / "amphora.xml"
        text = scene.read_text("utf-8")
        assert old in text
        scene.write_text(text.replace(old, new), "utf-8")

    return change


def _darken_green(folder: Path) -> None:
    path = folder / "textures" / "amphora.png"
    pixels = np.asarray(Image.open(path).convert("RGB")).copy()
    pixels[..., 1] = np.rint(0.9 * pixels[..., 1])
    Image.fromarray(pixels).save(path)


def _stretch_body(folder: Path) -> None:
    import trimesh

    path = folder / "meshes" / "amphora_body.ply"
    mesh = trimesh.load(path, process=False)
    mesh.vertices *= (1.05, 1, 1.05)
    mesh.export(path)


@dataclass(frozen=True)
class Change:
    """A change, what its report must name, its verdicts, and the checks that must fail."""

    name: str
    edit: Callable[[Path], None] | None = None
    settings: dict[str, str] = field(default_factory=dict)
    variables: dict[str, str] = field(default_factory=dict)
    named: tuple[str, ...] = ()
    verdicts: tuple[str, ...] = (CHANGED,)
    failed: tuple[str, ...] = ()


CHANGES = [
    Change("comment", _replace("<integrator", "<!-- paths -->\n<integrator"), verdicts=("passed",)),
    Change("seed", settings={"seed": "5"}, verdicts=("passed",)),
    Change("texture", _darken_green, named=("amphora.png",), failed=("green",)),
    Change("display", settings={"lens_columns": "23"}, named=("display: lens_columns",),
           verdicts=(CHANGED, WITHIN)),
    Change("options", settings={"algorithms": "template:samples=1,planted"},
           named=("algorithm template",), failed=("template:samples=1/left: SSIM",)),
    Change("brightness", variables={"BRIGHTNESS": "0.97"}, verdicts=("worse",),
           failed=("planted/left: light on relic",)),
    Change("depth", variables={"DEPTH": "1.1"}, verdicts=("worse",),
           failed=("planted/left: SSIM",)),
    Change("light", _replace("34.2, 32.9, 30.9", "30.8, 29.6, 27.8"), named=("light_key",),
           failed=("light on relic",)),
    Change("mesh", _stretch_body, named=("amphora_body.ply",)),
    Change("material", _replace('name="alpha" value="0.3"', 'name="alpha" value="0.29"'),
           named=("painted_clay", "black_glaze"), verdicts=(WITHIN, CHANGED)),
    Change("viewpoint", settings={"viewpoints": "left,up"}, named=("viewpoints",),
           verdicts=(WITHIN,)),
    Change("lens model", settings={"lens_model": "pinhole"}, named=("lens model",)),
]  # fmt: skip


@dataclass(frozen=True)
class Repository:
    """A folder with the amphora, its baseline, and a run of each change."""

    folder: Path
    run_inim: Callable[..., Ended]
    path: str

    def run(self, out: str, change: Change, *words: str) -> Ended:
        folder = self.folder / "scenes"
        if change.edit is not None:
            folder = self.folder / f"scenes of {change.name}"
            shutil.copytree(self.folder / "scenes", folder)
            change.edit(folder)
        return self.run_inim(
            str(folder / "amphora.xml"), "-o", str(self.folder / out), *words,
            folder=self.folder, variables={"PYTHONPATH": self.path, **change.variables},
            **(SETTINGS | change.settings),
        )  # fmt: skip

    def data(self, out: str) -> Any:
        return read_document(self.folder / out / "report.json")


@pytest.fixture(scope="module")
def repository(tmp_path_factory, run_inim):
    folder = tmp_path_factory.mktemp("repository")
    for kind in ("meshes", "textures"):
        (folder / "scenes" / kind).mkdir(parents=True)
        for path in (SCENES / kind).glob("amphora*"):
            shutil.copy(path, folder / "scenes" / kind)
    shutil.copy(SCENES / "amphora.xml", folder / "scenes")
    site = folder / "site"
    install_metadata(site, "planted", "[inim.generators]\nplanted = planted:prepare\n")
    (site / "planted.py").write_text(PLANTED)
    paths = [str(site), os.environ.get("PYTHONPATH", "")]
    created = Repository(folder, run_inim, os.pathsep.join(filter(None, paths)))
    ended = created.run("first", Change("none"))
    assert ended.code == EXIT_PASSED, ended.stderr
    words = ["accept", str(folder / "first"), "--reason", "the first", "-o", str(folder / "base")]
    assert main(words) == EXIT_PASSED
    return created


@pytest.mark.parametrize("change", CHANGES, ids=lambda change: change.name)
def test_a_change_is_named_and_judged_by_its_effect(repository, change, capsys):
    out = f"out of {change.name}"
    ended = repository.run(out, change, "--baseline", str(repository.folder / "base"))
    assert not ended.stderr
    data = repository.data(out)
    regression = data["regression"]
    names = [changed["name"] for changed in regression["inputs"]]
    assert regression["verdict"] in change.verdicts, (regression["verdict"], names, ended.stdout)
    assert bool(names) is bool(change.named), names
    assert all(any(word in name for name in names) for word in change.named), names
    failed = [check["name"] for check in data["verdict"]["checks"] if not check["passed"]]
    assert all(any(word in name for name in failed) for word in change.failed), failed
    fails = regression["verdict"] in (CHANGED, "worse")
    assert ended.code == (EXIT_CHECK_FAILED if fails else EXIT_PASSED), ended.stdout
    summary = (repository.folder / out / "summary.md").read_text("utf-8").replace("\\", "")
    assert regression["verdict"] in summary
    assert all(word in summary for word in change.named)

    capsys.readouterr()
    code = main(["compare", str(repository.folder / "first"), str(repository.folder / out),
                 "-o", str(repository.folder / f"compared {change.name}")])  # fmt: skip
    text = capsys.readouterr().out
    assert regression["verdict"] in text
    assert all(word in text for word in change.named)
    assert code == ended.code, text
