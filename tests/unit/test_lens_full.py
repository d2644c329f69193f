"""The mesh of the lens array against a sheet of lenses: closed, exact, as large as it is."""

import numpy as np
import pytest

from inim.display import DISPLAYS
from inim.display.lens import check_lens_model
from inim.display.lens.full import facet_error_mm, facets_per_lens, sheet_mesh
from inim.system.errors import DisplayError
from tests.conftest import small_display

NOMINAL = DISPLAYS["nominal"]
KINDS = [
    {},
    {"curved_side": "panel"},
    {"conic": -0.6, "asphere_a4": 0.02, "asphere_a6": -0.004},
    {"rotation_deg": 20.0, "shift_x_mm": 0.4, "pitch_y_mm": 0.8, "curved_side": "panel"},
]


def corners(mesh):
    return mesh.vertices[mesh.faces]


def face_normals(mesh):
    a, b, c = np.moveaxis(corners(mesh), 1, 0)
    return np.cross(b - a, c - a) / 2  # length: the area


@pytest.mark.parametrize("changes", KINDS)
def test_the_sheet_is_closed_and_consistently_oriented(changes):
    """Every edge has one face on either side, in opposite senses, once corners are joined."""
    mesh = sheet_mesh(small_display(3, 2, **changes), facets=4)
    joined = np.unique(np.round(mesh.vertices, 9), axis=0, return_inverse=True)[1].reshape(-1)
    faces = joined[mesh.faces]
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    assert (edges[:, 0] != edges[:, 1]).all()
    there, count = np.unique(edges, axis=0, return_counts=True)
    assert (count == 1).all()
    back = np.unique(edges[:, ::-1], axis=0)
    assert np.array_equal(there, back)


@pytest.mark.parametrize("changes", KINDS)
def test_normals_point_outwards_and_volume_is_that_of_the_lenses(changes):
    display = small_display(3, 2, **changes)
    mesh = sheet_mesh(display, facets=24)
    across = face_normals(mesh)
    unit = across / np.linalg.norm(across, axis=-1, keepdims=True)
    for corner in range(3):
        along = (unit * mesh.normals[mesh.faces[:, corner]]).sum(axis=-1)
        assert along.min() > 0.99, "facets are small: their normals are their corners'"
    assert np.allclose(np.linalg.norm(mesh.normals, axis=-1), 1)
    # The divergence theorem; positive where faces look outwards.
    volume = (corners(mesh).mean(axis=1) * across).sum() / 3
    glass = corners(mesh)[mesh.is_glass]
    flat = np.isclose(glass[..., 2], mesh.flat_mm).all(axis=1)
    full = np.abs(across[mesh.is_glass][flat, 2]).sum() * 1.0  # one pitch thick
    assert 0.8 * full < volume < full


@pytest.mark.parametrize("changes", KINDS)
def test_the_curved_face_has_the_sag_of_the_formula_and_its_area(changes):
    display = small_display(3, 2, **changes)
    mesh = sheet_mesh(display, facets=16)
    used = np.unique(mesh.faces[mesh.is_glass])
    points = mesh.vertices[used]
    curved = points[~np.isclose(points[:, 2], mesh.flat_mm)]
    # Back into the array's own frame, and into its lens.
    angle = np.radians(display.rotation_deg)
    turned = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    local = (curved[:, :2] - (display.shift_x_mm, 0)) @ turned
    pitch = np.array([display.pitch_mm, display.row_pitch_mm])
    even = np.array([display.lens_columns, display.lens_rows]) % 2 == 0
    local = local - pitch * (np.round(local / pitch - even / 2) + even / 2)
    square = (local**2).sum(axis=-1)
    radius, k = 3.0 * 0.4917, display.conic
    sag = square / (radius + np.sqrt(radius**2 - (1 + k) * square))
    sag = sag + display.asphere_a4 * square**2 + display.asphere_a6 * square**3
    vertex = 0.0 if display.curved_side == "viewer" else 1.0 / 1.4917 - 1.0
    depth = np.abs(curved[:, 2] - vertex)
    assert np.allclose(depth, sag, atol=1e-12)
    assert mesh.front_mm == pytest.approx(points[:, 2].max())
    # Seen from the front, the facets cover the lenses once.
    slopes = np.abs(face_normals(mesh)[mesh.is_glass][:, 2])
    face_points = corners(mesh)[mesh.is_glass][..., 2]
    bulge = ~np.isclose(face_points, mesh.flat_mm).all(axis=1)
    assert slopes[bulge].sum() == pytest.approx(display.width_mm * display.height_mm)


