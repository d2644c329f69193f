"""How accurately two displays must be known, beside what a calibration of them reaches.

    python -m reports.tolerate.run --work out/tolerate -o reports/tolerate

The goblet on the nominal display and the tripod on the phone, by `inim tolerate` with its own
draws; what the phone bears more of than is drawn by default once more, drawn farther (`phone.toml`
beside this file). The calibration is that of a case of `reports.calibration.cases` with the same
design, from simulated photographs. `--work` keeps what is drawn: a run that was stopped goes on
where it was.
"""

from __future__ import annotations

import argparse
import shlex
import shutil
from pathlib import Path
from typing import NamedTuple

from inim.documents import read_document
from inim.documents.tolerate import ToleranceDocument
from inim.files.image import write_atomically
from inim.report.tolerate import sentences
from reports.calibration.cases import draw_case
from reports.calibration.photographs import calibrated, run_inim


class Study(NamedTuple):
    """A scene on a display, and the case whose calibration stands beside it."""

    scene: str
    display: str
    viewpoints: str
    case: int
    drawn: str | None = None


#: The phone from three viewpoints: its views have two and a half times the pixels.
STUDIES = {
    "goblet": Study("scenes/wine_coin.xml", "nominal", "centre,left,right,up,down", 0),
    "phone": Study("scenes/tripod.xml", "phone", "centre,left,up", 1),
    "phone-farther": Study(
        "scenes/tripod.xml", "phone", "centre,left,up", 1, "reports/tolerate/phone.toml"
    ),
}
_KEPT = ("tolerate.html", "tolerate.json")


def _tolerated(study: Study, work: Path, out: Path) -> ToleranceDocument:
    """What `inim tolerate` says, kept."""
    drawn, calibration = work / out.name, work / "display-calibration" / "calibration.json"
    if not calibration.is_file():
        calibrated(draw_case(study.case), work)
    words = ["--display", study.display, "--viewpoints", study.viewpoints]
    words += [] if study.drawn is None else ["--study", study.drawn]
    run_inim("tolerate", study.scene, *words, "--calibration", calibration, "-o", drawn)
    out.mkdir(parents=True, exist_ok=True)
    for name in _KEPT:
        shutil.copyfile(drawn / name, out / name)
    return read_document(drawn / _KEPT[1], "draw again", ToleranceDocument)


def table(found: dict[str, ToleranceDocument], command: str) -> str:
    """The sentences of all studies in Markdown."""
    lines = ["# How accurately displays must be known", "", f"Made by `{command}`."]
    for name, data in found.items():
        study = STUDIES[name]
        lines += ["", f"## {name}: `{study.scene}` on {study.display}", ""]
        lines += [f"`{data.command}`", ""]
        lines += [f"* {sentence}" for sentence in sentences(data)]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Draw what is missing, and write."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--work", type=Path, default=Path("out/tolerate"))
    parser.add_argument("-o", "--out", type=Path, default=Path("reports/tolerate"))
    args = parser.parse_args()
    found = {
        name: _tolerated(study, args.work / study.display, args.out / name)
        for name, study in STUDIES.items()
    }
    words = ("python", "-m", "reports.tolerate.run", "--work", args.work, "-o", args.out)
    text = table(found, shlex.join(map(str, words)))
    write_atomically(args.out / "tolerate.md", lambda path: path.write_text(text, "utf-8"))


if __name__ == "__main__":
    main()
