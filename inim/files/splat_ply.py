"""3D Gaussian splats in and out: the PLY that their training writes.

Of each splat it holds a centre, the logarithms of three standard deviations, a quaternion (real
part first), the logit of an opacity, and colours as real spherical harmonics: `f_dc_*` of degree 0,
`f_rest_*` of the higher ones, all of red first, then of green, then of blue. After Kerbl et al.,
3D Gaussian Splatting for Real-Time Radiance Field Rendering, SIGGRAPH 2023.

Mitsuba's `ellipsoids` shapes trust such a file: they go by the order of its properties, take each
for a float, and allocate what its header says. `check_splats` holds it against that first.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from inim.errors import FileError
from inim.files.image import write_atomically
from inim.files.ply import PlyHeader, columns_of, is_ply, ply_header

#: Mitsuba's shapes that are made of such a file.
SPLAT_SHAPES = frozenset({"ellipsoids", "ellipsoidsmesh"})
_CENTRE = ("x", "y", "z")
_NORMAL = ("nx", "ny", "nz")
_DC = ("f_dc_0", "f_dc_1", "f_dc_2")
_SCALE = ("scale_0", "scale_1", "scale_2")
_TURN = ("rot_0", "rot_1", "rot_2", "rot_3")
# Coefficients of one colour up to degree 0, 1, 2 and 3.
_HARMONICS = (1, 4, 9, 16)
# As for meshes: squares must stay finite in float32. Logarithms of it bound the scales.
_MOST_EXTENT = 1e15
_MOST_LOG = float(np.log(_MOST_EXTENT))


@dataclass(frozen=True)
class Splats:
    """3D Gaussians with colours that depend on the direction.

    Attributes
    ----------
    centre : (n, 3) float32
    log_scale : (n, 3) float32
        Logarithms of the standard deviations along the splat's own axes.
    turn : (n, 4) float32
        Unit quaternions from the splat's axes to the file's, real part first.
    logit : (n,) float32
        Of the opacity.
    harmonics : (n, 1, 4, 9 or 16, 3) float32
        Coefficients of red, green and blue; a colour is their sum and 0.5, sRGB. They are functions
        of the direction that the ray runs in.
    """

    centre: np.ndarray
    log_scale: np.ndarray
    turn: np.ndarray
    logit: np.ndarray
    harmonics: np.ndarray

    def __len__(self) -> int:
        return len(self.centre)

    def __getitem__(self, which: np.ndarray) -> Splats:
        return Splats(*(getattr(self, name)[which] for name in self.__dataclass_fields__))

    @property
    def opacity(self) -> np.ndarray:
        """(n,) float64, 0 to 1."""
        shown: np.ndarray = 1 / (1 + np.exp(-self.logit.astype(np.float64)))
        return shown


def is_splats(data: bytes) -> bool:
    """Whether a file opens as a PLY of splats, of a kind that is read here or packed."""
    if not is_ply(data):
        return False
    words = data[: max(0, data.find(b"end_header"))].split()
    return not {b"f_dc_0", b"scale_0", b"packed_position"}.isdisjoint(words)


def read_splats(path: Path, data: bytes) -> Splats:
    """The splats of a PLY, its properties in any order.

    Raises
    ------
    FileError
        Cut short, without a property that splats have, or with values that make no splat; one line
        naming the file and the cause.
    """
    return _splats(path, data, ply_header(path, data))


def check_splats(path: Path, data: bytes) -> int:
    """How many splats a PLY has that Mitsuba reads rightly.

    Raises
    ------
    FileError
        As `read_splats`, and where Mitsuba would take one property for another.
    """
    header = ply_header(path, data)
    splats = _splats(path, data, header)
    fields = tuple((name, "f4") for name in _names(splats.harmonics.shape[1]))
    if header.order != "<" or header.elements[0].fields != fields:
        raise FileError(
            f"{path}: its splats are not laid out as their training writes them, and Mitsuba would "
            "misread them; convert it with `inim new-scene`"
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
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(splats)}"]
    header += [f"property float {name}" for name in _names(splats.harmonics.shape[1])]
    head = ("\n".join([*header, "end_header"]) + "\n").encode("ascii")

    def write(made: Path) -> None:
        with made.open("wb") as file:
            file.write(head)
            records.tofile(file)

    write_atomically(path, write)


def _names(harmonics: int) -> tuple[str, ...]:
    """The properties in the order that Mitsuba goes by."""
    rest = tuple(f"f_rest_{k}" for k in range(3 * (harmonics - 1)))
    return (*_CENTRE, *_NORMAL, *_DC, *rest, "opacity", *_SCALE, *_TURN)


def _splats(path: Path, data: bytes, header: PlyHeader) -> Splats:
    element = next((one for one in header.elements if one.name == "vertex"), None)
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

    def stacked(wanted: tuple[str, ...]) -> np.ndarray:
        made = np.empty((element.count, len(wanted)), np.float32)
        with np.errstate(over="ignore"):  # beyond float32's range is infinite: refused below
            for k, name in enumerate(wanted):
                made[:, k] = vertex[name]
        return made

    rest = stacked(tuple(f"f_rest_{k}" for k in range(higher)))
    colours = [stacked(_DC)[:, None], rest.reshape(element.count, 3, -1).transpose(0, 2, 1)]
    splats = Splats(
        stacked(_CENTRE), stacked(_SCALE), stacked(_TURN), stacked(("opacity",))[:, 0],
        np.concatenate(colours, axis=1),
    )  # fmt: skip
    length = np.linalg.norm(splats.turn.astype(np.float64), axis=1, keepdims=True)
    _check(path, splats, length[:, 0])
    splats.turn[:] = splats.turn / length
    return splats


def _check(path: Path, splats: Splats, length: np.ndarray) -> None:
    """Values that make splats, or a FileError naming the first that does not.

    `length` is that of their quaternions: its squares leave float32's range, not float64's.
    """
    wrong = {
        "is not finite": ~np.isfinite(splats.centre).all(axis=1)
        | ~np.isfinite(splats.log_scale).all(axis=1)
        | ~np.isfinite(splats.turn).all(axis=1)
        | ~np.isfinite(splats.logit)
        | ~np.isfinite(splats.harmonics).all(axis=(1, 2)),
        "has no orientation (its quaternion is zero)": ~(length > 0),
        "lies or reaches impossibly far": (np.abs(splats.centre) > _MOST_EXTENT).any(axis=1)
        | (splats.log_scale > _MOST_LOG).any(axis=1),
        "is impossibly thin": (splats.log_scale < -_MOST_LOG).any(axis=1),
    }
    for words, where in wrong.items():
        if where.any():
            raise FileError(
                f"{path}: splat {int(where.argmax())} {words}; clean the file and export it again"
            )
