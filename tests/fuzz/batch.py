"""A child that reads mutated files: `python -m tests.fuzz.batch FORMATS FIRST END CHANNEL`.

It reads files FIRST to END of each format in turn (FORMATS: names with commas between them). It
dies of whatever kills it: that is the finding. Each file is announced on the channel before it is
read and answered for afterwards, so the parent knows which one did it.
"""

import hashlib
import io
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from importlib import import_module
from pathlib import Path
from typing import Any

import msgspec

from inim.system.errors import (
    EXIT_BASELINE,
    EXIT_CHECK_FAILED,
    EXIT_INTERNAL,
    EXIT_PASSED,
    EXIT_USAGE,
    InimError,
    OutOfMemoryError,
)
from inim.system.process import machine
from tests.fuzz.documents import mutated_document
from tests.fuzz.mutations import mutated
from tests.fuzz.specimens import DISPLAY, SPECIMENS, TINY

# What one file may cost.
MOST_SECONDS = 10  # of processor time
MOST_BYTES = 2**30
# Seconds, on a busy machine, after which a file that costs no processor time has blocked.
_HANGS_S = 60

_MESH = '<shape type="{}"><string name="filename" value="{}"/></shape>'
_TEXTURED = (
    '<shape type="rectangle"><bsdf type="diffuse"><texture type="bitmap" name="reflectance">'
    '<string name="filename" value="{1}"/></texture></bsdf></shape>'
)
_VOLUME = (
    '<shape type="rectangle"><bsdf type="diffuse"><texture type="volume" name="reflectance">'
    '<volume type="gridvolume" name="volume"><string name="filename" value="{1}"/></volume>'
    "</texture></bsdf></shape>"
)

Read = Callable[[Path], object]


def _open_scene(path: Path) -> None:
    """Read a scene like the worker, after the parent's plan."""
    from inim.pipeline.plan import make_plan
    from inim.pipeline.request import Request
    from inim.render.scene import open_scene

    plan = make_plan(Request(path, path.parent / "out"))
    open_scene(plan.file, plan.display, plan.settings.fit_share)


def _in_a_scene(shape: str, plugin: str) -> Read:
    """The file as a scene's mesh, texture or volume."""

    def read_path(path: Path) -> None:
        from tests.conftest import scene_text

        scene = path.with_name("scene.xml")
        scene.write_text(scene_text(shape.format(plugin, path.name)))
        _open_scene(scene)

    return read_path


def _new_scene(path: Path) -> None:
    from inim.render.scene_files.new_scene import new_scene

    out = path.parent / "made" / "new.xml"
    new_scene(path, out, unit="mm", up="y", force=True, warn=lambda _: None)


def _reader(module: str, *names: str, more: tuple[object, ...] = ()) -> Read:
    """Functions that read a file, from a module that is loaded when it is needed."""

    def read_path(path: Path) -> None:
        for name in names:
            getattr(import_module(f"inim.{module}"), name)(path, *more)

    return read_path


_eia = _reader("image.files.eia_file", "read_eia", more=(DISPLAY,))
_rgbd = _reader("image.files.image", "read_exr", "read_rgbd")
_depth = _reader("apps.own_picture.picture_files", "read_depth")
_color = _reader("apps.own_picture.picture_files", "read_color")
_photo = _reader("apps.own_picture.depth_photo", "read_depth_photo")
_read_study = _reader("apps.sweep.study", "read_study")


