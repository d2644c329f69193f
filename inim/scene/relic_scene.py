"""A new scene around a relic: its meshes turned, scaled and centred, lit from three sides."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from inim.files.triangle_mesh import Mesh
from inim.image.color import linear_from_srgb

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path


def merged(meshes: Sequence[Mesh]) -> list[Mesh]:
    """One mesh for all without texture, one for each texture: Mitsuba dislikes many shapes."""
    alike: dict[object, list[Mesh]] = {}
    for mesh in meshes:
        key = None if mesh.texture is None else (mesh.texture.shape, mesh.texture.tobytes())
        alike.setdefault(key, []).append(mesh)
    return [_one(group) for group in alike.values()]


def _one(group: Sequence[Mesh]) -> Mesh:
    """Meshes with normals, of one texture or of none, as one."""
    starts = np.cumsum([0, *(len(m.vertices) for m in group)])
    textured = group[0].texture is not None
    colored = not textured and any(m.color is not None for m in group)
    colors = [np.tile(STONE, (len(m.vertices), 1)) if m.color is None else m.color for m in group]
    return replace(
        group[0],
        vertices=np.concatenate([m.vertices for m in group]),
        faces=np.concatenate([m.faces + n for m, n in zip(group, starts, strict=False)]),
        normals=np.concatenate([m.normals for m in group if m.normals is not None]),
        uv=np.concatenate([m.uv for m in group if m.uv is not None]) if textured else None,
        color=np.concatenate(colors).clip(0, 1) if colored else None,
    )


def bounds(meshes: Sequence[Mesh]) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner (3,) float64 of what the faces use."""
    used = [mesh.vertices[np.unique(mesh.faces)] for mesh in meshes]
    low = np.min([points.min(axis=0) for points in used], axis=0)
    return low.astype(float), np.max([points.max(axis=0) for points in used], axis=0).astype(float)


def placed(meshes: Sequence[Mesh], turn: np.ndarray, scale_mm: float) -> list[Mesh]:
    """Turned, in millimetres, with the centre of the bounding box at the origin."""
    low, high = bounds(meshes)
    middle = (low + high) / 2
    moved = []
    for mesh in meshes:
        points = (mesh.vertices.astype(np.float64) - middle) @ turn.T * scale_mm
        normals = None if mesh.normals is None else mesh.normals @ turn.T
        moved.append(replace(mesh, vertices=points.astype(np.float32), normals=normals))
    return moved


# Linear RGB of weathered plaster, for a relic that has no colour of its own.
STONE = (0.60, 0.57, 0.52)
# The lamps are made for it: on a perpendicular face of it they come to 0.74, and to white where it
# shines at the rim. They are dimmed for a relic whose brightest hundredth is brighter.
_BRIGHTEST_QUANTILE = 0.99
# A camera far enough off for a natural perspective, and the air around the relic in its picture.
_FIELD_OF_VIEW_DEG = 20.0
_AIR = 1.12
# Lamps stand this many bounding radii off, outside all that viewers within 25 degrees of the front
# see past the relic; squares of half the side, in the same unit. Direction, half side, radiance.
_LAMP_DISTANCE = 12.0
_LAMPS = {
    "key, up left": ((-0.80, 0.85, 0.55), 2.5, (17.6, 16.8, 15.8)),
    "fill, right": ((0.85, 0.10, 0.50), 3.0, (3.2, 3.3, 3.5)),
    "top": ((0.10, 1.00, -0.15), 3.0, (5.2, 5.2, 5.2)),
}


def scene_xml(files: Mapping[Path, Mesh], half_mm: np.ndarray, title: str, display: str) -> str:
    """The scene's text.

    Parameters
    ----------
    files : mapping of Path to Mesh
        The relic's PLY files, each in the scene's folder; those with a texture have a PNG beside.
    half_mm : (3,) float array
        Half the size of the relic's bounding box, which is centred on the origin.
    title, display : str
        Values of `inim.title` and `inim.display`.
    """
    radius = math.hypot(*half_mm)
    lines = defaults_xml(title, display)
    lines += ['    <integrator type="path">', '        <integer name="max_depth" value="6"/>']
    lines += ["    </integrator>", "", *camera_xml(half_mm, radius), ""]
    share = min(1.0, max(STONE) / max(map(_brightest, files.values())))
    for name, (direction, half_side, radiance) in _LAMPS.items():
        light = tuple(share * r for r in radiance)
        lines += [f"    <!-- {name} -->", *_lamp_xml(direction, half_side, light, radius), ""]
    for path in files:
        if path.suffix == ".ply":
            lines += [*_relic_xml(path, files[path]), ""]
    return "\n".join([*lines[:-1], "</scene>", ""])


def _brightest(part: Mesh) -> float:
    """Linear light that the brightest hundredth of a part sends back of what falls on it."""
    if part.texture is not None:
        code = np.quantile(part.texture.max(axis=-1), _BRIGHTEST_QUANTILE)
        return float(linear_from_srgb(code / 255))
    if part.color is not None:
        return float(np.quantile(part.color.max(axis=-1), _BRIGHTEST_QUANTILE))
    return max(STONE)


def defaults_xml(title: str, display: str, **more: str) -> list[str]:
    """How a new scene begins: its settings, and robust intersections."""
    defaults = {"title": title, "display": display, "algorithms": "wang2024,template", **more}
    lines = ["<?xml version='1.0' encoding='utf-8'?>", '<scene version="3.0.0">']
    lines += ["    <!-- Lengths are millimetres; +y is up, +z towards the viewer. -->"]
    for key, value in defaults.items():
        lines.append(f'    <default name="inim.{key}" value="{attribute(value)}"/>')
    # Our rays run along edges and through vertices, where Embree's default lets them slip through.
    return [*lines, "", '    <boolean name="embree_use_robust_intersections" value="true"/>']


def camera_xml(half: np.ndarray, radius: float) -> list[str]:
    """First sensor: from +z, the whole relic in a square picture."""
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
            f'    <string name="filename" value="{attribute(path.with_suffix(".png").name)}"/>',
            "</texture>",
        ]
    elif part.color is not None:
        color = [
            '<texture type="mesh_attribute" name="base_color">',
            '    <string name="name" value="vertex_color"/>',
            "</texture>",
        ]
    else:
        color = [f'<rgb name="base_color" value="{", ".join(f"{c:g}" for c in STONE)}"/>']
    return [
        '    <shape type="ply">',
        f'        <string name="filename" value="{attribute(path.name)}"/>',
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


def xml_text(text: str) -> str:
    """The text with every character that XML 1.0 or UTF-8 cannot carry made an underscore."""
    return "".join(c if _is_xml(ord(c)) else "_" for c in text)


def _is_xml(code: int) -> bool:
    return code >= 0x20 and not 0xD800 <= code <= 0xDFFF and code not in (0x7F, 0xFFFE, 0xFFFF)


def attribute(text: str) -> str:
    """Text for an XML attribute; Mitsuba takes `$name` for a parameter unless escaped."""
    from xml.sax.saxutils import escape

    return escape(xml_text(text), {'"': "&quot;"}).replace("$", "\\$")
