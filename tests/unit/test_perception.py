"""Metrics of perception: how a picture is seen reaches them, and JOD is the package's own."""

import json
import sys

import numpy as np
import pytest

from inim import metrics
from inim.display import DISPLAYS
from inim.display.viewpoint import Viewpoint
from inim.documents.report import ReportDocument
from inim.errors import UsageError
from inim.image.color import linear_from_srgb, srgb_from_linear
from inim.image.noisy_image import NoisyImage
from inim.metrics import Metric, Viewing, cvvdp
from inim.pipeline.stages.reconstruction import Optics
from inim.regression.scores import view_scores
from inim.report.labels import disagreements
from tests.schemas import report_document

SEEN = Viewing(30.0, 400.0)
installed = pytest.mark.skipif(
    not cvvdp.is_installed(), reason="needs pip install 'inim[perception]': make test-perception"
)


def pictures(seed: int, rows: int = 40, columns: int = 48) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    return tuple(rng.random((rows, columns, 3)).astype(np.float32) for _ in range(3))


def test_a_degree_has_as_many_pixels_as_fit_into_it():
    """573 mm away, a hundredth of a millimetre short of it, a degree is a centimetre wide."""
    assert Viewing.of(0.25, (0, 0, 572.9578), 500).pixels_per_degree == pytest.approx(40, rel=1e-4)
    pixel_offset = Viewing.of(0.25, (300, 0, 400), 500)
    assert pixel_offset.pixels_per_degree == pytest.approx(40 * 500 / 572.9578, rel=1e-4)


def test_a_view_s_pixels_are_on_the_array():
    display = DISPLAYS["nominal"]
    optics = Optics(display, "thick", 4, 8, 0)
    viewing = optics.viewing_conditions(Viewpoint("eye", 0, 0, 572.9578), 123.0)
    assert viewing.pixels_per_degree == pytest.approx(10 / (display.pitch_mm / 4), rel=1e-4)
    assert viewing.luminance_cd_m2 == 123.0


def test_metrics_of_viewing_score_views_only(announce):
    arguments = []

    def score(reference: np.ndarray, test: np.ndarray, viewing: Viewing) -> float:
        arguments.append(viewing)
        return viewing.pixels_per_degree * viewing.luminance_cd_m2

    announce(seen=Metric("seen", score, needs_viewing=True, tolerance=1, range=(0, np.inf)))
    a, b, _ = pictures(1)
    assert "seen" not in metrics.score(a, b)
    assert "seen" not in metrics.eia_scores(a, b)
    assert metrics.score(a, b, viewing=SEEN)["seen"] == 12000
    assert arguments == [SEEN]


@pytest.mark.parametrize(("slow", "evaluations"), [(False, 1 + 8 * 4), (True, 1 + 2 * 4)])
def test_the_error_of_a_slow_metric_is_estimated_from_few_evaluations(announce, slow, evaluations):
    calls = []

    def score(reference: np.ndarray, test: np.ndarray, viewing: Viewing) -> float:
        calls.append(viewing)
        return float(np.abs(reference - test).mean())

    announce(
        seen=Metric("seen", score, needs_viewing=True, is_slow=slow, better="lower", tolerance=1)
    )
    a, b, noise = pictures(2)
    noise = 0.02 * (noise - 0.5)
    scores = view_scores(NoisyImage.from_image(a), NoisyImage.from_image(b, noise), viewing=SEEN)[
        "seen"
    ]
    assert calls == [SEEN] * evaluations
    assert scores.freedom == (evaluations - 1) / 4
    assert 0 < scores.error < 0.01


def test_a_heat_map_gets_its_viewing_conditions_and_scale(announce):
    def lost(reference: np.ndarray, test: np.ndarray, viewing: Viewing) -> np.ndarray:
        return viewing.pixels_per_degree * np.abs(reference - test).mean(axis=-1)

    maps = {"heat_map": lost, "heat_map_max": 3.0}
    metric = Metric("seen", lost, needs_viewing=True, tolerance=1, range=(0, 99), **maps)
    a, b, _ = pictures(3)
    expected = 10 * np.abs(srgb_from_linear(a) - srgb_from_linear(b)).mean(axis=-1)
    np.testing.assert_allclose(metrics.heat_map(metric, a, b, SEEN), expected, rtol=1e-5)


def test_a_heat_map_of_another_package_that_fails_is_one_line_that_names_it(announce):
    def score(reference: np.ndarray, test: np.ndarray) -> float:
        return 1.0

    a, b, _ = pictures(3)
    for heat_map, why in (
        (lambda *_: 1 / 0, r"metric 'hot' failed: ZeroDivisionError"),
        (lambda *_: np.zeros(3), r"metric 'hot' failed: ValueError: .* shape \(3,\)"),
    ):
        announce(hot=Metric("hot", score, tolerance=1, heat_map=heat_map))
        with pytest.raises(UsageError, match=why):
            metrics.heat_map(metrics.find("hot"), a, b, None)
        metrics._all_metrics.cache_clear()


