"""The bronze ibex, 168 mm tall: ridged horns, thin legs on runners, a carrying ring on its back."""

import numpy as np

from relics.drawing import mottle, patinated, write_png
from relics.solids import arc_length, join, moved, spline, sweep, tipped, torus, turned, write_ply

IBEX_COLOURS = ((30, 26, 20), (134, 98, 54), (212, 170, 100), (86, 142, 114))


def limb(stations, rings, segments=20, ridge=0.0):
    """Round bar in the xy plane with rounded ends.

    Parameters
    ----------
    stations : sequence of (x, y, half_width, half_thickness)
        Along its centre line; widths are across z [mm].
    rings, segments : int
        Of the grid, along the bar and around it.
    ridge : float
        Height of rings about every 6 mm [mm].
    """
    curve = spline(stations, 8)
    along = arc_length(curve[:, :2])
    # Closer together towards the ends, which are round.
    at = along[-1] * (0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, rings)))
    x, y, width, thickness = (np.interp(at, along, column) for column in curve.T)
    t = np.clip(np.minimum(at, along[-1] - at) / np.minimum(width, thickness), 0.02, 1.0)
    size = np.sqrt(t * (2.0 - t))
    raised = ridge * (0.5 - 0.5 * np.cos(2 * np.pi * at / 6.0)) * (thickness / thickness.max())
    path = np.stack([x, y, np.zeros(rings)], -1)
    return sweep(path, (0, 0, 1), size * width + raised, size * thickness + raised, segments)


def ibex_body():
    """Trunk and neck, head, ears, beard and tail."""
    trunk = [
        (-47, 71, 7, 8), (-40, 75, 13, 13), (-22, 77, 15, 15), (0, 74, 15, 16), (20, 77, 14, 17),
        (34, 87, 11, 14), (43, 101, 8.5, 10), (52, 117, 7, 8),
    ]  # fmt: skip
    head = [(46, 119, 6, 6), (56, 122, 7.5, 9), (68, 118, 6, 7), (83, 110, 4, 4.5)]
    beard = [(74, 112, 1.6, 2.4), (71, 103, 1.4, 2), (72, 95, 0.8, 0.8)]
    tail = [(-45, 76, 3, 3), (-54, 82, 2.6, 2.6), (-58, 92, 2.4, 2.4), (-53, 99, 1.4, 1.4)]
    ear = limb([(0, 0, 1.6, 1.6), (9, 2, 3, 1.5), (18, 1, 0.9, 0.9)], 16, 12)
    ears = [moved(turned(ear, angle), x=49, y=124) for angle in (-112, 112)]
    parts = [limb(trunk, 56, 36), limb(head, 32, 28), limb(beard, 14, 12), limb(tail, 24, 14)]
    return join([*parts, *ears])


def ibex_legs():
    """Four thin legs on two runners, which two bars join."""
    fore = [(19, 78, 7, 9), (24, 54, 5, 6.2), (27, 38, 4, 4.6), (24, 20, 2.9, 3.1),
            (25, 8, 3, 3.4), (28, 0, 4.2, 4.6)]  # fmt: skip
    hind = [(-34, 74, 8, 12), (-35, 56, 6, 8.5), (-45, 39, 3.8, 4.8), (-39, 20, 2.9, 3.2),
            (-39, 8, 3, 3.4), (-36, 0, 4.2, 4.6)]  # fmt: skip
    runner = limb([(-54, -2, 3, 2), (-8, -2.6, 3, 2), (40, -2, 3, 2), (48, 3, 2, 2)], 36, 14)
    bar = turned(limb([(-13, -2, 2.4, 1.6), (13, -2, 2.4, 1.6)], 14, 12), 90)
    legs = [limb(leg, 36, 16) for leg in (fore, hind)]
    sides = [moved(part, z=z) for part in (*legs, runner) for z in (-10, 10)]
    return join([*sides, *(moved(bar, x=x) for x in (-46, 38))])


def ibex_horns():
    """Two arcs that sweep back over the trunk, ridged and pointed."""
    arc = [(55, 122, 4.2, 5), (60, 140, 4, 5), (54, 156, 3.6, 4.6), (38, 165, 3.1, 4),
           (18, 163, 2.5, 3.2), (3, 151, 1.9, 2.4), (-3, 136, 1, 1.2)]  # fmt: skip
    horn = moved(limb(arc, 120, 16, 0.9), y=-122)
    return join([moved(tipped(horn, angle), y=122, z=z) for angle, z in ((13, 3.5), (-13, -3.5))])


def ibex_ring():
    """Eyelet on the back, and the ring that stands in it."""
    arch = np.linspace(-0.15 * np.pi, 1.15 * np.pi, 25)
    path = np.stack([7 * np.cos(arch) - 12, 7 * np.sin(arch) + 93, np.zeros(25)], -1)
    eyelet = sweep(path, (0, 0, 1), 2.4, 2.0, 14)
    ring = turned(tipped(torus(16.0, 2.1), 90), 72)
    return join([eyelet, moved(ring, x=-12, y=111.5)])


def make(folder, rng):
    """Bronze ibex of 168 mm with a ring."""
    body, legs, horns, ring = ibex_body(), ibex_legs(), ibex_horns(), ibex_ring()
    write_ply(join([body, legs, horns, ring]), folder, "ibex")
    plain = 0.45 + 0.16 * mottle(256, 256, 5, 4, rng)
    write_png(patinated(plain, *IBEX_COLOURS, rng), folder, "ibex")
