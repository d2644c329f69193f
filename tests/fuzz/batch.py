"""A child that reads mutated files: `python -m tests.fuzz.batch FORMATS FIRST END CHANNEL`.

It reads files FIRST to END of each format in turn (FORMATS: names with commas between them). It
dies of whatever kills it: that is the finding. Each file is announced on the channel before it is
read and answered for afterwards, so the parent knows which one did it.
"""

from __future__ import annotations

import os
import resource
import signal
import sys
import tempfile
import time
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from inim import backend
from inim.errors import EXIT_USAGE, InimError, OutOfMemoryError
from tests.fuzz.mutations import mutated
from tests.fuzz.specimens import DISPLAY, SPECIMENS

# What one file may cost: the issue's own limits.
MOST_SECONDS = 10
MOST_BYTES = 2**30

_MESH = '<shape type="{}"><string name="filename" value="{}"/></shape>'
_TEXTURED = (
    '<shape type="rectangle"><bsdf type="diffuse"><texture type="bitmap" name="reflectance">'
    '<string name="filename" value="{1}"/></texture></bsdf></shape>'
)
_VOLUME = (
    '<shape type="cube"><bsdf type="null"/><medium type="heterogeneous" name="interior">'
    '<volume type="gridvolume" name="albedo"><string name="filename" value="{1}"/></volume>'
    "</medium></shape>"
)

Read = Callable[[Path], object]


def _open_scene(path: Path) -> None:
    """As the worker does, after the plan as the parent makes it."""
    from inim.pipeline.plan import make_plan
    from inim.pipeline.request import Request
    from inim.render.scene import open_scene

    plan = make_plan(Request(path, path.parent / "out"))
    open_scene(plan.file, plan.display, plan.settings.fit_share)


def _in_a_scene(shape: str, plugin: str) -> Read:
    """The file as a scene's mesh, texture or volume."""

    def read(path: Path) -> None:
        from tests.conftest import scene_text

        scene = path.with_name("scene.xml")
        scene.write_text(scene_text(shape.format(plugin, path.name)))
        _open_scene(scene)

    return read


def _new_scene(path: Path) -> None:
    from inim.commands.new_scene import new_scene

    out = path.parent / "made" / "new.xml"
    new_scene(path, out, unit="mm", up="y", force=True, warn=lambda _: None)


def _eia(path: Path) -> None:
    from inim.files.eia_file import read_eia

    read_eia(path, DISPLAY)


def _rgbd(path: Path) -> None:
    from inim.files.image import read_exr, read_rgbd

    read_exr(path)
    read_rgbd(path)


def _depth(path: Path) -> None:
    from inim.from_camera.picture_files import read_depth

    read_depth(path)


def _color(path: Path) -> None:
    from inim.from_camera.picture_files import read_color

    read_color(path)


#: By format: all doors by which a user's file comes in.
DOORS: dict[str, tuple[Read, ...]] = {
    "exr-rgbd": (_rgbd,),
    "exr-layers": (_rgbd,),
    "exr-eia": (_eia,),
    "png-eia": (_eia,),
    "picture": (_in_a_scene(_TEXTURED, ""),),
    "ply-text": (_new_scene, _in_a_scene(_MESH, "ply")),
    "ply-binary": (_new_scene, _in_a_scene(_MESH, "ply")),
    "obj": (_new_scene, _in_a_scene(_MESH, "obj")),
    "glb": (_new_scene,),
    "gltf": (_new_scene,),
    "stl-text": (_new_scene,),
    "stl-binary": (_new_scene,),
    "serialized": (_in_a_scene(_MESH, "serialized"),),
    "volume": (_in_a_scene(_VOLUME, ""),),
    **{f"depth-{kind}": (_depth,) for kind in ("exr", "png", "ppm", "tiff", "npy", "pfm")},
    "color": (_color,),
    "xml": (_open_scene,),
}

_WITHOUT_RENDERER = (_new_scene, _eia, _rgbd, _depth, _color)


