"""Model the relics of the example scenes: meshes (binary PLY) and textures (PNG).

Run ``python scenes/make_relics.py``: it rewrites ``scenes/meshes`` and ``scenes/textures``, byte
for byte the same on every run. Lengths are millimetres, +y is up, the front of a relic faces +z.
Texture coordinate v runs downwards, as image rows do. Every part is a closed surface whose normals
point outwards; parts may sink into one another.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image, ImageDraw

SCENES = Path(__file__).resolve().parent
SEED = 20240901
SUPERSAMPLING = 2  # drawn this much larger, then averaged, so that edges are smooth
GRID_MM = 1e-4  # coordinates are rounded to this, so that seams close exactly

BLACK_GLAZE = (30, 24, 23)
TERRACOTTA = (196, 104, 56)
PURPLE = (112, 34, 38)
CREAM = (226, 208, 172)


# ------------------------------------------------------------------------------------------- meshes


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
    rotation = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
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


def write_ply(mesh, name):
    """Check a mesh and write it to ``meshes/name.ply``, little-endian with normals and (u, v)."""
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
    (SCENES / "meshes" / f"{name}.ply").write_bytes(data)
    print(f"{name}.ply: {len(faces)} triangles, {solid.extents.round(1)} mm")


# ----------------------------------------------------------------------------------------- textures


class Canvas:
    """An image to draw on in millimetres, origin at the centre of its top edge, y downwards.

    Parameters
    ----------
    width_mm, height_mm : float
        Size of what is drawn.
    pixels : (int, int)
        Width and height of the finished image.
    colour : (int, int, int) or int
        Background; an int makes a grey image.
    """

    def __init__(self, width_mm, height_mm, pixels, colour):
        self.pixels = pixels
        self.scale = np.array(pixels) * SUPERSAMPLING / np.array([width_mm, height_mm])
        self.centre = np.array([pixels[0] * SUPERSAMPLING / 2, 0.0])
        mode = "L" if isinstance(colour, int) else "RGB"
        self.paper = Image.new(mode, tuple(SUPERSAMPLING * n for n in pixels), colour)
        self.draw = ImageDraw.Draw(self.paper)

    def _place(self, points):
        return [tuple(p) for p in np.asarray(points, float) * self.scale + self.centre]

    def polygon(self, points, colour):
        """Fill a closed outline."""
        self.draw.polygon(self._place(points), fill=colour)

    def line(self, points, width_mm, colour):
        """Draw a polyline with round joints and ends."""
        width = max(1, round(width_mm * float(self.scale.mean())))
        self.draw.line(self._place(points), fill=colour, width=width, joint="curve")
        for end in (points[0], points[-1]):
            self.disc(end, width_mm / 2, colour)

    def disc(self, centre, radius_mm, colour):
        """Fill a circle; two radii make an ellipse."""
        low, high = np.subtract(centre, radius_mm), np.add(centre, radius_mm)
        self.draw.ellipse([*self._place([low])[0], *self._place([high])[0]], fill=colour)

    def band(self, top, bottom, colour):
        """Fill the full width between two heights."""
        far = 1e5
        self.polygon([(-far, top), (far, top), (far, bottom), (-far, bottom)], colour)

    def array(self):
        """The finished image, (rows, columns[, 3]) float64 in 0..255."""
        return np.asarray(self.paper.reduce(SUPERSAMPLING), float)


class Pen:
    """Draws on a canvas in a frame of its own: moved, scaled and perhaps mirrored.

    Parameters
    ----------
    canvas : Canvas
    origin : (float, float)
        Where the frame's (0, 0) lies [mm].
    scale : (float, float)
        Millimetres per unit in x and y; negative mirrors. Widths scale with y.
    """

    def __init__(self, canvas, origin, scale):
        self.canvas, self.origin, self.scale = canvas, np.asarray(origin), np.asarray(scale)

    def at(self, points):
        """Points of the frame on the canvas [mm]."""
        return self.origin + np.asarray(points, float) * self.scale

    def shape(self, points, colour, steps=5):
        """Fill a smooth closed outline."""
        self.canvas.polygon(self.at(spline([*points, points[0]], steps)), colour)

    def stroke(self, points, width, colour, steps=6):
        """Draw a smooth line; with ``steps=1`` a polyline."""
        self.canvas.line(self.at(spline(points, steps)), width * abs(self.scale[1]), colour)

    def curl(self, centre, radius, turns, start_deg, hand, width, colour, end_radius=0.0):
        """Draw a spiral from its outer end inwards."""
        points = spiral(centre, radius, turns, start_deg, hand, 24, end_radius)
        self.canvas.line(self.at(points), width * abs(self.scale[1]), colour)

    def disc(self, centre, radius, colour):
        """Fill a circle; two radii make an ellipse."""
        self.canvas.disc(self.at(centre), np.asarray(radius) * np.abs(self.scale[1]), colour)


def write_png(array, name):
    """Write an sRGB image, (rows, columns, 3) in 0..255, to ``textures/name.png``."""
    image = Image.fromarray(np.clip(np.round(array), 0, 255).astype(np.uint8))
    path = SCENES / "textures" / f"{name}.png"
    image.save(path, optimize=True)
    print(f"{name}.png: {image.width} x {image.height}, {path.stat().st_size // 1024} KiB")


def blurred(image, sigma_rows, sigma_columns=None):
    """Gaussian blur that wraps around in columns and repeats the edge in rows.

    Parameters
    ----------
    image : (rows, columns) float64
    sigma_rows, sigma_columns : float
        Standard deviations [pixels]; the second defaults to the first.
    """
    sigmas = (sigma_rows, sigma_rows if sigma_columns is None else sigma_columns)
    for axis, (sigma, mode) in enumerate(zip(sigmas, ("edge", "wrap"), strict=True)):
        reach = max(1, int(3 * sigma))
        kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
        kernel /= kernel.sum()
        padding = [(0, 0), (0, 0)]
        padding[axis] = (reach, reach)
        padded = np.pad(image, padding, mode=mode)
        size = image.shape[axis]
        shifts = (np.take(padded, range(k, k + size), axis=axis) for k in range(len(kernel)))
        image = sum(weight * shifted for weight, shifted in zip(kernel, shifts, strict=True))
    return image


def mottle(rows, columns, cells, octaves, rng):
    """Smooth random field in -1..1 (about), periodic in columns.

    Parameters
    ----------
    rows, columns : int
        Size of the field [pixels].
    cells : int
        Random values across the width in the coarsest octave.
    octaves : int
        Each doubles the cells and halves the weight.
    rng : numpy.random.Generator

    Returns
    -------
    (rows, columns) float64
    """
    field = np.zeros((rows, columns))
    for octave in range(octaves):
        count = cells * 2**octave
        down = max(2, round(count * rows / columns))
        values = rng.uniform(-1.0, 1.0, (down + 1, count))
        y = np.linspace(0.0, down, rows, endpoint=False)
        x = np.linspace(0.0, count, columns, endpoint=False)
        i, j = y.astype(int), x.astype(int)
        s, t = y - i, x - j
        s, t = (s * s * (3 - 2 * s))[:, None], t * t * (3 - 2 * t)
        right = (j + 1) % count
        top = values[i][:, j] * (1 - t) + values[i][:, right] * t
        low = values[i + 1][:, j] * (1 - t) + values[i + 1][:, right] * t
        field += (top * (1 - s) + low * s) / 2**octave
    return field


def spiral(centre, start_radius, turns, start_deg=0.0, hand=1, steps=24, end_radius=0.0):
    """Points of an Archimedean spiral, from its outer end inwards, (k, 2)."""
    count = int(abs(turns) * steps) + 2
    share = np.linspace(0.0, 1.0, count)
    radius = start_radius + (end_radius - start_radius) * share
    angle = np.radians(start_deg) + hand * 2 * np.pi * turns * share
    return np.asarray(centre) + np.stack([radius * np.cos(angle), radius * np.sin(angle)], -1)


# ------------------------------------------------------------------------------------------ amphora


def amphora_profile():
    """Profile of the amphora from below the foot, up the outside, over the lip and down inside.

    Returns
    -------
    profile : (k, 2) float64
        Radius and height [mm].
    outer : int
        Number of points up to the top of the lip.
    """
    foot = xy("0,0 30,0 52,0 56,1.5 58,6 57,11 53,15 44,19 37,22 34,25")
    ring = [(35, 28), (35.5, 30)]
    body = xy("36,32 56,62 88,112 118,165 133,215 134,245 122,277 96,302 66,317 52,322")
    collar = [(53.5, 324), (54.5, 326.5), (53.5, 329), (51, 331)]
    neck = spline([(49.5, 334), (46, 347), (46, 362), (50, 376), (55, 381)], 5)
    lip = xy("63,384 70,388 73,392 73.5,396 72,399.2 70,400")
    inside = xy("62,399.6 57,397 50,385 43,372 41,350 45,330 60,312 40,296 0,292")
    outer = np.concatenate([foot, ring, spline(body, 7), collar, neck, lip])
    return np.concatenate([outer, inside]), len(outer)


def amphora_body():
    """The vase itself, and the length of its outer profile from the foot to given heights.

    Returns
    -------
    mesh : Mesh
        v runs from 0 at the lip to 1 under the foot; u covers half a turn, front and back alike.
    down : callable
        Maps a height on the vase [mm] to the distance from the lip along the profile [mm].
    length : float
        Profile length from lip to axis [mm].
    """
    profile, outer = amphora_profile()
    along = arc_length(profile[:outer])
    length = along[-1]
    v = np.concatenate([1.0 - along / length, np.full(len(profile) - outer, 0.001)])
    first = int(np.argmax(profile[:, 1] > 20))  # above this the outside rises without overhang

    def down(height):
        return length - float(np.interp(height, profile[first:outer, 1], along[first:]))

    return lathe(profile, v, 120, turns=2.0), down, length


def amphora_handles():
    """Two handles from the neck to the shoulder."""
    centre = spline(xy("38,362 58,368 84,364 103,343 108,315 105,284"), 6)
    parts = []
    for side in (-1, 1):
        path = np.stack([side * centre[:, 0], centre[:, 1], 0 * centre[:, 0]], -1)
        parts.append(sweep(path, (0, 0, 1), 11.0, 5.5, segments=20, squareness=0.8))
    return join(parts)


def draw_meander(canvas, top, bottom, repeats, half_width):
    """Greek key band between two lines."""
    height = bottom - top
    unit = 2 * half_width / repeats
    key = xy("1.1,0 1.1,1 0,1 0,0 0.76,0 0.76,0.68 0.3,0.68 0.3,0.36 0.5,0.36")
    size = np.array([unit, 0.72 * height])
    for k in range(repeats):
        corner = np.array([-half_width + (k + 0.1) * unit, top + 0.14 * height])
        canvas.line(corner + key * size, 0.13 * height, BLACK_GLAZE)
    draw_rings(canvas, (top, bottom), half_width, 0.1 * height)


def draw_rings(canvas, heights, half_width, width_mm):
    """Thin lines around the vase."""
    for y in heights:
        canvas.line([(-half_width, y), (half_width, y)], width_mm, BLACK_GLAZE)


def draw_palmette(canvas, centre, size, stretch=1.0, down=False, petals=9):
    """Fan of petals over a heart; ``stretch`` widens it where the vase is narrow."""
    pen = Pen(canvas, centre, (size * stretch, -size if down else size))
    t = np.linspace(0.0, 1.0, 16)[:, None]
    width = 0.13 * np.sqrt(np.clip(t**1.3 - t**6, 0.0, None))
    for angle in np.radians(np.linspace(-105, 105, petals)):
        axis = np.array([np.sin(angle), -np.cos(angle)])
        side = width * np.array([axis[1], -axis[0]])
        spine = t * (0.75 + 0.25 * np.cos(angle)) * axis
        canvas.polygon(pen.at(np.concatenate([spine + side, (spine - side)[::-1]])), BLACK_GLAZE)
    pen.disc((0, 0), (0.24 * stretch, 0.24), BLACK_GLAZE)
    pen.disc((0, 0), (0.17 * stretch, 0.17), PURPLE)


HOPLITE = {  # outlines of a warrior one unit tall, facing right, feet at y = 0
    "back leg": xy(
        "-.05,.46 -.15,.34 -.22,.26 -.29,.13 -.35,.05 -.36,0 -.24,0 -.27,.05 -.2,.13 -.13,.24 "
        "-.03,.31 .06,.42"
    ),
    "front leg": xy(
        "0,.46 .1,.38 .2,.3 .18,.16 .19,.05 .18,0 .33,0 .31,.03 .25,.05 .25,.16 .28,.27 .26,.35 "
        ".15,.44 .08,.5"
    ),
    "tunic": xy("-.12,.74 .1,.74 .12,.56 .15,.4 -.03,.37 -.13,.4 -.1,.55"),
    "arm": xy("-.06,.74 -.14,.66 -.25,.74 -.24,.86 -.19,.89 -.17,.84 -.18,.76 -.13,.74 -.04,.8"),
    "helmet": xy("-.02,.74 -.05,.84 0,.92 .08,.92 .13,.87 .14,.83 .11,.83 .13,.75 .06,.78"),
    "spearhead": xy("-.46,.947 .6,.674 .6,.69 .74,.628 .6,.648 .6,.662 -.46,.933"),
}
HOPLITE_CREST = xy(".14,.94 .06,1 -.06,.98 -.14,.88 -.18,.72 -.13,.66 -.1,.82 -.04,.92 .06,.95")
HOPLITE_INCISIONS = (
    xy(".12,.925 .05,.95 -.05,.92 -.1,.82 -.125,.69"),  # crest holder
    xy(".05,.83 .07,.855 .1,.85 .07,.835 .05,.83"),  # eye
    xy("0,.77 .03,.82 .02,.87 .06,.895 .12,.88"),  # cheek piece
    xy("-.11,.44 0,.41 .14,.43"),  # hem
    xy(".2,.27 .21,.17 .215,.06"),  # greaves
    xy(".18,.29 .23,.3 .27,.28"),
    xy("-.2,.25 -.17,.27 -.13,.25"),
    xy("-.2,.23 -.25,.14 -.3,.06"),
)


def draw_warrior(canvas, foot, height, facing, arms):
    """Hoplite in black figure with incised and added colour.

    Parameters
    ----------
    canvas : Canvas
    foot : (float, float)
        Ground below the figure's centre [mm].
    height : float
        From the ground to the top of the crest [mm].
    facing : int
        1 to the right, -1 to the left.
    arms : int
        Arms of the wheel on the shield.
    """
    pen = Pen(canvas, foot, (facing * height, -height))
    for name, outline in HOPLITE.items():
        pen.shape(outline, BLACK_GLAZE, 1 if name == "spearhead" else 5)
    pen.shape(HOPLITE_CREST, PURPLE)
    for points in HOPLITE_INCISIONS:
        pen.stroke(points, 0.009, TERRACOTTA)
    pen.stroke(xy("-.1,.47 -.04,.45 .02,.45"), 0.02, PURPLE)
    shield = (0.1, 0.6)
    rings = ((0.2, TERRACOTTA), (0.19, BLACK_GLAZE), (0.165, PURPLE), (0.155, BLACK_GLAZE))
    for radius, colour in rings:
        pen.disc(shield, radius, colour)
    for k in range(arms):
        pen.curl(shield, 0.13, 0.22, 360.0 * k / arms, 1, 0.026, CREAM, 0.015)


def draw_onlooker(canvas, foot, height, facing):
    """Woman in a patterned robe with a raised hand, in black figure with white skin."""
    pen = Pen(canvas, foot, (facing * height, -height))
    pen.shape(xy(".02,.05 .02,0 .16,0 .15,.03 .09,.06"), CREAM)
    pen.shape(xy(".08,.62 .2,.56 .25,.7 .29,.72 .27,.77 .22,.73 .18,.62"), CREAM)
    robe = "-.02,.82 .1,.75 .1,.6 .09,.45 .15,.1 .14,.03 -.15,.03 -.13,.2 -.12,.5 -.12,.7"
    pen.shape(xy(robe), BLACK_GLAZE)
    pen.shape(xy("-.04,.86 -.08,.94 -.02,1 .05,.99 .07,.93 -.01,.9 -.02,.84"), BLACK_GLAZE)
    pen.shape(xy("-.01,.82 0,.92 .05,.96 .09,.93 .105,.895 .085,.88 .06,.86 .05,.8"), CREAM)
    pen.disc((0.065, 0.925), 0.012, BLACK_GLAZE)
    pen.stroke(xy("-.07,.96 .06,.965"), 0.022, PURPLE)
    pen.shape(xy("-.08,.55 .05,.55 .09,.12 -.09,.12"), PURPLE, 2)
    pen.stroke(xy("-.13,.08 .12,.08"), 0.012, TERRACOTTA)
    pen.stroke(xy("-.11,.56 .08,.56"), 0.012, TERRACOTTA)
    for row in range(4):
        for column in range(3):
            pen.disc((-0.05 + 0.045 * column, 0.19 + 0.1 * row), 0.013, CREAM)


def paint_top(canvas, down, half):
    """Lip, palmettes on the neck, tongues on the shoulder."""
    canvas.band(0, down(379), BLACK_GLAZE)
    for k in range(-3, 4):
        upright = k % 2 == 0
        centre = (k * half / 3, down(341 if upright else 370))
        draw_palmette(canvas, centre, 25, 2.6, down=not upright)
    canvas.band(down(331), down(321), BLACK_GLAZE)
    canvas.band(down(327.5), down(325.5), PURPLE)
    spacing = half / 16
    for k in range(32):
        x = -half + (k + 0.5) * spacing
        tongue = [(x, down(321)), (x, down(304) - 0.36 * spacing)]
        canvas.line(tongue, 0.72 * spacing, PURPLE if k % 2 else BLACK_GLAZE)
    draw_rings(canvas, (down(299.5), down(296.5)), half, 1.6)


def paint_figures(canvas, down, half):
    """A duel between two onlookers, scrolls and a palmette under the handles."""
    ground = down(176)
    tall = ground - down(293)
    for side in (-1, 1):
        draw_onlooker(canvas, (side * 112, ground), 0.86 * tall, -side)
        draw_warrior(canvas, (side * 50, ground), tall, -side, 4 + side)
        frame, scroll = side * (half - 62), side * (half - 28)
        canvas.line(spiral((scroll, down(205)), 24, 1.6, 90, side), 3.5, BLACK_GLAZE)
        canvas.line(spiral((scroll, down(250)), 20, 1.6, -90, -side), 3.5, BLACK_GLAZE)
        draw_palmette(canvas, (side * half, down(225)), 34)
        canvas.line([(frame, ground), (frame, down(296))], 1.4, BLACK_GLAZE)
    draw_rings(canvas, (ground, down(172.5)), half, 1.8)


def paint_bottom(canvas, down, half, length):
    """Meander, bands, rays above the foot."""
    draw_meander(canvas, down(169), down(152), 14, half)
    canvas.band(down(148), down(126), BLACK_GLAZE)
    canvas.band(down(139), down(135.5), PURPLE)
    draw_rings(canvas, [down(122)], half, 1.6)
    spacing = half / 7
    for k in range(14):
        x = -half + (k + 0.5) * spacing
        low, tip = down(40), down(118)
        ray = [(x - 0.42 * spacing, low), (x, tip), (x + 0.42 * spacing, low)]
        canvas.polygon(ray, BLACK_GLAZE)
    canvas.band(down(40), length, BLACK_GLAZE)
    canvas.band(down(31), down(28), PURPLE)


def amphora_texture(down, length, half_turn):
    """Black-figure decoration half way round the vase.

    Parameters
    ----------
    down : callable
        Height on the vase [mm] to distance from the lip along the profile [mm].
    length, half_turn : float
        Size of the drawing [mm].

    Returns
    -------
    (1024, 1024, 3) float64
        sRGB in 0..255.
    """
    canvas = Canvas(half_turn, length, (1024, 1024), TERRACOTTA)
    paint_top(canvas, down, half_turn / 2)
    paint_figures(canvas, down, half_turn / 2)
    paint_bottom(canvas, down, half_turn / 2, length)
    return canvas.array()


def make_amphora(rng):
    """Amphora, 400 mm tall: body, handles and the painted texture."""
    body, down, length = amphora_body()
    write_ply(body, "amphora_body")
    write_ply(amphora_handles(), "amphora_handles")
    painting = amphora_texture(down, length, np.pi * 134.0)
    wear = mottle(1024, 1024, 6, 3, rng)[..., None]
    painting = painting * (1.0 + 0.05 * wear) + 2.0 * wear
    write_png(painting, "amphora")


# ------------------------------------------------------------------------------------------- relief


def sampled(image, u, v):
    """Bilinear look-up of an image at texture coordinates, wrapping in u but not in v.

    Parameters
    ----------
    image : (rows, columns) float64
    u, v : float64 arrays of one shape

    Returns
    -------
    float64 array of that shape
    """
    rows, columns = image.shape
    x = np.mod(u, 1.0) * columns - 0.5
    y = np.clip(v * rows - 0.5, 0.0, rows - 1.0)
    i, j = np.floor(y).astype(int), np.floor(x).astype(int)
    s, t = y - i, x - j
    below, right = np.minimum(i + 1, rows - 1), (j + 1) % columns
    j = j % columns
    upper = image[i, j] * (1 - t) + image[i, right] * t
    lower = image[below, j] * (1 - t) + image[below, right] * t
    return upper * (1 - s) + lower * s


def blend(low, high, share):
    """Mix two colours, or colour fields, by a share in 0..1 per pixel; (rows, columns, 3)."""
    share = np.clip(share, 0.0, 1.0)[..., None]
    return np.asarray(low, float) * (1 - share) + np.asarray(high, float) * share


def patinated(height, recess, surface, worn, stain, rng):
    """Colour of old metal: dark in the recesses, rubbed bare on the heights, stained in patches.

    Parameters
    ----------
    height : (rows, columns) float64
        Relief in 0..1.
    recess, surface, worn, stain : (int, int, int)
        sRGB colours.
    rng : numpy.random.Generator

    Returns
    -------
    (rows, columns, 3) float64
        sRGB in 0..255.
    """
    rows, columns = height.shape
    patches = mottle(rows, columns, 5, 4, rng)
    grain = mottle(rows, columns, 24, 2, rng)
    colour = blend(recess, surface, height * 1.6 + 0.1)
    colour = blend(colour, worn, 1.5 * (height - 0.62) + 0.25 * grain)
    colour = blend(colour, stain, 0.9 * (patches + 0.15 * grain) - 0.25)
    return colour * (1.0 + 0.05 * grain[..., None])


# ------------------------------------------------------------------------------------------- tripod

DING_COLOURS = ((32, 40, 34), (100, 118, 88), (172, 144, 88), (92, 160, 126))
DING_BAND = (114.0, 162.0)  # heights of the relief band [mm]
DING_RADIUS = 93.0


def draw_half_mask(pen, ground, plate, boss):
    """Half of a monster mask: jaw, horn, body with claw and tail, eyebrow, eye."""
    pen.stroke(xy("0,3 5,12 6,28 12,34"), 6, plate)
    pen.curl((19, 36), 7.5, 1.2, 180, -1, 4.5, plate, 1.0)
    pen.stroke(xy("8,13 20,8 38,12 44,4"), 6.5, plate)
    pen.curl((46, 11), 9, 1.3, -100, 1, 5, plate, 1.0)
    pen.stroke(xy("34,27 50,26 66,20 76,12"), 8, plate)
    pen.curl((78, 17), 10, 1.4, -90, 1, 5.5, plate, 1.0)
    pen.stroke(xy("38,34 50,36 58,42"), 6, plate)
    for toe in (52, 58, 64):
        pen.stroke([(52, 36), (toe, 40), (toe + 2, 45)], 3, plate)
    pen.curl((74, 38), 7, 1.3, 200, 1, 4.5, plate, 1.0)
    pen.stroke(xy("27,40 34,36 38,42"), 4, plate)
    for groove in ("36,27 50,26 65,20 74,13", "10,13 20,8.5 37,12", "1,8 2,34"):
        pen.stroke(xy(groove), 1.2, ground)
    for radius, value in (((11.5, 8.5), 40), ((10, 7), boss), (3.2, 60)):
        pen.disc((25, 22), radius, value)


def taotie_relief():
    """Height map of one monster mask on a ground of spirals, a third of the way round the vessel.

    Returns
    -------
    (256, 1024) float64
        Height in 0..1.
    """
    ground, plate, boss = 70, 170, 255
    canvas = Canvas(2 * np.pi * DING_RADIUS / 3, DING_BAND[1] - DING_BAND[0], (1024, 256), 0)
    for row in range(6):
        for k in range(-13, 14):
            centre = (7.6 * k + 3.8 * (row % 2), 4 + 8 * row)
            canvas.line(spiral(centre, 3.4, 1.75, 45, 1 if k % 2 else -1, 4), 0.9, ground)
    for side in (-1, 1):
        draw_half_mask(Pen(canvas, (0, 0), (side, 1)), ground, plate, boss)
    return canvas.array() / 255.0


def ding_bowl():
    """Bowl of the tripod without its relief band; v runs from 0 at the rim."""
    outside = spline(xy("0,84 28,86 58,94 80,108 91,128 93,150"), 5)
    neck = xy("92,164 90.5,168 93,171 99,172 101,174 101,177 99,179")
    inside = spline(xy("92,179 87,176 85,160 82,134 70,112 40,98 0,94"), 3)
    profile = np.concatenate([outside, neck, inside])
    along = arc_length(profile)
    return lathe(profile, 1.0 - along / along[-1], 96, turns=2.0)


def ding_band(relief):
    """Closed ring that carries the masks, three times around, raised by up to 3 mm."""
    low, high = DING_BAND
    height = np.linspace(high, low, 32)
    v = (high - height) / (high - low)
    bulge = DING_RADIUS + 1.2 * np.clip(6 * np.minimum(v, 1 - v), 0, 1) ** 0.5
    bulge -= np.interp(height, [low, low + 18], [5.5, 0.0])
    front = np.stack([bulge, height], -1)
    profile = np.concatenate([[(90, high)], front, [(80, low), (90, high)]])
    v = np.concatenate([[0.0], v, [1.0, 0.0]])
    segments = 336
    u = 3 * np.linspace(-0.5, 0.5, segments + 1) + 0.5
    raised = 3.0 * sampled(relief, *np.broadcast_arrays(u, v[:, None]))
    raised[[0, 1, -3, -2, -1]] = 0.0  # the masks do not reach the edges
    return lathe(profile, v, segments, 3.0, raised)


def ding_flanges():
    """Six notched ridges that divide the masks."""
    low, high = DING_BAND
    y = np.linspace(low - 1, high + 1, 43)
    notch = 1.6 * (np.mod(np.arange(43), 7) == 3)
    lean = np.interp(y, [low, low + 18], [-4.5, 0.0])
    path = np.stack([0 * y, y, DING_RADIUS + lean], -1)
    ridge = sweep(path, (1, 0, 0), 1.9, 6.5 - notch, segments=16, squareness=0.5)
    return join([turned(ridge, 60.0 * k) for k in range(6)])


def ding_legs():
    """Three legs, one behind: columns that swell towards the bowl."""
    column = xy("0,0 9.5,0 11,1 11.2,3 10,8 9.2,20 9,45 9.6,66 12,80 15,92")
    profile = np.concatenate([spline(column[4:], 3), [(15, 104), (0, 104)]])
    profile = np.concatenate([column[:4], profile])
    for ring in (24.0, 62.0):
        profile[:, 0] += 1.3 * np.exp(-(((profile[:, 1] - ring) / 2.5) ** 2)) * (profile[:, 0] > 0)
    leg = lathe(profile, 1.0 - profile[:, 1] / 104.0, 40)
    return join([turned(moved(leg, z=56.0), angle) for angle in (60, 180, 300)])


def ding_handles():
    """Two upright loops on the rim, on opposite sides."""
    arch = np.linspace(np.pi, 0.0, 21)
    top = np.stack([21 * np.cos(arch), 204 + 22 * np.sin(arch)], -1)
    right = xy("20.5,193 19.5,182 19,173.5")
    outline = np.concatenate([(right * [-1, 1])[::-1], top, right])
    path = np.stack([outline[:, 0], outline[:, 1], np.full(len(outline), 93.0)], -1)
    loop = sweep(path, (0, 0, 1), 4.6, 5.6, segments=24, squareness=0.55)
    return join([turned(loop, angle) for angle in (52, 232)])


def make_tripod(rng):
    """Bronze ding, 230 mm tall: bowl, relief band, flanges, legs and handles."""
    relief = blurred(taotie_relief(), 1.6)
    write_ply(ding_band(blurred(relief, 1.5, 2.5)), "tripod_band")
    vessel = join([ding_bowl(), ding_flanges(), ding_legs(), ding_handles()])
    write_ply(vessel, "tripod_vessel")
    write_png(patinated(relief, *DING_COLOURS, rng), "tripod_band")
    plain = 0.42 + 0.14 * mottle(512, 512, 6, 4, rng)
    write_png(patinated(plain, *DING_COLOURS, rng), "tripod_bronze")


# ------------------------------------------------------------------------------------ pierced discs


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


def height_field(image, outer, scale_mm):
    """Height above the plate [mm] as a function of x, y [mm].

    Parameters
    ----------
    image : (n, 2 * n) float64
        Height map in 0..1, the front in its left half.
    outer : float
        Radius of the plate [mm].
    scale_mm : float
        Height of 1.
    """
    front = image[:, : image.shape[1] // 2]

    def relief(x, y):
        return scale_mm * sampled(front, 0.5 + 0.5 * x / outer, 0.5 - 0.5 * y / outer)

    return relief


# --------------------------------------------------------------------------------------- wine, coin

COIN_RADIUS, COIN_HOLE = 32.0, 8.0  # outer radius and half the side of the square hole [mm]
COIN_STROKES = {  # the four characters in a square from (-1, -1) to (1, 1), y downwards
    "da": ("-.9,-.3 .9,-.3", "0,-1 0,-.3 -.3,.3 -.95,.95", ".02,-.3 .3,.3 .95,.95"),
    "quan": (
        *("0,-1 -.2,-.75", "-.6,-.7 .6,-.7 .6,.05 -.6,.05 -.6,-.7", "-.6,-.32 .6,-.32"),
        *("0,.05 0,1", "-.85,.3 -.3,.3 -.9,.85", ".7,.2 .25,.42", ".25,.3 .9,.85"),
    ),
    "wu": (
        *("-.8,-.9 .8,-.9", "-.55,-.85 -.4,-.35 .4,.35 .55,.85"),
        *(".55,-.85 .4,-.35 -.4,.35 -.55,.85", "-.8,.9 .8,.9"),
    ),
    "shi": ("-.85,-.05 .85,-.05", "0,-1 0,1"),
}


def coin_relief():
    """Height map of the coin, front in the left half and plain back in the right, in 0..1."""
    size = 2 * COIN_RADIUS
    canvas = Canvas(2 * size, size, (1024, 512), 0)
    for centre in (-COIN_RADIUS, COIN_RADIUS):
        canvas.disc((centre, COIN_RADIUS), COIN_RADIUS, 255)
        canvas.disc((centre, COIN_RADIUS), COIN_RADIUS - 3.6, 0)
        corners = xy("-1,-1 1,-1 1,1 -1,1") * (COIN_HOLE + 1.9)
        canvas.polygon(corners + np.array([centre, COIN_RADIUS]), 255)
    reach = 0.5 * (COIN_HOLE + 1.9 + COIN_RADIUS - 3.6)
    places = {"da": (0, -reach), "quan": (0, reach), "wu": (reach, 0), "shi": (-reach, 0)}
    for name, strokes in COIN_STROKES.items():
        middle = np.add(places[name], (-COIN_RADIUS, COIN_RADIUS))
        pen = Pen(canvas, middle, (6.6, 6.8))
        for points in strokes:
            pen.stroke(xy(points), 0.31, 235, steps=1)
    return canvas.array() / 255.0


def coin_mesh(height):
    """Coin of 64 mm with a square hole and 1.5 mm of relief."""
    angle = np.linspace(0.0, 2 * np.pi, 201)
    inner = COIN_HOLE / np.maximum(np.abs(np.cos(angle)), np.abs(np.sin(angle)))
    relief = height_field(height, COIN_RADIUS, 1.5)
    return pierced_disc(inner, COIN_RADIUS, relief, 50, 2.0, 0.5)


def goblet_profile():
    """Outside of the goblet from under the foot to the lip, then its inside.

    Returns
    -------
    profile : (k, 2) float64
        Radius and height [mm].
    outer : int
        Number of points up to the lip.
    """
    foot = [(0, 0), (25, 0), (27.5, 0.8), (28, 2.5), (27, 4)]
    stem = spline([(25, 5), (17, 9), (9.5, 17), (6.5, 26), (6, 30)], 5)
    knop = spline([(6.5, 32), (9.5, 34), (11, 37), (9.5, 40), (6.5, 42)], 4)
    cup = spline(xy("6.2,44 13,46 24,53 31,65 33,80 32.5,95 34,108 36,113"), 10)
    lip = [(36.2, 114.2), (35.2, 115)]
    inside = xy("34,114.4 32,108 30.5,95 31,80 28.5,66 22,55 12,50 0,48.5")
    outer = np.concatenate([foot, stem, knop, cup, lip])
    return np.concatenate([outer, inside]), len(outer)


def draw_petal(canvas, base, tip, half_width, value):
    """Lotus petal with a pointed tip and an incised border."""
    t = np.linspace(0.0, 1.0, 24)
    width = half_width * np.minimum(1.0, 1.6 * (1 - t) ** 0.75)
    middle = np.asarray(base) + t[:, None] * np.subtract(tip, base)
    for share, inner in ((1.0, 40), (0.9, value), (0.62, value - 45), (0.54, value)):
        side = share * np.stack([width, np.zeros_like(t)], -1)
        centre = np.asarray(base) + (middle - base) * (0.5 + 0.5 * share)
        canvas.polygon(np.concatenate([centre - side, (centre + side)[::-1]]), inner)


def goblet_relief(down, length, half_turn):
    """Height map of half the goblet, 0..1: lotus petals on cup and foot, a scrolling vine above."""
    canvas = Canvas(half_turn, length, (768, 1024), 96)
    half = half_turn / 2
    for layer, value in ((0.5, 150), (0.0, 200)):
        for k in range(-4, 5):
            x = (k + layer) * half_turn / 6
            draw_petal(canvas, (x, down(45)), (x, down(77 + 3 * layer)), half_turn / 12.4, value)
            draw_petal(canvas, (x, down(16)), (x, down(6)), half_turn / 12.4, value)
    for k in range(6):
        hand = 1 if k % 2 else -1
        pen = Pen(canvas, (-half + (k + 0.5) * half_turn / 6, down(94)), (1, hand))
        pen.curl((0, 0), 6.2, 1.5, -90, 1, 1.5, 225, 0.8)
        x = np.linspace(-half_turn / 12, half_turn / 12, 13)
        pen.stroke(np.stack([x, 7.2 * np.cos(x * np.pi * 6 / half_turn)], -1), 1.5, 225, steps=1)
        for leaf in (-6.0, 6.0):
            pen.disc((leaf, -6.0), (2.0, 1.5), 235)
    for height in (84, 104.5):
        canvas.line([(-half, down(height)), (half, down(height))], 1.6, 230)
    return canvas.array() / 255.0


def make_goblet(rng):
    """Gilt bronze goblet, 115 mm tall."""
    profile, outer = goblet_profile()
    along = arc_length(profile[:outer])
    length = along[-1]

    def down(height):
        return length - float(np.interp(height, profile[4:outer, 1], along[4:]))

    relief = goblet_relief(down, length, np.pi * 33.0)
    v = np.concatenate([1.0 - along / length, np.full(len(profile) - outer, 0.002)])
    segments = 128
    u = 2.0 * np.linspace(-0.5, 0.5, segments + 1) + 0.5
    raised = 1.1 * sampled(blurred(relief, 2.5), *np.broadcast_arrays(u, v[:, None])) - 0.4
    raised *= np.clip((profile[:, :1] - 5.0) / 10.0, 0.0, 1.0)  # none on the stem
    raised[outer - 3 :] = 0.0  # nor on the lip and inside
    write_ply(lathe(profile, v, segments, 2.0, raised), "goblet")
    gilding = ((58, 36, 18), (176, 128, 58), (222, 182, 96), (96, 104, 70))
    write_png(patinated(blurred(relief, 1.0), *gilding, rng), "goblet")


def make_wine_coin(rng):
    """The goblet and a copper cash coin of 64 mm."""
    make_goblet(rng)
    height = blurred(coin_relief(), 2.2)
    write_ply(coin_mesh(height), "coin")
    copper = ((74, 60, 44), (122, 80, 48), (176, 122, 76), (74, 132, 106))
    write_png(patinated(blurred(height, 0.8), *copper, rng), "coin")


# --------------------------------------------------------------------------------------------- jade

JADE_RADIUS, JADE_HOLE = 80.0, 17.0  # [mm]
JADE_DRAGONS = (53.0, 75.5)  # radii of the outer zone [mm]


def draw_dragon(pen):
    """Dragon some 90 mm long, walking to the right; heights in 0..255."""
    body = spline(xy("-40,-5 -34,5 -24,5 -14,-5 -4,-5 6,4 16,4 24,-3 31,-3"), 10)
    thick = 2.2 + 3.8 * np.sin(np.pi * np.linspace(0.06, 0.85, len(body)))
    for point, width in zip(body, thick, strict=True):
        pen.disc(point, width / 2 + 0.8, 215)
    pen.stroke(body, 0.7, 140, steps=1)
    pen.shape(xy("28,-6 36,-8 46,-4 38,-2.5 45,2 36,3.5 29,0"), 245)
    pen.disc((35, -4.6), 1.3, 90)
    pen.stroke(xy("31,-6 25,-9.5 18,-9"), 1.6, 235)
    pen.stroke(xy("38,4 39,8 34,9"), 1.3, 225)
    pen.curl((-44, -5), 4.5, 1.3, 0, -1, 1.9, 225, 0.6)
    pen.curl((2, 6.5), 3.0, 1.4, 180, 1, 1.3, 200, 0.5)
    for x, y, hand in ((-26, 8, 1), (-8, -8, -1), (12, 8, 1)):
        pen.stroke([(x - 3, y - 5 * hand), (x, y), (x + 6, y + hand)], 2.2, 225)
        pen.curl((x + 7, y - 1.5 * hand), 2.6, 1.1, 90 * hand, -hand, 1.3, 225, 0.5)


def dragon_strip():
    """Height map, 0..1, of the outer zone unrolled: four dragons in file, heads to the right."""
    low, high = JADE_DRAGONS
    length = np.pi * (low + high)
    canvas = Canvas(length, high - low, (2048, 128), 0)
    for k in range(4):
        x = -length / 2 + (k + 0.5) * length / 4
        draw_dragon(Pen(canvas, (x, (high - low) / 2), (1, 1)))
    return canvas.array() / 255.0


def jade_relief():
    """Height map of the disc in 0..1, (1024, 2048): the front, then the plain back."""
    size = 2 * JADE_RADIUS
    canvas = Canvas(size, size, (1024, 1024), 0)
    middle = np.array([0.0, JADE_RADIUS])
    spacing = 5.6
    for row, radius in enumerate(np.arange(JADE_HOLE + 7.4, JADE_DRAGONS[0] - 4.5, spacing * 0.9)):
        count = int(2 * np.pi * radius / spacing)
        for k in range(count):
            angle = 2 * np.pi * (k + 0.5 * (row % 2)) / count
            grain = middle + radius * np.array([np.cos(angle), -np.sin(angle)])
            canvas.disc(grain, 1.75, 225)
            canvas.line(spiral(grain, 2.6, 0.55, np.degrees(-angle), 1, 24, 1.4), 0.7, 190)
    y, x = (np.mgrid[0:1024, 0:1024] + 0.5) * size / 1024 - JADE_RADIUS
    radius, angle = np.hypot(x, y), np.arctan2(-y, x)
    low, high = JADE_DRAGONS
    strip = sampled(dragon_strip(), -angle / (2 * np.pi), (high - radius) / (high - low))
    front = np.where((radius > low) & (radius < high), strip, canvas.array() / 255.0)
    rims = (radius > high + 0.6) | (np.abs(radius - low + 1.6) < 0.9) | (radius < JADE_HOLE + 3.6)
    front = np.where(rims, 1.0, front)
    return np.concatenate([front, rims.astype(float)], axis=1)


def jade_colour(height, rng):
    """Celadon green with paler clouds, russet veins and darker recesses; sRGB in 0..255."""
    rows, columns = height.shape
    clouds = mottle(rows, columns, 6, 4, rng)
    veins = mottle(rows, columns, 8, 4, rng)
    y, x = np.mgrid[0:rows, 0:columns]
    bend = 0.03 * mottle(rows, columns, 10, 3, rng)  # keeps the veins off the grid of the noise
    veins = sampled(veins, (x + 0.4 * y) / columns + bend, y / rows + bend)
    colour = blend((92, 122, 84), (168, 192, 148), 0.35 + 0.55 * height + 0.1 * clouds)
    colour = blend(colour, (206, 210, 178), 0.55 * clouds - 0.1)
    thin_veins = np.exp(-((veins / 0.07) ** 2)) * np.clip(clouds + 0.1, 0, 1)
    colour = blend(colour, (140, 92, 54), 0.6 * thin_veins)
    return blend(colour, (146, 104, 66), 0.8 * veins - 0.55)


def plinth(profile, half_width, half_depth, squareness, segments=96):
    """Turned block with a rounded rectangular plan.

    Parameters
    ----------
    profile : (k, 2) array_like
        Share of the full plan (0 at the axis) and height [mm].
    half_width, half_depth : float
        Half the plan's sides [mm].
    squareness : float
        1 for an ellipse, towards 0 for a rectangle.
    """
    profile = np.asarray(profile, float)
    angle = np.linspace(-np.pi, np.pi, segments + 1)
    x = np.sign(np.sin(angle)) * np.abs(np.sin(angle)) ** squareness * half_width
    z = np.sign(np.cos(angle)) * np.abs(np.cos(angle)) ** squareness * half_depth
    x[-1], z[-1] = x[0], z[0]
    share, height = profile[:, :1], np.broadcast_to(profile[:, 1:], (len(profile), segments + 1))
    points = np.stack([share * x, height, share * z], -1)
    u = 0.5 + 0.5 * share * x / half_width
    v = (profile[:, 1].max() - height) / np.ptp(profile[:, 1])
    return grid_mesh(points, np.stack([u, v], -1))


def stand_arm(side):
    """Bar that cradles the disc on one side and ends in a scroll."""
    angle = np.radians(np.linspace(-92, -38, 18))
    cradle = (JADE_RADIUS + 2.5) * np.stack([np.cos(angle), np.sin(angle)], -1)
    hook = spiral(cradle[-1] + np.array([8.5, 2.5]), 8.9, 1.15, 196, -1, 28, 2.2)
    curve = np.concatenate([cradle, hook[1:]])
    count = len(curve)
    path = np.stack([side * curve[:, 0], curve[:, 1], np.zeros(count)], -1)
    taper = np.interp(np.arange(count), [0, len(cradle) - 1, count], [5.5, 4.2, 2.4])
    return sweep(path, (0, 0, 1), np.linspace(9.0, 6.0, count), taper, 20, 0.7)


def jade_stand():
    """Carved wooden stand: a moulded base on four feet and two arms that hold the disc."""
    moulding = xy(
        "0,-24 .9,-24 1,-23 1,-18 .97,-16 .88,-14 .84,-11 .84,-5 .88,-3 .97,-1.5 1,.5 1,2.5 "
        ".97,3.5 .9,4 0,4"
    )
    base = plinth(moulding, 58.0, 27.0, 0.45)
    foot = plinth(xy("0,-31 .75,-31 1,-29 1,-22 0,-22"), 9.0, 7.0, 0.6, 32)
    feet = [moved(foot, x=x, z=z) for x in (-46, 46) for z in (-16, 16)]
    block = moved(join([base, *feet]), y=-JADE_RADIUS - 3.0)
    return join([block, stand_arm(-1), stand_arm(1)])


def wood_texture(rng):
    """Dark rosewood with a carved cloud scroll along the waist of the base."""
    canvas = Canvas(116.0, 28.0, (512, 128), 255)
    for k in range(-3, 4):
        pen = Pen(canvas, (16 * k, 15.5), (1, 1))
        pen.stroke(xy("-8,2.5 0,-4.3 8,2.5"), 0.9, 90)
        for side in (-1, 1):
            pen.curl((3.6 * side, 0), 3.2, 1.4, 90 - 90 * side, side, 0.9, 90, 0.5)
    carving = blurred(canvas.array() / 255.0, 0.8)
    grain = mottle(128, 512, 4, 2, rng) + 0.5 * np.repeat(mottle(128, 8, 2, 5, rng), 64, axis=1)
    wood = blend((64, 30, 18), (124, 66, 38), 0.5 + 0.3 * grain)
    return wood * (0.35 + 0.65 * carving[..., None])


def make_jade(rng):
    """Jade bi of 160 mm in low relief on a wooden stand."""
    height = blurred(jade_relief(), 1.6)
    inner = np.full(321, JADE_HOLE)
    disc = pierced_disc(inner, JADE_RADIUS, height_field(height, JADE_RADIUS, 0.9), 54, 3.0, 0.7)
    write_ply(disc, "jade_disc")
    write_ply(jade_stand(), "jade_stand")
    colour = jade_colour(blurred(height, 0.8), rng)
    write_png(colour.reshape(512, 2, 1024, 2, 3).mean((1, 3)), "jade")
    write_png(wood_texture(rng), "wood")


def main():
    """Rewrite every mesh and texture."""
    for folder in ("meshes", "textures"):
        (SCENES / folder).mkdir(exist_ok=True)
    for number, make in enumerate((make_amphora, make_wine_coin, make_tripod, make_jade)):
        make(np.random.default_rng([SEED, number]))


if __name__ == "__main__":
    main()
