"""Time against error: time and error of each algorithm of the run."""

import math
from functools import lru_cache

from inim.report import plots
from inim.report.document import ReportDocument
from inim.report.images import ReportImages
from inim.report.labels import plain
from inim.report.page import element, plot, text
from inim.report.plots import TimedPoint
from inim.report.sections import ReportSection
from inim.scores.metrics import HEADLINE, HEADLINE_WORDS
from inim.scores.metrics.psnr import metric as PSNR  # noqa: N812

_KERNEL_TIMES = "kernel times"
_WORDS = (
    "Points at the bottom left are best. The line joins the Pareto-optimal algorithms. For each "
    "grey algorithm, another is at least as fast and as good. "
)
_RATIOS = (
    "Times are medians of warm runs, alternating with the reference kernel, a loop that copies one "
    "4-byte value per panel pixel."
)
_SECONDS = (
    "Times are rough, because each is from a single run and includes preparation and "
    "compilation. For warm times relative to the reference kernel, use "
)


def time_against_error(data: ReportDocument, images: ReportImages) -> str:
    """The section; empty where no algorithm has a time and a score."""
    times, unit = times_of(data)
    views, eias = [], []
    for name, time in times.items():
        score, psnr = data.mean(name, HEADLINE), data.algorithms[name].eia[PSNR.key]
        if score is not None:
            views.append(TimedPoint(plain(name), time, 1 - score, 1 - score))
        if psnr is not None and math.isfinite(psnr):
            eias.append(TimedPoint(plain(name), time, -psnr, psnr))
    if not (views or eias):
        return ""
    floor = None if data.noise_floor is None else data.noise_floor.eia[PSNR.key]
    known_floor = floor if floor is not None and math.isfinite(floor) else None
    figure = (tuple(views), tuple(eias), unit, known_floor)
    drawing = images.drawing("time against error", lambda: _drawing(*figure), figure=figure)
    words = "; ".join(
        f"{p.name} {p.time:.2g} {unit}, 1 − {HEADLINE_WORDS} {p.error:.3f}" for p in views
    )
    alt = f"Time against error. {words}" if words else "Time against error"
    if unit == _KERNEL_TIMES:
        description = text(_WORDS + _RATIOS)
    else:
        description = text(_WORDS + _SECONDS) + element("code", "inim bench") + "."
    return element("p", description, class_="lead") + plot(drawing, alt, width=760, height=330)


def times_of(data: ReportDocument) -> tuple[dict[str, float], str]:
    """Times by algorithm, and their unit: ratios where all that took time have one."""
    seconds, ratios = (
        {
            name: value
            for name, result in data.algorithms.items()
            if (value := getattr(result, key)) is not None and value > 0
        }
        for key in ("seconds", "yardsticks")
    )
    return (ratios, _KERNEL_TIMES) if ratios.keys() >= seconds.keys() else (seconds, "seconds")


@lru_cache(maxsize=8)  # a page too large is put together again
@plots.reproducible()
def _drawing(
    views: tuple[TimedPoint, ...], eias: tuple[TimedPoint, ...], unit: str, floor: float | None
) -> bytes:
    """Both panels over one time axis, as SVG."""
    # Margins for labels of any length that there can be: to lay them out takes half of the time.
    figure = plots.blank_figure((9.2, 4.0))
    figure.subplots_adjust(left=0.09, right=0.985, bottom=0.13, top=0.92, wspace=0.24)
    axes = figure.subplots(1, 2, sharex=True)
    panels = (
        ("Views", views, f"1 − {HEADLINE_WORDS}, mean", None),
        ("Elemental images", eias, f"EIA {PSNR.label} to ground truth, {PSNR.unit}", floor),
    )
    labels = []
    for axis, (title, points, label, line) in zip(axes, panels, strict=True):
        axis.set_xscale("log")
        plots.style(axis, title, f"{unit} (↙ better)", label)
        labels.append(plots.draw_time_against_error(axis, points))
        axis.margins(0.25, 0.2)
        if line is not None and points:
            axis.axhline(line, **plots.LINES["floor"])
            plots.across(axis, "noise floor", y=line)
    axes[1].invert_yaxis()  # as in the other panel, down is better
    for axis in axes:
        plots.plain_ticks(axis)
    for axis in axes:
        axis.autoscale_view()  # now all has its place, and names can be set apart in it
    for axis, names in zip(axes, labels, strict=True):
        plots.set_apart(axis, names)
    return plots.svg(figure)


SECTIONS = (ReportSection(80, "time", "Time against error", time_against_error, is_folded=True),)
