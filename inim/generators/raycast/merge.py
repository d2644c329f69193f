# Kernels have no types of their own.
# mypy: disable-error-code="no-untyped-def, no-untyped-call"
"""Merge of RGB-D pictures from several cameras into a layered depth image.

docs/theory/layers.md, "Several cameras", has the definition of surfaces, backs and colours. The
**height** of a camera's surface over a point is the distance in z, along the camera's ray through
the point, to the surface that it sees: negative if it sees past the point, minus infinity if it
sees nothing there. Depth is interpolated bilinearly between pixels of one surface, so a surface has
no gaps between pixels. A point is **empty** if a camera sees past it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from inim.display import Display
from inim.generators.raycast.columns import THICKNESS_PX, surface_backs
from inim.image.rgbd import MAX_SLOPE, RGBD, CameraRGBDs
from inim.image.sides import Sides, with_sides
from inim.system.backend.kernels import compiled, share_rows
from inim.system.errors import FileError

#: Most solids of a column; further ones are left out.
MOST_SOLIDS = 8
# A column is followed in steps that move it by this part of a pixel in any picture.
_STEP_PX = 0.25
# A camera sees past a point if its surface is this far behind it: rounding, interpolation.
_PAST_PX = 0.05
# A camera sees a point if its surface is so near to it; in pixels of the result.
_SAME_PX = 1.0
# Halvings of a step in which the end of a solid is located.
_HALVINGS = 12
_EDGE_WEIGHT = 1e-3
# Steeper surfaces, depth over width, are walls.
_STEEP = 2.0
# Walls are marked in as many bins of depth: the bits of an integer.
_BINS = 64
# Pictures contradict each other where one sees past another's surface by more than this, in pixels
# of the result, and in each of them on slopes.
_CONTRADICTION_PX = 2.0
# Largest share of contradicted points. Exact pictures of ten relics have none, on three displays; a
# camera that is wrong by a fiftieth of its distance has 9 %.
_MAX_CONTRADICTION = 0.05
_CHECKED_POINTS = 20_000
_BESIDE = ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))


class _Pictures(NamedTuple):
    """All pictures in arrays of one size, padded with unknown depth.

    `resolution` has the pixels per mm^2 of surface, 0 without one; `slope` is that of the surface,
    depth over width.
    """

    depth: np.ndarray  # (cameras, H, W) float32
    color: np.ndarray  # (cameras, H, W, 3 per colouring) float32
    matrix: np.ndarray  # (cameras, 3, 4): points from pixels
    inverse: np.ndarray  # (cameras, 4, 4)
    is_pinhole: np.ndarray  # (cameras,) bool
    limits: np.ndarray  # (cameras, 2): see `Camera.same_surface`
    resolution: np.ndarray  # (cameras, H, W) float32
    slope: np.ndarray  # (cameras, H, W) float32

    @classmethod
    def of(cls, colourings: Sequence[CameraRGBDs]) -> _Pictures:
        pictures = colourings[0].pictures
        rows, columns = np.max([picture.depth.shape for picture in pictures], axis=0)
        depth = np.full((len(pictures), rows, columns), np.nan, np.float32)
        color = np.zeros((*depth.shape, 3 * len(colourings)), np.float32)
        for k, picture in enumerate(pictures):
            height, width = picture.depth.shape
            depth[k, :height, :width] = picture.depth
            colors = [cameras.pictures[k].color for cameras in colourings]
            color[k, :height, :width] = np.concatenate(colors, axis=-1)
        matrix = np.stack([picture.camera.display_from_picture for picture in pictures])
        last = np.broadcast_to([[0.0, 0, 0, 1]], (len(pictures), 1, 4))
        result = cls(
            depth,
            color,
            matrix,
            np.linalg.inv(np.concatenate([matrix, last], axis=1)),
            np.array([picture.camera.is_pinhole for picture in pictures]),
            np.array([picture.camera.same_surface for picture in pictures], np.float64),
            np.zeros(depth.shape, np.float32),
            np.zeros(depth.shape, np.float32),
        )
        lines = result.depth.shape[0] * result.depth.shape[1]
        share_rows(_describe_surfaces, lines, result, result.resolution, result.slope)
        return result


class _Walls(NamedTuple):
    """Points on the steep surfaces of all pictures, and their colours."""

    points: np.ndarray  # (n, 3) float64
    color: np.ndarray  # (n, 3 per colouring) float32

    @classmethod
    def of(cls, pictures: _Pictures) -> _Walls:
        is_steep = pictures.slope >= _STEEP
        return cls(_points(pictures, np.argwhere(is_steep)), pictures.color[is_steep])


def merge(
    colourings: Sequence[CameraRGBDs], display: Display, shape: tuple[int, int], pixel_mm: float
) -> list[RGBD]:
    """Merge pictures into a layered depth image; a single one becomes a picture without layers.

    * `colourings`: the pictures, or several versions of them that differ in colour only, such as
      half images: each is merged into one result.
    * `shape`, (rows, columns): size of the results, such as `Display.capture_shape`.

    Raises `FileError`: the pictures contradict each other.
    """
    cameras, pictures = colourings[0], _Pictures.of(colourings)
    _check_agreement(cameras, pictures, pixel_mm)
    low, high = display.depth_range_mm
    margin = (high - low) / 64
    ends = np.array([high + margin, low - margin])
    front = np.full((MOST_SOLIDS, *shape), -np.inf, np.float32)
    back, is_closed = front.copy(), np.zeros(front.shape, np.bool_)
    step = _step_mm(pictures, ends)
    share_rows(_carve, front.shape[1], pictures, pixel_mm, ends, step, front, back, is_closed)
    solids = max(1, int(np.count_nonzero((front > -np.inf).any(axis=(1, 2)))))
    front, back, is_closed = front[:solids], back[:solids], is_closed[:solids]
    color = np.zeros((*front.shape, pictures.color.shape[-1]), np.float32)
    share_rows(_colour, front.shape[1], pictures, pixel_mm, front, color)
    colors = np.split(color, len(colourings), axis=-1)
    if len(cameras.pictures) == 1:
        covered = front[0] > -np.inf
        depth = np.where(covered, front[0], 0)
        return [RGBD(color[0], depth, covered, pixel_mm) for color in colors]
    walls = _Walls.of(pictures)
    thin = np.stack([surface_backs(layer, layer > -np.inf, pixel_mm) for layer in front])
    thin[is_closed] = back[is_closed]
    bins = _mark_walls(walls.points, pixel_mm, ends, shape)
    _end_solids(front, thin, bins, ends, THICKNESS_PX * pixel_mm, back)
    sides = Sides.of(front, back, display.traced_range_mm, display.steepest_slopes, pixel_mm)
    light, has_light = _side_colours(walls, sides, shape, pixel_mm)
    return [
        with_sides((front, back, color), sides, of_sides, has_light, pixel_mm)
        for color, of_sides in zip(colors, np.split(light, len(colourings), axis=-1), strict=True)
    ]


def _step_mm(pictures: _Pictures, ends: np.ndarray) -> float:
    """Depth in which a column moves by a part of a pixel in any picture, at least 1/400 of all."""
    fastest = 1e-9
    for inverse, is_pinhole, depth in zip(
        pictures.inverse, pictures.is_pinhole, pictures.depth, strict=True
    ):
        right, down, away, _ = inverse[:, 2]
        if is_pinhole:
            nearest = np.min(depth[np.isfinite(depth)], initial=np.inf)
            rows, columns = depth.shape
            right = abs(right) + columns * abs(away)
            down = abs(down) + rows * abs(away)
            right, down = right / nearest, down / nearest
        fastest = max(fastest, abs(right), abs(down))
    span = float(ends[0] - ends[1])
    return max(min(_STEP_PX / fastest, span / 40), span / 400)


def _check_agreement(cameras: CameraRGBDs, pictures: _Pictures, pixel_mm: float) -> None:
    """Raise `FileError` if surfaces of a picture are where others see past, or conversely."""
    count = len(cameras.pictures)
    if count == 1:
        return
    stride = max(1, int((pictures.depth[0].size / _CHECKED_POINTS) ** 0.5))
    contradicted, compared = np.zeros((2, count, count))
    heights = [_heights(pictures, k, pixel_mm, stride) for k in range(count)]
    for k in range(count):
        for other in range(count):
            contradicted[k, other] = np.count_nonzero(heights[k][other] < -1)
            agreed = np.count_nonzero(np.abs(heights[k][other]) <= 1)
            compared[k, other] = contradicted[k, other] + agreed
    pairs = (contradicted + contradicted.T) / np.maximum(compared + compared.T, 1)
    shares = pairs.sum(axis=1) / (count - 1)
    # Of two cameras the second one, as the display is framed by the first.
    worst = count - 1 - int(shares[::-1].argmax())
    if shares[worst] > _MAX_CONTRADICTION:
        past = np.concatenate([heights[worst].ravel(), *(h[worst].ravel() for h in heights)])
        past = -past[np.isfinite(past) & (past < -1)]
        error_mm = np.median(past) * _CONTRADICTION_PX * pixel_mm if past.size else np.inf
        raise FileError(
            f"{cameras.pictures[worst].name}: {shares[worst]:.0%} of its surface contradicts the "
            f"other cameras, by {error_mm:.3g} mm on the display in the median; correct its "
            "pose, intrinsics or depth unit, or leave it out"
        )


def _side_colours(
    walls: _Walls, sides: Sides, shape: tuple[int, int], pixel_mm: float
) -> tuple[np.ndarray, np.ndarray]:
    """Mean colours of the pixels that see each piece, float32, and if there are any."""
    pixel = sides.row.astype(np.int64) * shape[1] + sides.column
    first = np.searchsorted(pixel, np.arange(shape[0] * shape[1] + 1))
    pieces = _nearest_pieces(walls.points, pixel_mm, shape, first, sides.front_mm, sides.back_mm)
    sums, is_wall = np.zeros((len(pixel), walls.color.shape[1])), pieces >= 0
    np.add.at(sums, pieces[is_wall], walls.color[is_wall])
    counts = np.bincount(pieces[is_wall], minlength=len(pixel))
    return (sums / np.maximum(counts, 1)[:, None]).astype(np.float32), counts > 0


@compiled
def _point(pictures, k, i, j, d):
    """Point of a pixel at a depth."""
    w = d if pictures.is_pinhole[k] else 1.0
    m = pictures.matrix[k]
    return (
        m[0, 0] * j * w + m[0, 1] * i * w + m[0, 2] * d + m[0, 3],
        m[1, 0] * j * w + m[1, 1] * i * w + m[1, 2] * d + m[1, 3],
        m[2, 0] * j * w + m[2, 1] * i * w + m[2, 2] * d + m[2, 3],
    )


@compiled
def _points(pictures, pixels):
    """Points of pixels: camera, row and column."""
    points = np.empty(pixels.shape)
    for n in range(len(pixels)):
        k, i, j = pixels[n, 0], pixels[n, 1], pixels[n, 2]
        points[n] = _point(pictures, k, i, j, np.float64(pictures.depth[k, i, j]))
    return points


@compiled
def _is_one_surface(depth, other, limits):
    """True if two depths of a camera can belong to one surface."""
    return abs(depth - other) <= limits[0] + limits[1] * min(abs(depth), abs(other))


@compiled
def _neighbour(pictures, k, row, column, down, right, corner):
    """One of the four pixels around a place next to a pixel: its row, column and weight.

    The weight is 0 if it is not of the same surface.
    """
    r, c, weight = row, column, 1.0
    if corner >= 2:
        r, weight = row + (1 if down > 0 else -1), weight * abs(down)
    else:
        weight *= 1 - abs(down)
    if corner % 2:
        c, weight = column + (1 if right > 0 else -1), weight * abs(right)
    else:
        weight *= 1 - abs(right)
    depth = pictures.depth[k]
    if not (0 <= r < depth.shape[0] and 0 <= c < depth.shape[1]):
        return r, c, 0.0
    near, other = np.float64(depth[row, column]), np.float64(depth[r, c])
    if not (np.isfinite(other) and _is_one_surface(near, other, pictures.limits[k])):
        return r, c, 0.0
    return r, c, weight


@compiled
def _look(pictures, k, x, y, z):
    """Height of a camera's surface over a point, NaN if unknown; and the place in its picture."""
    m, depth = pictures.inverse[k], pictures.depth[k]
    j = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]
    i = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]
    d = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
    if pictures.is_pinhole[k]:
        if d <= 0:
            return np.nan, 0, 0, 0.0, 0.0
        i, j = i / d, j / d
    row, column = int(np.floor(i + 0.5)), int(np.floor(j + 0.5))
    down, right = i - row, j - column
    if not (0 <= row < depth.shape[0] and 0 <= column < depth.shape[1]):
        return np.nan, row, column, down, right
    if not np.isfinite(depth[row, column]):
        height = np.nan if np.isnan(depth[row, column]) else -np.inf
        return height, row, column, down, right
    total = surface = 0.0
    for corner in range(4):
        r, c, weight = _neighbour(pictures, k, row, column, down, right, corner)
        if weight > 0:
            surface += weight * np.float64(depth[r, c])
            total += weight
    m = pictures.matrix[k]
    z_per_depth = m[2, 2] + (m[2, 0] * j + m[2, 1] * i if pictures.is_pinhole[k] else 0.0)
    return (surface / total - d) * z_per_depth, row, column, down, right