def test_more_pixels_per_degree_than_the_model_has_bands_warns():
    with pytest.raises(UsageError, match=r"2.094e\+04 pixels per degree .* lower inim\.view"):
        cvvdp._model(Viewing(20944.0, 500.0))


def test_a_viewed_metric_of_eias_is_refused():
    with pytest.raises(UsageError, match="with needs_viewing"):
        Metric("seen", lambda *_: 1.0, needs_viewing=True, has_eia_score=True, tolerance=1)


def results(**psnr_db: float) -> ReportDocument:
    """A report in which SSIM falls from one algorithm to the next."""
    views = {
        name: {
            "ssim_on_relic_to_reference": 0.9 - 0.1 * n,
            "psnr_on_relic_to_reference_db": value,
            "flip_on_relic_to_reference": 0.1 + 0.1 * n,
        }
        for n, (name, value) in enumerate(psnr_db.items())
    }
    algorithms = {name: {"views": {"centre": scores}} for name, scores in views.items()}
    return report_document({"viewpoints": [{"name": "centre"}], "algorithms": algorithms})


def test_a_metric_that_prefers_another_algorithm_is_named(announce):
    announce()
    assert disagreements(results(first=30.0, second=25.0)) == []
    (warning,) = disagreements(results(first=25.0, second=30.0))
    assert warning.startswith("PSNR disagrees: it prefers second to first, with 30.00")
    within_its_tolerance = results(first=25.0, second=25.0 + 1e-3)
    assert disagreements(within_its_tolerance) == []


def test_without_the_package_a_film_names_the_install_command(monkeypatch):
    monkeypatch.setitem(sys.modules, "pycvvdp", None)
    cvvdp._packages.cache_clear()
    a = pictures(4)[0]
    with pytest.raises(UsageError, match=r"pip install 'inim\[perception\]'"):
        cvvdp.film_jod([a], [a], Viewing(1.0, 1.0), 10)


@installed
@pytest.mark.parametrize(("noise", "ppd", "luminance"), [(0.02, 30, 400), (0.2, 60, 100)])
def test_jod_is_the_package_s_own_of_codes_on_a_display_in_its_words(
    tmp_path, noise, ppd, luminance
):
    import pycvvdp
    import torch

    rng = np.random.default_rng(5)
    reference = np.kron(rng.integers(40, 220, (8, 10, 3)), np.ones((12, 12, 1))).astype(np.uint8)
    test = reference + 255 * noise * rng.standard_normal(reference.shape)
    test = np.clip(test, 0, 255).astype(np.uint8)
    display = {
        "mine": {
            "name": "as inim's", "resolution": [120, 96], "pixels_per_degree": ppd,
            "max_luminance": luminance, "contrast": 1000, "E_ambient": 0, "source": "none",
        }
    }  # fmt: skip
    models = tmp_path / "display_models.json"
    models.write_text(json.dumps(display))
    theirs = pycvvdp.cvvdp(
        "mine", config_paths=[str(models)], device=torch.device("cpu"), quiet=True
    )
    expected, _ = theirs.predict(test, reference, dim_order="HWC")
    linear = [linear_from_srgb(codes.astype(np.float32) / 255) for codes in (reference, test)]
    scores = metrics.score(*linear, viewing=Viewing(ppd, luminance))["cvvdp_jod"]
    assert 3 < float(expected) < 9.9
    assert scores == pytest.approx(float(expected), abs=1e-3)


@installed
def test_equal_pictures_are_ten_and_more_noise_is_less(tmp_path):
    a, _, noise = pictures(6)
    scores = [
        metrics.score(a, np.clip(a + by * (noise - 0.5), 0, 1), viewing=SEEN)["cvvdp_jod"]
        for by in (0.0, 0.1, 0.4)
    ]
    assert scores[0] == 10.0
    assert 10 > scores[1] > scores[2]


@installed
def test_a_flicker_that_no_frame_shows_alone_counts_in_a_film():
    """Frames brighter and darker in turn than those of the reference, against all too bright."""
    still = np.full((32, 32, 3), 128, np.uint8)
    steady = [still + 8] * 16
    flicker = [still + 8, still - 8] * 8
    reference = [still] * 16
    jod = [cvvdp.film_jod(reference, film, SEEN, 16) for film in (steady, flicker)]
    assert jod[1] < jod[0] - 0.5
