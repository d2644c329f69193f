"""Table of a sweep: `sweep.parquet`."""

from __future__ import annotations

from inim.documents.record import Record


class SweepTable(Record, tag="inim.sweep/1"):
    """Table of a sweep.

    Metadata of `sweep.parquet` in the folder of `inim sweep`, under these names after `inim:`.
    """