@compiled
def _is_empty(pictures, x, y, z, past):
    """True if a camera sees past a point."""
    for k in range(len(pictures.depth)):  # noqa: SIM110
        if _look(pictures, k, x, y, z)[0] < -past:
            return True
    return False


@compiled
def _border(pictures, x, y, empty, full, past):
    """Depth between an empty and another point of a column where it ceases to be empty."""
    for _ in range(_HALVINGS):
        middle = 0.5 * (empty + full)
        if _is_empty(pictures, x, y, middle, past):
            empty = middle
        else:
            full = middle
    return full


@compiled
def _surface_at(pictures, x, y, z, same):
    """Surface at a point, from the camera with the finest resolution; NaN if none sees one."""
    finest, depth = -1.0, np.nan
    for k in range(len(pictures.depth)):
        height, row, column, _, _ = _look(pictures, k, x, y, z)
        if abs(height) <= same and pictures.resolution[k, row, column] > finest:
            finest, depth = pictures.resolution[k, row, column], z + height
    return depth


@compiled
def _is_on_surface(pictures, x, y, z, same):
    """True if a camera sees a surface at a point; on slopes, heights are larger."""
    for k in range(len(pictures.depth)):
        height, row, column, _, _ = _look(pictures, k, x, y, z)
        if np.isnan(height):  # the place may be outside the picture
            continue
        if abs(height) <= same * (1 + min(pictures.slope[k, row, column], MAX_SLOPE)):
            return True
    return False


