"""Layered depth images: RGB-D pictures with what lies behind their front surface.

After Shade et al., Layered depth images, SIGGRAPH 1998; a layer here also has a back.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from inim.errors import UsageError
from inim.rgbd.rgbd import RGBD

__all__ = ["Layer", "LayeredRGBD"]


@dataclass(frozen=True)
class Layer:
    """One more surface behind those before it, with the solid that it begins.

    Attributes
    ----------
    color : (H, W, channels)
        As in the picture.
    front_mm, back_mm : (H, W) float32
        Where the solid begins and ends, ``back_mm <= front_mm``.
    covered : (H, W) bool
        Where there is such a layer.
    """

    color: np.ndarray
    front_mm: NDArray[np.float32]
    back_mm: NDArray[np.float32]
    covered: NDArray[np.bool_]


@dataclass(frozen=True)
class LayeredRGBD(RGBD):
    """A layered depth image, whose columns are solid from each front only down to its back.

    To a generator that knows no layers it is the RGB-D picture of its front surface.

    Parameters
    ----------
    color, depth_mm, covered, pixel_mm :
        The front surface, as in `RGBD`.
    back_mm : (H, W) float32
        Where the solid behind the front surface ends; -inf: never.
    deeper : tuple of Layer
        What follows behind it, nearest first. A pixel covered in one is covered in all before it.

    Raises
    ------
    UsageError
        As `RGBD`; a back in front of its front, or a layer without or in front of the one before
        it.
    """

    back_mm: NDArray[np.float32]
    deeper: tuple[Layer, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "back_mm", np.array(self.back_mm, np.float32))
        object.__setattr__(self, "deeper", tuple(self.deeper))
        above, before = self.covered, self.layers[0]
        for number, layer in enumerate(self.layers):
            if layer.color.shape != self.color.shape or layer.color.dtype != self.color.dtype:
                raise UsageError(
                    f"LayeredRGBD: layer {number} has {layer.color.dtype} colours of shape "
                    f"{layer.color.shape}; the picture's are {self.color.dtype} "
                    f"{self.color.shape}"
                )
            for name in ("front_mm", "back_mm", "covered"):
                if getattr(layer, name).shape != self.shape:
                    raise UsageError(
                        f"LayeredRGBD: layer {number}: {name} of shape "
                        f"{getattr(layer, name).shape}; the picture has {self.shape}"
                    )
            front, back = layer.front_mm[layer.covered], layer.back_mm[layer.covered]
            if not (back <= front).all():
                raise UsageError(
                    f"LayeredRGBD: layer {number}: {np.count_nonzero(~(back <= front))} pixels "
                    "have a back in front of their front"
                )
            if (layer.covered & ~above).any():
                raise UsageError(
                    f"LayeredRGBD: layer {number} covers pixels that the layer before it does not"
                )
            if number and (front > before.front_mm[layer.covered]).any():
                raise UsageError(
                    f"LayeredRGBD: layer {number} begins in front of the layer before it"
                )
            above, before = layer.covered, layer

    @property
    def layers(self) -> tuple[Layer, ...]:
        """All layers, the front surface first."""
        return (Layer(self.color, self.depth_mm, self.back_mm, self.covered), *self.deeper)

    @cached_property
    def palette(self) -> np.ndarray:
        """The colours of all layers one below the other, (layers x H, W, channels)."""
        return np.concatenate([layer.color for layer in self.layers])
