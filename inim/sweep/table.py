"""The table of a sweep: tidy Parquet, a row for each score that was asked for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from inim.errors import UsageError
from inim.files.image import write_atomically
from inim.sweep.rows import DISPLAY_COLUMNS, SETTING_COLUMNS

__all__ = ["COLUMNS", "SCHEMA", "TABLE", "check_pyarrow", "read_table", "write_table"]

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
_SCORES = ("ssim", "psnr_db", "flip")
#: Name and type of every column, in the table's order.
COLUMNS: dict[str, str] = {
    **dict.fromkeys(("scene", "display", "algorithm", "viewpoint", "status", "error"), "string"),
    **dict.fromkeys(_SCORES, "float64"),
    "ssim_on_relic": "float64",
    **dict.fromkeys(("ssim_to_ceiling", "psnr_to_ceiling_db", "flip_to_ceiling"), "float64"),
    **{f"ceiling_{key}": "float64" for key in _SCORES},
    **{f"noise_floor_{key}": "float64" for key in _SCORES},
    **dict.fromkeys(("eia_ssim", "eia_psnr_db", "hole_fraction"), "float64"),
    **dict.fromkeys(("noise_floor_eia_ssim", "noise_floor_eia_psnr_db"), "float64"),
    **dict.fromkeys(("seconds", "yardsticks", "unit_seconds", "render_seconds"), "float64"),
    "passed": "bool",
    "failed_checks": "string",
    **dict.fromkeys(("x_mm", "y_mm", "z_mm"), "float64"),
    **{
        key: "string" if key in _TEXT else "int64" if key in _WHOLE else "float64"
        for key in (*DISPLAY_COLUMNS, "pixels_per_lens", *SETTING_COLUMNS)
    },
    **dict.fromkeys(("unit", "scene_sha256", "variant", "device"), "string"),
    **dict.fromkeys(("inim_version", "mitsuba_version", "created"), "string"),
}


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
        Values by `COLUMNS`; what is missing is null.
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
        [(name, types[kind]) for name, kind in COLUMNS.items()],
        metadata={"inim:schema": SCHEMA, **{f"inim:{key}": text for key, text in about.items()}},
    )
    table = pa.Table.from_pylist([dict(row) for row in rows], schema=schema)
    write_atomically(path, lambda p: parquet.write_table(table, p))


def read_table(path: Path) -> list[dict[str, Any]]:
    """The rows of a table that `write_table` wrote."""
    from pyarrow import parquet

    rows: list[dict[str, Any]] = parquet.ParquetFile(path).read().to_pylist()
    return rows
