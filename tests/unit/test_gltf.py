"""glTF files with extensions: numbers mean what the extensions' specifications say."""

import json

import numpy as np
import pytest
import trimesh
from PIL import Image

from inim.errors import FileError
from inim.files.mesh import read_mesh
from inim.scene.new_scene import new_scene

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


def test_draco_is_read(tmp_path):
    sphere = trimesh.creation.icosphere(subdivisions=3)
    path = tmp_path / "d.glb"
    path.write_bytes(trimesh.exchange.gltf.export_glb(sphere, extension_draco=True))
    assert b"KHR_draco_mesh_compression" in path.read_bytes()
    mesh = read(path)
    assert mesh.faces.shape == sphere.faces.shape
    np.testing.assert_allclose(np.linalg.norm(mesh.vertices, axis=1), 1, atol=1e-3)


@pytest.mark.parametrize(
    ("name", "command"),
    [("EXT_meshopt_compression", "copy q.gltf"), ("KHR_texture_basisu", "ktxdecompress q.gltf")],
)
def test_an_unread_extension_names_the_converter(tmp_path, monkeypatch, name, command):
    path = quantized(tmp_path, {}, extensionsRequired=[name])
    monkeypatch.chdir(tmp_path)
    with pytest.raises(FileError, match=f"{name}.*@gltf-transform/cli {command}"):
        read_mesh(path.relative_to(tmp_path), pytest.fail)


def test_a_folder_s_only_mesh_becomes_a_scene(tmp_path):
    folder = tmp_path / "scan"
    folder.mkdir()
    quantized(folder, {"texCoord": 1})
    assert new_scene(folder, tmp_path / "relic.xml", warn=lambda text: None).is_file()
    (folder / "other.obj").write_text("")
    with pytest.raises(FileError, match=r"2 meshes \(other.obj, q.gltf\)"):
        new_scene(folder, tmp_path / "second.xml")
