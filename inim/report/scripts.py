"""Scripts in a page that forbids all others."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterable

__all__ = ["script_element", "script_policy"]

_NONE = "'none'"


def script_policy(scripts: Iterable[str]) -> str:
    """Directive of a content security policy that lets these very scripts run, and no other."""
    digests = (hashlib.sha256(script.encode()).digest() for script in scripts)
    allowed = [f"'sha256-{base64.b64encode(one).decode('ascii')}'" for one in digests]
    return f"script-src {' '.join(allowed) or _NONE}"


def script_element(script: str) -> str:
    """A script as an element, to be put at the end of the page."""
    return f"<script>{script}</script>"
