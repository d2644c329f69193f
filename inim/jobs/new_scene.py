"""`inim new-scene`: a lit, fitted stock Mitsuba 3 scene around a mesh of a relic.

The mesh is turned (+y up, +z towards the viewer), scaled to millimetres, centred and written as
PLY beside the scene. Units and axes that a format does not state are asked for, never guessed.
The scene is plain Mitsuba: `mi.load_file` opens it, and the display travels in its `<default>`s.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from inim.errors import FileError, UsageError

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    import numpy as np

    from inim.formats.mesh import Mesh

__all__ = ["add_arguments", "new_scene", "run", "smoothed"]

_UNITS = ("mm", "cm", "m", "in")
_AXES = {
    f"{sign}{axis}": tuple((-1 if sign else 1) * (axis == other) for other in "xyz")
    for sign in ("", "-")
    for axis in "xyz"
}
# What faces the viewer where nobody says: glTF's rule for y up, the CAD and Blender habit for z up.
_USUAL_FRONT = {"y": "z", "-y": "z", "z": "-y", "-z": "-y", "x": "z", "-x": "z"}

# Edges that turn by more stay sharp: drapery and hair stay crisp, scan facets vanish.
_CREASE_DEG = 50.0
# A camera far enough off for a natural perspective, and the air around the relic in its picture.
_FIELD_OF_VIEW_DEG = 20.0
_AIR = 1.12
# Linear RGB of weathered plaster.
_STONE = (0.60, 0.57, 0.52)
# Lamps stand this many bounding radii off, outside all that viewers within 25 degrees of the front
# see past the relic; squares of half the side, in the same unit. Direction, half side, radiance.
_LAMP_DISTANCE = 12.0
_LAMPS = {
    "key, up left": ((-0.80, 0.85, 0.55), 2.5, (22.0, 21.0, 19.8)),
    "fill, right": ((0.85, 0.10, 0.50), 3.0, (4.0, 4.1, 4.4)),
    "top": ((0.10, 1.00, -0.15), 3.0, (6.5, 6.5, 6.5)),
}


def new_scene(
    source: Path,
    out: Path,
    *,
    unit: str | None,
    up: str | None,
    front: str | None = None,
    title: str | None = None,
    display: str = "nominal",
    force: bool = False,
) -> Path:
    """Write a scene for the mesh `source`, with its PLY and textures beside it.

    Parameters
    ----------
    source : Path
        PLY, OBJ, STL, GLB or glTF.
    out : Path
        The scene's XML; `<stem>.ply` and `<stem>.png` go into the same folder.
    unit : str or None
        Length of one unit of the file: mm, cm, m, in. None only for glTF, which is metres.
    up, front : str or None
        The axis of the file that points up and the one that faces the viewer: x, -x, y, ...
        `up` None only for glTF (y); `front` None takes z, or -y where z is up.
    title : str or None
        Name in reports; None takes the mesh file's name.
    display : str
        Preset of `inim.display.DISPLAYS`.
    force : bool
        Replace existing files.

    Returns
    -------
    Path
        `out`.

    Raises
    ------
    FileError
        The mesh is not usable, or the scene cannot be written.
    UsageError
        Unit or axis missing or impossible, unknown display, or a file in the way.
    """
    from inim.formats.mesh import UNIT_MM, read_mesh

    source, out = Path(source), Path(out)
    _check_choices(out, unit, up, front, display)
    meshes = read_mesh(source)
    unit, up = _settled(source, meshes, unit, up)
    turn = _turn(up, front or _USUAL_FRONT[up])
    parts = _placed(_merged([smoothed(m) for m in meshes]), turn, UNIT_MM[unit])
    files = _part_files(out, parts)
    _check_targets(source, [out, *files], force)
    xml = _scene_xml(parts, files, title or source.stem, display)
    _write_all(out, files, xml)
    return out


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `inim new-scene`."""
    add = parser.add_argument
    add("mesh", type=Path, metavar="MESH", help="PLY, OBJ, STL, GLB or glTF file")
    add("-o", "--out", type=Path, required=True, metavar="XML", help="scene to write")
    add("--unit", choices=_UNITS, help="length of one unit of the mesh (glTF: metres)")
    axes = f"{', '.join(_AXES)}; write a negative one as --up=-z"
    add("--up", metavar="AXIS", help=f"axis of the mesh that points up: {axes} (glTF: y)")
    add("--front", metavar="AXIS", help="axis that faces the viewer (default z; -y where z is up)")
    add("--title", help="name of the scene in reports (default: the mesh file's name)")
    add("--display", default="nominal", help="display preset: nominal or phone")
    add("--force", action="store_true", help="replace existing files")


