"""Mesh files keep their geometry, colours, instances and textures, or a line names the loss."""

import base64
import json

import numpy as np
import pytest
from PIL import Image

from inim.render.meshes.mesh import read_mesh, read_shapes
from inim.render.scene_files.new_scene import new_scene
from inim.system.errors import FileError

# A tetrahedron with a right corner of 1, 2 and 3 units: its volume is 1.
CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]], float)
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
RED, GREEN, BLUE = np.eye(3)


def obj_text(corners=CORNERS, first=1):
    vertices = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in corners]
    return "\n".join([*vertices, *(f"f {a} {b} {c}" for a, b, c in FACES + first)]) + "\n"


def volume(mesh):
    a, b, c = (mesh.vertices[mesh.faces[:, k]].astype(float) for k in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


def messages_of(tmp_path, name, content, **options):
    """Scene of a file, as written, with the warnings and notes of the way there."""
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    lines = []
    choices = {"unit": "mm", "up": "y"} | options
    scene = new_scene(path, tmp_path / "out.xml", warn=lines.append, say=lines.append, **choices)
    return scene, lines


@pytest.mark.parametrize("name", ["a.obj", "a.ply", "a.off"])
def test_survey_coordinates_keep_their_digits_until_they_are_centred(tmp_path, name):
    place = np.array([506612.625, 4614943.75, 512.25])
    far = CORNERS + place
    texts = {
        "a.obj": obj_text(far),
        "a.ply": "ply\nformat ascii 1.0\nelement vertex 4\nproperty double x\nproperty double y\n"
        "property double z\nelement face 4\nproperty list uchar int vertex_indices\nend_header\n"
        + "".join(f"{x:.6f} {y:.6f} {z:.6f}\n" for x, y, z in far)
        + "".join(f"3 {a} {b} {c}\n" for a, b, c in FACES),
        "a.off": "OFF\n4 4 0\n"
        + "".join(f"{x:.6f} {y:.6f} {z:.6f}\n" for x, y, z in far)
        + "".join(f"3 {a} {b} {c}\n" for a, b, c in FACES),
    }
    scene, lines = messages_of(tmp_path, name, texts[name], unit="m")
    (mesh,) = read_mesh(scene.with_suffix(".ply"))
    assert np.ptp(mesh.vertices, axis=0) == pytest.approx([1000, 2000, 3000])
    assert volume(mesh) == pytest.approx(1e9, rel=1e-6)
    assert lines == ["read 4 triangles, 1 body, 1 x 2 x 3 units, no colours"]


def test_coordinates_without_their_digits_are_named(tmp_path):
    far = (CORNERS + 4614943.75).astype(np.float32)
    _, lines = messages_of(tmp_path, "a.obj", obj_text(far))
    assert any("32-bit numbers have steps of 0.5" in line for line in lines)
    heard = []
    read_shapes(tmp_path / "a.obj", "obj", heard.append)
    assert "`inim new-scene` centres a mesh first" in heard[0]


def test_relative_indices_count_back_from_their_own_line(tmp_path):
    text = ""
    for x in (-30, 30, 90):
        moved = CORNERS + np.array([x, 0, 0])
        text += "".join(f"v {a:g} {b:g} {c:g}  # corner\n" for a, b, c in moved)
        text += "vt 0 0\n\n" + "".join(f"f {a} {b} {c}\n" for a, b, c in FACES - 4)
    _, lines = messages_of(tmp_path, "a.obj", text.replace("\n", "\r\n"))
    assert lines == ["read 12 triangles, 3 bodies, 121 x 2 x 3 units, no colours"]


@pytest.mark.parametrize(("face", "words"), [("f 0 1 2", "index 0"), ("f -9 1 2", "index -9")])
def test_impossible_indices_are_refused(tmp_path, face, words):
    (tmp_path / "a.obj").write_text(obj_text() + face + "\n")
    with pytest.raises(FileError, match=words):
        read_mesh(tmp_path / "a.obj")


@pytest.mark.parametrize(
    "line",
    [
        "map_Kd -s 1 1 1 -o 0 0 0 tex.png",
        "map_Kd -clamp on -mm 0 1 -bm 0.5 tex.png",
        r"map_Kd maps\tex.png",
        r"map_kd C:\Users\me\Tex.PNG",
        'map_Kd "tex.png"',
    ],
)
def test_textures_are_found_by_any_line_of_their_name(tmp_path, line):
    Image.new("RGB", (4, 4), (200, 100, 50)).save(tmp_path / "tex.png")
    (tmp_path / "first.mtl").write_text("newmtl other\nKd 1 0 0\n")
    (tmp_path / "second.mtl").write_text(f"newmtl m\nKd 1 1 1\n{line}\n")
    corners = "".join(f"v {x} {y} {z}\n" for x, y, z in CORNERS) + "vt 0 0\nvt 1 0\nvt 0 1\n"
    faces = "".join(f"f {a}/1 {b}/2 {c}/3\n" for a, b, c in FACES + 1)
    text = f"mtllib first.mtl second.mtl\n{corners}usemtl m\n{faces}"
    _, lines = messages_of(tmp_path, "a.obj", text)
    assert lines == ["read 4 triangles, 1 body, 1 x 2 x 3 units, 1 texture"]
    assert np.asarray(Image.open(tmp_path / "out.png"))[0, 0].tolist() == [200, 100, 50]


def test_scale_and_offset_of_a_texture_are_applied_and_other_maps_are_named(tmp_path):
    Image.new("RGB", (4, 4)).save(tmp_path / "tex.png")
    (tmp_path / "a.mtl").write_text("newmtl m\nmap_Kd -s 2 3 -o 0.5 0.25 tex.png\nmap_d hole.png\n")
    corners = "".join(f"v {x} {y} {z}\n" for x, y, z in CORNERS) + "vt 0 0\nvt 1 0\nvt 0 1\n"
    path = tmp_path / "a.obj"
    path.write_text(f"mtllib a.mtl\n{corners}usemtl m\nf 1/1 2/2 3/3\n")
    heard = []
    (mesh,) = read_mesh(path, heard.append)
    assert sorted(mesh.uv.tolist()) == [[0.5, 0.25], [0.5, 3.25], [2.5, 0.25]]
    assert any("not read: map_d" in line for line in heard)


def colored_ply(form):
    head = (
        f"ply\nformat {form} 1.0\nelement vertex 4\nproperty float x\nproperty float y\n"
        "property float z\nproperty float quality\nelement face 4\n"
        "property list uchar int vertex_indices\nproperty uchar red\nproperty uchar green\n"
        "property uchar blue\nend_header\n"
    )
    colors = np.array([RED, GREEN, BLUE, RED], np.uint8) * 255
    if form == "ascii":
        rows = [f"{x} {y} {z} 1" for x, y, z in CORNERS]
        rows += [f"3 {a} {b} {c} {r} {g} {u}" for (a, b, c), (r, g, u)
                 in zip(FACES, colors, strict=True)]  # fmt: skip
        return (head + "\n".join(rows) + "\n").encode()
    table = np.zeros(4, [("n", "u1"), ("i", "<i4", 3), ("c", "u1", 3)])
    table["n"], table["i"], table["c"] = 3, FACES, colors
    return (
        head.encode()
        + np.pad(CORNERS, ((0, 0), (0, 1))).astype("<f4").tobytes()
        + (table.tobytes())
    )


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian"])
def test_colours_of_the_faces_of_a_ply_are_read_and_other_numbers_named(tmp_path, form):
    _, lines = messages_of(tmp_path, "a.ply", colored_ply(form))
    assert lines[0].endswith("not read: quality of each vertex")
    assert lines[1] == "read 4 triangles, 1 body, 1 x 2 x 3 units, colours"
    (mesh,) = read_mesh(tmp_path / "a.ply")
    assert np.array_equal(mesh.color[::3], [RED, GREEN, BLUE, RED])


def test_blank_lines_and_comments_in_the_body_of_a_ply_are_skipped(tmp_path):
    head, body = colored_ply("ascii").decode().split("end_header\n")
    lines = body.splitlines()
    lines[6:6], lines[1:1] = ["   ", "comment 3 0 1 2"], ["", "comment after the header"]
    (tmp_path / "a.ply").write_text(head + "end_header\n" + "\n".join(lines) + "\n")
    (mesh,) = read_mesh(tmp_path / "a.ply")
    assert len(mesh.faces) == 4
    assert np.array_equal(mesh.color[::3], [RED, GREEN, BLUE, RED])


@pytest.mark.parametrize(
    ("head", "vertex", "face"),
    [
        ("OFF", "", " 255 0 0"),
        ("OFF", "", " 1.0 0.0 0.0"),
        ("COFF", " 255 0 0 255", ""),
        ("CNOFF", " 0 0 1 1.0 0.0 0.0", ""),
    ],
)
def test_colours_of_off_files_are_read(tmp_path, head, vertex, face):
    text = f"{head}\n# a comment\n4 4 0\n"
    text += "".join(f"{x} {y} {z}{vertex}\n" for x, y, z in CORNERS)
    text += "".join(f"3 {a} {b} {c}{face}\n" for a, b, c in FACES)
    (tmp_path / "a.off").write_text(text)
    (mesh,) = read_mesh(tmp_path / "a.off")
    assert len(mesh.faces) == 4
    assert np.unique(mesh.color, axis=0).tolist() == [[1, 0, 0]]


def gltf(node=None, material=None, **header):
    """A tetrahedron, and three translations, rotations and scales."""
    parts = [
        (CORNERS.astype("<f4"), 5126, "VEC3"),
        (FACES.astype("<u2"), 5123, "SCALAR"),
        (np.array([[0, 0, 0], [5, 0, 0], [0, 7, 0]], "<f4"), 5126, "VEC3"),
        (np.array([[0, 0, 0, 127], [0, 0, 0, 127], [0, 0, 127, 0]], "i1"), 5120, "VEC4"),
    ]
    body, views, accessors = b"", [], []
    for numbers, kind, shape in parts:
        views.append({"buffer": 0, "byteOffset": len(body), "byteLength": numbers.nbytes})
        count = numbers.size if shape == "SCALAR" else len(numbers)
        accessor = {"bufferView": len(accessors), "componentType": kind, "count": count}
        accessors.append({**accessor, "type": shape, "normalized": kind == 5120})
        body += numbers.tobytes() + bytes(-numbers.nbytes % 4)
    primitive = {"attributes": {"POSITION": 0}, "indices": 1, "material": 0}
    uri = "data:application/octet-stream;base64," + base64.b64encode(body).decode()
    tree = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, **(node or {})}],
        "meshes": [{"primitives": [primitive]}],
        "materials": [material or {}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"uri": uri, "byteLength": len(body)}],
        **header,
    }
    return json.dumps(tree)


