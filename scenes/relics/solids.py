"""Closed triangle meshes: lathed, swept, pierced; and the PLY files they go to.

Lengths are millimetres, +y is up, the front of a relic faces +z. Texture coordinate v runs
downwards, as image rows do. Every part is a closed surface whose normals point outwards.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import trimesh

GRID_MM = 1e-4  # coordinates are rounded to this, so that seams close exactly


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh with normals and texture coordinates.

    Attributes
    ----------
    points : (n, 3) float64
        Vertices [mm].
    normals : (n, 3) float64
        Unit vertex normals.
    uv : (n, 2) float64
        Texture coordinates, v downwards.
    faces : (m, 3) int32
        Vertex indices, counter-clockwise seen from outside.
    """

    points: np.ndarray
    normals: np.ndarray
    uv: np.ndarray
    faces: np.ndarray


def smooth_normals(points, faces):
    """Area-weighted vertex normals, shared by vertices at the same place (so seams do not show).

    Parameters
    ----------
    points : (n, 3) float64
    faces : (m, 3) int

    Returns
    -------
    (n, 3) float64
    """
    _, place = np.unique(points, axis=0, return_inverse=True)
    place = place.reshape(-1)
    a, b, c = (points[faces[:, k]] for k in range(3))
    face_normals = np.cross(b - a, c - a)
    total = np.zeros((place.max() + 1, 3))
    for k in range(3):
        np.add.at(total, place[faces[:, k]], face_normals)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return (total / np.where(length > 0, length, 1.0))[place]


def signed_volume(points, faces):
    """Volume of a closed mesh [mm^3], negative when its faces look inwards."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def grid_mesh(points, uv):
    """Mesh of a grid of points that closes on itself, with faces turned outwards.

    Parameters
    ----------
    points : (rows, columns, 3) float64
        First and last column coincide; the first and last row may shrink to a point.
    uv : (rows, columns, 2) float64

    Returns
    -------
    Mesh
    """
    rows, columns = points.shape[:2]
    points = placed(points.reshape(-1, 3))
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b = index[:-1, :-1].ravel(), index[:-1, 1:].ravel()
    c, d = index[1:, 1:].ravel(), index[1:, :-1].ravel()
    faces = np.stack([np.stack([a, b, c], 1), np.stack([a, c, d], 1)], 1).reshape(-1, 3)
    p, q, r = (points[faces[:, k]] for k in range(3))
    distinct = (p != q).any(1) & (q != r).any(1) & (r != p).any(1)
    faces = faces[distinct]
    if signed_volume(points, faces) < 0:
        faces = faces[:, ::-1]
    used, faces = np.unique(faces, return_inverse=True)
    faces = faces.reshape(-1, 3).astype(np.int32)
    points = points[used]
    return Mesh(points, smooth_normals(points, faces), uv.reshape(-1, 2)[used], faces)


def join(meshes):
    """One mesh out of several, without welding them."""
    counts = np.cumsum([0] + [len(mesh.points) for mesh in meshes[:-1]])
    return Mesh(
        np.concatenate([mesh.points for mesh in meshes]),
        np.concatenate([mesh.normals for mesh in meshes]),
        np.concatenate([mesh.uv for mesh in meshes]),
        np.concatenate([m.faces + n for m, n in zip(meshes, counts, strict=True)]).astype(np.int32),
    )


def placed(points):
    """Points rounded to the grid of coordinates."""
    return np.round(points / GRID_MM) * GRID_MM + 0.0  # + 0.0 turns -0 into 0


def moved(mesh, x=0.0, y=0.0, z=0.0):
    """The mesh shifted by some millimetres."""
    return replace(mesh, points=placed(mesh.points + np.array([x, y, z])))


def turned(mesh, angle_deg):
    """The mesh turned about the y axis, its front towards +x for 90 degrees."""
    angle = np.radians(angle_deg)
    c, s = np.cos(angle), np.sin(angle)
    return rotated(mesh, np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]))


def tipped(mesh, angle_deg):
    """The mesh turned about the x axis, its top towards +z for 90 degrees."""
    angle = np.radians(angle_deg)
    c, s = np.cos(angle), np.sin(angle)
    return rotated(mesh, np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]]))


def rotated(mesh, rotation):
    """The mesh turned by a (3, 3) rotation matrix."""
    points = placed(mesh.points @ rotation.T)
    return replace(mesh, points=points, normals=mesh.normals @ rotation.T)


def xy(text):
    """Points written as ``"x,y x,y ..."``, (k, 2) float64."""
    return np.array([[float(number) for number in pair.split(",")] for pair in text.split()])


def spline(points, steps):
    """Catmull-Rom curve through points, parametrised by chord length so that it does not overshoot.

    Parameters
    ----------
    points : (k, d) array_like
    steps : int
        Pieces between two neighbouring points.

    Returns
    -------
    ((k - 1) * steps + 1, d) float64
    """
    points = np.asarray(points, float)
    chords = np.linalg.norm(np.diff(points, axis=0), axis=1)
    knots = np.concatenate([[0.0], np.cumsum(np.sqrt(chords))])
    tangents = np.gradient(points, knots, axis=0)
    pieces = []
    for k in range(len(points) - 1):
        t = np.linspace(0.0, 1.0, steps, endpoint=False)[:, None]
        h = knots[k + 1] - knots[k]
        pieces.append(
            (2 * t**3 - 3 * t**2 + 1) * points[k]
            + (t**3 - 2 * t**2 + t) * h * tangents[k]
            + (3 * t**2 - 2 * t**3) * points[k + 1]
            + (t**3 - t**2) * h * tangents[k + 1]
        )
    return np.concatenate([*pieces, points[-1:]])


def arc_length(curve):
    """Length along a polyline at each of its points [mm]."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])


