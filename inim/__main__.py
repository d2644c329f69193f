"""`python -m inim`."""

from inim.cli.program import run

if __name__ == "__main__":
    run()
