"""The scoreboard as Markdown, the worst method of each light field first."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from math import inf
from typing import Any

from inim.generators.registry import DEFAULT
from reports.scoreboard.rivals import RVS_SETTINGS

_LABELS = {
    "copy": "copy of the middle view",
    "splat": "naive splat, nearest fill",
    "rvs": "RVS (MPEG)",
}
#: First hits of the project with the naive fill: the difference is the gain of `fill=hidden`.
NEAREST = "template, holes from the nearest pixel"
_SPLIT = ("splat", "rvs", NEAREST, DEFAULT)
_KINDS = {
    "shown": "shown",
    "uncovered": "uncovered, a hole",
    "beyond_edge": "beyond the picture's edge, a hole",
}
_COMMAND = "`python -m reports.scoreboard.run FOLDER ... --rvs RVS -o reports/scoreboard`"
_STRIP = """\
![One row of pixels in all views of the middle row: true views and methods](strip.png)

One row of pixels of *shop*, one line for each view
(`python -m reports.scoreboard.strip shop --row 72 --rvs RVS -o reports/scoreboard/strip.png`).
With `colour=nearest`, as in the splat, each picture pixel keeps its colour, and edges become
stairs. RVS and `colour=smooth` interpolate between pixels. `gu2020` tests a ray at fixed steps of
depth, `wang2024` at the entries of its matrix. `li2012` projects each picture pixel through each
lens to one panel pixel. With one lens for each picture pixel and disparities below 1, most of its
panel stays empty.""".splitlines()
_MEASURED = """\
* PSNR belongs to the mean squared error of all views, in dB. SSIM is the mean of the views.
* *Shown* is the PSNR of the pixels whose surface the middle view shows, too. A dash means equal to
  the last bit.
* *Next* and *farthest* are the PSNR of the views next to the middle one and at the rim of the grid.
  The JSON has all distances.
* `template` and `layered` fill the holes of these pictures by default. Without `fill`, the holes of
  other algorithms, and of `colour=nearest`, stay black.
* `gu2020` steps by the display's pixel in focus, here an eighth of a pixel of disparity.
* *Copy* shows the middle view in every place. *Naive splat* moves each pixel to its new position,
  the nearest on top, and fills empty pixels from the nearest pixel.
* *RVS* is MPEG's Reference View Synthesizer (https://gitlab.com/mpeg-i-visual/rvs, BSD), run as
  `RVS CONFIG --noopengl` on one view with a 16-bit depth map. It shares no code with inim.\
""".splitlines()
_LIMITS = """\
## Limits

* There is no display: no lenses with blur and crosstalk, and no eye. A panel pixel is one pixel of
  one view, and a lens is one pixel of the picture.
* All pictures fill their frame, and disparities are small. Relics in front of a background are in
  `reports/one_picture`.
* Errors of an estimated disparity affect all methods and hide part of their differences. The
  disparity of *shop* is estimated from the true views.
