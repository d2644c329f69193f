"""Commands about what is installed: what it can run on, what it keeps, what it knows."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from inim.commands.options import Command, no_arguments
from inim.errors import EXIT_PASSED, BackendError

if TYPE_CHECKING:
    from inim.backend import Verdict
    from inim.cache import StoreInfo

_NO_STORE = "no store is used: INIM_CACHE is off, or there is no home folder; let it name a folder"
_DISTRIBUTIONS = ("inim", "mitsuba", "drjit", "numpy", "OpenEXR", "trimesh", "flip-evaluator")


def _algorithms(_: argparse.Namespace) -> int:
    from inim.pipeline.stages.method import algorithm_table

    print(algorithm_table())
    return EXIT_PASSED


def _settings(_: argparse.Namespace) -> int:
    from inim.settings import setting_table

    print(setting_table())
    return EXIT_PASSED


def _add_cache_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Results of validations are kept and found again by what decides them. "
        "INIM_CACHE names their folder, or is 'off'; INIM_CACHE_GIB is the most they may take "
        "(8): what was not used for longest goes first."
    )
    parser.add_argument("action", choices=("info", "clear"))


def _cache(args: argparse.Namespace) -> int:
    from inim.cache import open_store

    store = open_store()
    if store is None:
        print(_NO_STORE)
    elif args.action == "clear":
        print(f"removed {_held(store.clear())}")
    else:
        info = store.info()
        print(f"{_held(info)}, at most {info.limit_bytes / 2**30:.3g} GiB")
    return EXIT_PASSED


def _held(info: StoreInfo) -> str:
    return f"{info.records} results, {info.size_bytes / 2**20:.1f} MiB, in {info.folder}"


def _add_sys_info_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="as JSON")


def _sys_info(args: argparse.Namespace) -> int:
    import json

    print(json.dumps(describe(), indent=1) if args.json else sys_info())
    return EXIT_PASSED


def describe() -> dict[str, Any]:
    """All that a report about this machine needs, ready for JSON."""
    import platform

    from inim.backend.choice import choose_backend, cuda_verdict, llvm_verdicts
    from inim.backend.trial import cache_file
    from inim.process.machine import cpu_count, cpu_model, memory_limit_bytes

    cuda = cuda_verdict()
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
        "versions": {name: _installed_version(name) for name in _DISTRIBUTIONS},
        "libllvm": [_candidate(path, verdict) for path, verdict in llvm_verdicts()],
        "cuda": {"usable": cuda.usable, "reason": cuda.reason, "device": cuda.device},
        "chosen": chosen,
        "cache": str(cache_file() or ""),
    }


def _installed_version(name: str) -> str | None:
    """The installed version of a Python distribution, or None."""
    from importlib import metadata

    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _candidate(library: Path, verdict: Verdict) -> dict[str, Any]:
    from inim.backend.choice import llvm_version

    named = ".".join(map(str, llvm_version(library) or ()))
    version = verdict.version or named or None
    reason = verdict.reason
    return {"path": str(library), "version": version, "usable": verdict.usable, "reason": reason}


def sys_info() -> str:
    """The facts of `describe` as text, one per line."""
    facts = describe()
    chosen = facts["chosen"]
    rows = [(name, facts[name]) for name in ("python", "platform", "cpu", "cores")]
    rows.append(("memory", f"{facts['memory_bytes'] / 2**30:.1f} GiB"))
    rows += [(name, version or "not installed") for name, version in facts["versions"].items()]
    for found in facts["libllvm"]:
        words = "usable" if found["usable"] else f"refused: {found['reason']}"
        rows.append(("libLLVM", f"{found['version'] or '?'}  {found['path']}  {words}"))
    rows.append(("CUDA", facts["cuda"]["device"] or f"not used: {facts['cuda']['reason']}"))
    if isinstance(chosen, dict):
        chosen = " ".join(str(chosen[name]) for name in ("variant", "device"))
    rows += [("backend", chosen), ("cache", facts["cache"] or "none (no home folder)")]
    return "\n".join(f"{name:<15} {value}" for name, value in rows)


COMMANDS = {
    "cache": Command("what the store of results holds; empty it", _add_cache_arguments, _cache),
    "sys-info": Command("what the renderer can run on here", _add_sys_info_arguments, _sys_info),
    "algorithms": Command("list the algorithms and their options", no_arguments, _algorithms),
    "settings": Command("list the inim.* settings of scene files", no_arguments, _settings),
}
