"""The bronze ding, 232 mm tall, with a monster-mask band in relief."""

import numpy as np

from relics.drawing import Canvas, Pen, blurred, mottle, patinated, sampled, spiral, write_png
from relics.solids import arc_length, join, lathe, moved, spline, sweep, turned, write_ply, xy

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


def make(folder, rng):
    """Bronze ding, 230 mm tall: bowl, relief band, flanges, legs and handles."""
    relief = blurred(taotie_relief(), 1.6)
    write_ply(ding_band(blurred(relief, 1.5, 2.5)), folder, "tripod_band")
    vessel = join([ding_bowl(), ding_flanges(), ding_legs(), ding_handles()])
    write_ply(vessel, folder, "tripod_vessel")
    write_png(patinated(relief, *DING_COLOURS, rng), folder, "tripod_band")
    plain = 0.42 + 0.14 * mottle(512, 512, 6, 4, rng)
    write_png(patinated(plain, *DING_COLOURS, rng), folder, "tripod_bronze")
