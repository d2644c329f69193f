"""`python -m inim`."""

import sys

from inim.cli import main

if __name__ == "__main__":
    sys.exit(main())
