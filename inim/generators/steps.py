"""Steps from the sources of rays to an elemental image array, the same for every algorithm.

1. Samples: the points of every pixel from which rays start (`sample_points`).
2. Sources of these rays: the algorithm.
3. Colour of each ray, and the mean of a pixel's rays (`inim.generators.raycast.colour`).
4. Fill of pixels without a source (`inim.generators.raycast.fill`).
5. Mask: panel pixels outside it are black.

`inim.generators.options.CommonOptions` has the options of these steps. With a mask, each pixel has
the same bits as without it, because it depends only on its own rays and the picture.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from functools import cached_property, partial
from typing import Any

import numpy as np

from inim.display import Display
from inim.display.pixels import CENTRE, SUBPIXELS, PixelOffset, SubPixel, exact_length
from inim.generators.base import (
    HOLE,
    MASKED,
    Generator,
    PanelRays,
    PictureShape,
    Ray,
    RaySearch,
    SourceFinder,
    SourceGenerator,
    Sources,
    check_array,
    check_out,
    check_range,
    each_ray,
)
from inim.generators.options import CommonOptions
from inim.generators.registry import Algorithm
from inim.image.rgbd import RGBD, LayeredRGBD
from inim.system.errors import UsageError


class RayGenerator(SourceGenerator):
    """Generator of an algorithm that finds the sources of rays; see the module.

    * `algorithm`: with its options.
    * `display`, `shape`, `pixel_mm`, `mask`: as for `SourceGenerator`.
    * `leave_holes`: see `PanelRays`.

    Raises `UsageError`: the algorithm does not support the display or an option.
    """

    def __init__(
        self,
        algorithm: Algorithm,
        display: Display,
        shape: PictureShape,
        pixel_mm: float,
        mask: np.ndarray | None = None,
        *,
        leave_holes: bool = False,
    ) -> None:
        super().__init__(display, shape, pixel_mm, mask)
        self._algorithm, self._leave_holes = algorithm, leave_holes
        self.rays = sample_points(display, algorithm.common.samples)
        fill = algorithm.common.fill
        is_filled = fill in ("hidden", "all")
        # Both raise here for what the algorithm does not support; tables come with pictures.
        _ = self.with_holes if is_filled and display.is_separable else self._finder
        if is_filled and not display.is_separable:
            raise UsageError(
                f"fill = {fill!r}: this display has {display.not_separable_by}, so its lenses form "
                "no rows and columns; use fill=none"
            )

    def _prepare(self, offsets: tuple[PixelOffset, ...]) -> SourceFinder:
        size = self.display, self.shape, self.pixel_mm
        rays = PanelRays(*size, offsets, self.mask, self._leave_holes)
        with self._algorithm.errors():
            finder: SourceFinder = self._algorithm.prepare(rays, self._algorithm.options)
            return finder

    @cached_property
    def _finder(self) -> SourceFinder:
        return self._prepare(self._offsets)

    @cached_property
    def _centre_finder(self) -> SourceFinder:
        return self._finder if self._offsets == (CENTRE,) else self._prepare((CENTRE,))

    @property
    def _offsets(self) -> tuple[PixelOffset, ...]:
        return tuple(ray.pixel_offset for ray in self.rays)

    @cached_property
    def with_holes(self) -> RayGenerator:
        """Generator of the same rays over the continued picture, without a fill and a mask."""
        from inim.generators.raycast.fill import continued_shape

        unfilled = replace(self._algorithm, common=replace(self._algorithm.common, fill="none"))
        shape = continued_shape(self.display, self.shape, self.pixel_mm)
        return RayGenerator(unfilled, self.display, shape, self.pixel_mm, leave_holes=True)

    def _fill_of(self, rgbd: RGBD) -> str:
        from inim.generators.raycast.fill import fills_frame

        fill = self._algorithm.common.fill
        if fill != "auto":
            return fill
        return "hidden" if self.display.is_separable and fills_frame(rgbd) else "none"

    def find(self, rgbd: RGBD) -> Sources:
        """See `SourceGenerator.find`."""
        with self._algorithm.errors():
            return self._whole(self._centre_finder(rgbd), 0)

    def _whole(self, search: RaySearch, ray: int) -> Sources:
        sources = np.empty(self.display.eia_shape, np.int32)
        search(ray, slice(0, len(sources)), sources)
        return sources

    def _marked(self, search: RaySearch, ray: int) -> Sources:
        """Sources of a ray of all panel pixels."""
        sources = self._whole(search, ray)
        self.mark(sources)
        return sources

    def sources_of_rays(self, rgbd: RGBD) -> list[tuple[Ray, Sources]]:
        """Rays whose colours a pixel shows, or their mean, with the sources of each."""
        self.check(rgbd)
        with self._algorithm.errors():
            search = self._finder(rgbd)
            return [(ray, self._marked(search, n)) for n, ray in enumerate(self.rays)]

    def shows_sources(self, rgbd: RGBD) -> bool:
        """True if the colours of its sources are the complete result for a picture."""
        is_copied = self._algorithm.common.colour == "nearest" and self._offsets == (CENTRE,)
        return is_copied and self._fill_of(rgbd) == "none"

    def generate(self, rgbd: RGBD, out: np.ndarray | None = None) -> np.ndarray:
        """See `Generator.generate`; a hole counts as black, filled pixels have their alpha."""
        from inim.generators.raycast.fill import continued, fill_holes

        self.check(rgbd)
        out = self.place(rgbd, out)
        if isinstance(rgbd, LayeredRGBD) and self._algorithm.reads is RGBD:
            rgbd = RGBD(rgbd.color, rgbd.depth_mm, rgbd.covered, rgbd.pixel_mm)
        fill = self._fill_of(rgbd)
        with self._algorithm.errors():
            if fill == "none":
                self._show(rgbd, out)
                return out
            whole = self.with_holes
            rgbd = continued(rgbd, whole.shape)
            search, incomplete = whole._show(rgbd, out)
            sources = {ray: partial(whole._marked, search, ray) for ray in sorted(incomplete)}
            fill_holes(rgbd, self.display, self.rays, sources, out, unknown=fill == "all")
        if self.mask is not None:  # the source of a fill may be outside
            out[~self.mask] = 0
        return out

    def _show(self, rgbd: RGBD, out: np.ndarray) -> tuple[RaySearch, set[int]]:
        """Write the mean colours of the rays.

        Returns the search for their sources; with `leave_holes`, the numbers of rays with holes.
        """
        from inim.generators.raycast.colour import show_colours

        search, mask, incomplete = self._finder(rgbd), self.mask, set[int]()

        def show(ray: int, rows: slice, sources: Sources) -> None:
            search(ray, rows, sources)
            if mask is not None:
                sources[~mask[rows]] = MASKED
            is_open = self._leave_holes and ray not in incomplete and sources.min() < 0
            if is_open and (sources[self.display.lensed[rows]] == HOLE).any():
                incomplete.add(ray)

        show_colours(rgbd, self.display, self._algorithm.common.colour, self.rays, show, out)
        return search, incomplete


_A = Fraction(1, 4)
# Down and right from the centre of an area, in its height and width.
_PLACES: dict[str, tuple[tuple[Fraction, Fraction], ...]] = {
    "1": ((Fraction(0), Fraction(0)),),
    "2": ((-_A, -_A), (_A, _A)),
    "4": ((-_A, -_A), (-_A, _A), (_A, -_A), (_A, _A)),
}


def sample_points(display: Display, samples: str) -> tuple[Ray, ...]:
    """Rays of a panel pixel, or of each of its sub-pixels.

    * `samples`: see `CommonOptions`. Rays through the centres of quarters start in those of the
      emitting area (`Display.pixel_fill`).
    """
    if samples == "centre":
        return (Ray(CENTRE, (0, 1, 2)),)
    channels: dict[SubPixel, list[int]] = {}
    for channel, subpixel in enumerate(SUBPIXELS[display.subpixels]):
        place = replace(subpixel, turn=None)  # wherever it shines
        channels.setdefault(place, []).append(channel)
    fill, rays = exact_length(display.pixel_fill), []
    for subpixel, of_rays in channels.items():
        for down, right in _PLACES[str(display.layout.samples) if samples == "auto" else samples]:
            down, right = down * subpixel.height * fill, right * subpixel.width * fill
            offset = PixelOffset(down, subpixel.right + right, subpixel.channel)
            rays.append(Ray(offset, tuple(of_rays)))
    return tuple(rays)


class ImageGenerator:
    """Generator of another package that gives an image; checked, and black outside a mask."""

    def __init__(
        self, algorithm: Algorithm, generator: Generator, display: Display, mask: np.ndarray | None
    ) -> None:
        self.display, self.mask = display, mask
        self._algorithm, self._generator = algorithm, generator

    def generate(self, rgbd: RGBD, out: np.ndarray | None = None) -> np.ndarray:
        """See `Generator.generate`."""
        shape = *self.display.eia_shape, rgbd.color.shape[2]
        out = check_out(out, shape, rgbd.color.dtype)
        with self._algorithm.errors():
            eia = self._generator.generate(rgbd, out)
            check_array(eia, shape, str(rgbd.color.dtype))
            if eia is not out:  # it may keep one place to write to
                out[...] = eia
        if self.mask is not None:
            out[~self.mask] = 0
        return out


def _checked_sources(generator: SourceGenerator, rgbd: RGBD, display: Display) -> Sources:
    """Sources of another package's generator; its errors are those of the package."""
    sources = generator.sources(rgbd)
    check_array(sources, display.eia_shape, "int32")
    check_range(sources, len(rgbd.layers) * rgbd.depth_mm.size)
    return sources