INSTANCES = {
    "extensions": {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 2, "ROTATION": 3}}}
}


@pytest.mark.parametrize("word", ["extensionsRequired", "extensionsUsed"])
def test_instances_are_placed(tmp_path, word):
    text = gltf(INSTANCES, **{word: ["EXT_mesh_gpu_instancing"]})
    _, lines = messages_of(tmp_path, "a.gltf", text, unit="m")
    # The third is turned by half a turn about z, and lies at y = 7.
    assert lines == ["read 12 triangles, 3 bodies, 7 x 7 x 3 units, no colours"]


def test_colours_of_instances_are_named(tmp_path):
    attributes = {"TRANSLATION": 2, "_COLOR_0": 2}
    node = {"extensions": {"EXT_mesh_gpu_instancing": {"attributes": attributes}}}
    text = gltf(node, extensionsUsed=["EXT_mesh_gpu_instancing"])
    _, lines = messages_of(tmp_path, "a.gltf", text, unit="m")
    assert "not read: 1 _COLOR_0 of instances" in lines[0]


def test_other_required_extensions_are_refused_and_optional_ones_named(tmp_path):
    with pytest.raises(FileError, match=r"needs XYZ_made_up"):
        messages_of(tmp_path, "a.gltf", gltf(extensionsRequired=["XYZ_made_up"]))
    text = gltf(extensionsUsed=["XYZ_made_up"], animations=[{}], skins=[{}, {}])
    _, lines = messages_of(tmp_path, "b.gltf", text)
    assert "not read: XYZ_made_up, 1 animations, 2 skins" in lines[0]


