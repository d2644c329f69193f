# Kernels have no types of their own.
# mypy: disable-error-code="no-untyped-def, no-untyped-call"
"""Kernels of `inim.apps.own_picture.tiles`: places of samples, and cells that their tiles cover.

Bands of rows of samples are drawn separately, each into a window of cells. Of the tiles of all
windows that cover a cell, the nearest counts, and of equally near ones the first. So results do not
depend on the number of threads.
"""

import numpy as np

from inim.system.backend.kernels import compiled

# Tolerance for cell centres on a border of two tiles: both cover them despite rounding.
_ON_BORDER = 1e-9


@compiled(inline="always")
def _clip(q, frame):
    """Clip to the range; NaN stays NaN."""
    return frame.q_low if q < frame.q_low else frame.q_high if q > frame.q_high else q


@compiled(inline="always")
def _is_one_surface(a, b, frame):
    return abs(a - b) <= frame.tolerance + frame.tolerance_share * min(a, b)


@compiled(inline="always")
def _unclipped_depth(q, frame):
    return frame.offset_mm + (frame.slope / q if frame.over_q else frame.slope * q)


@compiled(inline="always")
def _display_depth(q, frame):
    return min(max(_unclipped_depth(q, frame), frame.low_mm), frame.high_mm)


@compiled(inline="always")
def _is_out_of_range(q, frame):
    """True if a sample is out of range by more than rounding."""
    z = _unclipped_depth(q, frame)
    z_tolerance = 1e-6 * (frame.high_mm - frame.low_mm)
    q_tolerance = 1e-6 * (abs(frame.q_low) + abs(frame.q_high))
    z_is_out = z < frame.low_mm - z_tolerance or z > frame.high_mm + z_tolerance
    return z_is_out or q < frame.q_low - q_tolerance or q > frame.q_high + q_tolerance


@compiled(inline="always")
def _column(j, w, frame, width):
    return (frame.ax * (j - frame.cx) * w + frame.ox) / frame.cell_mm + 0.5 * width


@compiled(inline="always")
def _row(i, w, frame, height):
    return (frame.ay * (i - frame.cy) * w - frame.oy) / frame.cell_mm + 0.5 * height


@compiled
def _own_corner(q, i, j, di, dj, frame, shape, around):
    """Column, row and display depth of the corner (i + di/2, j + dj/2) of the surface of (i, j).

    `around` (4,) receives the four samples there.
    """
    rows, columns = q.shape
    top, left = i + min(di, 0), j + min(dj, 0)
    for k in range(4):
        row, column = top + k // 2, left + k % 2
        is_inside = 0 <= row < rows and 0 <= column < columns
        around[k] = _clip(np.float64(q[row, column]), frame) if is_inside else np.nan
    own = 2 * (di < 0) + (dj < 0)
    horizontal, vertical, diagonal = own ^ 1, own ^ 2, own ^ 3
    has_horizontal = _is_one_surface(around[own], around[horizontal], frame)
    has_vertical = _is_one_surface(around[own], around[vertical], frame)
    joins_horizontal = _is_one_surface(around[diagonal], around[horizontal], frame)
    joins_vertical = _is_one_surface(around[diagonal], around[vertical], frame)
    has_diagonal = (has_horizontal and joins_horizontal) or (has_vertical and joins_vertical)
    has_horizontal = has_horizontal or (has_diagonal and joins_horizontal)
    has_vertical = has_vertical or (has_diagonal and joins_vertical)
    total, count = 0.0, 0
    for k in range(4):  # in row-major order, so that all tiles at a corner compute identical bits
        if (
            k == own
            or (k == horizontal and has_horizontal)
            or (k == vertical and has_vertical)
            or (k == diagonal and has_diagonal)
        ):
            total, count = total + around[k], count + 1
    mean = total / count
    w = 1.0 / mean if frame.perspective else 1.0
    u, v = _column(j + 0.5 * dj, w, frame, shape[1]), _row(i + 0.5 * di, w, frame, shape[0])
    return u, v, _display_depth(mean, frame)


@compiled(error_model="numpy")
def place(begin, end, q, frame, shape, cells, ends, clipped):
    """Fill some rows of `Places`."""
    height, width = shape
    for i in range(begin, end):
        least, most, out_of_range = np.inf, -np.inf, 0
        line, of_samples = q[i], cells[i]
        for j in range(len(line)):
            value = np.float64(line[j])
            is_out = _is_out_of_range(value, frame)
            out_of_range += 1 if is_out else 0
            w = 1.0 / _clip(value, frame) if frame.perspective else 1.0
            u, v = _column(j, w, frame, width), _row(i, w, frame, height)
            inside = (u >= 0) & (u < width) & (v >= 0) & (v < height) & ~np.isnan(value)
            inside &= not (frame.drop and is_out)
            of_samples[j] = np.int32(v) * np.int32(width) + np.int32(u) if inside else np.int32(-1)
        for j in range(len(line)):  # separately, so that the loop above is vectorised
            centre = _clip(np.float64(line[j]), frame)
            least = centre if centre < least else least
            most = centre if centre > most else most
        ends[i, 0], ends[i, 1], clipped[i] = least, most, out_of_range


