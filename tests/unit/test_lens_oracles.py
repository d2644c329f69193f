"""The thick lens against two other tracers: optiland, and a ray that feels its way step by step.

`python -m tests.unit.test_lens_oracles` writes the table of `docs/theory/lens-models.md` anew.
"""

import math
from pathlib import Path

import numpy as np
import pytest

from inim.display import DISPLAYS
from inim.display.lens import trace_to_panel

PAGE = Path(__file__).parents[2] / "docs" / "theory" / "lens-models.md"
MARKERS = ("<!-- optiland -->", "<!-- /optiland -->")
NOMINAL = DISPLAYS["nominal"]
SIDES = ("viewer", "panel")

# -- optiland ----------------------------------------------------------------------------------

PRESCRIPTIONS = {
    "sphere, bulge first": NOMINAL,
    "sphere, flat first": NOMINAL.replace(curved_side="panel"),
    "conic and even asphere, bulge first": NOMINAL.replace(
        conic=-0.6, asphere_a4=0.02, asphere_a6=-0.015, focal_length_mm=2.4, gap_mm=2.5
    ),
    "conic and even asphere, flat first": NOMINAL.replace(
        conic=-2.0, asphere_a4=-0.03, asphere_a6=0.01, curved_side="panel"
    ),
    "sphere, bulge first; cover glass and glue": NOMINAL.replace(layers="0.5 1.52, 0.1 1.41"),
    "sphere, flat first; cover glass and glue": NOMINAL.replace(
        curved_side="panel", layers="0.5 1.52, 0.1 1.41"
    ),
    "sphere, bulge first; glued to glass": NOMINAL.replace(
        layers=((0.4, 1.41), ((3.3 - 1 / 1.4917 - 0.4 / 1.41) * 1.52, 1.52))
    ),
}
FIELDS = {"axis": (0.0, 0.0), "8 degrees": (math.tan(math.radians(8)) * 0.8, -0.6 * 0.14)}
RAYS_PER_FIELD = 500
# A lens far off the array's axis: there float32 has the fewest digits.
CENTRE = (28.5, -30.5)
REACH_MM = 0.35  # a pupil whose oblique rays still stay with their lens


def bundle(slope, dtype):
    """Parallel rays all over a lens, as floats of a type: x, y, sx, sy."""
    random = np.random.default_rng(7)
    radius = REACH_MM * np.sqrt(random.uniform(0, 1, RAYS_PER_FIELD))
    turn = random.uniform(0, 2 * np.pi, RAYS_PER_FIELD)
    x = (CENTRE[0] + radius * np.cos(turn)).astype(dtype)
    y = (CENTRE[1] + radius * np.sin(turn)).astype(dtype)
    return x, y, np.full_like(x, slope[0]), np.full_like(x, slope[1])


def optiland_landing(display, x, y, sx, sy):
    """Landing points of optiland's sequential trace of the same lens on the panel."""
    reason = "optiland is not installed: pip install -e '.[oracle]'"
    optic = pytest.importorskip("optiland.optic", reason=reason)
    from optiland.materials import IdealMaterial
    from optiland.rays import RealRays

    n, f, g = display.refractive_index, display.focal_length_mm, display.gap_mm
    t = display.pitch_mm  # the default thickness
    side = 1 if display.curved_side == "viewer" else -1
    curved = {
        "radius": side * f * (n - 1),
        "conic": display.conic,
        "surface_type": "even_asphere" if display.asphere_a4 else "standard",
    }
    if display.asphere_a4:
        curved["coefficients"] = [0.0, side * display.asphere_a4, side * display.asphere_a6]
        curved["tol"] = 1e-14  # by default its Newton steps end 1e-7 mm short on the panel
    bulge_first = side > 0
    faces = (curved, {}) if bulge_first else ({}, curved)
    lens = optic.Optic()
    lens.surfaces.add(index=0, thickness=np.inf)
    lens.surfaces.add(index=1, thickness=t, material=IdealMaterial(n=n), is_stop=True, **faces[0])
    air = g - (t / n if bulge_first else 0) - sum(a / m for a, m in display.layers)
    media = [(air, 1.0)] * (air > 1e-9) + list(display.layers)
    for index, (thickness, m) in enumerate(media, start=2):
        face = faces[1] if index == 2 else {}
        lens.surfaces.add(index=index, thickness=thickness, material=IdealMaterial(n=m), **face)
    lens.surfaces.add(index=2 + len(media))
    lens.set_aperture("EPD", 1.0)
    lens.fields.set_type("angle")
    lens.fields.add(y=0)
    lens.wavelengths.add(value=0.5876, is_primary=True)
    # Rays are given on the front principal plane; the flat face lies t / n before it.
    before = 0.0 if bulge_first else t / n
    x, y, sx, sy = (np.asarray(value, np.float64) for value in (x, y, sx, sy))
    length = np.sqrt(1 + sx**2 + sy**2)
    start = x - CENTRE[0] - before * sx, y - CENTRE[1] - before * sy, np.zeros_like(x)
    along = sx / length, sy / length, 1 / length
    rays = RealRays(*start, *along, np.ones_like(x), np.full_like(x, 0.5876))
    lens.surfaces.trace(rays)
    return np.asarray(rays.x) + CENTRE[0], np.asarray(rays.y) + CENTRE[1]


