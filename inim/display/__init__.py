"""The display: a pixel panel under a lens array, and the viewpoints in front of it."""

from inim.display.display import Display
from inim.display.presets import DISPLAYS
from inim.display.viewpoint import Viewpoint

__all__ = ["DISPLAYS", "Display", "Viewpoint"]
