"""An algorithm for inim: the whole picture is assumed to be in the central depth plane."""

import numpy as np


def prepare(display, shape, pixel_mm, *, brightness=1.0):
    """Prepare an algorithm that assumes the whole picture in the central depth plane."""
    z = display.central_depth_mm
    x = display.columns.centre_mm + display.columns.slope * z
    y = display.rows.centre_mm + display.rows.slope * z
    columns = np.floor(x / pixel_mm + shape[1] / 2).astype(int)
    rows = np.floor(shape[0] / 2 - y / pixel_mm).astype(int)
    return Flat(rows.clip(0, shape[0] - 1), columns.clip(0, shape[1] - 1), float(brightness))


class Flat:
    def __init__(self, rows, columns, brightness):
        self.pixels, self.brightness = np.ix_(rows, columns), brightness

    def generate(self, rgbd, out=None):
        color = rgbd.color[self.pixels]
        out = np.empty_like(color) if out is None else out
        out[...] = color * self.brightness
        out[~rgbd.covered[self.pixels]] = 0
        return out
