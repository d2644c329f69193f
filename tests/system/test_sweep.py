"""Sweeps of tiny studies, from the command line.

Expected: a row for each combination with the very scores a validation of its own gives; nothing
computed twice, nothing lost by whatever is killed; failures in rows, and one line for a mistake.
"""

import os
import re
import shutil
import signal
from pathlib import Path

import numpy as np
import pytest

import inim
from inim.apps.sweep.run import SweepPlace, run_sweep
from inim.apps.sweep.table import TABLE, columns
from inim.apps.sweep.unit import Unit
from inim.system.cache import input_digests
from inim.system.errors import EXIT_CHECK_FAILED, EXIT_PASSED
from tests.conftest import scene_text
from tests.schemas import read_document, read_text
from tests.system.conftest import assert_refused, files_in, nothing_left, worker_here
from tests.system.sweeps import (
    results,
    start,
    sweep,
    sweep_here,
    table,
    until,
    workers_of,
    write_study,
)

pytestmark = pytest.mark.usefixtures("no_page")
HOW_TO = Path(__file__).parents[2] / "docs" / "how-to" / "sweep.md"


@pytest.fixture(scope="module")
def swept(no_page, tmp_path_factory):
    """Two relics, one display, two algorithms."""
    folder = tmp_path_factory.mktemp("sweep 鼎")
    study = write_study(folder)
    ended = sweep_here(study.name, "-o", "out", folder=folder)
    assert ended.code == EXIT_PASSED, ended.stderr + ended.stdout
    return folder, ended


def test_a_row_for_each_combination(swept):
    folder, ended = swept
    rows = table(folder / "out")
    names = [(r["scene"], r["display"], r["algorithm"], r["viewpoint"]) for r in rows]
    assert names == [
        (f"relic{n}", "d0", algorithm, "centre")
        for n in (0, 1)
        for algorithm in ("template", "gu2020")
    ]
    assert all(row["status"] == "ok" and row["passed"] and row["error"] is None for row in rows)
    assert "2 of 2 validations run, 4 rows" in ended.stdout
    assert (folder / "out" / "sweep.html").is_file()
    assert nothing_left(folder)
    assert files_in(folder / "out") == {TABLE, "sweep.html", "sweep.json", "sweep.md"}


def test_scores_are_those_of_a_validation_of_its_own(swept, tmp_path):
    folder = swept[0]
    settings = {"lens_columns": 6, "lens_rows": 6, "capture_spp": 2, "eia_spp": 2, "view_spp": 2}
    options = {f"inim.{k}": v for k, v in (settings | {"reconstruction_spp": 2}).items()}
    scene, out = folder / "relic1.xml", tmp_path / "alone"
    with worker_here():
        inim.validate(scene, out, algorithms="gu2020", viewpoints="centre", definitions=options)
    (row,) = [
        r for r in table(folder / "out") if (r["scene"], r["algorithm"]) == ("relic1", "gu2020")
    ]
    data = read_document(out / "report.json")
    for key, value in data["algorithms"]["gu2020"]["views"]["centre"].items():
        assert row[key] == value, key
    for key in ("ssim", "psnr_db"):
        assert row[f"eia_{key}"] == data["algorithms"]["gu2020"]["eia"][key]
        assert row[f"reference_{key}"] == data["reference"]["views"]["centre"][key]
        assert row[f"noise_floor_{key}"] == data["noise_floor"]["views"]["centre"][key]
        assert row[f"noise_floor_eia_{key}"] == data["noise_floor"]["eia"][key]
    assert row["scene_sha256"] == data["scene"]["sha256"]
    assert [row[k] for k in ("x_mm", "y_mm", "z_mm")] == data["viewpoints"][0]["position_mm"]
    assert row["eia_spp"] == data["settings"]["eia_spp"] == 2


def test_columns_have_the_types_that_they_state(swept):
    from pyarrow import parquet

    schema = parquet.read_schema(swept[0] / "out" / TABLE)
    assert {f.name: str(f.type).replace("double", "float64") for f in schema} == columns()


