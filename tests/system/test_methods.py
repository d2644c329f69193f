"""Methods that are no generators of the project: files, the pickup, packages of others.

Expected: each is scored like any algorithm; what it cannot say (seconds, holes) is null; what is
wrong with it is one line that names it, before anything is rendered where that can be known.
"""

import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import inim
from inim.generators import Algorithm, SourceGenerator, algorithm_items
from inim.generators.steps import make_generator
from inim.image.color import srgb_from_linear
from inim.image.files.image import read_exr
from inim.pipeline.request import Request
from inim.pipeline.stages.generation import run_generator
from inim.pipeline.stages.method import parse_eias, parse_methods
from inim.system.errors import EXIT_CHECK_FAILED, EXIT_PASSED, EXIT_USAGE, UsageError
from tests.conftest import small_display, square
from tests.schemas import read_document
from tests.system.conftest import (
    TINY,
    Ended,
    assert_one_line,
    install_metadata,
    nothing_left,
    worker_here,
    write_scene,
)

Run = Callable[..., Ended]
EXAMPLE = Path(__file__).parents[1] / "example_package"
BRIGHT, HALF = "example", "example:brightness=0.5"
NAMES = ["template", "pickup:spp=8", BRIGHT, HALF]
FAULTY = '''
import numpy as np
from inim.system.errors import UsageError

class Faulty:
    def __init__(self, how, shape):
        self.how, self.shape = how, (*shape, 3)

    def generate(self, rgbd, out=None):
        print("generating")
        eia = np.full(self.shape, 0.5, np.float32)
        if self.how == 1:
            eia[3, 4] = np.nan
        if self.how == 2:
            eia[...] = 0
        return eia[1:] if self.how == 3 else eia

def prepare(display, shape, pixel_mm, how="well"):
    """A generator with a fault to choose."""
    if how == "raise":
        raise RuntimeError("no such\\nweights")
    if how == "leave":
        raise SystemExit(0)
    if how == "refuse":
        raise UsageError("a picture of 4 pixels is too small")
    if how == "none":
        return None
    return Faulty({"well": 0, "nan": 1, "dark": 2, "shape": 3}[how], display.eia_shape)
'''


@pytest.fixture(scope="session")
def others(tmp_path_factory):
    """Variables of a process in which the example and three bad packages are installed."""
    folder = tmp_path_factory.mktemp("site")
    project = (EXAMPLE / "pyproject.toml").read_text()
    entry_points = re.search(r'\[project\.entry-points\."inim\.generators"\]\n(.*)', project)
    assert entry_points
    install_metadata(
        folder, "inim_example", "[inim.generators]\n" + entry_points[1].replace('"', "")
    )
    install_metadata(folder, "inim_faulty", "[inim.generators]\nfaulty = faulty:prepare\n")
    install_metadata(folder, "inim_gone", "[inim.generators]\ngone = no_such_module:prepare\n")
    shutil.copy(EXAMPLE / "inim_example.py", folder)
    (folder / "faulty.py").write_text(FAULTY)
    paths = [str(folder), os.environ.get("PYTHONPATH", "")]
    return {"PYTHONPATH": os.pathsep.join(filter(None, paths))}


class Finished:
    """One run: its data, its folder and how it ended."""

    def __init__(self, ended: Ended, out: Path) -> None:
        self.ended, self.out = ended, out
        self.data: dict[str, Any] = read_document(out / "report.json")
        self.results = self.data["algorithms"]


@pytest.fixture(scope="session")
def evaluated(tmp_path_factory, run_inim, others):
    """A generator of the project, the pickup, and another's generator twice."""
    folder = tmp_path_factory.mktemp("methods")
    scene = write_scene(folder)
    words = ("--algorithms", ",".join(NAMES), "--viewpoints", "centre")
    limit = {"min_ssim_to_reference": f"{HALF}:0"}
    ended = run_inim(scene, "-o", "out", *words, folder=folder, variables=others, **limit)
    assert ended.code == EXIT_PASSED, ended.stderr
    return Finished(ended, folder / "out")


