"""The study of a stream at a small size: every frame timed, and written with the rest."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from reports.bench.stream import run
from tests.conftest import small_display


def test_every_frame_is_timed_in_parts_and_every_case_has_a_row(tmp_path, monkeypatch):
    monkeypatch.setattr(run, "_MOST_FRAMES", 4)
    monkeypatch.setitem(run.PANELS, "phone", small_display())
    files = tmp_path / "color.png", tmp_path / "depth.png"
    depth = np.tile(np.linspace(4000, 6000, 96), (60, 1))  # in fifths of a millimetre
    depth[:, :9] = 0
    Image.fromarray(np.full((60, 96, 3), 200, np.uint8)).save(files[0])
    Image.fromarray(depth.astype(np.uint16)).save(files[1])
    result = run.measure(files, 5, None, "phone", run.ALGORITHMS[0])
    assert len(result["times_ms"]) == 4
    for _, fit, generate, whole, _ in result["times_ms"]:
        assert whole == pytest.approx(fit + generate)
    assert result["median"] <= result["p99"]
    assert result["goal"] == 60
    assert 0.5 < result["shown"] < 1  # rays of the outer lenses leave the picture
    (part,) = run.page({"case": result})[1]
    assert [row[0] for row in part.tables[0].rows] == ["case"]


def test_frames_move_and_keep_their_holes():
    random = np.random.default_rng(1)
    depth = np.where(random.random((40, 50)) < 0.2, 0, 1000)
    color = random.integers(0, 256, (40, 50, 3), np.uint8)
    for n, (frame_color, depth_mm) in zip(range(3), run.frames(color, depth), strict=False):
        turn = 2 * np.pi * n / 60
        move = round(20 * np.sin(turn)), round(20 * np.cos(turn))
        np.testing.assert_array_equal(frame_color, np.roll(color, move, (0, 1)))
        own = np.roll(depth == 0, move, (0, 1))
        assert (depth_mm[own] == 0).all()
        shares = (depth_mm[~own] == 0).mean(), abs(depth_mm[depth_mm > 0] - 60 * np.sin(turn))
        assert shares[0] == pytest.approx(0.01, abs=0.01)
        assert shares[1].mean() == pytest.approx(1000, abs=0.5)
        assert shares[1].std() == pytest.approx(1.5, abs=0.2)
