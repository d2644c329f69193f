"""The worker process of a validation without a scene; see `inim.jobs.worker`."""

import json
import sys

from inim.jobs.picture.job import work
from inim.jobs.worker import serve

if __name__ == "__main__":
    serve(json.loads(sys.argv[1]), int(sys.argv[2]), work)
