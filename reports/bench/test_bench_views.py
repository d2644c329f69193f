"""The study of views at a small size: every model timed and scaled, and written with the rest."""

from __future__ import annotations

import numpy as np
import pytest

from inim.pipeline.timing import Rounds
from reports.bench.views.run import RECTANGLE, bench_views, page, textured_rectangle
from tests.conftest import small_display

pytestmark = pytest.mark.usefixtures("renderer")


@pytest.fixture(scope="module")
def views(renderer):
    return bench_views(Rounds(runs=3, warmups=1), 4, 4, spp=16, full_spp=4)


def test_every_lens_model_is_timed_in_turn_with_the_rectangle(views):
    names = [c["name"] for c in views["algorithms"]]
    assert names == [RECTANGLE, "pinhole", "thin", "thick", "full"]
    assert [c["spp"] for c in views["algorithms"]] == [16, 16, 16, 16, 4]
    assert views["algorithms"][0]["ratio"] == 1


def test_times_are_those_of_equal_samples_and_of_equal_noise(views):
    algorithms = {c["name"]: c for c in views["algorithms"]}
    base = algorithms[RECTANGLE]["median_ms"]
    for c in algorithms.values():
        assert c["view_ms"] == pytest.approx(c["median_ms"] * 16 / c["spp"])
    full, thick = algorithms.pop("full"), algorithms["thick"]
    for c in algorithms.values():
        assert c["ratio"] == pytest.approx(c["view_ms"] / base)
        assert c["thick_ratio"] == pytest.approx(c["view_ms"] / thick["view_ms"])
    # Timed apart, in turn with `thick`; by way of it to the rectangle.
    assert full["ratio"] == pytest.approx(full["thick_ratio"] * thick["ratio"])
    assert full["noise"] > thick["noise"] > 0, "faces that reflect by chance add noise"
    share = (full["noise"] / thick["noise"]) ** 2
    assert full["equal_noise_ms"] == pytest.approx(full["view_ms"] * share)


def test_the_views_have_a_table_on_the_page(views):
    ((table,),) = (part.tables for part in page({"views": views})[1])
    assert [row[0] for row in table.rows] == [RECTANGLE, "pinhole", "thin", "thick", "full"]


def test_the_rectangle_shows_its_picture_upright():
    display = small_display(7, 5)
    letter = np.zeros((5, 7, 3), np.float32)
    letter[:, 1] = letter[0, 1:5] = letter[2, 1:4] = 1.0  # an F: no symmetry at all
    view = textured_rectangle(letter, display, 100.0, 4, 4)(0)
    middle = view.reshape(5, 4, 7, 4, 3)[:, 1:3, :, 1:3].mean(axis=(1, 3))
    assert np.allclose(middle, letter, atol=1e-6)
