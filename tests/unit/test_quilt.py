"""Quilts before rendering: where eyes stand, what of a tile the array takes, what is refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from inim.apps.export.quilt import QuiltRequest
from inim.apps.export.tiles import Tiles, parse_tiles
from inim.display.viewpoint import default_distance_mm, zone_eyes
from inim.system.errors import UsageError, ViewpointError
from tests.conftest import small_display

DISPLAY = small_display(24, 20, 17)
REQUEST = QuiltRequest(
    out=Path("q.png"), source=Path("eia.png"), label=Path("eia.png"), design=DISPLAY,
    misaligned_display=DISPLAY, lens_model="thin", distance_mm=None, columns=8, rows=6, width=420,
    height=560, aspect=0.75, spp=32,
)  # fmt: skip


@pytest.mark.parametrize(("count", "distance"), [(1, None), (45, None), (48, 300.0)])
def test_eyes_are_in_the_middles_of_equal_shares_of_the_zone_from_left_to_right(count, distance):
    at = np.array([eye.position_mm for eye in zone_eyes(DISPLAY, count, distance)])
    stands = default_distance_mm(DISPLAY) if distance is None else distance
    limit = DISPLAY.flip_limit_mm(stands)[0]
    assert (at[:, 1:] == [0, stands]).all()
    borders = np.linspace(-limit, limit, count + 1)
    np.testing.assert_allclose(at[:, 0], (borders[:-1] + borders[1:]) / 2, atol=1e-12)


def test_eyes_too_close_for_a_zone_are_refused():
    with pytest.raises(ViewpointError, match="move back to at least"):
        zone_eyes(DISPLAY, 48, 60.0)


@pytest.mark.parametrize(
    ("width", "height", "columns", "rows", "aspect"),
    [
        (3360, 3360, 8, 6, 0.75),  # Portrait
        (4092, 4092, 11, 6, 0.5625),  # Go
        (5999, 5999, 7, 7, 16 / 9),  # 16", landscape
        (4096, 4096, 5, 9, 16 / 9),  # 15.6"
        (8192, 8192, 8, 9, 16 / 9),  # 65"
    ],
)
def test_tiles_of_a_device_are_those_of_the_vendor_s_table(width, height, columns, rows, aspect):
    """LKG-Toolkit, HardCodedLKGDeviceTemplates.cs; tiles are whole pixels, the rest is unused."""
    tiles = Tiles(columns, rows, width // columns, height // rows, aspect)
    assert parse_tiles(f"{columns}x{rows}", None, None) == tiles


@pytest.mark.parametrize(
    ("size", "aspect", "window"),
    [
        ((420, 560), 0.75, (350, 420)),  # 24 x 20 lenses: as wide as the tile
        ((96, 80), 1.2, (80, 96)),
        ((1000, 100), 10.0, (100, 120)),
        ((200, 200), 2.0, (200, 120)),  # pixels twice as wide as high
        ((3, 1000), 0.003, (2, 3)),
    ],
)
def test_the_array_fills_a_tile_undistorted(size, aspect, window):
    request = replace(REQUEST, width=size[0], height=size[1], aspect=aspect)
    assert request.window == window


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"columns": 0}, "--tiles: 0 views"),
        ({"columns": 200}, "--tiles: 1200 views"),
        ({"width": 40_000, "height": 40_000}, "--view-size: "),
        ({"aspect": float("nan")}, "--aspect nan"),
        ({"spp": 0}, "--view-spp 0"),
        ({"out": Path("q.webp")}, "a quilt is a .png"),
    ],
)
def test_a_quilt_that_cannot_be_is_refused_before_its_eia_is_read(changed, says):
    with pytest.raises(UsageError, match=says):
        replace(REQUEST, **changed).check()
