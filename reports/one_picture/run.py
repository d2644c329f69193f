"""Compare the algorithms of one picture with equal rays and colours, on many relics.

    python -m reports.one_picture.run scenes/*.xml MORE.xml ... -o reports/one_picture

Each scene is evaluated from three viewpoints with the usual samples. `inim new-scene` makes a
scene from a scanned relic. Scores of views are those on the relic, without noise, with 95 %
intervals. The interval of a mean over viewpoints has their mean ends.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import product
from pathlib import Path
from statistics import fmean
from typing import Any, NamedTuple

from inim.pipeline.job import setup
from inim.pipeline.plan import make_plan
from inim.pipeline.request import Request
from inim.pipeline.stages.scoring import compute_noise_floor
from inim.pipeline.validate import evaluate
from inim.report.labels import number
from inim.report.study import PagePart, Table
from inim.scores.metrics import HEADLINE, HEADLINE_TO_SCENE
from inim.scores.regression.scores import difference
from inim.system.process.observer import Observer
from reports.study import Results, Study, add_scenes, entry, table

#: Rays per panel pixel and their colours, equal for all algorithms of a comparison.
TERMS = {
    "one ray, nearest": "samples=1:colour=nearest",
    "one ray, smooth": "samples=1:colour=smooth",
    "four rays, smooth": "samples=4:colour=smooth",
}
_TEMPLATE = "template"
_RIVALS = ("wang2024", "wang2024:matching=ray", "gu2020", "li2012")
#: Algorithms of more than one picture.
_MORE_PICTURES = ("cameras:views=5", "layered")
_AREAS = {"centre": ("centre",), "sides": ("right", "up")}  # Viewpoints of each mean.
_SSIM = "SSIM to the reference"
_TO_TRUTH = {
    "SSIM to the truth": HEADLINE_TO_SCENE,
    "PSNR to the truth, dB": "psnr_on_relic_db",
    "FLIP to the truth": "flip_on_relic",
}
_SCORES = {_SSIM: HEADLINE, **_TO_TRUTH}
_REFERENCE = "reference"
_EIA = "PSNR of the EIA, dB"
_FLOOR = "noise floor"
#: A score or a difference of scores, and the ends of its interval.
_Estimate = Sequence[float]


def _named(algorithm: str, terms: str) -> str:
    return f"{algorithm}:{TERMS[terms]}"


def collect_scores(scene: Path) -> dict[str, Any]:
    """Scores of a scene.

    `eia` has the PSNR by algorithm, with noise; `views` the scores by algorithm, area and score;
    `differences` those of two algorithms.
    """
    algorithms = [_named(name, terms) for terms in TERMS for name in (_TEMPLATE, *_RIVALS)]
    viewpoints = tuple(view for views in _AREAS.values() for view in views)
    plan = make_plan(Request(
        scene, Path("unused"), algorithms=(*algorithms, *_MORE_PICTURES), viewpoints=viewpoints,
        definitions={"inim.score_error": 0},
    ))  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        run, renderer, images = setup(plan, Path(folder), Observer(), data_only=True)
        evaluation = evaluate(plan, renderer, images, run)
    floor = compute_noise_floor(evaluation.truth, run=run)
    assert floor is not None
    results = evaluation.results
    scores = {f"{_REFERENCE}/{view}": s for view, s in evaluation.reference_scores.items()}
    for result in results.values():
        scores |= result.statistics.scores

    def value(name: str) -> dict[str, Any]:
        def estimate(view: str, key: str) -> _Estimate:
            score = scores[f"{name}/{view}"][key]
            return score.value, *score.interval

        return _by_area(estimate, _SCORES)

    def change(name: str, other: str) -> dict[str, Any]:
        def estimate(view: str, key: str) -> _Estimate:
            value, ends = difference(scores[f"{name}/{view}"][key], scores[f"{other}/{view}"][key])
            return value, *ends

        return _by_area(estimate, _TO_TRUTH if other == _REFERENCE else _SCORES)

    own = [_named(_TEMPLATE, terms) for terms in TERMS]
    compared = [[_named(rival, terms) for rival in _RIVALS] for terms in TERMS]
    compared[-1] += [*own[:-1], _REFERENCE]
    return {
        "eia": {name: result.scores.eia["psnr_db"] for name, result in results.items()}
        | {_FLOOR: floor.eia["psnr_db"]},
        "views": {name: value(name) for name in results},
        "differences": {
            name: {other: change(name, other) for other in others}
            for name, others in zip(own, compared, strict=True)
        },
    }


def _by_area(
    estimate: Callable[[str, str], _Estimate], keys: Mapping[str, str]
) -> dict[str, dict[str, _Estimate]]:
    """Mean estimates of the viewpoints of each area, by area and score."""
    return {
        area: {score: _mean(estimate(view, key) for view in views) for score, key in keys.items()}
        for area, views in _AREAS.items()
    }


def _mean(estimates: Iterable[_Estimate]) -> _Estimate:
    return [round(fmean(values), 5) for values in zip(*estimates, strict=True)]


class Difference(NamedTuple):
    """Score of an algorithm minus that of another on a relic."""

    relic: str
    other: str
    estimate: _Estimate

    def text(self, digits: int) -> str:
        """The difference, with its interval if it has one."""
        value, *ends = (number(v, digits) for v in self.estimate)
        return f"{value} [{', '.join(ends)}]" if ends else value

    @property
    def sign(self) -> int:
        """1 or -1; 0 if the interval contains 0."""
        low, high = self.estimate[1 % len(self.estimate)], self.estimate[-1]
        return (low > 0) - (high < 0)


def differences(
    results: Results, score: str, area: str, name: str, others: Sequence[str]
) -> list[Difference]:
    """Difference to the best of some other algorithms on each relic, the smallest first.

    PSNR of the EIA has no area and no interval.
    """
    smallest = []
    for relic, result in results.items():
        of_others = {
            other: result["differences"][name][other][area][score]
            if area
            else [result["eia"][name] - result["eia"][other]]
            for other in others
        }
        best = min(of_others, key=lambda other: of_others[other][0])
        smallest.append(Difference(relic, best.split(":samples=")[0], of_others[best]))
    return sorted(smallest, key=lambda difference: difference.estimate[0])


def leads(results: Results, score: str, area: str, terms: str) -> list[Difference]:
    """Leads of `template` over the best other algorithm of one picture, the smallest first."""
    rivals = [_named(rival, terms) for rival in _RIVALS]
    return differences(results, score, area, _named(_TEMPLATE, terms), rivals)


# Scores of the comparison, with the area of their views.
_COMPARED = [(_EIA, ""), *product([*_SCORES][:2], _AREAS)]
*_OTHER_TERMS, _DEFAULT = (_named(_TEMPLATE, terms) for terms in TERMS)


def page(results: Results) -> tuple[list[str], list[PagePart]]:
    """Leads and scores on equal terms, the terms of `template`, more pictures."""
    remarks = [
        "A lead is the score of `template` minus that of the best other algorithm of one picture, "
        "chosen for each relic and score, with equal rays and colours.",
        "Relics count as above or below if the interval of their difference does not contain 0.",
        "PSNR of an EIA includes the noise of the ground truth and has no interval.",
        "In FLIP, lower is better.",
        f"Sides are the mean of the viewpoints {' and '.join(_AREAS['sides'])}.",
    ]
    all_leads = [
        ([_title(*of), terms], leads(results, *of, terms), of[0])
        for of, terms in product(_COMPARED, TERMS)
    ]
    own = [
        ([_title(score, area), other], differences(results, score, area, _DEFAULT, [other]), score)
        for score, area in product(_SCORES, _AREAS)
        for other in [*_OTHER_TERMS, *([_REFERENCE] if score in _TO_TRUTH else [])]
    ]
    heads = ["score", "rays and colours"]
    parts = {
        "Leads of template": [_summary("Leads of template", heads, all_leads)],
        "Mean of all relics; worst relic": [_scores(results, *of) for of in _COMPARED],
        "Leads by relic": [_leads(results, *of) for of in _COMPARED],
        "Rays and colours of template": [
            _summary(f"{_DEFAULT} minus another", ["score", "other"], own),
            _default_by_relic(results),
        ],
        "More pictures": [_more_pictures(results)],
    }
    return remarks, [
        PagePart(title.split()[0].lower() + str(n), title, "", tables)
        for n, (title, tables) in enumerate(parts.items())
    ]


def _digits(score: str) -> int:
    return 1 if score == _EIA else 2 if "dB" in score else 3


def _title(score: str, area: str) -> str:
    return f"{score}, {area}" if area else score


def _summary(
    caption: str, heads: Sequence[str], rows: Iterable[tuple[list[str], list[Difference], str]]
) -> Table:
    """Mean, smallest and largest of differences, and their signs."""
    cells = []
    for names, of_relics, score in rows:
        digits = _digits(score)
        mean = number(fmean(d.estimate[0] for d in of_relics), digits)
        ends = [f"{d.text(digits)} ({d.relic})" for d in (of_relics[0], of_relics[-1])]
        signs = [d.sign for d in of_relics]
        cells.append([*names, mean, *ends, *(str(signs.count(sign)) for sign in (1, 0, -1))])
    columns = ["mean", "smallest", "largest", "relics above", "not distinguished", "below"]
    return Table(caption, [*heads, *columns], cells)


def _scores(results: Results, score: str, area: str) -> Table:
    """Mean of all relics and worst relic of each algorithm, with each of the terms."""

    def cell(algorithm: str) -> str:
        of_relics = {
            relic: result["views"][algorithm][area][score][0] if area else result["eia"][algorithm]
            for relic, result in results.items()
        }
        worst = min(of_relics, key=lambda relic: of_relics[relic])
        values = fmean(of_relics.values()), of_relics[worst]
        mean, least = (number(value, _digits(score)) for value in values)
        return f"{mean}; {least} ({worst})"

    rows = [[name, *(cell(_named(name, t)) for t in TERMS)] for name in (_TEMPLATE, *_RIVALS)]
    return Table(f"{_title(score, area)}: mean; worst relic", ["algorithm", *TERMS], rows)


def _leads(results: Results, score: str, area: str) -> Table:
    """Lead on each relic and best other algorithm, the smallest of the default terms first."""
    by_terms = [{d.relic: d for d in leads(results, score, area, terms)} for terms in TERMS]
    rows = [
        [relic, *(f"{of[relic].text(_digits(score))} {of[relic].other}" for of in by_terms)]
        for relic in by_terms[-1]
    ]
    return Table(f"Lead in {_title(score, area)}, and best other", ["relic", *TERMS], rows)


def _default_by_relic(results: Results) -> Table:
    """Default terms minus one smooth ray, to the truth."""
    other = _OTHER_TERMS[-1]
    compared = [*product(_TO_TRUTH, _AREAS)]
    columns = [
        {
            d.relic: d.text(_digits(score))
            for d in differences(results, score, area, _DEFAULT, [other])
        }
        for score, area in compared
    ]
    rows = [[relic, *(texts[relic] for texts in columns)] for relic in columns[0]]
    heads = ["relic", *(_title(score, area) for score, area in compared)]
    return Table(f"{_DEFAULT} minus {other}", heads, rows)


def _more_pictures(results: Results) -> Table:
    """PSNR of the EIA from one picture, from five, and from layers."""
    columns = [_DEFAULT, *_MORE_PICTURES, _FLOOR]
    order = differences(results, _EIA, "", _DEFAULT, _MORE_PICTURES[-1:])
    cells = {name: entry("eia", name, text=lambda v: number(v, 1)) for name in columns}
    rows = [{"relic": d.relic, **results[d.relic]} for d in order]
    return table(_EIA, rows, {"relic": entry("relic"), **cells})


STUDY = Study(
    "reports.one_picture.run", "Algorithms of one picture with equal rays and colours", __doc__,
    add_scenes, lambda args: {s.stem: {"scene": s} for s in args.scenes}, collect_scores, page,
)  # fmt: skip

if __name__ == "__main__":
    sys.exit(STUDY.main())
