"""The table of a sweep: tidy Parquet, a row for each viewpoint of each algorithm of each unit."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from inim.apps.sweep.document import SweepDocument
from inim.apps.sweep.unit import Unit
from inim.display.settings import DISPLAY_KEYS, PREFIX, SETTINGS, Settings, plain_parameters
from inim.report.document import ReportDocument
from inim.report.labels import ScoreKind, check_finding, score_keys
from inim.scores.metrics import Metric, all_metrics
from inim.system.errors import UsageError
from inim.system.files import check_file
from inim.system.process.atomic_file import write_atomically

#: Columns of the relic's depth on the display, in mm and as a share of its own depth.
DEPTH, DEPTH_SHARE = "relic_depth_mm", "relic_depth_share"
#: Column of the smallest headline score that passes.
CRITERION = "min_ssim_to_reference"

# Settings with columns of their own, or without one.
_OTHER_COLUMNS = (
    "title",
    "display",
    "algorithms",
    "cameras",
    "viewpoints",
    "lens_model",
    CRITERION,
)
#: Parameters and settings that tell rows of one scene, display, algorithm and viewpoint apart.
VARIED_COLUMNS = (
    *DISPLAY_KEYS,
    "lens_model",
    *(name for name in SETTINGS if name not in (*DISPLAY_KEYS, *_OTHER_COLUMNS)),
)

#: Prefixes of the reference's and the noise floor's scores in each row.
REFERENCES = ("reference", "noise_floor")
_FLOOR_EIA = "noise_floor_eia"


def view_columns(prefix: str = "") -> dict[str, Metric]:
    """Columns of a view's scores against the scene, with their metrics, in the table's order."""
    return _columns_of_kinds("scene", "relic", prefix)


def to_reference_columns() -> dict[str, Metric]:
    """Columns of a view's scores against the reference view, with their metrics."""
    return _columns_of_kinds("reference", "relic to reference")


def _columns_of_kinds(whole: ScoreKind, relic: ScoreKind, prefix: str = "") -> dict[str, Metric]:
    return {
        f"{prefix}{keys[kind]}": metric
        for kind in (whole, relic)
        for metric in all_metrics()
        if kind in (keys := score_keys(metric))
    }


def eia_columns(start: str = "eia") -> dict[str, Metric]:
    """Columns of an EIA's scores, with their metrics."""
    return {f"{start}_{metric.key}": metric for metric in all_metrics() if metric.has_eia_score}


def finished_rows(unit: Unit, algorithm: str, data: ReportDocument) -> list[dict[str, Any]]:
    """Rows of the table for an algorithm of a validation, one for each viewpoint."""
    assert unit.plan is not None
    result, floor, scene = data.algorithms[algorithm], data.noise_floor, data.scene
    assert floor is not None and scene is not None
    failed = _failed_checks(data, algorithm)
    common = {
        **_identity(unit, algorithm),
        "status": "ok",
        "error": None,
        **_scores(result.eia, eia_columns(), "eia_"),
        "hole_fraction": result.eia["hole_fraction"],
        DEPTH: scene.fit.depth_mm,
        DEPTH_SHARE: scene.fit.depth_share,
        **_scores(floor.eia, eia_columns(_FLOOR_EIA), f"{_FLOOR_EIA}_"),
        "seconds": result.seconds,
        "yardsticks": result.yardsticks,
        "unit_seconds": data.timings["total"],
        "render_seconds": data.timings["mitsuba_render"],
        "passed": not failed,
        "failed_checks": "; ".join(failed) or None,
        CRITERION: unit.plan.ssim_limits.get(algorithm),
        "variant": data.backend.variant,
        "device": data.backend.device,
        "inim_version": data.inim_version,
        "mitsuba_version": data.versions["mitsuba"],
        "created": data.created,
    }
    rows = []
    for eye in data.viewpoints:
        scores = _scores(result.views[eye.name], view_columns() | to_reference_columns())
        for reference in REFERENCES:
            of_reference = getattr(data, reference).views[eye.name]
            scores |= _scores(of_reference, view_columns(f"{reference}_"), f"{reference}_")
        place = dict(zip(("x_mm", "y_mm", "z_mm"), eye.position_mm, strict=True))
        rows.append(common | {"viewpoint": eye.name} | place | scores)
    return rows


