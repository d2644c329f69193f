"""Reading and writing of 3D Gaussian splats in the PLY layout of their training.

Each splat has a centre, the logarithms of three standard deviations, a quaternion (real part
first), the logit of an opacity, and colours as real spherical harmonics: `f_dc_*` of degree 0,
`f_rest_*` of higher degrees, in the order red, green, blue. See Kerbl et al., 3D Gaussian Splatting
for Real-Time Radiance Field Rendering, SIGGRAPH 2023.

Mitsuba's `ellipsoids` shapes trust such a file: they rely on the order of its properties, read all
as floats, and allocate memory by the header. `check_splats` verifies this layout first.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from inim.render.meshes.ply import PlyHeader, columns_of, is_ply, ply_header, write_header
from inim.system.errors import FileError
from inim.system.process.atomic_file import write_atomically

#: Mitsuba's shapes that read such a file.
SPLAT_SHAPES = frozenset({"ellipsoids", "ellipsoidsmesh"})
_CENTRE = ("x", "y", "z")
_NORMAL = ("nx", "ny", "nz")
_DC = ("f_dc_0", "f_dc_1", "f_dc_2")
_SCALE = ("scale_0", "scale_1", "scale_2")
_TURN = ("rot_0", "rot_1", "rot_2", "rot_3")
# Number of coefficients per colour up to degree 0, 1, 2 and 3.
_HARMONICS = (1, 4, 9, 16)
# Squares must stay finite in float32, as for meshes. The logarithm bounds the scales.
_MOST_EXTENT = 1e15
_MOST_LOG = float(np.log(_MOST_EXTENT))


@dataclass(frozen=True)
class Splats:
    """3D Gaussians with colours that depend on the direction."""

    centre: np.ndarray  #: (n, 3) float32
    #: (n, 3) float32: logarithms of the standard deviations along the splat's axes.
    log_scale: np.ndarray
    #: (n, 4) float32: unit quaternions from the splat's axes to the file's, real part first.
    turn: np.ndarray
    logit: np.ndarray  #: (n,) float32: logit of the opacity.
    #: (n, 1, 4, 9 or 16, 3) float32: coefficients of red, green and blue, for the direction of the
    #: ray. The sRGB colour is the expansion plus 0.5.
    harmonics: np.ndarray

    def __len__(self) -> int:
        return len(self.centre)

    def __getitem__(self, index: np.ndarray) -> Splats:
        return Splats(*(getattr(self, name)[index] for name in self.__dataclass_fields__))

    @property
    def opacity(self) -> np.ndarray:
        """Opacity, (n,) float64 from 0 to 1."""
        opacity: np.ndarray = 1 / (1 + np.exp(-self.logit.astype(np.float64)))
        return opacity


def is_splats(data: bytes) -> bool:
    """True if the content is a PLY of splats, plain or packed."""
    if not is_ply(data):
        return False
    words = data[: max(0, data.find(b"end_header"))].split()
    return not {b"f_dc_0", b"scale_0", b"packed_position"}.isdisjoint(words)


def read_splats(path: Path, data: bytes) -> Splats:
    """Read the splats of a PLY with properties in any order.

    Raises `FileError`: the file is truncated, lacks a property, or has invalid values.
    """
    return _splats(path, data, ply_header(path, data))


def check_splats(path: Path, data: bytes) -> int:
    """Count the splats of a PLY and check that Mitsuba reads them correctly.

    Raises `FileError`: as for `read_splats`, and if Mitsuba would confuse the properties.
    """
    header = ply_header(path, data)
    splats = _splats(path, data, header)
    fields = [(name, "f4") for name in _names(splats.harmonics.shape[1])]
    if header.order != "<" or header.elements[0].fields != fields:
        raise FileError(
            f"{path}: the order or type of its splats' properties differs from the training "
            "layout, which Mitsuba needs; convert it with `inim new-scene`"
        )
    return len(splats)


def write_splats(path: Path, splats: Splats) -> None:
    """Write a PLY in the layout that Mitsuba reads; atomic."""
    rest = splats.harmonics[:, 1:].transpose(0, 2, 1).reshape(len(splats), -1)
    columns = [
        splats.centre, np.zeros_like(splats.centre), splats.harmonics[:, 0], rest,
        splats.logit[:, None], splats.log_scale, splats.turn,
    ]  # fmt: skip
    records = np.hstack(columns).astype("<f4")
    head = write_header(_names(splats.harmonics.shape[1]), len(splats))

    def write(temporary: Path) -> None:
        with temporary.open("wb") as file:
            file.write(head)
            records.tofile(file)

    write_atomically(path, write)


def _names(harmonics: int) -> tuple[str, ...]:
    """Properties in the order that Mitsuba expects."""
    rest = tuple(f"f_rest_{k}" for k in range(3 * (harmonics - 1)))
    return (*_CENTRE, *_NORMAL, *_DC, *rest, "opacity", *_SCALE, *_TURN)


def _splats(path: Path, data: bytes, header: PlyHeader) -> Splats:
    element = next((element for element in header.elements if element.name == "vertex"), None)
    names = [name for name, _ in element.fields] if element else []
    if "packed_position" in names:
        raise FileError(f"{path}: holds packed splats; export it as a plain, uncompressed PLY")
    missing = [name for name in (*_CENTRE, *_DC, "opacity", *_SCALE, *_TURN) if name not in names]
    if element is None or missing:
        raise FileError(f"{path}: its splats have no {missing[0]!r}; export them again")
    higher = sum(name.startswith("f_rest_") for name in names)
    degrees = [count for count in _HARMONICS if 3 * (count - 1) == higher]
    if not degrees or not {f"f_rest_{k}" for k in range(higher)} <= set(names):
        raise FileError(
            f"{path}: its splats have {higher} f_rest_*; degrees 0 to 3 have 0, 9, 24 or 45"
        )
    if not element.count:
        raise FileError(f"{path}: holds no splats; export them again")
    columns = columns_of(data, header)
    if columns is None:
        raise FileError(f"{path}: its length does not match its header; it is cut short or damaged")
    vertex = columns["vertex"]

    def stack(properties: tuple[str, ...]) -> np.ndarray:
        values = np.empty((element.count, len(properties)), np.float32)
        with np.errstate(over="ignore"):  # overflow gives infinity, refused below
            for k, name in enumerate(properties):
                values[:, k] = vertex[name]
        return values

    rest = stack(tuple(f"f_rest_{k}" for k in range(higher)))
    colours = [stack(_DC)[:, None], rest.reshape(element.count, 3, -1).transpose(0, 2, 1)]
    splats = Splats(
        stack(_CENTRE), stack(_SCALE), stack(_TURN), stack(("opacity",))[:, 0],
        np.concatenate(colours, axis=1),
    )  # fmt: skip
    length = np.linalg.norm(splats.turn.astype(np.float64), axis=1, keepdims=True)
    _check(path, splats, length[:, 0])
    splats.turn[:] = splats.turn / length
    return splats


def _check(path: Path, splats: Splats, length: np.ndarray) -> None:
    """Raise `FileError` for the first invalid splat; `length` (float64) is of the quaternions."""
    problems = {
        "is not finite": ~np.logical_and.reduce(
            [np.isfinite(part).reshape(len(part), -1).all(axis=1) for part in vars(splats).values()]
        ),
        "has no orientation (its quaternion is zero)": ~(length > 0),
        "has an implausible position or size": (np.abs(splats.centre) > _MOST_EXTENT).any(axis=1)
        | (splats.log_scale > _MOST_LOG).any(axis=1),
        "is implausibly thin": (splats.log_scale < -_MOST_LOG).any(axis=1),
    }
    for problem, mask in problems.items():
        if mask.any():
            raise FileError(
                f"{path}: splat {int(mask.argmax())} {problem}; clean the file and export it again"
            )
