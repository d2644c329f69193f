"""Meshes read by trimesh: STL and glTF."""

import io
import logging
import mimetypes
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from PIL import Image

from inim.image.color import linear_from_srgb, srgb_from_linear, srgb_to_uint8
from inim.render.meshes.companions import Companions
from inim.render.meshes.gltf import prepare_gltf
from inim.render.meshes.triangle_mesh import Mesh, coarse_text, first_line, usable_normals
from inim.system.errors import FileError

_MOST_INSTANCED_FACES = 50_000_000
# Name of the vertex colours of a mesh that also has a material.
_COLORS = "_inim_color"
# Vertex colours above it change no 8-bit code.
_WHITE = 0.995

# Without a handler, trimesh's tracebacks would go to the terminal.
logging.getLogger("trimesh").addHandler(logging.NullHandler())


class _Resolver(trimesh.resolvers.FilePathResolver):  # type: ignore[misc]
    """Companions of a mesh for trimesh, which goes on without them, silently."""

    def __init__(self, path: Path, companions: Companions) -> None:
        super().__init__(str(path))
        self._companions = companions

    def get(self, name: str) -> Any:
        """Bytes of a companion file; trimesh catches the exceptions of this method."""
        data = self._companions.read(name)
        if data is None:
            raise ValueError(f"{name[:120]!r} is no file that is read")
        if (mimetypes.guess_type(name)[0] or "").startswith("image/"):
            try:
                Image.open(io.BytesIO(data)).close()
            except Exception:
                self._companions.lacking[name] = None
                raise
        return data


def read_with_trimesh(
    path: Path, data: bytes, kind: str, warn: Callable[[str], object]
) -> list[Mesh]:
    """Read every surface of the *transformed* scene; any exception of trimesh becomes a FileError.

    * `path`: path of the mesh, next to its companion files.
    * `data`: content of the file.
    * `kind`: name of the format in trimesh.
    * `warn`: called with a line on what is not read.
    """
    try:
        companions = Companions(path)
        resolver = _Resolver(path, companions)
        if kind in ("glb", "gltf"):
            data = prepare_gltf(path, data, resolver.get, warn)
        elif _has_colors(data):
            warn(f"{path}: not read: colours of an STL")
        # No processing: merging vertices drops texture seams, and NaN must be seen, not mended.
        scene = trimesh.load_scene(
            io.BytesIO(data),
            file_type=kind,
            resolver=resolver,
            process=False,
        )
        for text in companions.losses():
            warn(f"{path}: {text}")
        _check_instances(path, scene)
        for part in scene.geometry.values():  # copies keep a mesh's attributes, but not a visual's
            colors = getattr(getattr(part, "visual", None), "vertex_attributes", {}).get("color")
            if colors is not None:
                part.vertex_attributes[_COLORS] = colors
        for part in scene.geometry.values():
            if text := coarse_text(np.asarray(getattr(part, "vertices", np.zeros((1, 3))))):
                warn(f"{path}: {text}; export it closer to its origin")
        linear = kind in ("glb", "gltf")
        # Copies, where nodes have transforms, lose the file's normals.
        surfaces = _surfaces(path, scene.dump())
        if any(_has_two_colors(part) for part in surfaces):
            warn(f"{path}: its vertex colours would multiply its texture, and are left out")
        return [_mesh(path, part, linear_colors=linear) for part in surfaces]
    except FileError:
        raise
    except MemoryError as error:
        raise FileError(f"{path}: does not fit into memory; decimate the mesh first") from error
    except Exception as error:
        cause = first_line(error)
        raise FileError(f"{path}: not a readable {kind} mesh ({cause}); export it again") from error


def _has_colors(data: bytes) -> bool:
    """True for a binary STL with attributes of triangles, or a colour in its header."""
    count = int.from_bytes(data[80:84], "little")
    if len(data) != 84 + 50 * count:
        return False
    records = np.frombuffer(data, np.uint8, offset=84).reshape(count, 50)
    return b"COLOR=" in data[:80] or bool(records[:, 48:].any())


def _surfaces(path: Path, parts: list[Any]) -> list[Any]:
    surfaces = [p for p in parts if isinstance(p, trimesh.Trimesh) and len(p.faces)]
    if not surfaces:
        kinds = sorted({type(p).__name__ for p in parts}) or ["nothing"]
        raise FileError(f"{path}: holds no faces ({', '.join(kinds)}); inim needs a triangle mesh")
    return surfaces


