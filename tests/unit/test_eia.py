"""The axis order of an elemental image array, in every direction."""

from __future__ import annotations

import numpy as np
import pytest

from inim.display import Display
from inim.display.elemental_images import elemental_images, sub_aperture_view
from inim.errors import UsageError

SHOWN = Display(
    pitch_mm=1.0,
    focal_length_mm=3.0,
    gap_mm=3.3,
    pixel_pitch_mm=1 / 5,
    lens_columns=4,
    lens_rows=3,
)
EIA = np.random.default_rng(1).random((15, 20, 3), np.float32)


def test_axes_are_lens_row_pixel_row_lens_column_pixel_column_colour() -> None:
    images = elemental_images(EIA, SHOWN)
    assert images.shape == (3, 5, 4, 5, 3)
    assert np.array_equal(images[2, 1, 3, 4], EIA[2 * 5 + 1, 3 * 5 + 4])
    assert np.array_equal(images[1, :, 2], EIA[5:10, 10:15])


def test_elemental_images_agree_with_where_the_display_puts_its_lenses() -> None:
    lens = SHOWN.rows.lens[:, None] * 4 + SHOWN.columns.lens
    images = elemental_images(lens, SHOWN)
    for m in range(3):
        for n in range(4):
            assert (images[m, :, n] == m * 4 + n).all()


@pytest.mark.parametrize("eia", [EIA, EIA[::-1], np.asfortranarray(EIA), EIA[:, :, 0]])
def test_elemental_images_are_a_view(eia: np.ndarray) -> None:
    assert np.shares_memory(elemental_images(eia, SHOWN), eia)
    assert np.shares_memory(sub_aperture_view(eia, SHOWN, 1, 2), eia)


def test_sub_aperture_view_takes_one_pixel_of_every_lens() -> None:
    view = sub_aperture_view(EIA, SHOWN, 1, 4)
    assert view.shape == (3, 4, 3)
    assert np.array_equal(view, EIA[1::5, 4::5])
    assert np.array_equal(sub_aperture_view(EIA[..., 0], SHOWN, 1, 4), EIA[1::5, 4::5, 0])


def test_array_of_another_display_is_refused() -> None:
    with pytest.raises(UsageError, match=r"EIA of 15 x 19 pixels; display custom has 15 x 20"):
        elemental_images(EIA[:, :19], SHOWN)


@pytest.mark.parametrize(
    "changes", [{"pixel_pitch_mm": 0.0636}, {"panel_columns": 22}, {"panel_rows": 14}]
)
def test_display_without_common_elemental_images_is_refused(changes: dict[str, float]) -> None:
    shown = SHOWN.replace(**changes)
    with pytest.raises(UsageError, match="no common shape"):
        elemental_images(np.zeros((*shown.eia_shape, 3)), shown)
