"""The board: means of all scored submissions by track, and tables by relic and by display."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from statistics import fmean, median
from typing import Any

from inim.apps.benchmark.definition import RELICS, case_of
from inim.apps.benchmark.document import (
    BoardDocument,
    BoardEntry,
    ResultDocument,
    ViewScores,
)
from inim.apps.benchmark.make import OPTIMAL
from inim.apps.benchmark.protocol import PROTOCOL, TRACKS
from inim.apps.benchmark.run import OPTIMAL_BLIND
from inim.apps.benchmark.score import RESULT
from inim.apps.benchmark.submission import check_name
from inim.report import plots
from inim.report.labels import number, per_cent, precise
from inim.report.score_table import latex_table, latex_text
from inim.report.study import Fold, PagePart, StudyPage, Table
from inim.scores.document_parts import origin
from inim.scores.metrics import HEADLINE_WORDS
from inim.scores.regression.scores import INTERVAL_LEVEL
from inim.scores.regression.verdict import student_interval
from inim.system.document import decode, encode, read_document, write_text
from inim.system.errors import FileError
from inim.system.worker.output import output_files

_VIEWS = "the reference above, the entry below; from a corner of the viewing zone, and the middle"
_PLOTS = tuple(f"time-{track}.{kind}" for track in TRACKS for kind in ("svg", "png"))
FILES = ("board.json", "board.html", "board.md", "board.tex", *_PLOTS)
_OPTIMA = {True: OPTIMAL_BLIND, False: OPTIMAL}
CITATION = (
    f"Scores by {PROTOCOL}: mean SSIM on the relic, without noise, between views of the submitted "
    "and of the ray-traced elemental images through the same simulated lens array, over the cases "
    "and nine viewpoints each, with 95 % intervals."
)


def read_results(suite: Path) -> list[ResultDocument]:
    """Results of a suite; raises `FileError` if there are none, or one is of another protocol."""
    results = []
    for path in sorted((suite / "results").glob(f"*/{RESULT}")):
        result = read_document(path, "score its submission again", ResultDocument)
        if result.protocol != PROTOCOL:
            raise FileError(f"{path}: is of {result.protocol}; score its submission again")
        results.append(result)
    if not results:
        raise FileError(
            f"{suite / 'results'}: no results; score submissions with `inim benchmark score`, or "
            "run algorithms with `inim benchmark run`"
        )
    return results


def entries_of(results: Sequence[ResultDocument], track: str) -> list[BoardEntry]:
    """Entries of a track, best first, over the cases that all of them have."""
    scores = {r.submission.name: r.scores[track] for r in results if r.scores.get(track)}
    if not scores:
        return []
    cases = common_cases(scores)
    order = sorted(scores, key=lambda name: -_mean(scores[name], cases, _headline))
    by_name = {result.submission.name: result for result in results}
    best = scores[order[0]]
    optimum = scores.get(_OPTIMA[track == "blind"]) or next(
        (r.scores["mesh"] for r in results if r.submission.name == OPTIMAL and track != "blind"),
        None,
    )
    return [_entry(by_name[name], scores[name], cases, best, optimum) for name in order]


def common_cases(scores: Mapping[str, Mapping[str, ViewScores]]) -> list[str]:
    """Cases that all entries have."""
    first, *others = scores.values()
    return [case for case in first if all(case in other for other in others)]


def _headline(score: ViewScores) -> float:
    return score.headline


def _mean(
    scores: Mapping[str, ViewScores],
    cases: Iterable[str],
    value: Callable[[ViewScores], float],
) -> float:
    return fmean(value(scores[case]) for case in cases)


def _by_relic(scores: Mapping[str, ViewScores], cases: Sequence[str]) -> dict[str, float]:
    """Mean headline by relic."""
    groups: dict[str, list[float]] = {}
    for case in cases:
        groups.setdefault(case_of(case).relic.name, []).append(scores[case].headline)
    return {relic: fmean(values) for relic, values in groups.items()}


def _entry(
    result: ResultDocument,
    scores: Mapping[str, ViewScores],
    cases: Sequence[str],
    best: Mapping[str, ViewScores],
    optimum: Mapping[str, ViewScores] | None,
) -> BoardEntry:
    relics = _by_relic(scores, cases)
    worst = min(relics, key=lambda relic: relics[relic])
    seconds, pixels = result.submission.seconds, result.panel_pixels
    times = [seconds[case] / pixels[case] for case in cases if case in seconds]
    psnrs = [scores[case].psnr_db for case in cases]
    possible = None
    if optimum is not None and all(case in optimum for case in cases):
        gap_db = _mean(scores, cases, _psnr) - _mean(optimum, cases, _psnr)
        possible = 10 ** (gap_db / 20)
    return BoardEntry(
        name=result.submission.name,
        cases=len(cases),
        headline=_mean(scores, cases, _headline),
        headline_error=math.hypot(*(scores[case].headline_error for case in cases)) / len(cases),
        worst=worst,
        worst_headline=relics[worst],
        centre=_mean(scores, cases, lambda score: score.centre),
        sides=_mean(scores, cases, lambda score: score.sides),
        to_truth=_mean(scores, cases, lambda score: score.to_truth),
        psnr_db=None if None in psnrs else fmean(psnr for psnr in psnrs if psnr is not None),
        possible=possible,
        ms_per_megapixel=1e9 * median(times) if times else None,
        difference=_difference(relics, _by_relic(best, cases)),
    )


def _psnr(score: ViewScores) -> float:
    return score.psnr_to_truth_db


def _difference(
    relics: Mapping[str, float], best: Mapping[str, float]
) -> tuple[float, float | None, float | None] | None:
    """Mean difference to the best, paired by relic, with Student's 95 % interval; None for itself.

    The interval is unknown for a single relic.
    """
    sample = [relics[name] - best[name] for name in relics]
    if not any(sample):
        return None
    low, high = student_interval(sample, INTERVAL_LEVEL) if len(sample) > 1 else (None, None)
    return fmean(sample), low, high


_HEADS = (
    "algorithm", "headline", "to the best", "worst relic", "centre", "sides", "to the scene",
    "EIA PSNR dB", "of what is possible", "ms per megapixel",
)  # fmt: skip


def _row(entry: BoardEntry) -> list[str]:
    error = entry.headline_error
    interval = (entry.headline - error, entry.headline + error)
    return [
        entry.name,
        precise(entry.headline, interval, 3),
        "best" if entry.difference is None else precise(
            entry.difference[0], entry.difference[1:], 3),
        f"{number(entry.worst_headline, 3)} {entry.worst}",
        number(entry.centre, 3),
        number(entry.sides, 3),
        number(entry.to_truth, 3),
        "equal" if entry.psnr_db is None else number(entry.psnr_db, 1),
        per_cent(entry.possible, 0),
        number(entry.ms_per_megapixel, 2),
    ]  # fmt: skip


def write_board(suite: Path, out: Path, command: str) -> None:
    """Write `board.json`, its page, Markdown and LaTeX into a folder."""
    results = read_results(suite)
    tracks = {track: entries_of(results, track) for track in TRACKS}
    tracks = {track: entries for track, entries in tracks.items() if entries}
    document = BoardDocument(
        title=f"Board of {PROTOCOL}",
        **origin(command),
        protocol=PROTOCOL,
        citation=CITATION,
        tracks=tracks,
        results=results,
        files=[],
    )
    document = decode(encode(document), BoardDocument)  # as it is read: infinite values are null
    with output_files(out, FILES) as staging:
        parts = [_part(document, track, suite) for track in tracks]
        page = StudyPage("Conditions", _facts(document), _remarks(document), parts)
        write_text(staging / "board.tex", _latex(document))
        page.write(document, staging, "board")


def _cases(data: BoardDocument) -> set[str]:
    return {case for result in data.results for track in result.scores.values() for case in track}


def _facts(data: BoardDocument) -> list[str]:
    entries = len(data.results)
    return [
        data.protocol,
        f"{len(_cases(data))} cases",
        f"{entries} submissions",
        f"inim {data.inim_version}",
    ]


def _remarks(data: BoardDocument) -> list[str]:
    copies = [
        f"{result.submission.name}: {text}" for result in data.results for text in result.warnings
    ]
    names_on_board = {*map(_relic, _cases(data))}
    relics = [
        f"{relic.name}: {relic.source}, {relic.licence}"
        for relic in RELICS.values()
        if relic.scan is not None and relic.name in names_on_board
    ]
    return [
        data.citation,
        f"Headline: {HEADLINE_WORDS}. Its interval is that of the truth's noise, over the same "
        "relics. Sides are the viewpoints apart from the middle one.",
        "Differences to the best are means over relics, with Student's 95 % interval.",
        f"{OPTIMAL}: its views come closest to the scene, not to the reference; it is the bound of "
        "what is possible.",
        "Run times are those of each submission's hardware, and comparable on one machine only.",
        *copies,
        *relics,
    ]


def _part(data: BoardDocument, track: str, suite: Path) -> PagePart:
    entries = data.tracks[track]
    scores = {r.submission.name: r.scores[track] for r in data.results if track in r.scores}
    cases, names = common_cases(scores), [entry.name for entry in entries]
    folds = []
    for heading, group in (("relic", _relic), ("display", _display)):
        groups = list(dict.fromkeys(map(group, cases)))
        rows = [
            [name, *(
                number(fmean(scores[name][c].headline for c in cases if group(c) == of), 3)
                for of in groups
            )]
            for name in names
        ]  # fmt: skip
        table = Table(f"{track}: headline by {heading}", ["algorithm", *groups], rows)
        folds.append(Fold(f"By {heading}", (table,)))
    for case in {_relic(case): case for case in reversed(cases)}.values():
        views = {
            name: suite / "results" / check_name(name) / "views" / track / f"{case}.png"
            for name in names
        }
        pictures = {name: path for name, path in views.items() if path.is_file()}
        folds.append(Fold(f"Views of {case}: {_VIEWS}", (), pictures))
    timed = [entry for entry in entries if entry.ms_per_megapixel is not None]
    figure = _draw(timed) if len(timed) > 1 else None
    table = Table(f"{track}: {TRACKS[track]}", _HEADS, [_row(entry) for entry in entries])
    lead = f"{TRACKS[track][0].upper()}{TRACKS[track][1:]}. Best first."
    return PagePart(
        track, f"Track {track}", lead, [table],
        plot=f"time-{track}", figure=figure, folds=folds,
    )  # fmt: skip


def _relic(case: str) -> str:
    return case_of(case).relic.name


def _display(case: str) -> str:
    return case_of(case).display_name


def _draw(entries: Sequence[BoardEntry]) -> Any:
    """Time against error of the entries with times."""
    figure = plots.blank_figure((9.2, 5.2), "constrained")
    axis = figure.subplots()
    plots.style(axis, "", "ms per million panel pixels (↙ better)", "1 − SSIM on the relic")
    errors = {entry.name: 1 - entry.headline for entry in entries}
    names = plots.draw_time_against_error(
        axis,
        [
            plots.TimedPoint(e.name, e.ms_per_megapixel, errors[e.name], errors[e.name])
            for e in entries
            if e.ms_per_megapixel is not None
        ],
    )
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.margins(0.15, 0.1)
    plots.plain_ticks(axis)
    figure.canvas.draw()
    plots.set_apart(axis, names)
    return figure


def _latex(data: BoardDocument) -> str:
    """Tables of all tracks as LaTeX, with the citation as a comment."""
    heads = [latex_text(head) for head in _HEADS]
    tables = [
        latex_table(heads, [[_latex_cell(cell) for cell in _row(entry)] for entry in entries])
        for entries in data.tracks.values()
    ]
    return "\n".join([f"% {data.citation}", *tables])


def _latex_cell(text: str) -> str:
    return latex_text(text).replace("±", r"$\pm$").replace("−", "$-$")
