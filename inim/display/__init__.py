"""The display: a pixel panel under a lens array, and where an eye stands before it."""

from inim.display.display import DISPLAYS, Display
from inim.display.viewpoint import Viewpoint

__all__ = ["DISPLAYS", "Display", "Viewpoint"]
