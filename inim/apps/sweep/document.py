"""Document of a sweep: `sweep.json`."""

from inim.scores.document_parts import Files, TitledDocument


class SweepDocument(TitledDocument, tag="inim.sweep/1"):
    """Result of a sweep.

    `sweep.json` in the folder of `inim sweep`. The scores are in `sweep.parquet`, whose metadata
    has the title, the time, the version and the command under these names after `inim:`.
    """

    validations: int  #: Number of validations of the study.
    computed: int  #: Number of validations that this run computed; the others were stored.
    rows: int  #: Number of rows of the table.
    passed: bool  #: True if every validation finished and passed its checks.
    #: Error of each failed validation, by its label: scene, display, varied values.
    failed: dict[str, str]
    files: Files = []
