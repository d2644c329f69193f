"""Displays, layouts, pixels and viewpoints, against closed forms and brute force."""

import math
from collections.abc import Iterator
from fractions import Fraction

import numpy as np

from inim.apps.stress.oracles.rays import panel_places, panel_rays
from inim.apps.stress.pictures import displays, scaled, small_display
from inim.apps.stress.relation import EPS, Deviation, difference, excess, is_true, relation
from inim.display import DISPLAYS, Display
from inim.display.cells import CELL_PATTERNS, cell_centres, kinds_of_pixels
from inim.display.layers import air_equivalent_mm, excess_mm
from inim.display.lens import channel_indices, trace_to_panel
from inim.display.misalignment import misaligned, one_pixel_errors
from inim.display.panel import emitted_light, emitted_picture, seen_light, white_of
from inim.display.pixels import (
    CENTRE,
    SUBPIXELS,
    PixelOffset,
    emission_profile,
    exact_length,
    exact_ratio,
    panel_points,
    pixel_rays,
    row_blocks,
)
from inim.display.viewpoint import (
    DEFAULT_VIEWPOINTS,
    Viewpoint,
    check_viewpoint,
    default_distance_mm,
    focus_distance_mm,
    parse_viewpoints,
    zone_eyes,
)
from inim.system.errors import ViewpointError

_ROUNDING = "a few roundings of float64 at the largest coordinate"
_OFFSET = PixelOffset(Fraction(1, 4), Fraction(-1, 3))


def rays_of(display: Display, offset: PixelOffset = CENTRE) -> list[np.ndarray]:
    """Lens, x0, y0, slopes and gap of all pixels, (rows, columns) each."""
    blocks = [pixel_rays(display, rows, offset) for rows in row_blocks(display)]
    names = ("lens", "x0", "y0", "slope_x", "slope_y", "gap_mm")
    return [
        np.concatenate([np.broadcast_to(getattr(b, n), b.lens.shape) for b in blocks])
        for n in names
    ]


def offsets_of(display: Display) -> list[PixelOffset]:
    """Centre, a point beside it, and the centres of sub-pixels."""
    subpixels = [PixelOffset(Fraction(0), s.right, s.channel) for s in SUBPIXELS[display.subpixels]]
    return list(dict.fromkeys([CENTRE, _OFFSET, *subpixels]))


@relation(
    "rays of pixels", covers="display.pixels display.layouts display.cells display.display",
    limit=64, unit="ulp of half the panel's diagonal", source=_ROUNDING,
)  # fmt: skip
def _rays(_: str, effort: int) -> Iterator[Deviation]:
    """Each pixel has the nearest lens and its ray, found among all lenses in 64-bit mantissas."""
    for name, display in displays():
        pixels = np.argwhere(np.ones(display.eia_shape, bool))[:: 5 - effort]
        for offset in offsets_of(display):
            expected = panel_rays(display, pixels, offset)
            actual = [table[tuple(pixels.T)] for table in rays_of(display, offset)]
            half = math.hypot(*display.eia_shape) * display.pixel_pitch_mm / 2 + display.pitch_mm
            certain = expected.margin > 64 * EPS * half
            lens, *values = (table[certain] for table in actual)
            true_lens, *true_values = (np.asarray(table)[certain] for table in expected[:6])
            if display.layout.of_cylinders:  # numbers count from an arbitrary cylinder
                lens, true_lens = lens - lens.min(), true_lens - true_lens.min()
            yield difference(f"{name}: lens at {offset}", lens, true_lens, 1e-9)
            units = (half, half, half / display.gap_mm, half / display.gap_mm, half)
            for value, true_value, unit in zip(values, true_values, units, strict=True):
                yield difference(f"{name}: {offset}", value, true_value, EPS * unit)


