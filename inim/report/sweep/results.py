"""The results on a sweep's page: means over viewpoints, grouped as they are compared.

Scores of different scenes are never averaged into one another's rank: a scene's row is compared
with itself only, and where a figure stands for several scenes it is the mean of what each lost
against its own ceiling.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from inim.metrics import all_metrics
from inim.metrics.headline import HEADLINE, HEADLINE_TO_SCENE, MAIN
from inim.report.wording import is_number

Row = Mapping[str, Any]

#: Columns of the main score on the relic of the ceiling, and of the truth against itself.
REFERENCES = (f"ceiling_{HEADLINE_TO_SCENE}", f"noise_floor_{HEADLINE_TO_SCENE}")
_COSTS = ("seconds", "yardsticks", "unit_seconds")

#: Settings that tell rows of one scene, display, algorithm and viewpoint apart.
SETTING_COLUMNS = (
    "lens_model",
    "misalign",
    "fit_share",
    "viewing_distance_mm",
    "pupil_mm",
    "focus_mm",
    "luminance_cd_m2",
    "view_pixels_per_lens",
    "capture_pixels_per_pitch",
    "capture_spp",
    "eia_spp",
    "view_spp",
    "reconstruction_spp",
    "score_error",
    "seed",
)


@dataclass(frozen=True)
class Result:
    """One algorithm on one scene, display and set of settings: means over its viewpoints.

    Attributes
    ----------
    scene, display, settings, algorithm : str
    failed : bool
    scores : dict of str to float or None
        By column of the table; None where a viewpoint lacks it.
    """

    scene: str
    display: str
    settings: str
    algorithm: str
    failed: bool
    scores: dict[str, float | None]


def results_of(rows: Sequence[Row]) -> list[Result]:
    """The rows by result, in the table's order."""
    varied = varied_settings(rows)
    own = [key for m in all_metrics() for key in (m.key, m.on_relic_key)]
    columns = [*own, MAIN.to_ceiling_key, HEADLINE, *REFERENCES, *_COSTS]
    groups: dict[tuple[str, str, str, str], list[Row]] = {}
    for row in rows:
        settings = settings_of(row, varied)
        key = (str(row["scene"]), str(row["display"]), settings, str(row["algorithm"]))
        groups.setdefault(key, []).append(row)
    return [
        Result(
            *key,
            any(row["status"] != "ok" for row in group),
            {name: mean(row.get(name) for row in group) for name in columns},
        )
        for key, group in groups.items()
    ]


def varied_settings(rows: Sequence[Row]) -> list[str]:
    """Settings that the study varies: of which one scene and display has several values."""
    values: dict[tuple[Any, Any, str], set[Any]] = {}
    for row in rows:
        for name in SETTING_COLUMNS:
            if name in row:
                values.setdefault((row["scene"], row["display"], name), set()).add(row[name])
    return [
        n
        for n in SETTING_COLUMNS
        if any(len(v) > 1 for (_, _, name), v in values.items() if name == n)
    ]


def settings_of(row: Row, varied: Iterable[str]) -> str:
    """The varied settings of a row, as text; empty where nothing varies."""
    return ", ".join(f"{name} = {row.get(name)}" for name in varied)


def names_of(results: Sequence[Result], field: str) -> list[str]:
    """The values of a field, each once, in order."""
    return list(dict.fromkeys(getattr(result, field) for result in results))


def mean(values: Iterable[Any]) -> float | None:
    """The arithmetic mean; None of nothing, or where a value is missing or not finite."""
    known = list(values)
    if not known or not all(is_number(v) and math.isfinite(v) for v in known):
        return None
    return math.fsum(known) / len(known)
