"""A worker process: `python -m inim.worker MODULE:FUNCTION CHANNEL [ABOUT]`.

The module is loaded while the supervisor still checks the plan; the job comes later, on stdin.
"""

import sys
from importlib import import_module

from inim.worker.serve import read_job, serve

if __name__ == "__main__":
    module, _, function = sys.argv[1].partition(":")
    carry_out = getattr(import_module(module), function)
    serve(read_job(), int(sys.argv[2]), carry_out)
