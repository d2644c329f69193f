"""Reader of OBJ meshes and their MTL materials.

Wavefront, Advanced Visualizer manual, appendix B1; colours of vertices as MeshLab writes them.
trimesh counts negative indices from the end of the file, takes the options of a texture as part of
its name, reads one library, and loses colours of vertices in meshes with materials.
"""

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from inim.image.color import linear_from_srgb
from inim.render.meshes.companions import Companions
from inim.render.meshes.polygons import triangulate
from inim.render.meshes.triangle_mesh import Mesh, parse_numbers, usable_normals
from inim.system.errors import FileError

_NOT_FACES = {b"l": "lines", b"p": "sets of points", b"curv": "curves", b"curv2": "curves",
              b"surf": "surfaces"}  # fmt: skip
# Words that follow an option of a texture; up to three numbers for None.
_OPTIONS = {"-mm": 2, "-o": None, "-s": None, "-t": None}
_MAPS = ("map_", "bump", "disp", "decal", "refl", "norm")
_OPAQUE = 0.5
# Combinations of indices are counted in 64 bits.
_MOST_INDEX = 2**40
_MOST_KEY = 2.0**62


@dataclass
class _Material:
    name: str
    kd: list[float] | None = None
    ke: list[float] | None = None
    picture: str = ""
    folder: str = ""
    scale: list[float] = field(default_factory=lambda: [1.0, 1.0, 1.0])
    offset: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])

    @property
    def tint(self) -> np.ndarray | None:
        """Linear colour, (3,) float32: the light of a black one that shines; None if not given."""
        shines = self.ke is not None and any(self.ke)
        color = self.ke if shines and not any(self.kd or [0.0]) else self.kd
        if color is None:
            return None
        return linear_from_srgb(np.clip(np.array(color, np.float32), 0, 1))


class _Content:
    """Statements of an OBJ text, line by line."""

    def __init__(self, data: bytes) -> None:
        text = data.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").replace(b"\r", b"\n")
        self.points: list[bytes] = []
        self.coordinates: list[bytes] = []
        self.normals: list[bytes] = []
        #: Corners, material, and numbers of vertices, coordinates and normals before it.
        self.faces: list[tuple[bytes, str, int, int, int]] = []
        self.libraries: list[str] = []
        self.unread: Counter[str] = Counter()
        rows = {b"v": self.points, b"vt": self.coordinates, b"vn": self.normals}
        material = ""
        for line in text.replace(b"\\\n", b" ").split(b"\n"):
            words = line.split(None, 1)
            if not words:
                continue
            key, rest = words[0].lower(), words[1] if len(words) > 1 else b""
            if key in rows:
                rows[key].append(rest.partition(b"#")[0])
            elif key == b"f":
                counts = len(self.points), len(self.coordinates), len(self.normals)
                self.faces.append((rest.partition(b"#")[0], material, *counts))
            elif key == b"usemtl":
                material = _name(rest)
            elif key == b"mtllib":
                self.libraries.append(_decoded(rest).strip())
            elif key in _NOT_FACES:
                self.unread[_NOT_FACES[key]] += 1
            elif key.startswith(b"#mrgb"):
                self.unread["colours of ZBrush"] += 1