@compiled
def _carve(begin, end, pictures, pixel, ends, step, front, back, is_closed):
    """Fronts of the solids of all columns, and backs where the columns are empty again."""
    layers, rows, columns = front.shape
    steps = int(np.ceil((ends[0] - ends[1]) / step))
    past, same = _PAST_PX * pixel, _SAME_PX * pixel
    for row in range(begin, end):
        y = (0.5 * (rows - 1) - row) * pixel
        for column in range(columns):
            x = (column - 0.5 * (columns - 1)) * pixel
            layer, is_solid, was_empty, previous = -1, False, True, ends[0]
            for n in range(steps + 1):
                z = max(ends[0] - n * step, ends[1])
                is_empty = _is_empty(pictures, x, y, z, past)
                if was_empty and not is_empty:
                    border = _border(pictures, x, y, previous, z, past)
                    surface = _surface_at(pictures, x, y, border, same)
                    is_solid = not np.isnan(surface)
                    if is_solid:
                        layer += 1
                        if layer == layers:
                            break
                        above = back[layer - 1, row, column] if layer else np.float32(np.inf)
                        front[layer, row, column] = min(np.float32(surface), above)
                        back[layer, row, column] = ends[1]
                elif is_empty and not was_empty and is_solid:
                    border = np.float32(_border(pictures, x, y, z, previous, past))
                    back[layer, row, column] = min(border, front[layer, row, column])
                    is_closed[layer, row, column] = _is_on_surface(pictures, x, y, border, same)
                was_empty, previous = is_empty, z


