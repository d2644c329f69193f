"""The film's worker process; see `inim.jobs.worker`."""

from __future__ import annotations

import sys

from inim.jobs.film.job import work
from inim.jobs.supervisor import read_job
from inim.jobs.worker import serve

if __name__ == "__main__":
    serve(read_job(), int(sys.argv[1]), work)