@relation(
    "rows and columns", covers="display.pixels display.layouts.layout display.layouts.square",
    limit=1, unit="ulp", source="one rounded division of whole numbers",
)  # fmt: skip
def _axes(_: str, effort: int) -> Iterator[Deviation]:
    """Rows and columns of separable displays are those of fractions, also at borders of lenses."""
    cases = [*displays(separable=True)]
    for per_lens, lenses, shift in ((1.5, 3, 0.0), (2.5, 4, 0.4), (3, 4, 0.5), (2, 3, 0.25)):
        changes = {"pixel_pitch_mm": 1 / per_lens, "lens_columns": lenses, "shift_x_mm": shift}
        cases.append((f"{per_lens} pixels per lens", small_display(**changes, lens_rows=lenses)))
    for name, display in cases:
        for axis, sign, count, lenses, pitch, shift in (
            (display.columns, 1, display.eia_shape[1], display.lens_columns, display.pitch_mm,
             display.shift_x_mm),
            (display.rows, -1, display.eia_shape[0], display.lens_rows, display.row_pitch_mm,
             display.shift_y_mm),
        ):  # fmt: skip
            pixel, exact_pitch = (Fraction(str(v)).limit_denominator(10**5)
                                  for v in (display.pixel_pitch_mm, pitch))  # fmt: skip
            wider = Fraction(str(display.elemental_image_pitch_mm)) / Fraction(
                str(display.pitch_mm)
            )
            gap, moved = Fraction(str(display.gap_mm)), sign * Fraction(str(shift))
            lens, centre, slope, place = [], [], [], []
            for i in range(count):
                x = Fraction(2 * i + 1 - count, 2) * pixel
                at = (x - moved) / (exact_pitch * wider)
                number = at + Fraction(lenses, 2)
                own = math.ceil(number) - 1 if at >= 0 else math.floor(number)
                x0 = Fraction(2 * own + 1 - lenses, 2) * exact_pitch + moved
                lens.append(own if 0 <= own < lenses else -1)
                centre.append(float(sign * x0))
                slope.append(float(sign * (x0 - x) / gap))
                place.append(float(sign * x))
            yield difference(f"{name}: lenses", axis.lens, lens, 1e-9)
            for actual, expected in (
                (axis.centre_mm, centre), (axis.slope, slope), (axis.position_mm, place)
            ):  # fmt: skip
                unit = np.maximum(np.spacing(np.abs(expected)), 1e-300)
                yield difference(name, actual, expected, unit)
            first, end = axis.elemental_images()
            own_pixels = [np.flatnonzero(np.array(lens) == n) for n in range(lenses)]
            sizes = [len(p) for p in own_pixels]
            yield difference(f"{name}: sizes of elemental images", end - first, sizes, 1e-9)
            yield is_true(
                f"{name}: first pixels",
                [not len(p) or p[0] == f for p, f in zip(own_pixels, first, strict=True)],
            )
            exact = [float(o * axis.unit_mm / 4) for o in axis.moved_offset(Fraction(1, 4))]
            step = sign * display.pixel_pitch_mm / 4
            there = axis.centre_mm - axis.position_mm - step
            yield difference(f"{name}: moved", exact, there, 8 * np.finfo(float).eps * count)


