"""Mistakes in the content of an EIA that its truth reveals.

Each mistake has an inverse. If the inverse of one brings the EIA of a case clearly closer to the
truth, the mistake is named. Distances are root mean squares of sRGB values.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from inim.display import Display
from inim.display.pixels import SUBPIXELS, PixelOffset, pixel_rays
from inim.image.color import linear_from_srgb, srgb_from_linear

# The inverse of a mistake brings the EIA closer by so much.
_LEAST_GAIN_DB = 2.0
# An EIA that is farther from the truth than one of a single colour resembles nothing.
_LEAST_RESEMBLANCE_DB = 1.0
# Saturated pixels beyond those of the truth.
_MOST_CLIPPED = 0.01
# Difference of sRGB channels that is a colour.
_LEAST_COLOUR = 0.1
_WHITE = 1 - 0.5 / 255


class Judged(NamedTuple):
    """EIA of a case with its truth, (rows, columns, 3) float32, linear RGB."""

    case: str
    display: Display
    eia: np.ndarray
    truth: np.ndarray


# Channels of a file in the wrong order, by the places of red, green and blue in it.
_ORDERS = {"BGR": (2, 1, 0), "RBG": (0, 2, 1), "GRB": (1, 0, 2), "GBR": (2, 0, 1), "BRG": (1, 2, 0)}


def _turn_elemental_images(
    eia: np.ndarray, display: Display, *, across: bool = True, up: bool = True
) -> np.ndarray:
    """Reverse each elemental image about the axis of its lens, in one direction or in both."""
    turned = eia.copy()
    rows, columns = display.eia_shape
    pitch = display.pixel_pitch_mm
    for channel, subpixel in enumerate(SUBPIXELS[display.subpixels]):
        offset = PixelOffset(subpixel.right * 0, subpixel.right, subpixel.channel)
        rays = pixel_rays(display, slice(0, rows), offset)
        x = rays.x0 + (1 if across else -1) * rays.slope_x * rays.gap_mm
        x = x - float(subpixel.right) * pitch
        y = rays.y0 + (1 if up else -1) * rays.slope_y * rays.gap_mm
        column = np.rint(x / pitch + (columns - 1) / 2).astype(int)
        row = np.rint((rows - 1) / 2 - y / pitch).astype(int)
        row, column = np.broadcast_arrays(row, column)
        is_inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        source = eia[row.clip(0, rows - 1), column.clip(0, columns - 1), channel]
        turned[..., channel] = np.where(is_inside, source, 0)
    return turned


#: Inverses by mistake.
_INVERSES: dict[str, tuple[str, Callable[[np.ndarray, Display], np.ndarray]]] = {
    "its black is code 16, as in video of limited range": (
        "black is 0 and white is 255",
        lambda eia, _: linear_from_srgb(np.clip((srgb_from_linear(eia) * 255 - 16) / 219, 0, 1))),
    "its rows are in reverse order (upside down)": (
        "row 0 is the top", lambda eia, _: eia[::-1]),
    "its columns are in reverse order (mirrored)": (
        "column 0 is on the left, as the viewer sees the panel", lambda eia, _: eia[:, ::-1]),
    "it is rotated by 180 degrees": (
        "row 0 is the top", lambda eia, _: eia[::-1, ::-1]),
    "it is pseudoscopic: each elemental image is reversed from left to right": (
        "a ray through a lens is mirrored at its centre",
        partial(_turn_elemental_images, up=False)),
    "it is pseudoscopic: each elemental image is reversed from top to bottom": (
        "a ray through a lens is mirrored at its centre",
        partial(_turn_elemental_images, across=False)),
    "it is pseudoscopic: each elemental image is rotated by 180 degrees": (
        "rotate the elemental images; a ray through a lens is mirrored at its centre",
        _turn_elemental_images),
    "its values are linear light, where sRGB is expected (gamma)": (
        "encode a PNG as sRGB", lambda eia, _: srgb_from_linear(eia)),
    "its values are sRGB, where linear light is expected (gamma)": (
        "an EXR has linear light; encode a PNG once", lambda eia, _: linear_from_srgb(eia)),
    "its values reach from 0 to 255": (
        "in an EXR, white is 1", lambda eia, _: eia / np.float32(255)),
}  # fmt: skip


class Undone(NamedTuple):
    """Effect of the inverse of a mistake on a case."""

    gain_db: float
    mistake: str
    remedy: str
    detail: str = ""


def content_mistakes(judged: Sequence[Judged]) -> list[str]:
    """Sentences on mistakes in the content of EIAs, each with its remedy."""
    mistakes = [*_clipped(judged), *_grey(judged)]
    undone_by_mistake: dict[tuple[str, str], dict[str, Undone]] = {}
    for case in judged:
        if _is_clipped(case):
            continue
        error = _error_db(case.eia, case.truth)
        best = max(_inverses(case, error), key=lambda undone: undone.gain_db)
        if best.gain_db >= _LEAST_GAIN_DB:
            undone_by_mistake.setdefault((best.mistake, best.remedy), {})[case.case] = best
        else:
            mistakes += _unlike(case, error, judged)
    for (mistake, remedy), cases in undone_by_mistake.items():
        gain = sum(undone.gain_db for undone in cases.values()) / len(cases)
        first = next(iter(cases))
        more = f", and {len(cases) - 1} more" * (len(cases) > 1)
        mistakes.append(
            f"{mistake}{cases[first].detail} ({first}{more}): undone, it is {gain:.1f} dB closer "
            f"to the truth; {remedy}"
        )
    return mistakes


def _inverses(case: Judged, error: float) -> Iterator[Undone]:
    """Effects of the inverses of all mistakes."""
    for mistake, (remedy, inverse) in _INVERSES.items():
        undone = inverse(case.eia, case.display)
        yield Undone(error - _error_db(undone, case.truth), mistake, remedy)
    of_chroma = _error_db(case.eia, case.truth, chroma=True)
    for name, order in _ORDERS.items():  # colours of a relic may be similar in two channels
        after = _error_db(case.eia[..., list(order)], case.truth, chroma=True)
        yield Undone(of_chroma - after, f"its channels are {name}", "write RGB")
    down, right = _shift_of(case)
    gain = error - _error_db(np.roll(case.eia, (-down, -right), (0, 1)), case.truth)
    pitch = case.display.pixels_per_lens
    detail = (
        f" by {right:+d} pixels to the right and {down:+d} down, {right / pitch:+.2f} and "
        f"{down / pitch:+.2f} lenses"
    )
    yield Undone(gain, "it is shifted", "take the lens of a pixel from rays.exr", detail)


def _error_db(eia: np.ndarray, truth: np.ndarray, *, chroma: bool = False) -> float:
    """Root mean square of the difference of sRGB values, in decibels; smaller is closer.

    Of the differences between channels only for `chroma`.
    """
    difference = srgb_from_linear(np.clip(eia, 0, 1)) - srgb_from_linear(np.clip(truth, 0, 1))
    if chroma:
        difference = difference - difference.mean(axis=-1, keepdims=True)
    return 10 * math.log10(float(np.mean(difference.astype(np.float64) ** 2)) + 1e-9)


def _brightness(image: np.ndarray) -> np.ndarray:
    grey: np.ndarray = srgb_from_linear(np.clip(image, 0, 1)).mean(axis=-1, dtype=np.float64)
    grey -= grey.mean()
    return grey


def _shift_of(case: Judged) -> tuple[int, int]:
    """Pixels down and right by which the EIA is moved, at most a lens and a half."""
    spectrum = np.fft.rfft2(_brightness(case.eia)) * np.conj(np.fft.rfft2(_brightness(case.truth)))
    match = np.fft.irfft2(spectrum, case.truth.shape[:2])
    reach = math.ceil(1.5 * case.display.pixels_per_lens)
    window = np.roll(match, (reach, reach), (0, 1))[: 2 * reach + 1, : 2 * reach + 1]
    down, right = np.unravel_index(window.argmax(), window.shape)
    return int(down) - reach, int(right) - reach


def _grey(judged: Sequence[Judged]) -> list[str]:
    """Words on EIAs without colour, whose truth has colours."""
    grey = [c.case for c in judged if not np.ptp(c.eia, axis=-1).any() and _is_coloured(c.truth)]
    if not grey:
        return []
    return [f"{len(grey)} pictures are grey ({grey[0]}); write the colours of the input"]


def _is_coloured(image: np.ndarray) -> bool:
    return bool(np.quantile(np.ptp(srgb_from_linear(image), axis=-1), 0.99) > _LEAST_COLOUR)


def _clipped_share(case: Judged) -> float:
    """Share of saturated pixels, less that of the truth."""
    own, true = ((image >= _WHITE).any(axis=-1).mean() for image in (case.eia, case.truth))
    return float(own - true)


def _is_clipped(case: Judged) -> bool:
    return case.eia.max() <= 1 and _clipped_share(case) > _MOST_CLIPPED


def _clipped(judged: Sequence[Judged]) -> list[str]:
    """Words on EIAs with far more saturated pixels than their truth."""
    clipped = [case for case in judged if _is_clipped(case)]
    if not clipped:
        return []
    excess = [_clipped_share(case) for case in clipped]
    worst = clipped[int(np.argmax(excess))].case
    return [
        f"{max(excess):.1%} more of its pixels are clipped at white than in the truth of {worst}; "
        "do not brighten it: in linear light, white is 1 as in the input"
    ]


def _unlike(case: Judged, error: float, judged: Sequence[Judged]) -> list[str]:
    """Words on an EIA that resembles another case, or nothing."""
    others = {
        other.case: _error_db(case.eia, other.truth)
        for other in judged
        if other is not case and other.truth.shape == case.truth.shape
    }
    nearest = min(others, key=lambda name: others[name], default="")
    if nearest and error - others[nearest] > _LEAST_GAIN_DB:
        return [f"{case.case}: resembles the truth of {nearest}; exchange the files"]
    flat = np.broadcast_to(case.truth.mean(axis=(0, 1)), case.truth.shape)
    if error <= _error_db(flat, case.truth) - _LEAST_RESEMBLANCE_DB:
        return []
    return [
        f"{case.case}: resembles its truth no more than a picture of one colour; make it for the "
        "relic and the display of its input.json"
    ]


def alpha_mistakes(alphas: Mapping[str, float]) -> list[str]:
    """Words on transparent pixels, by case the share of pixels under a lens that are."""
    if not alphas:
        return []
    worst = max(alphas, key=lambda case: alphas[case])
    return [
        f"{len(alphas)} pictures have transparent pixels, {worst} {alphas[worst]:.1%}; a panel "
        "shows no alpha: write opaque RGB, black where there is nothing"
    ]