def outcome(read: Read, path: Path) -> str:
    """ "read", "refused", or "WRONG" and what is wrong with how it ended."""
    try:
        read(path)
    except InimError as error:
        return _wrong_refusal(error, path) or "refused"
    except Exception as error:
        return f"WRONG: {type(error).__name__}: {error}"
    return "read"


def _wrong_refusal(error: InimError, path: Path) -> str:
    cause: BaseException | None = error
    while cause:
        if isinstance(cause, MemoryError):
            return "WRONG: asked for more memory than a file may"
        cause = cause.__cause__ or cause.__context__
    text = str(error)
    # A scene may ask for a display too large for this machine: code 3, found out beforehand.
    if error.exit_code != EXIT_USAGE and not isinstance(error, OutOfMemoryError):
        return f"WRONG: exit code {error.exit_code}: {text}"
    named = path.name in text or "scene.xml" in text or path.suffix == ".xml"
    if len(text) > 1500 or not named:
        return f"WRONG: no clear line: {text[:1500]}"
    return ""


def specimen_bytes(kind: str, specimens: tuple[bytes, ...], index: int) -> bytes:
    """The mutation of that number."""
    seed = f"{kind}-{index}"
    if kind != "serialized" or index % 2:
        return mutated(specimens, seed, kind.partition("-")[0])
    # Mutated inside its zlib stream, which any change outside it breaks.
    first = specimens[index // 2 % len(specimens)]
    inner = zlib.decompressobj()
    body = inner.decompress(first[4:])
    return first[:4] + zlib.compress(mutated((body,), seed, kind)) + inner.unused_data


def _limit_memory() -> int:
    """Bytes in use now; more than `MOST_BYTES` above them cannot be had."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + MOST_BYTES
    hard = resource.getrlimit(resource.RLIMIT_AS)[1]  # kept, for the next format's limit
    resource.setrlimit(resource.RLIMIT_AS, (most, hard))
    return _peak_bytes()


def _peak_bytes() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def _load_once(kinds: Sequence[str]) -> None:
    """Load what is loaded once, so that it counts as the base."""
    doors = [door for kind in kinds for door in DOORS[kind]]
    if any(door in _WITHOUT_RENDERER for door in doors):
        import OpenEXR  # noqa: F401
        import trimesh  # noqa: F401
    if not all(door in _WITHOUT_RENDERER for door in doors):
        from inim.render import variant

        variant.use()


def main(kinds: Sequence[str], first: int, end: int, channel: Any) -> None:
    """Read mutations `first` to `end` of each format through all its doors."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    # Scenes are planned for the machine as it is: the limit below is that of one file.
    machine = backend.memory_limit_bytes()
    backend.memory_limit_bytes = lambda: machine
    _load_once(kinds)
    for kind in kinds:
        print("format", kind, file=channel, flush=True)
        _read_format(kind, first, end, channel)
        first = 0  # only the first format may continue where a child died


def _read_format(kind: str, first: int, end: int, channel: Any) -> None:
    suffix, make = SPECIMENS[kind]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        specimens = make(folder)
        path = folder / f"mutated{suffix}"
        for door in DOORS[kind]:  # a sound one by every door, for what loads late
            path.write_bytes(specimens[0])
            print("sound", outcome(door, path), file=channel, flush=True)
        base = _limit_memory()
        for index in range(first, end):
            path.write_bytes(specimen_bytes(kind, specimens, index))
            print("begin", index, file=channel, flush=True)
            for door in DOORS[kind]:
                started = time.perf_counter()
                signal.alarm(MOST_SECONDS)
                said = " ".join(outcome(door, path).split())
                signal.alarm(0)
                seconds = time.perf_counter() - started
                grown = _peak_bytes() - base
                print("end", index, f"{seconds:.3f}", grown, said, file=channel, flush=True)


if __name__ == "__main__":
    with os.fdopen(int(sys.argv[4]), "w", encoding="utf-8", errors="replace") as answers:
        main(sys.argv[1].split(","), int(sys.argv[2]), int(sys.argv[3]), answers)