@relation(
    "lengths of a display", covers="display.display display.pixels display.layouts",
    limit=0, unit="nearest floats", source="one rounding of a fraction",
)  # fmt: skip
def _lengths(_: str, effort: int) -> Iterator[Deviation]:
    """Depths and sizes follow from their formulas in fractions, rounded once."""
    random = np.random.default_rng(1)
    usual = (900, 6000), (2000, 6000), (1500, 7000), (30, 300)
    deep = (900, 6000), (2000, 6000), (1500, 60000), (30, 300)
    # The central plane is within two pitches, and large pixels let the formula cross the array.
    near = (4000, 6000), (1000, 1300), (1460, 1700), (500, 900)
    for number in range(21 * effort):
        pitch, f, gap, pixel = (
            Fraction(int(random.integers(*ends)), 1000) for ends in (usual, deep, near)[number % 3]
        )
        columns, rows = (int(n) for n in random.integers(1, 90, 2))
        if f == gap:
            continue
        display = Display(*map(float, (pitch, f, gap, pixel)), columns, rows)
        depth = f * gap / (gap - f)
        image = abs(depth) * pixel / gap
        half = abs(depth) * image / pitch
        clear = min(pitch, abs(depth) / 2)
        low, high = depth - half, depth + half
        low, high = (max(low, clear), high) if depth > 0 else (low, min(high, -clear))
        expected = (depth, image, 2 * half, low, high, columns * pitch, rows * pitch)
        actual = (
            display.central_depth_mm, display.scene_pixel_mm, display.depth_span_mm,
            *display.depth_range_mm, display.width_mm, display.height_mm,
        )  # fmt: skip
        yield difference(f"display {number}", actual[:5], [float(v) for v in expected[:5]])
        sizes = [float(v) for v in expected[5:]]
        yield is_true(f"display {number}: size", np.abs(np.subtract(actual[5:], sizes)) < 1e-12)
        shape = math.ceil(rows * pitch / pixel), math.ceil(columns * pitch / pixel)
        yield difference(f"display {number}: panel", display.eia_shape, shape)
        is_cut = abs(depth) - half < clear
        yield difference(f"display {number}: cut", display.depth_range_is_cut, is_cut)
        half_angle = math.degrees(math.atan2(float(pitch), 2 * float(gap)))
        yield is_true("half angle", abs(display.viewing_half_angle_deg - half_angle) < 1e-12)
        # A picture covers the array and the reach of its outermost rays, in whole pixels.
        reach = max(abs(low), abs(high)) * pitch / (2 * gap)
        for per_pitch in (1, 3, 5):
            pads = [
                2
                * math.ceil(
                    (n * pitch / 2 + reach) * per_pitch / pitch - Fraction(n * per_pitch, 2)
                )
                for n in (rows, columns)
            ]
            covered = rows * per_pitch + pads[0], columns * per_pitch + pads[1]
            yield difference(f"picture of {number}", display.capture_shape(per_pitch), covered)
            side = float(pitch / per_pitch)
            yield difference("its pixel", display.capture_pixel_mm(per_pitch), side)
    aimed = small_display(elemental_pitch_mm=1.25)
    half_angle = math.degrees(math.atan(1.25 / 6.6))
    yield is_true("aimed half angle", abs(aimed.viewing_half_angle_deg - half_angle) < 1e-12)
    row = math.sqrt(3) / 2
    for rows in (1, 2, 3, 4):
        hexagonal = small_display(lattice="hexagonal", lens_columns=5, lens_rows=rows)
        actual = (hexagonal.width_mm, hexagonal.height_mm, hexagonal.row_pitch_mm)
        size = 5 + 0.5 * (rows > 1), rows * row, row
        yield is_true(f"hexagonal, {rows} rows", np.abs(np.subtract(actual, size)) < 1e-12)


@relation(
    "simple fractions", covers="display.pixels", limit=0, unit="fractions",
    source="denominators up to a million within 8 ulp",
)  # fmt: skip
def _fractions(_: str, effort: int) -> Iterator[Deviation]:
    """The fraction that a person wrote is recovered from its float, also after divisions."""
    random = np.random.default_rng(2)
    for _ in range(100 * effort):
        top, below = (int(n) for n in random.integers(1, 4000, 2))
        fraction = Fraction(top, below)
        yield is_true(f"{fraction}", exact_length(float(fraction)) == fraction)
        scale = float(random.uniform(0.1, 7))
        ratio = (top * scale) / (below * scale)
        yield is_true(f"{fraction} as a ratio", exact_ratio(ratio) == fraction)
        power = Fraction(2) ** int(random.integers(-40, 40))
        yield is_true("in another unit", exact_length(float(fraction * power)) == fraction * power)
    for length, unit in ((0.3 / 3, 0.3), (1.7 / 5, 1.7)):
        display = small_display(pitch_mm=unit, pixel_pitch_mm=length, panel_rows=4)
        whole = round(unit / length)
        yield is_true("a third", display.exact_mm(length) * whole == exact_length(unit))
        yield difference("pixels per lens", display.pixels_per_lens, whole)


