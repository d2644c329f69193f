"""`python -m inim.stress`."""

import sys

if __name__ == "__main__":
    if not getattr(sys.flags, "safe_path", False):
        del sys.path[0]  # the current folder: nothing in it is meant to be imported
    from inim.cli import main

    sys.exit(main(["stress", *sys.argv[1:]]))