@compiled
def draw_bands(begin, end, q, frame, shape, windows):
    """Draw the tiles of some bands of samples into their windows."""
    columns, around = q.shape[1], np.empty(4)
    above, below = np.empty((3, columns + 1)), np.empty((3, columns + 1))
    for band in range(begin, end):
        own = slice(windows.start[band], windows.start[band + 1])
        depth, owner, top = windows.depth[own], windows.owner[own], windows.top[band]
        if not len(depth):
            continue
        depth[:] = -np.inf
        first = windows.first[band]
        _place_corners(first, q, frame, shape, above)
        for i in range(first, windows.first[band + 1]):
            _place_corners(i + 1, q, frame, shape, below)
            _draw_row(i, top, q, frame, shape, above, below, around, depth, owner)
            above, below = below, above


@compiled(error_model="numpy")
def _place_corners(i, q, frame, shape, corners):
    """Find the places of the corners above row i of the samples.

    * `corners`, (3, W + 1): column, row and display depth of each corner whose four samples are one
      surface; column and row NaN elsewhere.
    """
    (height, width), (u, v, z) = shape, (corners[0], corners[1], corners[2])
    u[0] = u[-1] = v[0] = v[-1] = np.nan
    if i == 0 or i == len(q):
        u[:], v[:] = np.nan, np.nan
        return
    above, below = q[i - 1], q[i]
    for j in range(len(above) - 1):
        a, b = _clip(np.float64(above[j]), frame), _clip(np.float64(above[j + 1]), frame)
        c, d = _clip(np.float64(below[j]), frame), _clip(np.float64(below[j + 1]), frame)
        across = np.int64(_is_one_surface(a, b, frame)) + np.int64(_is_one_surface(c, d, frame))
        down = np.int64(_is_one_surface(a, c, frame)) + np.int64(_is_one_surface(b, d, frame))
        is_shared = across + down > 2  # all four are connected
        mean = (a + b + c + d) / 4
        w = 1.0 / mean if frame.perspective else 1.0
        u[j + 1] = _column(j + 0.5, w, frame, width) if is_shared else np.nan
        v[j + 1] = _row(i - 0.5, w, frame, height) if is_shared else np.nan
        z[j + 1] = _display_depth(mean, frame)


@compiled
def _draw_row(i, begin, q, frame, shape, above, below, around, depth, owner):
    """Draw the tiles of a row of samples into the rows of cells from `begin` on."""
    samples, end = q[i], begin + len(depth)
    u0, v0, z0, u1, v1, z1 = above[0], above[1], above[2], below[0], below[1], below[2]
    for n in range(len(samples)):
        j = np.uintp(n)
        k = j + np.uintp(1)
        if (v0[j] <= begin) & (v0[k] <= begin) & (v1[k] <= begin) & (v1[j] <= begin):
            continue
        if (v0[j] >= end) & (v0[k] >= end) & (v1[k] >= end) & (v1[j] >= end):
            continue
        value = np.float64(samples[j])
        if np.isnan(value) or (frame.drop and _is_out_of_range(value, frame)):
            continue
        a, b = (u0[j], v0[j], z0[j]), (u0[k], v0[k], z0[k])
        c, d = (u1[k], v1[k], z1[k]), (u1[j], v1[j], z1[j])
        if np.isnan(a[0] + b[0] + c[0] + d[0]):
            a = a if a[0] == a[0] else _own_corner(q, i, n, -1, -1, frame, shape, around)
            b = b if b[0] == b[0] else _own_corner(q, i, n, -1, 1, frame, shape, around)
            c = c if c[0] == c[0] else _own_corner(q, i, n, 1, 1, frame, shape, around)
            d = d if d[0] == d[0] else _own_corner(q, i, n, 1, -1, frame, shape, around)
        left, right = min(a[0], b[0], c[0], d[0]), max(a[0], b[0], c[0], d[0])
        top, bottom = min(a[1], b[1], c[1], d[1]), max(a[1], b[1], c[1], d[1])
        box = _first(left), _last(right), _first(top), _last(bottom)
        # Most tiles of a fine picture cover no centre of a cell.
        if box[0] <= box[1] and box[2] <= box[3]:
            _fill(a, b, c, d, box, i * len(samples) + n, begin, depth, owner)