@relation(
    "scaled displays", covers="display.display display.pixels display.layouts display.cells",
    limit=0, unit="bits", source="powers of two change no mantissa; counts have no unit",
)  # fmt: skip
def _scale(_: str, effort: int) -> Iterator[Deviation]:
    """All lengths times 2^k scale rays bit for bit; other factors change no count."""
    for name, display in displays():
        rays = rays_of(display)
        for power in (-9, 12)[:effort]:
            other = rays_of(scaled(display, 2.0**power))
            for which, (a, b) in enumerate(zip(rays, other, strict=True)):
                factor = 1.0 if which in (0, 3, 4) else 2.0**power
                yield difference(f"{name} x 2^{power}", b, a * factor)
        for factor in (3.0, 0.7, 25.4):
            other_display = scaled(display, factor)
            case = f"{name} x {factor:g}"
            yield difference(case, other_display.eia_shape, display.eia_shape)
            yield difference(case, other_display.capture_shape(3), display.capture_shape(3))
            yield difference(case, other_display.layout.grid, display.layout.grid)
            yield difference(case, other_display.view_shape(4), display.view_shape(4))


@relation(
    "bounds of rays", covers="display.layouts display.pixels display.display", limit=1e-9,
    unit="mm outside", source=_ROUNDING,
)  # fmt: skip
def _bounds(_: str, effort: int) -> Iterator[Deviation]:
    """Declared slopes, crossings and extents bound all rays, and the picture contains them."""
    wide = {"lens_columns": 40, "lens_rows": 2}
    ranges = {"before": (6.0, 12.0), "behind": (-12.0, -6.0), "on both sides": (-9.0, 7.0)}
    aims = [
        (f"images of {cell:g}, {name}", small_display(
            **wide, elemental_pitch_mm=cell, depth_min_mm=low, depth_max_mm=high))
        for cell in (0.97, 1.03)
        for name, (low, high) in ranges.items()
    ]  # fmt: skip
    cells = small_display(subpixels="cells", subpixel_cells="0.1 0.9 0.7 -0.8 0 0.6")
    aims.append(("far cells", cells))
    for name, display in (*displays(), *aims):
        steep, far = display.steepest_slopes, display.layout.farthest_crossings_mm
        half = display.half_extent_mm
        # On borders of lenses, rows and columns decide, not `pixel_rays`.
        has_lens = rays_of(display)[0] >= (-np.inf if display.layout.of_cylinders else 0)
        lensed = display.lensed & has_lens
        if not display.is_separable:
            yield is_true(f"{name}: lenses", display.lensed == has_lens, has_lens.size)
        high, wide = display.capture_shape(4)
        pixel = display.capture_pixel_mm(4)
        for offset in offsets_of(display):
            if offset == _OFFSET:
                continue
            _, x0, y0, slope_x, slope_y, gap = (t[lensed] for t in rays_of(display, offset))
            for slope, bound, crossing in zip((slope_x, slope_y), steep, far, strict=True):
                yield excess(f"{name}: slopes", np.abs(slope), bound)
                yield excess(f"{name}: crossings", np.abs(slope * gap), crossing)
            if display.layout.of_cylinders:
                continue
            yield excess(f"{name}: extent", np.abs(x0), half[0])
            yield excess(f"{name}: extent", np.abs(y0), half[1])
            for z in display.depth_range_mm:
                yield excess(f"{name}: width", np.abs(x0 + slope_x * z), wide * pixel / 2)
                yield excess(f"{name}: height", np.abs(y0 + slope_y * z), high * pixel / 2)
    square = small_display(lens_columns=6, lens_rows=4)
    widest = square.pitch_mm / (2 * square.gap_mm)
    yield is_true("tight on squares", np.abs(np.subtract(square.steepest_slopes, widest)) < 1e-12)


def _parts(place: complex) -> tuple[float, float]:
    return place.real, place.imag


def _flips(display: Display, x: float, y: float, distance: float) -> bool:
    """True if a lens shows an eye a point outside of its own elemental image."""
    share = display.elemental_image_pitch_mm / display.pitch_mm
    across, up = (
        (np.arange(count) - (count - 1) / 2) * pitch
        for count, pitch in (
            (display.lens_columns, display.pitch_mm), (display.lens_rows, display.row_pitch_mm)
        )
    )  # fmt: skip
    turned = (across + 1j * up[:, None]) * np.exp(1j * math.radians(display.rotation_deg))
    shift = display.shift_x_mm + 1j * display.shift_y_mm
    lens = turned + shift
    landing = lens + (lens - x - 1j * y) * display.gap_mm / distance
    off = (landing - shift - turned * share) * np.exp(-1j * math.radians(display.rotation_deg))
    halves = display.pitch_mm * share / 2, display.row_pitch_mm * share / 2
    return bool(((np.abs(off.real) > halves[0]) | (np.abs(off.imag) > halves[1])).any())


