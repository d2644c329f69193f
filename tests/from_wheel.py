"""Installation by a user: the built wheel in a fresh virtual environment, outside the repository.

    python -m tests.from_wheel                    # downloads what inim needs
    python -m tests.from_wheel --borrow-packages  # takes it from the environment that runs this

Builds the wheel, installs it, and runs each program below in a process and an empty folder of its
own. A program that ends badly ends this with its output.
"""

import argparse
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import time
from pathlib import Path

from tests.conftest import scene_text, sphere, square

ROOT = Path(__file__).parents[1]

_HEAD = """
import inim
assert "site-packages" in inim.__file__, inim.__file__
display = inim.Display(pitch_mm=1, focal_length_mm=3, gap_mm=3.3, pixel_pitch_mm=0.125,
                       lens_columns=12, lens_rows=10)
"""

_VALUES = """
lab = display.replace(gap_mm=3.2)
few = {f"inim.{name}_spp": 4 for name in ("capture", "eia", "view", "reconstruction")}
report = inim.validate(
    "scene.xml", "out", display=lab, algorithms=["template", {"wang2024": {"matching": "ray"}}],
    viewpoints=["centre", inim.Viewpoint("aside", 5, 0, 150)], definitions=few)
print(report)
assert "aside" in str(report) and "-D inim.gap_mm=3.2" in report.data.command
assert repr(report).startswith("Report('out': ")
"""

_DEMO = """
import pathlib, subprocess, sys
subprocess.run([sys.executable, "-m", "inim", "demo", "-o", "demo"], check=True)
assert (pathlib.Path("demo") / "report.html").is_file()
"""

PROGRAMS = {"Python values": f"{_HEAD}\n{_VALUES}", "the demonstration": _DEMO}


def built_wheel(folder: Path) -> Path:
    """The project's wheel."""
    words = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*words, "-w", str(folder), str(ROOT)], check=True)
    return next(folder.glob("inim-*.whl"))


def fresh_environment(folder: Path, wheel: Path, *, borrow: bool) -> Path:
    """The Python of a new virtual environment with the wheel."""
    subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
    python = folder / "bin" / "python"
    if borrow:
        inside = [str(python), "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"]
        site = Path(
            subprocess.run(inside, check=True, capture_output=True, text=True).stdout.strip()
        )
        (site / "borrowed.pth").write_text(sysconfig.get_path("purelib") + "\n", "utf-8")
    words = [str(python), "-m", "pip", "install", "--quiet", str(wheel)]
    # What is borrowed may hold an editable inim: the wheel goes beside it, and first.
    extra = ["--no-deps", "--ignore-installed"] if borrow else []
    subprocess.run([*words, *extra], check=True)
    return python


def run(python: Path, folder: Path) -> None:
    """Every program, in an empty folder."""
    hidden = ("PYTHONPATH", "VIRTUAL_ENV", "PYTHONHOME")
    environment = {k: v for k, v in os.environ.items() if k not in hidden}
    for name, program in PROGRAMS.items():
        empty = Path(tempfile.mkdtemp(dir=folder))
        ball = scene_text(sphere((0, 0, 0), 10), square((0, 0, -8), 14, "0.2 0.5 0.3"))
        (empty / "scene.xml").write_text(ball, encoding="utf-8")
        started = time.perf_counter()
        ended = subprocess.run(
            [str(python), "-c", program], cwd=empty, env=environment, capture_output=True, text=True
        )
        print(f"{name}: {time.perf_counter() - started:.1f} s", ended.stdout.rstrip(), sep="\n")
        if ended.returncode:
            raise SystemExit(f"{name}: ended with {ended.returncode}\n{ended.stderr}")


def main() -> None:
    """Build, install, run."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--borrow-packages", action="store_true", help="download nothing")
    args = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="inim-wheel-"))
    try:
        wheel = built_wheel(folder)
        run(fresh_environment(folder / "venv", wheel, borrow=args.borrow_packages), folder)
    finally:
        shutil.rmtree(folder)


if __name__ == "__main__":
    main()
