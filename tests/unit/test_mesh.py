"""Meshes come through whole, and no file takes time, memory or the process with it."""

import base64
import json
import struct
import time
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from inim.render.meshes.mesh import read_mesh, read_shapes
from inim.render.meshes.ply import write_ply
from inim.render.meshes.triangle_mesh import Mesh
from inim.system.errors import FileError

POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]], np.float32)
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]], np.uint32)
OBJ = "".join(f"v {x} {y} {z}\n" for x, y, z in POINTS) + "".join(
    f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in FACES
)


def ply_header(n: int, m: int, form: str = "binary_little_endian") -> bytes:
    return (
        f"ply\nformat {form} 1.0\nelement vertex {n}\nproperty float x\nproperty float y\n"
        f"property float z\nelement face {m}\nproperty list uchar int vertex_indices\nend_header\n"
    ).encode()


def ply_body(points: np.ndarray, faces: np.ndarray, order: str = "<") -> bytes:
    table = np.empty(len(faces), [("n", "u1"), ("i", order + "i4", 3)])
    table["n"], table["i"] = 3, faces
    return points.astype(order + "f4").tobytes() + table.tobytes()


def tetrahedron_ply(points: np.ndarray = POINTS, faces: np.ndarray = FACES) -> bytes:
    return ply_header(len(points), len(faces)) + ply_body(points, faces)


def stl(triangles: np.ndarray, count: int | None = None) -> bytes:
    table = np.zeros(len(triangles), [("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    table["v"] = triangles
    return bytes(80) + struct.pack("<I", len(table) if count is None else count) + table.tobytes()


def gltf(node: dict[str, object], count: int = 4, **primitive: object) -> bytes:
    body = POINTS.tobytes() + FACES.astype("<u4").tobytes()
    tree = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, **node}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, **primitive}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": count, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5125, "count": 12, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 48},
            {"buffer": 0, "byteOffset": 48, "byteLength": 48},
        ],
        "materials": [{"pbrMetallicRoughness": {"baseColorFactor": [1.0, 0.2, 0.0, 1.0]}}],
        "buffers": [
            {
                "byteLength": 96,
                "uri": "data:application/octet-stream;base64," + base64.b64encode(body).decode(),
            }
        ],
    }
    return json.dumps(tree).encode()


def placed(folder: Path, name: str, content: bytes | str) -> Path:
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def refusal(path: Path) -> str:
    """The message of `read_mesh`, which must be one line that names the file."""
    with pytest.raises(FileError) as caught:
        read_mesh(path)
    message = str(caught.value)
    assert str(path) in message
    assert "\n" not in message
    return message


# --- Round trips --------------------------------------------------------------------------------


