"""Compile the generators' kernels in a process of their own while the worker loads and renders.

A first run compiles for seconds, on one processor and mostly in Python. The child process makes the
EIA of a small picture with each algorithm, by which numba keeps the kernels on its way; the worker
finds them there. It changes no result and is never an error: what it lacks, the worker compiles.
"""

from __future__ import annotations

import pickle
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import numpy as np

from inim.errors import InimError
from inim.generators import is_own, parse_algorithm, properties
from inim.image.rgbd import RGBD, Layer, LayeredRGBD
from inim.pipeline.compiled_marks import compiling, is_compiled
from inim.pipeline.plan import Plan
from inim.pipeline.stages.generate import GeneratorHandle
from inim.process.machine import cpu_count
from inim.process.python_process import (
    child_environment,
    end_process,
    exit_with_parent,
    python_module,
)
from inim.regression import reference_input

# Small panels take other kernels than large ones, which these are enough for.
_LENSES = 64


@contextmanager
def compiling_ahead(plan: Plan) -> Iterator[None]:
    """Compile a plan's generators in a child process, which ends with the block.

    None is started where nothing is to be gained: on one processor, where memory is short, of a
    panel that is made in part, and where all has been compiled before. Other packages' algorithms
    are run by nobody but the worker.
    """
    job = _job(plan)
    if not job:
        yield
        return
    child = subprocess.Popen(
        python_module("inim.pipeline.compile_ahead"),
        env=child_environment(),
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    assert child.stdin is not None
    try:
        with suppress(OSError):  # it has died already
            child.stdin.write(job)
            child.stdin.flush()
        yield
    finally:
        end_process(child)
        with suppress(OSError):
            child.stdin.close()


def _job(plan: Plan) -> bytes:
    """What the child is given; empty where it has nothing to do."""
    if cpu_count() < 2 or plan.is_short_of_memory or plan.request.lazy:
        return b""
    own = [m.name for m in plan.methods if m.times and is_own(parse_algorithm(m.name)[0])]
    new = [name for name in own if not is_compiled(name, plan.display)]
    lenses = {n: min(_LENSES, getattr(plan.display, n)) for n in ("lens_rows", "lens_columns")}
    try:
        small = plan.display.replace(**lenses, panel_rows=None, panel_columns=None)
    except InimError:
        return b""
    return pickle.dumps((small, plan.settings.capture_pixels_per_pitch, new)) if new else b""


def _compile() -> None:
    """The child's whole life."""
    display, pixels_per_pitch, algorithms = pickle.load(sys.stdin.buffer)
    exit_with_parent()
    shape = display.capture_shape(pixels_per_pitch)
    pixel_mm = display.capture_pixel_mm(pixels_per_pitch)
    picture = reference_input(display, shape, pixel_mm)
    for name in algorithms:
        with compiling(name, display) as mine:
            if mine:
                layers = properties(name).reads_layers
                rgbd = _of_two_layers(picture) if layers else picture
                GeneratorHandle(name, display, shape, pixel_mm).run(rgbd)


def _of_two_layers(rgbd: RGBD) -> LayeredRGBD:
    """A picture whose surface is a sheet before another one."""
    front, covered = rgbd.depth_mm, rgbd.covered
    behind = Layer(rgbd.color, front - 2, np.full_like(front, -np.inf), covered)
    return LayeredRGBD(rgbd.color, front, covered, rgbd.pixel_mm, front - 1, (behind,))


if __name__ == "__main__":
    _compile()
