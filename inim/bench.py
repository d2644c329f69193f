"""`python -m inim.bench scene.xml`; see `inim.jobs.bench`."""

import sys

from inim.cli import main

if __name__ == "__main__":
    sys.exit(main(["bench", *sys.argv[1:]]))