class EndedError(InimError):
    """A command that did not succeed: its exit code and what it said."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.exit_code = code


def _command(place: str, *words: str) -> Read:
    """A command that reads the file where it is put, beside the others of its run."""

    def read_path(path: Path) -> None:
        from inim.apps.export import quilt
        from inim.cli.main import main

        # Views are no matter of a document; what is looked at before them is.
        quilt.run_in_worker = lambda _, check, *__, **___: check()
        printed = io.StringIO()
        try:
            os.chdir(path.parent)
            with (
                _in_place_of(path.parent / place, path),
                redirect_stdout(printed),
                redirect_stderr(printed),
            ):
                code = main(list(words))
        finally:
            os.chdir(_ROOT)
        if code not in (EXIT_PASSED, EXIT_CHECK_FAILED):
            text = printed.getvalue()
            raise EndedError(code if text.count("\n") == 1 else EXIT_INTERNAL, text)

    return read_path


@contextmanager
def _in_place_of(target: Path, path: Path) -> Iterator[None]:
    """The file where a sound one lies; the JSON that has the digest of arrays has that of these."""
    document = target.with_suffix(".json")
    sound = {file: file.read_bytes() for file in (target, document)}
    shutil.copyfile(path, target)
    if target.suffix == ".npz":
        before, after = (
            hashlib.sha256(data).hexdigest().encode() for data in (sound[target], path.read_bytes())
        )
        document.write_bytes(sound[document].replace(before, after))
    try:
        yield
    finally:
        for file, content in sound.items():
            file.write_bytes(content)


def _baseline(place: str) -> Read:
    """A plan with the baseline, and the verdict of a run on it."""

    def read_path(path: Path) -> None:
        from inim.pipeline.baseline import compare_with_baseline
        from inim.pipeline.plan import make_plan
        from inim.pipeline.request import Request
        from inim.scores.regression.run_statistics import CANDIDATE, read_statistics

        folder = path.parent
        with _in_place_of(folder / place, path):
            tiny = {f"inim.{key}": str(value) for key, value in TINY.items()}
            out = folder / "again"
            request = Request(folder / "scene.xml", out, baseline=folder / "base", definitions=tiny)
            plan = make_plan(request)
            candidate = read_statistics(folder / "OUT/regression", CANDIDATE)
            comparison = compare_with_baseline(plan, out, candidate, {})
            msgspec.json.encode([comparison.data, *comparison.checks])

    return read_path


def _plan(path: Path) -> None:
    from inim.pipeline.plan import make_plan
    from inim.pipeline.request import Request

    make_plan(Request(path, path.parent / "out"))


_REPORT, _CANDIDATE = "OUT/report.json", "OUT/regression/candidate"
_ROOT = Path(__file__).parents[2]
_ACCEPT = ("accept", "OUT", "--reason", "because", "-o", "made")

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
    "off": (_new_scene,),
    "serialized": (_in_a_scene(_MESH, "serialized"),),
    "glb": (_new_scene,),
    "gltf": (_new_scene,),
    "stl-text": (_new_scene,),
    "stl-binary": (_new_scene,),
    "volume": (_in_a_scene(_VOLUME, ""),),
    **{f"depth-{kind}": (_depth,) for kind in ("exr", "png", "ppm", "tiff", "npy", "pfm")},
    "color": (_color,),
    "photo": (_photo,),
    "xml": (_open_scene,),
    "document-report": (
        _command(_REPORT, "export", "OUT", "--quilt", "quilt.png", "--hci", "field"),
        _command(_REPORT, "export", "OUT", "--quilt", "quilt.png", "--algorithms", "truth"),
        _command(_REPORT, *_ACCEPT),
        _command(_REPORT, "view", "OUT"),
        _command(_REPORT, "compare", "OUT", "OUT", "-o", "made"),
    ),
    "document-baseline": (
        _baseline("base/baseline.json"),
        _command(f"{_CANDIDATE}.json", *_ACCEPT),
        _command(f"{_CANDIDATE}.json", "compare", "OUT", "OTHER", "-o", "made"),
    ),
    "document-arrays": (
        _baseline("base/baseline.npz"),
        _command(f"{_CANDIDATE}.npz", *_ACCEPT),
        _command(f"{_CANDIDATE}.npz", "compare", "OTHER", "OUT", "-o", "made"),
    ),
    "document-study": (_read_study,),
    "document-scene": (_plan,),
}

_WITHOUT_RENDERER = (
    *(_new_scene, _eia, _rgbd, _depth, _color, _photo),
    *(door for kind, doors in DOORS.items() if kind.startswith("document") for door in doors),
)
#: What a refusal may name besides the file itself.
_NAMED = ("scene.xml", "Mitsuba scene (.xml)", "OUT", "OTHER", "base", "display nominal")


def outcome(read_file: Read, path: Path) -> str:
    """ "read", "refused", or "WRONG" and what is wrong with how it ended."""
    try:
        read_file(path)
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
    codes = (EXIT_USAGE, EXIT_BASELINE)
    if error.exit_code not in codes and not isinstance(error, OutOfMemoryError):
        return f"WRONG: exit code {error.exit_code}: {text}"
    named = any(name in text for name in (path.name, *_NAMED)) or path.suffix == ".xml"
    if len(text) > 1500 or not named:
        return f"WRONG: no clear line: {text[:1500]}"
    return ""


def specimen_bytes(kind: str, specimens: tuple[bytes, ...], index: int) -> bytes:
    """The mutation of that number."""
    seed = f"{kind}-{index}"
    if kind.startswith("document"):
        return mutated_document(SPECIMENS[kind][0].removeprefix("."), specimens, seed)
    return mutated(specimens, seed, kind.partition("-")[0])


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
    limit = machine.memory_limit_bytes()
    machine.memory_limit_bytes = lambda: limit
    command_line = import_module("inim.cli.main")
    command_line.check_memory()
    command_line.check_memory = lambda: None
    _load_once(kinds)
    for kind in kinds:
        print("format", kind, file=channel, flush=True)
        _read_format(kind, first, end, channel)
        first = 0  # only the first format may continue where a child died


def _read_format(kind: str, first: int, end: int, channel: Any) -> None:
    suffix, make = SPECIMENS[kind]
    # Some specimens are made by the program itself, which needs more than a file may.
    hard = resource.getrlimit(resource.RLIMIT_AS)[1]
    resource.setrlimit(resource.RLIMIT_AS, (hard, hard))
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
                started = time.process_time()
                signal.alarm(_HANGS_S)
                answer = " ".join(outcome(door, path).split())
                signal.alarm(0)
                seconds = time.process_time() - started
                grown = _peak_bytes() - base
                print("end", index, f"{seconds:.3f}", grown, answer, file=channel, flush=True)


if __name__ == "__main__":
    with os.fdopen(int(sys.argv[4]), "w", encoding="utf-8", errors="replace") as answers:
        main(sys.argv[1].split(","), int(sys.argv[2]), int(sys.argv[3]), answers)