def test_black_surfaces_that_shine_have_the_colour_of_their_light(tmp_path):
    black = {"pbrMetallicRoughness": {"baseColorFactor": [0, 0, 0, 1]}}
    _, lines = messages_of(tmp_path, "a.gltf", gltf(material=black), unit="m")
    assert any("all of its colours are black" in line for line in lines)
    text = gltf(material={**black, "emissiveFactor": [0, 0.5, 0]})
    messages_of(tmp_path, "b.gltf", text, unit="m", force=True)
    (mesh,) = read_mesh(tmp_path / "b.gltf")
    assert np.unique(mesh.color, axis=0)[0] == pytest.approx([0, 0.5, 0], abs=1 / 255)
    grey = {"pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.5, 0.5, 1]}}
    text = gltf(material={**grey, "emissiveFactor": [0, 0.5, 0]})
    _, lines = messages_of(tmp_path, "c.gltf", text, unit="m", force=True)
    assert "1 emissions of coloured surfaces" in lines[0]


L_SHAPE = [(1, 1), (1, 2), (0, 2), (0, 0), (2, 0), (2, 1)]


@pytest.mark.parametrize("kind", ["obj", "ply", "off"])
def test_concave_polygons_keep_their_area(tmp_path, kind):
    points = "\n".join(f"{x} {y} 0" for x, y in L_SHAPE)
    texts = {
        "obj": "".join(f"v {row}\n" for row in points.split("\n")) + "f 1 2 3 4 5 6\n",
        "ply": "ply\nformat ascii 1.0\nelement vertex 6\nproperty float x\nproperty float y\n"
        "property float z\nelement face 1\nproperty list uchar int vertex_index\nend_header\n"
        f"{points}\n6 0 1 2 3 4 5\n",
        "off": f"OFF\n6 1 0\n{points}\n6 0 1 2 3 4 5\n",
    }
    (tmp_path / f"a.{kind}").write_text(texts[kind])
    (mesh,) = read_mesh(tmp_path / f"a.{kind}")
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    assert np.cross(b - a, c - a)[:, 2].sum() / 2 == pytest.approx(3)
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2 == pytest.approx(3)


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_polygons_of_a_ply_have_the_colours_of_their_faces(tmp_path, form):
    order = ">" if form.endswith("big_endian") else "<"
    head = (
        f"ply\nformat {form} 1.0\nelement vertex 5\nproperty float x\nproperty float y\n"
        "property float z\nelement face 2\nproperty list uchar int vertex_indices\n"
        "property list uchar float texcoord\nproperty uchar red\nproperty uchar green\n"
        "property uchar blue\nend_header\n"
    )
    points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 2, 0)]
    polygons = [((0, 1, 2, 3), (255, 0, 0)), ((3, 2, 4), (0, 255, 0))]
    if form == "ascii":
        rows = [" ".join(map(str, point)) for point in points]
        for corners, color in polygons:
            wedges = [2 * len(corners)] + [0.5] * 2 * len(corners)
            rows.append(" ".join(map(str, [len(corners), *corners, *wedges, *color])))
        body = ("\n".join(["", *rows]) + "\n").encode()
    else:
        body = np.array(points, order + "f4").tobytes()
        for corners, color in polygons:
            body += bytes([len(corners)]) + np.array(corners, order + "i4").tobytes()
            body += (
                bytes([2 * len(corners)]) + np.full(2 * len(corners), 0.5, order + "f4").tobytes()
            )
            body += bytes(color)
    (tmp_path / "a.ply").write_bytes(head.encode() + body)
    (mesh,) = read_mesh(tmp_path / "a.ply", pytest.fail)
    assert len(mesh.faces) == 3
    assert np.array_equal(mesh.color[::3], [RED, RED, GREEN])


