"""What a calibration is worth: EIAs made for what was found, shown on what was hidden.

    python -m reports.calibration.shown scenes/wine_coin.xml --cases 8 -o reports/calibration

For cases of `reports.calibration.run`, whose `calibration.json` lies in the folder, a scene is
shown three times on the hidden display: its EIA made with the truth known, for the calibrated
display, and for the design. All are compared with the same reference, by SSIM on the relic.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

import inim
from inim.display import Display
from inim.display.misalignment import MISALIGNMENTS
from inim.files.image import write_atomically
from reports.calibration.cases import Case, draw_case

#: An EIA for the calibrated display has to reach this share of what knowing the truth gives.
TARGET = 0.98
_ALGORITHM, _VIEWPOINTS = "template", ("centre", "left")
_NAME = "shown"


def shown(scene: Path, case: Case, found: Mapping[str, Any]) -> dict[str, Any]:
    """Scores of a case's three EIAs, and of the second and third the share of the first."""
    known = {n: found[n]["value"] for n in MISALIGNMENTS if n in found and found[n]["known"]}
    hidden = case.display
    unknown = {n: getattr(case.design, n) for n in MISALIGNMENTS}
    scores = {
        "truth": _score(scene, hidden, hidden),
        "calibrated": _score(scene, hidden, hidden.replace(**unknown | known)),
        "design": _score(scene, hidden, hidden.replace(**unknown)),
    }
    shares = {name: scores[name] / scores["truth"] for name in ("calibrated", "design")}
    return {"case": case.number, "display": case.design.name, "ssim": scores, "share": shares}


def _score(scene: Path, hidden: Display, known: Display) -> float:
    """SSIM on the relic to the reference, of an EIA made for one display and shown on another.

    The displays have one focal length: no EIA depends on it.
    """
    off = {name: getattr(hidden, name) - getattr(known, name) for name in MISALIGNMENTS}
    with tempfile.TemporaryDirectory() as folder:
        report = inim.validate(
            scene,
            Path(folder, "out"),
            display=known,
            misalign={name: value for name, value in off.items() if value},
            algorithms=_ALGORITHM,
            viewpoints=_VIEWPOINTS,
        )
    views = report.data.algorithms[_ALGORITHM].views.values()
    return fmean(view["ssim_on_relic_to_reference"] or 0.0 for view in views)


def table(scene: Path, rows: Sequence[Mapping[str, Any]], command: str) -> str:
    """The scores in Markdown, worst first."""
    reached = sum(row["share"]["calibrated"] >= TARGET for row in rows)
    lines = [
        "# EIAs for calibrated displays, shown on the hidden ones",
        "",
        f"Made by `{command}`: `{_ALGORITHM}` on {scene.stem}, mean SSIM on the relic to the "
        f"reference. {reached} of {len(rows)} reach {TARGET:.0%} of what knowing the truth gives.",
        "",
        "| case | display | truth known | calibrated | of it | as designed | of it |",
        "| --: | --- | --: | --: | --: | --: | --: |",
    ]
    for row in sorted(rows, key=lambda row: row["share"]["calibrated"]):
        ssim, share = row["ssim"], row["share"]
        lines.append(
            f"| {row['case']} | {row['display']} | {ssim['truth']:.4f} | {ssim['calibrated']:.4f} "
            f"| {share['calibrated']:.2%} | {ssim['design']:.4f} | {share['design']:.1%} |"
        )
    return "\n".join(lines) + "\n"


def main() -> None:
    """Score the first cases that were calibrated, and write."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("scene", type=Path)
    parser.add_argument("--cases", type=int, default=8, help="how many (default: %(default)s)")
    parser.add_argument("-o", "--out", type=Path, default=Path("reports/calibration"))
    args = parser.parse_args()
    held = json.loads((args.out / "calibration.json").read_text("utf-8"))["cases"]
    rows = []
    for one in [one for one in held if not one["refused"]][: args.cases]:
        rows.append(shown(args.scene, draw_case(one["case"]), one["found"]))
        print(json.dumps(rows[-1]), flush=True)
    command = f"python -m reports.calibration.shown {args.scene} --cases {args.cases} -o {args.out}"
    data = {"inim_version": inim.__version__, "command": command, "cases": rows}
    text, words = json.dumps(data, indent=1) + "\n", table(args.scene, rows, command)
    write_atomically(args.out / f"{_NAME}.json", lambda p: p.write_text(text, "utf-8"))
    write_atomically(args.out / f"{_NAME}.md", lambda p: p.write_text(words, "utf-8"))


if __name__ == "__main__":
    main()