def test_the_mesh_is_mirror_symmetric_to_the_last_bit():
    mesh = sheet_mesh(small_display(3, 2), facets=6)
    triangles = corners(mesh)[mesh.is_glass]
    triangles = triangles[(triangles[..., 2] > mesh.flat_mm).all(axis=1)]
    for axis in (0, 1):
        mirrored = triangles * np.where(np.arange(3) == axis, -1.0, 1.0)
        original, other = (
            np.unique(np.sort(t.reshape(len(t), 3, 3).view("f8,f8,f8"), axis=1), axis=0)
            for t in (triangles + 0.0, mirrored + 0.0)
        )
        assert np.array_equal(original, other)


def test_no_ray_in_the_glass_gets_past_the_margin():
    """The most oblique ray there can be, traced by Snell's law, stays within the flat face."""
    display = small_display(3, 2)
    mesh = sheet_mesh(display, facets=4)
    reach = mesh.vertices[:, 0].max() - display.width_mm / 2
    steepest = np.arcsin(1 / display.refractive_index)
    assert reach >= np.tan(steepest) * 1.0 - 1e-12  # thickness: one pitch


def test_facets_are_as_fine_as_stated():
    display = small_display(3, 2)
    facets = facets_per_lens(display)
    error = facet_error_mm(display, facets)
    assert error <= 0.0105 * display.pixel_pitch_mm
    # The surface's next term is small, not nothing.
    assert facet_error_mm(display, 2 * facets) == pytest.approx(error / 4, rel=0.05)
    mesh = sheet_mesh(display)
    triangles = corners(mesh)[mesh.is_glass]
    # Against the formula, at many places inside the facets.
    random = np.random.default_rng(0)
    share = random.dirichlet((1, 1, 1), (40, len(triangles)))
    inside = (share[..., None] * triangles).sum(axis=2)
    inside = inside[:, ~np.isclose(triangles[..., 2], mesh.flat_mm).all(axis=1)]
    local_x = inside[..., 0] - np.round(inside[..., 0])
    local_y = inside[..., 1] - (np.floor(inside[..., 1]) + 0.5)
    radius = 3.0 * 0.4917
    sag = radius - np.sqrt(radius**2 - local_x**2 - local_y**2)
    measured = np.abs(-sag - inside[..., 2]).max()
    assert 0.7 * error < measured <= error * 1.001


def test_the_nominal_array_fits_and_a_huge_one_is_refused():
    assert 8 < facets_per_lens(NOMINAL) < 40
    check_lens_model("full", NOMINAL)
    huge = NOMINAL.replace(lens_columns=2000, lens_rows=1000)
    with pytest.raises(DisplayError, match="2000000 lenses"):
        check_lens_model("full", huge)


@pytest.mark.parametrize(
    "changes",
    [
        {"lattice": "hexagonal"},
        {"aperture": "round"},
        {"fill_factor": 0.9},
        {"subpixels": "pentile"},
        {"pixel_fill": 0.5},
    ],
)
def test_impossible_meshes_of_full_lenses_are_refused_by_name(changes):
    with pytest.raises(DisplayError, match=next(iter(changes))):
        check_lens_model("full", NOMINAL.replace(**changes))
