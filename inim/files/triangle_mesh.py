"""A triangle mesh as it stands in its file: the value that readers make and writers take."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["Mesh", "usable_normals"]


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh in the unit and axes of the file it came from.

    Attributes
    ----------
    vertices : (n, 3) float32
    faces : (m, 3) uint32, counter-clockwise from outside
    normals : (n, 3) float32, unit length, or None
    uv : (n, 2) float32 or None; v grows upwards, row 0 of the texture is at v = 1
    color : (n, 3) float32 or None; **linear** RGB in 0..1 (8-bit PLY, OBJ and STL colours are
        sRGB and decoded, glTF's are linear already)
    texture : (h, w, 3) uint8 or None; sRGB, base colour
    name : str
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray | None = None
    uv: np.ndarray | None = None
    color: np.ndarray | None = None
    texture: np.ndarray | None = None
    name: str = ""


def usable_normals(normals: np.ndarray | None) -> np.ndarray | None:
    """Unit normals; None where any is missing, zero or not finite, so that they are made anew."""
    if normals is None:
        return None
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    if not np.isfinite(length).all() or (length < 1e-6).any():
        return None
    unit: np.ndarray = (normals / length).astype(np.float32)
    return unit
