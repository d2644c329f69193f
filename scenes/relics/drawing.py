"""Textures and height maps drawn in millimetres, and the PNG files they go to."""

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from relics.solids import spline

SUPERSAMPLING = 2  # drawn this much larger, then averaged, so that edges are smooth


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


def write_png(array, folder, name):
    """Write an sRGB image, (rows, columns, 3) in 0..255, to ``folder/textures/name.png``."""
    image = Image.fromarray(np.clip(np.round(array), 0, 255).astype(np.uint8))
    path = Path(folder) / "textures" / f"{name}.png"
    path.parent.mkdir(parents=True, exist_ok=True)
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
