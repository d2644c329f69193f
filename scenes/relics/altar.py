"""A group of votive stones: a stepped altar, a painted cone, a lapis ring, a ball, a cylinder seal.

Five bodies that do not touch, one before another, with gaps between them; flat faces, a point, a
hole, and round things. All stand on the plane y = 0.
"""

from dataclasses import replace

import numpy as np

from relics.drawing import Canvas, blend, blurred, mottle, write_png
from relics.solids import Mesh, join, lathe, moved, tipped, torus, turned, write_ply, xy

PIECES = ("altar", "cone", "ring", "ball", "seal")  # cells of the texture, from left to right
CELL = 256  # pixels along a side of a cell


def box(half_width, height, half_depth):
    """Block with flat faces on y = 0; each of its faces shows the texture's whole cell."""
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)], float)
    points, normals = [], []
    for axis in range(3):
        for side in (-1.0, 1.0):
            face = np.insert(corners if side > 0 else corners[::-1], axis, side, axis=1)
            # Axes x and z are named in cyclic order, y against it: seen from outside, turned round.
            points.append(face[::-1] if axis == 1 else face)
            normals.append(np.tile(np.eye(3)[axis] * side, (4, 1)))
    points, normals = np.concatenate(points), np.concatenate(normals)
    across = np.where(np.abs(normals[:, :1]) > 0.5, points[:, 2:], points[:, :1])
    down = np.where(np.abs(normals[:, 1:2]) > 0.5, points[:, 2:], -points[:, 1:2])
    uv = 0.5 + 0.5 * np.hstack([across, down])
    first = 4 * np.arange(6)[:, None]
    faces = np.concatenate([first + np.array(half) for half in ((0, 1, 2), (0, 2, 3))]).astype(
        np.int32
    )
    points = points * [half_width, height / 2, half_depth] + [0, height / 2, 0]
    return Mesh(points, normals, uv, faces)


def in_cell(mesh, piece):
    """The mesh with its texture in the cell of a piece, half a pixel off the cell's rim."""
    rim = 1.0 / CELL
    u = (PIECES.index(piece) + rim + (1 - 2 * rim) * mesh.uv[:, 0]) / len(PIECES)
    return replace(mesh, uv=np.stack([u, mesh.uv[:, 1]], -1))


