"""`new-scene` writes scenes that plain Mitsuba opens: upright, lit, whole, on black."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from inim.image.color import srgb_from_linear, srgb_to_uint8
from inim.render.meshes.mesh import read_mesh
from inim.render.meshes.ply import write_ply
from inim.render.meshes.triangle_mesh import Mesh, add_vertex_normals
from inim.render.scene_files.new_scene import new_scene
from inim.render.scene_files.relic_scene import STONE, scene_xml
from inim.system.errors import UsageError
from tests.conftest import box_surface


@pytest.fixture
def mi(renderer):
    import mitsuba

    return mitsuba


def box(size: tuple[float, float, float], **rest: Any) -> Mesh:
    """A box from 0 to `size`, corners shared, no normals."""
    corners, faces = box_surface()
    return Mesh(corners * np.float32(size), faces, **rest)


def sphere(rows: int = 24, columns: int = 48) -> Mesh:
    phi, theta = np.meshgrid(
        np.linspace(0, 2 * np.pi, columns, endpoint=False), np.linspace(0, np.pi, rows + 1)
    )
    ring = np.sin(theta)
    points = np.stack([ring * np.cos(phi), np.cos(theta), -ring * np.sin(phi)], -1).reshape(-1, 3)
    k, j = np.meshgrid(np.arange(columns), np.arange(rows))
    a, b = j * columns + k, j * columns + (k + 1) % columns
    faces = np.concatenate(
        [np.stack([a, a + columns, b + columns], -1), np.stack([a, b + columns, b], -1)]
    ).reshape(-1, 3)
    return Mesh(points.astype(np.float32), faces.astype(np.uint32))


def saved(folder: Path, mesh: Mesh, name: str = "source.ply") -> Path:
    path = folder / "given" / name
    write_ply(path, mesh)
    return path


def render(mi: Any, path: Path, spp: int = 16) -> np.ndarray:
    scene = mi.load_file(str(path))
    return np.array(mi.render(scene, spp=spp))[..., :3]


# --- Units, axes, refusals ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("up", "front", "size_mm"),
    [
        ("y", None, (10, 20, 30)),
        ("z", None, (10, 30, 20)),
        ("z", "x", (20, 30, 10)),
        ("-x", "y", (30, 10, 20)),
    ],
)
def test_named_axes_end_up_on_y_and_z(tmp_path, up, front, size_mm):
    source = saved(tmp_path, box((1, 2, 3)))
    out = new_scene(source, tmp_path / "a.xml", unit="cm", up=up, front=front)
    points = read_mesh(out.with_suffix(".ply"))[0].vertices
    np.testing.assert_allclose(np.ptp(points, axis=0), size_mm, rtol=1e-5)
    np.testing.assert_allclose(points.max(axis=0) + points.min(axis=0), 0, atol=1e-5)


@pytest.mark.parametrize("up", ["x", "-x", "y", "-y", "z", "-z"])
def test_turning_never_mirrors(tmp_path, up):
    source = saved(tmp_path, sphere())
    out = new_scene(source, tmp_path / "a.xml", unit="mm", up=up)
    mesh = read_mesh(out.with_suffix(".ply"))[0]
    a, b, c = (mesh.vertices[mesh.faces[:, k]].astype(float) for k in range(3))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6
    assert volume == pytest.approx(4 / 3 * np.pi, rel=0.02)  # the sign is the handedness


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (
            {"unit": None, "up": None},
            r"no length unit and no up axis; the mesh is 1 x 2 x 3 units along x, y, z\. "
            r"Give --unit \(mm, cm, m, in\) and --up \(perhaps z, the longest\)\.$",
        ),
        ({"unit": None}, r"z\. Give --unit \(mm, cm, m, in\)\.$"),
        ({"up": None}, r"no up axis; .* z\. Give --up \(perhaps z, the longest\)\.$"),
        ({"unit": "ft"}, "--unit ft"),
        ({"up": "w"}, "--up w"),
        ({"front": "-y"}, "parallel to --up"),
        ({"display": "cinema"}, "--display cinema"),
        ({"name": "a.ply"}, r"name the scene a\.xml"),
    ],
)
def test_impossible_options_are_refused(tmp_path, options, words):
    source = saved(tmp_path, box((1, 2, 3)))
    parameters = {"unit": "mm", "up": "y", **options}
    with pytest.raises(UsageError, match=words):
        new_scene(source, tmp_path / parameters.pop("name", "a.xml"), **parameters)
    assert list(tmp_path.iterdir()) == [source.parent]


def test_forcing_removes_the_parts_that_only_the_earlier_scene_had(tmp_path):
    skins = [f"newmtl {name}\nmap_Kd {name}.png\n" for name in ("one", "two")]
    target = tmp_path / "given"
    target.mkdir()
    for value, name in ((0, "one"), (255, "two")):
        Image.fromarray(np.full((4, 4, 3), value, np.uint8)).save(target / f"{name}.png")
    (target / "a.mtl").write_text("".join(skins))
    points = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n"
    faces = "usemtl one\nf 1/1 2/2 3/3\nusemtl two\nf 1/1 3/3 2/2\n"
    (target / "a.obj").write_text(points + faces)
    new_scene(target / "a.obj", tmp_path / "b.xml", unit="mm", up="y")
    assert (tmp_path / "b-2.ply").is_file()
    bystanders = [tmp_path / "b-3.ply", tmp_path / "b-notes.png", tmp_path / "bb-2.ply"]
    for path in bystanders:
        path.write_text("mine")
    new_scene(saved(tmp_path, sphere()), tmp_path / "b.xml", unit="mm", up="y", force=True)
    assert not (tmp_path / "b-2.ply").exists()
    assert not (tmp_path / "b-2.png").exists()
    assert (tmp_path / "b.ply").is_file()
    assert [path.read_text() for path in bystanders] == ["mine"] * 3


def test_the_mesh_itself_is_never_overwritten(tmp_path):
    source = saved(tmp_path, box((1, 2, 3)))
    before = source.read_bytes()
    with pytest.raises(UsageError, match="the mesh itself"):
        new_scene(source, source.with_suffix(".xml"), unit="mm", up="y", force=True)
    assert source.read_bytes() == before


# --- Normals ------------------------------------------------------------------------------------


def test_box_keeps_its_edges_and_sphere_is_smooth():
    cube = add_vertex_normals(box((1, 1, 1)))
    assert len(cube.vertices) == 24
    assert cube.normals is not None
    np.testing.assert_allclose(np.abs(cube.normals).max(axis=1), 1, atol=1e-6)
    ball = add_vertex_normals(sphere())
    assert ball.normals is not None
    assert np.einsum("ij,ij->i", ball.normals, ball.vertices).min() > 0.995


# --- In Mitsuba ---------------------------------------------------------------------------------


def test_scene_is_lit_whole_and_on_black(tmp_path, mi):
    out = new_scene(saved(tmp_path, sphere()), tmp_path / "a.xml", unit="m", up="y")
    picture = render(mi, out)
    assert picture.shape == (512, 512, 3)
    light = picture.mean(axis=2)
    assert max(light[0].max(), light[-1].max(), light[:, 0].max(), light[:, -1].max()) == 0
    rows, columns = np.nonzero(light > 0)
    disc = light[128:384, 128:384]
    assert 0.2 < np.median(disc) < 0.7
    assert np.quantile(disc, 0.99) < 1.2
    # Centred, and filling most of the picture.
    assert abs(rows.min() + rows.max() - 511) <= 2
    assert abs(columns.min() + columns.max() - 511) <= 2
    assert 380 < np.ptp(rows) < 511
    # The key comes from the upper left of what the viewer sees.
    assert light[100:256, 100:256].mean() > 1.5 * light[256:412, 256:412].mean()


def test_lamps_are_out_of_sight_within_25_degrees(tmp_path, mi):
    """Rays through a field three bounding radii wide, from anywhere in the viewing zone."""
    out = new_scene(saved(tmp_path, box((1, 3, 2))), tmp_path / "a.xml", unit="m", up="y")
    scene = mi.load_file(str(out))
    radius = 500 * np.sqrt(1 + 9 + 4)
    rng = np.random.default_rng(3)
    n = 200_000
    through = rng.uniform(-1, 1, (n, 2)) * [3 * radius, 1.5 * radius]
    slope = rng.uniform(-1, 1, (n, 2)) * np.tan(np.radians(25))
    start = np.column_stack([through + slope * 30 * radius, np.full(n, 30 * radius)])
    along = np.column_stack([-slope, np.full(n, -1.0)])
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    ray = mi.Ray3f(mi.Point3f(start.T), mi.Vector3f(along.T))
    hit = scene.ray_intersect_preliminary(ray)
    lamps = [s for s in scene.shapes() if s.is_emitter()]
    assert len(lamps) == 3
    is_lamp = np.array(mi.Bool(False) | mi.Mask(hit.shape.is_emitter()))
    assert np.array(hit.is_valid()).any()
    assert not is_lamp.any()


@pytest.mark.parametrize("kind", ["colour", "texture"])
def test_a_white_relic_is_not_clipped(tmp_path, mi, kind):
    """A white relic is as bright as plaster of its shape; a dark one is not brightened."""
    views = {}
    for name, value in {"white": 1.0, "plaster": max(STONE), "dark": 0.3}.items():
        mesh = sphere()
        count = len(mesh.vertices)
        if kind == "colour":
            mesh = replace(mesh, color=np.full((count, 3), value, np.float32))
        else:
            code = srgb_to_uint8(srgb_from_linear(np.full((2, 2, 3), value)))
            mesh = replace(mesh, uv=np.zeros((count, 2), np.float32), texture=code)
        lines = scene_xml({tmp_path / "a.ply": mesh}, np.ones(3), "", "nominal")
        views[name] = [float(x) for x in re.findall(r'name="radiance" value="([\d.]+)', lines)]
    np.testing.assert_allclose(
        np.array(views["white"]), max(STONE) * np.array(views["plaster"]), rtol=1e-2
    )
    assert views["dark"] == pytest.approx(views["plaster"], rel=1e-2)


# --- Command line -------------------------------------------------------------------------------
