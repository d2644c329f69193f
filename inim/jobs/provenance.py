"""What made a result: versions and backend, as reports tell them."""

from __future__ import annotations

import platform
from collections.abc import Iterable
from importlib import metadata
from typing import Any

from inim.backend import Backend

__all__ = ["backend_data", "versions"]


def versions(packages: Iterable[str]) -> dict[str, str]:
    """Of Python and of installed packages; "unknown" where one is not."""
    found = {"python": platform.python_version()}
    for name in packages:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "unknown"
    return found


def backend_data(backend: Backend) -> dict[str, Any]:
    """The backend under the names of report.json and bench.json."""
    return {
        "variant": backend.variant,
        "libllvm": backend.libllvm_version,
        "device": backend.device,
    }
