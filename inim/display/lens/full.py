r"""`full`: the lens array as a body, a plano-convex sheet of triangles, path traced.

An independent check of `thick`, with the same lenses; `inim.render.reconstruct` traces the rays.

The position of the sheet is that of `inim.display.lens.thick`. Its curved face is one patch of flat
facets for each lens, with the exact surface's normals at their corners; neighbours meet in an edge,
so corners there are doubled. Cylinders have one patch each, a little longer than the panel; they
cover it, and have flat facets along their axes. The flat face extends beyond the lenses by the
largest sideways travel of a ray inside the glass, so that no ray leaves through the sheet's ends,
as in the analytic models. On the curved side this margin is the black *mount*; the ends are black,
too.

    bulge to the viewer          ____   ____
                        mount  _/    \_/    \_  mount      curved face
                        ends  |_______________|            flat face
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from inim.display import Display
from inim.display.layouts import Lenticular, Square
from inim.display.lens import thick
from inim.display.lens.array import NUMPY_OPS, LensArray, channel_indices, lens_array
from inim.display.lens.model import Face, LensModel, SheetMesh, sag, steepness
from inim.display.pixels import exact_ratio
from inim.system.errors import DisplayError

# Facets may depart from the surface by this many panel pixels. A ray then meets the facet aside of
# the surface's point by the error times the tangent of its angle to the normal; the interpolated
# normals of a sphere are exact there. Of 200,000 rays 99 in 100 landed on the panel less than the
# error away from where `thick` has them, and but a few in 100,000, at the lenses' seams, more than
# twice as far.
_WANTED_ERROR_PIXELS = 0.01
_WORST_ERROR_PIXELS = 0.1
# Some 100 bytes each with the acceleration structure.
_MOST_TRIANGLES = 4_000_000


def check(display: Display) -> None:
    """Raise `DisplayError` where the display's lenses cannot be made as such a sheet."""
    thick.check(display)
    for name, plain in (
        ("lattice", (Square.name, Lenticular.name)),
        ("aperture", ("square",)),
        ("fill_factor", (1,)),
        ("subpixels", ("none", "rgb-stripe")),
        ("pixel_fill", (1,)),
        ("layers", ((),)),
    ):
        value = getattr(display, name)
        if value not in plain:
            raise DisplayError(
                f"full lens model: {name} = {value!r} is not modelled, only "
                f"{' or '.join(map(repr, plain))}; use lens_model 'thick'"
            )
    facets = facets_per_lens(display)
    error, pixel = facet_error_mm(display, facets), display.pixel_pitch_mm
    if error > _WORST_ERROR_PIXELS * pixel:
        lenses = math.prod(_Sheet.of(display).counts)
        raise DisplayError(
            f"full lens model: {lenses} lenses within {_MOST_TRIANGLES:,} triangles have facets "
            f"{error / pixel:.2g} panel pixels off the surface; use fewer lenses, or lens_model "
            "'thick'"
        )


def facets_per_lens(display: Display) -> int:
    """Facets along a lens's side: fine enough to be the surface, as far as memory allows.

    An even number: a mirrored lens is the same mesh.
    """
    trial = 8
    tolerance_mm = _WANTED_ERROR_PIXELS * display.pixel_pitch_mm
    # The error falls with the square of a facet's width.
    facets = math.ceil(trial * math.sqrt(facet_error_mm(display, trial) / tolerance_mm))
    sheet = _Sheet.of(display)
    patch = _MOST_TRIANGLES // (2 * math.prod(sheet.counts))
    most = patch // _FACETS_ALONG if sheet.cylinders else math.isqrt(patch)
    return max(2, min(facets + facets % 2, most - most % 2))


def facet_error_mm(display: Display, facets: int) -> float:
    """Largest distance along z between the curved face and its facets, at the facets' middles."""
    sheet = _Sheet.of(display, facets)
    x, y = (_nodes(1, n, pitch) for n, pitch in zip(sheet.facets, sheet.pitches, strict=True))
    at_corners = sheet.sag(x, y[:, None])
    middle = sheet.sag((x[1:] + x[:-1]) / 2, (y[1:, None] + y[:-1, None]) / 2)
    rising = (at_corners[:-1, :-1] + at_corners[1:, 1:]) / 2
    falling = (at_corners[:-1, 1:] + at_corners[1:, :-1]) / 2
    return float(np.max(np.abs([rising - middle, falling - middle])))


# Of a cylinder along its axis; an even number: a mirrored lens is the same mesh.
_FACETS_ALONG = 2
# Cylinders beyond those over the panel, on each side, and their overlength at each end.
_MARGIN_LENSES = 2


