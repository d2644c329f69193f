"""Metrics of perception: the viewing conditions reach them."""

import numpy as np
import pytest

from inim.display import DISPLAYS
from inim.display.viewpoint import Viewpoint
from inim.pipeline.stages.reconstruction import Optics
from inim.report.document import ReportDocument
from inim.report.labels import disagreements
from inim.scores import metrics
from inim.scores.metrics import Metric, Viewing
from inim.system.errors import UsageError
from tests.schemas import report_document

SEEN = Viewing(30.0, 400.0)


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
