"""The worker process of a validation without a scene; see `inim.jobs.worker`."""

import sys

from inim.jobs.picture.job import work
from inim.jobs.supervisor import read_job
from inim.jobs.worker import serve

if __name__ == "__main__":
    serve(read_job(), int(sys.argv[1]), work)
