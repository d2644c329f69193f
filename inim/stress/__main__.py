"""`python -m inim.stress`."""

from inim.program import run

if __name__ == "__main__":
    run("stress")