@compiled
def _step(pictures, k, i, j, down, right):
    """Step on a surface by one pixel of its picture, and if the surface ends next to it.

    The mean of the steps to both neighbours on the surface. Without one, the smaller jump, as on a
    wall that the camera grazes; without any depth, a step at equal depth.
    """
    depth = pictures.depth[k]
    rows, columns = depth.shape
    here = np.float64(depth[i, j])
    first, last, jump, is_end = (0, here), (0, here), (1, here), False
    smallest = np.inf
    for side in (-1, 1):
        r, c = i + side * down, j + side * right
        if not (0 <= r < rows and 0 <= c < columns):
            continue
        other = np.float64(depth[r, c])
        if np.isfinite(other) and _is_one_surface(here, other, pictures.limits[k]):
            if side < 0:
                first = side, other
            else:
                last = side, other
        else:
            is_end = True
            if abs(other - here) < smallest:
                smallest, jump = abs(other - here), (side, other)
    if first[0] == last[0]:
        last = jump
    pixels = last[0] - first[0]
    x, y, z = _point(pictures, k, i + first[0] * down, j + first[0] * right, first[1])
    u, v, w = _point(pictures, k, i + last[0] * down, j + last[0] * right, last[1])
    return ((u - x) / pixels, (v - y) / pixels, (w - z) / pixels), is_end


