"""glTF files with extensions: numbers mean what the extensions' specifications say."""

import json

import numpy as np
import pytest
from PIL import Image

from inim.render.meshes.mesh import read_mesh
from inim.system.errors import FileError

FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]], "<u2")
CORNERS = np.array([[0, 0, 0], [65535, 0, 0], [0, 65535, 0], [0, 0, 13107]], "<u2")
COORDINATES = np.array([[0, 0], [255, 0], [0, 255], [51, 102]], np.uint8)
TRANSFORM = {"offset": [0.25, -0.5], "scale": [2.0, 0.5]}


def quantized(folder, texture, **header):
    """A tetrahedron with 16-bit positions and 8-bit texture coordinates, (folder)/q.gltf."""
    Image.new("RGB", (8, 8), (200, 100, 50)).save(folder / "t.png")
    parts = {
        "POSITION": (np.pad(CORNERS, ((0, 0), (0, 1))), 5123, "VEC3", 8),
        "indices": (FACES, 5123, "SCALAR", None),
        "TEXCOORD_0": (np.zeros((4, 4), np.uint8), 5121, "VEC2", 4),
        "TEXCOORD_1": (np.pad(COORDINATES, ((0, 0), (0, 2))), 5121, "VEC2", 4),
    }
    body, views, accessors = b"", [], []
    for numbers, kind, shape, stride in parts.values():
        view = {"buffer": 0, "byteOffset": len(body), "byteLength": numbers.nbytes}
        views.append(view | ({} if stride is None else {"byteStride": stride}))
        count = 12 if shape == "SCALAR" else 4
        accessor = {"bufferView": len(accessors), "componentType": kind, "count": count}
        accessors.append({**accessor, "type": shape, "normalized": shape != "SCALAR"})
        body += numbers.tobytes()
    (folder / "q.bin").write_bytes(body)
    attributes = {"POSITION": 0, "TEXCOORD_0": 2, "TEXCOORD_1": 3}
    tree = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "scale": [0.5, 0.5, 0.5]}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": 1, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0, **texture}}}],
        "textures": [{"source": 0}],
        "images": [{"uri": "t.png"}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"uri": "q.bin", "byteLength": len(body)}],
        **header,
    }
    path = folder / "q.gltf"
    path.write_text(json.dumps(tree))
    return path


def read(path):
    (mesh,) = read_mesh(path, pytest.fail)
    return mesh


def test_normalized_positions_and_another_set_of_texture_coordinates(tmp_path):
    mesh = read(quantized(tmp_path, {"texCoord": 1}))
    np.testing.assert_allclose(mesh.vertices, CORNERS / 65535 / 2, rtol=1e-6)
    # Row 0 of a picture is v = 0 in glTF, and v = 1 here.
    u, v = (COORDINATES / 255).T
    np.testing.assert_allclose(mesh.uv, np.stack([u, 1 - v], -1), rtol=1e-6, atol=1e-7)


def test_texture_coordinates_are_transformed(tmp_path):
    extension = {"KHR_texture_transform": {**TRANSFORM, "texCoord": 1}}
    mesh = read(quantized(tmp_path, {"extensions": extension}))
    u, v = (COORDINATES / 255).T
    expected = np.stack([2 * u + 0.25, 1 - (v / 2 - 0.5)], axis=-1)
    np.testing.assert_allclose(mesh.uv, expected, rtol=1e-6)


RGB = [[255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255]]


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.usdz", b"PK\3\4 usd", "a.usdz: .*import it in Blender"),
        ("a.3mf", b"PK\3\4 3mf", "a.3mf: .*MeshLab"),
        (
            "a.ply",
            b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
            b"property float z\nelement tristrips 1\nproperty list int int vertex_indices\n"
            b"end_header\n0 0 0\n1 0\n",
            "a.ply: has triangle strips; open it in MeshLab",
        ),
    ],
)
def test_other_formats_name_the_program_to_convert_with(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(FileError, match=message):
        read_mesh(tmp_path / name)
