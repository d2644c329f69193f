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
#: The project's first hits with the naive fill: what `fill=hidden` is worth by itself.
NEAREST = "template, holes from the nearest pixel"
_SPLIT = ("splat", NEAREST, "template:fill=hidden")
_KINDS = {
    "shown": "shown",
    "uncovered": "uncovered, a hole",
    "beyond_edge": "beyond the picture's edge, a hole",
}
_COMMAND = "`python -m reports.scoreboard.run FOLDER ... --rvs RVS -o reports/scoreboard`"
_WHY = """\
![One row of pixels in all views of the middle row: the truth, and methods](strip.png)

One row of pixels of *shop*, a line a view
(`python -m reports.scoreboard.strip shop --row 72 --rvs RVS -o reports/scoreboard/strip.png`).
The project's algorithms and the splat show each colour of a whole picture pixel: edges run in
stairs. RVS interpolates between pixels, `samples=4` softens. `gu2020` meets what lies on a ray at
the depths that it steps through, `wang2024` at the entries of its matrix. `li2012` puts each
picture pixel through each lens on one panel pixel: with a lens for each picture pixel, and
disparities below 1, most of the panel stays empty.""".splitlines()
_MEASURED = """\
* PSNR is that of the mean squared error of all views, in dB; SSIM a mean over views.
* *Shown* is the PSNR of those pixels alone that the middle view shows, too: what an algorithm
  does wrong, without what it cannot know. A dash: equal to the last bit.
* *Next* and *farthest*: PSNR of the views next to the middle one, and at the grid's rim; all
  distances are in the JSON.
* A method without `fill` leaves holes black.
* `gu2020` steps by the display's pixel in focus, here an eighth of a pixel of disparity.
* *Copy*: every view is the middle view. *Naive splat*: each pixel moves to its place, the nearest
  on top, and empty ones take the nearest pixel.
* *RVS*: MPEG's Reference View Synthesizer (https://gitlab.com/mpeg-i-visual/rvs, BSD), by
  `RVS CONFIG --noopengl`, of one view with a 16-bit depth map. It shares no code with inim.\
""".splitlines()
_NOT_MEASURED = """\
## What this does not measure

* No display: neither lenses, nor their blur and crosstalk, nor an eye. A panel pixel here is one
  pixel of one view, and a lens one pixel of the picture.
* No relic before black: these pictures fill their frame, and disparities are small. `fill=hidden`
  is made for that, the default of every algorithm is not.
* Where disparity was estimated, its errors count against all methods alike, and hide part of what
  is between them. Of *shop* it was found in the true views themselves.
* Shine moves with the eye: one picture does not say how, and no method here tries.
* No synthesiser that has learned from pictures is among the others.""".splitlines()


def page(data: Mapping[str, Any]) -> str:
    """`scoreboard.json` in Markdown."""
    results = data["light_fields"]
    lines = [
        "# Scoreboard: light fields with true views",
        "",
        "Each method is given the middle view of a light field and its disparity, and makes all",
        "other views; they are compared with the true ones. Made by",
        f"{_COMMAND},",
        "whose docstring says what a folder holds. All figures: `scoreboard.json`.",
        "",
        "## What it says",
        "",
        *_tally(results),
        "",
        *(line for result in results for line in _verdict(result)),
        "",
        *_WHY,
        "",
        "## What was measured",
        "",
        *_MEASURED,
        f"  Its settings: {_settings()}.",
        f"  Its build: {data['rvs_build'] or 'not said'}.",
    ]
    for result in results:
        lines += _board(result)
    lines += _where(results)
    lines += _sources(results)
    lines += [
        "",
        *_NOT_MEASURED,
    ]
    return "\n".join(lines) + "\n"


def _settings() -> str:
    return ", ".join(f"{name} {value}" for name, value in RVS_SETTINGS.items())


def _psnr(scored: Mapping[str, Any], key: str = "psnr_db") -> float:
    found = scored[key]
    return inf if found is None else float(found)


def _decibels(value: float) -> str:
    return "—" if value == inf else f"{value:.2f}"


def _label(method: str) -> str:
    return _LABELS.get(method, f"`{method}`")


def _tally(results: list[dict[str, Any]]) -> list[str]:
    """Over all light fields: how often the best of the project, and its default, are ahead."""
    lines = []
    for rival, label in _LABELS.items():
        met = [r["methods"] for r in results if rival in r["methods"]]
        best, default = (
            sum(ahead(m) > _psnr(m[rival]) for m in met)
            for ahead in (_best_of, lambda m: _psnr(m[DEFAULT]))
        )
        lines.append(
            f"* Above {label}, of {len(met)} light fields: the best of the project on {best}, "
            f"`{DEFAULT}` as it is on {default}."
        )
    return lines


def _own(methods: Mapping[str, Any]) -> dict[str, float]:
    return {name: _psnr(s) for name, s in methods.items() if name not in (*_LABELS, NEAREST)}


def _best_of(methods: Mapping[str, Any]) -> float:
    return max(_own(methods).values())


def _verdict(result: Mapping[str, Any]) -> list[str]:
    """The best of the project, how far it is from the others' and who loses to whom."""
    methods = result["methods"]
    own = _own(methods)
    best = max(own, key=own.__getitem__)
    text = f"* **{result['name']}**: best of the project is {_label(best)}, {own[best]:.2f} dB"
    rivals = [name for name in _LABELS if name in methods]
    text += "".join(
        f", {own[best] - _psnr(methods[name]):+.2f} dB to {_label(name)}" for name in rivals
    )
    lines = [text + "."]
    for name in rivals:
        losing = [n for n, psnr in own.items() if psnr < _psnr(methods[name])]
        if len(losing) == len(own):
            lines.append(f"  All of the project's are below {_label(name)}.")
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
        "## Where the error is",
        "",
        "Share of the true views' pixels, and of each method's squared error.",
        "",
        f"| kind of pixel | {' | '.join(heads)} |",
        f"| --- |{' --: |' * len(heads)}",
    ]
    for kind, words in _KINDS.items():
        share = [f"{r['pixel_share'][kind]:.2%}" for r in results]
        lines.append(f"| {words}: pixels | {' | '.join(share)} |")
        for name in _SPLIT:
            share = [f"{r['methods'][name]['error_share'][kind]:.1%}" for r in results]
            lines.append(f"| {words}: error, {_label(name)} | {' | '.join(share)} |")
    return lines


def _sources(results: list[dict[str, Any]]) -> list[str]:
    lines = ["", "## Sources and licences", "", "Pictures are not part of the project.", ""]
    lines += ["| light field | source | licence |", "| --- | --- | --- |"]
    return lines + [f"| {r['name']} | {r['source']} | {r['licence']} |" for r in results]
