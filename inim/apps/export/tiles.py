"""Tiles of a quilt, as given by a user."""

from typing import NamedTuple

from inim.system.errors import UsageError

#: Two whole numbers, across and down: ``(8, 6)`` or ``"8x6"``.
Pair = str | tuple[int, int]
#: Defaults of a quilt: tiles across and down, and samples per pixel.
TILES, SPP = "8x6", 32
#: Quilts of published devices, by their columns and rows of views: width and height of a view in
#: pixels, and its width over its height as seen, where its pixels are not square.
_QUILTS = {
    (8, 6): (420, 560, 0.75),
    (5, 9): (819, 455, 16 / 9),
    (7, 7): (857, 857, 16 / 9),
    (11, 6): (372, 682, 9 / 16),
    (8, 9): (1024, 910, 16 / 9),
}


class Tiles(NamedTuple):
    """Number of tiles across and down, size of each in pixels, and its displayed aspect ratio."""

    columns: int
    rows: int
    width: int
    height: int
    aspect: float


def parse_pair(option: str, pair: Pair, most: int) -> tuple[int, int]:
    """Two whole numbers, across and down, whose product is at most `most`."""
    text = pair if isinstance(pair, str) else "x".join(map(str, pair))
    across, _, down = text.lower().partition("x")
    if not (across.isdecimal() and down.isdecimal() and 0 < int(across) * int(down) <= most):
        raise UsageError(f"{option} {text}: write ACROSSxDOWN, such as 9x9, of at most {most}")
    return int(across), int(down)


def parse_tile_counts(tiles: Pair) -> tuple[int, int]:
    """Number of tiles across and down."""
    return parse_pair("--tiles", tiles, 1000)


def parse_tiles(tiles: Pair | None, view_size: Pair | None, aspect: float | None) -> Tiles:
    """Tiles of a quilt; a missing size or aspect is that of the device with so many tiles."""
    columns, rows = parse_tile_counts(tiles or TILES)
    if view_size is not None:
        width, height = parse_pair("--view-size", view_size, 2**28)
        default_aspect = width / height
    elif (columns, rows) in _QUILTS:
        width, height, default_aspect = _QUILTS[columns, rows]
    else:
        raise UsageError(f"--tiles {columns}x{rows}: unknown size of a tile; give --view-size WxH")
    return Tiles(columns, rows, width, height, default_aspect if aspect is None else aspect)


def check_aspect(aspect: float) -> None:
    """Raise `UsageError` unless a displayed tile has a possible shape."""
    if not 0.01 <= aspect <= 100:
        raise UsageError(f"--aspect {aspect:g}: must be width over height, such as 0.75")
