"""Page of the scoreboard, the worst method of each light field first."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf
from typing import Any

from inim.generators.registry import DEFAULT
from inim.report.study import PagePart, Table
from reports.scoreboard.rivals import RVS_SETTINGS
from reports.study import Results, table

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
_REMARKS = (
    "Each method generates all other views of a light field from the middle view and its "
    "disparity. PSNR belongs to the mean squared error of all views. SSIM is the mean of the "
    "views. *Shown* is the PSNR of the pixels whose surface the middle view shows, too; ∞ means "
    "equal to the last bit.",
    "*Next* and *farthest* are the PSNR of the views next to the middle one and at the rim of the "
    "grid. The JSON has all distances.",
    "`template` and `layered` fill the holes of these pictures by default. Without `fill`, the "
    "holes of other algorithms, and of `colour=nearest`, stay black. `gu2020` steps by the "
    "display's pixel in focus, here an eighth of a pixel of disparity.",
    "*Copy* shows the middle view in every place. *Naive splat* moves each pixel to its new "
    "position, the nearest on top, and fills empty pixels from the nearest pixel.",
    "*RVS* is MPEG's Reference View Synthesizer (https://gitlab.com/mpeg-i-visual/rvs, BSD), run "
    "as `RVS CONFIG --noopengl` on one view with a 16-bit depth map. It shares no code with inim. "
    f"Settings: {', '.join(f'{name} {value}' for name, value in RVS_SETTINGS.items())}.",
    "There is no display: no lenses with blur and crosstalk, and no eye. All pictures fill their "
    "frame, and disparities are small. Highlights move with the eye, and no method here tries. No "
    "learned view synthesis is included. The disparity of *shop* is estimated from the true views; "
    "such errors affect all methods and hide part of their differences.",
)


def page(results: Results) -> tuple[list[str], list[PagePart]]:
    """Verdicts, one board per light field, kinds of errors, and sources."""
    lines = [*_tally(results), *(_verdict(name, result) for name, result in results.items())]
    columns = {
        "light field": lambda item: item[0],
        "source": lambda item: item[1]["source"],
        "licence": lambda item: item[1]["licence"],
    }
    sources = table("Sources; the pictures are not part of the project", results.items(), columns)
    return list(_REMARKS), [
        PagePart(
            "results",
            "Results",
            "",
            [_kinds(results)],
            claims=("Best algorithm of the project", lines),
        ),
        *(PagePart(name, name, "", [_board(result)]) for name, result in results.items()),
        PagePart("sources", "Sources and licences", "", [sources]),
    ]


def _psnr(scored: Mapping[str, Any], key: str = "psnr_db") -> float:
    psnr = scored[key]
    return inf if psnr is None else float(psnr)


def _decibels(value: float) -> str:
    return "∞" if value == inf else f"{value:.2f}"


def _label(method: str) -> str:
    return _LABELS.get(method, f"`{method}`")


def _own(methods: Mapping[str, Any]) -> dict[str, float]:
    return {name: _psnr(s) for name, s in methods.items() if name not in (*_LABELS, NEAREST)}


def _tally(results: Results) -> list[str]:
    """Number of light fields on which the best algorithm of the project and its default lead."""
    lines = []
    for rival, label in _LABELS.items():
        compared = [r["methods"] for r in results.values() if rival in r["methods"]]
        best = sum(max(_own(m).values()) > _psnr(m[rival]) for m in compared)
        default = sum(_psnr(m[DEFAULT]) > _psnr(m[rival]) for m in compared)
        lines.append(
            f"Better than {label}, of {len(compared)} light fields: the best algorithm of the "
            f"project on {best}, `{DEFAULT}` with default options on {default}."
        )
    return lines


def _verdict(light_field: str, result: Mapping[str, Any]) -> str:
    """Lead of the best algorithm of the project, and algorithms below each of the others."""
    methods = result["methods"]
    own = _own(methods)
    best = max(own, key=own.__getitem__)
    rivals = [name for name in _LABELS if name in methods]
    leads = "".join(
        f", {own[best] - _psnr(methods[name]):+.2f} dB compared with {_label(name)}"
        for name in rivals
    )
    text = f"{light_field}: best is {_label(best)} with {own[best]:.2f} dB{leads}."
    for name in rivals:
        below = [_label(n) for n, psnr in own.items() if psnr < _psnr(methods[name])]
        text += f" Below {_label(name)}: {', '.join(below) or 'none'}."
    return text


def _board(result: Mapping[str, Any]) -> Table:
    """Scores of all methods, the worst first."""
    methods, (low, high) = result["methods"], result["disparity_range_px"]
    splat, copied = _psnr(methods["splat"]), _psnr(methods["copy"])

    def ring(scored: Mapping[str, Any], index: int) -> str:
        return _decibels(_psnr(list(scored["by_distance"].values())[index]))

    columns = {
        "method": lambda item: _label(item[0]),
        "PSNR": lambda item: _decibels(_psnr(item[1])),
        "to the splat": lambda item: f"{_psnr(item[1]) - splat:+.2f}",
        "to the copy": lambda item: f"{_psnr(item[1]) - copied:+.2f}",
        "SSIM": lambda item: f"{item[1]['ssim']:.4f}",
        "worst view": lambda item: _decibels(_psnr(item[1]["worst_view"])),
        "shown": lambda item: _decibels(_psnr(item[1], "shown_psnr_db")),
        "next": lambda item: ring(item[1], 0),
        "farthest": lambda item: ring(item[1], -1),
    }
    caption = (
        f"{result['views']} views of {result['side']} × {result['side']} - 1, "
        f"{result['view_px'][0]} × {result['view_px'][1]} pixels; disparity {low:.2f} to "
        f"{high:.2f} pixels from view to view ({result['disparity']})"
    )
    return table(caption, sorted(methods.items(), key=lambda item: _psnr(item[1])), columns)


def _kinds(results: Results) -> Table:
    """Shares of the pixels, and of the squared error of some methods."""
    rows = []
    for kind, words in _KINDS.items():
        shares = [f"{r['pixel_share'][kind]:.2%}" for r in results.values()]
        rows.append([f"{words}: pixels", *shares])
        for name in _SPLIT:
            scores = [r["methods"].get(name) for r in results.values()]
            shares = ["" if s is None else f"{s['error_share'][kind]:.1%}" for s in scores]
            rows.append([f"{words}: error, {_label(name)}", *shares])
    caption = "Shares of the pixels of all true views, and of the squared error of each method"
    return Table(caption, ["kind of pixel", *results], rows)
