"""Tiny studies, the command run on them, and what its tables must share whoever computed them."""

import os
import signal
import subprocess
import sys
import time
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from inim.apps.sweep.table import TABLE, read_table
from tests.conftest import sphere, square
from tests.schemas import assert_rows, read_document
from tests.system.conftest import Ended, run_child, run_here, write_scene

#: What a run takes differs from run to run; everything else may not.
TIMES = ("seconds", "yardsticks", "unit_seconds", "render_seconds", "created")
WITHIN_S = 240


def write_study(
    folder: Path,
    scenes: int = 2,
    displays: int = 1,
    algorithms: Sequence[str] = ("template", "gu2020"),
    extra: str = "",
) -> Path:
    """Scenes of a sphere and a square on displays of few lenses, with hardly any samples."""
    names = []
    for number in range(scenes):
        shapes = (sphere((0, 0, 1), 1 + number), square((number, 1, 0), 0.7, "0.9,0.1,0.1"))
        names.append(write_scene(folder, *shapes, name=f"relic{number}.xml").name)
    tables = "".join(
        f'[[display]]\nname = "d{n}"\nlens_columns = {6 + n}\nlens_rows = 6\n'
        for n in range(displays)
    )
    path = folder / "study.toml"
    path.write_text(
        f"[study]\nscenes = {names}\nalgorithms = {list(algorithms)}\n"
        f"viewpoints = 'centre'\n{extra}"
        "[settings]\ncapture_spp = 2\neia_spp = 2\nview_spp = 2\nreconstruction_spp = 2\n" + tables
    )
    return path


def command(*words: object) -> list[str]:
    """`inim sweep` as a user's shell runs it."""
    return [sys.executable, "-m", "inim", "sweep", *map(str, words)]


def sweep(*words: object, folder: Path) -> Ended:
    """Run it to its end in a folder."""
    return run_child(command(*words), WITHIN_S, cwd=folder, env=os.environ | own_folders(folder))


def sweep_here(*words: object, folder: Path) -> Ended:
    """The same in this process, the validations included, one after another."""
    words = (*map(str, words), "--workers", "1")
    return run_here("sweep", *words, folder=folder, variables=own_folders(folder))


def start(*words: object, folder: Path) -> subprocess.Popen[str]:
    """Begin with it."""
    return subprocess.Popen(
        command(*words), cwd=folder, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, encoding="utf-8", env=os.environ | own_folders(folder),
        preexec_fn=_hear_signals,
    )  # fmt: skip


def _hear_signals() -> None:
    """Undo what shells do to jobs in the background: ignored stays ignored."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def own_folders(folder: Path) -> dict[str, str]:
    """Variables of a temporary folder and a result cache that only this test uses."""
    (folder / "tmp").mkdir(exist_ok=True)
    return {"TMPDIR": str(folder / "tmp"), "INIM_CACHE": str(folder / "cache")}


def table(out: Path) -> list[dict[str, Any]]:
    """Rows of a table without times; they and the document next to them keep their schemas."""
    rows = read_table(out / TABLE)
    assert_rows(rows)
    assert read_document(out / "sweep.json")["rows"] == len(rows)
    return [{key: value for key, value in row.items() if key not in TIMES} for row in rows]


def results(folder: Path) -> dict[Path, int]:
    """Records of finished validations in the result cache, with the inode of each."""
    records = {}
    for path in (folder / "cache").glob("[!.]*.npz"):
        with zipfile.ZipFile(path) as archive:
            if "reports.npy" in archive.namelist():
                records[path] = path.stat().st_ino
    return records


def until(holds: Any, event: str) -> Any:
    """Wait until something holds."""
    end = time.monotonic() + WITHIN_S
    while time.monotonic() < end:
        value = holds()
        if value:
            return value
        time.sleep(0.02)
    raise AssertionError(f"not within {WITHIN_S} s: {event}")


def workers_of(out: Path) -> list[int]:
    """Processes that validate a unit of this sweep, whoever started them."""
    workers = []
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        try:
            words = (entry / "cmdline").read_bytes().split(b"\0")
            state = (entry / "stat").read_text().rpartition(")")[2].split()[0]
        except OSError:
            continue
        of_this = os.fsencode(os.path.abspath(out)) in words  # noqa: PTH100
        carries_out = b"inim.pipeline.job:run_data_job" in words  # see `inim.system.worker`
        if carries_out and of_this and state != "Z":
            workers.append(int(entry.name))
    return workers
