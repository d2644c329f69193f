"""Layouts of lens arrays, one file each; `Display.layout` is a display's own."""

from inim.display.layouts.hexagonal import Hexagonal
from inim.display.layouts.layout import NUMPY_OPS, Layout, LensAxis, Ops
from inim.display.layouts.lenticular import Lenticular
from inim.display.layouts.square import Square

#: Layouts by the display's parameter `lattice`.
LAYOUTS: dict[str, type[Layout]] = {
    layout.name: layout for layout in (Square, Hexagonal, Lenticular)
}

__all__ = ["LAYOUTS", "NUMPY_OPS", "Layout", "LensAxis", "Lenticular", "Ops", "Square"]
