"""`python -m inim`."""

from inim.program import run

if __name__ == "__main__":
    run()
