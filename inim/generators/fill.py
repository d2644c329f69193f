# Kernels have no types of their own.
# mypy: disable-error-code="no-untyped-def, no-untyped-call"
"""What the picture did not see: an option of every algorithm that says where its colours come from.

Definition. A hole belongs to one view: the pixels at its place under all other lenses send rays
parallel to its own. In that view, in each of the eight directions, the next pixel that shows
something names a surface. Carried on to the hole at its depth, that surface is a candidate, unless
the picture shows something farther at the place where the hole's ray is at that depth: there the
picture saw that nothing is. A foreground beside the background that it uncovers is ruled out so;
what goes on behind the foreground, or beyond the picture's edge, is not. The hole takes the mean of
the candidates' colours, in linear light, each by its nearness. Nothing that is shown lies between
it and a candidate, so nothing is carried over across a nearer surface. Where all are ruled out, as
on a slanted background behind something thin, the farthest are taken.

Where a surface ends its pixels are mixed with what is beside it. A candidate's colour is therefore
that of the picture's next pixel, away from the hole, if that is the same surface.

Uncovered pixels are seen ground under `hidden`: it rules out as what is farther does, and a hole
whose ray ends on it stays, unless there is a candidate. Under `all` they are pixels
of which nothing is known, as in a photograph whose depth has gaps.

Each hole is filled by what its own view shows, never by another filled hole: results depend on no
order, and the cost grows with the number of holes.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from inim.color import linear_from_srgb, srgb_from_linear, srgb_to_uint8
from inim.display import Display
from inim.display.pixels import PixelAxis
from inim.errors import UsageError
from inim.generators.base import HOLE, NO_LENS, Ray, SourceGenerator, Sources
from inim.generators.raycast.cells import CellRays, cell_rays
from inim.generators.raycast.surfaces import STEEPEST
from inim.rgbd import RGBD

__all__ = ["FILLS", "Filled"]

#: What is filled: nothing; what is hidden behind a surface or by the picture's edge; that and what
#: the picture does not cover.
FILLS = ("none", "hidden", "all")

# Lenses to look aside from a hole: the parallax of any display, and a bound on the time.
_REACH = 64


class Filled(SourceGenerator):
    """A generator whose holes are filled from their own views.

    Its sources are the generator's: holes are reported as it left them.

    Parameters
    ----------
    made : SourceGenerator
        Of a whole panel.
    how : {"hidden", "all"}
        See `FILLS`.

    Raises
    ------
    UsageError
        A display whose lenses stand in no rows and columns.
    """

    def __init__(self, made: SourceGenerator, how: str) -> None:
        super().__init__(made.display, made.shape, made.pixel_mm)
        if not self.display.is_separable:
            raise UsageError(
                f"fill = {how!r}: this display has {self.display.not_separable_by}, so its lenses "
                "stand in no rows and columns; use fill=none"
            )
        self._made, self._how = made, how

    def find(self, rgbd: RGBD) -> Sources:
        """See `SourceGenerator.find`."""
        return self._made.find(rgbd)

    def generate(self, rgbd: RGBD, out: np.ndarray | None = None) -> np.ndarray:
        """See `Generator.generate`; what is filled has the alpha of what is shown."""
        out = self._made.generate(rgbd, self.place(rgbd, out))
        rays = self._made.rays()
        seen = _Seen.of(rgbd, unknown=self._how == "all")
        where, light = [], []
        for ray in rays:
            holes, colour = self._missing(ray, rgbd, seen)
            share = np.zeros(4, np.float32)  # of the pixel's light, and of its alpha
            alike = sum(other.channels == ray.channels for other in rays)
            share[list(ray.channels)] = 1 / alike
            share[3] = len(ray.channels) / 3 / alike
            where.append(holes)
            light.append(colour * share)
        pixels, of = np.unique(np.concatenate(where), return_inverse=True)
        total = np.zeros((len(pixels), 4), np.float32)
        np.add.at(total, of, np.concatenate(light))
        _add_light(out.reshape(-1, out.shape[-1]), pixels, total)
        return out

    def _missing(self, ray: Ray, rgbd: RGBD, seen: _Seen) -> tuple[np.ndarray, np.ndarray]:
        """The panel pixels whose ray meets nothing and can be filled, and what with.

        Returns
        -------
        pixels : (n,) int64
            ``row * columns + column`` of the panel.
        colour : (n, 4) float32
            Linear RGB, and 1.
        """
        sources = ray.generator.sources(rgbd)
        holes = np.flatnonzero(sources == HOLE)
        colour = np.ones((len(holes), 4), np.float32)
        filled = np.zeros(len(holes), np.bool_)
        columns, rows = cell_rays(self.shape, self.pixel_mm, self.display, ray.aside)
        display = self.display
        down = _lattice(display.rows, display.lens_rows, display.elemental_row_pitch_mm, display)
        across = _lattice(
            display.columns, display.lens_columns, display.elemental_image_pitch_mm, display
        )
        _fill(
            holes, sources, down, across, _kept(rows), _kept(columns), *seen,
            STEEPEST * self.pixel_mm, display.row_pitch_mm / display.pitch_mm,
            display.depth_range_mm[0], colour, filled,
        )  # fmt: skip
        return holes[filled], colour[filled]


class _Seen(NamedTuple):
    """What the picture says, of all its layers.

    Attributes
    ----------
    nearest : (H, W) float32
        Depth up to which nothing can be known of a place; -inf where the ground is seen.
    depth : (layers x H x W,) float32
        Of what is shown; -inf where there is nothing.
    palette : (layers x H x W, 3) float32
        Linear RGB.
    """

    nearest: np.ndarray
    depth: np.ndarray
    palette: np.ndarray

    @classmethod
    def of(cls, rgbd: RGBD, *, unknown: bool) -> _Seen:
        uncovered = np.float32(np.inf if unknown else -np.inf)
        layers = rgbd.layers
        depth = [np.where(one.covered, one.front_mm, np.float32(-np.inf)) for one in layers]
        color = rgbd.palette.reshape(-1, rgbd.color.shape[2])[:, :3]
        if color.dtype == np.uint8:
            color = _LIGHT[color]
        nearest = np.where(rgbd.covered, rgbd.depth_mm, uncovered)
        return cls(nearest, np.concatenate(depth).reshape(-1), color)


_LIGHT = linear_from_srgb(np.arange(256, dtype=np.float32) / np.float32(255))


def _add_light(pixels: np.ndarray, at: np.ndarray, light: np.ndarray) -> None:
    """Add light, (n, 4) with its share of the pixel, to float RGB or sRGB codes with alpha."""
    if pixels.dtype != np.uint8:
        pixels[at] += light[:, :3]
        return
    shown = _LIGHT[pixels[at, :3]] + light[:, :3]
    pixels[at, :3] = srgb_to_uint8(srgb_from_linear(shown))
    alpha = pixels[at, 3] + np.rint(light[:, 3] * np.float32(255))
    pixels[at, 3] = np.minimum(alpha, 255).astype(np.uint8)


def _kept(rays: CellRays) -> tuple[np.ndarray, np.ndarray, float]:
    return rays.start, rays.slope, rays.scale


def _lattice(
    axis: PixelAxis, lenses: int, pitch_mm: float, display: Display
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Lens of each panel pixel; first pixel of each lens and the one after its last; their pitch.

    The pitch is in panel pixels: where it is no whole number, the pixel at the same place under
    another lens is the nearest one.
    """
    first, end = axis.elemental_images(lenses)
    return axis.lens, first, end, pitch_mm / display.pixel_pitch_mm


