"""A worker process: `python -m inim.system.worker MODULE:FUNCTION CHANNEL [ABOUT]`.

The module is loaded while the supervisor still checks the request; the job comes later, on stdin.
"""

import sys
from importlib import import_module

from inim.system.worker.serve import read_job, serve

if __name__ == "__main__":
    module, _, function = sys.argv[1].partition(":")
    run_job = getattr(import_module(module), function)
    serve(read_job(), int(sys.argv[2]), run_job)