def ball(radius, rings=40, segments=64):
    """Sphere on y = 0."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, rings + 1)
    profile = radius * np.stack([np.cos(angle), 1 + np.sin(angle)], -1)
    profile[[0, -1], 0] = 0.0
    return lathe(profile, 0.5 - 0.5 * np.sin(angle), segments)


def cone():
    """Slender cone with a rounded rim and a blunt point."""
    profile = xy("0,0 22,0 23.6,.6 24,2 23.4,4.5 1.8,90 1.2,91.3 0,91.8")
    slope = np.linspace(profile[4], profile[5], 24)
    profile = np.concatenate([profile[:4], slope, profile[6:]])
    return lathe(profile, 1.0 - profile[:, 1] / 91.8, 72)


def seal():
    """Cylinder on its side, along x before it is turned, pierced at neither end."""
    profile = xy("0,-19 9.2,-19 10.2,-18.6 10.6,-17.6 10.6,17.6 10.2,18.6 9.2,19 0,19")
    lying = turned(tipped(lathe(profile, 0.5 - profile[:, 1] / 38.0, 48), 90), 90)
    return moved(lying, y=10.6)


def incised(canvas_size, draw):
    """Depth of lines in a cell, 0..1: what `draw` draws on a canvas of that size [mm]."""
    canvas = Canvas(canvas_size, canvas_size, (CELL, CELL), 0)
    draw(canvas)
    return blurred(canvas.array() / 255.0, 0.7)


def draw_wedges(canvas):
    """Rows of wedge-shaped signs within a frame."""
    canvas.line(xy("-27,4 27,4 27,56 -27,56 -27,4"), 1.2, 200)
    for row in range(5):
        for k in range(7):
            x, y = -21 + 7 * k, 9 + 9.4 * row
            turn = (3 * row + 5 * k + row * k) % 4
            head = np.array([(-2.2, 0), (2.2, 0), (0, 2.6)])
            tail = np.array([(-0.55, 1.5), (0.55, 1.5), (0, 6.6)])
            for part in (head, tail):
                points = part[:, ::-1] - [3, -3] if turn % 2 else part
                canvas.polygon(np.add(points, (x, y)), 255)
            if turn > 1:
                canvas.polygon(np.add(head, (x + 3, y + 3.4)), 255)


def draw_figures(canvas):
    """Palms, and beasts that walk between them."""
    for k in range(-2, 3):
        x = 13.2 * k
        canvas.line([(x, 16), (x, 48)], 1.4, 255)
        for leaf in (-5, -2.5, 2.5, 5):
            canvas.line([(x, 17), (x + leaf, 12 + 0.9 * abs(leaf))], 1.3, 255)
        canvas.line(np.add(xy("2.5,30 10.5,29"), (x, 0)), 3.6, 255)
        for leg in (3, 5, 8.4, 10.4):
            canvas.line([(x + leg, 31), (x + leg - 0.4, 43)], 1.1, 255)
        canvas.line(np.add(xy("10.5,29 11.5,22 9,18"), (x, 0)), 1.5, 255)
    for y in (7, 53):
        canvas.line([(-40, y), (40, y)], 1.4, 255)


def stone(light, dark, cells, rng, vein=0.0):
    """Colour of a cell of stone, with veins where asked for, (CELL, CELL, 3) sRGB."""
    field = mottle(CELL, CELL, cells, 5, rng)
    colour = blend(dark, light, 0.55 + 0.5 * field)
    crest = np.exp(-(((field + 0.25 * mottle(CELL, CELL, 4, 3, rng)) / 0.06) ** 2))
    return blend(colour, (226, 214, 186), vein * crest)


def painted_cone(rng):
    """Terracotta with zigzags in black and cream."""
    v, u = np.mgrid[0:CELL, 0:CELL] / CELL
    wave = np.abs(np.mod(12 * u, 1.0) - 0.5)
    band = np.mod(5.0 * v + 0.9 * wave, 1.0)
    clay = stone((196, 104, 62), (140, 66, 38), 6, rng)
    clay = np.where(((band > 0.1) & (band < 0.38))[..., None], (38, 30, 28), clay)
    return np.where(((band > 0.45) & (band < 0.62))[..., None], (222, 204, 164), clay)


def texture(rng):
    """All cells side by side."""
    limestone = stone((214, 196, 158), (158, 136, 100), 5, rng)
    limestone = blend(limestone, (70, 54, 38), 0.8 * incised(60, draw_wedges))
    lapis = stone((52, 84, 168), (18, 30, 84), 7, rng)
    flecks = mottle(CELL, CELL, 40, 2, rng)
    lapis = blend(lapis, (206, 172, 88), 4 * (flecks - 1.0))
    carnelian = stone((214, 104, 62), (112, 26, 18), 3, rng, vein=0.75)
    serpentine = stone((108, 142, 108), (48, 78, 62), 6, rng)
    serpentine = blend(serpentine, (22, 30, 26), 0.85 * incised(66, draw_figures))
    return np.concatenate([limestone, painted_cone(rng), lapis, carnelian, serpentine], axis=1)


def make(folder, rng):
    """The group: matt bodies in one mesh, polished ones in another."""
    steps = [box(36, 12, 24), moved(box(29, 42, 18), y=11), moved(box(34, 9, 22), y=52)]
    block = in_cell(moved(turned(join(steps), 24), x=-30, z=-58), "altar")
    spire = in_cell(moved(cone(), x=42, z=-24), "cone")
    write_ply(join([block, spire]), folder, "altar_matt")
    hoop = moved(tipped(torus(24.0, 6.5, 96, 28), 82), y=29.5)
    hoop = in_cell(moved(turned(hoop, -22), x=-22, z=14), "ring")
    globe = in_cell(moved(ball(17.0), x=28, z=40), "ball")
    roller = in_cell(moved(turned(seal(), 28), x=-18, z=66), "seal")
    write_ply(join([hoop, globe, roller]), folder, "altar_polished")
    write_png(texture(rng), folder, "altar")