def run(args: argparse.Namespace) -> int:
    """Act on the arguments of `add_arguments`; 0 when the scene stands."""
    path = new_scene(
        args.mesh,
        args.out,
        unit=args.unit,
        up=args.up,
        front=args.front,
        title=args.title,
        display=args.display,
        force=args.force,
    )
    print(f"wrote {path}")
    return 0


# --- What was asked for -------------------------------------------------------------------------


def _check_choices(
    out: Path, unit: str | None, up: str | None, front: str | None, display: str
) -> None:
    from inim.display import DISPLAYS

    if unit is not None and unit not in _UNITS:
        raise UsageError(f"--unit {unit}: unknown; one of {', '.join(_UNITS)}")
    for option, axis in (("--up", up), ("--front", front)):
        if axis is not None and axis not in _AXES:
            raise UsageError(f"{option} {axis}: unknown axis; one of {', '.join(_AXES)}")
    if display not in DISPLAYS:
        raise UsageError(f"--display {display}: unknown; one of {', '.join(DISPLAYS)}")
    if out.is_dir() or not out.name:
        raise UsageError(f"{out}: is a folder; name the scene's file, such as {out / 'relic.xml'}")


def _settled(
    source: Path, meshes: Sequence[Mesh], unit: str | None, up: str | None
) -> tuple[str, str]:
    """Unit and up axis, from the format's standard where it has one."""
    if source.suffix.lower() in (".glb", ".gltf"):
        return unit or "m", up or "y"
    missing = []
    if unit is None:
        missing.append(f"length unit, give --unit ({', '.join(_UNITS)})")
    if up is None:
        missing.append("up axis, give --up (x, y, z, -x, -y, -z)")
    if unit is None or up is None:
        low, high = _bounds(meshes)
        size = " x ".join(f"{length:.4g}" for length in high - low)
        raise UsageError(
            f"{source}: the format states no {' and no '.join(missing)}; the mesh is {size} units "
            "along x, y, z"
        )
    return unit, up


def _turn(up: str, front: str) -> np.ndarray:
    """Rotation (3, 3) that takes `up` to +y and `front` to +z."""
    import numpy as np

    y, z = np.array(_AXES[up], float), np.array(_AXES[front], float)
    if y @ z:
        free = [axis for axis in _AXES if axis[-1] != up[-1]]
        raise UsageError(f"--front {front}: lies along --up {up}; one of {', '.join(free)}")
    return np.stack([np.cross(y, z), y, z])


def _check_targets(source: Path, targets: Sequence[Path], force: bool) -> None:
    for target in targets:
        if target.exists() and source.exists() and target.samefile(source):
            raise UsageError(f"{target}: is the mesh itself; choose another name with -o")
        if target.exists() and not force:
            raise UsageError(f"{target}: exists already; add --force or choose another -o")


# --- Geometry -----------------------------------------------------------------------------------


