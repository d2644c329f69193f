"""The study of the paper's experiments: growth, claims, and their page."""

import math

import pytest

from inim.apps.bench.page import milliseconds
from inim.pipeline.timing import Rounds
from inim.report.labels import per_cent
from reports.bench.paper.claims import claims
from reports.bench.paper.experiments import Sizes, bench_paper
from reports.bench.paper.page import page
from reports.bench.paper.scaling import bench_scaling, power_law
from reports.bench.paper.steps import depth_steps
from reports.bench.study import times
from tests.unit.test_bench_report import method, timing


def paper_results():
    def point(size):
        ms = {"gu2020 in plain Python": 6000.0, "wang2024 in plain Python": 3000.0,
              "gu2020": 9.0, "wang2024": 3.0, "template": 1.5}  # fmt: skip
        methods = [method(n, size * v) for n, v in ms.items()]
        sizes = {"scene_pixels": 100 * size, "lenses": size, "elemental_pixels": 289 * size}
        return {**sizes, "yardstick": timing(1.0), "algorithms": methods}

    experiments = [
        {
            "name": size,
            "figure": "Fig. 12",
            "kept": "x",
            "size": size,
            "points": [point(1), point(4)],
        }
        for size in ("scene_pixels", "lenses", "elemental_pixels")
    ]
    last = [{**c, "middle_view_ssim": 0.5, "published_ssim": None} for c in point(1)["algorithms"]]
    last[1] |= {"wrong_source": 0.4, "eia_psnr_db": 20.0}
    same = {
        "lenses": 4, "display_pixels": 100, "scene_pixels": 50, "reference_ssim": 0.9,
        "yardstick": timing(1.0), "algorithms": last,
    }  # fmt: skip
    paper = {"experiments": experiments, "same_input": same, "steps": depth_steps()}
    paper["claims"] = claims(experiments, same, paper["steps"])
    paper["readings"] = [
        {"scene": scene, "name": f"wang2024:matching={matching}{option}", "changed": 0.02,
         "hole_fraction": 0.5, "eia_psnr_db": 21.0}
        for scene in ("jade", "tripod")
        for matching in ("matrix", "ray")
        for option in ("", ":rounding=up")
    ]  # fmt: skip
    return paper


def paper_tables(monkeypatch):
    monkeypatch.setattr("reports.bench.paper.page._scaling_tables", lambda _: [])
    monkeypatch.setattr("reports.bench.paper.page._draw_scaling", lambda _: None)
    memory = {"lenses": 1, "above_import_bytes": 1, "limit_bytes": 2}
    return page({"scaling": {"memory": memory}, "paper": paper_results()})[1][1].tables


def test_every_reading_is_a_row_of_its_scene_and_matching(monkeypatch):
    tables = paper_tables(monkeypatch)
    table = next(table for table in tables if "Other readings" in table.caption)
    assert [row[0] for row in table.rows] == [
        "jade, matrix", "jade, ray", "tripod, matrix", "tripod, ray",
    ]  # fmt: skip
    assert table.heads[1:] == [
        "as printed, EIA PSNR dB", "rounding=up, other sources", "rounding=up, EIA PSNR dB",
    ]  # fmt: skip
    assert table.rows[0][1:] == ["21.00", per_cent(0.02, 3), "21.00"]


def test_steps_keep_the_paper_s_bounds_only_off_the_centre_of_odd_lenses():
    """P_I g / |x0 - x| in closed form: offsets of 1 to 8, and of 0.5 to 7.5 panel pixels."""
    odd, even, phone = depth_steps()
    assert odd["lower_mm"] == pytest.approx(2 * 3.3 * (10 / 17) / 1)
    assert [odd[k] for k in ("least_mm", "most_mm")] == pytest.approx([33 / 8, 33])
    assert (odd["beyond"], odd["endless"]) == (3, 3)
    assert [even[k] for k in ("least_mm", "most_mm")] == pytest.approx([33 / 7.5, 66])
    assert (even["beyond"], even["endless"]) == (2 * 3, 0)
    assert phone["lower_mm"] <= phone["least_mm"]
    assert phone["beyond"] > 0
    lower, upper = (
        next(c for c in paper_results()["claims"] if f"at {bound}" in c["claim"])
        for bound in ("least 2 g", "most g P_I")
    )
    assert lower["holds"] is True
    assert upper["holds"] is False


def test_ratios_in_the_paper_s_tables_are_those_of_the_medians(monkeypatch):
    table = paper_tables(monkeypatch)[0]
    first = dict(zip(table.heads, table.rows[0], strict=True))
    assert first["gu2020 / wang2024, Python"] == times(6000 / 3000) == "2.00 ×"
    assert first["wang2024, Python / template"] == times(3000 / 1.5) == "2000 ×"
    assert first["gu2020 / wang2024"] == times(9 / 3)
    assert first["template"] == milliseconds(1.5) == "1.50"


