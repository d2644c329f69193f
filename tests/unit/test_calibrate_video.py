"""Videos of the running patterns: which frames show which pattern, and one line for each mistake.

Expected: every chosen frame shows its own pattern alone, wherever the video starts, whatever its
frame rate, and if frames are missing or mixed.
"""

from pathlib import Path

import numpy as np
import pytest

from inim.calibration import video
from inim.calibration.patterns import read_positions
from inim.calibration.video import pattern_frames, read_video
from inim.errors import FileError, InimError, UsageError
from inim.image.color import srgb_from_linear, srgb_to_uint8
from tests.conftest import small_display

COUNT, PIXELS = 7, 2000
RANDOM = np.random.default_rng(5)
# Light of a pixel behind each pattern: white with dark marks, three phases of columns and of rows.
PHASES = RANDOM.uniform(0, 2 * np.pi, (2, PIXELS))
SHIFTS = np.radians([[0], [120], [240]])
PATTERNS = 0.8 * np.concatenate(
    [
        (RANDOM.random((1, PIXELS)) > 0.05).astype(float),
        *(0.5 + 0.35 * np.cos(phase - SHIFTS) for phase in PHASES),
    ]
)


def film(
    start_s: float, seconds: float, rate_hz: float, mixing_s: float = 0.01, keep: float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """Codes of the frames of a loop with a second per pattern, and the time of each frame.

    * `mixing_s`: exposure and response of the panel, a ramp from one pattern to the next.
    * `keep`: probability that a frame is not dropped.
    """
    random = np.random.default_rng(7)
    times = start_s + np.arange(int(seconds * rate_hz)) / rate_hz
    times = times[random.random(times.size) < keep]
    number, into = np.divmod(times, 1.0)
    share = np.clip(into / mixing_s, 0, 1)[:, None]
    here, before = (PATTERNS[k.astype(int) % COUNT] for k in (number, number - 1))
    light = share * here + (1 - share) * before
    light = light + random.normal(0, 0.02, light.shape)
    return srgb_to_uint8(srgb_from_linear(np.clip(light, 0, 1))), times


@pytest.mark.parametrize("start_s", [0.0, 0.97, 3.4, 6.5])
@pytest.mark.parametrize(
    ("rate_hz", "mixing_s", "keep"), [(24, 0.02, 1), (25, 0.1, 1), (60, 0.1, 1), (30, 0.02, 0.4)]
)
def test_frames_of_each_pattern_show_nothing_else(start_s, rate_hz, mixing_s, keep):
    samples, times = film(start_s, 14.5, rate_hz, mixing_s, keep)
    chosen = pattern_frames(samples, COUNT)
    assert len(chosen) == COUNT
    for k, frames in enumerate(chosen):
        assert frames.size >= 0.5 * keep * rate_hz
        into = (times[frames] - k + 0.5) % COUNT - 0.5
        assert (into < 1 + 0.3 * mixing_s).all() and (into > 0.7 * mixing_s).all(), "pure"


def test_a_round_that_starts_in_the_middle_is_enough():
    samples, times = film(3.515, 7.0, 30)
    for k, frames in enumerate(pattern_frames(samples, COUNT)):
        assert frames.size > 10 and (times[frames].astype(int) % COUNT == k).all()


def test_a_round_without_one_of_its_patterns_is_not_used():
    samples, times = film(0.015, 20.9, 30)
    dropped = (times > 9.0) & (times < 10.0)  # a wave of the second round
    samples, times = samples[~dropped], times[~dropped]
    used = np.concatenate(pattern_frames(samples, COUNT))
    assert set((times[used] // COUNT).astype(int)) == {0, 2}


def test_a_dark_page_before_and_after_is_not_a_pattern():
    samples, _ = film(0.0, 7.0, 30)
    dark = np.full((40, PIXELS), 12, np.uint8)
    chosen = pattern_frames(np.concatenate([dark, samples, dark]), COUNT)
    assert [frames.size > 20 for frames in chosen] == [True] * COUNT
    assert chosen[0].min() >= 40 and chosen[-1].max() < 40 + len(samples)


def fake_frames(monkeypatch, samples: np.ndarray) -> None:
    monkeypatch.setattr(video, "_frames", lambda _: iter(samples.reshape(-1, 40, PIXELS // 40)))


def test_the_mean_of_a_pattern_is_its_light(monkeypatch):
    fake_frames(monkeypatch, film(2.2, 15.0, 30)[0])
    lights = read_video(Path("left.mp4"), COUNT)
    for light, expected in zip(lights, PATTERNS, strict=True):
        assert np.abs(light.ravel() - expected).mean() < 0.01


@pytest.mark.parametrize("seconds", [2.5, 5.0])
def test_too_short_a_video_is_refused(monkeypatch, seconds):
    fake_frames(monkeypatch, film(0.2, seconds, 30)[0])
    with pytest.raises(FileError, match=r"left\.mp4: \d of 7 patterns are missing.*film"):
        read_video(Path("left.mp4"), COUNT)


def test_what_is_not_a_video_of_patterns_is_refused(monkeypatch, tmp_path):
    still = np.repeat(film(0.0, 0.1, 10)[0], 90, axis=0)
    fake_frames(monkeypatch, still)
    with pytest.raises(FileError, match=r"7 of 7 patterns are missing"):
        read_video(Path("still.mp4"), COUNT)
    monkeypatch.undo()
    (tmp_path / "left.mp4").write_bytes(b"no video")
    monkeypatch.setattr(video.importlib.util, "find_spec", lambda _: None)
    with pytest.raises(UsageError, match=r"left\.mp4: a video needs imageio-ffmpeg; pip install"):
        read_positions(tmp_path, small_display(30, 24, 17))


def test_a_file_is_decoded_frame_by_frame_and_a_damaged_one_is_named(tmp_path):
    encoder = pytest.importorskip("imageio_ffmpeg")
    (tmp_path / "left.mp4").write_bytes(b"no video")
    with pytest.raises(InimError, match=r"left\.mp4: not a video that ffmpeg can read"):
        read_positions(tmp_path, small_display(30, 24, 17))
    # Lenses of 16 x 16 pixels, which an encoder keeps.
    samples, _ = film(1.3, 15.0, 25)
    frames = samples.reshape(-1, 40, 50)[:, :8, :10].repeat(16, axis=1).repeat(16, axis=2)
    path = tmp_path / "left.mp4"
    writer = encoder.write_frames(str(path), (160, 128), fps=25, quality=8, macro_block_size=2)
    writer.send(None)
    for frame in frames:
        writer.send(np.repeat(frame[..., None], 3, axis=2).copy())
    writer.close()
    (position,) = read_positions(tmp_path, small_display(30, 24, 17))
    assert (position.name, position.shape) == ("left", (128, 160))
    for light, expected in zip(read_video(path, COUNT), PATTERNS, strict=True):
        inner = light[8::16, 8::16]
        truth = expected.reshape(40, 50)[:8, :10]
        assert np.abs(inner - truth).mean() < 0.02