def _has_two_colors(part: Any) -> bool:
    """True if a texture is multiplied by vertex colours that are not white."""
    colors = part.vertex_attributes.get(_COLORS)
    material = getattr(part.visual, "material", None)
    if colors is None or getattr(material, "baseColorTexture", None) is None:
        return False
    return bool((_color(colors, True) < _WHITE).any())


def _check_instances(path: Path, scene: Any) -> None:
    """A small file may place one mesh a million times; count before copying."""
    total = 0
    for node in scene.graph.nodes_geometry:
        geometry = scene.geometry[scene.graph[node][1]]
        total += len(getattr(geometry, "faces", ()))
    if total > _MOST_INSTANCED_FACES:
        raise FileError(f"{path}: unfolds to {total} faces; decimate the mesh first")


def _mesh(path: Path, part: Any, *, linear_colors: bool) -> Mesh:
    vertices = np.asarray(part.vertices, np.float64)
    faces = np.asarray(part.faces, np.int64)
    if vertices.shape[1:] != (3,) or faces.shape[1:] != (3,):
        raise FileError(f"{path}: vertices of {vertices.shape[1:]} numbers; the file is damaged")
    # Normals that trimesh would compute are not the file's; it keeps the file's in this cache.
    normals = part.vertex_normals if "vertex_normals" in part._cache else None
    normals = usable_normals(None if normals is None else np.asarray(normals, np.float32))
    color, uv, texture = _appearance(path, part, linear_colors)
    if part.visual.kind == "face":  # one colour a face: give every face its own corners
        color = np.repeat(_color(part.visual.face_colors, linear_colors), 3, axis=0)
        vertices, faces = vertices[faces.ravel()], np.arange(faces.size).reshape(-1, 3)
        normals = None
    name = str(part.metadata.get("name") or path.stem)
    return Mesh(vertices, faces, normals, uv, color, texture, name)


def _appearance(
    path: Path, part: Any, linear: bool
) -> tuple[np.ndarray | None, np.ndarray | None, np.ndarray | None]:
    """Vertex colour, texture coordinates and base-colour texture, each where there is one."""
    visual, count = part.visual, len(part.vertices)
    if visual.kind == "vertex":
        return _color(visual.vertex_colors, linear), None, None
    material = getattr(visual, "material", None)
    if material is None:
        return None, None, None
    image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    # Where trimesh found no picture it paints four grey pixels, which no file's format has.
    if image is not None and image.size == (2, 2) and image.format is None:
        image = None
    factor = getattr(material, "baseColorFactor", None)
    tint = np.ones(3, np.float32) if factor is None else _color(np.array([factor]), linear)[0]
    uv = None if visual.uv is None else np.nan_to_num(np.asarray(visual.uv, np.float32))
    if uv is not None and uv.shape != (count, 2):
        uv = None
    if image is not None and uv is not None:
        return None, uv, _apply_tint(Companions(path).pixels(image), tint)
    colors = part.vertex_attributes.get(_COLORS)
    if colors is not None and len(colors) == count:
        return _color(colors, linear) * tint, uv, None
    if factor is None or bool((tint == 1).all()):
        return None, uv, None
    return np.tile(tint, (count, 1)).astype(np.float32), uv, None


def _apply_tint(pixels: np.ndarray, tint: np.ndarray) -> np.ndarray:
    """Texture times base-colour factor: glTF multiplies in linear light."""
    if (tint == 1).all():
        return pixels
    curve = linear_from_srgb(np.arange(256) / 255.0)
    table = np.stack([srgb_to_uint8(srgb_from_linear(curve * t)) for t in tint])
    return np.stack([table[c][pixels[..., c]] for c in range(3)], axis=-1)


def _color(values: Any, linear: bool) -> np.ndarray:
    """(n, 3) linear float32 from trimesh's 8-bit or float colours."""
    array = np.asarray(values)[:, :3]
    scale = np.iinfo(array.dtype).max if array.dtype.kind in "ui" else 1.0
    share = np.clip(np.nan_to_num(array / scale), 0, 1).astype(np.float32)
    return share if linear else linear_from_srgb(share)
