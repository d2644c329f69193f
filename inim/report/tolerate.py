"""The report of drawn misalignments: `tolerate.json` and `tolerate.html`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from inim.documents.display import ParameterTolerance, Together, ToleranceDocument
from inim.documents.document import write_forms
from inim.metrics import HEADLINE_WORDS
from inim.report.labels import MISSING, NBSP, number, per_cent
from inim.report.page import (
    Section,
    bullets,
    document_page,
    element,
    how_to_reproduce,
    lead,
    plot,
    text,
    text_table,
)
from inim.report.plots import LINES, SOFT, across, new_figure, style, svg

PAGE = "tolerate.html"
#: Of a normal error, 95 % lie within so many standard errors.
_WITHIN = 1.96
_PANEL_HEIGHT = 2.9  # inches
_DRAWN, _CURVE, _BEARS, _REACHED = "#17596b", "#1e2022", "#a4262c", "#1c6b3c"
_ALONE = (
    "One parameter has an error; all others are exact. Each point is a display. The dashed line is "
    "the score of the aligned display minus the criterion. The black line is the fitted curve. The "
    "dotted red lines are the tolerances."
)
_CALIBRATED = " After a calibration, 95 % of displays are within the green range."
_TOGETHER = (
    "All parameters have errors, each drawn from its own spread. The solid line is the share of "
    "displays with at most this loss. The dashed line is that share if the single losses added up."
)


def write_tolerance(data: ToleranceDocument, folder: Path) -> None:
    """Write data and page, the data last."""
    write_forms(data, folder, "tolerate.json", {PAGE: _page})


def sentences(data: ToleranceDocument) -> list[str]:
    """Sentences on the errors that this display tolerates, one for each parameter and on all."""
    lines = [_sentence(row) for row in data.parameters]
    if data.together is not None:
        together = data.together
        low, high = together.interval
        lines.append(
            f"With all errors at once, drawn from their spreads, {per_cent(together.share, 0)} "
            f"of {len(together.draws)} displays stay within the criterion ({per_cent(low, 0)} to "
            f"{per_cent(high, 0)})."
        )
        if together.to_sum is not None and together.part_of_each is not None:
            lines.append(
                f"The loss of all errors together is {together.to_sum:.2g} times the sum of the "
                "single losses. If losses add up, each error may be "
                f"{together.part_of_each:.2g} of its tolerance above."
            )
    return lines


def _sentence(row: ParameterTolerance) -> str:
    name = _words(row.name)
    bears, interval = row.tolerance, row.interval
    if interval is None:
        return f"{name.capitalize()}: too few displays could be validated for a result."
    if bears is None:
        farthest = _format_with_unit(row, row.farthest)
        return f"{name.capitalize()} may deviate by {farthest} or more; use a larger reach."
    low, high = ("beyond the drawn range" if end is None else f"{end:.3g}" for end in interval)
    return (
        f"With this sheet, {name} must be known to {_format_with_unit(row, bears)} (95{NBSP}% "
        f"interval {low} to {high}).{_calibrated_accuracy(row)}"
    )


def _calibrated_accuracy(row: ParameterTolerance) -> str:
    """Accuracy of a calibration, if given."""
    error = row.calibration_standard_error
    if error is None or row.tolerance is None:
        return ""
    within = _WITHIN * error
    often = row.tolerance / within
    enough = f"{often:.2g} times better than needed" if often >= 1 else "not good enough"
    return (
        f" A calibration reaches {_format_with_unit(row, within)} in 95{NBSP}% of cases: {enough}."
    )


def _words(name: str) -> str:
    return name.rpartition("_")[0].replace("_", " ")


def _format_with_unit(row: ParameterTolerance, value: float) -> str:
    return f"{value:.3g}{NBSP}{row.name.rpartition('_')[2]}"


def _page(data: ToleranceDocument) -> str:
    criterion = number(data.criterion, 4).rstrip("0")
    introduction = (
        f"An EIA of the nominal display is shown on misaligned displays. The score is "
        f"{HEADLINE_WORDS}, averaged over the viewpoints; the reference uses the misaligned "
        f"display. The aligned display scores {number(data.aligned, 4)}; the tolerated loss is "
        f"{criterion}."
    )
    rows = data.parameters
    together = len(data.together.draws) if data.together is not None else 0
    facts = [
        f"{sum(len(row.draws) for row in rows)} displays with one error, {together} with all "
        "errors",
        f"EIA of {data.algorithm}",
        ", ".join(data.viewpoints),
    ]
    failed = [f"{failure.display}: {failure.error}" for failure in data.failed]
    return document_page(
        data,
        "tolerate.json",
        map(text, facts),
        [
            Section("failures", "Failed displays", bullets(failed, "failures")),
            Section(
                "bears",
                "Tolerances",
                lead(introduction) + bullets(sentences(data), "remarks") + _tolerance_table(rows),
            ),
            Section(
                "alone",
                "Each error alone",
                lead(_ALONE + _CALIBRATED * _is_calibrated(rows))
                + element("div", *(_panel(data, row) for row in rows), class_="panels"),
            ),
            Section(
                "together",
                "All errors at once",
                lead(_TOGETHER)
                + plot(_draw_together(data, data.together), "Share of displays against their loss")
                if data.together is not None
                else "",
            ),
            how_to_reproduce(data),
        ],
        purpose="inim tolerate",
    )


def _is_calibrated(rows: Sequence[ParameterTolerance]) -> bool:
    return any(row.calibration_standard_error is not None for row in rows)


def _tolerance_table(rows: Sequence[ParameterTolerance]) -> str:
    heads = [
        "Parameter",
        "Must be known to",
        "95 % interval",
        "Drawn range",
        "Scatter of the curve",
    ]
    heads += ["Spread, all at once"]
    calibrated = _is_calibrated(rows)
    heads += ["A calibration reaches", "Better than needed"] if calibrated else []
    cells = []
    for row in rows:
        bears, ends = row.tolerance, row.interval or [None, None]
        tolerance_text = MISSING if bears is None else _format_with_unit(row, bears)
        between = ["…" if end is None else f"{end:.3g}" for end in ends]
        line = [
            _words(row.name),
            tolerance_text,
            " – ".join(between),
            _format_with_unit(row, row.farthest),
        ]
        line += [number(row.scatter, 4), f"{row.distribution} {_format_with_unit(row, row.spread)}"]
        error = row.calibration_standard_error
        if calibrated:
            within = MISSING if error is None else _format_with_unit(row, _WITHIN * error)
            better = None if bears is None or error is None else bears / (_WITHIN * error)
            line += [within, MISSING if better is None else f"{better:.2g} ×"]
        cells.append(line)
    caption = "Errors that cost no more than the criterion, each alone"
    return text_table(caption, heads, cells, "numbers")


def _panel(data: ToleranceDocument, row: ParameterTolerance) -> str:
    """A parameter's draws and its curve; all panels have one scale of scores."""
    figure, (axis,) = new_figure(1, _PANEL_HEIGHT)
    name, aligned = _words(row.name), data.aligned
    style(axis, name, row.name.rpartition("_")[2], "SSIM to the reference")
    axis.axhline(aligned - data.criterion, **LINES["floor"])
    axis.set_xlim(-1.04 * row.farthest, 1.04 * row.farthest)
    scores = [draw.score for parameter_row in data.parameters for draw in parameter_row.draws]
    low, high = min([*scores, aligned - 2 * data.criterion]), max([*scores, aligned])
    axis.set_ylim(low - 0.05 * (high - low), high + 0.08 * (high - low))
    error = row.calibration_standard_error
    if error is not None:
        axis.axvspan(-_WITHIN * error, _WITHIN * error, color=_REACHED, alpha=0.2, linewidth=0)
    if row.curve is not None:
        at, lost = zip(*row.curve.line, strict=True)
        axis.plot(at, [aligned - loss for loss in lost], color=_CURVE, linewidth=1.0)
    errors = [draw.error for draw in row.draws]
    axis.plot(errors, [draw.score for draw in row.draws], "o", color=_DRAWN, markersize=3.5)
    if row.tolerance is not None:
        for side in (-1, 1):
            place = side * row.tolerance
            axis.axvline(place, color=_BEARS, linewidth=1.0, linestyle=":")
        across(axis, f"{row.tolerance:.3g}", x=row.tolerance)
    return plot(svg(figure), f"Score against the error of {name}")


def _draw_together(data: ToleranceDocument, together: Together) -> bytes:
    figure, (axis,) = new_figure(1, 3.4)
    draws, criterion = together.draws, data.criterion
    lost = sorted(data.aligned - draw.score for draw in draws)
    shares = [(i + 1) / len(lost) for i in range(len(lost))]
    axis.step([min(0.0, lost[0]), *lost], [0, *shares], where="post", color=_CURVE, linewidth=1.3)
    sums = sorted(d.sum_of_losses for d in draws if d.sum_of_losses is not None)
    if sums:
        axis.step([0.0, *sums], [0, *shares], where="post", color=SOFT, linestyle="--", linewidth=1)
    axis.axvline(criterion, color=_BEARS, linewidth=1.0, linestyle=":")
    across(axis, "criterion", x=criterion)
    axis.set_ylim(0, 1.02)
    style(axis, "", f"loss of {HEADLINE_WORDS}", "share of displays")
    return svg(figure)
