"""A package beside inim: one file each for an algorithm, a metric and a lens model.

Expected: what it announces is in every result.
"""

import re
import shutil
from collections.abc import Mapping
from pathlib import Path

import pytest

from inim.apps.sweep.table import TABLE, read_table
from inim.system.errors import EXIT_PASSED, EXIT_USAGE
from tests.schemas import read_document
from tests.system.conftest import (
    TINY,
    assert_one_line,
    definitions,
    install_metadata,
    run_here,
    write_scene,
)

PACKAGE = Path(__file__).parents[1] / "example_package"
SECTION = re.compile(r'\[project\.entry-points\."(inim\.\w+)"\]\n((?:.+\n)+)')
LENS = {"inim.lens_model": "vignetted"}


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Variables of commands for which the package is installed, as pip leaves it behind."""
    folder = tmp_path_factory.mktemp("site")
    for file in PACKAGE.glob("*.py"):
        shutil.copy(file, folder)
    points = SECTION.findall((PACKAGE / "pyproject.toml").read_text("utf-8"))
    assert len(points) == len(list(PACKAGE.glob("*.py")))
    entry_points = "".join(f"[{group}]\n{names}" for group, names in points)
    install_metadata(folder, "inim-example", entry_points.replace('"', ""))
    return {"PYTHONPATH": str(folder)}


def run(*words: object, folder: Path, variables: Mapping[str, str]) -> None:
    ended = run_here(*map(str, words), folder=folder, variables=variables)
    assert ended.code == EXIT_PASSED, ended.stderr


@pytest.fixture(scope="module")
def validated(tmp_path_factory, installed):
    """Its algorithm beside another, through its lenses, scored by its metric."""
    folder = tmp_path_factory.mktemp("example")
    words = ("-o", "out", "--algorithms", "template,example", "--viewpoints", "centre")
    scene = write_scene(folder)
    options = definitions(TINY | LENS)
    run("validate", scene, *words, *options, folder=folder, variables=installed)
    return folder / "out", read_document(folder / "out" / "report.json")


def test_report_has_its_algorithm_s_scores_by_its_metric(validated):
    _, data = validated
    assert [*data["algorithms"]] == ["template", "example"]
    assert data["lens_model"] == "vignetted"
    for result in data["algorithms"].values():
        scores = result["views"]["centre"]
        assert 0 < scores["mad"] < 1
        assert 0 < scores["mad_to_reference"] < 1
        assert {"ssim", "psnr_db", "flip"} < scores.keys()
    for reference in ("reference", "noise_floor"):
        assert 0 < data[reference]["views"]["centre"]["mad"] < 1
    views = {name: result["views"]["centre"] for name, result in data["algorithms"].items()}
    assert views["template"]["mad_to_reference"] < views["example"]["mad_to_reference"]


def test_baseline_judges_its_metric_by_its_own_tolerance(validated, installed, tmp_path):
    out, _ = validated
    run("compare", out, out, "-o", "same", folder=tmp_path, variables=installed)
    data = read_document(tmp_path / "same" / "compare.json")
    label = "example/centre: MAD to reference"
    (check,) = [c for c in data["verdict"]["checks"] if c["name"].startswith(label)]
    assert check["passed"]
    assert check["value"] == 0
    assert check["limit"] >= 0.002


def test_sweep_has_columns_of_its_metric(tmp_path, installed):
    scene = write_scene(tmp_path).name
    lines = [f"{key.removeprefix('inim.')} = {value}\n" for key, value in TINY.items()]
    settings = "".join(line for line in lines if "lens_" not in line)
    (tmp_path / "study.toml").write_text(
        f"[study]\nscenes = ['{scene}']\nalgorithms = ['example']\nviewpoints = 'centre'\n"
        "lens_model = 'vignetted'\n"
        f"[settings]\n{settings}"
        f"[[display]]\nname = 'small'\nlens_columns = 8\nlens_rows = 6\n"
    )
    words = ("sweep", "study.toml", "-o", "out", "--workers", "1")
    run(*words, folder=tmp_path, variables=installed)
    rows = read_table(tmp_path / "out" / TABLE)
    (row,) = rows
    expected = ("example", "vignetted", "ok")
    assert (row["algorithm"], row["lens_model"], row["status"]) == expected
    for name in ("mad", "mad_to_reference", "reference_mad", "noise_floor_mad"):
        assert 0 < row[name] < 1, name


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (
            "raise ImportError('no such\\nweights')",
            ["cannot be loaded", "no such weights; update or uninstall"],
        ),
        (
            "from inim.scores.metrics import Metric\n"
            "metric = Metric('bad', lambda a, b: a.no_such, tolerance=0.01)",
            ["of package bad-metric failed: AttributeError", "bad_metric.py, line 2"],
        ),
    ],
    ids=["loading", "scoring"],
)
def test_metric_with_a_fault_is_one_line_that_names_it(tmp_path, code, words):
    install_metadata(tmp_path, "bad-metric", "[inim.metrics]\nbad = bad_metric:metric\n")
    (tmp_path / "bad_metric.py").write_text(code)
    scene = write_scene(tmp_path).name
    arguments = ("validate", scene, "-o", "out", "--viewpoints", "centre", *definitions(TINY))
    ended = run_here(*arguments, folder=tmp_path, variables={"PYTHONPATH": str(tmp_path)})
    assert (ended.code, ended.stdout) == (EXIT_USAGE, "")
    assert_one_line(ended.stderr, ["metric 'bad'", *words])
    assert not (tmp_path / "out").exists()