* Highlights move with the eye. One picture does not determine how, and no method here tries.
* No learned view synthesis is included.""".splitlines()


def page(data: Mapping[str, Any]) -> str:
    """`scoreboard.json` in Markdown."""
    results = data["light_fields"]
    lines = [
        "# Scoreboard: light fields with true views",
        "",
        "Each method generates all other views of a light field from the middle view and its",
        "disparity. They are compared with the true views. Command:",
        f"{_COMMAND};",
        "its docstring describes the folders. `scoreboard.json` has all scores.",
        "",
        "## Results",
        "",
        *_tally(results),
        "",
        *(line for result in results for line in _verdict(result)),
        "",
        *_STRIP,
        "",
        "## Method",
        "",
        *_MEASURED,
        f"  Settings: {_settings()}.",
        f"  Build: {data['rvs_build'] or 'unknown'}.",
    ]
    for result in results:
        lines += _board(result)
    lines += _where(results)
    lines += _sources(results)
    lines += [
        "",
        *_LIMITS,
    ]
    return "\n".join(lines) + "\n"


def _settings() -> str:
    return ", ".join(f"{name} {value}" for name, value in RVS_SETTINGS.items())


def _psnr(scored: Mapping[str, Any], key: str = "psnr_db") -> float:
    psnr = scored[key]
    return inf if psnr is None else float(psnr)


def _decibels(value: float) -> str:
    return "—" if value == inf else f"{value:.2f}"


def _label(method: str) -> str:
    return _LABELS.get(method, f"`{method}`")


def _tally(results: list[dict[str, Any]]) -> list[str]:
    """Number of light fields on which the best algorithm of the project and its default lead."""
    lines = []
    for rival, label in _LABELS.items():
        compared = [r["methods"] for r in results if rival in r["methods"]]
        best, default = (
            sum(ahead(m) > _psnr(m[rival]) for m in compared)
            for ahead in (_best_of, lambda m: _psnr(m[DEFAULT]))
        )
        lines.append(
            f"* Better than {label}, of {len(compared)} light fields: the best algorithm of the "
            f"project on {best}, `{DEFAULT}` with default options on {default}."
        )
    return lines


def _own(methods: Mapping[str, Any]) -> dict[str, float]:
    return {name: _psnr(s) for name, s in methods.items() if name not in (*_LABELS, NEAREST)}


def _best_of(methods: Mapping[str, Any]) -> float:
    return max(_own(methods).values())


def _verdict(result: Mapping[str, Any]) -> list[str]:
    """Lead of the best algorithm of the project, and algorithms below each of the others."""
    methods = result["methods"]
    own = _own(methods)
    best = max(own, key=own.__getitem__)
    text = f"* **{result['name']}**: best is {_label(best)} with {own[best]:.2f} dB"
    rivals = [name for name in _LABELS if name in methods]
    text += "".join(
        f", {own[best] - _psnr(methods[name]):+.2f} dB compared with {_label(name)}"
        for name in rivals
    )
    lines = [text + "."]
    for name in rivals:
        losing = [n for n, psnr in own.items() if psnr < _psnr(methods[name])]
        if len(losing) == len(own):
            lines.append(f"  All algorithms of the project are below {_label(name)}.")
        elif losing:
            lines.append(f"  Below {_label(name)}: {_listed(losing)}.")
        else:
            lines.append(f"  None is below {_label(name)}.")
    return lines


def _listed(names: Iterable[str]) -> str:
    return ", ".join(map(_label, names))


def _board(result: Mapping[str, Any]) -> list[str]:
    columns, rows = result["view_px"]
    low, high = result["disparity_range_px"]
    side = result["side"]
    heads = ["method", "PSNR", "to the splat", "to the copy", "SSIM"]
    heads += ["worst view", "shown", "next", "farthest"]
    lines = [
        "",
        f"## {result['name']}",
        "",
        f"{result['views']} views of {side} x {side} - 1, {columns} x {rows} pixels; disparity "
        f"{low:.2f} to {high:.2f} pixels from view to view (`{result['disparity']}`).",
        "",
        f"| {' | '.join(heads)} |",
        f"| --- |{' --: |' * (len(heads) - 1)}",
    ]
    methods = result["methods"]
    splat, copied = _psnr(methods["splat"]), _psnr(methods["copy"])
    for name, scored in sorted(methods.items(), key=lambda item: _psnr(item[1])):
        psnr = _psnr(scored)
        rings = list(scored["by_distance"].values())
        cells = [
            _label(name),
            _decibels(psnr),
            f"{psnr - splat:+.2f}",
            f"{psnr - copied:+.2f}",
            f"{scored['ssim']:.4f}",
            _decibels(_psnr(scored["worst_view"])),
            _decibels(_psnr(scored, "shown_psnr_db")),
            _decibels(_psnr(rings[0])),
            _decibels(_psnr(rings[-1])),
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def _where(results: list[dict[str, Any]]) -> list[str]:
    """Shares of the pixels, and of the squared error of some methods."""
    heads = [r["name"] for r in results]
    lines = [
        "",
        "## Errors by kind of pixel",
        "",
        "Shares of the pixels of all true views, and of the squared error of each method.",
        "",
        f"| kind of pixel | {' | '.join(heads)} |",
        f"| --- |{' --: |' * len(heads)}",
    ]
    for kind, words in _KINDS.items():
        share = [f"{r['pixel_share'][kind]:.2%}" for r in results]
        lines.append(f"| {words}: pixels | {' | '.join(share)} |")
        for name in _SPLIT:
            scores = [r["methods"].get(name) for r in results]
            share = ["" if s is None else f"{s['error_share'][kind]:.1%}" for s in scores]
            lines.append(f"| {words}: error, {_label(name)} | {' | '.join(share)} |")
    return lines


def _sources(results: list[dict[str, Any]]) -> list[str]:
    lines = ["", "## Sources and licences", "", "The pictures are not part of the project.", ""]
    lines += ["| light field | source | licence |", "| --- | --- | --- |"]
    return lines + [f"| {r['name']} | {r['source']} | {r['licence']} |" for r in results]
