"""The tables of a bench, once as text cells, for the page and for Markdown alike."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from inim.metrics import Metric, all_metrics
from inim.report.bench.cells import Table, milliseconds, times
from inim.report.bench.command_tables import command_remarks, command_tables
from inim.report.wording import MISSING, items, number, part, per_cent, plain, score

__all__ = ["claim_lines", "remarks", "render_markdown", "tables_of", "thread_words"]

_GIB = 2**30


def tables_of(data: Mapping[str, Any]) -> list[Table]:
    """All tables there is data for."""
    found = []
    if data.get("contenders"):
        found.append(_contenders(data))
    if data.get("scaling"):
        found += _scaling(part(data, "scaling"))
    if data.get("paper"):
        found += _paper(part(data, "paper"))
    if data.get("views"):
        found.append(_views(part(data, "views")))
    if data.get("layers"):
        found += _layers(items(data, "layers"))
    if data.get("commands"):
        found += command_tables(part(data, "commands"))
    return found


# -- scene --------------------------------------------------------------------------------------

# A score's name in bench.json, and its metric.
_Score = tuple[str, Metric]
_TIME_HEADS = ("ms per EIA", "fastest", "spread", "runs", "Mpx/s", "yardsticks", "by fastest")


def _time_cells(c: Mapping[str, Any]) -> list[str]:
    return [
        milliseconds(c.get("median_ms")),
        milliseconds(c.get("min_ms")),
        f"± {per_cent(c.get('spread'), 1)}",
        plain(c.get("runs", MISSING)),
        number(c.get("mpx_per_s"), 1 if c.get("mpx_per_s", 0) < 100 else 0),
        times(c.get("ratio")),
        times(c.get("ratio_min")),
    ]


def _contenders(data: Mapping[str, Any]) -> Table:
    floor = part(data, "noise_floor")
    found = items(data, "contenders")
    scores = _scores({**part(found[0]), **floor})
    heads = [
        "algorithm", *_TIME_HEADS, "prepare s", "cold s", "wrong source", "holes", *scores, "front",
    ]  # fmt: skip
    rows = [[c["name"], *_time_cells(c), *_error_cells(c, scores.values())] for c in found]
    rows.append(_yardstick_row(part(data, "yardstick"), len(heads)))
    errors = _score_cells(floor, scores.values())
    blank = [MISSING] * (len(heads) - 2 - len(errors))
    rows.append(["noise floor", *blank, *errors, MISSING])
    return Table("scene", "Time against error, medians", heads, rows)


def _error_cells(c: Mapping[str, Any], scores: Iterable[_Score]) -> list[str]:
    return [
        number(c.get("prepare_s"), 3),
        number(c.get("cold_s"), 2),
        per_cent(c.get("wrong_source"), 3),
        per_cent(c.get("hole_fraction"), 2),
        *_score_cells(c, scores),
        "yes" if c.get("pareto") else "no",
    ]


def _scores(data: Mapping[str, Any]) -> dict[str, _Score]:
    """Scores that a bench has of EIAs and of views, by the heads of their columns."""
    known = {
        f"EIA {m.label} {m.unit}".strip(): (f"eia_{m.key}", m) for m in all_metrics() if m.of_eia
    }
    for m in all_metrics():
        known[f"view {m.label} to ceiling {m.unit}".strip()] = (f"view_{m.to_ceiling_key}", m)
    return {head: one for head, one in known.items() if one[0] in data}


def _score_cells(c: Mapping[str, Any], scores: Iterable[_Score]) -> list[str]:
    return [score({m.key: c[name]}, m.key) if name in c else MISSING for name, m in scores]


def _yardstick_row(yardstick: Mapping[str, Any], cells: int) -> list[str]:
    known = _time_cells({**yardstick, "ratio": 1.0, "ratio_min": 1.0})
    known[4] = MISSING
    return ["yardstick", *known, *[MISSING] * (cells - 1 - len(known))]


# -- scaling ------------------------------------------------------------------------------------


def _scaling(scaling: Mapping[str, Any]) -> list[Table]:
    heads = [
        "lenses", "picture pixels per pitch", "display pixels", "scene pixels",
        *_TIME_HEADS, "yardstick ms",
    ]  # fmt: skip
    captions = {
        "display": f"{scaling['algorithm']} against display pixels",
        "scene": f"{scaling['algorithm']} against scene pixels",
    }
    found = [
        Table("scaling", caption, heads, [_size_row(p) for p in items(scaling, key)])
        for key, caption in captions.items()
    ]
    memory = part(scaling, "memory")
    row = [
        f"{memory['lenses']} × {memory['lenses']}",
        *(
            f"{number(memory[k] / _GIB, 3)} GiB"
            for k in (
                "imported_bytes",
                "peak_bytes",
                "above_import_bytes",
                "limit_bytes",
                "eia_bytes",
            )
        ),
    ]
    names = ["lenses", "after the imports", "peak", "above the imports", "limit", "the EIA itself"]
    caption = "Peak memory of a fresh process that makes one EIA"
    return [*found, Table("scaling", caption, names, [row])]


def _size_row(point: Mapping[str, Any]) -> list[str]:
    return [
        f"{point['lenses']} × {point['lenses']}",
        str(point["pixels_per_pitch"]),
        f"{point['display_pixels']:,}",
        f"{point['scene_pixels']:,}",
        *_time_cells(point),
        milliseconds(part(point, "yardstick").get("median_ms")),
    ]


# -- paper --------------------------------------------------------------------------------------

_PYTHON = ":implementation=python"


def _paper(paper: Mapping[str, Any]) -> list[Table]:
    found = [_experiment(part(e)) for e in items(paper, "experiments")]
    return [*found, _same_input(part(paper, "same_input"))]


def _experiment(experiment: Mapping[str, Any]) -> Table:
    """Milliseconds of each at each size, then the two ratios the paper's claims are about."""
    points = items(experiment, "points")
    names = [c["name"] for c in points[0]["contenders"]]
    heads = [
        experiment["name"],
        *(name.replace(_PYTHON, ", Python") for name in names),
        "gu2020 / wang2024, Python", "gu2020 / wang2024", "wang2024, Python / template",
    ]  # fmt: skip
    rows = []
    for point in points:
        ms = {c["name"]: c["median_ms"] for c in point["contenders"]}
        ratios = [
            ratio(ms, f"gu2020{_PYTHON}", f"wang2024{_PYTHON}"),
            ratio(ms, "gu2020", "wang2024"),
            ratio(ms, f"wang2024{_PYTHON}", "template"),
        ]
        cells = [milliseconds(ms[name]) for name in names]
        rows.append([f"{point[experiment['size']]:,}", *cells, *map(times, ratios)])
    caption = (
        f"As the paper's {experiment['figure']}: ms per EIA against {experiment['name']}; "
        f"{experiment['kept']}"
    )
    return Table("paper", caption, heads, rows)


