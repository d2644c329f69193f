"""Meshes passed as arrays against Mitsuba's own readers.

Expected: equal arrays, bit for bit, from PLY; the same picture from OBJ, whose corners Mitsuba
numbers otherwise.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from inim.render.meshes.mesh import read_shapes
from inim.system.errors import FileError
from tests.serialized_meshes import serialized

MOVED = (
    '<transform name="to_world"><scale x="2" y="-1" z="0.5"/>'
    '<rotate x="1" y="2" z="0.3" angle="33"/><translate x="1" y="-2" z="3"/></transform>'
)
EMITTER = '<emitter type="area"><rgb name="radiance" value="1, 2, 3"/></emitter>'
INSIDE = (
    '<bsdf type="dielectric"/><medium name="interior" type="homogeneous">'
    '<rgb name="albedo" value="0.5, 0.6, 0.7"/></medium>'
)
POINTS = np.random.default_rng(3).normal(size=(6, 3)).astype(np.float32)
FACES = np.array([[0, 1, 2], [2, 1, 3], [3, 4, 5], [0, 4, 5]])


def ply(path: Path, columns: list[str], form: str, face: tuple[str, ...] = ()) -> Path:
    """A PLY with random values in more columns, `TYPE NAME` each."""
    rng = np.random.default_rng(5)
    codes = {"float": "f4", "double": "f8", "uchar": "u1", "ushort": "u2"}
    order = {"ascii": "=", "binary_big_endian": ">"}.get(form, "<")

    def table(names: list[str], count: int) -> list[np.ndarray]:
        kinds = [codes[name.split()[0]] for name in names]
        return [
            rng.random(count).astype(k) if k[0] == "f" else rng.integers(0, 256, count).astype(k)
            for k in kinds
        ]

    vertex = [*POINTS.T, *table(columns, len(POINTS))]
    faces = [np.full(len(FACES), 3, np.uint8), *FACES.T.astype(np.int32)]
    faces += table(list(face), len(FACES))
    head = ["ply", f"format {form} 1.0", f"element vertex {len(POINTS)}"]
    head += [f"property float {c}" for c in "xyz"] + [f"property {c}" for c in columns]
    head += [f"element face {len(FACES)}", "property list uchar int vertex_indices"]
    head += [f"property {c}" for c in face] + ["end_header"]
    body = b""
    for group in (vertex, faces):
        for row in zip(*group, strict=True):
            if form == "ascii":
                body += (" ".join(str(v) for v in row) + "\n").encode()
            else:
                body += b"".join(np.array(v, v.dtype.newbyteorder(order)).tobytes() for v in row)
    path.write_bytes("\n".join([*head, ""]).encode() + body)
    return path


def shapes(path: Path, plugin: str, inner: str) -> tuple[Any, Any]:
    """The shape of a scene, read by Mitsuba and passed as arrays."""
    import mitsuba as mi

    from inim.render.scene import use_mesh

    config = mi.parser.ParserConfig(mi.variant())
    config.merge_meshes = False
    text = (
        f'<scene version="3.0.0"><shape type="{plugin}" id="relic">'
        f'<string name="filename" value="{path}"/>{inner}</shape></scene>'
    )
    meshes = []
    for passed in (False, True):
        state = mi.parser.parse_string(config, text)
        for node in state.nodes:
            if passed and node.props.plugin_name() == plugin:
                use_mesh(node.props, read_shapes(path, plugin)[node.props.get("shape_index", 0)])
        mi.parser.transform_all(config, state)
        scene = mi.parser.instantiate(config, state)
        meshes += scene.shapes()
    return meshes[0], meshes[1]


def assert_equal(theirs: Any, ours: Any, tolerance: float = 0) -> None:
    import mitsuba as mi

    first, second = mi.traverse(theirs), mi.traverse(ours)
    assert set(first.properties) == set(second.properties)
    for name in first.properties:
        if "vertex" in name or "face" in name:
            np.testing.assert_allclose(
                np.asarray(second[name]), np.asarray(first[name]), rtol=0, atol=tolerance
            )
    assert str(ours.bbox()) == str(theirs.bbox())
    assert ours.id() == theirs.id()
    assert ours.is_emitter() == theirs.is_emitter()
    assert (ours.interior_medium() is None) == (theirs.interior_medium() is None)
    assert ours.has_face_normals() == theirs.has_face_normals()
    assert ours.has_flipped_normals() == theirs.has_flipped_normals()


NORMALS = ["float nx", "float ny", "float nz"]


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize(
    "inner",
    [
        "",
        MOVED,
        MOVED + '<boolean name="face_normals" value="true"/>',
        MOVED + '<boolean name="flip_normals" value="true"/>',
        '<boolean name="flip_tex_coords" value="true"/>' + EMITTER,
        MOVED + INSIDE,
    ],
)
@pytest.mark.parametrize(
    "columns",
    [
        [],
        NORMALS,
        [*NORMALS, "float u", "float v"],
        ["double s", "double t", "float r", "float g", "float b"],
        ["float heat_0", "float stain_r", "float stain_g", "float stain_b", "float lonely"],
    ],
)
def test_ply_gives_the_arrays_of_mitsuba(renderer, tmp_path, form, inner, columns):
    path = ply(tmp_path / "a.ply", columns, form, ("float glow_0",))
    assert_equal(*shapes(path, "ply", inner))


def test_integer_colours_are_srgb(renderer, tmp_path):
    """Mitsuba 3.9 takes 16-bit ones so, too, and 8-bit ones for values up to 255."""
    columns = [f"ushort {name}" for name in ("red", "green", "blue")]
    assert_equal(*shapes(ply(tmp_path / "a.ply", columns, "ascii"), "ply", ""), tolerance=1e-5)


OBJ = {
    "plain": "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 1\nf 1 2 3\nf 3 2 4\n",
    "polygon": "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nusemtl a\nf 1 2 3 4\nusemtl b\nf 1 3 2\n",
    "seam": "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 1\nvt 0 0.25\nvt 1 0\nvt 0 1\nvt 0.5 0.5\n"
    "vn 0 0 2\nvn 0 1 0\nf 1/1/1 2/2/1 3/3/1\nf 3/4/2 2/2/1 4/4/2\n",
}


@pytest.mark.parametrize("name", OBJ)
@pytest.mark.parametrize("inner", ["", MOVED, '<boolean name="flip_tex_coords" value="false"/>'])
def test_obj_gives_the_corners_of_mitsuba(renderer, tmp_path, name, inner):
    import mitsuba as mi

    path = tmp_path / "a.obj"
    path.write_text(OBJ[name])
    corners = []
    for shape in shapes(path, "obj", inner):
        values = mi.traverse(shape)
        faces = np.asarray(values["faces"])
        meshes = [
            np.asarray(values[f"vertex_{name}"]).reshape(shape.vertex_count(), -1)[faces]
            for name in ("positions", "normals", "texcoords")
            if len(values[f"vertex_{name}"])
        ]
        each_face = np.hstack(meshes).reshape(shape.face_count(), 3, -1)
        # A face may begin at any corner.
        first = [min(range(3), key=lambda k: tuple(face[k].round(3))) for face in each_face]
        turned = [np.roll(f, -k, axis=0).ravel() for f, k in zip(each_face, first, strict=True)]
        flat = np.array(turned)
        corners.append(flat[np.lexsort(flat.T)])
    np.testing.assert_allclose(corners[1], corners[0], atol=1e-6)


def _serialized_meshes() -> list[dict[str, np.ndarray]]:
    rng = np.random.default_rng(8)
    plain = {"vertices": POINTS, "faces": FACES}
    normals, uv = rng.normal(size=(6, 3)), rng.random((6, 2))
    return [plain, {**plain, "normals": normals}, {**plain, "normals": normals, "uv": uv},
            {**plain, "uv": uv, "color": rng.random((6, 3))}]  # fmt: skip


@pytest.mark.parametrize("number", range(4))
@pytest.mark.parametrize(("version", "kind"), [(3, "f4"), (4, "f4"), (4, "f8")])
def test_serialized_gives_the_arrays_of_mitsuba(renderer, tmp_path, number, version, kind):
    path = tmp_path / "a.serialized"
    path.write_bytes(serialized(_serialized_meshes(), version, kind))
    inner = f'{MOVED}<integer name="shape_index" value="{number}"/>'
    assert_equal(*shapes(path, "serialized", inner))


def test_a_damaged_serialized_mesh_has_one_line(tmp_path):
    """Cut anywhere, or with any changed byte: read with equal numbers, or refused."""
    path = tmp_path / "a.serialized"
    data = serialized(_serialized_meshes())
    path.write_bytes(data)
    whole = read_shapes(path, "serialized")
    refused = 0
    for place in range(len(data)):
        path.write_bytes(data[:place] if place % 2 else _changed(data, place))
        try:
            meshes = read_shapes(path, "serialized")
        except FileError as error:
            refused += 1
            assert "\n" not in str(error)
            assert "a.serialized" in str(error)
        else:
            assert len(meshes) == len(whole)
            for mesh, original in zip(meshes, whole, strict=True):
                np.testing.assert_array_equal(mesh.faces, original.faces)
                np.testing.assert_array_equal(mesh.vertices, original.vertices)
    assert refused > 0.9 * len(data)


def _changed(data: bytes, place: int) -> bytes:
    return data[:place] + bytes([data[place] ^ 0x55]) + data[place + 1 :]
