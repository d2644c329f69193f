"""Colours of rays in float64: the section "Colour of a ray" of `docs/theory/templates.md`.

Written from that page alone, in plain loops, without code of the package. Sources and rays are
given; `tests.oracle` and `reports.stress.study` check them separately.
"""

import math
from dataclasses import dataclass

import numpy as np

STEEPEST = 20
COLOURS = ("linear", "averaged", "smooth")


def linear_from_code(code: np.ndarray) -> np.ndarray:
    """Linear light of sRGB values 0 .. 1 (IEC 61966-2-1)."""
    return np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)


def code_from_linear(light: np.ndarray) -> np.ndarray:
    """Inverse of `linear_from_code`."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


@dataclass
class Picture:
    """A picture for the oracle.

    Attributes
    ----------
    light : (layers, H, W, channels) float64
        Some channels in linear light, or opacity.
    depth : (layers, H, W) float64
        Depths of fronts in millimetres, NaN where nothing is covered.
    pixel_mm : float
    """

    light: np.ndarray
    depth: np.ndarray
    pixel_mm: float

    def neighbour(self, depth: float, row: int, column: int, distance: float) -> int | None:
        """Layer of a pixel that is on one surface with a depth; None if there is none.

        Parameters
        ----------
        depth : float
            Depth of the pixel in question.
        row, column : int
        distance : float
            Distance of that pixel, in pixels.
        """
        layers, rows, columns = self.depth.shape
        if not (0 <= row < rows and 0 <= column < columns):
            return None
        candidates = []
        for layer in range(layers):
            far = abs(self.depth[layer, row, column] - depth)
            if far <= STEEPEST * distance * self.pixel_mm:
                candidates.append((far, self.depth[layer, row, column], layer))
        return min(candidates)[2] if candidates else None

    def averaged(self, width: tuple[float, float], present: float) -> "Picture":
        """The picture averaged over footprints.

        Parameters
        ----------
        width : (down, right)
            Size of a footprint at the depth of 1 mm, in picture pixels.
        present : float
            Variance that is there anyway.
        """
        light, step = self.light, 1
        variance = self._variance(width, present)
        while True:
            earlier = (step**2 - 1) / 12  # the sum of 4^i / 4 over all earlier passes
            shares = [np.clip(v - earlier, 0, step**2 / 4) for v in variance]
            if not np.nansum(shares):
                return Picture(light, self.depth, self.pixel_mm)
            light = self._diffused(light, shares, step)
            step *= 2

    def sharpened(self, width: tuple[float, float], present: float) -> "Picture":
        """The picture after one pass with the negative part of the variance; see `averaged`."""
        shares = [np.minimum(v, 0) for v in self._variance(width, present)]
        return Picture(self._diffused(self.light, shares, 1), self.depth, self.pixel_mm)

    def _variance(self, width: tuple[float, float], present: float) -> list[np.ndarray]:
        """Variance V of each pixel on both axes."""
        return [(np.abs(self.depth) * w) ** 2 / 12 - present for w in width]

    def _diffused(self, light: np.ndarray, shares: list[np.ndarray], step: int) -> np.ndarray:
        """One pass, with the variance of each pixel on both axes."""
        changed = light.copy()
        for layer, row, column in np.argwhere(~np.isnan(self.depth)):
            for share, (down, right) in zip(shares, ((1, 0), (0, 1)), strict=True):
                for side in (-step, step):
                    beside = row + side * down, column + side * right
                    other = self.neighbour(self.depth[layer, row, column], *beside, step)
                    if other is not None:
                        gain = share[layer, row, column] / (2 * step**2)
                        difference = light[(other, *beside)] - light[layer, row, column]
                        changed[layer, row, column] += gain * difference
        return np.maximum(changed, 0)

    def interpolated(self, source: tuple[int, int, int], row: float, column: float) -> np.ndarray:
        """Bilinear values at a point, limited to the source pixel."""
        layer, r, c = source
        depth = self.depth[source]
        down = min(max(row, r), r + 1) - (r + 0.5)
        right = min(max(column, c), c + 1) - (c + 0.5)
        total, weights = np.zeros(self.light.shape[-1]), 0.0
        for rows, share_down in ((0, 1 - abs(down)), (1, abs(down))):
            for columns, share_right in ((0, 1 - abs(right)), (1, abs(right))):
                p = r + int(math.copysign(rows, down))
                q = c + int(math.copysign(columns, right))
                at = layer if not (rows or columns) else None
                if at is None:
                    at = self.neighbour(depth, p, q, math.hypot(rows, columns))
                if at is not None:
                    weights += share_down * share_right
                    total += share_down * share_right * self.light[at, p, q]
        return total / weights


def averaged_picture(picture: Picture, colour: str, footprint: tuple[float, float]) -> Picture:
    """The picture that the rays of a colour option read; square roots of light for ``smooth``.

    Parameters
    ----------
    picture : Picture
        In linear light.
    colour : str
        One of `COLOURS`.
    footprint : (down, right)
        Size of a footprint at the depth of 1 mm, in picture pixels.
    """
    if colour == "linear":
        return picture
    if colour == "averaged":
        return picture.averaged(footprint, present=1 / 12)
    picture = picture.averaged(footprint, present=1 / 6)
    roots = Picture(np.sqrt(picture.light), picture.depth, picture.pixel_mm)
    return roots.sharpened(footprint, present=1 / 6)


def ray_values(picture: Picture, colour: str, sources: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """Values of a picture for some rays, (n, channels); 0 where there is no source.

    Parameters
    ----------
    picture : Picture
        For light from `averaged_picture`, squared afterwards if ``smooth``; for opacity as it is.
    colour : str
        One of `COLOURS`.
    sources : (n,) int
        ``(layer * H + row) * W + column``, or negative.
    rays : (n, 4) float
        v0, dv, u0, du: row ``v0 + dv z`` and column ``u0 + du z`` of the picture at a depth z.
    """
    values = np.zeros((len(sources), picture.light.shape[-1]))
    for n in np.flatnonzero(sources >= 0):
        source = np.unravel_index(sources[n], picture.depth.shape)
        v0, dv, u0, du = rays[n]
        z = picture.depth[source]
        if colour == "averaged":
            values[n] = picture.light[source]
        else:
            values[n] = picture.interpolated(source, v0 + dv * z, u0 + du * z)
    return values
