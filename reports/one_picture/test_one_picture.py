"""Leads are over the best other algorithm, and count only outside their interval."""

import pytest

from reports.one_picture.run import TERMS, Difference, leads

TERM = "one ray, smooth"
RIVALS = ("wang2024", "wang2024:matching=ray", "gu2020", "li2012")


def relic(*lead_over_rivals):
    """Results with leads of `template` in one score, over the rivals in this order."""
    names = [f"{name}:{TERMS[TERM]}" for name in ("template", *RIVALS)]
    differences = {
        name: {"centre": {"SSIM to the truth": [lead, lead - 0.01, lead + 0.01]}}
        for name, lead in zip(names[1:], lead_over_rivals, strict=True)
    }
    eia = {name: 30 - lead for name, lead in zip(names, (0, *lead_over_rivals), strict=True)}
    return {"differences": {names[0]: differences}, "eia": eia}


@pytest.mark.parametrize(("score", "area"), [("SSIM to the truth", "centre"),
                                             ("PSNR of the EIA, dB", "")])  # fmt: skip
def test_a_lead_is_over_the_best_rival_of_each_relic_and_the_smallest_comes_first(score, area):
    results = {"vase": relic(0.3, 0.2, 0.1, 0.4), "bust": relic(0.3, -0.05, 0.2, 0.4)}
    bust, vase = leads(results, score, area, TERM)
    assert (bust.relic, bust.other, vase.relic, vase.other) == (
        "bust", "wang2024:matching=ray", "vase", "gu2020"
    )  # fmt: skip
    assert (bust.estimate[0], vase.estimate[0]) == pytest.approx((-0.05, 0.1))


@pytest.mark.parametrize(
    ("estimate", "sign"),
    [([0.01, -0.001, 0.02], 0), ([0.01, 0.001, 0.02], 1), ([-0.01, -0.02, -0.001], -1),
     ([0.1], 1), ([-0.1], -1)],
)  # fmt: skip
def test_a_difference_has_a_sign_only_if_its_interval_excludes_zero(estimate, sign):
    assert Difference("vase", "gu2020", estimate).sign == sign
