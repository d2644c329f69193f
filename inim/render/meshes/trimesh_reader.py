"""Meshes read by trimesh: OBJ, STL, glTF, and PLY that is more than plain triangles."""

import io
import logging
import mimetypes
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from PIL import Image

from inim.image.color import linear_from_srgb, srgb_from_linear, srgb_to_uint8
from inim.render.meshes.gltf import prepare_gltf
from inim.render.meshes.obj import UV_TRANSFORM, prepare_mtl, prepare_obj
from inim.render.meshes.triangle_mesh import Mesh, first_line, usable_normals
from inim.system.errors import FileError
from inim.system.files import read_file

_MOST_TEXTURE_PIXELS = 2**26
_MOST_INSTANCED_FACES = 50_000_000
_MOST_COMPANION_BYTES = 2**29
# Name of the vertex colours of a mesh that also has a material.
_COLORS = "_inim_color"
# Vertex colours above it change no 8-bit code.
_WHITE = 0.995
# trimesh's colour for "nobody said"; a material of this colour says nothing.
_GREY = (102, 102, 102)

# Without a handler, trimesh's tracebacks would go to the terminal.
logging.getLogger("trimesh").addHandler(logging.NullHandler())


class _Companions(trimesh.resolvers.FilePathResolver):  # type: ignore[misc]
    """The files that a mesh names, from its own folder; keeps the names of those that are lacking.

    trimesh goes on without them, silently.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(str(path))
        self._folder = path.parent
        self.lacking: dict[str, None] = {}
        self.libraries: list[str] = []
        self.unread_maps: dict[str, None] = {}

    def get(self, name: str) -> Any:
        """Bytes of a companion file; trimesh catches the exceptions of this method."""
        if self.libraries and name == self.libraries[0]:
            return self._materials()
        try:
            data = self._read(name)
            if (mimetypes.guess_type(name)[0] or "").startswith("image/"):
                Image.open(io.BytesIO(data)).close()
        except Exception:
            self.lacking[name] = None
            raise
        return data

    def _materials(self) -> bytes:
        """Texts of all material libraries: a line names one file with spaces, or several."""
        texts = []
        for line in self.libraries:
            for name in (line,) if self._find(line) is not None else line.split():
                data = self._find(name)
                if data is None:
                    self.lacking[name] = None
                    continue
                text, unread = prepare_mtl(data)
                texts.append(text)
                self.unread_maps |= dict.fromkeys(unread)
        return b"\n".join(texts)

    def _read(self, name: str) -> bytes:
        """Read a file from one of the folders that trimesh searches."""
        data = self._find(name)
        if data is None:
            raise ValueError(f"{name[:120]!r} is no file that is read")
        return data

    def _find(self, name: str) -> bytes | None:
        """Content of a file by its path from the mesh's folder, or by its name in that folder."""
        path = name.strip().replace("\\", "/")
        bare = path.rpartition("/")[2]
        others = [entry.name for entry in self._folder.iterdir()
                  if entry.name.lower() == bare.lower()]  # fmt: skip
        for candidate in (path, path.lstrip("/"), bare, *others):
            with suppress(ValueError, FileError):
                data: bytes = read_file(self.absolute(candidate), _MOST_COMPANION_BYTES)
                return data
        return None


def read_with_trimesh(
    path: Path, data: bytes, kind: str, warn: Callable[[str], object], *, materials: bool = True
) -> list[Mesh]:
    """Read every surface of the *transformed* scene; any exception of trimesh becomes a FileError.

    * `path`: path of the mesh, next to its companion files.
    * `data`: content of the file.
    * `kind`: name of the format in trimesh.
    * `warn`: called with a line for each missing companion file.
    * `materials`: True to read materials and textures.
    """
    try:
        companions = _Companions(path)
        if kind in ("glb", "gltf"):
            data = prepare_gltf(path, data, companions.get, warn)
        elif kind == "obj":
            data, companions.libraries = prepare_obj(data)
        # No processing: merging vertices drops texture seams, and NaN must be seen, not mended.
        scene = trimesh.load_scene(
            io.BytesIO(data),
            file_type=kind,
            resolver=companions,
            process=False,
            skip_materials=not materials,
        )
        for name in companions.lacking:
            warn(
                f"{path}: {name[:120]!r} is missing, unreadable or outside the mesh's folder; "
                "the relic goes without it"
            )
        if companions.unread_maps:
            warn(f"{path}: not read: {', '.join(companions.unread_maps)}; only map_Kd has colours")
        _check_instances(path, scene)
        for part in scene.geometry.values():  # copies keep a mesh's attributes, but not a visual's
            colors = getattr(getattr(part, "visual", None), "vertex_attributes", {}).get("color")
            if colors is not None:
                part.vertex_attributes[_COLORS] = colors
        linear = kind in ("glb", "gltf")
        # Copies, where nodes have transforms, lose the file's normals.
        parts = scene.dump() if materials else list(scene.geometry.values())
        surfaces = _surfaces(path, parts)
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
    factor = getattr(material, "baseColorFactor", None) if linear else material.main_color
    tint = np.ones(3, np.float32) if factor is None else _color(np.array([factor]), linear)[0]
    uv = None if visual.uv is None else np.nan_to_num(np.asarray(visual.uv, np.float32))
    if uv is not None and uv.shape != (count, 2):
        uv = None
    transform = getattr(material, "kwargs", {}).get(UV_TRANSFORM)
    if uv is not None and transform:
        numbers = np.array(transform, np.float32)
        uv = uv * numbers[:2] + numbers[2:]
    if image is not None and uv is not None:
        return None, uv, _apply_tint(_pixels(path, image), tint if linear else np.ones(3))
    colors = part.vertex_attributes.get(_COLORS)
    if colors is not None and len(colors) == count:
        return _color(colors, linear) * tint, uv, None
    if factor is None or tuple(factor[:3]) == _GREY or bool((tint == 1).all()):
        return None, uv, None
    return np.tile(tint, (count, 1)).astype(np.float32), uv, None


def _pixels(path: Path, image: Any) -> np.ndarray:
    if image.width * image.height > _MOST_TEXTURE_PIXELS:
        raise FileError(
            f"{path}: texture of {image.width} x {image.height} pixels; scale it below 8192 x 8192"
        )
    return np.asarray(image.convert("RGB"), np.uint8)


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
