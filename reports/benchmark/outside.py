"""An outside program as an entry: Open3D casts the rays of a case into its triangulated picture.

``python -m reports.benchmark.outside SUITE FOLDER`` needs ``pip install open3d`` and writes a
submission. Neighbouring pixels of the RGB-D picture are connected unless the surface between them
is steeper than 10 to 1, the limit of `inim.image.rgbd.MAX_SLOPE`. Colours are interpolated in
sRGB between the corners of the first triangle that a ray hits.
"""

import hashlib
import json
import sys
import time
from importlib import import_module
from pathlib import Path

import numpy as np
import OpenEXR
from PIL import Image

_STEEPEST = 10.0


def _channels(path: Path) -> dict[str, np.ndarray]:
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: channel.pixels for name, channel in file.channels().items()}


def _triangles(depth: np.ndarray, covered: np.ndarray, pixel_mm: float) -> np.ndarray:
    """Two triangles for each square of four connected pixels, as pixel numbers."""
    numbers = np.arange(depth.size).reshape(depth.shape)
    corners = (np.s_[:-1, :-1], np.s_[:-1, 1:], np.s_[1:, :-1], np.s_[1:, 1:])
    a, b, c, d = (numbers[corner].ravel() for corner in corners)
    triangles = np.concatenate([np.stack([a, c, b], 1), np.stack([b, c, d], 1)])
    z = np.where(covered, depth, np.nan).ravel()[triangles]
    with np.errstate(invalid="ignore"):
        connected = np.ptp(z, axis=1) <= _STEEPEST * pixel_mm
    selected: np.ndarray = triangles[connected]
    return selected


def generate(folder: Path) -> tuple[np.ndarray, float]:
    """EIA of a case, (rows, columns, 3) uint8, and its run time in seconds."""
    open3d = import_module("open3d")  # which this project does not need
    case = json.loads((folder / "input.json").read_text("utf-8"))
    picture, pixel_mm = case["pictures"][0], case["pixel_mm"]
    rgba = np.asarray(Image.open(folder / picture["color"]))
    depth, covered = _channels(folder / picture["depth"])["Z"], rgba[..., 3] > 0
    rays = _channels(folder / case["rays"])
    start = time.perf_counter()
    rows, columns = depth.shape
    x, y = np.meshgrid(np.arange(columns) - (columns - 1) / 2, (rows - 1) / 2 - np.arange(rows))
    points = np.stack([x * pixel_mm, y * pixel_mm, depth], axis=-1).reshape(-1, 3)
    triangles = _triangles(depth, covered, pixel_mm)
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(points.astype(np.float32), triangles.astype(np.uint32))
    front = float(depth[covered].max()) + 1
    eia = np.zeros((*rays["R.x"].shape, 3), np.uint8)
    for channel, name in enumerate("RGB"):
        at_x, at_y, right, up = (rays[f"{name}.{part}"] for part in ("x", "y", "right", "up"))
        origin = np.stack([at_x + right * front, at_y + up * front, np.full_like(at_x, front)], -1)
        direction = np.stack([-right, -up, np.full_like(at_x, -1)], axis=-1)
        lensed = np.isfinite(at_x)
        hits = scene.cast_rays(np.concatenate([origin, direction], -1)[lensed].astype(np.float32))
        is_hit = np.isfinite(hits["t_hit"].numpy())
        corners = triangles[hits["primitive_ids"].numpy()[is_hit].astype(np.int64)]
        u, v = hits["primitive_uvs"].numpy()[is_hit].T
        weights = np.stack([1 - u - v, u, v], axis=1)
        colors = (rgba[..., channel].ravel()[corners] * weights).sum(axis=1)
        values = np.zeros(len(is_hit), np.uint8)
        values[is_hit] = np.rint(colors)
        eia[..., channel][lensed] = values
    return eia, time.perf_counter() - start


def main(words: list[str]) -> int:
    """Write a submission for all cases of a suite."""
    suite, out = Path(words[0]), Path(words[1])
    out.mkdir(parents=True, exist_ok=True)
    seconds = {}
    for folder in sorted(suite.glob("*/input")):
        name = folder.parent.name
        eia, seconds[name] = generate(folder)
        Image.fromarray(eia).save(out / f"{name}.png")
    files = {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted(out.glob("*.png"))}
    entry = {
        "schema": "inim.submission/1",
        "protocol": "inim-bench-1.0",
        "name": "open3d",
        "authors": ["Open3D, Zhou et al., arXiv 1801.09847"],
        "licence": "MIT",
        "tracks": ["rgbd", "blind"],
        "files": files,
        "seconds": seconds,
    }
    (out / "submission.json").write_text(json.dumps(entry, indent=1), "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
