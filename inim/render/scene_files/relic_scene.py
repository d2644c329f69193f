"""New scenes of a relic, rotated, scaled and centred: from meshes, or from 3D Gaussian splats.

Meshes are lit from three sides. Mitsuba's `to_world` rotates splats, but not their colours, which
are functions of the direction in the file's axes. Splats are therefore rotated in this module, with
their harmonics, and written to a new file. Their file has no unit of length. The relic becomes
`SIZE_MM` large, because the integrator continues 1e-4 units behind each splat that it enters: a
small distance relative to the splats, and a large one relative to the rounding of coordinates.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from inim.image.color import linear_from_srgb
from inim.render.meshes.splat_ply import Splats
from inim.render.meshes.triangle_mesh import Mesh, bounds
from inim.system.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path


def merge_meshes(meshes: Sequence[Mesh]) -> list[Mesh]:
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


def place_meshes(meshes: Sequence[Mesh], turn: np.ndarray, scale_mm: float) -> list[Mesh]:
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


def scene_xml(
    files: Mapping[Path, Mesh], half_mm: np.ndarray, title: str, display: str | None = None
) -> str:
    """Text of the scene.

    * `files`: the relic's PLY files in the scene's folder; a texture is a PNG next to its file.
    * `half_mm`, (3,) float array: half the size of the relic's bounding box, which is centred on
      the origin.
    * `title`, `display`: values of `inim.title` and `inim.display`; without a display, the default
      applies.
    """
    radius = math.hypot(*half_mm)
    lines = defaults_xml(title, display)
    lines += ['    <integrator type="path">', '        <integer name="max_depth" value="6"/>']
    lines += ["    </integrator>", "", *camera_xml(half_mm, radius), ""]
    brightest = max(map(_brightest, files.values()))
    share = max(STONE) / max(brightest, max(STONE))
    for name, (direction, half_side, radiance) in _LAMPS.items():
        light = tuple(share * r for r in radiance)
        lines += [f"    <!-- {name} -->", *_lamp_xml(direction, half_side, light, radius), ""]
    for path in files:
        if path.suffix == ".ply":
            lines += [*_relic_xml(path, files[path]), ""]
    return "\n".join([*lines[:-1], "</scene>", ""])


def is_black(part: Mesh) -> bool:
    """True if nearly all colours of a part are black."""
    return _brightest(part) == 0


def _brightest(part: Mesh) -> float:
    """Share of light reflected by the brightest hundredth of a part, linear."""
    if part.texture is not None:
        code = np.quantile(part.texture.max(axis=-1), _BRIGHTEST_QUANTILE)
        return float(linear_from_srgb(code / 255))
    if part.color is not None:
        return float(np.quantile(part.color.max(axis=-1), _BRIGHTEST_QUANTILE))
    return max(STONE)


def defaults_xml(title: str, display: str | None) -> list[str]:
    """First lines of a new scene: its settings, and robust intersections."""
    defaults = {"title": title, **({} if display is None else {"display": display})}
    lines = ["<?xml version='1.0' encoding='utf-8'?>", '<scene version="3.0.0">']
    lines += ["    <!-- Lengths are millimetres; +y is up, +z towards the viewer. -->"]
    for key, value in defaults.items():
        lines.append(f'    <default name="inim.{key}" value="{xml_attribute(value)}"/>')
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
            f'    <string name="filename" value="{xml_attribute(path.with_suffix(".png").name)}"/>',
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
        f'        <string name="filename" value="{xml_attribute(path.name)}"/>',
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


_NOT_XML = re.compile(r"[\x00-\x1f\x7f\ud800-\udfff\ufffe\uffff]")


def xml_text(text: str) -> str:
    """The text with every character that XML 1.0 or UTF-8 cannot carry made an underscore."""
    return _NOT_XML.sub("_", text)


def xml_attribute(text: str) -> str:
    """Text for an XML attribute; Mitsuba takes `$name` for a parameter unless escaped."""
    from xml.sax.saxutils import escape

    return escape(xml_text(text), {'"': "&quot;"}).replace("$", "\\$")


#: The largest side of a relic of splats.
SIZE_MM = 100.0
# Of a splat's greatest share of light, below which it counts as nothing: Mitsuba's
# `extent_adaptive_clamping` ends its support there, and cannot take a fainter one.
_FAINTEST = 0.01
# Splats far out are few and faint: this share of all opacity is left out at each end of an axis,
# and the frame widened by so much of its largest side.
_STRAY = 0.005
_WIDER = 0.05
# Splats that reach farther, in largest sides of the frame, are fog or background.
_FARTHEST = 0.25
# Turned at a time: harmonics of a million splats take 0.2 GB.
_SPLATS_AT_ONCE = 2**17


@dataclass(frozen=True)
class Frame:
    """A box in the axes of a file, from its lower corner (3,) to its upper one."""

    low: np.ndarray
    high: np.ndarray

    @classmethod
    def parse(cls, words: str) -> Frame:
        """The box of `--crop`: x0,x1,y0,y1,z0,z1.

        Raises `UsageError`.
        """
        try:
            numbers = np.array([float(word) for word in words.split(",")]).reshape(3, 2)
        except ValueError:
            raise UsageError(f"--crop {words}: write six numbers, x0,x1,y0,y1,z0,z1") from None
        low, high = numbers.T
        if not (np.isfinite(numbers).all() and (low < high).all()):
            raise UsageError(f"--crop {words}: each axis needs a finite lower and a higher end")
        return cls(low, high)

    @classmethod
    def around(cls, splats: Splats) -> Frame:
        """The box that holds nearly all opacity, along each axis."""
        weight = splats.opacity
        low, high = np.zeros((2, 3))
        for axis, places in enumerate(splats.centre.T.astype(np.float64)):
            order = np.argsort(places, kind="stable")
            share = weight[order].cumsum() / weight.sum()
            low[axis], high[axis] = places[order][np.searchsorted(share, (_STRAY, 1 - _STRAY))]
        margin = _WIDER * (high - low).max()
        return cls(low - margin, high + margin)

    def holds(self, points: np.ndarray) -> np.ndarray:
        """Mask of points, (n, 3), inside the box."""
        inside: np.ndarray = np.all((points >= self.low) & (points <= self.high), axis=1)
        return inside

    def __str__(self) -> str:
        return ",".join(
            f"{end:.4g}" for pair in zip(self.low, self.high, strict=True) for end in pair
        )


def place_splats(splats: Splats, turn: np.ndarray, frame: Frame) -> tuple[Splats, np.ndarray]:
    """The splats in a frame, turned, `SIZE_MM` large, about the origin.

    * `turn`, (3, 3) float64: rotation from the file's axes to the scene's.
    * `frame`: holds their centres.

    Returns `splats`; `half_mm`, (3,) float64: half the size of the box that their supports reach.

    Raises `UsageError`: none are left.
    """
    visible = splats[splats.opacity > _FAINTEST]
    small = _reach(visible).max(axis=1) <= _FARTHEST * (frame.high - frame.low).max()
    inside = frame.holds(visible.centre) & small
    if not inside.any():
        faint = len(splats) - len(visible)
        raise UsageError(
            f"no splat can be shown: {faint} of {len(splats)} are fainter than a hundredth, and "
            f"the others lie outside the box {frame}, or are half as wide; nearly all splats are "
            f"in {Frame.around(splats)}; to use another box, give --crop"
        )
    relic = rotate_splats(visible[inside], turn)
    reach = _reach(relic)
    low, high = (relic.centre - reach).min(axis=0), (relic.centre + reach).max(axis=0)
    scale = SIZE_MM / (high - low).max()
    centre = (relic.centre - (low + high) / 2) * scale
    log_scale = relic.log_scale + np.float32(np.log(scale))
    moved = replace(relic, centre=centre.astype(np.float32), log_scale=log_scale)
    return moved, (high - low) / 2 * scale


def rotate_splats(splats: Splats, turn: np.ndarray) -> Splats:
    """Splats after a rotation, (3, 3): centres, axes and colours."""
    harmonics = np.empty_like(splats.harmonics)
    bands = [(k * k, (k + 1) ** 2) for k in range(4) if k * k < harmonics.shape[1]]
    matrices = [_band_rotation(turn, first, last) for first, last in bands]
    for start in range(0, len(splats), _SPLATS_AT_ONCE):
        block = np.s_[start : start + _SPLATS_AT_ONCE]
        for (first, last), matrix in zip(bands, matrices, strict=True):
            own = splats.harmonics[block, first:last].astype(np.float64)
            harmonics[block, first:last] = np.einsum("ij,njc->nic", matrix, own)
    turned = Rotation.from_matrix(turn) * _rotations(splats)
    return replace(
        splats,
        centre=(splats.centre @ turn.T).astype(np.float32),
        turn=np.roll(turned.as_quat(), 1, axis=1).astype(np.float32),
        harmonics=harmonics,
    )


def splat_scene_xml(name: str, half_mm: np.ndarray, title: str, display: str | None = None) -> str:
    """The scene's text.

    * `name`: of the PLY file, in the scene's folder.
    * `half_mm`, (3,) float64: half the size of the relic, which is centred on the origin.
    * `title`, `display`: see `scene_xml`.
    """
    lines = defaults_xml(title, display)
    # Rays meet splats by the hundred; Mitsuba's default ends them at the 64th.
    lines += ['    <integrator type="volprim_rf_basic">']
    lines += ['        <integer name="max_depth" value="4096"/>', "    </integrator>", ""]
    lines += [*camera_xml(half_mm, float(np.linalg.norm(half_mm))), ""]
    # `ellipsoids` meets thin splats twice: its intersections round too much.
    lines += ['    <shape type="ellipsoidsmesh">']
    lines += [f'        <string name="filename" value="{xml_attribute(name)}"/>']
    lines += ['        <boolean name="extent_adaptive_clamping" value="true"/>', "    </shape>"]
    return "\n".join([*lines, "</scene>", ""])


def _reach(splats: Splats) -> np.ndarray:
    """Half the sizes of the boxes of splats' supports, (n, 3) float64."""
    extent = np.sqrt(2 * np.log(np.maximum(splats.opacity / _FAINTEST, 1)))
    axes = _rotations(splats).as_matrix() * np.exp(splats.log_scale)[:, None]
    reach: np.ndarray = np.linalg.norm(axes, axis=2) * extent[:, None]
    return reach


