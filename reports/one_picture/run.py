"""Compare the algorithms of one RGB-D picture, several cameras, and layers, on many relics.

    python -m reports.one_picture.run scenes/*.xml MORE.xml ... -o reports/one_picture

`inim.validate` validates each scene from three viewpoints with the scene's settings; `inim
new-scene` makes a scene from a scanned relic. The tables begin with the relic on which `template`
leads least.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

import inim
from inim.report.study import PagePart, Table
from reports.study import Results, Study, add_scenes

#: The default, and the same sources with nearest colours of four rays and of one.
_DEFAULT = "template"
_FOUR = "template:samples=4:colour=nearest"
_ONE = "template:samples=1:colour=nearest"
_SOLID = "template:columns=solid:samples=1:colour=nearest"
_SOLID_FOUR = "template:columns=solid:samples=4:colour=nearest"
#: The literature, with one ray per panel pixel and nearest colours.
_LITERATURE = ("wang2024", "wang2024:matching=ray", "gu2020", "li2012")
_FIVE_CAMERAS = "cameras:views=5"
_CAMERAS = ("cameras:views=1", "cameras:views=2", _FIVE_CAMERAS, "cameras:views=9")
_LAYERED = "layered"
ALGORITHMS = (_DEFAULT, _FOUR, _SOLID_FOUR, _ONE, _SOLID, *_LITERATURE, *_CAMERAS, _LAYERED)
_VIEWPOINTS = "centre,right,up"
_PSNR, _SSIM = "eia_psnr_db", "relic_ssim"
_TITLES = {_PSNR: "EIA PSNR, dB", _SSIM: "SSIM on the relic, to the reference"}
#: Targets: largest distance of five cameras from `layered`, and of `layered` from the noise floor.
_CAMERAS_DB, _FLOOR_DB = 0.5, 2.0


def collect_scores(scene: Path, algorithms: Sequence[str]) -> dict[str, Any]:
    """Scores of one relic by algorithm: PSNR of the EIA, and the mean SSIM of its views."""
    out = Path("out", "one_picture", scene.stem)
    data = inim.validate(scene, out, algorithms=algorithms, viewpoints=_VIEWPOINTS).data
    assert data.noise_floor is not None
    floor = data.noise_floor.eia
    return {
        "noise_floor_db": floor["psnr_db"],
        _PSNR: {name: data.algorithms[name].eia["psnr_db"] for name in algorithms},
        _SSIM: {
            name: fmean(
                view["ssim_on_relic_to_reference"] or 0.0
                for view in data.algorithms[name].views.values()
            )
            for name in algorithms
        },
    }


def lead(row: Mapping[str, Any], score: str, algorithm: str) -> float:
    """Score of an algorithm minus that of the best algorithm of the literature."""
    scores: Mapping[str, float] = row[score]
    return scores[algorithm] - max(scores[name] for name in _LITERATURE)


def sentences(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Numbers of relics on which each statement holds, and extreme differences."""

    def differences(first: str, second: str) -> list[float]:
        return [row[_PSNR][first] - row[_PSNR][second] for row in rows]

    above = [
        f"`{name}` is above all of {', '.join(_LITERATURE)} in {title}: "
        f"{sum(lead(row, score, name) > 0 for row in rows)} of {len(rows)} relics."
        for name in (_DEFAULT, _FOUR, _ONE)
        for score, title in _TITLES.items()
    ]
    over_solid, to_layered = differences(_ONE, _SOLID), differences(_DEFAULT, _LAYERED)
    cameras, to_default = differences(_FIVE_CAMERAS, _LAYERED), differences(_FIVE_CAMERAS, _DEFAULT)
    to_floor = [row[_PSNR][_LAYERED] - row["noise_floor_db"] for row in rows]
    return [
        *above,
        f"EIA PSNR of columns that end, above solid columns, one ray per pixel: "
        f"{min(over_solid):.1f} dB at least, {fmean(over_solid):.1f} dB on average.",
        f"`template`, from one picture, to `layered`: {min(to_layered):.1f} dB at worst, "
        f"{fmean(to_layered):.1f} dB on average.",
        f"Five cameras to `layered`: {min(cameras):+.2f} to {max(cameras):+.2f} dB; within "
        f"{_CAMERAS_DB} dB or above on {sum(d > -_CAMERAS_DB for d in cameras)} relics; above "
        f"`template` on {sum(d > 0 for d in to_default)}.",
        f"`layered` to the noise floor: {min(to_floor):+.1f} to {max(to_floor):+.1f} dB; within "
        f"{_FLOOR_DB:g} dB or above on {sum(d > -_FLOOR_DB for d in to_floor)} relics.",
    ]


def page(results: Results) -> tuple[list[str], list[PagePart]]:
    """Summary, and one table per score."""
    parts = [PagePart(key, title, "", [_table(results, key)]) for key, title in _TITLES.items()]
    return sentences(list(results.values())), parts


def _table(results: Results, score: str) -> Table:
    """Table of one score, with a row of means; EIA PSNR has the noise floor, too."""
    digits = 1 if score == _PSNR else 3
    order = sorted(results, key=lambda relic: lead(results[relic], score, _DEFAULT))
    columns = {name: [results[relic][score][name] for relic in order] for name in ALGORITHMS}
    if score == _PSNR:
        columns["noise floor"] = [results[relic]["noise_floor_db"] for relic in order]
    rows = [["mean", *(f"{fmean(values):.{digits}f}" for values in columns.values())]]
    rows += [
        [relic, *(f"{values[index]:.{digits}f}" for values in columns.values())]
        for index, relic in enumerate(order)
    ]
    return Table(_TITLES[score], ["relic", *columns], rows)


STUDY = Study(
    "reports.one_picture.run", "One picture and several cameras, relic by relic", __doc__,
    add_scenes,
    lambda args: {s.stem: {"scene": s, "algorithms": ALGORITHMS} for s in args.scenes},
    collect_scores, page,
)  # fmt: skip

if __name__ == "__main__":
    sys.exit(STUDY.main())
