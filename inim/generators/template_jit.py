"""`template_jit`: the first hits of `inim.generators.template`, bit for bit, compiled by Dr.Jit.

For GPUs, and, through LLVM, for checking on any machine: see `inim.render.template_jit`.
"""

from __future__ import annotations

from importlib import import_module

from inim.display import Display
from inim.errors import UsageError
from inim.generators.base import PictureShape, SourceGenerator, require_separable
from inim.generators.registry import algorithm


@algorithm()
def prepare(display: Display, shape: PictureShape, pixel_mm: float) -> SourceGenerator:
    """Exact first hits, compiled by Dr.Jit: on the GPU where there is one.

    Runs on the backend whose variant is active; if none is, on CUDA where it works, else on LLVM.

    Parameters
    ----------
    display, shape, pixel_mm :
        See `inim.generators.prepare`.

    Raises
    ------
    BackendError
        Dr.Jit has no backend that works on this machine.
    UsageError
        A display whose pixels are not separable, or have sub-pixels.
    """
    require_separable(display, "template_jit")
    if display.subpixels != "none":
        raise UsageError(
            f"template_jit: shows whole pixels, and this display has subpixels = "
            f"{display.subpixels!r}; use template"
        )
    # By name: only the rooms above this one may import the renderer.
    engine = import_module("inim.render.template_jit")
    made: SourceGenerator = engine.prepare(display, shape, pixel_mm)
    return made