@numba.njit(parallel=True, cache=True, nogil=True)
def _fill(
    holes, sources, down, across, row_rays, column_rays, nearest, depth, palette, same_mm, aspect,
    z_min, colour, filled,
):  # fmt: skip
    """Fill each hole; see the module's definition."""
    wide = sources.shape[1]
    for n in numba.prange(len(holes)):
        i, j = divmod(holes[n], wide)
        if _seen_at(nearest, row_rays, i, column_rays, j, z_min) == -np.inf:
            continue
        found, lenses = np.empty(9, np.int64), np.ones(9, np.int64)
        farthest, farther = np.inf, np.empty(9, np.bool_)
        ruled_out = True
        for k in range(9):
            found[k], lenses[k] = _next_shown(sources, i, j, k // 3 - 1, k % 3 - 1, down, across)
            if found[k] >= 0:
                z = depth[found[k]]
                place = np.float32(np.inf)
                for on in range(lenses[k]):
                    p = _beside(i, on * (k // 3 - 1), down)
                    q = _beside(j, on * (k % 3 - 1), across)
                    place = min(place, _seen_at(nearest, row_rays, p, column_rays, q, z))
                if place == -np.inf:  # the ground is seen between the two
                    found[k] = -1
                    continue
                farthest = min(farthest, z)
                farther[k] = place < z - same_mm
                ruled_out &= farther[k]
        weight = red = green = blue = 0.0
        for k in range(9):
            if found[k] < 0:
                continue
            z = depth[found[k]]
            if (ruled_out and z > farthest + same_mm) or (farther[k] and not ruled_out):
                continue
            down_step, right_step = k // 3 - 1, k % 3 - 1
            source = _next_of_surface(
                found[k], down_step, right_step, depth, nearest.shape, same_mm
            )
            share = 1 / (lenses[k] * np.sqrt((down_step * aspect) ** 2 + right_step**2))
            weight += share
            red += share * palette[source, 0]
            green += share * palette[source, 1]
            blue += share * palette[source, 2]
        if weight > 0:
            filled[n] = True
            colour[n, 0], colour[n, 1], colour[n, 2] = red / weight, green / weight, blue / weight


@numba.njit(cache=True, nogil=True)
def _seen_at(nearest, row_rays, i, column_rays, j, z):
    """What the picture shows where a ray is at a depth; beyond its edge, what may be anything."""
    v0, dv, v1 = row_rays
    u0, du, u1 = column_rays
    v = np.floor((v0[i] + dv[i] * z) / v1)
    u = np.floor((u0[j] + du[j] * z) / u1)
    if 0 <= v < nearest.shape[0] and 0 <= u < nearest.shape[1]:
        return nearest[int(v), int(u)]
    return np.float32(np.inf)


@numba.njit(cache=True, nogil=True)
def _next_of_surface(source, down_step, right_step, depth, shape, same_mm):
    """The picture's next pixel in a direction, if it is the same surface; or the pixel itself."""
    row, column = divmod(source % (shape[0] * shape[1]), shape[1])
    beside = source + down_step * shape[1] + right_step
    if (
        0 <= row + down_step < shape[0]
        and 0 <= column + right_step < shape[1]
        and abs(depth[beside] - depth[source]) <= same_mm
    ):
        return beside
    return source


@numba.njit(cache=True, nogil=True)
def _next_shown(sources, i, j, step_i, step_j, down, across):
    """Source of the next pixel of a view that shows something, or -1; and how many lenses on."""
    if step_i == 0 and step_j == 0:
        return np.int64(-1), 0
    for k in range(1, _REACH + 1):
        p, q = _beside(i, k * step_i, down), _beside(j, k * step_j, across)
        if p < 0 or q < 0 or sources[p, q] == NO_LENS:
            break
        if sources[p, q] >= 0:
            return np.int64(sources[p, q]), k
    return np.int64(-1), 0


@numba.njit(cache=True, nogil=True)
def _beside(pixel, lenses, axis):
    """The pixel of another elemental image that is nearest to the same place; -1 if none is."""
    lens, first, end, pitch = axis
    other = lens[pixel] + lenses
    if not 0 <= other < len(first) or end[other] <= first[other]:
        return np.int64(-1)
    place = np.int64(np.floor(pixel + lenses * pitch + 0.5))
    return min(max(place, first[other]), end[other] - 1)
