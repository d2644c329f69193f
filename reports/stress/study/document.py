"""`stress.json` of the accuracy study."""

from __future__ import annotations

from typing import Annotated, Any

from inim.apps.stress.document import StressRecord
from inim.system.document import doc


class StudyDocument(StressRecord, tag="inim.stress-study/1"):
    """Accuracy study of generators and lens models.

    `stress.json` of `python -m reports.stress.study`: every generator and lens model against its
    oracle.
    """

    oracle_mantissa_bits: Annotated[int, doc("Mantissa bits of the lens models' oracle.")]
    generators: Annotated[
        list[dict[str, Any]],
        doc("Generators against their oracles, for each case, algorithm and type."),
    ]
    lens_models: Annotated[
        list[dict[str, Any]],
        doc("Lens models against their oracle, for each case, model and type."),
    ]
    regions: Annotated[
        list[dict[str, Any]],
        doc("Widest safe range of each family's parameter, for each algorithm or model and type."),
    ]
    trust: Annotated[
        dict[str, Any],
        doc("Measured values for the constants of `inim.generators.accuracy_limits`."),
    ]
