"""The amphora: black figure on terracotta, 400 mm tall."""

import numpy as np

from relics.drawing import Canvas, Pen, mottle, spiral, write_png
from relics.solids import arc_length, join, lathe, spline, sweep, write_ply, xy

BLACK_GLAZE = (30, 24, 23)
TERRACOTTA = (196, 104, 56)
PURPLE = (112, 34, 38)
CREAM = (226, 208, 172)


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


def make(folder, rng):
    """Amphora, 400 mm tall: body, handles and the painted texture."""
    body, down, length = amphora_body()
    write_ply(body, folder, "amphora_body")
    write_ply(amphora_handles(), folder, "amphora_handles")
    painting = amphora_texture(down, length, np.pi * 134.0)
    wear = mottle(1024, 1024, 6, 3, rng)[..., None]
    painting = painting * (1.0 + 0.05 * wear) + 2.0 * wear
    write_png(painting, folder, "amphora")
