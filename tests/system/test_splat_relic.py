"""A PLY of splats becomes a scene that stands upright, and is validated to a report."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from inim.cli.main import main
from inim.render.meshes.splat_ply import read_splats, write_splats
from inim.render.scene_files.new_scene import new_scene
from inim.system.errors import EXIT_PASSED, UsageError
from tests.schemas import assert_schema, read_document
from tests.splat_relics import joined, random_splats, splats_at
from tests.system.conftest import run_here

RED, GREEN, BLUE = (0.9, 0.02, 0.02), (0.02, 0.9, 0.02), (0.02, 0.02, 0.9)


def signpost(folder: Path) -> Path:
    """Y down, as trained: red above, green right and blue left, as seen from -z of the file."""
    bar = np.linspace(-1, 1, 21)[:, None]
    body = splats_at(bar * [[0, 1, 0]], np.full(3, 0.1), 0.9, np.full(3, 0.3))
    ends = [
        splats_at(np.array([place], float), np.full(3, 0.15), 0.95, np.array(colour))
        for place, colour in (((0, -1.2, 0), RED), ((0.8, 0, 0), GREEN), ((-0.8, 0, 0), BLUE))
    ]
    far = splats_at(np.array([[50.0, 0, 0]]), np.full(3, 0.1), 0.01001, np.array(RED))
    path = folder / "signpost.ply"
    write_splats(path, joined(body, *ends, far))
    return path


@pytest.fixture(scope="module")
def mi():
    from inim.render import variant

    variant.use()
    import mitsuba

    return mitsuba


def test_a_relic_with_y_down_is_upright_and_not_mirrored(mi, tmp_path):
    """Whoever stands at -z of such a file, with -y up, has +x of it on the right."""
    messages: list[str] = []
    scene = new_scene(
        signpost(tmp_path), tmp_path / "a.xml", unit=None, up="-y", front="-z", warn=messages.append
    )
    assert "24 of 25 splats" in messages[0]
    # Stock Mitsuba, by the scene's own camera.
    image = np.array(mi.render(mi.load_file(str(scene)), spp=1))[..., :3]
    rows, columns = image.shape[:2]
    brightest = {
        name: np.unravel_index((image[..., k] - image.sum(axis=-1) / 2).argmax(), (rows, columns))
        for k, name in enumerate(("red", "green", "blue"))
    }
    assert brightest["red"][0] < rows / 3
    assert brightest["green"][1] > 0.6 * columns and brightest["blue"][1] < 0.4 * columns


def test_missing_settings_of_splats_are_requested(tmp_path):
    source, out = signpost(tmp_path), tmp_path / "a.xml"
    with pytest.raises(UsageError, match=r"--up .*nearly all splats are in -"):
        new_scene(source, out, unit=None, up=None)
    with pytest.raises(UsageError, match="splats have no unit"):
        new_scene(source, out, unit="mm", up="-y")
    with pytest.raises(UsageError, match="is the mesh itself"):
        new_scene(source, tmp_path / "signpost.xml", unit=None, up="-y", force=True)
    mesh = tmp_path / "mesh.stl"
    trimesh.creation.box().export(str(mesh))
    with pytest.raises(UsageError, match="--crop is for splats"):
        new_scene(mesh, out, unit="mm", up="y", crop="0,1,0,1,0,1")
    assert not out.exists()


def test_crop_keeps_a_part(tmp_path, capsys):
    source, out = signpost(tmp_path), tmp_path / "a.xml"
    words = ["new-scene", str(source), "--up=-y", "--crop=-0.5,0.5,-2,0.01,-1,1", "-o", str(out)]
    assert main(words) == EXIT_PASSED
    printed = capsys.readouterr()
    assert "12 of 25 splats" in printed.err
    assert "took 12 of 25 splats, --crop=-0.5,0.5,-2,0.01,-1,1\n" in printed.out
    cropped = read_splats(out.with_suffix(".ply"), out.with_suffix(".ply").read_bytes())
    assert len(cropped) == 12 and np.abs(cropped.centre).max() < 50


def test_a_splat_relic_is_validated_with_layers_and_its_translucency(tmp_path):
    relic = random_splats(100)
    write_splats(tmp_path / "relic.ply", replace(relic, log_scale=relic.log_scale - 0.5))
    new_scene(tmp_path / "relic.ply", tmp_path / "scene.xml", unit=None, up="y", warn=print)
    ended = run_here(
        "validate", "scene.xml", "-o", "out", "--algorithms", "layered,template",
        "--viewpoints", "centre",
        "-Dinim.lens_columns=8", "-Dinim.lens_rows=6", "-Dinim.capture_spp=2", "-Dinim.eia_spp=2",
        "-Dinim.view_spp=2", "-Dinim.reconstruction_spp=2", "-Dinim.score_error=0",
        folder=tmp_path,
    )  # fmt: skip
    assert ended.code == EXIT_PASSED, ended.stderr
    data = read_document(tmp_path / "out" / "report.json")
    assert_schema(data)
    entry = data["scene"]["splats"]
    assert sum(entry["coverage_histogram"]) == pytest.approx(1)
    assert 0 < entry["without_depth_fraction"] < entry["never_opaque_fraction"] < 1
    assert entry["touched_fraction"] >= data["rgbd"]["covered_fraction"] > 0
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    assert 'id="splats"' in page and f"{entry['count']} splats touch" in page
