"""Elemental images section: some of them magnified, and their location on the panel."""

from dataclasses import dataclass

import numpy as np

from inim.display.pixels import exact_ratio
from inim.report.document import ReportDocument
from inim.report.images import ReportImages
from inim.report.labels import TRUE_EIA, metric_scores, named, score
from inim.report.page import captioned, element, lead
from inim.report.sections import ReportSection

_CROP_LENSES = 5
_WHOLE_EIA_PX = 420
_INTRO = (
    f"About {_CROP_LENSES} × {_CROP_LENSES} elemental images of the panel, magnified, where the "
    "ground-truth EIA varies most near the centre. Below each is the whole EIA, scaled "
    "down, with a frame around this region."
)


@dataclass(frozen=True)
class _Window:
    """A rectangle of an elemental image array, in pixels."""

    top: int
    left: int
    height: int
    width: int

    def of(self, pixels: np.ndarray) -> np.ndarray | None:
        """The part of `pixels` inside, or None where it does not reach that far."""
        cut = pixels[self.top : self.top + self.height, self.left : self.left + self.width]
        return cut if cut.shape[:2] == (self.height, self.width) else None


def elemental_images(data: ReportDocument, images: ReportImages) -> str:
    """The section on the elemental images, at the same location in every EIA."""
    truth = images.read("truth", "eia.png")
    window = _busiest_window(truth, data)
    floor = data.noise_floor
    own = [] if floor is None else [("To itself", metric_scores(floor.eia, "eia"))]
    figures = [_eia_figure(images, truth, window, named(data, TRUE_EIA), own)]
    for name, result in data.algorithms.items():
        eia, scores = images.read("eia", f"{name}.png"), result.eia
        facts = [("Holes", [("", score(scores, "hole_fraction"))])]
        if floor is not None:
            holes = ("Holes", score(scores, "hole_fraction"))
            facts = [("To the ground-truth EIA", [*metric_scores(scores, "eia"), holes])]
        figures.append(_eia_figure(images, eia, window, name, facts))
    intro = lead(named(data, _INTRO))
    return intro + element("div", *figures, class_="eias")


def _eia_figure(
    images: ReportImages,
    pixels: np.ndarray | None,
    window: _Window,
    name: str,
    facts: list[tuple[str, list[tuple[str, str]]]],
) -> str:
    cut = None if pixels is None else window.of(pixels)
    crop = images.magnify(cut, f"Magnified elemental images, {name}")
    whole = images.embed(pixels, f"Whole elemental image array, {name}", _WHOLE_EIA_PX)
    marked = element("div", whole, _marker(pixels, window), class_="marked")
    return captioned(name, "", [crop, marked], facts)


def _marker(pixels: np.ndarray | None, window: _Window) -> str:
    """Frame around the magnified part of the whole EIA."""
    if pixels is None or window.of(pixels) is None:
        return ""
    rows, columns = pixels.shape[:2]
    place = (
        f"top:{100 * window.top / rows:.2f}%;left:{100 * window.left / columns:.2f}%;"
        f"height:{100 * window.height / rows:.2f}%;width:{100 * window.width / columns:.2f}%"
    )
    return element("i", style=place, aria_hidden="true")


def _busiest_window(truth: np.ndarray | None, data: ReportDocument) -> _Window:
    """The few lenses in the central half of the array whose pixels vary most."""
    rows, columns = (0, 0) if truth is None else truth.shape[:2]
    pixels_per_lens = data.display.parameters.pixels_per_lens
    size = max(1, round(_CROP_LENSES * pixels_per_lens))
    height, width = min(size, rows), min(size, columns)
    if truth is None:
        return _Window(0, 0, size, size)
    tops = _lens_starts(rows, height, pixels_per_lens)
    lefts = _lens_starts(columns, width, pixels_per_lens)
    # Only what the windows can reach: an array of 33 million pixels would take gigabytes.
    reach = np.s_[tops[0] : tops[-1] + height, lefts[0] : lefts[-1] + width]
    grey = truth[reach].mean(axis=2, dtype=np.float64)
    inside = tops - tops[0], lefts - lefts[0], height, width
    variance = _window_mean(grey**2, *inside) - _window_mean(grey, *inside) ** 2
    row, column = np.unravel_index(int(np.argmax(variance)), variance.shape)
    return _Window(int(tops[row]), int(lefts[column]), height, width)


def _lens_starts(pixels: int, size: int, pixels_per_lens: float) -> np.ndarray:
    """First pixels of the lenses, the array centred on the panel, in its central half."""
    lenses = int(exact_ratio(pixels / pixels_per_lens))
    first = (pixels - lenses * pixels_per_lens) / 2
    starts = np.round(first + np.arange(lenses) * pixels_per_lens).astype(int)
    central = (starts >= pixels / 4) & (starts + size <= 3 * pixels / 4)
    if central.any():
        return starts[central]
    return np.array([(pixels - size) // 2])


def _window_mean(
    values: np.ndarray, tops: np.ndarray, lefts: np.ndarray, height: int, width: int
) -> np.ndarray:
    """(tops, lefts) means over windows, from a summed-area table."""
    table = np.pad(values.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    below, above = table[tops + height], table[tops]
    total = below[:, lefts + width] - below[:, lefts] - above[:, lefts + width] + above[:, lefts]
    return np.asarray(total / (height * width))


SECTIONS = (ReportSection(70, "eia", "Elemental images", elemental_images, is_folded=True),)