def make_generator(
    algorithm: Algorithm,
    display: Display,
    shape: PictureShape,
    pixel_mm: float,
    mask: np.ndarray | None,
) -> Generator:
    """Prepare the generator of an algorithm with its options.

    Raises `UsageError`: the algorithm does not support the display or an option.
    """
    if algorithm.finds_rays:
        return RayGenerator(algorithm, display, shape, pixel_mm, mask)
    generator = _call(algorithm, display, shape, pixel_mm, mask)
    has_sources = isinstance(generator, SourceGenerator)
    if not (has_sources and type(generator).generate is SourceGenerator.generate):
        changed = [name for name, v in vars(algorithm.common).items() if v != _PLAIN[name]]
        if changed:
            raise UsageError(
                f"algorithm {algorithm.name!r} does not report its sources; omit "
                f"{' and '.join(changed)}"
            )
        return ImageGenerator(algorithm, generator, display, mask)

    def prepare(rays: PanelRays, _: object) -> SourceFinder:
        if rays.offsets != (CENTRE,):
            raise UsageError(
                f"algorithm {algorithm.name!r} has rays through the centres of pixels only; use "
                "samples=centre"
            )
        centre = generator
        if rays.shape != shape or rays.mask is not mask:
            centre = _call(algorithm, display, rays.shape, pixel_mm, rays.mask)
        return each_ray(rays, lambda rgbd, _: _checked_sources(centre, rgbd, display))

    return RayGenerator(replace(algorithm, prepare=prepare), display, shape, pixel_mm, mask)


# Options with which another package's generator shows its own colours.
_PLAIN = vars(CommonOptions())


def _call(
    algorithm: Algorithm,
    display: Display,
    shape: PictureShape,
    pixel_mm: float,
    mask: np.ndarray | None,
) -> Any:
    """Result of another package's ``prepare(display, shape, pixel_mm, **options)``."""
    options = dict(algorithm.options)
    if mask is not None and algorithm.takes_mask:
        options["mask"] = mask
    with algorithm.errors():
        generator = algorithm.prepare(display, shape, pixel_mm, **options)
    if not isinstance(generator, Generator):
        raise UsageError(
            f"algorithm {algorithm.name!r} returned a {type(generator).__name__}, which cannot "
            "generate"
        )
    return generator