def smoothed(mesh: Mesh, crease_deg: float = _CREASE_DEG) -> Mesh:
    """The mesh with vertex normals, made where it has none: smooth, but hard edges stay hard.

    Corners that meet at a vertex share a normal when a fan of faces, each turning by less than
    `crease_deg` from the next, joins them; each such group becomes one vertex. Normals are means
    weighted by area. Vertices at one place are one for this purpose, so STL and texture seams
    come out smooth; faces without area are dropped.
    """
    from dataclasses import replace

    import numpy as np

    if mesh.normals is not None:
        return mesh
    points, faces = mesh.vertices.astype(np.float64), mesh.faces.astype(np.int64)
    place = np.unique(mesh.vertices, axis=0, return_inverse=True)[1].reshape(-1)
    a, b, c = (points[faces[:, k]] for k in range(3))
    area = np.cross(b - a, c - a)
    kept = np.linalg.norm(area, axis=1) > 0
    faces, area = faces[kept], area[kept]
    group = _fans(place[faces], area, np.cos(np.radians(crease_deg)))
    corner = faces.reshape(-1)
    _, first, index = np.unique(
        group * len(points) + corner, return_index=True, return_inverse=True
    )
    weights = np.repeat(area, 3, axis=0)
    total = np.stack([np.bincount(group, weights[:, k], corner.size) for k in range(3)], axis=1)
    normals = total[group[first]]
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    # A fan folded onto itself may cancel: its first face speaks for it.
    normals = np.where(length > 1e-12 * np.abs(area).max(), normals, weights[first])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    taken = corner[first]
    return replace(
        mesh,
        vertices=mesh.vertices[taken],
        faces=index.reshape(-1, 3).astype(np.uint32),
        normals=normals.astype(np.float32),
        uv=None if mesh.uv is None else mesh.uv[taken],
        color=None if mesh.color is None else mesh.color[taken],
    )


