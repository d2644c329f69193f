"""Facts on the files of a scene, to show what changed: size and preview, or bounding box."""

import base64
import io
from pathlib import Path
from typing import Any

import numpy as np

from inim.image.color import srgb_from_linear
from inim.image.files.picture import read_texture
from inim.render.meshes.mesh import read_shapes
from inim.render.meshes.splat_ply import SPLAT_SHAPES
from inim.render.scene_files.file import SceneFile

#: Longest side of a preview, and number of previews: a baseline stays small.
PREVIEW_PX, MOST_PREVIEWS = 32, 8


def file_facts(file: SceneFile) -> dict[str, dict[str, str]]:
    """Facts of meshes and pictures, with a preview of pictures (PNG in base64), by SHA-256.

    Raises `FileError` if a file is damaged.
    """
    facts: dict[str, dict[str, str]] = {}
    for plugin, path in file.meshes:
        if plugin not in SPLAT_SHAPES:
            meshes = read_shapes(path, plugin)
            vertices = np.concatenate([mesh.vertices for mesh in meshes])
            facts[_sha256(file, path)] = {"facts": _box(vertices)}
    for number, path in enumerate(file.pictures):
        picture = _picture(path)
        width, height = picture.size
        preview = {"preview": _preview(picture)} if number < MOST_PREVIEWS else {}
        facts[_sha256(file, path)] = {"facts": f"{width} x {height} pixels"} | preview
    return facts


def _sha256(file: SceneFile, path: Path) -> str:
    return file.contents[path][0].hex()


def _box(vertices: np.ndarray) -> str:
    """Number of vertices and bounding box of a mesh, in the scene's unit."""
    low, high = (ends.tolist() for ends in (vertices.min(axis=0), vertices.max(axis=0)))
    axes = (f"{a:.4g} to {b:.4g}" for a, b in zip(low, high, strict=True))
    return f"{len(vertices)} vertices, box {', '.join(axes)}"


def _picture(path: Path) -> Any:
    """A texture as a picture of Pillow."""
    from PIL import Image

    texture = read_texture(path)
    if texture is None:
        return Image.open(path)
    if texture.dtype != np.uint8:
        light = np.broadcast_to(texture[..., :3], (*texture.shape[:2], 3))
        texture = np.rint(255 * srgb_from_linear(np.clip(np.nan_to_num(light), 0, 1)))
    return Image.fromarray(texture.astype(np.uint8))


def _preview(picture: Any) -> str:
    preview = picture.convert("RGB")
    preview.thumbnail((PREVIEW_PX, PREVIEW_PX))
    stream = io.BytesIO()
    preview.save(stream, "PNG")
    return base64.b64encode(stream.getvalue()).decode("ascii")