def test_claims_follow_the_measured_times():
    paper = paper_results()
    twice, growth, _, thousand = _by_words(paper["claims"])
    assert twice["holds"] is False  # exactly twice is not more than twice
    assert twice["why"]
    assert growth["holds"] is False  # both grow alike
    assert thousand["holds"] is True
    assert thousand["why"] == ""
    same = paper["same_input"]
    same["algorithms"][0]["median_ms"] *= 1.01
    same["algorithms"][-1]["median_ms"] *= 2.01
    twice, _, _, thousand = _by_words(claims(paper["experiments"], same, paper["steps"]))
    assert twice["holds"] is True
    assert thousand["holds"] is False


def _by_words(claims_read):
    words = ("twice as fast as gu2020", "grows slowly", "the middle view", "1000 times")
    return [next((c for c in claims_read if word in c["claim"]), None) for word in words]


def test_claims_of_speed_and_growth_cite_their_own_figures():
    paper = paper_results()

    def verdict(words):
        claims_read = claims(paper["experiments"], paper["same_input"], paper["steps"])
        return next(c["holds"] for c in claims_read if words in c["claim"])

    assert verdict("the fastest") is True  # gu2020 takes twice as long at all sizes
    assert verdict("elemental images") is False  # both grow alike
    _, lenses, elemental = paper["experiments"]
    elemental["points"][1]["algorithms"][0]["min_ms"] = 1.0
    assert verdict("the fastest") is False
    lenses["points"][1]["algorithms"][0]["min_ms"] *= 1.01
    assert verdict("number of elemental images") is True


def test_each_reading_of_eq_5_has_verdicts_of_its_own():
    paper = paper_results()
    names = [c["claim"] for c in paper["claims"]]
    assert not any("step_pixel" in name for name in names)  # it took no part
    for point in (paper["same_input"], *(p for e in paper["experiments"] for p in e["points"])):
        for mine in [c for c in point["algorithms"] if c["name"].startswith("wang2024")]:
            scene = {"name": mine["name"].replace("wang2024", "wang2024:step_pixel=scene")}
            fast = {key: mine[key] / 10 for key in ("median_ms", "min_ms")}
            point["algorithms"].append(mine | scene | fast)
    verdicts = {
        c["claim"]: c["holds"]
        for c in claims(paper["experiments"], paper["same_input"], paper["steps"])
    }
    assert verdicts["wang2024 is more than twice as fast as gu2020"] is False
    assert verdicts["wang2024:step_pixel=scene is more than twice as fast as gu2020"] is True


@pytest.mark.parametrize("factor", [2.0, 3.0, 0.1, 1 / 3, 7e-5])
@pytest.mark.parametrize("sizes", [(100, 400), (3, 5), (1, 2, 4, 6, 8, 10, 12)])
def test_powers_that_differ_by_rounding_only_are_equal(factor, sizes):
    """Times that are multiples of one another grow alike, however the logarithms are rounded."""
    first, other = (
        power_law([{"n": n, "min_ms": 0.9 * f * n**0.7} for n in sizes], "n") for f in (1.0, factor)
    )
    assert not first.is_below(other)
    assert not other.is_below(first)
    assert first.error < 1e-11
    slower = power_law([{"n": n, "min_ms": n**0.701} for n in sizes], "n")
    assert first.is_below(slower)


def test_error_of_a_power_is_its_standard_error():
    """Against scipy's, which takes n - 2 degrees of freedom too."""
    from scipy.stats import linregress

    points = [{"n": n, "min_ms": ms} for n, ms in ((1, 1.1), (2, 1.9), (4, 4.2), (8, 7.7))]
    expected = linregress(*([math.log(p[key]) for p in points] for key in ("n", "min_ms")))
    law = power_law(points, "n")
    assert law.power == pytest.approx(expected.slope)
    assert law.error == pytest.approx(expected.stderr)
    near = [{"n": p["n"], "min_ms": p["min_ms"] * p["n"] ** (0.5 * law.error)} for p in points]
    assert not law.is_below(power_law(near, "n"))


def test_scaling_and_paper_at_small_sizes(renderer):
    rounds = Rounds(runs=2, warmups=1)
    scaling = bench_scaling(rounds, (1, 4), (1, 3), 2)
    sizes = Sizes(2, (1, 2), (3, 5), (1, 2), 3, 2)
    paper = bench_paper(rounds, sizes)
    assert [p["display_pixels"] for p in scaling["display"]] == [17**2, 68**2]
    assert len({p["display_pixels"] for p in scaling["scene"]}) == 1
    memory = scaling["memory"]
    assert memory["imported_bytes"] + memory["eia_bytes"] < memory["peak_bytes"]
    assert [p["lenses"] for p in paper["experiments"][2]["points"]] == [1, 4]
    assert [p["elemental_pixels"] for p in paper["experiments"][1]["points"]] == [9, 25]
    forms = {c["name"]: c for c in paper["same_input"]["algorithms"]}
    for name in ("li2012", "gu2020", "wang2024"):
        # Compiled or not, it is the same algorithm.
        python, compiled = forms[f"{name} in plain Python"], forms[name]
        same = ("wrong_source", "eia_psnr_db", "middle_view_ssim")
        assert [python[k] for k in same] == [compiled[k] for k in same]
    _, parts = page({"scaling": scaling, "paper": {**paper, "readings": []}})
    assert [part.plot for part in parts] == ["scaling", "paper"]
