"""Files saved while a run reads them: a report tells the truth or is not made, and the result cache
never serves pictures of other bytes than those asked for."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from inim.image.files.image import read_exr, write_exr, write_png
from inim.render import scene as render_scene
from inim.render.meshes.ply import write_ply
from inim.render.meshes.triangle_mesh import Mesh
from tests.conftest import scene_text, square
from tests.system.conftest import Ended, assert_one_line

pytestmark = pytest.mark.usefixtures("no_page")
SHAPE = """<shape type="ply"><string name="filename" value="a.ply"/><bsdf type="diffuse">
    <texture type="bitmap" name="reflectance"><string name="filename" value="{0}"/></texture>
    </bsdf></shape><include filename="part.xml"/>"""
KINDS = ("a.ply", "a.png", "a.exr", "part.xml", "s.xml")
# The scene names one of its pictures.
PICTURE = {kind: "a.exr" if kind == "a.exr" else "a.png" for kind in KINDS}


def write_version(folder: Path, kind: str, version: int) -> None:
    """One file of the scene, whole at once as editors save it, in one of two versions."""
    temporary = folder / f"new-{kind}"
    grey = np.full((4, 4, 3), 0.2 + 0.6 * version)
    if kind == "a.ply":
        corners = np.float32([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, version]])
        faces = np.array([[0, 1, 2], [0, 2, 3]])
        write_ply(temporary, Mesh(corners, faces, uv=(corners[:, :2] + 1) / 2))
    elif kind == "a.png":
        write_png(temporary, grey)
    elif kind == "a.exr":
        write_exr(temporary, grey)
    else:
        shape = square((-1, 1, 1 + version), 0.5, "0.9,0.1,0.1")
        text = f"<scene version='3.0.0'>{shape}</scene>"
        if kind == "s.xml":
            picture = "a.exr" if (folder / "a.exr").exists() else "a.png"
            text = scene_text(SHAPE.format(picture), square((1, -1, version), 0.5, "0.1,0.9,0.1"))
        temporary.write_text(text)
    temporary.replace(folder / kind)


def write_all(folder: Path, kind: str) -> Path:
    """The scene in its first version, with what the kind needs."""
    folder.mkdir(exist_ok=True)
    for name in ("a.ply", PICTURE[kind], "part.xml", "s.xml"):
        write_version(folder, name, 0)
    return folder


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("moment", ["decode", "load", "loaded", "there and back"])
def test_a_file_saved_meanwhile_stops_the_run(run_inim, tmp_path, monkeypatch, kind, moment):
    """Between the scan and the decoding, before the renderer, after it, or changed and put back."""
    folder = write_all(tmp_path / "scene", kind)
    decode, load = render_scene._read_files, render_scene._load_scene
    shutil.copytree(folder, tmp_path / "before", copy_function=shutil.copy2)

    def load_meanwhile(file: object, decoded: object) -> object:
        if moment != "loaded":
            write_version(folder, kind, 1)
        loaded = load(file, decoded)
        if moment == "loaded":
            write_version(folder, kind, 1)
        if moment == "there and back":
            shutil.copy2(tmp_path / "before" / kind, folder / kind)
        return loaded

    def decode_meanwhile(file: object) -> object:
        write_version(folder, kind, 1)
        return decode(file)

    with monkeypatch.context() as patch:
        if moment == "decode":
            patch.setattr(render_scene, "_read_files", decode_meanwhile)
        else:
            patch.setattr(render_scene, "_load_scene", load_meanwhile)
        ended = run_here_cached(run_inim, folder, tmp_path)
    assert ended.code == 2
    assert_one_line(ended.stderr, [kind, "was saved while the run read it; run it again"])
    assert not (tmp_path / "out").exists()
    if (kind, moment) != ("a.ply", "there and back"):  # others in the slow tier
        return
    for version in (0, 1):
        write_version(folder, kind, version)
        assert run_here_cached(run_inim, folder, tmp_path).code == 0
        digest = truth(tmp_path / "out")
        assert run_here_cached(run_inim, folder, tmp_path, cached=False).code == 0
        assert np.array_equal(digest, truth(tmp_path / "out"))


def run_here_cached(
    run: Callable[..., Ended], folder: Path, tmp_path: Path, *, cached: bool = True
) -> Ended:
    """Validate from the centre only, with a result cache of the test's own or none."""
    return run(
        *(folder / "s.xml", "-o", tmp_path / "out", "--quiet", "--algorithms", "template"),
        folder=tmp_path,
        variables={"INIM_CACHE": str(tmp_path / "cache") if cached else "off"},
        viewpoints="centre",
    )


def truth(out: Path) -> np.ndarray:
    """A report's true view."""
    return read_exr(out / "truth" / "centre.exr")