def read_obj(
    path: Path, data: bytes, warn: Callable[[str], object], *, materials: bool = True
) -> list[Mesh]:
    """Read the meshes of an OBJ, one for each material.

    * `path`: path of the file, next to its companions.
    * `data`: content of the file.
    * `warn`: called with a line on what is not read.
    * `materials`: False: one mesh without materials.

    Raises `FileError`: the file is damaged, or has no faces.
    """
    content = _Content(data)
    try:
        vertices, colors = _vertices(content.points)
        uv = _rows(content.coordinates, 2) if content.coordinates else None
        normals = _rows(content.normals, 3) if content.normals else None
        sizes = [0 if rows is None else len(rows) for rows in (vertices, uv, normals)]
        corners, counts, names = _corners(content.faces, sizes)
    except ValueError as error:
        raise FileError(f"{path}: not a readable obj mesh ({error}); export it again") from error
    tables = _Rows(vertices, colors, uv, normals)
    triangles, polygon = triangulate(vertices[corners[:, 0]], counts)
    if not len(triangles):
        others = ", ".join(content.unread) or ("points" if len(vertices) else "nothing")
        raise FileError(f"{path}: holds no faces ({others}); inim needs a triangle mesh")
    if content.unread:
        unread = [f"{n} {name}" for name, n in content.unread.items()]
        warn(f"{path}: not read: {', '.join(unread)}; only faces are shown")
    of_triangle = np.asarray(names)[polygon]
    groups: dict[str, np.ndarray] = {"": triangles}
    library: dict[str, _Material] = {}
    companions = Companions(path)
    if materials:
        library = _libraries(path, content.libraries, companions, warn)
        used = list(dict.fromkeys(of_triangle.tolist()))
        groups = {name: triangles[of_triangle == name] for name in used}
        unknown = [name for name in used if name and name.lower() not in library]
        if unknown and not companions.lacking:
            warn(f"{path}: materials {', '.join(unknown)} are not defined; they have no colour")
    meshes = []
    for name, own in groups.items():
        chosen = library.get(name.lower(), _Material(name))
        picture = companions.picture(chosen.picture, chosen.folder) if chosen.picture else None
        has_uv = (corners[own][..., 1] >= 0).all(axis=1)
        if picture is not None and not has_uv.all():
            warn(f"{path}: {np.count_nonzero(~has_uv)} faces of the material {name!r} have no "
                 "texture coordinates; they show its plain colour")  # fmt: skip
        if picture is not None and colors is not None:
            warn(f"{path}: its vertex colours would multiply its texture, and are left out")
        keeps_uv = has_uv.all() and not materials  # for the scene's own textures
        is_textured = has_uv if picture is not None or keeps_uv else np.zeros(len(own), bool)
        for part, has_own in ((own[is_textured], True), (own[~is_textured], False)):
            if len(part):
                rows = tables if has_own else tables._replace(uv=None)
                mesh = _mesh(corners[part.ravel()], rows, chosen, picture if has_own else None)
                meshes.append(mesh if name else replace(mesh, name=path.stem))
    for text in companions.losses():
        warn(f"{path}: {text}")
    return meshes


class _Rows(NamedTuple):
    """Vertices (n, 3), their colours, texture coordinates and normals; None without any."""

    vertices: np.ndarray
    colors: np.ndarray | None
    uv: np.ndarray | None
    normals: np.ndarray | None


def _mesh(
    corners: np.ndarray, tables: _Rows, material: _Material, texture: np.ndarray | None
) -> Mesh:
    """Mesh of corners, (3 n, 3): vertex, coordinates and normal, -1 without one."""
    if tables.uv is None:
        corners = corners * (1, 0, 1) - (0, 1, 0)
    # One number for each combination: sorting rows takes ten times as long.
    sizes = corners.max(axis=0) + 2
    key = corners[:, 0] * sizes[1] + corners[:, 1] + 1
    if float(sizes[0]) * float(sizes[1]) * float(sizes[2]) > _MOST_KEY:
        key = np.unique(key, return_inverse=True)[1].reshape(-1)
    key = key * sizes[2] + corners[:, 2] + 1
    _, first, index = np.unique(key, return_index=True, return_inverse=True)
    place, at, towards = corners[first].T
    uv = normals = color = None
    if tables.uv is not None:
        scaled = tables.uv[at] * np.array(material.scale[:2]) + np.array(material.offset[:2])
        uv = np.nan_to_num(scaled.astype(np.float32))
    if tables.normals is not None and (towards >= 0).all():
        normals = usable_normals(tables.normals[towards].astype(np.float32))
    tint = material.tint
    if texture is None and tables.colors is not None:
        color = tables.colors[place] * (np.ones(3, np.float32) if tint is None else tint)
    elif texture is None and tint is not None and not (tint == 1).all():
        color = np.tile(tint, (len(place), 1))
    faces = index.reshape(-1, 3)
    return Mesh(tables.vertices[place], faces, normals, uv, color, texture, material.name)