def spot_um(x, y):
    """RMS distance from the centroid, micrometres."""
    return 1000 * float(np.sqrt(np.var(x) + np.var(y)))


def compared(display):
    """Largest difference in float64 and in float32, and RMS spots (ours, optiland's) per field."""
    largest = {np.float64: 0.0, np.float32: 0.0}
    spots = []
    for slope in FIELDS.values():
        for dtype in largest:
            rays = bundle(slope, dtype)
            px, py, weight = trace_to_panel(display, "thick", *rays, dtype=dtype)
            assert px.dtype == dtype and (weight > 0.8).all()
            qx, qy = optiland_landing(display, *rays)
            apart = np.hypot(px.astype(np.float64) - qx, py.astype(np.float64) - qy)
            largest[dtype] = max(largest[dtype], float(apart.max()))
            if dtype is np.float64:
                spots.append((spot_um(px, py), spot_um(qx, qy)))
    return largest[np.float64], largest[np.float32], spots


def within(difference_mm):
    """A difference as the power of ten above it: the digits below depend on the machine."""
    return f"< 1e{math.ceil(math.log10(max(difference_mm, 1e-12)) + 0.3):d}"


def comparison_table():
    """The page's table, as Markdown."""
    lines = [
        "| lens | float64, mm | float32, mm | RMS spot on axis, µm: ours, optiland's "
        "| at 8 degrees |",
        "|---|---|---|---|---|",
    ]
    for name, display in PRESCRIPTIONS.items():
        double, single, spots = compared(display)
        cells = " | ".join(f"{ours:.3f}, {theirs:.3f}" for ours, theirs in spots)
        lines.append(f"| {name} | {within(double)} | {within(single)} | {cells} |")
    return "\n".join(lines)


@pytest.mark.parametrize("name", PRESCRIPTIONS)
def test_a_thousand_rays_land_where_optiland_s_do(name):
    double, single, spots = compared(PRESCRIPTIONS[name])
    assert double < 1e-6
    assert single < 1e-4
    for ours, theirs in spots:
        assert theirs > 1, "a spot to compare, in micrometres"
        assert ours == pytest.approx(theirs, rel=1e-6)


def test_the_page_s_table_is_the_one_made_here():
    table = comparison_table()
    start, end = MARKERS
    printed = PAGE.read_text(encoding="utf-8").split(start)[1].split(end)[0].strip()
    assert printed == table, "run: python -m tests.unit.test_lens_oracles"


# -- a ray that feels its way ------------------------------------------------------------------

STEP_MM = 2e-3
DEEPEST_MM = 0.4  # deeper than any relief here
FLAT = np.array([0.0, 0.0, 1.0])


