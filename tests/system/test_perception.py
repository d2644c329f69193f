"""A metric of perception is in every result, its conditions those of the display and the eye."""

from math import inf
from pathlib import Path

import numpy as np
import pytest

from inim.scores import metrics
from inim.scores.metrics import Metric, Viewing
from tests.schemas import read_document
from tests.system.conftest import TINY, definitions, run_here, write_scene

SEEN: list[Viewing] = []


def score(reference: np.ndarray, test: np.ndarray, viewing: Viewing) -> float:
    SEEN.append(viewing)
    return 10 - 10 * float(np.abs(test - reference).mean())


@pytest.fixture(scope="module", autouse=True)
def package():
    """A metric of another package."""
    metric = Metric(
        "seen", score, unit="JOD", digits=2, range=(-inf, 10), tolerance=0.05,
        settings={"ambient_lux": 0}, needs_viewing=True,
    )  # fmt: skip
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("inim.scores.metrics.announced_names", lambda group: ["seen"])
        patch.setattr("inim.scores.metrics.load", lambda group, name, kind: metric)
        patch.setattr("inim.scores.metrics.identity", lambda group, name: {"version": "1"})
        metrics._all_metrics.cache_clear()
        yield
    metrics._all_metrics.cache_clear()


def run(*words: object, folder: Path) -> str:
    ended = run_here(*map(str, words), folder=folder)
    assert ended.code == 0, ended.stderr
    return ended.stdout


@pytest.fixture(scope="module")
def validated(tmp_path_factory):
    folder = tmp_path_factory.mktemp("seen")
    words = ("-o", "out", "--algorithms", "template,li2012", "--viewpoints", "centre")
    options = definitions(TINY | {"inim.luminance_cd_m2": "123"})
    run("validate", write_scene(folder), *words, *options, folder=folder)
    return folder / "out", read_document(folder / "out" / "report.json")


def test_report_has_the_score_to_scene_and_reference_with_intervals(validated):
    _, data = validated
    for result in data["algorithms"].values():
        view, precision = result["views"]["centre"], result["precision"]["centre"]
        for key in ("seen_jod", "seen_to_reference_jod"):
            low, high = precision[key]["interval"]
            assert low <= view[key] <= high
            assert view[key] < 10
    assert data["reference"]["views"]["centre"]["seen_jod"] < 10
    assert data["noise_floor"]["views"]["centre"]["seen_jod"] <= 10
    assert data["scoring"]["metrics"]["seen"]["arguments"]["ambient_lux"] == 0


def test_viewing_conditions_are_those_of_the_display_from_the_eye(validated):
    _, data = validated
    (position,) = (viewpoint["position_mm"] for viewpoint in data["viewpoints"])
    pixel = data["display"]["parameters"]["pitch_mm"] / data["settings"]["view_pixels_per_lens"]
    degree = 2 * np.linalg.norm(position) * np.tan(np.radians(0.5))
    assert {viewpoint.luminance_cd_m2 for viewpoint in SEEN} == {123.0}
    assert {round(viewpoint.pixels_per_degree, 6) for viewpoint in SEEN} == {
        round(degree / pixel, 6)
    }