def _rows(lines: Sequence[bytes], width: int) -> np.ndarray:
    """Numbers of lines, (n, width) float64; a line may have more."""
    lengths = {len(line.split()) for line in lines}
    if min(lengths) < width:
        raise ValueError(f"a line has {min(lengths)} numbers instead of {width}")
    if len(lengths) > 1:
        lines = [b" ".join(line.split()[:width]) for line in lines]
        lengths = {width}
    numbers = parse_numbers(b" ".join(lines))
    if numbers is None or len(numbers) != len(lines) * (length := lengths.pop()):
        raise ValueError("a coordinate is not a number")
    return numbers.reshape(len(lines), length)[:, :width]


def _vertices(lines: Sequence[bytes]) -> tuple[np.ndarray, np.ndarray | None]:
    """Points, (n, 3), and linear colours of vertices, (n, 3) float32, where all or most have them.

    After x, y and z, a vertex has a weight, a colour, or both.
    """
    if not lines:
        return np.zeros((0, 3)), None
    points = _rows(lines, 3)
    words = [line.split() for line in lines]
    has_color = np.array([len(row) >= 6 for row in words])
    if not has_color.any():
        return points, None
    start = {6: 3}
    values = [row[start.get(len(row), 4) :][:3] for row in words if len(row) >= 6]
    color = np.zeros((len(lines), 3), np.float32)
    color[has_color] = linear_from_srgb(np.clip(np.array(values, np.float32), 0, 1))
    color[~has_color] = color[has_color].mean(axis=0)
    return points, color