# --- Rotations ----------------------------------------------------------------------------------


def _rotations(splats: Splats) -> Rotation:
    """Rotations of splats; SciPy has the real part of a quaternion last, splat files first."""
    return Rotation.from_quat(np.roll(splats.turn.astype(np.float64), -1, axis=1))


def _band_rotation(turn: np.ndarray, first: int, last: int) -> np.ndarray:
    """Real Wigner matrix: the effect of a rotation on the coefficients of one degree.

    Turned functions of a degree are of that degree, so the matrix follows from their values in as
    many directions as there are of them, and more for good measure.
    """
    directions = np.random.default_rng(0).normal(size=(4 * (last - first), 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    after, before = (_basis(d)[:, first:last] for d in (directions, directions @ turn))
    matrix: np.ndarray = np.linalg.lstsq(after, before, rcond=None)[0]
    return matrix


def _basis(directions: np.ndarray) -> np.ndarray:
    """Real spherical harmonics up to degree 3, (n, 16), in the order and signs of splat files."""
    x, y, z = directions.T
    ones = np.ones_like(x)
    columns = [
        0.28209479177387814 * ones,
        -0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x,
        1.0925484305920792 * x * y, -1.0925484305920792 * y * z,
        0.31539156525252005 * (3 * z * z - 1), -1.0925484305920792 * x * z,
        0.5462742152960396 * (x * x - y * y),
        -0.5900435899266435 * y * (3 * x * x - y * y), 2.890611442640554 * x * y * z,
        -0.4570457994644658 * y * (5 * z * z - 1), 0.3731763325901154 * z * (5 * z * z - 3),
        -0.4570457994644658 * x * (5 * z * z - 1), 1.445305721320277 * z * (x * x - y * y),
        -0.5900435899266435 * x * (x * x - 3 * y * y),
    ]  # fmt: skip
    return np.stack(columns, axis=-1)