def ratio(ms: Mapping[str, float], above: str, below: str) -> float | None:
    """One median over another; None where one is missing."""
    return ms[above] / ms[below] if above in ms and below in ms else None


def _same_input(same: Mapping[str, Any]) -> Table:
    heads = [
        "algorithm", "ms per EIA", "runs", "times template", "wrong source", "EIA PSNR dB",
        "view SSIM to ceiling", "middle view SSIM", "the paper's, other scenes",
    ]  # fmt: skip
    contenders = items(same, "contenders")
    ms = {c["name"]: c["median_ms"] for c in contenders}
    rows = [
        [
            c["name"].replace(_PYTHON, ", Python"),
            milliseconds(c["median_ms"]),
            str(c["runs"]),
            times(ratio(ms, c["name"], "template")),
            per_cent(c["wrong_source"], 2),
            score({"psnr_db": c["eia_psnr_db"]}, "psnr_db"),
            number(c["view_ssim_to_ceiling"], 4),
            number(c["middle_view_ssim"], 3),
            number(c["published_ssim"], 2),
        ]
        for c in contenders
    ]
    rows.append(["ceiling", *[MISSING] * 6, number(same.get("ceiling_ssim"), 3), MISSING])
    caption = (
        f"One input for all: {same['lenses']:,} lenses, {same['display_pixels']:,} display pixels, "
        f"{same['scene_pixels']:,} scene pixels"
    )
    return Table("paper", caption, heads, rows)


# -- views --------------------------------------------------------------------------------------


def _views(views: Mapping[str, Any]) -> Table:
    heads = [
        "lens model", "ms per view", "rectangles", "by fastest", "times thick", "samples timed",
        "ms as timed",
        "spread", "runs", "noise of a sample", "ms at the noise of thick",
    ]  # fmt: skip
    rows = [
        [
            c["name"],
            milliseconds(c["view_ms"]),
            times(c["ratio"]),
            times(c["ratio_min"]),
            times(c["thick_ratio"]),
            str(c["spp"]),
            milliseconds(c["median_ms"]),
            f"± {per_cent(c['spread'], 1)}",
            str(c["runs"]),
            number(c["noise"], 4),
            milliseconds(c["equal_noise_ms"]),
        ]
        for c in items(views, "contenders")
    ]
    caption = (
        f"One view of {views['columns']} × {views['rows']} pixels, {views['spp']} samples each "
        "(fewer timed: scaled up)"
    )
    return Table("views", caption, heads, rows)


# -- layers -------------------------------------------------------------------------------------