@pytest.mark.parametrize(
    ("use", "library"),
    [
        ("usemtl\tred  wine", "newmtl red wine\nKd 1 0 0 # red\n"),
        ("  usemtl Red", "\ufeffnewmtl red\nKd 1 0 0\n"),
        ("usemtl m # c", "newmtl m\nKe 1 0 0\nKd 0 0 0\n"),
        ("usemtl m", "newmtl m\r\nKd 1 \\\r\n0 0\r\n"),
    ],
)
def test_materials_are_found_by_their_names(tmp_path, use, library):
    (tmp_path / "my a.mtl").write_bytes(library.encode())
    (tmp_path / "a.obj").write_text(f'mtllib "my a.mtl"\n{use}\n{obj_text()}')
    (mesh,) = read_mesh(tmp_path / "a.obj", pytest.fail)
    assert np.unique(mesh.color, axis=0).tolist() == [[1, 0, 0]]


def test_missing_materials_and_colours_are_named(tmp_path):
    (tmp_path / "a.mtl").write_text("newmtl a\nKd spectral x.rfl\nnewmtl b\nd 0.1\n")
    (tmp_path / "a.obj").write_text(f"mtllib a.mtl\nusemtl c\n{obj_text()}l 1 2\n")
    heard = []
    read_mesh(tmp_path / "a.obj", heard.append)
    text = "\n".join(heard)
    assert "1 lines" in text
    assert "materials c are not defined" in text
    assert "Kd spectral x.rfl" in text
    assert "materials b are transparent" in text