@compiled(inline="always")
def _first(least):
    """First cell whose centre is not below a place."""
    return np.ceil(least - 0.5 - _ON_BORDER)


@compiled(inline="always")
def _last(most):
    """Last cell whose centre is not above a place."""
    return np.floor(most - 0.5 + _ON_BORDER)


@compiled(error_model="numpy")
def _fill(a, b, c, d, box, number, begin, depth, owner):
    """Draw a tile into the cells whose centres it covers and where it is the nearest."""
    left, right, top, bottom = box
    area_c = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
    area_d = (c[0] - a[0]) * (d[1] - a[1]) - (d[0] - a[0]) * (c[1] - a[1])
    rows, width = depth.shape
    left, right = max(left, 0.0), min(right, width - 1.0)
    top, bottom = max(top, float(begin)), min(bottom, begin + rows - 1.0)
    if left > right or top > bottom:
        return
    for row in range(int(top), int(bottom) + 1):
        for column in range(int(left), int(right) + 1):
            x, y = column + 0.5, row + 0.5
            z = max(_plane(a, b, c, area_c, x, y), _plane(a, c, d, area_d, x, y))
            if z > depth[row - begin, column]:
                depth[row - begin, column] = z
                owner[row - begin, column] = number


@compiled(inline="always")
def _plane(a, b, c, area, x, y):
    """Depth of a triangle at a place; -inf outside it."""
    wa = ((b[0] - x) * (c[1] - y) - (c[0] - x) * (b[1] - y)) / area
    wb = ((c[0] - x) * (a[1] - y) - (a[0] - x) * (c[1] - y)) / area
    wc = 1.0 - wa - wb
    inside = area != 0 and min(wa, wb, wc) >= -_ON_BORDER
    return wa * a[2] + wb * b[2] + wc * c[2] if inside else -np.inf


@compiled
def write_cells(
    begin, end, q, color, light, codes, frame, same_mm, sample_cells, windows, out, z_mm, covered
):
    """Write some rows of cells: the nearest tiles of all windows, and their colours."""
    width = z_mm.shape[1]
    depth = np.full((end - begin, width), -np.inf)
    owner = np.empty((end - begin, width), np.int32)
    sums = np.zeros((end - begin, width, 3))
    counts = np.zeros((end - begin, width), np.int32)
    for band in range(len(windows.top)):
        top, start = windows.top[band], windows.start[band]
        for row in range(max(begin, top), min(end, top + windows.start[band + 1] - start)):
            z, number = windows.depth[start + row - top], windows.owner[start + row - top]
            nearest, of = depth[row - begin], owner[row - begin]
            for column in range(width):
                is_nearer = z[column] > nearest[column]
                of[column] = number[column] if is_nearer else of[column]
                nearest[column] = z[column] if is_nearer else nearest[column]
    flat_depth, flat_sums, flat_counts = depth.ravel(), sums.reshape(-1, 3), counts.ravel()
    first_cell, cells = np.int32(begin * width), np.uintp(depth.size)
    for band in range(len(windows.top)):
        top = windows.top[band]
        if top >= end or top + windows.start[band + 1] - windows.start[band] <= begin:
            continue
        for i in range(windows.first[band], windows.first[band + 1]):
            for j in range(q.shape[1]):
                cell = np.uintp(np.uint32(sample_cells[i, j] - first_cell))
                if cell >= cells:
                    continue
                centre = _clip(np.float64(q[i, j]), frame)
                if abs(_display_depth(centre, frame) - flat_depth[cell]) <= same_mm:
                    for k in range(3):
                        flat_sums[cell, k] += _linear(color, light, i, j, k)
                    flat_counts[cell] += 1
    for row in range(end - begin):
        line, z, has_tile = out[begin + row], z_mm[begin + row], covered[begin + row]
        for column in range(width):
            if depth[row, column] == -np.inf:
                continue
            count = counts[row, column]
            if count > 0:
                for k in range(3):
                    line[column, k] = _shown(np.float32(sums[row, column, k] / count), codes)
            else:
                i, j = divmod(owner[row, column], q.shape[1])
                for k in range(3):
                    line[column, k] = _shown(_linear(color, light, i, j, k), codes)
            if codes is not None:
                line[column, 3] = 255
            z[column], has_tile[column] = depth[row, column], True


@compiled(inline="always")
def _linear(color, light, i, j, k):
    """Linear light of a sample's colour, which is a code if there is a table of their light."""
    if light is None:
        return color[i, j, k]
    return light[color[i, j, k]]


@compiled(inline="always")
def _shown(light, codes):
    """Light, or its code if there is a table of codes."""
    if codes is None:
        return light
    return codes[int(min(max(light, np.float32(0)), np.float32(1)) * (len(codes) - 1) + 0.5)]