@relation(
    "the viewing zone", covers="display.viewpoint display.layouts display.display", limit=0,
    unit="wrong answers", source="each lens and the landing point of the eye's ray",
)  # fmt: skip
def _zone(_: str, effort: int) -> Iterator[Deviation]:
    """Eyes within a ten-millionth of the zone's edge see no flip inside it, and one outside."""
    kinds = {
        "nominal": DISPLAYS["nominal"], "phone": DISPLAYS["phone"],
        "aimed": DISPLAYS["nominal"].replace(elemental_pitch_mm=1.0079),
        "rows apart": DISPLAYS["nominal"].replace(pitch_y_mm=1.2, lens_rows=20),
        "small images": DISPLAYS["nominal"].replace(elemental_pitch_mm=0.9996, lens_columns=21),
        "shifted": DISPLAYS["nominal"].replace(shift_x_mm=2.3, shift_y_mm=-1.7),
        "turned": DISPLAYS["nominal"].replace(rotation_deg=12.0, shift_x_mm=0.4, lens_rows=20),
    }  # fmt: skip
    for name, display in kinds.items():
        nearest = display.nearest_viewing_distance_mm
        centre = display.shift_x_mm, display.shift_y_mm
        axes = np.exp(1j * math.radians(display.rotation_deg))
        yield is_true(f"{name}: nearest", _flips(display, *centre, nearest * (1 - 1e-9)))
        yield is_true(f"{name}: farther", not _flips(display, *centre, nearest * (1 + 1e-9)))
        distance = 2.3 * nearest
        limits = display.flip_limit_mm(distance)
        for inside in (1 - 1e-7, 1 + 1e-7):
            for sign in (1, -1):
                for offset in (sign * limits[0] * inside, sign * limits[1] * inside * 1j):
                    x, y = (n + c for n, c in zip(_parts(offset * axes), centre, strict=True))
                    expected, case = _flips(display, x, y, distance), f"{name}: {x:g} {y:g}"
                    yield difference(case, inside > 1, expected)
                    eye = Viewpoint("eye", x, y, distance)
                    yield difference(f"{case}, checked", _is_refused(eye, display), expected)
        x, y = np.add(_parts((limits[0] - 2.0) * axes), centre)
        half_pupil = Viewpoint("eye", x, y, distance, pupil_mm=4.0 * (1 + 1e-7))
        yield is_true(f"{name}: pupil", _is_refused(half_pupil, display))
        smaller = Viewpoint("eye", x, y, distance, pupil_mm=4.0 * (1 - 1e-7))
        yield is_true(f"{name}: smaller pupil", not _is_refused(smaller, display))
        in_picture = Viewpoint("eye", 0.0, 0.0, max(display.depth_range_mm[1], 0.1) * (1 - 1e-9))
        yield is_true(f"{name}: in the picture", _is_refused(in_picture, display))
    aimed = kinds["aimed"]
    aim = aimed.gap_mm * aimed.pitch_mm / (aimed.elemental_image_pitch_mm - aimed.pitch_mm)
    usual = default_distance_mm(aimed)
    yield is_true("aimed distance", abs(usual - max(aim, 2 * aimed.depth_range_mm[1])) < 1e-9)
    nominal = kinds["nominal"]
    usual = default_distance_mm(nominal)
    yield is_true("usual distance", abs(usual - 2 * 63 * 3.3) < 1e-9)
    for eye in parse_viewpoints(",".join(DEFAULT_VIEWPOINTS), nominal):
        # Half of the nearest position's zone is left at twice its distance.
        sideways = 0.75 * (usual / 6.6 - 31.5)
        across, up = (sideways * part for part in DEFAULT_VIEWPOINTS[eye.name])
        position = np.subtract(eye.position_mm, (across, up, usual))
        yield is_true(f"{eye.name}", np.abs(position) < 1e-9)
    eyes = zone_eyes(nominal, 5, rows=3)
    x, y = (np.array([eye.position_mm[k] for eye in eyes]).reshape(3, 5) for k in (0, 1))
    half = usual / 6.6 - 31.5
    steps = (2 * np.arange(5) - 4) / 5 * half, (2 * np.arange(3) - 2) / 3 * half
    yield is_true("even eyes across", np.abs(x - steps[0]) < 1e-9)
    yield is_true("even eyes up", np.abs(y - steps[1][:, None]) < 1e-9)
    focus = focus_distance_mm(Viewpoint("eye", 0, 0, 400, pupil_mm=3), nominal)
    yield is_true("focus", abs(focus - (400 - 33)) < 1e-9)
    slanted = small_display(
        lattice="lenticular", lens_columns=40, lens_rows=1, panel_columns=200, panel_rows=100,
        rotation_deg=15.0, elemental_pitch_mm=1.01, depth_min_mm=-5.0, depth_max_mm=5.0,
    )  # fmt: skip
    yield is_true("eye of a sheet", abs(default_distance_mm(slanted) - 330) < 1e-6)
    # Along the slanted axes nothing flips.
    at = 300 * math.tan(math.radians(15))
    along = Viewpoint("eye", -at, 300.0, 330.0)
    yield is_true("along cylinders", not _is_refused(along, slanted))
    yield is_true("across cylinders", _is_refused(Viewpoint("eye", at, 300.0, 330.0), slanted))


