"""Fixtures shared by all tiers."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from inim.display import Display
from inim.display.settings import plain_parameters
from inim.system.process.machine import user_cache_folder

LIT = """
<integrator type="path"><integer name="max_depth" value="2"/></integrator>
<sensor type="perspective">
    <transform name="to_world"><lookat origin="0,0,100" target="0,0,0" up="0,1,0"/></transform>
</sensor>
<emitter type="directional">
    <vector name="direction" value="0,0,-1"/><rgb name="irradiance" value="2.5"/>
</emitter>
"""


# Tests make what they test: what earlier runs found would hide a change. Those of the result
# cache name a folder of their own.
os.environ["INIM_CACHE"] = "off"
# All tests share compiled kernels, also those with a home of their own.
if user_cache := user_cache_folder():
    os.environ.setdefault("NUMBA_CACHE_DIR", str(user_cache / "kernels"))


def scene_text(*shapes: str) -> str:
    """A scene lit straight from the viewer: no noise but that of the pixel's area."""
    return f'<scene version="3.0.0">{LIT}{"".join(shapes)}</scene>'


def square(centre: tuple[float, float, float], half: float | tuple[float, float], rgb: str) -> str:
    """A flat square facing the viewer."""
    half_x, half_y = (half, half) if isinstance(half, (int, float)) else half
    x, y, z = centre
    return f"""<shape type="rectangle">
        <transform name="to_world"><scale x="{half_x}" y="{half_y}"/>
        <translate x="{x}" y="{y}" z="{z}"/></transform>
        <bsdf type="diffuse"><rgb name="reflectance" value="{rgb}"/></bsdf></shape>"""


def sphere(centre: tuple[float, float, float], radius: float, rgb: str = "0.8") -> str:
    """A diffuse sphere."""
    x, y, z = centre
    return f"""<shape type="sphere"><point name="center" x="{x}" y="{y}" z="{z}"/>
        <float name="radius" value="{radius}"/>
        <bsdf type="diffuse"><rgb name="reflectance" value="{rgb}"/></bsdf></shape>"""


def small_display(columns: int = 12, rows: int = 10, pixels: int = 8, **changes: object) -> Display:
    """A display small enough to render in a blink: 1 mm lenses of a whole number of pixels."""
    values: dict[str, object] = {
        "pitch_mm": 1.0, "focal_length_mm": 3.0, "gap_mm": 3.3, "pixel_pitch_mm": 1.0 / pixels,
        "lens_columns": columns, "lens_rows": rows,
    }  # fmt: skip
    return Display(**(values | changes))  # type: ignore[arg-type]


def box_surface() -> tuple[np.ndarray, np.ndarray]:
    """Corners and triangles of a cube from 0 to 1, outwards, corners shared."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float32)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))]
    return corners, np.array(faces, np.uint32)


def display_shape(eia: np.ndarray, display: Display, lens_model: str) -> dict[str, Any]:
    """The scene dictionary of a display showing an EIA, in a world that is the display frame."""
    import mitsuba as mi

    parameters = plain_parameters(display)
    picture = mi.TensorXf(np.ascontiguousarray(eia, np.float32))
    return {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().scale([*display.half_extent_mm, 1]),
        "emitter": {"type": "inim_display", "eia": picture, "lens_model": lens_model, **parameters},
    }


def run_python(code: str, *words: str | Path, folder: Path | None = None) -> str:
    """Output of code in a fresh interpreter, which succeeds."""
    ended = subprocess.run(
        [sys.executable, "-c", code, *words], cwd=folder, capture_output=True, text=True,
        timeout=180, check=False,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr
    return ended.stdout.strip()


@pytest.fixture(scope="session")
def renderer() -> object:
    """The renderer with a variant set; tests that render ask for it."""
    from inim.render import variant

    return variant.use()


@pytest.fixture
def open_fitted(renderer: object, tmp_path: Path):
    """Open scene text fitted to a display."""
    from inim.render.scene import open_scene
    from inim.render.scene_files.file import read_scene_file

    def opened(text: str, display: Display, fit_share: float = 0.85):
        path = tmp_path / "scene.xml"
        path.write_text(text, encoding="utf-8")
        return open_scene(read_scene_file(path), display, fit_share)

    return opened