def _fans(places: np.ndarray, area: np.ndarray, least_cosine: float) -> np.ndarray:
    """Group number of each corner (3 m,), given the places (m, 3) and face vectors (m, 3)."""
    import numpy as np

    unit = area / np.linalg.norm(area, axis=1, keepdims=True)
    start, end = places.reshape(-1), np.roll(places, -1, axis=1).reshape(-1)
    key = np.minimum(start, end) * (int(places.max()) + 1) + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    one, two = order[:-1], order[1:]
    smooth = (key[one] == key[two]) & (
        np.einsum("ij,ij->i", unit[one // 3], unit[two // 3]) >= least_cosine
    )
    one, two = one[smooth], two[smooth]
    after = np.roll(np.arange(start.size).reshape(-1, 3), -1, axis=1).reshape(-1)
    along = start[one] == start[two]
    left = np.concatenate([one, after[one]])
    right = np.concatenate([np.where(along, two, after[two]), np.where(along, after[two], two)])
    return _joined(start.size, left, right)


def _joined(count: int, left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Smallest member of each node's component under the edges left-right, by pointer jumping."""
    import numpy as np

    label = np.arange(count)
    while True:
        low = np.minimum(label[left], label[right])
        joined = label.copy()
        for ends in (left, right, label[left], label[right]):
            np.minimum.at(joined, ends, low)
        joined = joined[joined]
        if np.array_equal(joined, label):
            return label
        label = joined


def _merged(meshes: Sequence[Mesh]) -> list[Mesh]:
    """One mesh for all without texture, one for each texture: Mitsuba dislikes many shapes."""
    from dataclasses import replace

    import numpy as np

    alike: dict[object, list[Mesh]] = {}
    for mesh in meshes:
        key = None if mesh.texture is None else (mesh.texture.shape, mesh.texture.tobytes())
        alike.setdefault(key, []).append(mesh)
    merged = []
    for group in alike.values():
        starts = np.cumsum([0, *(len(m.vertices) for m in group)])
        textured = group[0].texture is not None
        colored = not textured and any(m.color is not None for m in group)
        colors = [
            np.tile(_STONE, (len(m.vertices), 1)) if m.color is None else m.color for m in group
        ]
        merged.append(
            replace(
                group[0],
                vertices=np.concatenate([m.vertices for m in group]),
                faces=np.concatenate([m.faces + n for m, n in zip(group, starts, strict=False)]),
                normals=np.concatenate([m.normals for m in group if m.normals is not None]),
                uv=None
                if not textured
                else np.concatenate([m.uv for m in group if m.uv is not None]),
                color=np.concatenate(colors) if colored else None,
            )
        )
    return merged


def _bounds(meshes: Sequence[Mesh]) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner (3,) float64 of what the faces use."""
    import numpy as np

    used = [mesh.vertices[np.unique(mesh.faces)] for mesh in meshes]
    low = np.min([points.min(axis=0) for points in used], axis=0)
    return low.astype(float), np.max([points.max(axis=0) for points in used], axis=0).astype(float)


def _placed(meshes: Sequence[Mesh], turn: np.ndarray, scale_mm: float) -> list[Mesh]:
    """Turned, in millimetres, with the centre of the bounding box at the origin."""
    from dataclasses import replace

    import numpy as np

    low, high = _bounds(meshes)
    middle = (low + high) / 2
    placed = []
    for mesh in meshes:
        points = (mesh.vertices.astype(np.float64) - middle) @ turn.T * scale_mm
        normals = None if mesh.normals is None else mesh.normals @ turn.T
        placed.append(replace(mesh, vertices=points.astype(np.float32), normals=normals))
    return placed


# --- Files --------------------------------------------------------------------------------------


def _part_files(out: Path, parts: Sequence[Mesh]) -> dict[Path, Mesh]:
    """Path of every PLY and PNG to write, and the part it holds."""
    stem = _xml_text(out.stem).replace("\\", "_").replace("$", "_") or "relic"
    files = {}
    for k, part in enumerate(parts):
        name = stem if k == 0 else f"{stem}-{k + 1}"
        files[out.parent / f"{name}.ply"] = part
        if part.texture is not None:
            files[out.parent / f"{name}.png"] = part
    return files


def _write_all(out: Path, files: dict[Path, Mesh], xml: str) -> None:
    """All files into a hidden folder beside `out`, then renamed, the scene last."""
    import tempfile

    from inim.formats.mesh import write_ply

    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".new-scene-", dir=out.parent) as folder:
            for path, part in files.items():
                if path.suffix == ".png":
                    _write_texture(Path(folder) / path.name, part)
                else:
                    write_ply(Path(folder) / path.name, part)
            (Path(folder) / out.name).write_text(xml, encoding="utf-8")
            for path in (*files, out):
                (Path(folder) / path.name).replace(path)
    except OSError as error:
        raise FileError(
            f"{out}: cannot be written ({error.strerror or error}); choose another folder with -o"
        ) from error


def _write_texture(path: Path, part: Mesh) -> None:
    from PIL import Image

    Image.fromarray(part.texture).save(path, "PNG")


# --- The scene ----------------------------------------------------------------------------------


def _scene_xml(parts: Sequence[Mesh], files: dict[Path, Mesh], title: str, display: str) -> str:
    import numpy as np

    half = (_bounds(parts)[1] - _bounds(parts)[0]) / 2
    radius = float(np.linalg.norm(half))
    defaults = {"title": title, "display": display, "algorithms": "wang2024,template"}
    lines = ["<?xml version='1.0' encoding='utf-8'?>", '<scene version="3.0.0">']
    lines += ["    <!-- Lengths are millimetres; +y is up, +z towards the viewer. -->"]
    for key, value in defaults.items():
        lines.append(f'    <default name="inim.{key}" value="{_attribute(value)}"/>')
    lines += ["", '    <boolean name="embree_use_robust_intersections" value="true"/>']
    lines += ['    <integrator type="path">', '        <integer name="max_depth" value="6"/>']
    lines += ["    </integrator>", "", *_camera_xml(half, radius), ""]
    for name, lamp in _LAMPS.items():
        lines += [f"    <!-- {name} -->", *_lamp_xml(*lamp, radius), ""]
    for path in files:
        if path.suffix == ".ply":
            lines += [*_relic_xml(path, files[path]), ""]
    return "\n".join([*lines[:-1], "</scene>", ""])


def _camera_xml(half: np.ndarray, radius: float) -> list[str]:
    """First sensor: from +z, the whole relic in a square picture."""
    import math

    away = max(half[0], half[1]) * _AIR / math.tan(math.radians(_FIELD_OF_VIEW_DEG / 2))
    z = away + half[2]
    return [
        '    <sensor type="perspective">',
        f'        <float name="fov" value="{_FIELD_OF_VIEW_DEG:g}"/>',
        f'        <float name="near_clip" value="{away / 2:.6g}"/>',
        f'        <float name="far_clip" value="{2 * (z + radius):.6g}"/>',
        '        <transform name="to_world">',
        f'            <lookat origin="0, 0, {z:.6g}" target="0, 0, 0" up="0, 1, 0"/>',
        "        </transform>",
        '        <sampler type="independent">',
        '            <integer name="sample_count" value="64"/>',
        "        </sampler>",
        '        <film type="hdrfilm">',
        '            <integer name="width" value="512"/>',
        '            <integer name="height" value="512"/>',
        '            <string name="component_format" value="float32"/>',
        '            <rfilter type="box"/>',
        "        </film>",
        "    </sensor>",
    ]


def _lamp_xml(
    direction: tuple[float, ...], half_side: float, radiance: tuple[float, ...], radius: float
) -> list[str]:
    """A black square that shines one way, at the relic."""
    import math

    away = _LAMP_DISTANCE * radius / math.hypot(*direction)
    origin = ", ".join(f"{away * d:.6g}" for d in direction)
    # Any vector that is not along the direction will do as the square's own up.
    upward = "0, 0, 1" if abs(direction[1]) > 0.9 else "0, 1, 0"
    return [
        '    <shape type="rectangle">',
        '        <transform name="to_world">',
        f'            <scale value="{half_side * radius:.6g}"/>',
        f'            <lookat origin="{origin}" target="0, 0, 0" up="{upward}"/>',
        "        </transform>",
        '        <bsdf type="diffuse"><rgb name="reflectance" value="0, 0, 0"/></bsdf>',
        '        <emitter type="area">',
        f'            <rgb name="radiance" value="{", ".join(f"{r:g}" for r in radiance)}"/>',
        "        </emitter>",
        "    </shape>",
    ]


def _relic_xml(path: Path, part: Mesh) -> list[str]:
    """The relic: its texture, its vertex colours, or plaster."""
    if part.texture is not None:
        color = [
            '<texture type="bitmap" name="base_color">',
            f'    <string name="filename" value="{_attribute(path.with_suffix(".png").name)}"/>',
            "</texture>",
        ]
    elif part.color is not None:
        color = [
            '<texture type="mesh_attribute" name="base_color">',
            '    <string name="name" value="vertex_color"/>',
            "</texture>",
        ]
    else:
        color = [f'<rgb name="base_color" value="{", ".join(f"{c:g}" for c in _STONE)}"/>']
    return [
        '    <shape type="ply">',
        f'        <string name="filename" value="{_attribute(path.name)}"/>',
        '        <boolean name="flip_tex_coords" value="true"/>',
        '        <bsdf type="twosided">',
        '            <bsdf type="principled">',
        *(f"                {line}" for line in color),
        '                <float name="roughness" value="0.7"/>',
        '                <float name="specular" value="0.3"/>',
        "            </bsdf>",
        "        </bsdf>",
        "    </shape>",
    ]


def _xml_text(text: str) -> str:
    """The text with every character that XML 1.0 or UTF-8 cannot carry made an underscore."""
    return "".join(c if _is_xml(ord(c)) else "_" for c in text)


def _is_xml(code: int) -> bool:
    return code >= 0x20 and not 0xD800 <= code <= 0xDFFF and code not in (0x7F, 0xFFFE, 0xFFFF)


def _attribute(text: str) -> str:
    """Text for an XML attribute; Mitsuba takes `$name` for a parameter unless escaped."""
    from xml.sax.saxutils import escape

    return escape(_xml_text(text), {'"': "&quot;"}).replace("$", "\\$")
