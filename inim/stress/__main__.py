"""`python -m inim.stress`."""

import sys

from inim.cli import main

if __name__ == "__main__":
    sys.exit(main(["stress", *sys.argv[1:]]))
