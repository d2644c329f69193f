"""The worker process of a validation; see `inim.worker.serve`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from inim.pipeline.plan import make_plan
from inim.pipeline.request import Request
from inim.pipeline.validate import run
from inim.worker.output import publish

__all__ = ["work"]


def work(job: dict[str, Any], listener: Any) -> bool:
    """Carry out the request and publish its report; whether every check passed."""
    os.environ.update(job["variables"])  # this process has begun before they were known
    request = Request.from_json(job["request"])
    report = run(make_plan(request), Path(job["staging"]), listener)
    publish(Path(job["staging"]), request.out)
    return report.passed
