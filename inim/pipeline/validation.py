"""A validation in a process of its own; imports nothing heavy before that process has begun."""

from __future__ import annotations

from inim.pipeline.request import Request
from inim.worker.output import open_staging
from inim.worker.supervisor import run_in_worker

__all__ = ["validate_in_worker"]


def validate_in_worker(request: Request, *, quiet: bool = True, debug: bool = False) -> bool:
    """Validate in a worker process; the report is in `request.out` afterwards.

    Parameters
    ----------
    request : Request
    quiet : bool
        No result lines on stdout and no progress bar on stderr.
    debug : bool
        Let the worker print the traceback of an internal error.

    Returns
    -------
    bool
        Whether every check passed.

    Raises
    ------
    InimError
        What is wrong with the request or the scene; see `run_in_worker`.
    """

    def check() -> None:
        from inim.pipeline.plan import make_plan  # loaded while the worker loads

        make_plan(request)

    return run_in_worker(
        "inim.pipeline.validate:work",
        request,
        lambda: open_staging(request.out),
        check=check,
        backend=request.backend,
        about=str(request.scene),
        quiet=quiet,
        debug=debug,
    )
