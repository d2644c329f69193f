"""What made a result: versions and backend, as reports have them."""

from __future__ import annotations

import platform
from collections.abc import Iterable
from functools import cache
from importlib import metadata
from typing import Any

from inim.backend import Backend


def versions(packages: Iterable[str]) -> dict[str, str]:
    """Of Python and of installed packages; "unknown" where one is not."""
    return {"python": platform.python_version(), **{name: _version(name) for name in packages}}


@cache
def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "unknown"


def backend_data(backend: Backend) -> dict[str, Any]:
    """The backend under the names of report.json and bench.json."""
    return {
        "variant": backend.variant,
        "libllvm": backend.libllvm_version,
        "device": backend.device,
    }
