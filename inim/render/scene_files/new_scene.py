"""A lit Mitsuba 3 scene of a relic, from a mesh or from Gaussian splats.

The mesh is rotated (+y up, +z towards the viewer), scaled to millimetres, centred and written as
PLY next to the scene. Units and axes that a format does not define are requested, never guessed.
Splats (`inim.render.scene_files.relic_scene`) have no unit, and emit light. `mi.load_file` opens
the scene.
"""

from __future__ import annotations

import re
import warnings
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from inim.system.errors import FileError, UsageError
from inim.system.files import read_file
from inim.system.process.atomic_file import file_errors, published_together, write_atomically

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence

    import numpy as np

    from inim.render.meshes.triangle_mesh import Mesh
    from inim.render.scene_files.relic_scene import Frame

    # Path of each part of a scene, and the function that writes it.
    _Writers = dict[Path, Callable[[Path], object]]

# The limit of `inim.render.scene_files.file`.
_MOST_SCENE_BYTES = 2**26
UNITS = ("mm", "cm", "m", "in")
#: Unit of a relic whose size does not matter, for formats with and without units.
ANY_UNIT = "any"
_PLAUSIBLE_MM = (2.0, 30_000.0)
AXES = {
    f"{sign}{axis}": tuple((-1 if sign else 1) * (axis == other) for other in "xyz")
    for sign in ("", "-")
    for axis in "xyz"
}
# Default axis towards the viewer by the upward axis: of glTF for y, of CAD and Blender for z.
_USUAL_FRONT = {"y": "z", "-y": "z", "z": "-y", "-z": "-y", "x": "z", "-x": "z"}


def new_scene(
    source: Path | str,
    out: Path | str | None = None,
    *,
    unit: str | None = None,
    up: str | None = None,
    front: str | None = None,
    crop: str | None = None,
    title: str | None = None,
    display: str | None = None,
    force: bool = False,
    warn: Callable[[str], object] = warnings.warn,
    say: Callable[[str], object] | None = None,
) -> Path:
    """Write a scene for a mesh or splats, with PLY files and textures in the same folder.

    Parameters
    ----------
    source : path
        PLY, OBJ, OFF, STL, GLB or glTF, or a PLY of 3D Gaussian splats; or a folder with one
        such file, such as that of a photogrammetry program.
    out : path, optional
        The scene's XML; default: `<source>-scene.xml` in the current folder.
    unit : {"mm", "cm", "m", "in", "any"}, optional
        Length of one unit of the file; may be omitted for glTF (metres), and must be for splats.
        "any" suits every file: images do not depend on the size of a relic.
    up, front : str, optional
        Axes of the file, x, -x, y, ..., that point up and towards the viewer. `up` may be omitted
        for glTF only (y); `front` is by default z, or -y if z is up.
    crop : str, optional
        Box of splats to keep, ``"x0,x1,y0,y1,z0,z1"`` in the file's axes and unit; by default
        nearly all.
    title : str, optional
        Name in reports; default: the file's.
    display : str, optional
        Preset to write into the scene.
    force : bool
        Replace existing files, and remove numbered parts that only the replaced scene needs.
    warn : callable
        Receives warnings as text; by default `warnings.warn`.
    say : callable, optional
        Receives a note on the box of splats.

    Returns
    -------
    Path
        `out`.

    Raises
    ------
    FileError
        The mesh is unusable, or the scene cannot be written.
    UsageError
        A missing or impossible unit or axis, an unknown display, or a file in the way.
    """
    from inim.render.meshes.splat_ply import is_splats
    from inim.render.meshes.triangle_mesh import read_bytes
    from inim.render.scene_files.relic_scene import Frame, scene_xml, splat_scene_xml

    source, note = _mesh_in(Path(source)), ""
    out = Path(f"{source.stem}-scene.xml") if out is None else Path(out)
    _check_choices(out, unit, up, front, display)
    data, title = read_bytes(source), title or source.stem
    cautions: list[str] = []
    writers: _Writers
    if is_splats(data):
        if unit not in (None, ANY_UNIT):
            raise UsageError(f"{source}: splats have no unit; leave out --unit {unit}")
        frame = None if crop is None else Frame.parse(crop)
        writers, half, cautions, note = _place_splats(source, data, out, up, front, frame)
        xml = splat_scene_xml(next(iter(writers)).name, half, title, display)
    else:
        if crop is not None:
            raise UsageError(f"{source}: --crop is for splats; crop a mesh in a mesh editor")
        parts, size, note = _place_mesh(source, data, unit, up, front, warn)
        files = _part_files(out, parts)
        writers = {path: partial(_write_part, part) for path, part in files.items()}
        cautions = [] if unit == ANY_UNIT else _size_warnings(source, float(size.max()))
        xml = scene_xml(files, size / 2, title, display)
    _check_targets(source, [out, *writers], force)
    for text in cautions:
        warn(text)
    leftovers = [path for path in _leftovers(out, writers) if not path.samefile(source)]
    _write_all(out, writers, xml, leftovers)
    if note and say is not None:
        say(note)
    return out


