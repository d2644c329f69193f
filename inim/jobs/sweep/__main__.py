"""The worker process of a unit; see `inim.jobs.worker`."""

import os
import sys

from inim.jobs.supervisor import read_job

if __name__ == "__main__":
    job = read_job()
    if job["task"]["threads"] is not None:  # numba reads it when it is imported
        os.environ["NUMBA_NUM_THREADS"] = str(job["task"]["threads"])
    from inim.jobs.sweep.task import work
    from inim.jobs.worker import serve

    serve(job, int(sys.argv[1]), work)