@compiled
def _describe_surfaces(begin, end, pictures, resolution, slope):
    """Resolution and slope of the pictures' surfaces, from the differences of neighbours."""
    _, rows, columns = pictures.depth.shape
    for index in range(begin, end):
        k, i = divmod(index, rows)
        for j in range(columns):
            if not np.isfinite(pictures.depth[k, i, j]):
                continue
            a, ends_down = _step(pictures, k, i, j, 1, 0)
            b, ends_right = _step(pictures, k, i, j, 0, 1)
            normal_x, normal_y = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2]
            normal_z = a[0] * b[1] - a[1] * b[0]
            across = np.hypot(normal_x, normal_y)
            weight = _EDGE_WEIGHT if ends_down or ends_right else 1.0
            resolution[k, i, j] = weight / max(np.hypot(across, normal_z), 1e-9)
            slope[k, i, j] = across / max(abs(normal_z), 1e-9)


@compiled
def _heights(pictures, k, pixel, stride):
    """Heights of other pictures over one's surface, in units of a contradiction.

    (cameras, H, W), NaN where unknown. A camera that sees past a point sees past its neighbours,
    too, unless the point is at a silhouette, where pictures of pixels differ.
    """
    _, rows, columns = pictures.depth.shape
    heights = np.full((len(pictures.depth), rows, columns), np.nan)
    for i in range(0, rows, stride):
        for j in range(0, columns, stride):
            if not np.isfinite(pictures.depth[k, i, j]):
                continue
            x, y, z = _point(pictures, k, i, j, np.float64(pictures.depth[k, i, j]))
            unit = _CONTRADICTION_PX * pixel * (1 + pictures.slope[k, i, j])
            for other in range(len(pictures.depth)):
                if other != k:
                    height = _look(pictures, other, x, y, z)[0]
                    for side in range(4 if height < -unit else 0):
                        right, up = _BESIDE[side]
                        beside = _look(pictures, other, x + right * pixel, y + up * pixel, z)[0]
                        height = max(height, beside)
                    heights[other, i, j] = height / unit
    return heights


@compiled
def _add_colour(pictures, k, row, column, down, right, weight, sums):
    """Add the interpolated colour at a place of a picture to sums of colours."""
    total = 0.0
    for corner in range(4):
        total += _neighbour(pictures, k, row, column, down, right, corner)[2]
    for corner in range(4):
        r, c, share = _neighbour(pictures, k, row, column, down, right, corner)
        if share > 0:
            for channel in range(len(sums)):
                sums[channel] += weight * share / total * pictures.color[k, r, c, channel]