def _mesh_in(source: Path) -> Path:
    """The only mesh of a folder; any other path unchanged."""
    from inim.render.meshes.triangle_mesh import MESH_SUFFIXES

    if not source.is_dir():
        return source
    meshes = sorted(path for path in source.iterdir() if path.suffix.lower() in MESH_SUFFIXES)
    if len(meshes) != 1:
        names = ", ".join(path.name for path in meshes[:5]) or ", ".join(MESH_SUFFIXES)
        raise FileError(f"{source}: has {len(meshes)} meshes ({names}); name the file")
    return meshes[0]


def _place_mesh(
    source: Path,
    data: bytes,
    unit: str | None,
    up: str | None,
    front: str | None,
    warn: Callable[[str], object],
) -> tuple[Sequence[Mesh], np.ndarray, str]:
    """Read, rotate, scale and centre a mesh; return its parts, the size of their box in mm, and
    an account of the file.
    """
    from inim.render.meshes.account import mesh_account
    from inim.render.meshes.mesh import UNIT_MM, mesh_kind, read_mesh
    from inim.render.meshes.triangle_mesh import add_vertex_normals, bounds, coarse_text
    from inim.render.scene_files.relic_scene import is_black, merge_meshes, place_meshes

    meshes = read_mesh(source, warn, data)
    account = mesh_account(data, mesh_kind(source, data), meshes)
    unit, up = _unit_and_up(source, meshes, unit, up)
    turn = _turn(up, front or _USUAL_FRONT[up])
    parts = place_meshes(merge_meshes([add_vertex_normals(m) for m in meshes]), turn, UNIT_MM[unit])
    low, high = bounds(parts)
    for text in account.lost(parts, UNIT_MM[unit]):
        warn(f"{source}: {text}")
    if any(
        coarse_text(m.vertices) and (m.vertices == m.vertices.astype("f4")).all() for m in meshes
    ):
        warn(f"{source}: {coarse_text(meshes[0].vertices)}; export it closer to its origin")
    if all(is_black(part) for part in parts):
        warn(f"{source}: all of its colours are black, so the relic is")
    return parts, high - low, f"read {account.text}"


def _place_splats(
    source: Path, data: bytes, out: Path, up: str | None, front: str | None, frame: Frame | None
) -> tuple[_Writers, np.ndarray, list[str], str]:
    """Rotate, crop and scale splats; return their writer, half their size, warnings and a note."""
    from inim.render.meshes.splat_ply import read_splats, write_splats
    from inim.render.scene_files.relic_scene import Frame, place_splats

    splats = read_splats(source, data)
    frame = Frame.around(splats) if frame is None else frame
    if up is None:
        raise UsageError(
            f"{source}: splat files contain no up axis; give --up (x, y, z, -x, -y, -z), usually "
            f"-y; nearly all splats are in {frame} (x0,x1,y0,y1,z0,z1)"
        )
    try:
        visible, half = place_splats(splats, _turn(up, front or _USUAL_FRONT[up]), frame)
    except UsageError as error:
        raise UsageError(f"{source}: {error}") from None
    counts = f"{len(visible)} of {len(splats)} splats"
    cautions = []
    if len(visible) < len(splats):
        cautions.append(
            f"{source}: {counts} are shown; the others are fainter than a hundredth, outside "
            f"--crop {frame}, or half as wide as that box"
        )
    writers: _Writers = {out.parent / f"{_stem(out)}.ply": lambda path: write_splats(path, visible)}
    return writers, half, cautions, f"took {counts}, --crop={frame}"


# --- Arguments ----------------------------------------------------------------------------------


def _check_choices(
    out: Path, unit: str | None, up: str | None, front: str | None, display: str | None
) -> None:
    from inim.display import DISPLAYS

    if unit is not None and unit not in (*UNITS, ANY_UNIT):
        raise UsageError(f"--unit {unit}: unknown; one of {', '.join(UNITS)}")
    for option, axis in (("--up", up), ("--front", front)):
        if axis is not None and axis not in AXES:
            raise UsageError(f"{option} {axis}: unknown axis; one of {', '.join(AXES)}")
    if display is not None and display not in DISPLAYS:
        raise UsageError(f"--display {display}: unknown; one of {', '.join(DISPLAYS)}")
    if out.is_dir() or not out.name:
        raise UsageError(f"{out}: is a folder; name the scene's file, such as {out / 'relic.xml'}")
    if out.suffix.lower() in (".ply", ".png"):
        raise UsageError(f"{out}: the scene's parts use that name; name the scene {out.stem}.xml")