def _layers(scenes: Sequence[Mapping[str, Any]]) -> list[Table]:
    heads = [
        "scene", "algorithm", *_TIME_HEADS, "times template", "by fastest", "EIA SSIM",
        "EIA PSNR dB", "to noise floor dB", "view SSIM to ceiling", "rays differ",
    ]  # fmt: skip
    rows = [
        [
            found["title"],
            c["name"],
            *_time_cells(c),
            times(c["template_ratio"]),
            times(c["template_ratio_min"]),
            number(c["eia_ssim"], 4),
            score({"psnr_db": c["eia_psnr_db"]}, "psnr_db"),
            f"{c['to_floor_db']:+.2f}",
            number(c["view_ssim_to_ceiling"], 4),
            per_cent(c["averaged_share"], 1),
        ]
        for found in scenes
        for c in items(found, "contenders")
    ]
    captured = [_captured_row(found, part(found, "captured_layers")) for found in scenes]
    capture_heads = [
        "scene", "noise floor dB", "picture", "layers", "front covers", "what lies behind",
        "of it hidden, left out", "yardstick ms",
    ]  # fmt: skip
    return [
        Table("layers", "One layer and all, at equal samples", heads, rows),
        Table(
            "layers", "What the capture found, in shares of the picture", capture_heads, captured
        ),
    ]


def _captured_row(found: Mapping[str, Any], captured: Mapping[str, Any]) -> list[str]:
    front, *deeper = captured["covered_shares"]
    return [
        found["title"],
        score({"psnr_db": found["noise_floor"]["eia_psnr_db"]}, "psnr_db"),
        f"{found['picture']['columns']} × {found['picture']['rows']}",
        str(1 + len(deeper)),
        per_cent(front, 1),
        per_cent(sum(deeper), 2),
        per_cent(captured["hidden_share"], 1),
        milliseconds(found["yardstick"]["median_ms"]),
    ]


def claim_lines(paper: Mapping[str, Any]) -> list[str]:
    """Each claim in a few sentences: what is claimed, what was found, why not."""
    lines = []
    for claim in items(paper, "claims"):
        word = "Reproduced" if claim["holds"] else "Does not reproduce"
        why = f" {claim['why']}" if claim["why"] else ""
        lines.append(f"{word}: {claim['claim']} ({claim['source']}). Found: {claim['found']}.{why}")
    return lines


def thread_words(data: Mapping[str, Any]) -> str:
    """The number of threads with its noun."""
    count = data.get("threads", MISSING)
    return f"{count} thread" if count == 1 else f"{count} threads"


def remarks(data: Mapping[str, Any]) -> list[str]:
    """Conditions, in sentences."""
    load, rounds = part(data, "load"), part(data, "rounds")
    backend = part(data, "backend")
    slow = [c["name"] for c in items(data, "contenders") if c.get("slow")]
    lines = [
        f"{thread_words(data)}, {backend.get('device', MISSING)}; load average "
        f"{number(load.get('start'), 2)} at the start, {number(load.get('end'), 2)} at the end, on "
        f"{load.get('cores', MISSING)} cores.",
        f"Medians of {rounds.get('runs')} runs after {rounds.get('warmups')} warm-ups, all in turn "
        "with the yardstick: one 4-byte gather per display pixel where its ray meets the central "
        "depth plane. Spread: half the distance between the quartiles.",
    ]
    if slow:
        lines.append(f"Fewer runs, being slow: {', '.join(slow)}.")
    if data.get("views"):
        lines.append(
            "Views: in turn with the textured rectangle; the mesh of `full` apart, in turn with "
            "`thick`: while it is there, the renderer compiles its lights and materials into every "
            "scene's kernel."
        )
    if data.get("commands"):
        lines += command_remarks(part(data, "commands"))
    paper = part(data, "paper")
    memory = part(data, "scaling", "memory")
    if memory:
        within = memory["above_import_bytes"] < memory["limit_bytes"]
        lines.append(
            f"Peak memory at {memory['lenses']} × {memory['lenses']} lenses "
            f"{'stays below' if within else 'EXCEEDS'} {memory['limit_bytes'] / _GIB:g} GiB above "
            "the imports."
        )
    if paper:
        lines.append("Plain Python above 2 s a run: at most 3 runs; above 10 s: one.")
    return [*lines, *map(str, items(data, "notes")), *map(str, items(paper, "notes"))]


def render_markdown(data: Mapping[str, Any]) -> str:
    """The bench as Markdown: conditions, tables, claims."""
    blocks = [f"## {_cell(data.get('title', 'Bench'))}"]
    blocks += [f"⚠ {_cell(w)}" for w in items(data, "warnings")]
    blocks.append("\n".join(f"* {_cell(line)}" for line in remarks(data)))
    for table in tables_of(data):
        head = [list(table.heads), [":--", *["--:"] * (len(table.heads) - 1)]]
        rows = [f"| {' | '.join(map(_cell, row))} |" for row in [*head, *table.rows]]
        blocks += [f"### {_cell(table.caption)}", "\n".join(rows)]
    claims = claim_lines(part(data, "paper"))
    if claims:
        blocks += ["### The paper's claims", "\n".join(f"* {_cell(line)}" for line in claims)]
    blocks.append(f"`{plain(data.get('command', '')).replace('`', '')}`")
    return "\n\n".join(blocks)


def _cell(value: object) -> str:
    """One line that cannot break a table."""
    line = " ".join(plain(value).split())
    return line.replace("&", "&amp;").replace("<", "&lt;").replace("|", "\\|")
