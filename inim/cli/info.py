"""Command `inim info`, about the installation."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from inim.pipeline.options import Command
from inim.system.errors import EXIT_PASSED, BackendError

if TYPE_CHECKING:
    from inim.system.cache import StoreInfo


_NO_STORE = "no cache: INIM_CACHE is off, or there is no home folder; set INIM_CACHE to a folder"
_DISTRIBUTIONS = ("inim", "mitsuba", "drjit", "numpy", "OpenEXR", "trimesh")


def _algorithms(_: argparse.Namespace) -> int:
    from inim.pipeline.stages.method import algorithm_table

    print(algorithm_table())
    return EXIT_PASSED


def _displays(_: argparse.Namespace) -> int:
    from inim.display import DISPLAYS
    from inim.display.viewpoint import default_distance_mm
    from inim.report.labels import aligned

    rows = [("preset", "size, mm", "pitch, mm", "depth, mm", "viewing zone, mm")]
    for name, display in DISPLAYS.items():
        (far, near), distance = display.depth_range_mm, default_distance_mm(display)
        size = f"{display.width_mm:.1f} x {display.height_mm:.1f}"
        zone = f"+-{display.flip_limit_mm(distance)[0]:.1f} at {distance:.0f}"
        depth = f"{far:.1f} to {near:.1f}"
        rows.append((name, size, f"{display.pitch_mm:.3f}", depth, zone))
    print("\n".join(aligned([*zip(*rows, strict=True)])))
    return EXIT_PASSED


def _settings(_: argparse.Namespace) -> int:
    from inim.display.settings import setting_table

    print(setting_table())
    return EXIT_PASSED


def _cache(args: argparse.Namespace) -> int:
    from inim.system.cache import open_store

    store = open_store()
    if store is None:
        print(_NO_STORE)
    elif args.clear:
        print(f"removed {_size_text(store.clear())}")
    else:
        info = store.info()
        print(f"{_size_text(info)}, at most {info.limit_bytes / 2**30:.3g} GiB")
    return EXIT_PASSED


def _size_text(info: StoreInfo) -> str:
    return f"{info.records} results, {info.size_bytes / 2**20:.1f} MiB, in {info.folder}"


def _system(_: argparse.Namespace) -> int:
    print(sys_info())
    return EXIT_PASSED


def describe() -> dict[str, Any]:
    """Describe the machine and the installation, as JSON values."""
    import platform

    from inim.system.backend import choose_backend, find_card, find_libllvm
    from inim.system.cache import store_folder, versions
    from inim.system.process.machine import cpu_count, cpu_model, memory_limit_bytes

    card, reason = find_card()
    chosen: dict[str, Any] | str
    try:
        chosen = {name: value and str(value) for name, value in choose_backend()._asdict().items()}
    except BackendError as error:
        chosen = str(error)
    return {
        "python": platform.python_version(),
        "platform": platform.platform(),
        "cpu": cpu_model(),
        "cores": cpu_count(),
        "memory_bytes": memory_limit_bytes(),
        "versions": {
            name: None if version == "unknown" else version
            for name, version in versions(_DISTRIBUTIONS).items()
            if name != "python"
        },
        "libllvm": [_candidate(path) for path in find_libllvm()],
        "cuda": {"usable": bool(card), "reason": reason, "device": card},
        "chosen": chosen,
        "cache": str(store_folder() or ""),
    }


def _candidate(library: Path) -> dict[str, Any]:
    from inim.system.backend import llvm_version, rejection_reason

    version = llvm_version(library)
    reason = rejection_reason(version)
    return {
        "path": str(library), "version": version or None, "usable": not reason, "reason": reason
    }  # fmt: skip


def sys_info() -> str:
    """The facts of `describe` as text, one per line."""
    facts = describe()
    chosen = facts["chosen"]
    rows = [(name, facts[name]) for name in ("python", "platform", "cpu", "cores")]
    rows.append(("memory", f"{facts['memory_bytes'] / 2**30:.1f} GiB"))
    rows += [(name, version or "not installed") for name, version in facts["versions"].items()]
    for library in facts["libllvm"]:
        words = "usable" if library["usable"] else f"refused: {library['reason']}"
        rows.append(("libLLVM", f"{library['version'] or '?'}  {library['path']}  {words}"))
    rows.append(("CUDA", facts["cuda"]["device"] or f"not used: {facts['cuda']['reason']}"))
    if isinstance(chosen, dict):
        chosen = " ".join(str(chosen[name]) for name in ("variant", "device"))
    rows += [("backend", chosen), ("cache", facts["cache"] or "none")]
    return "\n".join(f"{name:<15} {value}" for name, value in rows)


def _add_info_arguments(parser: argparse.ArgumentParser) -> None:
    subjects = parser.add_subparsers(required=True, metavar="SUBJECT")
    for name, (summary, run) in _SUBJECTS.items():
        own = subjects.add_parser(name, help=summary, description=summary.capitalize() + ".")
        own.set_defaults(show=run)
        if name == "cache":
            own.epilog = (
                "INIM_CACHE is the folder, or 'off'; INIM_CACHE_GIB is its maximum size (8)."
            )
            own.add_argument("--clear", action="store_true", help="remove all cached results")


_SUBJECTS = {
    "algorithms": ("list the algorithms and their options", _algorithms),
    "displays": ("list the presets of displays: size, pitch, depth and viewing zone", _displays),
    "settings": ("list the inim.* settings of scene files", _settings),
    "cache": ("show the folder and the size of the result cache", _cache),
    "system": ("show the renderer's backends and the installed versions", _system),
}


COMMANDS = {
    "info": Command(
        "show algorithms, displays, settings, cache or system",
        _add_info_arguments,
        lambda args: int(args.show(args)),
        "inim info algorithms",
    ),
}