def relief(display, x, y):
    """Depth of the bulges below the plane of their vertices, and whether a lens is there.

    Every lens within reach is asked, the nearest centre answers. Beside apertures: 0.
    """
    px, py = display.pitch_mm, display.row_pitch_mm
    nearest = np.full(x.shape, np.inf)
    offset_x, offset_y = np.zeros_like(x), np.zeros_like(y)
    for row in range(display.lens_rows):
        cy = (display.lens_rows / 2 - 0.5 - row) * py
        pixel_offset = 0.0
        if display.lattice == "hexagonal" and display.lens_rows > 1:
            pixel_offset = px / 4 if row % 2 else -px / 4
        for column in range(display.lens_columns):
            cx = (column + 0.5 - display.lens_columns / 2) * px + pixel_offset
            distance = (x - cx) ** 2 + (y - cy) ** 2
            closer = distance < nearest
            nearest = np.where(closer, distance, nearest)
            offset_x = np.where(closer, x - cx, offset_x)
            offset_y = np.where(closer, y - cy, offset_y)
    c = 1 / (display.focal_length_mm * (display.refractive_index - 1))
    depth = c * nearest / (1 + np.sqrt(np.clip(1 - (1 + display.conic) * c**2 * nearest, 0, None)))
    depth += display.asphere_a4 * nearest**2 + display.asphere_a6 * nearest**3
    half = display.fill_factor * px / 2
    if display.aperture == "round":
        lens = nearest <= half**2
    elif display.fill_factor < 1:
        lens = (np.abs(offset_x) <= half) & (np.abs(offset_y) <= half * py / px)
    else:
        lens = np.ones_like(x, bool)
    return np.where(lens, depth, 0.0), lens, (offset_x, offset_y)


def fresnel(display, cos_in, cos_out):
    """Unpolarised transmittance by angles: sines and tangents of their sum and difference."""
    i, t = np.arccos(np.clip(cos_in, -1, 1)), np.arccos(np.clip(cos_out, -1, 1))
    i, t = np.maximum(i, 1e-7), np.maximum(t, 1e-7 / display.refractive_index)
    s = np.sin(i - t) ** 2 / np.sin(i + t) ** 2
    p = np.tan(i - t) ** 2 / np.tan(i + t) ** 2
    return 1 - (s + p) / 2


def bent(d, normal, ratio):
    """Snell by the ray's part along the face, which grows by the ratio of indices."""
    along = d - normal * (d * normal).sum(-1, keepdims=True)
    along = ratio * along
    sine_squared = (along**2).sum(-1, keepdims=True)
    with np.errstate(invalid="ignore"):
        return along + np.sign((d * normal).sum(-1, keepdims=True)) * normal * np.sqrt(
            1 - sine_squared
        )


def felt(display, x, y, sx, sy):
    """Panel point and weight, by small steps through the relief; depth z grows to the panel.

    Steps find in which a ray passes from air to glass or back; halving it finds where.
    """
    for half, place in ((display.width_mm / 2, x), (display.height_mm / 2, y)):
        assert (np.abs(place) < half - 1.5).all(), "the oracle stays away from the array's border"
    p = np.stack([x, y, np.zeros_like(x)], -1)
    d = np.stack([sx, sy, np.ones_like(sx)], -1)
    d = d / np.linalg.norm(d, axis=-1, keepdims=True)
    through = felt_bulge_first if display.curved_side == "viewer" else felt_flat_first
    p, d, medium, weight = through(display, p, d)
    behind = display.pitch_mm / display.refractive_index if medium != 1 else p[..., 2]
    air = display.gap_mm - behind - sum(t / n for t, n in display.layers)
    media = [(air, 1.0)] * bool(np.any(air > 1e-9)) + list(display.layers)
    for thickness, index in media:
        before, d = d, d if index == medium else bent(d, FLAT, medium / index)
        weight = weight * fresnel(display, before[..., 2], d[..., 2]) ** (index != medium)
        p = p + d / d[..., 2:] * np.broadcast_to(thickness, weight.shape)[..., None]
        medium = index
    return p[..., 0], p[..., 1], np.nan_to_num(weight, nan=0.0)


def felt_bulge_first(display, p, d):
    """Trace from the vertices' plane to the flat face; the medium there is glass."""
    n, t = display.refractive_index, display.pitch_mm
    path = first_change(p, d, lambda q: q[..., 2] > depth_at(display, q), DEEPEST_MM / d[..., 2])
    p = p + path[..., None] * d
    d, curved = cross_relief(display, p, d, +1, 1 / n)
    p = p + d / d[..., 2:] * (t - p[..., 2:])
    return p, d, n, curved


