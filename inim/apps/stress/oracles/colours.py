"""Colours of rays in float64: the section "Colour of a ray" of `docs/theory/templates.md`.

Written from that page alone, in plain loops. Sources and rays are given: other oracles check them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from inim.apps.stress.oracles.rays import panel_rays, rays_over
from inim.display import Display
from inim.display.pixels import SUBPIXELS, PixelOffset, SubPixel, exact_length
from inim.generators.steps import RayGenerator
from inim.image.rgbd import RGBD

STEEPEST = 20
COLOURS = ("linear", "averaged", "smooth")
_QUARTER = Fraction(1, 4)
_STARTS = {
    1: [(Fraction(0), Fraction(0))],
    2: [(-_QUARTER, -_QUARTER), (_QUARTER, _QUARTER)],
    4: [(a, b) for a in (-_QUARTER, _QUARTER) for b in (-_QUARTER, _QUARTER)],
}
#: Height and width of a footprint at some depths, in picture pixels.
Footprint = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


def linear_from_code(code: np.ndarray) -> np.ndarray:
    """Linear light of sRGB values 0 .. 1 (IEC 61966-2-1)."""
    return np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)


def code_from_linear(light: np.ndarray) -> np.ndarray:
    """Inverse of `linear_from_code`."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


@dataclass
class OraclePicture:
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

    def averaged(self, footprint: Footprint, present: float) -> OraclePicture:
        """The picture averaged over footprints; `present` is the variance that is there anyway."""
        light, step = self.light, 1
        variance = self._variance(footprint, present)
        while True:
            earlier = (step**2 - 1) / 12  # the sum of 4^i / 4 over all earlier passes
            shares = [np.clip(v - earlier, 0, step**2 / 4) for v in variance]
            if not np.nansum(shares):
                return OraclePicture(light, self.depth, self.pixel_mm)
            light = self._diffused(light, shares, step)
            step *= 2

    def sharpened(self, footprint: Footprint, present: float) -> OraclePicture:
        """The picture after one pass with the negative part of the variance; see `averaged`."""
        shares = [np.minimum(v, 0) for v in self._variance(footprint, present)]
        return OraclePicture(self._diffused(self.light, shares, 1), self.depth, self.pixel_mm)

    def _variance(self, footprint: Footprint, present: float) -> list[np.ndarray]:
        """Variance V of each pixel on both axes."""
        return [side**2 / 12 - present for side in footprint(self.depth)]

    def _diffused(self, light: np.ndarray, shares: list[np.ndarray], step: int) -> np.ndarray:
        """One pass, with the variance of each pixel on both axes."""
        changed = light.copy()
        for share, axis in zip(shares, (1, 2), strict=True):
            for side in (-step, step):
                depth, beside = (_moved(values, side, axis) for values in (self.depth, light))
                # (own layer, layer beside, row, column)
                far = np.abs(depth[None] - self.depth[:, None])
                far = np.where(far <= STEEPEST * step * self.pixel_mm, far, np.inf)
                # The nearest in depth; of two at one distance, the deepest.
                rank = np.lexsort((np.broadcast_to(depth[None], far.shape), far), axis=1)[:, :1]
                has_neighbour = np.isfinite(np.take_along_axis(far, rank, axis=1))[:, 0]
                other = np.take_along_axis(beside[None], rank[..., None], axis=1)[:, 0]
                gain = np.where(has_neighbour, share / (2 * step**2), 0)[..., None]
                changed += np.where(gain != 0, gain * (np.nan_to_num(other) - light), 0)
        result: np.ndarray = np.maximum(changed, 0)
        return result

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


def _moved(values: np.ndarray, side: int, axis: int) -> np.ndarray:
    """Values of the pixels `side` pixels on along an axis; NaN beyond the picture."""
    moved = np.roll(values, -side, axis)
    beyond = [slice(None)] * values.ndim
    beyond[axis] = slice(-side, None) if side > 0 else slice(None, -side)
    moved[tuple(beyond)] = np.nan
    return moved


def averaged_picture(picture: OraclePicture, colour: str, footprint: Footprint) -> OraclePicture:
    """The picture that the rays of a colour option read; square roots of light for ``smooth``.

    Parameters
    ----------
    picture : OraclePicture
        In linear light.
    colour : str
        One of `COLOURS`.
    footprint : Footprint
    """
    if colour == "linear":
        return picture
    if colour == "averaged":
        return picture.averaged(footprint, present=1 / 12)
    picture = picture.averaged(footprint, present=1 / 6)
    roots = OraclePicture(np.sqrt(picture.light), picture.depth, picture.pixel_mm)
    return roots.sharpened(footprint, present=1 / 6)