def _scores(
    scores: Mapping[str, float | None], columns: Mapping[str, Metric], prefix: str = ""
) -> dict[str, float | None]:
    """Scores by column, whose name is the prefix and the score's; the infinite PSNR is not null."""
    values = {column: scores.get(column.removeprefix(prefix)) for column in columns}
    return {
        column: math.inf if value is None and max(columns[column].range) == math.inf else value
        for column, value in values.items()
    }


def _failed_checks(data: ReportDocument, algorithm: str) -> list[str]:
    """Failed checks of the ground truth and of this algorithm, not those of the others."""
    others = [name for name in data.algorithms if name != algorithm]
    return [
        f"{check.name}: {check_finding(check)}"
        for check in data.verdict.checks
        if not check.passed and not any(_is_of(check.name, other) for other in others)
    ]


def _is_of(check: str, algorithm: str) -> bool:
    """True if a check belongs to an algorithm: ``NAME: …``, ``NAME/VIEW: …``, ``eia/NAME: …``."""
    name = check.removeprefix("eia/").removeprefix("views/")
    return name.startswith((f"{algorithm}: ", f"{algorithm}/"))


def failed_rows(unit: Unit, algorithm: str, error: str) -> list[dict[str, Any]]:
    """Rows of a failed unit: one for each viewpoint, or one if the viewpoints are unknown."""
    start = _identity(unit, algorithm) | {"status": "failed", "error": error}
    viewpoints = unit.plan.viewpoints if unit.plan is not None else ()
    places = [
        {"viewpoint": v.name, "x_mm": v.x_mm, "y_mm": v.y_mm, "z_mm": v.z_mm} for v in viewpoints
    ]
    return [start | place for place in places or [{}]]


def _identity(unit: Unit, algorithm: str) -> dict[str, Any]:
    row: dict[str, Any] = {"scene": unit.scene, "display": unit.display, "algorithm": algorithm}
    row["unit"] = unit.hash or None
    if unit.plan is None:
        return row | _study_settings(unit)
    display = unit.plan.display
    values = asdict(unit.plan.settings) | display.parameters() | plain_parameters(display)
    row["scene_sha256"] = unit.plan.file.sha256
    row["pixels_per_lens"] = display.pixels_per_lens
    return row | {key: values[key] for key in VARIED_COLUMNS}


def _study_settings(unit: Unit) -> dict[str, Any]:
    """Settings of the study, for a unit whose scene cannot be read."""
    definitions = unit.request.definitions
    settings = asdict(Settings.parse(definitions, unit.label))
    return {key: settings[key] for key in VARIED_COLUMNS if f"{PREFIX}{key}" in definitions}


TABLE = "sweep.parquet"
# Column types of settings, by the first of their types.
_TYPES = {int: "int64", float: "float64"}
_SETTINGS = {name: _TYPES.get(s.kinds[0], "string") for name, s in SETTINGS.items()}
_MADE = ("unit", "scene_sha256", "variant", "device", "inim_version", "mitsuba_version", "created")


