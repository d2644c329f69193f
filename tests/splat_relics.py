"""Splats for tests: from triangles, as sheets, and at random."""

from pathlib import Path

import numpy as np

from inim.image.color import srgb_from_linear
from inim.render.meshes.splat_ply import Splats, write_splats

_Y0 = 0.28209479177387814


def splats_at(
    centre: np.ndarray,
    sigma: np.ndarray,
    opacity: float | np.ndarray,
    linear_rgb: np.ndarray,
    turn: np.ndarray | None = None,
) -> Splats:
    """Splats of one colour each, the same from everywhere."""
    n = len(centre)
    share = np.broadcast_to(np.asarray(opacity, np.float64), n)
    colour = (srgb_from_linear(np.broadcast_to(linear_rgb, (n, 3))) - 0.5) / _Y0
    upright = np.tile([1.0, 0, 0, 0], (n, 1))
    return Splats(
        np.asarray(centre, np.float32),
        np.log(np.broadcast_to(sigma, (n, 3))).astype(np.float32),
        np.asarray(upright if turn is None else turn, np.float32),
        np.log(share / (1 - share)).astype(np.float32),
        colour[:, None].astype(np.float32),
    )


def on_triangles(
    vertices: np.ndarray, faces: np.ndarray, colors: np.ndarray, per_edge: int, spread: float = 0.6
) -> tuple[Splats, float]:
    """Opaque flat splats all over triangles, so many along an edge; and their standard deviation.

    `colors` are linear, of the vertices, and run evenly between them.
    """
    k = per_edge
    i, j = (a.ravel() for a in np.meshgrid(np.arange(k), np.arange(k)))
    up, down = i + j < k, i + j < k - 1
    u = np.concatenate([(i[up] + 1 / 3) / k, (i[down] + 2 / 3) / k])
    v = np.concatenate([(j[up] + 1 / 3) / k, (j[down] + 2 / 3) / k])
    weights = np.stack([1 - u - v, u, v], -1)
    corners, shades = vertices[faces].astype(float), colors[faces].astype(float)
    sides = corners[:, 1:] - corners[:, :1]
    sigma = spread * float(np.linalg.norm(sides, axis=2).min()) / k
    normals = np.cross(sides[:, 0], sides[:, 1])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    # The turn that takes +z to the normal.
    turns = np.column_stack([1 + normals[:, 2], -normals[:, 1], normals[:, 0], 0 * normals[:, 0]])
    flipped = np.linalg.norm(turns, axis=1) < 1e-6
    turns[flipped] = [0, 1, 0, 0]
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    return splats_at(
        np.einsum("wc,tcx->twx", weights, corners).reshape(-1, 3),
        np.array([sigma, sigma, sigma / 20]),
        0.99,
        np.einsum("wc,tcx->twx", weights, shades).reshape(-1, 3),
        np.repeat(turns, len(weights), axis=0),
    ), sigma


def random_splats(count: int, degree: int = 3, seed: int = 5) -> Splats:
    """Splats within [-1, 1]^3 that point, shine and hide anyhow."""
    draw = np.random.default_rng(seed)
    turn = draw.normal(size=(count, 4))
    return Splats(
        draw.uniform(-1, 1, (count, 3)).astype(np.float32),
        np.log(draw.uniform(0.05, 0.3, (count, 3))).astype(np.float32),
        (turn / np.linalg.norm(turn, axis=1, keepdims=True)).astype(np.float32),
        draw.uniform(-2, 3, count).astype(np.float32),
        draw.normal(0, 0.4, (count, (degree + 1) ** 2, 3)).astype(np.float32),
    )


def joined(*parts: Splats) -> Splats:
    """All splats of several."""
    names = Splats.__dataclass_fields__
    return Splats(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def splat_scene(folder: Path, splats: Splats, shape: str = "ellipsoidsmesh") -> str:
    """A scene's text; its splats are written into the folder."""
    write_splats(folder / "splats.ply", splats)
    return f"""<scene version="3.0.0">
        <integrator type="volprim_rf_basic"><integer name="max_depth" value="1000"/></integrator>
        <shape type="{shape}"><string name="filename" value="splats.ply"/></shape></scene>"""