def _is_refused(eye: Viewpoint, display: Display) -> bool:
    try:
        check_viewpoint(eye, display)
    except ViewpointError:
        return True
    return False


@relation(
    "emitting areas", covers="display.pixels display.cells", limit=1e-9, unit="panel pixels",
    source=_ROUNDING,
)  # fmt: skip
def _areas(_: str, effort: int) -> Iterator[Deviation]:
    """Colours shine about the starts of their rays, with the mean 1, on their own pixels."""
    steps = 60
    at = (np.arange(steps) + 0.5) / steps - 0.5
    right, down = at[None, :], at[:, None]
    for name, colours in SUBPIXELS.items():
        for colour in colours:
            for fill in (1.0, 0.6):
                light = [
                    emission_profile(colour, fill, np.where, right, down, turn) for turn in (0, 1)
                ]
                case = f"{name}, {colour.right}, filled {fill:g}"
                yield difference(f"{case}: mean", np.mean(light), 1.0, 0.2 if fill < 1 else 1.0)
                total = np.sum(light, axis=0)
                centre = (total * right).sum() / total.sum(), (total * down).sum() / total.sum()
                expected = (float(colour.right), 0.0)
                yield excess(f"{case}: centre", np.abs(np.subtract(centre, expected)), 0.0)
                if colour.turn is not None:
                    yield is_true(f"{case}: turn", not np.any(light[1 - colour.turn]))
    for pattern in CELL_PATTERNS:
        display = small_display(
            subpixels="cells", cell_pattern=pattern, panel_rows=18, panel_columns=19,
            subpixel_cells="0.1 0.2 0 0 -0.1 0, 0.3 0 0.1 0 0 0.2, -0.3 0.1 0 0.3 0.2 0, "
            "0 0 0 0 0 0",
        )  # fmt: skip
        rows, _ = display.eia_shape
        pixels = np.argwhere(np.ones(display.eia_shape, bool))
        kinds = np.array(kinds_of_pixels(display)).reshape(4, 4)
        for channel in range(3):
            centres = cell_centres(display, slice(0, rows), slice(None), channel)
            x, y = panel_places(display, pixels, PixelOffset(Fraction(0), Fraction(0), channel))
            x0, y0 = panel_places(display, pixels)
            for centre, moved in zip(centres, (x - x0, y - y0), strict=True):
                centre = np.broadcast_to(centre, display.eia_shape).ravel()
                there = (moved / display.pixel_pitch_mm).astype(float)
                yield excess(f"{pattern}: centres", np.abs(centre - there), 0)
            table = np.array(display.subpixel_cells)[kinds]
            period = table[(rows - 1 - pixels[:, 0]) % 4, pixels[:, 1] % 4, 2 * channel]
            yield excess(f"{pattern}: kinds", np.abs(period - centres[0].ravel()), 0)
    for name, display in displays():
        yield from _points(name, display)