def felt_flat_first(display, p, d):
    """Through the flat face and out of the bulge into the air."""

    def in_glass(q):
        return q[..., 2] < -depth_at(display, q)

    n, t = display.refractive_index, display.pitch_mm
    p = p - d / d[..., 2:] * t / n
    inner = bent(d, FLAT, 1 / n)
    flat = fresnel(display, d[..., 2], inner[..., 2])
    p = p + inner / inner[..., 2:] * (t - DEEPEST_MM)
    p[..., 2] = -DEEPEST_MM  # from here on the vertices are at depth 0
    until = (DEEPEST_MM + 1e-9) / inner[..., 2]
    path = first_change(p, inner, lambda q: ~in_glass(q), until)
    p = p + path[..., None] * inner
    d, curved = cross_relief(display, p, inner, -1, n)
    leaves = d[..., 2] > 0  # not so where there is no ray: nan
    d = np.where(leaves[..., None], d, FLAT)
    # In air, before the plane of the vertices: a neighbour's bulge, or the wall of a hole.
    left = -p[..., 2] / d[..., 2]
    struck = first_change(p + 1e-7 * d, d, in_glass, left) < left - 2e-7
    weight = np.where(leaves & ~(struck & (left > 1e-6)), flat * curved, 0.0)
    return p, d, 1.0, weight


def depth_at(display, p):
    return relief(display, p[..., 0], p[..., 1])[0]


def cross_relief(display, p, d, side, ratio):
    """Refracted at a bulge or at the bare sheet; what gets through. Walls and paint take all."""
    depth, lens, offset = relief(display, p[..., 0], p[..., 1])
    at_vertices = np.abs(p[..., 2]) < 1e-7
    wall = (np.abs(p[..., 2] - side * depth) > 1e-6) & ~at_vertices
    bare = at_vertices & ~lens
    normal = np.where(bare[..., None], FLAT, face_normal(display, *offset, side))
    after = bent(d, normal, ratio)
    weight = fresnel(display, (d * normal).sum(-1), (after * normal).sum(-1))
    painted = bare & (display.between_lenses == "dark")
    return after, np.where(wall | painted, 0.0, weight)


def face_normal(display, u, v, side):
    """Normal by differences of the sag, not by its derivative."""

    def depth(u, v):
        lens = display.replace(lens_columns=1, lens_rows=1, fill_factor=1.0, aperture="square")
        return side * relief(lens, u, v)[0]

    h = 1e-4
    gx = (8 * (depth(u + h, v) - depth(u - h, v)) - depth(u + 2 * h, v) + depth(u - 2 * h, v)) / (
        12 * h
    )
    gy = (8 * (depth(u, v + h) - depth(u, v - h)) - depth(u, v + 2 * h) + depth(u, v - 2 * h)) / (
        12 * h
    )
    normal = np.stack([-gx, -gy, np.ones_like(gx)], -1)
    return normal / np.linalg.norm(normal, axis=-1, keepdims=True)


def first_change(p, d, changed, until):
    """Path at which a ray first changes sides, marched in steps, then halved; or all its path."""
    steps = int(np.ceil(until.max() / STEP_MM))
    low, high = np.zeros(until.shape), until.copy()
    is_known = np.zeros(until.shape, bool)
    for k in range(1, steps + 1):
        here = np.minimum(k * STEP_MM, until)
        now = changed(p + here[..., None] * d) & ~is_known
        low = np.where(now, np.minimum((k - 1) * STEP_MM, until), low)
        high = np.where(now, here, high)
        is_known |= now
    low = np.where(is_known, low, high)
    for _ in range(40):
        middle = (low + high) / 2
        now = changed(p + middle[..., None] * d)
        high, low = np.where(now, middle, high), np.where(now, low, middle)
    return np.where(is_known, high, until)