def test_the_query_of_the_how_to_answers(swept):
    duckdb = pytest.importorskip("duckdb")
    text = HOW_TO.read_text("utf-8")
    (query,) = re.findall(r"```sql\n(.*?)```", text, re.S)
    rows = duckdb.sql(query.replace("OUT/", f"{swept[0]}/out/")).fetchall()
    assert len(rows) == 2
    assert {row[0] for row in rows} == {"relic0", "relic1"}


def test_an_unchanged_study_computes_nothing(swept):
    folder = swept[0]
    before, rows = results(folder), table(folder / "out")
    assert len(before) == 2
    planned = sweep_here("study.toml", "-o", "out", "--dry-run", folder=folder)
    assert planned.stdout.endswith("2 of 2 results exist, 0 validations to run\n")
    ended = sweep_here("study.toml", "-o", "other", folder=folder)
    assert ended.code == EXIT_PASSED
    assert "0 of 2 validations run, 4 rows" in ended.stdout
    assert results(folder) == before
    assert table(folder / "other") == rows


def test_without_a_result_cache_everything_is_computed_again(swept, tmp_path):
    outs = (tmp_path / "first", tmp_path / "second")
    with worker_here():
        places = [SweepPlace(out, workers=1) for out in outs]
        results = [run_sweep(swept[0] / "study.toml", place) for place in places]
    assert [result.computed for result in results] == [2, 2]
    for out in outs:
        assert table(out) == table(swept[0] / "out")


@pytest.fixture
def two_workers():
    """A dask cluster of two workers in this process, and the address of its scheduler."""
    distributed = pytest.importorskip("distributed")
    with (
        worker_here(),
        distributed.LocalCluster(
            n_workers=2,
            threads_per_worker=1,
            processes=False,
            dashboard_address=":0",
            protocol="tcp://",
        ) as cluster,
    ):
        yield cluster.scheduler_address


def test_a_cluster_makes_the_same_table_and_its_results_are_kept(
    swept, tmp_path, two_workers, monkeypatch
):
    """The results return to the driver, whose cache and folder no worker needs."""
    monkeypatch.setenv("INIM_CACHE", str(tmp_path / "cache"))
    place = SweepPlace(tmp_path / "out", two_workers)
    results = [run_sweep(swept[0] / "study.toml", place) for _ in range(2)]
    assert [(r.passed, r.computed) for r in results] == [(True, 2), (True, 0)]
    assert table(tmp_path / "out") == table(swept[0] / "out")


def test_a_worker_with_another_scene_is_refused(swept, tmp_path, two_workers, monkeypatch):
    def changed(unit):
        return {**input_digests(unit.plan.cache_key()), "parameters": "of the driver"}

    monkeypatch.setattr(Unit, "inputs", property(changed))
    result = run_sweep(swept[0] / "study.toml", SweepPlace(tmp_path / "out", two_workers))
    assert set(result.failed) == {"relic0 · d0", "relic1 · d0"}
    for error in result.failed.values():
        assert "parameters differs from what the sweep started with" in error


@pytest.mark.slow
def test_only_changed_or_damaged_units_are_computed(tmp_path):
    write_study(tmp_path)
    assert sweep("study.toml", "-o", "out", folder=tmp_path).code == EXIT_PASSED
    rows, before = table(tmp_path / "out"), results(tmp_path)
    damaged = next(iter(before))
    damaged.write_bytes(damaged.read_bytes()[:-100])
    ended = sweep("study.toml", "-o", "out", folder=tmp_path)
    assert "1 of 2 results exist, 1 validations to run" in ended.stdout
    after = results(tmp_path)
    assert {path for path in after if after[path] != before[path]} == {damaged}
    # Another algorithm renders no ground truth: it is in the result cache.
    write_study(tmp_path, algorithms=("li2012", "template", "gu2020"))
    ended = sweep("study.toml", "-o", "out", folder=tmp_path)
    assert ended.code == EXIT_PASSED, ended.stderr
    for path in results(tmp_path).keys() - after.keys():
        report = read_text(bytes(np.load(path)["reports"]).decode())
        steps = [row for row in report["skipped"] if row["step"].startswith("ground-truth")]
        assert steps and all(row["performed"] == "read from the cache" for row in steps)
    others = [row for row in table(tmp_path / "out") if row["algorithm"] != "li2012"]
    assert [row | {"unit": None} for row in others] == [row | {"unit": None} for row in rows]