def test_colours_of_vertices_multiply_those_of_a_material(tmp_path):
    (tmp_path / "a.mtl").write_text("newmtl m\nKd 1 1 1\n")
    rows = "".join(f"v {x} {y} {z} 1 0 0\n" for x, y, z in CORNERS)
    faces = "".join(f"f {a} {b} {c}\n" for a, b, c in FACES + 1)
    (tmp_path / "a.obj").write_text(f"mtllib a.mtl\n{rows}usemtl m\n{faces}")
    (mesh,) = read_mesh(tmp_path / "a.obj", pytest.fail)
    assert np.unique(mesh.color, axis=0).tolist() == [[1, 0, 0]]


def test_sparse_accessors_and_fans_are_read(tmp_path):
    tree = json.loads(gltf())
    body = base64.b64decode(tree["buffers"][0]["uri"].partition(",")[2])
    start = len(body)
    body += np.array([3], "<u2").tobytes() + bytes(2) + np.array([0, 0, 30], "<f4").tobytes()
    uri = "data:application/octet-stream;base64," + base64.b64encode(body).decode()
    tree["buffers"] = [{"uri": uri, "byteLength": len(body)}]
    tree["bufferViews"] += [
        {"buffer": 0, "byteOffset": start, "byteLength": 2},
        {"buffer": 0, "byteOffset": start + 4, "byteLength": 12},
    ]
    tree["accessors"][0]["sparse"] = {
        "count": 1,
        "indices": {"bufferView": 4, "componentType": 5123},
        "values": {"bufferView": 5},
    }
    (tmp_path / "s.gltf").write_text(json.dumps(tree))
    (mesh,) = read_mesh(tmp_path / "s.gltf", pytest.fail)
    assert mesh.vertices.max(axis=0).tolist() == [1, 2, 30]
    # The same places and bytes as indices: the fourth index becomes 3.
    sparse = tree["accessors"][0].pop("sparse")
    sparse["values"], sparse["indices"]["bufferView"] = {"bufferView": 4}, 4
    tree["accessors"][1]["sparse"] = sparse
    (tmp_path / "i.gltf").write_text(json.dumps(tree))
    (mesh,) = read_mesh(tmp_path / "i.gltf", pytest.fail)
    assert np.array_equal(mesh.vertices[mesh.faces[1]], CORNERS[[3, 1, 3]])
    tree = json.loads(gltf())
    primitive = tree["meshes"][0]["primitives"][0]
    primitive["mode"] = 6
    del primitive["indices"]
    (tmp_path / "f.gltf").write_text(json.dumps(tree))
    (mesh,) = read_mesh(tmp_path / "f.gltf", pytest.fail)
    assert np.array_equal(mesh.vertices[mesh.faces[1]], CORNERS[[0, 2, 3]])


@pytest.mark.parametrize("extra", [{"mesh": 99}, INSTANCES, {"camera": 0, "children": [0]}])
def test_nodes_outside_the_scene_do_no_harm(tmp_path, extra):
    tree = json.loads(gltf())
    tree["nodes"].append(extra)
    _, lines = messages_of(tmp_path, "a.gltf", json.dumps(tree), unit="m")
    assert lines == ["read 4 triangles, 1 body, 1 x 2 x 3 units, no colours"]


def test_colours_of_an_stl_are_named(tmp_path):
    table = np.zeros(4, [("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    table["v"], table["a"] = CORNERS[FACES], 0x801F
    count = (4).to_bytes(4, "little")
    _, lines = messages_of(tmp_path, "a.stl", bytes(80) + count + table.tobytes())
    assert "not read: colours of an STL" in lines[0]
