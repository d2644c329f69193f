"""The jade disc (bi), 160 mm across, on its wooden stand."""

import numpy as np

from relics.drawing import (
    Canvas,
    Pen,
    blend,
    blurred,
    height_field,
    mottle,
    sampled,
    spiral,
    write_png,
)
from relics.solids import grid_mesh, join, moved, pierced_disc, spline, sweep, write_ply, xy

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


def make(folder, rng):
    """Jade bi of 160 mm in low relief on a wooden stand."""
    height = blurred(jade_relief(), 1.6)
    inner = np.full(321, JADE_HOLE)
    disc = pierced_disc(inner, JADE_RADIUS, height_field(height, JADE_RADIUS, 0.9), 54, 3.0, 0.7)
    write_ply(disc, folder, "jade_disc")
    write_ply(jade_stand(), folder, "jade_stand")
    colour = jade_colour(blurred(height, 0.8), rng)
    write_png(colour.reshape(512, 2, 1024, 2, 3).mean((1, 3)), folder, "jade")
    write_png(wood_texture(rng), folder, "wood")