def lathe(profile, v, segments, turns=1.0, relief=None):
    """Surface of revolution about the y axis.

    Parameters
    ----------
    profile : (k, 2) array_like
        Radius and height [mm], from axis to axis.
    v : (k,) array_like
        Texture coordinate of each profile point.
    segments : int
        Columns of the grid around the axis.
    turns : float
        How often the texture repeats around the axis; its centre (u = 0.5) is in front.
    relief : (k, segments + 1) float64, optional
        Added to the radius [mm].

    Returns
    -------
    Mesh
    """
    profile = np.asarray(profile, float)
    angle = np.linspace(-np.pi, np.pi, segments + 1)
    radius = profile[:, :1] + (0.0 if relief is None else relief)
    radius = np.broadcast_to(radius, (len(profile), segments + 1))
    height = np.broadcast_to(profile[:, 1:], radius.shape)
    points = np.stack([radius * np.sin(angle), height, radius * np.cos(angle)], -1)
    uv = np.empty((*radius.shape, 2))
    uv[..., 0] = angle / (2 * np.pi) * turns + 0.5
    uv[..., 1] = np.asarray(v, float)[:, None]
    return grid_mesh(points, uv)


def sweep(path, across, half_width, half_thickness, segments=20, squareness=1.0):
    """Bar with a rounded section along a plane curve, closed at both ends.

    Parameters
    ----------
    path : (k, 3) float64
        Centre line [mm], in a plane.
    across : (3,) array_like
        Unit vector perpendicular to that plane.
    half_width, half_thickness : float or (k,) array_like
        Half axes of the section, along ``across`` and in the plane of the curve [mm].
    segments : int
        Columns of the grid around the bar.
    squareness : float
        1 for an ellipse, towards 0 for a rectangle.

    Returns
    -------
    Mesh
    """
    path = np.asarray(path, float)
    tangent = np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    across = np.asarray(across, float)
    normal = np.cross(tangent, across)
    angle = np.linspace(0.0, 2 * np.pi, segments + 1)
    x = np.sign(np.cos(angle)) * np.abs(np.cos(angle)) ** squareness
    y = np.sign(np.sin(angle)) * np.abs(np.sin(angle)) ** squareness
    x[-1], y[-1] = x[0], y[0]
    width = np.broadcast_to(half_width, len(path))[:, None, None]
    thickness = np.broadcast_to(half_thickness, len(path))[:, None, None]
    ring = width * x[:, None] * across + thickness * y[:, None] * normal[:, None]
    closed = np.pad(ring, ((1, 1), (0, 0), (0, 0)))  # a ring of size 0 at each end
    points = np.pad(path, ((1, 1), (0, 0)), mode="edge")[:, None] + closed
    v = np.linspace(0.0, 1.0, len(points))[:, None]
    uv = np.stack(np.broadcast_arrays(angle / (2 * np.pi), v), -1)
    return grid_mesh(points, uv)


