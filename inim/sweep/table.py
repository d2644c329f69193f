"""The table of a sweep: tidy Parquet, a row for each viewpoint of each algorithm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from inim.errors import UsageError
from inim.files.image import write_atomically
from inim.metrics import all_metrics
from inim.sweep.rows import (
    DISPLAY_COLUMNS,
    SETTING_COLUMNS,
    ceiling_columns,
    eia_columns,
    reference_columns,
    view_columns,
)

__all__ = [
    "SCHEMA",
    "TABLE",
    "check_pyarrow",
    "column_groups",
    "columns",
    "columns_as_markdown",
    "read_table",
    "write_table",
]

SCHEMA = "inim.sweep/1"
TABLE = "sweep.parquet"
# Texts and whole numbers; everything else that is counted or measured is a float64.
_TEXT = ("lens_model", "misalign")
_WHOLE = (
    "lens_columns",
    "lens_rows",
    "view_pixels_per_lens",
    "capture_pixels_per_pitch",
    "capture_spp",
    "eia_spp",
    "view_spp",
    "reconstruction_spp",
    "seed",
)
_MADE = (
    "unit",
    "scene_sha256",
    "variant",
    "device",
    "inim_version",
    "mitsuba_version",
    "created",
)


def column_groups() -> dict[str, dict[str, str]]:
    """Name and type of every column, in the table's order, by what documents say of them.

    Raises
    ------
    UsageError
        Another package's metric cannot be loaded, or would have the name of another column.
    """
    floor = eia_columns("noise_floor_eia")
    scores = {
        "the view against the scene": view_columns(),
        "against the ceiling's view": ceiling_columns(),
        "the ceiling against the scene": reference_columns("ceiling"),
        "the truth against itself": reference_columns("noise_floor"),
    }
    groups = {
        "names": _of("string", "scene", "display", "algorithm", "viewpoint"),
        '"ok" or "failed", and why; scores are then null': _of("string", "status", "error"),
        **{what: _of("float64", *names) for what, names in scores.items()},
        "the EIA, before any optics": _of("float64", *eia_columns(), "hole_fraction", *floor),
        "of generating the EIA: once, cold; median ratio, with `time = true`": _of(
            "float64", "seconds", "yardsticks"
        ),
        "of the whole validation, and within the renderer": _of(
            "float64", "unit_seconds", "render_seconds"
        ),
        "whether the validation's checks on truth and algorithm passed": {
            "passed": "bool",
            "failed_checks": "string",
        },
        "where the eye is": _of("float64", "x_mm", "y_mm", "z_mm"),
        "the display": _parameters(*DISPLAY_COLUMNS, "pixels_per_lens"),
        "settings asked for; null: not given": _parameters(*SETTING_COLUMNS),
        "what made it": _of("string", *_MADE),
    }
    names = [name for group in groups.values() for name in group]
    for metric in all_metrics():
        for name in (metric.key, metric.to_ceiling_key):
            if names.count(name) > 1:
                raise UsageError(
                    f"metric {metric.name!r}: a sweep's table has a column {name!r} already; "
                    "give the metric another name"
                )
    return groups


def _of(kind: str, *names: str) -> dict[str, str]:
    return dict.fromkeys(names, kind)


def _parameters(*names: str) -> dict[str, str]:
    return {
        name: "string" if name in _TEXT else "int64" if name in _WHOLE else "float64"
        for name in names
    }


def columns() -> dict[str, str]:
    """Name and type of every column, in the table's order; errors as `column_groups`."""
    return {name: kind for group in column_groups().values() for name, kind in group.items()}


def columns_as_markdown() -> str:
    """`column_groups` as the Markdown table of the documents."""
    rows = [
        f"| {', '.join(f'`{name}`' for name in group)} | {what} |"
        for what, group in column_groups().items()
    ]
    return "\n".join(["| columns | what |", "| --- | --- |", *rows])


def check_pyarrow() -> None:
    """Raise the `UsageError` with the line to type where pyarrow is missing."""
    try:
        import pyarrow.parquet  # noqa: F401
    except ImportError:
        raise UsageError(
            "a sweep's table needs pyarrow, which is not installed: pip install 'inim[sweep]'"
        ) from None


def write_table(path: Path, rows: Sequence[Mapping[str, Any]], about: Mapping[str, str]) -> None:
    """Write rows as Parquet, whole or not at all.

    Parameters
    ----------
    path : Path
    rows : sequence of mapping
        Values by `columns`; what is missing is null.
    about : mapping of str to str
        Kept with the table: title, command.
    """
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
        metadata={"inim:schema": SCHEMA, **{f"inim:{key}": text for key, text in about.items()}},
    )
    table = pa.Table.from_pylist([dict(row) for row in rows], schema=schema)
    write_atomically(path, lambda p: parquet.write_table(table, p))


def read_table(path: Path) -> list[dict[str, Any]]:
    """The rows of a table that `write_table` wrote."""
    from pyarrow import parquet

    rows: list[dict[str, Any]] = parquet.ParquetFile(path).read().to_pylist()
    return rows
