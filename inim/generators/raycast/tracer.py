"""First hits of several rays of every pixel, traced in one picture at a time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from inim.display import Display
from inim.display.pixels import CENTRE, PixelOffset
from inim.generators.base import PictureShape, Search, SourceGenerator, Sources
from inim.image.rgbd import RGBD

#: Writes the sources of one ray, by its number, of a slice of panel rows; see `Search`.
RaySearch = Callable[[int, slice, Sources], None]


class Tracer(ABC):
    """Rays of every pixel, which hit the columns of pictures.

    * `display`, `shape`, `pixel_mm`, `mask`: as for `SourceGenerator`.
    * `rule`: see `raycast.columns`.
    * `offsets`: start of each ray in its pixel.
    """

    def __init__(
        self,
        display: Display,
        shape: PictureShape,
        pixel_mm: float,
        rule: str,
        offsets: Sequence[PixelOffset] = (CENTRE,),
        mask: np.ndarray | None = None,
    ) -> None:
        self.display, self.shape, self.pixel_mm = display, shape, pixel_mm
        self.rule, self.offsets, self.mask = rule, tuple(offsets), mask

    def rays(self) -> list[SourceGenerator]:
        """Generators of the first hits of each ray."""
        return [_FirstHits(self, number) for number in range(len(self.offsets))]

    @abstractmethod
    def take(self, rgbd: RGBD) -> RaySearch:
        """Prepare a picture for all rays; the next one takes its place."""


class _FirstHits(SourceGenerator):
    """First hits of one ray of a tracer."""

    def __init__(self, tracer: Tracer, number: int) -> None:
        super().__init__(
            tracer.display, tracer.shape, tracer.pixel_mm, tracer.mask, tracer.offsets[number]
        )
        self._tracer, self._number = tracer, number

    def find(self, rgbd: RGBD) -> Sources:
        """See `SourceGenerator.find`."""
        sources = np.empty(self.display.eia_shape, np.int32)
        self._tracer.take(rgbd)(self._number, slice(0, len(sources)), sources)
        return sources

    def search(self, rgbd: RGBD) -> Search:
        """See `SourceGenerator.search`."""
        return self._marked(self._tracer.take(rgbd))

    def search_all(self, rays: Sequence[SourceGenerator], rgbd: RGBD) -> list[Search]:
        """See `SourceGenerator.search_all`: a tracer takes the picture once."""
        own = [ray for ray in rays if isinstance(ray, _FirstHits) and ray._tracer is self._tracer]
        if len(own) < len(rays):
            return super().search_all(rays, rgbd)
        find_rows = self._tracer.take(rgbd)
        return [ray._marked(find_rows) for ray in own]

    def _marked(self, search: RaySearch) -> Search:
        if self.mask is None:
            return partial(search, self._number)

        def find_rows(rows: slice, out: Sources) -> None:
            search(self._number, rows, out)
            self.mark(rows, out)

        return find_rows