def _points(name: str, display: Display) -> Iterator[Deviation]:
    """Points of the panel have the pixel and the sub-pixels at their place."""
    rows, columns = display.eia_shape
    pixels = np.argwhere(np.ones(display.eia_shape, bool))
    x, y = (v.astype(float) for v in panel_places(display, pixels))
    turn = math.radians(display.rotation_deg)
    for right, up in ((0.03, 0.01), (0.31, 0.22), (-0.42, -0.37)):
        step = display.pixel_pitch_mm
        points = panel_points(display, x + right * step, y + up * step)
        own_pixel = np.stack([points.row, points.column], axis=-1)
        yield is_true(f"{name}: pixel", (own_pixel == pixels).all(), len(pixels))
        for channel, colour in enumerate(SUBPIXELS[display.subpixels]):
            offset = PixelOffset(Fraction(0), colour.right, colour.channel)
            sub_x, sub_y = (v.astype(float) for v in panel_places(display, pixels, offset))
            half_x, half_y = (
                float(side) * display.pixel_fill * step / 2
                for side in (colour.width, colour.height)
            )
            in_x = np.abs(x + right * step - sub_x) < half_x
            lit = in_x & (np.abs(y + up * step - sub_y) < half_y)
            if colour.turn is not None:
                lit &= pixels.sum(axis=1) % 2 == colour.turn
            yield is_true(f"{name}: colour {channel}", (points.shines[channel] > 0) == lit, len(x))
            across = math.cos(turn) * (sub_x - display.shift_x_mm)
            across += math.sin(turn) * (sub_y - display.shift_y_mm)
            far = np.abs(points.across_mm[channel] - across) / step
            yield excess(f"{name}: across", far, 0.0)
    beside = panel_points(display, np.array([0.0, columns]), np.array([rows, 0.0]))
    yield is_true(f"{name}: beside", [not light.any() for light in beside.shines])


# xy of CIE daylight D50, D55, D65 and D75, and the temperatures of their definition (CIE 15).
_DAYLIGHT = {5003: (0.3457, 0.3585), 5503: (0.3324, 0.3474), 6504: (0.3127, 0.3290),
             7504: (0.2990, 0.3149), 4600: (0.3585, 0.3684)}  # fmt: skip
_PRIMARIES = ((0.64, 0.33), (0.30, 0.60), (0.15, 0.06))


@relation(
    "light of the panel", covers="display.panel", limit=2e-3, unit="share of white",
    source="four digits of published chromaticities",
)  # fmt: skip
def _panel(_: str, effort: int) -> Iterator[Deviation]:
    """White has the daylight's chromaticity, black its level, and glare keeps the mean."""
    columns = np.array([(x / y, 1.0, (1 - x - y) / y) for x, y in _PRIMARIES]).T
    d65 = np.array([0.3127 / 0.3290, 1.0, (1 - 0.3127 - 0.3290) / 0.3290])
    to_xyz = columns * np.linalg.solve(columns, d65)
    for kelvin, (x, y) in _DAYLIGHT.items():
        white = np.linalg.solve(to_xyz, (x / y, 1.0, (1 - x - y) / y))
        actual = white_of(small_display(white_point_k=float(kelvin)))
        yield excess(f"{kelvin} K", np.abs(actual - white / white.max()), 0.0)
    blue = [white_of(small_display(white_point_k=k))[2] for k in (4000.0, 5500.0, 6999.9, 7000.1)]
    red = [white_of(small_display(white_point_k=k))[0] for k in (7000.1, 12000.0, 25000.0)]
    yield is_true("warmer has less blue", np.diff(blue) > -1e-3)
    yield is_true("colder has less red", np.diff(red) < 0)
    yield difference("usual white", white_of(small_display()), (1, 1, 1))
    display = small_display(
        black_level=0.01, white_point_k=5000.0, veiling_glare=0.1, ambient_reflection=0.02
    )
    white = np.array(white_of(display))
    drive = np.random.default_rng(0).random((*display.eia_shape, 3)).astype(np.float32)
    emitted = emitted_picture(drive, display)
    yield excess("emitted", np.abs(emitted - white * (0.01 + 0.99 * drive)), 0.0)
    yield difference("black", emitted_light(0.0, 0.01, 1.0), 0.01)
    yield difference("ideal", emitted_picture(drive, small_display()), drive)
    view = seen_light(drive, display)
    yield excess("mean", np.abs(view.mean(axis=(0, 1)) - drive.mean(axis=(0, 1)) - 0.02), 0.0)
    yield excess("contrast", np.abs(np.ptp(view[..., 1]) - 0.9 * np.ptp(drive[..., 1])), 0.0)
    yield difference("no glare", seen_light(drive, small_display()), drive)


