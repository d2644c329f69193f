"""Colour and depth pictures, of one layer or of several."""

from inim.rgbd.layered import Layer, LayeredRGBD
from inim.rgbd.rgbd import RGBD

__all__ = ["RGBD", "Layer", "LayeredRGBD"]
