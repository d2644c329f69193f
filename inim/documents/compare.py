"""`compare.json`: comparison of two reports."""

from __future__ import annotations

from typing import Annotated

from inim.documents.document import Document, Part, doc
from inim.documents.parts import Checks, Circumstances, Conditions, Files, Regression


class Side(Part):
    """One of the two reports."""

    folder: Annotated[str, doc("Its folder, as given.")]
    circumstances: Circumstances


class CompareDocument(Document, tag="inim.compare/2"):
    """Comparison of two reports.

    `compare.json` in the folder of `inim compare OUT_A OUT_B`: the verdicts of a regression check
    between two reports.
    """

    title: Annotated[str, doc("Name of the scene.")]
    created: Annotated[str, doc("Time of creation of the later report: UTC, ISO 8601.")]
    before: Annotated[Side, doc("The report before, which serves as the baseline.")]
    after: Annotated[Side, doc("The report after.")]
    conditions: Conditions
    regression: Regression
    verdict: Checks
    files: Files = []