@compiled
def _colour(begin, end, pictures, pixel, front, color):
    """Colours of fronts."""
    layers, rows, columns = front.shape
    cameras, channels = len(pictures.depth), pictures.color.shape[3]
    same = _SAME_PX * pixel
    for row in range(begin, end):
        heights, places = np.empty(cameras), np.empty((cameras, 2), np.int64)
        offsets = np.empty((cameras, 2))
        y = (0.5 * (rows - 1) - row) * pixel
        for column in range(columns):
            x = (column - 0.5 * (columns - 1)) * pixel
            for layer in range(layers):
                z = np.float64(front[layer, row, column])
                if z == -np.inf:
                    break
                nearest = np.inf
                for k in range(cameras):
                    height, r, c, down, right = _look(pictures, k, x, y, z)
                    heights[k] = abs(height)
                    places[k] = r, c
                    offsets[k] = down, right
                    nearest = heights[k] if heights[k] < nearest else nearest
                reach = max(nearest, same)
                sums, total = np.zeros(channels), 0.0
                for k in range(cameras):
                    if heights[k] <= reach:
                        r, c = places[k, 0], places[k, 1]
                        down, right = offsets[k, 0], offsets[k, 1]
                        weight = np.float64(pictures.resolution[k, r, c])
                        _add_colour(pictures, k, r, c, down, right, weight, sums)
                        total += weight
                for channel in range(channels):
                    color[layer, row, column, channel] = sums[channel] / max(total, 1e-30)


@compiled
def _nearest_pieces(points, pixel, shape, first, front, back):
    """Piece of a side in the column of each point, or in the nearest one next to it; -1 for none.

    The pieces of pixel p are ``first[p]`` to ``first[p + 1] - 1``.
    """
    rows, columns = shape
    pieces = np.full(len(points), -1)
    for index in range(len(points)):
        x, y, z = points[index, 0], points[index, 1], points[index, 2]
        u, v = x / pixel + 0.5 * columns, 0.5 * rows - y / pixel
        row, column = int(np.floor(v)), int(np.floor(u))
        nearest = 1.0
        for r in range(max(row - 1, 0), min(row + 2, rows)):
            for c in range(max(column - 1, 0), min(column + 2, columns)):
                distance = max(abs(r + 0.5 - v), abs(c + 0.5 - u)) - 0.5
                if distance >= nearest:
                    continue
                for n in range(first[r * columns + c], first[r * columns + c + 1]):
                    if back[n] <= z <= front[n]:
                        nearest, pieces[index] = distance, n
    return pieces


@compiled
def _mark_walls(points, pixel, ends, shape):
    """Bins of depth in which cameras see walls in a column or next to it, as bits."""
    rows, columns = shape
    walls = np.zeros(shape, np.uint64)
    bin_mm = (ends[0] - ends[1]) / _BINS
    for index in range(len(points)):
        x, y, z = points[index, 0], points[index, 1], points[index, 2]
        number = int(np.floor((z - ends[1]) / bin_mm))
        if not 0 <= number < _BINS:
            continue
        row = int(np.floor(0.5 * rows - y / pixel))
        column = int(np.floor(x / pixel + 0.5 * columns))
        for r in range(max(row - 1, 0), min(row + 2, rows)):
            for c in range(max(column - 1, 0), min(column + 2, columns)):
                walls[r, c] |= np.uint64(1) << np.uint64(number)
    return walls


@compiled
def _end_solids(front, thin, walls, ends, thickness, back):
    """Raise the backs of solids to where a single picture's columns end, or the last wall."""
    bin_mm = (ends[0] - ends[1]) / _BINS
    for k in range(front.shape[0]):
        for r in range(front.shape[1]):
            for c in range(front.shape[2]):
                if front[k, r, c] == -np.inf:
                    continue
                end = np.float64(thin[k, r, c])
                number = min(int((end - ends[1]) / bin_mm), _BINS - 1)
                while number >= 0 and end - (ends[1] + number * bin_mm) <= thickness:
                    if walls[r, c] & (np.uint64(1) << np.uint64(number)):
                        end = ends[1] + number * bin_mm
                    number -= 1
                back[k, r, c] = max(back[k, r, c], min(np.float32(end), front[k, r, c]))