def _corners(
    faces: Sequence[tuple[bytes, str, int, int, int]], sizes: Sequence[int]
) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Vertex, coordinates and normal of each corner, (corners, 3); corners and material of faces.

    Coordinates and normals are -1 where there are none.
    """
    counts = [len(line.split()) for line, *_ in faces]
    names = [material for _, material, *_ in faces]
    corners = _equal_corners(b" ".join(line for line, *_ in faces))
    if corners is None:
        rows = [_corner(word, before) for line, _, *before in faces for word in line.split()]
        corners = np.array(rows, np.int64).reshape(-1, 3)
    if len(corners) and corners[:, 0].max() >= sizes[0]:
        raise ValueError(f"a face has the index {corners[:, 0].max() + 1}, out of bounds of "
                         f"{sizes[0]} vertices")  # fmt: skip
    for axis in (1, 2):
        corners[corners[:, axis] >= sizes[axis], axis] = -1
    return corners, np.array(counts, np.int64), names


# Corners of one form, counted from 1, and the axes of their numbers.
_FORMS = (
    (re.compile(rb"\s*(?:[1-9]\d*\s+)*(?:[1-9]\d*)?"), (0,)),
    (re.compile(rb"\s*(?:[1-9]\d*/[1-9]\d*\s+)*(?:[1-9]\d*/[1-9]\d*)?"), (0, 1)),
    (re.compile(rb"\s*(?:[1-9]\d*//[1-9]\d*\s+)*(?:[1-9]\d*//[1-9]\d*)?"), (0, 2)),
    (re.compile(rb"\s*(?:[1-9]\d*/[1-9]\d*/[1-9]\d*\s+)*(?:[1-9]\d*/[1-9]\d*/[1-9]\d*)?"),
     (0, 1, 2)),
)  # fmt: skip


def _equal_corners(text: bytes) -> np.ndarray | None:
    """Corners, (n, 3), of which all have the same form; None for others. Ten times as fast."""
    for pattern, axes in _FORMS:
        if pattern.fullmatch(text):
            numbers = parse_numbers(text.replace(b"/", b" "))
            if numbers is None or numbers.max(initial=0) >= _MOST_INDEX:
                return None
            corners = np.full((len(numbers) // len(axes), 3), -1, np.int64)
            corners[:, axes] = numbers.reshape(-1, len(axes)).astype(np.int64) - 1
            return corners
    return None


def _corner(word: bytes, before: Sequence[int]) -> tuple[int, ...]:
    """Indices of a corner; `before`: numbers of vertices, coordinates and normals before it."""
    parts = word.split(b"/")
    if len(parts) > 3 or not parts[0]:
        raise ValueError(f"a corner is {word.decode('latin-1')[:20]!r}")
    parts += [b""] * (3 - len(parts))
    return tuple(
        _index(part, count) if part else -1 for part, count in zip(parts, before, strict=True)
    )


def _index(text: bytes, count: int) -> int:
    """Index from 0, of a text that counts from 1, or back from the line that it is in."""
    index = int(text)
    if abs(index) >= _MOST_INDEX:
        raise ValueError(f"a face has the index {index:.3g}")
    if index == 0:
        raise ValueError("a face has the index 0, but OBJ counts from 1")
    if index > 0:
        return index - 1
    if count + index < 0:
        raise ValueError(f"a face has the index {index} after {count} vertices")
    return count + index


# --- Materials ----------------------------------------------------------------------------------


def _decoded(text: bytes) -> str:
    try:
        return text.decode("utf-8-sig")
    except UnicodeDecodeError:
        return text.decode("latin-1")


def _name(text: bytes) -> str:
    """Name of a material, with single spaces."""
    return " ".join(_decoded(text).partition(" #")[0].split())


def _library_names(line: str) -> list[str]:
    """Names in a line of material libraries; a backslash escapes a space."""
    words = re.split(r"(?<!\\)\s+", line.partition(" #")[0].strip())
    return [word.replace("\\ ", " ") for word in words if word]


def _libraries(
    path: Path, lines: Sequence[str], companions: Companions, warn: Callable[[str], object]
) -> dict[str, _Material]:
    """Materials of all libraries by their names in lower case; the first definition counts."""
    library: dict[str, _Material] = {}
    unread: dict[str, None] = {}
    clear: dict[str, None] = {}
    for line in dict.fromkeys(lines):
        lacking = dict(companions.lacking)
        texts = {line: companions.read(line)}
        if texts[line] is None:  # several names, not one with spaces
            companions.lacking = lacking
            texts = {name: companions.read(name) for name in _library_names(line)}
        for name, text in texts.items():
            if text is None:
                continue
            folder = name.replace("\\", "/").rpartition("/")[0]
            for material in _materials(_decoded(text), folder, unread, clear):
                library.setdefault(material.name.lower(), material)
    if unread:
        warn(f"{path}: not read: {', '.join(unread)}; only Kd and map_Kd have colours")
    if clear:
        warn(f"{path}: materials {', '.join(clear)} are transparent; they are shown opaque")
    return library


def _materials(
    text: str, folder: str, unread: dict[str, None], clear: dict[str, None]
) -> list[_Material]:
    """Materials of a library; adds keys that are not read, and names of transparent materials."""
    materials: list[_Material] = []
    for line in text.replace("\r", "\n").replace("\\\n\n", " ").replace("\\\n", " ").split("\n"):
        words = line.split(None, 1)
        if not words or words[0].startswith("#"):
            continue
        key, rest = words[0].lower(), words[1] if len(words) > 1 else ""
        if key == "newmtl":
            materials.append(_Material(_name(rest.encode()), folder=folder))
        elif not materials:
            continue
        elif key in ("kd", "ke"):
            numbers = _numbers(rest)
            if len(numbers) in (1, 3):
                setattr(materials[-1], key, numbers * (3 // len(numbers)))
            else:
                unread[f"{words[0]} {rest.strip()[:40]}"] = None
        elif key == "map_kd":
            _set_texture(materials[-1], rest)
        elif key in ("d", "tr"):
            numbers = _numbers(rest.removeprefix("-halo"))
            if numbers and (numbers[0] if key == "d" else 1 - numbers[0]) < _OPAQUE:
                clear[materials[-1].name] = None
        elif key.startswith(_MAPS):
            unread[words[0]] = None
    return materials


def _numbers(text: str) -> list[float]:
    """Finite numbers at the start of a text."""
    numbers: list[float] = []
    for word in text.split():
        try:
            number = float(word)
        except ValueError:
            break
        if not np.isfinite(number):
            break
        numbers.append(number)
    return numbers


def _set_texture(material: _Material, text: str) -> None:
    """Read the options and the name of a texture."""
    values: dict[str, Any] = {"-s": material.scale, "-o": material.offset}
    while text.lstrip().startswith("-") and len(parts := text.split(None, 1)) == 2:
        option, text = parts[0].lower(), parts[1]
        count = _OPTIONS.get(option, 1)
        if count is None:
            numbers = _numbers(text)[:3]
            count = min(len(numbers), len(text.split()) - 1)
            if option in values:
                values[option][:count] = numbers[:count]
        for _ in range(count):
            text = [*text.split(None, 1), ""][1]
    material.picture = text.strip()
