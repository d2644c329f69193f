"""Steps that a run skips: results of the cache, black views, pixels of no view; and no others."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from inim.image.files.image import read_exr
from tests.schemas import read_document
from tests.system.conftest import Ended, write_scene

pytestmark = pytest.mark.usefixtures("no_page")
VIEWS = {"viewpoints": "centre,left"}


class Bench:
    """A scene, and a result cache of its own."""

    def __init__(self, run_inim: Callable[..., Ended], folder: Path) -> None:
        self._run, self.folder = run_inim, folder
        self.scene = write_scene(folder)
        self.out = folder / "out"

    def report(self, *words: str, cached: bool = True, **settings: str | None) -> dict[str, Any]:
        """Report of a run that passed, in a fresh folder."""
        shutil.rmtree(self.out, ignore_errors=True)
        cache = str(self.folder / "cache") if cached else "off"
        ended = self._run(
            *(self.scene, "-o", self.out, "--quiet", *words),
            folder=self.folder,
            variables={"INIM_CACHE": cache},
            **(VIEWS | settings),
        )
        assert ended.code == 0, ended.stderr
        return read_document(self.out / "report.json")


@pytest.fixture
def bench(run_inim, tmp_path):
    return Bench(run_inim, tmp_path)


@pytest.fixture(scope="module")
def first_run(run_inim, no_page, tmp_path_factory):
    """A folder whose cache holds the results of a run."""
    first = Bench(run_inim, tmp_path_factory.mktemp("first"))
    assert len(rendered(first.report())) == 4
    return first.folder


@pytest.fixture
def cached_bench(bench, first_run):
    """A scene whose run is in the cache."""
    shutil.copytree(first_run / "cache", bench.folder / "cache")
    return bench


def lasting(report: dict[str, Any]) -> dict[str, Any]:
    """Part of a report that must not depend on skipped steps: all but times and steps."""
    fixed = json.loads(json.dumps(report))
    for name in ("created", "command", "skipped", "timings"):
        del fixed[name]
    for result in fixed["algorithms"].values():
        del result["seconds"]
    return fixed


def rendered(report: dict[str, Any]) -> set[str]:
    """Products of the renderer that were made, not read."""
    kinds = ("RGB-D", "ground-truth", "true view")
    return {
        row["step"]
        for row in report["skipped"]
        if row["step"].startswith(kinds) and "samples traced" in row["performed"]
    }


def reason(report: dict[str, Any], step: str) -> str:
    (row,) = [row for row in report["skipped"] if row["step"].startswith(step)]
    return f"{row['performed']}; {row['why']}"


def test_a_rerun_into_another_folder_renders_nothing_and_has_the_same_results(bench):
    cold = bench.report()
    pictures = {p.name: p.read_bytes() for p in bench.out.rglob("*.png")}
    assert len(rendered(cold)) == 4
    bench.out = bench.folder / "other"
    warm = bench.report()
    assert rendered(warm) == set()
    assert lasting(warm) == lasting(cold)
    assert {p.name: p.read_bytes() for p in bench.out.rglob("*.png")} == pictures
    assert warm["timings"]["mitsuba_render"] == 0


def test_everything_done_scores_the_same(cached_bench):
    skipping = cached_bench.report()
    everything = cached_bench.report("--no-skip")
    assert lasting(everything) == lasting(skipping)
    assert "0 samples" in next(
        row["skipped"] for row in everything["skipped"] if row["step"] == "ground-truth EIA"
    )


# The scene's own numbers of samples are replaced by those that its scores need.
BY_NEED = dict.fromkeys(("capture_spp", "eia_spp", "view_spp"))


def test_sampling_ends_when_scores_are_precise(bench):
    rough, fine = (bench.report(**BY_NEED, score_error=error) for error in ("0.9", "1e-6"))
    (row,) = [row for row in rough["skipped"] if row["step"] == "samples"]
    used = [rough["settings"][name] for name in BY_NEED]
    assert used[1] in (8, 16, 32)
    assert used == [2 * used[1], used[1], 2 * used[1]]
    assert row["performed"] == (
        f"{used[0]} per RGB-D pixel, {used[1]} per observed EIA pixel, {used[2]} per view pixel"
    )
    assert row["skipped"] == f"{256 - used[0]}, {128 - used[1]}, {256 - used[2]} more"
    assert "+-0.9" in row["why"]
    assert [fine["settings"][name] for name in BY_NEED] == [256, 128, 256]
    (warning,) = [w for w in fine["warnings"] if "inim.score_error" in w]
    assert "1e-06" in warning
    assert set(rough["files"]) == set(fine["files"])


def test_another_algorithm_renders_nothing(cached_bench):
    other = cached_bench.report("--algorithms", "li2012")
    assert rendered(other) == set()
    assert "generated" in reason(other, "EIA of li2012")


def test_another_viewpoint_renders_its_view_and_the_eia_that_it_observes(cached_bench):
    moved = cached_bench.report(**{"viewpoints": "centre,right"})
    assert rendered(moved) == {"ground-truth view: right", "ground-truth EIA"}
    assert "read from the cache" in reason(moved, "view of template: centre")


def test_another_light_renders_all_with_the_reason(cached_bench):
    cached_bench.report()
    text = cached_bench.scene.read_text("utf-8")
    brighter = text.replace('name="irradiance" value="2.5"', 'name="irradiance" value="2.4"')
    assert brighter != text
    cached_bench.scene.write_text(brighter, "utf-8")
    report = cached_bench.report()
    assert len(rendered(report)) == 4
    assert "changed: scene)" in reason(report, "ground-truth EIA")


def test_lazy_generates_observed_pixels_and_scores_views_equally(bench):
    whole = bench.report("--lens-model", "thin", cached=False)
    eia = read_exr(bench.out / "eia" / "template.exr")
    truth = read_exr(bench.out / "truth" / "eia.exr")
    lazy = bench.report("--lens-model", "thin", "--lazy", cached=False)
    assert lazy["reference"] == whole["reference"]
    for name, result in lazy["algorithms"].items():
        assert result["views"] == whole["algorithms"][name]["views"]
        assert result["eia"]["ssim"] is None
        assert result["eia"]["psnr_db"] is None
    part = read_exr(bench.out / "eia" / "template.exr")
    is_generated = (part != 0).any(axis=-1)
    assert 0 < is_generated.sum() < 0.8 * (eia != 0).any(axis=-1).sum()
    assert np.array_equal(part[is_generated], eia[is_generated])
    true_part = read_exr(bench.out / "truth" / "eia.exr")
    lit = (true_part != 0).any(axis=-1)
    assert np.array_equal(true_part[lit], truth[lit])
    assert "no requested view" in reason(lazy, "panel pixels")


def test_a_cache_of_damaged_records_changes_nothing(cached_bench):
    whole = cached_bench.report()
    records = sorted((cached_bench.folder / "cache").glob("*.npz"))
    assert len(records) > 10
    for number, record in enumerate(records):
        data = bytearray(record.read_bytes())
        if number % 2:
            record.write_bytes(data[: len(data) // 2])
        else:
            data[len(data) // 2] ^= 0xFF
            record.write_bytes(data)
    assert lasting(cached_bench.report()) == lasting(whole)