def torus(radius, half_thickness, segments=64, sides=20):
    """Ring about the y axis, of a round section; its centre is the origin."""
    angle = np.linspace(0.0, 2 * np.pi, sides + 1)
    profile = np.stack([radius + half_thickness * np.cos(angle), np.sin(angle)], -1)
    profile[:, 1] *= half_thickness
    profile[-1] = profile[0]
    return lathe(profile, angle / (2 * np.pi), segments)


def write_ply(mesh, folder, name):
    """Check a mesh; write ``folder/meshes/name.ply``, little-endian with normals and (u, v)."""
    solid = trimesh.Trimesh(mesh.points, mesh.faces, process=False)
    solid.merge_vertices(merge_tex=True, merge_norm=True)
    if not (solid.is_watertight and solid.is_winding_consistent and solid.volume > 0):
        raise ValueError(f"{name}: the mesh is not a closed surface with outward faces")
    if not (np.isfinite(mesh.normals).all() and solid.area_faces.min() > 0):
        raise ValueError(f"{name}: the mesh has degenerate faces or normals")
    if len(mesh.points) > np.iinfo(np.uint16).max:
        raise ValueError(f"{name}: too many vertices for 16-bit face indices")
    vertices = np.hstack([mesh.points, mesh.normals, mesh.uv]).astype("<f4")
    faces = np.empty(len(mesh.faces), dtype=[("count", "u1"), ("index", "<u2", 3)])
    faces["count"], faces["index"] = 3, mesh.faces
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    header += [f"property float {axis}" for axis in ("x", "y", "z", "nx", "ny", "nz", "u", "v")]
    header += [f"element face {len(faces)}", "property list uchar ushort vertex_indices"]
    header += ["end_header"]
    data = "\n".join(header).encode("ascii") + b"\n" + vertices.tobytes() + faces.tobytes()
    path = Path(folder) / "meshes" / f"{name}.ply"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    print(f"{name}.ply: {len(faces)} triangles, {solid.extents.round(1)} mm")


def pierced_disc(inner, outer, relief, rings, half_thickness, bevel):
    """Flat round plate with a hole, relief on the front, plain rims on the back.

    Parameters
    ----------
    inner : (columns,) float64
        Radius of the hole's edge at evenly spaced angles, first and last alike [mm].
    outer : float
        Radius of the plate [mm].
    relief : callable
        Height above the plate [mm] at front positions x, y [mm].
    rings : int
        Rows of the grid across the front.
    half_thickness, bevel : float
        Of the plate [mm].

    Returns
    -------
    Mesh
        u runs over the front (0..0.5, seen from +z) and then over the back (0.5..1).
    """
    angle = np.linspace(0.0, 2 * np.pi, len(inner))
    direction = np.stack([np.cos(angle), np.sin(angle)], -1)
    start, end = inner + bevel, np.full_like(inner, outer - bevel)
    share = np.linspace(0.0, 1.0, rings)
    front = [(1 - s) * start + s * end for s in share]
    back = [(1 - s) * start + s * end for s in share[:: -(rings // 8)]]
    wall_out, wall_in = np.full_like(inner, outer), inner
    radii = np.array([*front, wall_out, wall_out, *back, wall_in, wall_in, front[0]])
    flat = radii[..., None] * direction
    is_front = np.arange(len(radii)) < rings
    is_front[-1] = True
    z = np.full(radii.shape, -half_thickness)
    z[is_front] = half_thickness + relief(flat[is_front, :, 0], flat[is_front, :, 1])
    z[rings], z[-2] = half_thickness - bevel, half_thickness - bevel
    z[rings + 1], z[-3] = bevel - half_thickness, bevel - half_thickness
    points = np.concatenate([flat, z[..., None]], -1)
    uv = np.stack([0.25 + 0.25 * flat[..., 0] / outer, 0.5 - 0.5 * flat[..., 1] / outer], -1)
    behind = ~is_front
    behind[[rings, -2]] = False
    uv[behind, :, 0] = 1.0 - uv[behind, :, 0]
    return grid_mesh(points, uv)