def _unit_and_up(
    source: Path, meshes: Sequence[Mesh], unit: str | None, up: str | None
) -> tuple[str, str]:
    """Unit and up axis, from the format's standard where it has one."""
    if source.suffix.lower() in (".glb", ".gltf"):
        unit, up = unit or "m", up or "y"
    unit = "mm" if unit == ANY_UNIT else unit
    if unit is None or up is None:
        from inim.render.meshes.triangle_mesh import bounds

        low, high = bounds(meshes)
        size = " x ".join(f"{length:.4g}" for length in high - low)
        missing, options = [], []
        if unit is None:
            missing.append("length unit")
            options.append(f"--unit ({', '.join(UNITS)})")
        if up is None:
            missing.append("up axis")
            options.append(f"--up (perhaps {'xyz'[(high - low).argmax()]}, the longest)")
        raise UsageError(
            f"{source}: the format contains no {' and no '.join(missing)}; the mesh is {size} "
            f"units along x, y, z. Give {' and '.join(options)}."
        )
    return unit, up


def _size_warnings(source: Path, largest_mm: float) -> list[str]:
    """Warn of a unit that makes a relic smaller than a bead or larger than a temple."""
    if _PLAUSIBLE_MM[0] <= largest_mm <= _PLAUSIBLE_MM[1]:
        return []
    size = f"{largest_mm:.3g} mm" if largest_mm < 1000 else f"{largest_mm / 1000:.3g} m"
    return [f"{source}: is {size} large; is --unit right? Images do not depend on it"]


def _turn(up: str, front: str) -> np.ndarray:
    """Rotation (3, 3) that takes `up` to +y and `front` to +z."""
    import numpy as np

    y, z = np.array(AXES[up], float), np.array(AXES[front], float)
    if y @ z:
        free = [axis for axis in AXES if axis[-1] != up[-1]]
        raise UsageError(f"--front {front}: is parallel to --up {up}; use one of {', '.join(free)}")
    return np.stack([np.cross(y, z), y, z])


def _check_targets(source: Path, targets: Sequence[Path], force: bool) -> None:
    for target in targets:
        if target.exists() and source.exists() and target.samefile(source):
            raise UsageError(f"{target}: is the mesh itself; choose another name with -o")
        if target.exists() and not force:
            raise UsageError(f"{target}: exists already; add --force or choose another -o")


# --- Files --------------------------------------------------------------------------------------


def _part_files(out: Path, parts: Sequence[Mesh]) -> dict[Path, Mesh]:
    """Path of every PLY and PNG to write, and the part it holds."""
    files = {}
    for k, part in enumerate(parts):
        name = _stem(out) if k == 0 else f"{_stem(out)}-{k + 1}"
        files[out.parent / f"{name}.ply"] = part
        if part.texture is not None:
            files[out.parent / f"{name}.png"] = part
    return files


def _stem(out: Path) -> str:
    """Name of the scene for its parts, without characters special to XML or Mitsuba."""
    from inim.render.scene_files.relic_scene import xml_text

    return xml_text(out.stem).replace("\\", "_").replace("$", "_") or "relic"


def _leftovers(out: Path, files: Collection[Path]) -> list[Path]:
    """Numbered parts that the existing scene `out` names and the new scene does not need."""
    from inim.render.scene_files.relic_scene import xml_attribute

    try:
        text = read_file(out, _MOST_SCENE_BYTES).decode("utf-8", errors="replace")
    except FileError:  # there is no earlier scene
        return []
    ours = re.compile(re.escape(_stem(out)) + r"-\d+\.(?:ply|png)")
    return [
        path
        for path in out.parent.iterdir()
        if ours.fullmatch(path.name)
        and path not in files
        and f'"{xml_attribute(path.name)}"' in text
        # The file relic-2.ply belongs to the scene relic-2.xml, if that exists.
        and not path.with_suffix(out.suffix).exists()
    ]


def _write_all(
    out: Path, files: Mapping[Path, Callable[[Path], object]], xml: str, leftovers: Sequence[Path]
) -> None:
    """Write all files or none, `out` last; then remove the leftovers."""
    with published_together():
        for path, write in files.items():
            write(path)
        write_atomically(out, lambda p: p.write_text(xml, encoding="utf-8"))
    for path in leftovers:
        with file_errors(path):
            path.unlink(missing_ok=True)


def _write_part(part: Mesh, path: Path) -> None:
    """Write a part's PLY, or its texture."""
    from PIL import Image

    from inim.render.meshes.ply import write_ply

    if path.suffix == ".png":
        write_atomically(path, lambda p: Image.fromarray(part.texture).save(p, "PNG"))
    else:
        write_ply(path, part)