@dataclass(frozen=True)
class _Sheet:
    """Lenses of a sheet, across and along: their numbers, pitches, and facets of each."""

    array: LensArray
    cylinders: bool
    counts: tuple[int, int]
    pitches: tuple[float, float]
    facets: tuple[int, int]

    @classmethod
    def of(cls, display: Display, facets: int = 2) -> _Sheet:
        """Sheet of a display, with `facets` along a lens's side, of cylinders across."""
        array, layout = lens_array(display), display.layout
        if not layout.of_cylinders:
            pitches = array.pitch_x, array.pitch_y
            return cls(array, False, layout.grid[::-1], pitches, (facets, facets))
        pitch, (half_x, half_y) = array.pitch_x, layout.half_extent_mm
        across = 2 * (math.ceil(exact_ratio(layout.outermost_mm[0] / pitch)) + _MARGIN_LENSES) + 1
        shift = abs(array.shift_x) + abs(array.shift_y)
        length = 2 * (abs(array.sine) * half_x + array.cosine * half_y + shift)
        return cls(
            array, True, (across, 1), (pitch, length + 2 * _MARGIN_LENSES * pitch),
            (facets, _FACETS_ALONG),
        )  # fmt: skip

    @property
    def face(self) -> Face:
        """The curved face."""
        array = self.array
        return Face(1 / array.radius, array.conic, (array.a4, array.a6))

    def radius_squared(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Squares of the distances of places from the lens's axis; its centre is the origin."""
        squares: np.ndarray = x * x if self.cylinders else x * x + y * y
        return squares

    def sag(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Depth of the curved face below its vertex plane, at places from the lens's centre."""
        squares = self.radius_squared(x, y)
        depth: np.ndarray = sag(NUMPY_OPS, self.face, squares)
        return np.broadcast_to(depth, np.broadcast_shapes(x.shape, y.shape))


def sheet_mesh(display: Display, facets: int | None = None) -> SheetMesh:
    """The sheet of a display's lenses.

    * `display`: of square lenses or cylinders; turned and shifted arrays are turned and shifted.
    * `facets`: along a lens's side, of cylinders across; `facets_per_lens` otherwise.

    Raises `DisplayError`: lenses that cannot be made so.
    """
    check(display)
    facets = facets_per_lens(display) if facets is None else facets
    sheet = _Sheet.of(display, facets)
    array = sheet.array
    margin = array.thickness / math.sqrt(min(channel_indices(display)) ** 2 - 1)
    parts = [
        _lens_faces(sheet),
        _flat_face(sheet, margin),
        _mount(sheet, margin),
    ]
    starts = np.cumsum([0] + [len(part.vertices) for part in parts])
    vertices = np.concatenate([part.vertices for part in parts])
    normals = np.concatenate([part.normals for part in parts])
    faces = np.concatenate([p.faces + s for p, s in zip(parts, starts[:-1], strict=True)])
    is_glass = np.repeat([True, True, False], [len(part.faces) for part in parts])
    # So far the vertices' plane is z = 0 and the bulge on the viewer's side.
    front, flat = 0.0, -array.thickness
    if display.curved_side == "panel":
        front = flat = array.thickness / display.refractive_index
        vertices[:, 2] = flat - array.thickness - vertices[:, 2]
        normals[:, 2] *= -1
        faces = faces[:, ::-1]
    turn = np.array([[array.cosine, array.sine], [-array.sine, array.cosine]])
    vertices[:, :2] = vertices[:, :2] @ turn + (array.shift_x, array.shift_y)
    normals[:, :2] = normals[:, :2] @ turn
    error = facet_error_mm(display, facets)
    return SheetMesh(
        vertices=vertices,
        normals=normals,
        faces=faces.astype(np.uint32),
        is_glass=is_glass,
        front_mm=front,
        flat_mm=flat,
        rear_principal_mm=array.thickness / display.refractive_index - array.thickness,
        facet_error_mm=error,
    )


@dataclass(frozen=True)
class _SheetPart:
    """Vertices, their normals, and faces of some of the sheet; bulge up, vertices at z = 0."""

    vertices: np.ndarray
    normals: np.ndarray
    faces: np.ndarray


def _nodes(lenses: int, facets: int, pitch: float) -> np.ndarray:
    """Facets' corners along `lenses` lenses about the axis; mirror-symmetric to the last bit."""
    return (2 * np.arange(lenses * facets + 1) - lenses * facets) * (pitch / (2 * facets))


def _lens_faces(sheet: _Sheet) -> _SheetPart:
    """The curved faces of all lenses."""
    counts, (wide, high) = sheet.counts, sheet.facets
    local_x, local_y = (
        _nodes(1, n, pitch) for n, pitch in zip(sheet.facets, sheet.pitches, strict=True)
    )
    down = local_y[:, None]
    steep = steepness(NUMPY_OPS, sheet.face, sheet.radius_squared(local_x, down))
    rising = down * steep * (not sheet.cylinders)
    steep = np.stack(np.broadcast_arrays(local_x * steep, rising, 1.0), -1)
    normals = (steep / np.linalg.norm(steep, axis=-1, keepdims=True)).reshape(-1, 3)
    x, y = (
        _nodes(count, n, pitch)[np.arange(count)[:, None] * n + np.arange(n + 1)]
        for count, n, pitch in zip(counts, sheet.facets, sheet.pitches, strict=True)
    )
    lenses = counts[0] * counts[1]
    shape = (counts[1], counts[0], high + 1, wide + 1)
    places = np.broadcast_arrays(
        x[None, :, None, :], y[:, None, :, None], -sheet.sag(local_x, down)
    )
    vertices = np.stack([np.broadcast_to(place, shape) for place in places], -1).reshape(-1, 3)
    patch = _grid_faces(wide + 1, high + 1, local_x, local_y)
    starts = np.arange(lenses)[:, None, None] * (wide + 1) * (high + 1)
    return _SheetPart(vertices, np.tile(normals, (lenses, 1)), (patch + starts).reshape(-1, 3))


def _grid_faces(columns: int, rows: int, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Two triangles for each cell of a grid of vertices, seen from +z.

    Diagonals point at the grid's middle, so that a symmetric surface stays symmetric.
    """
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    right, up, across = corner + 1, corner + columns, corner + columns + 1
    rising = (((x[1:] + x[:-1]) * (y[1:, None] + y[:-1, None])) >= 0).ravel()
    first = np.where(
        rising[:, None], _triangle(corner, right, across), _triangle(corner, right, up)
    )
    second = np.where(rising[:, None], _triangle(corner, across, up), _triangle(right, across, up))
    return np.concatenate([first, second])


def _triangle(*corners: np.ndarray) -> np.ndarray:
    return np.stack(corners, -1)


def _flat_face(sheet: _Sheet, margin: float) -> _SheetPart:
    """One quadrangle for each lens and for each piece of the margin, facing down."""
    x, y = (
        _with_margin(_nodes(count, 1, pitch), margin)
        for count, pitch in zip(sheet.counts, sheet.pitches, strict=True)
    )
    places = np.broadcast_arrays(x, y[:, None], -sheet.array.thickness)
    vertices = np.stack(places, -1).reshape(-1, 3)
    faces = _grid_faces(len(x), len(y), x, y)[:, ::-1]
    return _SheetPart(vertices, np.broadcast_to((0.0, 0.0, -1.0), vertices.shape), faces)


def _with_margin(nodes: np.ndarray, margin: float) -> np.ndarray:
    return np.concatenate([[nodes[0] - margin], nodes, [nodes[-1] + margin]])


def _mount(sheet: _Sheet, margin: float) -> _SheetPart:
    """Black mount from the outermost lenses to the margin's edge, and the ends.

    Faces have corners, and normals, of their own.
    """
    low = -sheet.sag(*(np.asarray(pitch / 2) for pitch in sheet.pitches))
    triangles: list[np.ndarray] = []
    outline: list[np.ndarray] = []
    outwards = np.array([(1.0, 0, 0), (0, 1.0, 0), (-1.0, 0, 0), (0, -1.0, 0)]) * margin
    for side, out in enumerate(outwards):
        border, facets = _outline(sheet, side), sheet.facets[1 - side % 2]
        edge = border[::facets] + out
        edge[:, 2] = low
        for lens in range(len(edge) - 1):
            inner = border[lens * facets : (lens + 1) * facets + 1]
            triangles += [np.stack([a, edge[lens], b]) for a, b in pairwise(inner)]
            triangles.append(np.stack([inner[-1], edge[lens], edge[lens + 1]]))
        corner, onward = border[-1], outwards[(side + 1) % 4]
        triangles.append(np.stack([corner, corner + out, corner + out + onward]))
        triangles.append(np.stack([corner, corner + out + onward, corner + onward]))
        outline += [*edge, corner + out + onward]
    below = [np.array([x, y, -sheet.array.thickness]) for x, y, _ in outline]
    for i in range(len(outline)):
        a, b, a_below, b_below = outline[i - 1], outline[i], below[i - 1], below[i]
        triangles += [np.stack([a, a_below, b_below]), np.stack([a, b_below, b])]
    corners = np.array(triangles)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = across / np.linalg.norm(across, axis=-1, keepdims=True)
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    return _SheetPart(corners.reshape(-1, 3), np.repeat(normals, 3, axis=0), faces)


def _outline(sheet: _Sheet, side: int) -> np.ndarray:
    """Corners of the facets along a side of the array: right, top, left, bottom.

    (n, 3), in the order that has the array on the left.
    """
    along, across = (1, 0) if side % 2 == 0 else (0, 1)
    pitches, facets = sheet.pitches, sheet.facets[along]
    half = sheet.counts[across] * pitches[across] / 2
    run = _nodes(sheet.counts[along], facets, pitches[along])
    local = np.resize(_nodes(1, facets, pitches[along])[:-1], len(run))
    edge = np.full(len(run), pitches[across] / 2)
    border = np.empty((len(run), 3))
    border[:, along] = run
    border[:, 2] = -sheet.sag(*((local, edge) if along == 0 else (edge, local)))
    border[:, across] = half if side < 2 else -half
    return border if side in (0, 3) else border[::-1]


MODEL = LensModel(
    "full",
    summary="the thick lenses as a mesh, path traced by the renderer; far slower",
    mesh=sheet_mesh,
    check=check,
    transmittance=thick.on_axis_transmittance,
    stand_in="thick",
)