def column_groups() -> dict[str, dict[str, str]]:
    """Name and type of every column by group, in the table's order.

    Raises `UsageError` if a metric of another package cannot be loaded or has the name of another
    column.
    """
    floor = eia_columns(_FLOOR_EIA)
    scores = {
        "the view against the scene": view_columns(),
        "against the reference view": to_reference_columns(),
        "the reference against the scene": view_columns("reference_"),
        "noise floor": view_columns("noise_floor_"),
    }
    groups = {
        "names": _columns_of_type("string", "scene", "display", "algorithm", "viewpoint"),
        '"ok" or "failed", and the error; scores of a failed unit are null': _columns_of_type(
            "string", "status", "error"
        ),
        **{title: _columns_of_type("float64", *names) for title, names in scores.items()},
        "the EIA, before any optics": _columns_of_type(
            "float64", *eia_columns(), "hole_fraction", *floor
        ),
        "generation of the EIA: first run; kernel times, with `time = true`": _columns_of_type(
            "float64", "seconds", "yardsticks"
        ),
        "time of the validation, and of its rendering": _columns_of_type(
            "float64", "unit_seconds", "render_seconds"
        ),
        "depth of the relic on the display, and its share of the relic's own depth": (
            _columns_of_type("float64", DEPTH, DEPTH_SHARE)
        ),
        "checks of the ground truth and the algorithm; the criterion, null: none": {
            "passed": "bool",
            "failed_checks": "string",
            CRITERION: "float64",
        },
        "position of the eye": _columns_of_type("float64", "x_mm", "y_mm", "z_mm"),
        "the display; null: by its other parameters": _parameter_columns(
            *DISPLAY_KEYS, "pixels_per_lens"
        ),
        "settings; null: not given": _parameter_columns(
            *(name for name in VARIED_COLUMNS if name not in DISPLAY_KEYS)
        ),
        "origin": _columns_of_type("string", *_MADE),
    }
    names = [name for group in groups.values() for name in group]
    for metric in all_metrics():
        for name in (metric.key, metric.to_reference_key):
            if names.count(name) > 1:
                raise UsageError(
                    f"metric {metric.name!r}: a sweep's table has a column {name!r} already; "
                    "give the metric another name"
                )
    return groups


_METADATA = ("title", "created", "inim_version", "command")


def _columns_of_type(kind: str, *names: str) -> dict[str, str]:
    return dict.fromkeys(names, kind)


def _parameter_columns(*names: str) -> dict[str, str]:
    return {name: _SETTINGS.get(name, "float64") for name in names}


def columns() -> dict[str, str]:
    """Name and type of every column, in the table's order; errors as `column_groups`."""
    return {name: kind for group in column_groups().values() for name, kind in group.items()}


def columns_as_markdown() -> str:
    """`column_groups` as the Markdown table of the documents."""
    rows = [
        f"| {', '.join(f'`{name}`' for name in group)} | {title} |"
        for title, group in column_groups().items()
    ]
    return "\n".join(["| columns | content |", "| --- | --- |", *rows])


def check_pyarrow() -> None:
    """Raise `UsageError` with the installation command if pyarrow is missing."""
    try:
        import pyarrow.parquet  # noqa: F401
    except ImportError:
        raise UsageError(
            "a sweep's table needs pyarrow, which is not installed: pip install 'inim[sweep]'"
        ) from None


def write_table(path: Path, rows: Sequence[Mapping[str, Any]], about: SweepDocument) -> None:
    """Write rows, with values by `columns`, as a Parquet file; missing values are null."""
    import pyarrow as pa
    from pyarrow import parquet

    types = {
        "string": pa.string(),
        "float64": pa.float64(),
        "int64": pa.int64(),
        "bool": pa.bool_(),
    }
    schema = pa.schema(
        [(name, types[kind]) for name, kind in columns().items()],
        metadata={f"inim:{key}": getattr(about, key) for key in _METADATA},
    )
    table = pa.Table.from_pylist([dict(row) for row in rows], schema=schema)
    write_atomically(path, lambda p: parquet.write_table(table, p))


def read_table(path: Path) -> list[dict[str, Any]]:
    """The rows of a table that `write_table` wrote."""
    from pyarrow import parquet

    check_file(path)
    rows: list[dict[str, Any]] = parquet.ParquetFile(path).read().to_pylist()
    return rows
