"""`inim cache`: what the store of results holds, and emptying it."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from inim.errors import EXIT_PASSED

if TYPE_CHECKING:
    from inim.cache.store import StoreInfo

__all__ = ["SUMMARY", "add_arguments", "run"]

SUMMARY = "what the store of results holds; empty it"

_NONE = "no store is used: INIM_CACHE is off, or there is no home folder; let it name a folder"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.description = (
        "Results of validations are kept and found again by what decides them. "
        "INIM_CACHE names their folder, or is 'off'; INIM_CACHE_GIB is the most they may take "
        "(8): what was not used for longest goes first."
    )
    parser.add_argument("action", choices=("info", "clear"))


def run(args: argparse.Namespace) -> int:
    """Carry out the command."""
    from inim.cache.store import open_store

    store = open_store()
    if store is None:
        print(_NONE)
    elif args.action == "clear":
        print(f"removed {_held(store.clear())}")
    else:
        info = store.info()
        print(f"{_held(info)}, at most {info.limit_bytes / 2**30:.3g} GiB")
    return EXIT_PASSED


def _held(info: StoreInfo) -> str:
    return f"{info.records} results, {info.size_bytes / 2**20:.1f} MiB, in {info.folder}"
