"""The gilt goblet, 115 mm tall, and the copper cash coin of 64 mm."""

import numpy as np

from relics.drawing import Canvas, Pen, blurred, height_field, patinated, sampled, write_png
from relics.solids import arc_length, lathe, pierced_disc, spline, write_ply, xy

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


def make_goblet(folder, rng):
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
    write_ply(lathe(profile, v, segments, 2.0, raised), folder, "goblet")
    gilding = ((58, 36, 18), (176, 128, 58), (222, 182, 96), (96, 104, 70))
    write_png(patinated(blurred(relief, 1.0), *gilding, rng), folder, "goblet")


def make(folder, rng):
    """The goblet and a copper cash coin of 64 mm."""
    make_goblet(folder, rng)
    height = blurred(coin_relief(), 2.2)
    write_ply(coin_mesh(height), folder, "coin")
    copper = ((74, 60, 44), (122, 80, 48), (176, 122, 76), (74, 132, 106))
    write_png(patinated(blurred(height, 0.8), *copper, rng), folder, "coin")
