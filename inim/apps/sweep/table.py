"""The table of a sweep: tidy Parquet, a row for each viewpoint of each algorithm of each unit."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msgspec import to_builtins

from inim.apps.sweep.document import SweepTable, UnitDocument, UnitView
from inim.apps.sweep.page import CRITERION, DEPTH, DEPTH_SHARE, VARIED_COLUMNS
from inim.display.settings import DISPLAY_KEYS, PREFIX, SETTINGS, Settings, plain_parameters
from inim.report.document import ReportDocument
from inim.report.labels import ScoreKind, check_finding, score_keys
from inim.scores.metrics import Metric, all_metrics
from inim.system.errors import UsageError
from inim.system.files import check_file
from inim.system.process.atomic_file import write_atomically

if TYPE_CHECKING:
    from inim.apps.sweep.unit import Unit

#: Prefixes of the reference's and the noise floor's scores in each row.
REFERENCES = ("reference", "noise_floor")


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


def unit_document(
    data: ReportDocument,
    *,
    unit: str,
    algorithm: str,
    making: dict[str, Any],
    key: dict[str, Any],
) -> UnitDocument:
    """Result of a finished validation for one algorithm.

    `unit` is the hash of the key; `making` and `key` are all inputs that determine the result.
    """
    result, floor, scene = data.algorithms[algorithm], data.noise_floor, data.scene
    assert floor is not None and scene is not None
    failed = _failed_checks(data, algorithm)
    views = []
    for eye in data.viewpoints:
        own = result.views[eye.name]
        scores = {column: own.get(column) for column in (*view_columns(), *to_reference_columns())}
        for reference in REFERENCES:
            of_reference = getattr(data, reference).views[eye.name]
            scores |= {f"{reference}_{name}": of_reference.get(name) for name in view_columns()}
        x_mm, y_mm, z_mm = eye.position_mm
        views.append(UnitView(viewpoint=eye.name, x_mm=x_mm, y_mm=y_mm, z_mm=z_mm, scores=scores))
    return UnitDocument(
        unit=unit,
        algorithm=algorithm,
        making=making,
        key=key,
        created=data.created,
        inim_version=data.inim_version,
        versions=data.versions,
        backend=data.backend,
        scores={
            **{name: result.eia.get(m.key) for name, m in eia_columns().items()},
            "hole_fraction": result.eia["hole_fraction"],
            DEPTH: scene.fit.depth_mm,
            DEPTH_SHARE: scene.fit.depth_share,
            **{name: floor.eia.get(m.key) for name, m in eia_columns("noise_floor_eia").items()},
        },
        seconds=result.seconds,
        yardsticks=result.yardsticks,
        unit_seconds=data.timings["total"],
        render_seconds=data.timings["mitsuba_render"],
        passed=not failed,
        failed_checks="; ".join(failed) or None,
        views=views,
    )


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


def finished_rows(unit: Unit, algorithm: str, result: UnitDocument) -> list[dict[str, Any]]:
    """Rows of the table for a result, one for each viewpoint."""
    common = {
        **_identity(unit, algorithm),
        "status": "ok",
        "error": None,
        **_infinite(result.scores),
        **{name: getattr(result, name) for name in _MEASURED},
        CRITERION: result.making[CRITERION],
        "variant": result.backend.variant,
        "device": result.backend.device,
        "inim_version": result.inim_version,
        "mitsuba_version": result.versions["mitsuba"],
        "created": result.created,
    }
    return [
        common
        | {"viewpoint": view.viewpoint, "x_mm": view.x_mm, "y_mm": view.y_mm, "z_mm": view.z_mm}
        | _infinite(view.scores)
        for view in result.views
    ]


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


def _infinite(columns: Mapping[str, float | None]) -> dict[str, float | None]:
    """Scores with the infinite PSNR of identical pictures, which is null in JSON."""
    scores = view_columns() | to_reference_columns()
    scores |= eia_columns() | eia_columns("noise_floor_eia")
    for reference in REFERENCES:
        scores |= view_columns(f"{reference}_")
    ends = {name: max(metric.range) for name, metric in scores.items()}
    return {
        key: math.inf if value is None and ends.get(key) == math.inf else value
        for key, value in columns.items()
    }


# Fields of a result that are columns of each of its rows.
_OF_GENERATION = ("seconds", "yardsticks")
_OF_VALIDATION = ("unit_seconds", "render_seconds")
_MEASURED = (*_OF_GENERATION, *_OF_VALIDATION, "passed", "failed_checks")
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
    floor = eia_columns("noise_floor_eia")
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
            "float64", *_OF_GENERATION
        ),
        "time of the validation, and of its rendering": _columns_of_type(
            "float64", *_OF_VALIDATION
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


def write_table(path: Path, rows: Sequence[Mapping[str, Any]], about: SweepTable) -> None:
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
        metadata={f"inim:{key}": text for key, text in to_builtins(about).items()},
    )
    table = pa.Table.from_pylist([dict(row) for row in rows], schema=schema)
    write_atomically(path, lambda p: parquet.write_table(table, p))


def read_table(path: Path) -> list[dict[str, Any]]:
    """The rows of a table that `write_table` wrote."""
    from pyarrow import parquet

    check_file(path)
    rows: list[dict[str, Any]] = parquet.ParquetFile(path).read().to_pylist()
    return rows
