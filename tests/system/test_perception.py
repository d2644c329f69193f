"""A metric of perception is in every result, its conditions those of the display and the eye.

Expected: the same keys, tables and pages with the package, and with what stands in for it here.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from inim import metrics
from inim.files.picture import open_picture
from inim.metrics import Viewing, cvvdp
from inim.sweeps.table import columns
from tests.schemas import read_document
from tests.system.conftest import (
    TINY,
    assert_refused,
    definitions,
    run_here,
    without_pauses,
    write_scene,
)

SEEN: list[Viewing] = []


@pytest.fixture(scope="module", autouse=True)
def package():
    """Something that scores as ColorVideoVDP does, where that is not installed."""

    class Found:
        """Stand-in for the used part of a tensor."""

        def __init__(self, values: np.ndarray) -> None:
            self.values = values

        def __getitem__(self, _: object) -> Found:
            return self

        def float(self) -> Found:
            return self

        def numpy(self) -> np.ndarray:
            return self.values

    def predicted(model: Any, test: np.ndarray, reference: np.ndarray, **_: Any) -> Any:
        lost = np.abs(test - reference).mean(axis=-1)
        return 10 - 10 * lost.mean(), {"heatmap": Found(lost)}

    installed, kept_model = cvvdp.is_installed(), cvvdp._model

    def model(viewing: Viewing, heat_map: str | None = None) -> Any:
        SEEN.append(viewing)
        return kept_model(viewing, heat_map) if installed else None

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cvvdp, "_model", model)
        if not installed:
            patch.setattr(cvvdp, "is_installed", lambda: True)
            patch.setattr(cvvdp, "_predict", predicted)
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


def test_report_has_jod_to_scene_and_reference_with_intervals(validated):
    _, data = validated
    for result in data["algorithms"].values():
        view, precision = result["views"]["centre"], result["precision"]["centre"]
        for key in ("cvvdp_jod", "cvvdp_to_reference_jod"):
            low, high = precision[key]["interval"]
            assert low <= view[key] <= high
            assert view[key] < 10
    assert data["reference"]["views"]["centre"]["cvvdp_jod"] < 10
    assert data["noise_floor"]["views"]["centre"]["cvvdp_jod"] <= 10
    assert data["scoring"]["metrics"]["cvvdp"]["arguments"]["ambient_lux"] == 0


def test_viewing_conditions_are_those_of_the_display_from_the_eye(validated):
    _, data = validated
    (position,) = (viewpoint["position_mm"] for viewpoint in data["viewpoints"])
    pixel = data["display"]["parameters"]["pitch_mm"] / data["settings"]["view_pixels_per_lens"]
    degree = 2 * np.linalg.norm(position) * np.tan(np.radians(0.5))
    assert {viewpoint.luminance_cd_m2 for viewpoint in SEEN} == {123.0}
    assert {round(viewpoint.pixels_per_degree, 6) for viewpoint in SEEN} == {
        round(degree / pixel, 6)
    }


def test_page_and_files_show_it(validated):
    out, data = validated
    page = (out / "report.html").read_text("utf-8")
    assert "CVVDP&#x27;s map shows the local loss" in page
    for name, run in data["algorithms"].items():
        jod = run["views"]["centre"]["cvvdp_to_reference_jod"]
        assert f"<dd>CVVDP <b>{jod:.2f}\N{NO-BREAK SPACE}JOD</b></dd>" in page
        file = f"maps/cvvdp/{name}/centre.png"
        assert file in data["files"]
        with open_picture(out / file, ("PNG",), 1) as picture:
            assert np.asarray(picture).std() > 1


def test_baseline_sweep_s_table_and_bench_have_it(validated, tmp_path):
    out, _ = validated
    run("compare", out, out, "-o", "same", folder=tmp_path)
    checks = read_document(tmp_path / "same" / "compare.json")["verdict"]["checks"]
    assert any(check["name"].startswith("template/centre: CVVDP to reference") for check in checks)
    assert "CVVDP" in (tmp_path / "same" / "junit.xml").read_text("utf-8")

    assert {"cvvdp_jod", "cvvdp_to_reference_jod", "luminance_cd_m2"} <= columns().keys()

    scene = write_scene(tmp_path).name
    words = ("-o", "timed", "--algorithms", "template", "--runs", "3", "--threads", "1")
    with without_pauses():
        run("bench", scene, *words, *definitions(TINY), folder=tmp_path)
    (row,) = read_document(tmp_path / "timed" / "bench.json")["scene"]["algorithms"]
    assert row["scores"]["view_cvvdp_to_reference_jod"] < 10
    assert "view CVVDP to reference" in (tmp_path / "timed" / "bench.html").read_text("utf-8")


def test_film_is_scored_against_the_scene_that_it_names(validated, tmp_path):
    out, _ = validated
    words = ("film", out, "-o", tmp_path / "film.webp", "--frames", "4", "--view-spp", "4")
    scene = out.parent / "tiny.xml"
    output = run(*words, "--scene", scene, "--algorithms", "template", folder=tmp_path)
    assert "template: " in output
    assert "JOD as a film, at " in output
    assert "123 cd/m^2" in output

    other = tmp_path / "other.xml"
    other.write_text(scene.read_text() + "<!-- another one -->\n")
    says = ["other.xml: differs from the report's scene"]
    assert_refused(*words, "--scene", other, folder=tmp_path, says=says)
