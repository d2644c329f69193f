"""Films: where the eye goes, and what is written."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageSequence

from inim.display.viewpoint import default_distance_mm, eye_path, zone_eyes
from inim.errors import FileError, UsageError, ViewpointError
from inim.views.film import write_film
from tests.conftest import small_display

DISPLAY = small_display(24, 20, 17)
COLORS = [(200, 30, 30), (30, 200, 30), (30, 30, 200), (220, 220, 30)]


def places(text: str, count: int) -> np.ndarray:
    return np.array([eye.position_mm for eye in eye_path(text, DISPLAY, count)])


def test_circle_stays_at_one_share_of_the_zone_and_closes():
    at = places("circle", 36)
    distance = default_distance_mm(DISPLAY)
    assert (at[:, 2] == distance).all()
    limits = np.array(DISPLAY.flip_limit_mm(distance))
    np.testing.assert_allclose(np.hypot(*(at[:, :2] / limits).T), 0.75)
    steps = np.arctan2(*(at[:, :2] / limits).T)
    turned = np.diff(np.unwrap([*steps, steps[0]]))
    np.testing.assert_allclose(turned, 2 * np.pi / 36)


def test_a_path_there_and_back_has_even_steps():
    at = places("-10 0 200, 10 0 200", 8)
    assert at[:, 0].tolist() == [-10, -5, 0, 5, 10, 5, 0, -5]
    assert (at[:, 1:] == [0, 200]).all()
    bent = places("0 0 200, 6 0 200, 6 6 200", 24)
    np.testing.assert_allclose(np.linalg.norm(np.diff(bent, axis=0), axis=1), 1.0)


def test_positions_without_a_distance_use_the_default():
    assert set(places("-1 0, 1 0", 4)[:, 2]) == {default_distance_mm(DISPLAY)}


@pytest.mark.parametrize("text", ["", "square", "1 2", "1 2 3 4, 0 0", "a b, 0 0", "0 0,"])
def test_path_that_cannot_be_read_is_refused(text):
    with pytest.raises(UsageError, match="--path"):
        eye_path(text, DISPLAY, 4)


def test_path_out_of_the_viewing_zone_is_refused():
    with pytest.raises(ViewpointError, match="outside the viewing zone"):
        eye_path("0 0 200, 90 0 200", DISPLAY, 4)
    assert eye_path("0 0 200, 90 0 200", DISPLAY, 4, allow_flips=True)[2].position_mm[0] == 90
    with pytest.raises(ViewpointError, match="inside the picture"):
        eye_path("0 0 2, 90 0 2", DISPLAY, 4, allow_flips=True)


@pytest.mark.parametrize("distance", [0.0, -5.0, float("nan"), 2.0])
def test_no_zone_is_seen_from_no_distance(distance):
    with pytest.raises(ViewpointError, match=r"middle: .*(z > 0|inside the picture)"):
        zone_eyes(DISPLAY, 5, distance)


def frames() -> list[np.ndarray]:
    return [np.full((32, 48, 3), color, np.uint8) for color in COLORS]


@pytest.mark.parametrize("kind", [".gif", ".webp"])
def test_film_has_its_frames_in_order_at_their_rate(tmp_path, kind):
    path = tmp_path / f"film{kind}"
    write_film(path, frames(), 20)
    with Image.open(path) as film:
        film_frames = [
            (f.convert("RGB").getpixel((9, 9)), f.info) for f in ImageSequence.Iterator(film)
        ]
    assert len(film_frames) == 4
    for (color, info), expected in zip(film_frames, COLORS, strict=True):
        np.testing.assert_allclose(color, expected, atol=6)
        assert info.get("duration") == 50
        assert info.get("loop", 0) == 0


def test_gif_is_never_faster_than_players_believe(tmp_path):
    write_film(tmp_path / "film.gif", frames(), 100)
    with Image.open(tmp_path / "film.gif") as film:
        assert film.info["duration"] == 20


def test_mp4_without_its_encoder_names_the_line_to_type(tmp_path, monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda n: None if n == "imageio_ffmpeg" else find(n)
    )
    with pytest.raises(UsageError, match="pip install imageio-ffmpeg"):
        write_film(tmp_path / "film.mp4", frames(), 20)


def test_mp4_gives_its_encoder_every_frame(tmp_path, monkeypatch):
    """The encoder is a stand-in that keeps what it is sent."""
    folder = tmp_path / "modules"
    folder.mkdir()
    (folder / "imageio_ffmpeg.py").write_text(
        "def write_frames(path, size, fps, **rest):\n"
        "    with open(path, 'wb') as file:\n"
        "        file.write(f'{size} {fps} '.encode())\n"
        "        while True:\n"
        "            frame = yield\n"
        "            file.write(bytes(frame.ravel()[:3]))\n"
    )
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.delitem(sys.modules, "imageio_ffmpeg", raising=False)
    write_film(tmp_path / "film.mp4", frames(), 25)
    sent = (tmp_path / "film.mp4").read_bytes()
    assert sent == b"(48, 32) 25 " + bytes(v for color in COLORS for v in color)
    sys.modules.pop("imageio_ffmpeg", None)


def test_film_that_cannot_be_written_is_a_file_error(tmp_path):
    with pytest.raises(FileError, match="cannot be written"):
        write_film(Path(tmp_path / "none" / "film.gif"), frames(), 20)
