"""Two views in one place: a border that slides between them, a flip, their difference.

It takes its pictures from the page's own section on the views, which is what stands without
scripts; package data beside this file, one script and one style sheet, do the rest.
"""

from __future__ import annotations

from inim.report.wipe.body import is_wiped, wipe
from inim.report.wipe.files import script, style

__all__ = ["is_wiped", "script", "style", "wipe"]