ARRAY = NOMINAL.replace(lens_columns=5, lens_rows=7)
RELIEFS = {
    "square cells": {},
    "rectangular cells": {"pitch_y_mm": 0.8},
    "hexagonal cells": {"lattice": "hexagonal"},
    "deep bulges": {"focal_length_mm": 1.8, "gap_mm": 2.0},
    "conic": {"conic": -0.8},
    "asphere": {"conic": -0.6, "asphere_a4": 0.03, "asphere_a6": -0.02},
    "hexagonal aspheres, deep": {
        "lattice": "hexagonal", "focal_length_mm": 1.8, "gap_mm": 2.0,
        "conic": -0.6, "asphere_a4": 0.03, "asphere_a6": -0.02,
    },
    # Walls between holes, 0.04 mm at their thinnest, are not stepped over.
    "round, dark between": {"aperture": "round", "fill_factor": 0.96},
    "round, clear between": {"aperture": "round", "fill_factor": 0.9, "between_lenses": "clear"},
    "square holes, clear between": {"fill_factor": 0.8, "between_lenses": "clear"},
    "round on hexagons, clear between": {
        "lattice": "hexagonal", "aperture": "round", "fill_factor": 0.95, "between_lenses": "clear",
    },
    "cover glass and glue": {"layers": "0.5 1.52, 0.1 1.41"},
    "glued to glass": {"layers": ((0.4, 1.41), ((3.3 - 1 / 1.4917 - 0.4 / 1.41) * 1.52, 1.52))},
    "glass, clear between": {
        "layers": "0.7 1.52", "aperture": "round", "fill_factor": 0.9, "between_lenses": "clear",
    },
    "glued to glass, clear between": {
        "layers": (((3.3 - 1 / 1.4917) * 1.52, 1.52),), "aperture": "round", "fill_factor": 0.9,
        "between_lenses": "clear",
    },
}  # fmt: skip


def oblique_rays(count, seed, steepest_deg=40.0):
    """Rays all over some cells, up to so far off the axis, all ways round."""
    random = np.random.default_rng(seed)
    x, y = random.uniform(-1.0, 1.0, (2, count))
    slope = np.tan(np.radians(random.uniform(0, steepest_deg, count)))
    turn = random.uniform(0, 2 * np.pi, count)
    return x, y, slope * np.cos(turn), slope * np.sin(turn)


def near_an_edge(display, x, y):
    """True if a point is within a step of an aperture's edge: steps cannot tell there."""
    if display.aperture == "square" and display.fill_factor == 1:
        return np.zeros_like(x, bool)
    edge = np.zeros_like(x, bool)
    here = relief(display, x, y)[1]
    for turn in np.linspace(0, 2 * np.pi, 16, endpoint=False):
        dx, dy = STEP_MM * np.cos(turn), STEP_MM * np.sin(turn)
        edge |= relief(display, x + dx, y + dy)[1] != here
    return edge


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("name", RELIEFS)
def test_rays_agree_with_a_ray_in_small_steps(name, side):
    """Through the first bulge met, lost on a wall or on a neighbour's bulge, or past the lens."""
    display = ARRAY.replace(curved_side=side, **RELIEFS[name])
    rays = oblique_rays(250, seed=5)
    px, py, weight = trace_to_panel(display, "thick", *rays)
    qx, qy, felt_weight = felt(display, *rays)
    lost, clear = felt_weight == 0, ~near_an_edge(display, *rays[:2])
    assert clear.mean() > 0.95
    # A ray inside the sheet that cuts the corner of a square hole is taken to go by.
    cut = 1 / 200 if display.aperture == "square" and display.fill_factor < 1 else 0.0
    assert ((weight == 0) != lost)[clear].mean() <= cut
    passes = clear & ~lost & (weight > 0)
    assert passes.mean() > 0.5
    # What is left are the oracle's differences and its 40 halvings.
    assert np.hypot(px - qx, py - qy)[passes].max() < 1e-8
    assert np.abs(weight - felt_weight)[passes].max() < 1e-6


@pytest.mark.parametrize(("cells", "suffice"), [(1, False), (4, True)])
@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("name", ["square cells", "deep bulges", "hexagonal cells"])
def test_two_cells_on_a_ray_s_path_are_enough(name, side, cells, suffice, monkeypatch):
    """Looking into more finds no other bulge, into fewer the wrong one."""
    display = ARRAY.replace(curved_side=side, **RELIEFS[name])
    rays = oblique_rays(50000, seed=13)
    two = trace_to_panel(display, "thick", *rays)
    monkeypatch.setattr("inim.display.lens.thick._CELLS_ON_THE_WAY", cells)
    other = trace_to_panel(display, "thick", *rays)
    same = np.isclose(two[0], other[0], atol=1e-9) & (two[2] == other[2])
    assert same.all() == suffice


if __name__ == "__main__":
    text = PAGE.read_text(encoding="utf-8")
    before, rest = text.split(MARKERS[0])
    _, behind = rest.split(MARKERS[1])
    PAGE.write_text(
        f"{before}{MARKERS[0]}\n{comparison_table()}\n{MARKERS[1]}{behind}", encoding="utf-8"
    )