@pytest.mark.slow
def test_a_unit_that_fails_is_a_row_and_the_others_go_on(tmp_path):
    study = write_study(tmp_path, scenes=2, algorithms=("template",), extra="keep_reports = true\n")
    (tmp_path / "relic0.xml").write_text(scene_text())  # nothing to see
    ended = sweep(study.name, "-o", "out", "--quiet", folder=tmp_path)
    assert ended.code == EXIT_CHECK_FAILED
    assert ended.stdout == ""
    (line,) = ended.stderr.splitlines()
    bad, good = table(tmp_path / "out")
    assert line == f"inim: failed: relic0 · d0: {bad['error']}"
    assert (bad["status"], bad["viewpoint"], bad["ssim"]) == ("failed", "centre", None)
    assert (good["status"], good["scene"]) == ("ok", "relic1")
    assert bad["error"] in (tmp_path / "out" / "sweep.html").read_text("utf-8")
    assert read_document(tmp_path / "out" / "sweep.json")["failed"] == {"relic0 · d0": bad["error"]}
    # The good one's report was asked to be kept.
    assert inim.Report.load(tmp_path / "out" / "reports" / good["unit"]).passed
    assert nothing_left(tmp_path)


@pytest.mark.slow
def test_a_killed_worker_and_a_killed_driver_lose_nothing_and_double_nothing(tmp_path):
    study = write_study(tmp_path, scenes=3, displays=2)
    assert sweep(study.name, "-o", "whole", folder=tmp_path).code == EXIT_PASSED
    shutil.rmtree(tmp_path / "cache")
    out = tmp_path / "out"
    driver = start(study.name, "-o", "out", folder=tmp_path)
    first = until(lambda: workers_of(out), "a worker starts")[0]
    os.kill(first, signal.SIGKILL)
    until(lambda: len(results(tmp_path)) >= 2, "some results")
    driver.send_signal(signal.SIGKILL)
    driver.communicate()
    until(lambda: not workers_of(out), "workers end with their driver")
    before = results(tmp_path)
    assert 2 <= len(before) < 6
    assert not (out / TABLE).exists()
    ended = sweep(study.name, "-o", "out", folder=tmp_path)
    assert ended.code == EXIT_PASSED, ended.stderr
    assert f"{len(before)} of 6 results exist" in ended.stdout
    after = results(tmp_path)
    assert len(after) == 6
    assert {path: after[path] for path in before} == before  # nothing was done again
    assert table(out) == table(tmp_path / "whole")
    assert nothing_left(tmp_path)
    assert not list((tmp_path / "tmp").rglob("*.partial"))


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_an_interrupt_takes_the_workers_along_and_prints_one_line(tmp_path, number):
    """Two sweeps at once do not disturb each other, either."""
    study = write_study(tmp_path)
    drivers = {out: start(study.name, "-o", out, folder=tmp_path) for out in ("out", "other")}
    for out, driver in drivers.items():
        until(lambda out=out: workers_of(tmp_path / out), "a worker starts")
        driver.send_signal(number)
    for out, driver in drivers.items():
        _, errors = driver.communicate(timeout=60)
        assert driver.returncode == 128 + number
        line = "inim: interrupted; results are kept; run it again to continue\n"
        assert errors == (line if number == signal.SIGINT else "")
        assert not workers_of(tmp_path / out)
    assert not list((tmp_path / "tmp").rglob("*.partial"))


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("gone.toml",), ["gone.toml", "study (.toml)"]),
        (("study.toml", "--workers", "0"), ["--workers 0"]),
        (("relic0.xml",), ["relic0.xml", "no TOML"]),
        (("study.toml", "-o", "relic0.xml"), ["relic0.xml", "-o"]),
        (("study.toml", "--scheduler", "nowhere"), ["--scheduler nowhere", "tcp://HOST:PORT"]),
        (("study.toml", "--scheduler", "tcp://127.0.0.1:1"), ["no answer", "dask scheduler"]),
    ],
)
def test_mistakes_cost_one_line_and_no_file(tmp_path, words, says):
    write_study(tmp_path, scenes=1)
    assert_refused("sweep", *words, folder=tmp_path, says=says)