def ray_values(
    picture: OraclePicture, colour: str, sources: np.ndarray, rays: np.ndarray
) -> np.ndarray:
    """Values of a picture for some rays, (n, channels); 0 where there is no source.

    Parameters
    ----------
    picture : OraclePicture
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
        if colour in ("averaged", "nearest"):
            values[n] = picture.light[source]
        else:
            values[n] = picture.interpolated(source, v0 + dv * z, u0 + du * z)
    return values


def footprint_of(display: Display, area: SubPixel, samples: int, pixel_mm: float) -> Footprint:
    """Footprint of one of `samples` rays of an emitting area."""
    side = display.pixel_pitch_mm * display.pixel_fill / samples**0.5
    high, wide = side * float(area.height), side * float(area.width)

    def footprint(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        far = np.abs(z) / display.gap_mm
        if not display.layout.of_cylinders:
            return far * high / pixel_mm, far * wide / pixel_mm
        # Rays of a cylinder meet in an eye at the distance V = g P / (Q - P).
        wider = max(display.elemental_image_pitch_mm / display.pitch_mm - 1, 0.0)
        per_eye = wider / display.gap_mm
        down = high * (1 - z * per_eye) / (1 + wider)
        slant = math.tan(math.radians(display.rotation_deg))
        lean = high * slant * (1 + z / display.gap_mm) / (1 + wider)
        return np.abs(down) / pixel_mm, np.hypot(far * wide, lean) / pixel_mm

    return footprint


def expected_colours(
    generator: RayGenerator, rgbd: RGBD, pixels: np.ndarray, colour: str, samples: int
) -> np.ndarray:
    """Colours of panel pixels, (n, channels) in linear light and alpha, for a generator's sources.

    Raises ``AssertionError``: the generator's rays do not start where the definition has them.
    """
    display, layers = generator.display, rgbd.layers
    depth = np.stack([np.where(layer.covered, layer.front_mm, np.nan) for layer in layers]).astype(
        float
    )
    values = np.stack([layer.color for layer in layers]).astype(float)
    if rgbd.color.dtype == np.uint8:
        values /= 255
        values[..., :3] = linear_from_code(values[..., :3])
    opacity = OraclePicture(values[..., 3:], depth, rgbd.pixel_mm)
    fill = exact_length(display.pixel_fill)
    result, starts = np.zeros((len(pixels), values.shape[-1])), []
    sources = {
        (channel, *ray.pixel_offset): of_ray[tuple(pixels.T)]
        for ray, of_ray in generator.sources_of_rays(rgbd)
        for channel in ray.channels
    }
    areas = SUBPIXELS[display.subpixels]
    for place in dict.fromkeys(areas):
        channels = [n for n, p in enumerate(areas) if p == place]
        light = OraclePicture(values[..., channels], depth, rgbd.pixel_mm)
        if colour != "nearest":
            footprint = footprint_of(display, place, samples, rgbd.pixel_mm)
            light = averaged_picture(light, colour, footprint)
        for down, right in _STARTS[samples]:
            offset = PixelOffset(
                down * place.height * fill, place.right + right * place.width * fill, place.channel
            )
            starts += [(channel, *offset) for channel in channels]
            axes = rays_over(display, rgbd, pixels, offset)
            rays = np.stack([axes.v0, axes.dv, axes.u0, axes.du], axis=1)
            ray = colour, sources[(channels[0], *offset)], rays
            colours = ray_values(light, *ray)
            result[:, channels] += (colours**2 if colour == "smooth" else colours) / samples
            result[:, 3:] += ray_values(opacity, *ray) * len(channels) / 3 / samples
    assert sources.keys() == set(starts), "rays start elsewhere"
    return result


# -- the fill of holes: the section "Hidden regions" of `docs/theory/templates.md` --------------

# Lenses to look aside from a hole.
_REACH = 64
_DIRECTIONS = [(down, right) for down in (-1, 0, 1) for right in (-1, 0, 1) if down or right]


class HoleFill:
    """Fill of the holes of a view, in plain loops.

    Parameters
    ----------
    display : Display
        A separable display.
    rgbd : RGBD
        Picture, or layers, that no ray leaves.
    sources : (rows, columns) int
        Source of each panel pixel; -1 is a hole, -2 has no lens.
    """

    def __init__(self, display: Display, rgbd: RGBD, sources: np.ndarray) -> None:
        self._display, self._sources, self._shape = display, sources, rgbd.shape
        pixels = np.argwhere(np.ones(display.eia_shape, bool))
        rays = rays_over(display, rgbd, pixels)
        self._rays = np.stack([rays.v0, rays.dv, rays.u0, rays.du], axis=-1)
        lens = panel_rays(display, pixels).lens.reshape(display.eia_shape)
        row, column = np.where(lens >= 0, np.divmod(lens, display.lens_columns), -1)
        self._lenses = row.max(axis=1), column.max(axis=0)
        pitches = display.elemental_row_pitch_mm, display.elemental_image_pitch_mm
        pixel = exact_length(display.pixel_pitch_mm)
        self._pitches = [exact_length(pitch) / pixel for pitch in pitches]
        self._front = np.where(rgbd.covered, rgbd.depth_mm.astype(float), -np.inf)
        self._depth = np.stack([layer.front_mm for layer in rgbd.layers]).astype(float).ravel()
        self._covered = np.stack([layer.covered for layer in rgbd.layers]).ravel()
        self._light = np.concatenate([layer.color.reshape(-1, 3) for layer in rgbd.layers])
        self._same_mm = STEEPEST * rgbd.pixel_mm
        self._places: dict[tuple[int, int, int], int | None] = {}

    def light(self, row: int, column: int) -> np.ndarray | None:
        """Light that a hole receives, (3,); None if it remains."""
        lowest = float(self._display.depth_range_mm[0])
        if self._seen(row, column, lowest) == -np.inf:
            return None
        candidates = [self._candidate(row, column, step) for step in _DIRECTIONS]
        surfaces = [surface for surface in candidates if surface is not None]
        if any(is_hidden for _, _, is_hidden, _ in surfaces):
            surfaces = [surface for surface in surfaces if surface[2]]
        elif surfaces and (self._front > -np.inf).all():
            farthest = min(self._depth[source] for source, *_ in surfaces)
            surfaces = [s for s in surfaces if self._depth[s[0]] <= farthest + self._same_mm]
        else:
            return None
        aspect = self._display.row_pitch_mm / self._display.pitch_mm
        shares = [1 / (away * math.hypot(down * aspect, right))
                  for _, away, _, (down, right) in surfaces]  # fmt: skip
        light = [self._light[self._beyond(source, step)] for source, _, _, step in surfaces]
        mean: np.ndarray = np.average(light, axis=0, weights=shares)
        return mean

    def _candidate(
        self, row: int, column: int, step: tuple[int, int]
    ) -> tuple[int, int, bool, tuple[int, int]] | None:
        """Next surface of the view in a direction, lenses away, whether it is certainly hidden."""
        empty = [(row, column)]
        for away in range(1, _REACH + 1):
            down = self._beside(row, away * step[0], 0)
            right = self._beside(column, away * step[1], 1)
            if down is None or right is None:
                return None
            source = int(self._sources[down, right])
            if source == -2:
                return None
            if source >= 0:
                depth = self._depth[source]
                nearest = min(self._seen(*pixel, depth) for pixel in empty)
                if nearest == -np.inf:
                    return None
                return source, away, nearest >= depth - self._same_mm, step
            empty.append((down, right))
        return None

    def _beside(self, pixel: int, lenses: int, axis: int) -> int | None:
        """Pixel of another lens that is nearest to the same place; the later one of two."""
        key = pixel, lenses, axis
        if key not in self._places:
            of = self._lenses[axis]
            others = np.flatnonzero((of == of[pixel] + lenses) & (of >= 0))
            place = pixel + lenses * self._pitches[axis]
            by_distance = sorted((abs(int(other) - place), -int(other)) for other in others)
            self._places[key] = -by_distance[0][1] if by_distance else None
        return self._places[key]

    def _seen(self, row: int, column: int, depth: float) -> float:
        """Depth that the picture shows where a ray is at a depth; infinite beyond the picture."""
        v0, dv, u0, du = self._rays[row * self._sources.shape[1] + column]
        v, u = math.floor(v0 + dv * depth), math.floor(u0 + du * depth)
        is_inside = 0 <= v < self._shape[0] and 0 <= u < self._shape[1]
        return float(self._front[v, u]) if is_inside else math.inf

    def _beyond(self, source: int, step: tuple[int, int]) -> int:
        """The picture's next pixel away from the hole if it is on the same surface, or itself."""
        rows, columns = self._shape
        layer, place = divmod(source, rows * columns)
        row, column = place // columns + step[0], place % columns + step[1]
        if not (0 <= row < rows and 0 <= column < columns):
            return source
        other = (layer * rows + row) * columns + column
        is_same = abs(self._depth[other] - self._depth[source]) <= self._same_mm
        return other if self._covered[other] and is_same else source
