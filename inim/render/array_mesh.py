"""Shape plugin `inim_mesh`: a mesh of decoded arrays in place of Mitsuba's own file readers.

Bit for bit, its positions and normals are those of Mitsuba's shape `ply`.
"""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np

from inim.files.triangle_mesh import Mesh

PLUGIN = "inim_mesh"
_ARRAYS = ("faces", "vertex_positions", "vertex_normals", "vertex_texcoords")
_ATTRIBUTE = "attribute."
# Mitsuba's readers differ in which way v grows.
_FLIPS_BY_DEFAULT = {"ply": False, "obj": True}


def register() -> None:
    """Register the plugin in the active variant."""
    mi.register_shape(PLUGIN, _shape)


def pass_mesh(properties: Any, mesh: Mesh) -> None:
    """Let a `ply` or `obj` shape have a mesh instead of the file that it names.

    Parameters
    ----------
    properties : mi.Properties
        Of the shape; changed in place.
    mesh : Mesh
        With indices in range.
    """
    flipped = _FLIPS_BY_DEFAULT[properties.plugin_name()]
    if "flip_tex_coords" in properties:
        flipped = properties["flip_tex_coords"]
        del properties["flip_tex_coords"]
    del properties["filename"]
    properties.set_plugin_name(PLUGIN)
    transform = properties.get("to_world", mi.ScalarAffineTransform4d())
    matrix, normal_matrix = (
        mi.Matrix4f(np.asarray(m, np.float32).reshape(4, 4))
        for m in (transform.matrix, transform.inverse_transpose)
    )
    to_world = mi.AffineTransform4f(matrix, normal_matrix)
    arrays = {
        "faces": mesh.faces.astype(np.uint32),
        "vertex_positions": np.array(to_world @ mi.Point3f(mesh.vertices.T)).T,
    }
    if mesh.normals is not None and not properties.get("face_normals", False):
        x, y, z = np.array(to_world @ mi.Normal3f(mesh.normals.T))
        # In the order of Mitsuba's own sum.
        scale = np.float32(1) / np.sqrt(x * x + z * z + y * y)
        arrays["vertex_normals"] = np.stack([x * scale, y * scale, z * scale], axis=1)
    if mesh.uv is not None:
        u, v = mesh.uv.T
        arrays["vertex_texcoords"] = np.stack([u, 1 - v if flipped else v], axis=1)
    colors = {} if mesh.color is None else {"vertex_color": mesh.color}
    for name, values in {**mesh.attributes, **colors}.items():
        arrays[_ATTRIBUTE + name] = values
    for name, values in arrays.items():
        kind = mi.TensorXu if name == "faces" else mi.TensorXf
        properties[name] = kind(np.ascontiguousarray(values))


def _shape(properties: Any) -> Any:
    """Build the shape; Mitsuba computes normals that are missing."""
    arrays = {
        name: properties[name]
        for name in list(properties.keys())
        if name in _ARRAYS or name.startswith(_ATTRIBUTE)
    }
    shape = mi.Mesh(
        properties.id(),
        arrays["vertex_positions"].shape[0],
        arrays["faces"].shape[0],
        properties,
        has_vertex_normals=not properties.get("face_normals", False),
        has_vertex_texcoords="vertex_texcoords" in arrays,
    )
    parameters = mi.traverse(shape)
    for name, values in arrays.items():
        if name.startswith(_ATTRIBUTE):
            shape.add_attribute(name.removeprefix(_ATTRIBUTE), values.shape[1], values.array)
        else:
            parameters[name] = values.array
    parameters.update()
    return shape
