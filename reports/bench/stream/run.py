"""Panel pictures per second from a depth camera's stream, end to end in one process.

    python -m reports.bench.stream.run --data DATA -o reports/bench/stream

There is no recording: each sequence is one real picture of a depth camera, with its own holes and
noise, which is moved, and gets further noise and holes in every frame.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import inim
from inim.apps.bench.page import milliseconds
from inim.apps.own_picture.missing_depth import fill_missing_depth
from inim.report.labels import MISSING, number, per_cent
from inim.report.study import PagePart
from reports.bench.study import doubts, square_display
from reports.study import CODE, Results, Study, entry, table

_CAMERA = 525.0, 525.0, 319.5, 239.5
_REDWOOD = "redwood_00000.color.jpg", "redwood_00000.depth.png"
#: Colour, depth, depth units per millimetre, and intrinsics.
SEQUENCES: dict[str, tuple[str, str, int, tuple[float, ...] | None]] = {
    "redwood": (*_REDWOOD, 1, _CAMERA),
    "redwood, parallel rays": (*_REDWOOD, 1, None),
    "TUM": ("TUM_color.png", "TUM_depth.png", 5, _CAMERA),
}
PANELS = {"phone": inim.DISPLAYS["phone"], "4080 × 4080": square_display(240)}
ALGORITHMS = ("template:samples=1:colour=nearest", "template", "template:fill=none")
#: Pictures per second to reach on two cores.
GOALS = {("phone", ALGORITHMS[0]): 60, ("phone", ALGORITHMS[1]): 15}
# Of a frame: movement in pixels and mm, noise in mm at 1 m, share of further holes.
_MOVED_PX, _MOVED_MM, _NOISE_MM, _HOLES = 20, 60, 1.5, 0.01
# A sequence ends after so many frames; or after so many seconds, with at least so many frames.
_MOST_FRAMES, _MOST_S, _LEAST_FRAMES = 120, 20, 20


def frames(color: np.ndarray, depth: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Frames of a camera, (H, W, 3) uint8 and (H, W) uint16 in mm, made of one picture."""
    random = np.random.default_rng(0)
    for turn in 2 * np.pi / 60 * np.arange(_MOST_FRAMES):
        move = round(_MOVED_PX * np.sin(turn)), round(_MOVED_PX * np.cos(turn))
        moved_color, moved = np.roll(color, move, (0, 1)), np.roll(depth, move, (0, 1))
        empty = (moved == 0) | (random.random(moved.shape) < _HOLES)
        noise = _NOISE_MM * (moved / 1000) ** 2 * random.standard_normal(moved.shape)
        mm = np.rint(moved + noise + _MOVED_MM * np.sin(turn)).clip(1)
        yield moved_color, np.where(empty, 0, mm).astype(np.uint16)


def measure(
    files: tuple[Path, Path], units: int, intrinsics: Any, panel: str, algorithm: str
) -> dict[str, Any]:
    """Milliseconds of each frame; the first one includes the fit of all frames and the tables."""
    with Image.open(files[0]) as color, Image.open(files[1]) as depth:
        picture = np.asarray(color.convert("RGB")), np.asarray(depth) // units
    display, fit, times, began = PANELS[panel], None, [], time.perf_counter()
    out = np.empty((*display.eia_shape, 4), np.uint8)
    for frame_color, depth_mm in frames(*picture):
        start, busy = time.perf_counter(), time.process_time()
        fit = fit or inim.CameraFit(display, depth_mm, intrinsics=intrinsics)
        rgbd = fit.picture(frame_color, depth_mm)
        fitted = time.perf_counter()
        inim.generate(rgbd, display, algorithm, out=out)
        end, busy = time.perf_counter(), time.process_time() - busy
        depth_or_nan = np.where(depth_mm > 0, depth_mm, np.nan).astype(np.float32)
        filling = time.perf_counter()
        fill_missing_depth(depth_or_nan, "behind")  # once more, to time this part of the fit
        fill = time.perf_counter() - filling
        times.append([1e3 * s for s in (fill, fitted - start, end - fitted, end - start, busy)])
        if end - began > _MOST_S and len(times) >= _LEAST_FRAMES:
            break
    names, whole = ("fill", "fit", "generate", "median", "processor"), np.array(times[1:])[:, 3]
    return dict(zip(names, np.median(times[1:], axis=0).tolist(), strict=True)) | {
        "p99": float(np.quantile(whole, 0.99)), "first": times[0][3],
        "rate": 1e3 / float(whole.mean()), "shown": float((out[..., 3] > 0).mean()),
        "goal": GOALS.get((panel, algorithm)), "times_ms": times,
    }  # fmt: skip


def page(results: Results) -> tuple[list[str], list[PagePart]]:
    """Remarks and the table of the cases."""
    remarks = [
        f"One real picture of 640 x 480 pixels makes up to {_MOST_FRAMES} frames, or those of "
        f"{_MOST_S} s. It moves by up to {_MOVED_PX} pixels and {_MOVED_MM} mm, with its own holes "
        f"and noise. Each frame has further noise of {_NOISE_MM} mm at 1 m, which grows with the "
        f"square of depth, and {_HOLES:.0%} holes.",
        "A panel picture is timed from the camera's arrays to the panel's buffer, in one process: "
        "`inim.CameraFit.picture`, which also fills missing depth, and `inim.generate` with `out`. "
        "`template` also fills hidden regions if the picture fills its frame.",
    ]
    parts = ("fill", "fit", "generate", "median", "p99", "first", "processor")
    columns = {
        "camera, panel, algorithm": lambda row: row[0],
        **{f"{part}, ms": entry(1, part, text=milliseconds) for part in parts},
        "panel shown": entry(1, "shown", text=lambda share: per_cent(share, 0)),
        "pictures per second": entry(1, "rate", text=lambda rate: number(rate, 1)),
        "goal": entry(1, "goal", text=lambda goal: str(goal or MISSING)),
    }
    caption = "Medians; fit contains fill; 99th percentile and first picture of the whole"
    panels = table(caption, results.items(), columns)
    return remarks, [PagePart("stream", "Panel pictures", caption, [panels])]


def _cases(args: argparse.Namespace) -> dict[str, dict[str, Any]]:
    return {
        f"{name}, {panel}, {algorithm}": {
            "files": (args.data / color, args.data / depth), "units": units,
            "intrinsics": intrinsics, "panel": panel, "algorithm": algorithm,
        }
        for name, (color, depth, units, intrinsics) in SEQUENCES.items()
        for panel in PANELS
        for algorithm in ALGORITHMS
    }  # fmt: skip


STUDY = Study(
    "reports.bench.stream.run", "Bench: a depth camera's stream", __doc__,
    lambda parser: parser.add_argument("--data", type=Path, required=True, help="pictures"),
    _cases, measure, page, code=(*CODE, "inim/apps/own_picture"), doubts=doubts,
)  # fmt: skip

if __name__ == "__main__":
    sys.exit(STUDY.main())