@pytest.fixture(scope="session")
def files_scored(tmp_path_factory, evaluated):
    """Folder of a report on the template's EIA again, from files, and on nothing else."""
    folder = tmp_path_factory.mktemp("files")
    rgb = np.asarray(Image.open(evaluated.out / "eia" / "template.png"))
    opaque = np.full(rgb.shape[:2], 255, np.uint8)
    opaque[: len(opaque) // 2] = 0
    Image.fromarray(np.dstack([rgb, opaque])).save(folder / "holes.PNG")
    eias = {
        "linear": evaluated.out / "eia" / "template.exr",
        "srgb": evaluated.out / "eia" / "template.png",
        "holes": folder / "holes.PNG",
    }
    parameters = {"definitions": TINY, "viewpoints": "centre", "algorithms": "none", "eias": eias}
    with worker_here():
        return inim.validate(write_scene(folder), folder / "out", **parameters).folder


# --- Finished EIAs ------------------------------------------------------------------------------


def test_finished_eia_scores_as_the_algorithm_it_came_from(evaluated, files_scored):
    """It has no seconds; holes only with alpha, where the panel is black."""
    results = read_document(files_scored / "report.json")["algorithms"]
    assert list(results) == ["linear", "srgb", "holes"]
    # Plain: the noise of a finished EIA is unknown, so its scores are not corrected for it.
    plain, linear, srgb = (
        {key: sure["plain"] for key, sure in result["precision"]["centre"].items()}
        for result in (evaluated.results["template"], results["linear"], results["srgb"])
    )
    assert linear == plain
    for key, value in plain.items():
        assert srgb[key] == pytest.approx(value, rel=0.02), key
    assert {result["seconds"] for result in results.values()} == {None}
    holes = {name: result["eia"]["hole_fraction"] for name, result in results.items()}
    assert holes == {"linear": None, "srgb": None, "holes": 0.5}
    eia = read_exr(files_scored / "eia" / "holes.exr")
    assert eia[: len(eia) // 2].max() == 0 < eia[len(eia) // 2 :].max()


def test_the_truth_against_itself_is_exactly_one(evaluated, tmp_path):
    """A copy shares the truth's noise; so does what was computed from it, if that is stated."""
    truth = evaluated.out / "truth"
    eias = {"copy": truth / "eia.exr", "coded": truth / "eia.png", "unstated": truth / "eia.png"}
    with worker_here():
        report = inim.validate(
            write_scene(tmp_path), tmp_path / "out", viewpoints="centre", algorithms="none",
            eias=eias, definitions=TINY | {"inim.shared_noise": "coded"},
        )  # fmt: skip
    scores = {name: result.views["centre"] for name, result in report.data.algorithms.items()}
    assert scores["copy"]["ssim_to_reference"] == scores["copy"]["ssim_on_relic_to_reference"] == 1
    assert scores["copy"]["flip_to_reference"] == 0
    assert scores["copy"]["ssim"] == report.data.reference.views["centre"]["ssim"]
    assert [text for text in report.data.warnings if "is a copy of the ground-truth EIA" in text]
    # Codes of 8 bits change SSIM by less than thousandths. Noise that both images have leaves no
    # trace in the plain score; otherwise it is taken for a difference.
    contained = {}
    for name in ("coded", "unstated"):
        precision = report.data.algorithms[name].precision["centre"]["ssim_on_relic_to_reference"]
        assert 0.995 < precision.plain < 1
        low, high = precision.interval
        contained[name] = low <= precision.plain <= high
    assert contained == {"coded": True, "unstated": False}


def failed_checks(out: Path) -> list[dict[str, Any]]:
    checks = read_document(out / "report.json")["verdict"]["checks"]
    return [check for check in checks if not check["passed"]]


def request(scene: Path, *eias: str, algorithms: str = "none") -> Request:
    """A request for a tiny display."""
    return Request(
        scene,
        scene.parent / "out",
        parse_eias(eias),
        definitions=TINY,
        algorithms=(algorithms if eias else "template",),
    )


@pytest.mark.parametrize(
    ("algorithms", "eias", "says"),
    [
        ("none", (), "--eia NAME=FILE"),
        ("", ("mine=a.png",), "none given"),
        ("none,template", ("mine=a.png",), "none given"),
        ("template", ("mine",), "write --eia NAME=FILE"),
        ("template", ("=a.png",), "write --eia NAME=FILE"),
        ("template", ("a/b=a.png",), "--eia name 'a/b': use 1 to 64"),
        ("template", ("..=a.png",), "--eia name '..'"),
        ("template", ("reference=a.png",), "'reference' is reserved"),
        ("wang2024", ("Template=a.png",), "'Template' is reserved"),
        ("wang2024", ("pickup=a.png",), "'pickup' is reserved"),
        ("wang2024", ("optimal=a.png",), "'optimal' is reserved"),
        ("template", ("mine=a.png", "Mine=b.png"), "EIA 'Mine' is given twice"),
        ("pickup,pickup", (), "algorithm 'pickup' is given twice"),
        ("pickup:spp=1", (), "spp must be a whole number in 2.."),
        ("pickup:spp=9999999999", (), "spp must be a whole number in 2.."),
        ("pickup:spp=x", (), "spp must be a whole number in 2.."),
        ("pickup:spp=4:spp=8", (), "option 'spp' is given twice"),
        ("pickup:samples=4", (), "'pickup' has no option 'samples'; its options are spp"),
        ("optimal:zone=33", (), "zone must be a whole number in 0..32"),
        ("optimal:spp=4", (), "'optimal' has no option 'spp'; its options are zone"),
    ],
)
def test_bad_method_is_named_with_the_fix(algorithms, eias, says):
    with pytest.raises(UsageError) as caught:
        parse_methods(algorithm_items(algorithms), parse_eias(eias))
    assert says in str(caught.value)


# --- The optimum --------------------------------------------------------------------------------


def psnr_of(views: dict[str, dict[str, float]]) -> float:
    return float(np.mean([view["psnr_db"] for view in views.values()]))


@pytest.mark.parametrize("lens_model", ["pinhole", "thick"])
def test_optimal_has_the_best_views_and_is_the_measure_of_the_others(
    tmp_path, run_inim, lens_model
):
    scene = write_scene(
        tmp_path, square((0, 0, 0), 0.6, "0.2"), square((0.3, 0.2, 0.4), 0.3, "0.8")
    )
    words = ("-o", "out", "--algorithms", "template,optimal,pickup", "--viewpoints", "centre,left")
    ended = run_inim(scene, *words, folder=tmp_path, lens_model=lens_model, view_spp=16)
    assert ended.code == EXIT_PASSED, ended.stderr
    finished = Finished(ended, tmp_path / "out")
    psnr_db = {name: psnr_of(result["views"]) for name, result in finished.results.items()}
    psnr_db["reference"] = psnr_of(finished.data["reference"]["views"])
    best = psnr_db.pop("optimal")
    assert best > max(psnr_db.values()) + 0.5
    optimal = finished.results["optimal"]
    assert optimal["seconds"] > 0
    assert optimal["eia"]["hole_fraction"] is None
    codes = 255 * srgb_from_linear(read_exr(finished.out / "eia" / "optimal.exr"))
    assert np.abs(codes - np.rint(codes)).max() < 2e-3, "8 bits"
    share = f"template {100 * 10 ** ((psnr_db['template'] - best) / 20):.0f}"
    line = next(x for x in ended.stdout.splitlines() if "share of what is possible: " in x)
    assert share in line.replace("\N{NO-BREAK SPACE}", " ")
    assert "share of what is possible" in (finished.out / "summary.md").read_text()
    assert "of what is possible" in (finished.out / "report.html").read_text()
    assert not [text for text in finished.data["warnings"] if text.startswith("optimal/")]


# --- The pickup ---------------------------------------------------------------------------------


def test_pickup_is_a_ground_truth_of_its_own(evaluated):
    """Its noise is its own: not the truth again, yet nearer to it than one half to the other.

    The truth has two samples a pixel, the pickup eight.
    """
    pickup, floor = evaluated.results["pickup:spp=8"], evaluated.data["noise_floor"]
    assert floor["eia"]["psnr_db"] < pickup["eia"]["psnr_db"] < 60
    assert pickup["eia"]["ssim"] > evaluated.results["template"]["eia"]["ssim"]
    eia, truth = (read_exr(evaluated.out / p) for p in ("eia/pickup:spp=8.exr", "truth/eia.exr"))
    assert not np.array_equal(eia, truth)
    assert pickup["seconds"] > 0


# --- Generators of other packages ---------------------------------------------------------------


def test_generator_of_another_package_is_scored_with_its_options(evaluated):
    assert list(evaluated.results) == NAMES
    bright, half = (read_exr(evaluated.out / "eia" / f"{name}.exr") for name in (BRIGHT, HALF))
    assert bright.max() > 0.1
    assert np.array_equal(half, bright * np.float32(0.5))
    assert evaluated.results[HALF]["seconds"] > 0
    assert evaluated.results[HALF]["eia"]["hole_fraction"] is None


@pytest.mark.parametrize(
    ("algorithm", "says"),
    [
        ("example:contrast=2", "'example' has no option 'contrast'; its options are brightness"),
        ("example:brightness=a/b", "cannot be part of file names"),
        ("example:brightness=much", "'example:brightness=much' of package "),
        ("faulty:how=raise", "failed: RuntimeError: no such weights ("),
        ("faulty:how=leave", "failed: SystemExit: 0 ("),
        ("faulty:how=badly", "failed: KeyError: 'badly' ("),
        ("faulty:how=refuse", "a picture of 4 pixels"),
        ("faulty:how=none", "'faulty' returned a NoneType, which cannot generate"),
        ("faulty:how=shape", "the result is float32 (101, 136, 3); this"),
        ("gone", "'gone' (no_such_module:prepare) cannot be loaded: ModuleNotFoundError"),
    ],
)
def test_fault_of_another_s_generator_is_one_line_that_names_it(
    tiny_scene, run_inim, run_process, others, algorithm, says
):
    words = ("-o", "out", "--algorithms", algorithm, "--viewpoints", "centre")
    # After rendering, threads are at work that only the worker's end stops.
    run = run_process if algorithm == "faulty:how=shape" else run_inim
    ended = run(tiny_scene, *words, folder=tiny_scene.parent, variables=others)
    assert (ended.code, ended.stdout.removeprefix("generating\n")) == (EXIT_USAGE, "")
    assert_one_line(ended.stderr, [f"algorithm '{algorithm.partition(':')[0]}", says])
    assert ended.stderr.count("algorithm '") == 1
    assert nothing_left(tiny_scene.parent)
    assert not (tiny_scene.parent / "out").exists()


def test_pictures_that_cannot_be_scored_fail_a_check(tiny_scene, run_inim, others):
    flaws = {"faulty:how=nan": "pixels not finite", "faulty:how=dark": "brightest value"}
    words = ("-o", "out", "--algorithms", ",".join(flaws), "--viewpoints", "centre")
    ended = run_inim(tiny_scene, *words, folder=tiny_scene.parent, variables=others)
    assert (ended.code, ended.stderr) == (EXIT_CHECK_FAILED, "")
    *lines, verdict = ended.stdout.splitlines()
    failed = [check["name"] for check in failed_checks(tiny_scene.parent / "out")]
    assert len(failed) == len(flaws)
    for name, check in flaws.items():
        assert any(line.startswith(f"{name} ") for line in lines)
        assert any(line.startswith("failed: ") and f"{name}: {check}: " in line for line in lines)
        assert any(f"{name}: {check}" in failure for failure in failed)
    assert verdict.startswith("failed; report: ")


class Wrong:
    """A generator that hands back what it was given."""

    def __init__(self, output: object) -> None:
        self.output = output

    def generate(self, rgbd: inim.RGBD, out: object = None) -> Any:
        return self.output


class WrongSources(SourceGenerator):
    """A generator whose sources are one number."""

    def __init__(self, display: inim.Display, source: int, kind: str) -> None:
        super().__init__(display, (4, 4), 1.0)
        self.source, self.kind = source, kind

    def find(self, rgbd: inim.RGBD) -> Any:
        return np.full(self.display.eia_shape, self.source, self.kind)


def some_picture() -> inim.RGBD:
    return inim.RGBD(np.zeros((4, 4, 3)), np.ones((4, 4)), np.ones((4, 4), bool), 1.0)


@pytest.mark.parametrize(
    ("generator", "says"),
    [
        (Wrong(None), "'x' failed: ValueError: the result is NoneType ()"),
        (Wrong(np.zeros((80, 96, 3))), "the result is float64 (80, 96, 3)"),
        (Wrong(np.zeros((80, 96, 4), np.float32)), "needs float32 (80, 96, 3)"),
        (
            WrongSources(small_display(), 16, "int32"),
            "'x': a source is 16; this picture has 0 to 15",
        ),
        (WrongSources(small_display(), 1, "float64"), "the result is float64"),
    ],
)
def test_result_of_a_generator_is_looked_at(generator, says):
    with pytest.raises(UsageError) as caught:
        display, rgbd = small_display(), some_picture()
        algorithm = Algorithm("x", lambda *_: generator, options={})
        run_generator(make_generator(algorithm, display, rgbd.shape, 1.0, None), rgbd)
    assert says in str(caught.value)


# --- What there is ------------------------------------------------------------------------------
