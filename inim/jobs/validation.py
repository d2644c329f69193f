"""The worker process of a validation; see `inim.jobs.worker`."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

from inim.jobs.output import publish
from inim.jobs.plan import make_plan
from inim.jobs.request import Request
from inim.jobs.supervisor import read_job
from inim.jobs.validate import run
from inim.jobs.worker import serve

__all__ = ["work"]


def work(job: dict[str, Any], listener: Any) -> bool:
    """Carry out the request and publish its report; whether every check passed."""
    os.environ.update(job["variables"])  # this process has begun before they were known
    request = Request.from_json(job["request"])
    report = run(make_plan(request), Path(job["staging"]), listener)
    publish(Path(job["staging"]), request.out)
    return report.passed


if __name__ == "__main__":
    serve(read_job(), int(sys.argv[1]), work)