def test_written_ply_reads_back_bit_for_bit(tmp_path):
    rng = np.random.default_rng(7)
    normals = rng.normal(size=(4, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    sent = Mesh(
        POINTS,
        FACES,
        normals.astype(np.float32),
        rng.random((4, 2), np.float32),
        rng.random((4, 3), np.float32),
    )
    write_ply(tmp_path / "a.ply", sent)
    (mesh,) = read_mesh(tmp_path / "a.ply")
    np.testing.assert_array_equal(mesh.vertices, sent.vertices)
    np.testing.assert_array_equal(mesh.faces, sent.faces)
    np.testing.assert_array_equal(mesh.uv, sent.uv)
    np.testing.assert_array_equal(mesh.color, sent.color)
    np.testing.assert_allclose(mesh.normals, sent.normals, atol=1e-6)
    assert mesh.vertices.dtype == np.float32


def test_gltf_node_transform_is_applied(tmp_path):
    node = {"translation": [10, 20, 30], "scale": [2, 2, 2]}
    (mesh,) = read_mesh(placed(tmp_path, "a.gltf", gltf(node)))
    np.testing.assert_allclose(np.sort(mesh.vertices, 0), np.sort(POINTS * 2 + [10, 20, 30], 0))


def test_gltf_base_colour_is_linear(tmp_path):
    (mesh,) = read_mesh(placed(tmp_path, "a.gltf", gltf({}, material=0)))
    assert mesh.color is not None
    np.testing.assert_allclose(mesh.color, np.tile([1, 0.2, 0], (4, 1)), atol=1 / 255)


def textured_obj(folder: Path, picture: str) -> Path:
    placed(folder, "a.mtl", f"newmtl skin\nmap_Kd {picture}\n")
    uv = "vt 0 0\nvt 1 0\nvt 0 1\nvt 1 1\n"
    faces = "usemtl skin\n" + "".join(f"f {a}/{a} {b}/{b} {c}/{c}\n" for a, b, c in FACES + 1)
    points = "".join(f"v {x} {y} {z}\n" for x, y, z in POINTS)
    return placed(folder, "a.obj", "mtllib a.mtl\n" + points + uv + faces)


def test_obj_texture_outside_the_folder_is_not_opened(tmp_path):
    from PIL import Image

    inner = tmp_path / "in"
    inner.mkdir()
    Image.fromarray(np.zeros((4, 4, 3), np.uint8)).save(tmp_path / "secret.png")
    (mesh,) = read_mesh(textured_obj(inner, "../secret.png"))
    assert mesh.texture is None


def textured_ply(folder: Path, picture: str) -> Path:
    text = ply_header(4, 4, "ascii").decode()
    text = text.replace("1.0\n", f"1.0\ncomment TextureFile {picture}\n", 1)
    text = text.replace("float z\n", "float z\nproperty float s\nproperty float t\n")
    text += "".join(f"{x} {y} {z} 0 0\n" for x, y, z in POINTS)
    return placed(folder, "a.ply", text + "".join(f"3 {a} {b} {c}\n" for a, b, c in FACES))


def textured_gltf(folder: Path, picture: str) -> Path:
    tree = json.loads(gltf({}, material=0))
    tree["images"], tree["textures"] = [{"uri": picture}], [{"source": 0}]
    tree["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = {"index": 0}
    return placed(folder, "a.gltf", json.dumps(tree))


@pytest.mark.parametrize("textured", [textured_obj, textured_ply, textured_gltf])
def test_a_missing_picture_is_reported_and_not_replaced(tmp_path, capfd, textured):
    messages: list[str] = []
    path = textured(tmp_path, "gone.png")
    (mesh,) = read_mesh(path, messages.append)
    assert mesh.texture is None
    assert messages == [
        f"{path}: 'gone.png' is missing, unreadable or outside the mesh's folder; "
        "the relic goes without it"
    ]
    assert capfd.readouterr().err == ""


# --- Refusals -----------------------------------------------------------------------------------


@pytest.mark.parametrize("index", [4, -1, 2**31 - 1])
def test_ply_index_out_of_range_is_refused(tmp_path, index):
    faces = FACES.astype(np.int64)
    faces[2, 1] = index
    path = placed(tmp_path, "a.ply", tetrahedron_ply(faces=faces))
    assert str(index) in refusal(path)
    with pytest.raises(FileError, match="refers to vertex"):
        read_shapes(path, "ply")


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_non_finite_vertex_is_refused_in_every_format(tmp_path, value):
    points = POINTS.copy()
    points[1, 2] = value
    lines = OBJ.splitlines()
    lines[1] = f"v 1 0 {value}"
    for name, content in (
        ("a.ply", tetrahedron_ply(points)),
        ("a.stl", stl(points[FACES])),
        ("a.obj", "\n".join(lines)),
    ):
        assert "not finite" in refusal(placed(tmp_path, name, content))


ZEROS = json.dumps(
    {
        "asset": {"version": "2.0"},
        "accessors": [{"count": 10**9, "componentType": 5126, "type": "VEC3"}],
    }
).encode()


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("vertices.ply", ply_header(10**9, 4) + bytes(96), "cut short"),
        ("faces.ply", ply_header(4, 10**9) + bytes(96), "cut short"),
        ("huge.ply", ply_header(10**18, 10**18) + bytes(96), "cut short"),
        ("ascii.ply", ply_header(10**9, 10**9, "ascii") + b"0 0 0\n", "cut short"),
        ("count.stl", stl(POINTS[FACES], 10**9), "no faces"),
        ("short.stl", stl(POINTS[FACES])[:-1], "no faces"),
        ("accessor.gltf", gltf({}, count=10**9), "not a readable gltf"),
        ("zeros.gltf", ZEROS, "1000000000 items without data"),
        ("chunk.glb", b"glTF" + struct.pack("<IIII", 2, 36, 8, 2**31) + bytes(12), "readable glb"),
    ],
)
def test_lying_counts_are_refused_quickly_and_cheaply(tmp_path, name, content, words):
    path = placed(tmp_path, name, content)
    tracemalloc.start()
    began = time.process_time()
    message = refusal(path)
    seconds, peak = time.process_time() - began, tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert words in message
    assert seconds < 2
    assert peak < 32 * 2**20


STRIPS = (
    b"ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\n"
    b"property float z\nelement tristrips 1\nproperty list int int vertex_indices\nend_header\n"
    b"0 0 0\n1 0 0\n0 1 0\n1 1 0\n4 0 1 2 3\n"
)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("empty.ply", b"", "empty"),
        ("blank.obj", b"\n\n", "empty"),
        ("points.ply", ply_header(4, 0) + POINTS.tobytes(), "no faces"),
        ("points.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "no faces"),
        ("wire.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nl 1 2\nl 2 3\n", "no faces"),
        ("strips.ply", STRIPS, "strips"),
        ("line.ply", tetrahedron_ply(POINTS * [1, 0, 0]), "zero area"),
        ("far.ply", tetrahedron_ply(POINTS * np.float32(1e30)), "3e+30"),
        ("range.obj", OBJ + "f 1 2 9\n", "out of bounds"),
        ("relative.obj", OBJ + "f -1 -2 -9\n", "index -9 after 4 vertices"),
        ("words.obj", OBJ + "v one two three\n", "not a readable obj"),
        ("flat.obj", OBJ.replace("v 1.0 0.0 0.0", "v 1.0 0.0"), "numbers"),
        ("slash.obj", OBJ + "f 1/1 /2 3\n", "not a readable obj"),
        ("nan.obj", OBJ + "f 1 nan 3\n", "not a readable obj"),
        ("solid.stl", b"solid x\nendsolid x\n", "no faces"),
        ("none.stl", b"none" + bytes(80), "no faces"),
        ("cut.glb", b"glTF" + struct.pack("<III4s", 2, 999, 900, b"JSON"), "not a readable glb"),
        ("tree.gltf", b'{"asset": 1, "nodes": ' + b"[" * 10**5, "not a readable gltf"),
        ("a.txt", b"hello", "not a mesh"),
        ("a.glb", b"hello", "its content is not"),
    ],
)
def test_files_without_a_surface_are_refused_in_one_line(tmp_path, name, content, words):
    assert words in refusal(placed(tmp_path, name, content))


# --- Meshes of scenes ---------------------------------------------------------------------------


def test_relative_indices_are_read(tmp_path):
    path = placed(tmp_path, "a.obj", OBJ + "f -4 -3 -2\n")
    assert len(read_mesh(path)[0].faces) == 5
    assert len(read_shapes(path, "obj")[0].faces) == 5
