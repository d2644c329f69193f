"""The film's worker process; see `inim.jobs.worker`."""

from __future__ import annotations

import json
import sys

from inim.jobs.film.job import work
from inim.jobs.worker import serve

if __name__ == "__main__":
    serve(json.loads(sys.argv[1]), int(sys.argv[2]), work)
