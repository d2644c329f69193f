"""A turned relic, `inim.turn_deg`.

Expected: it gives the EIA of a relic whose file is turned; a whole turn is none; the relic keeps
its size.
"""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from inim.render import ground_truth
from inim.system.errors import SceneError
from tests.conftest import scene_text, small_display
from tests.splat_relics import random_splats, splat_scene
from tests.system.conftest import (
    TINY,
    definitions,
)

DISPLAY = small_display(16, 12, 8)
QUICK = definitions(TINY | {"inim.lens_model": "pinhole", "inim.pixel_pitch_mm": "0.125"})


def vane(turn_deg: float = 0.0) -> trimesh.Trimesh:
    """Two crossed plates of unequal size, whose bounding box stays centred at every turn."""
    plates = [trimesh.creation.box((4, 2, 0.4)), trimesh.creation.box((0.4, 3, 1.5))]
    mesh = trimesh.util.concatenate(plates)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.radians(20), (0, 1, 0)))
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.radians(turn_deg), (0, 1, 0)))
    return mesh


def mesh_scene(folder: Path, mesh: trimesh.Trimesh) -> str:
    mesh.export(folder / "vane.ply")
    return scene_text('<shape type="ply"><string name="filename" value="vane.ply"/></shape>')


@pytest.fixture
def turned(open_fitted, renderer, tmp_path):
    """The fitted scene of a text at a turn."""
    from inim.render.scene import open_scene
    from inim.render.scene_files.file import read_scene_file

    def opened(text: str, turn_deg: float | None):
        path = tmp_path / "scene.xml"
        path.write_text(text, encoding="utf-8")
        return open_scene(read_scene_file(path), DISPLAY, 0.85, turn_deg=turn_deg)

    return opened


def eia_of(fitted) -> np.ndarray:
    return ground_truth.pickup(fitted, DISPLAY, spp=16, seed=3).image


def test_turned_relic_gives_the_eia_of_its_turned_file(turned, tmp_path):
    """Coordinates of the two differ by rounding, which decides samples at outlines only."""
    text = mesh_scene(tmp_path, vane())
    own = eia_of(turned(text, 55))
    other = eia_of(turned(mesh_scene(tmp_path, vane(55)), 0))
    backwards = eia_of(turned(text, -55))
    assert (abs(own - other) > 1e-3).mean() < 1e-3 < 0.1 < (own > 0).mean()
    assert (abs(backwards - other) > 1e-3).mean() > 0.05


def test_whole_turn_is_none_and_the_relic_keeps_its_place(turned, tmp_path):
    text = mesh_scene(tmp_path, vane())
    first = turned(text, 0)
    assert np.array_equal(eia_of(first), eia_of(turned(text, 360)))
    low, high = DISPLAY.depth_range_mm
    for angle in (0, 33, 90, 200):
        fitted = turned(text, angle)
        np.testing.assert_array_equal(fitted.fit.display_from_world, first.fit.display_from_world)
        corners = vane(angle).vertices @ fitted.fit.display_from_world[:3, :3].T
        corners += fitted.fit.display_from_world[:3, 3]
        assert low < corners[:, 2].min() and corners[:, 2].max() < high
        assert np.all(abs(corners[:, :2]) <= DISPLAY.half_extent_mm)
    # The radius of the plate's corners fills the width, as no bounding box would.
    radius = np.hypot(2, 0.2)
    limits = 0.85 * DISPLAY.width_mm / (2 * radius), 0.85 * DISPLAY.height_mm / 3
    assert first.fit.scale_xy == pytest.approx(min(limits), rel=1e-5)


def test_splats_are_refused(turned, tmp_path):
    with pytest.raises(SceneError, match="splats do not turn"):
        turned(splat_scene(tmp_path, random_splats(20)), 10)