@relation(
    "indices of colours", covers="display.lens.array", limit=1e-12, unit="index",
    source=_ROUNDING,
)  # fmt: skip
def _indices(_: str, effort: int) -> Iterator[Deviation]:
    """Indices of colours have the Abbe number of the glass on Cauchy's curve."""
    for n, abbe in ((1.4917, 57.2), (1.7, 30.0)):
        red, green, blue = channel_indices(small_display(refractive_index=n, abbe_number=abbe))
        inverse = [wave**-2 for wave in (611.4, 549.1, 464.2)]
        slope = (blue - red) / (inverse[2] - inverse[0])
        middle = red + slope * (inverse[1] - inverse[0])
        yield excess("one curve", abs(green - middle), 0.0)
        at = {wave: red + slope * (wave**-2 - inverse[0]) for wave in (587.56, 486.13, 656.27)}
        yield excess("d line", abs(at[587.56] - n), 0.0)
        number = (at[587.56] - 1) / (at[486.13] - at[656.27])
        yield excess("Abbe number", abs(number / abbe - 1), 0.0)
    yield difference("none", channel_indices(small_display()), (1.4917,) * 3)


@relation(
    "misalignments", covers="display.misalignment display.layers display.layouts", limit=0.05,
    unit="panel pixels", source="geometry to first order in the misalignment",
)  # fmt: skip
def _misaligned(_: str, effort: int) -> Iterator[Deviation]:
    """A misalignment of one pixel moves the point that an eye sees at the array's edge by one."""
    display = DISPLAYS["nominal"]
    distance = 2 * display.nearest_viewing_distance_mm
    for kind, size in one_pixel_errors(display).items():
        # The middle of an outermost lens: along the axis on which the error acts.
        x, y = (0.5, 31.5) if kind in ("shift_y_mm", "tilt_y_deg") else (31.5, 0.5)
        places = []
        for sign in (1, -1):
            other = misaligned(display, {kind: sign * size})
            yield difference(f"{kind}: panel", other.eia_shape, display.eia_shape)
            places.append(_seen_centre(other, x, y, distance))
        moved = np.abs(np.subtract(*places)) / 2 / display.pixel_pitch_mm
        yield difference(kind, moved.max(), 1.0)
    design = DISPLAYS["nominal"].replace(pitch_y_mm=1.1, elemental_pitch_mm=1.002)
    wider = misaligned(design, "pitch_mm=0.01, gap_mm=0.1")
    values = (wider.pitch_mm, wider.pitch_y_mm, wider.elemental_pitch_mm, wider.gap_mm,
              wider.lens_thickness_mm)  # fmt: skip
    yield difference("pitch", values, (1.01, 1.111, 1.01202, 3.4, 1.0), 1e-9)
    yield difference("depth range", wider.depth_range_mm, design.depth_range_mm)
    layers = ((0.5, 1.52), (0.2, 1.4))
    air = 0.5 / 1.52 + 0.2 / 1.4
    yield excess("layers", abs(air_equivalent_mm(layers) - air), 0.0)
    yield excess("excess", abs(excess_mm(layers) - (0.7 - air)), 0.0)


def _seen_centre(display: Display, column: float, row: float, distance: float) -> np.ndarray:
    """Panel point that an eye on the axis sees through the centre of a lens, in pitches."""
    turn, pitch = math.radians(display.rotation_deg), display.pitch_mm
    c, s = math.cos(turn), math.sin(turn)
    x = (c * column - s * row) * pitch + display.shift_x_mm
    y = (s * column + c * row) * pitch + display.shift_y_mm
    return np.array(trace_to_panel(display, "pinhole", x, y, x / distance, y / distance)[:2])
