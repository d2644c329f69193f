"""`python -m inim.bench`."""

import sys

from inim.cli import main

if __name__ == "__main__":
    sys.exit(main(["bench", *sys.argv[1:]]))
