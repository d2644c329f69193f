"""Baselines as a user meets them: accept, validate against, compare, a workflow, a pytest plugin.

Expected: an unchanged program passes with any seed. A regression fails in a row that names it, with
images of candidate and difference. Changed inputs are named, and scores decide. A missing baseline
ends with 4 before anything is rendered. The project's own two baselines can be compared with.
"""

import json
import os
import shlex
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

from inim.cli.main import main
from inim.pipeline import launch
from inim.pipeline.plan import make_plan
from inim.pipeline.request import Request
from inim.system.errors import EXIT_BASELINE, EXIT_CHECK_FAILED, EXIT_PASSED
from tests.schemas import read_document
from tests.system.conftest import (
    Ended,
    assert_one_line,
    assert_refused,
    files_in,
    install_metadata,
    nothing_left,
    worker_here,
    write_scene,
)

Run = Callable[..., Ended]
PROJECT = Path(__file__).parents[2]
SETTINGS = {
    "lens_columns": "16", "lens_rows": "12", "capture_spp": "8", "eia_spp": "8", "view_spp": "16",
    "reconstruction_spp": "8", "algorithms": "planted", "viewpoints": "left,right",
}  # fmt: skip
# The template's picture, or one in which something went wrong, by an environment variable.
PLANTED = '''
import os
import numpy as np
from inim.generators import prepare as prepared

class Planted:
    def __init__(self, generator):
        self.generator = generator

    def generate(self, rgbd, out=None):
        eia = self.generator.generate(rgbd, out)
        fault = os.environ.get("PLANTED", "")
        if fault == "noisy lens":
            noise = np.random.default_rng(1).uniform(-0.5, 0.5, (17, 17, 1))
            eia[85:102, 119:136] += noise.astype(eia.dtype)
        if fault == "nan":
            eia[0, 0] = np.nan
        return eia

def prepare(display, shape, pixel_mm):
    """A generator that can go wrong."""
    name = "template:samples=1:colour=nearest"
    return Planted(prepared(display, name, shape=shape, pixel_mm=pixel_mm))
'''


@dataclass(frozen=True)
class Bench:
    """A scene with an accepted baseline, and a generator that can go wrong."""

    folder: Path
    run_inim: Run
    variables: Mapping[str, str]

    def run(self, *words: str, fault: str = "", **settings: str) -> Ended:
        variables = {**self.variables, "PLANTED": fault}
        options = SETTINGS | settings
        return self.run_inim("tiny.xml", *words, folder=self.folder, variables=variables, **options)

    def judged(self, out: str, *words: str, fault: str = "", **settings: str) -> Ended:
        return self.run("-o", out, "--baseline", "base", *words, fault=fault, **settings)

    def data(self, out: str) -> dict[str, Any]:
        return read_document(self.folder / out / "report.json")

    def failed(self, out: str) -> set[str]:
        checks = self.data(out)["verdict"]["checks"]
        return {check["name"] for check in checks if not check["passed"]}


@pytest.fixture(scope="module")
def bench(tmp_path_factory, run_inim):
    folder = tmp_path_factory.mktemp("regression")
    write_scene(folder)
    site = folder / "site"
    install_metadata(site, "planted", "[inim.generators]\nplanted = planted:prepare\n")
    (site / "planted.py").write_text(PLANTED)
    paths = [str(site), os.environ.get("PYTHONPATH", "")]
    workbench = Bench(folder, run_inim, {"PYTHONPATH": os.pathsep.join(filter(None, paths))})
    ended = workbench.run("-o", "first")
    assert ended.code == EXIT_PASSED, ended.stderr
    assert main(["accept", str(folder / "first"), "--reason", "the first",
                 "-o", str(folder / "base")]) == EXIT_PASSED  # fmt: skip
    return workbench


@pytest.fixture(scope="module")
def noisy(bench):
    """One lens went wrong: the run is in `noisy`."""
    ended = bench.judged("noisy", fault="noisy lens")
    assert ended.code == EXIT_CHECK_FAILED, ended.stderr
    return bench


# --- Passing and failing ------------------------------------------------------------------------


def test_fresh_seed_passes_and_its_drift_shows(bench):
    ended = bench.judged("fresh", seed="1")
    assert ended.code == EXIT_PASSED, (ended.stderr, bench.failed("fresh"))
    regression = bench.data("fresh")["regression"]
    assert {"name": "seed", "baseline": 0, "candidate": 1} in regression["circumstances"]
    assert (regression["verdict"], regression["inputs"]) == ("passed", [])
    summary = (bench.folder / "fresh" / "summary.md").read_text(encoding="utf-8")
    assert "largest for its limit" in summary
    page = (bench.folder / "fresh" / "report.html").read_text(encoding="utf-8")
    assert "passed: 0 of" in page
    assert "the first" in page


def test_noisy_lens_fails_its_own_rows_only(noisy):
    light = {name for name in noisy.failed("noisy") if ": light on " in name}
    assert noisy.failed("noisy") - light == {
        "eia/planted: tiles against the baseline",
        "planted: changed pixels of the reference input",
    }
    assert all(name.startswith("planted/") for name in light)


def test_failure_leaves_candidate_baseline_and_difference(noisy):
    folder = noisy.folder / "noisy" / "regression"
    pages = {}
    for kind in ("baseline", "candidate", "difference"):
        with Image.open(folder / "eia" / f"planted-{kind}.png") as picture:
            pages[kind] = np.asarray(picture.convert("RGB")).astype(int)
    difference = pages["difference"].sum(axis=-1)
    worst = np.unravel_index(np.argmax(difference), difference.shape)
    assert (worst[0] // 17, worst[1] // 17) == (5, 7)
    assert (folder / "fixed" / "planted-candidate.png").is_file()
    assert {str(p.relative_to(noisy.folder / "noisy")) for p in folder.rglob("*.png")} <= set(
        noisy.data("noisy")["files"]
    )


# --- Changed inputs -----------------------------------------------------------------------------

SCORES_CHANGED = "inputs changed, scores changed"
WITHIN = "inputs changed, scores within intervals"
_SHAPE = '<shape type="sphere">'


def _edited(text: str) -> str:
    """The scene with a comment, other white space and another order of attributes."""
    radius = 'name="radius" value="1.2"'
    assert radius in text
    return text.replace(_SHAPE, f"<!-- the ball -->\n\n  {_SHAPE}").replace(
        radius, 'value="1.20"  name="radius"'
    )


def _replaced(old: str, new: str) -> Callable[[str], str]:
    def change(text: str) -> str:
        assert old in text
        return text.replace(old, new)

    return change


def _same(text: str) -> str:
    return text


@pytest.mark.parametrize(
    ("edit", "settings", "verdict", "named"),
    [
        pytest.param(_edited, {}, "passed", [], id="comment"),
        pytest.param(_same, {"seed": "7"}, "passed", [], id="seed"),
        pytest.param(
            _replaced("0.9,0.1,0.1", "0.9,0.1003,0.1"), {}, WITHIN,
            ["shape rectangle / bsdf diffuse / rgb reflectance"], id="material, too little",
        ),
        pytest.param(
            _replaced("0.9,0.1,0.1", "0.9,0.11,0.1"), {}, SCORES_CHANGED,
            ["shape rectangle / bsdf diffuse / rgb reflectance"], id="material",
        ),
        pytest.param(
            _replaced('value="1.2"', 'value="1.6"'), {}, SCORES_CHANGED,
            ["shape sphere / float radius"], id="shape",
        ),
        pytest.param(
            _same, {"lens_columns": "15"}, SCORES_CHANGED, ["display: lens_columns"], id="display"
        ),
        pytest.param(
            _same, {"lens_model": "pinhole"}, SCORES_CHANGED, ["lens model"], id="lens model"
        ),
        pytest.param(_same, {"viewpoints": "left,up"}, None, ["viewpoints: up"], id="viewpoint"),
        pytest.param(
            _same, {"algorithms": "planted,wang2024"}, WITHIN, ["algorithm wang2024"],
            id="algorithm",
        ),
    ],
)  # fmt: skip
def test_a_change_of_an_input_is_named_and_scores_decide(
    bench, tmp_path, edit, settings, verdict, named
):
    scene = tmp_path / "renamed.xml"
    scene.write_text(edit((bench.folder / "tiny.xml").read_text()))
    out = tmp_path / "out"
    words = [str(scene), "-o", str(out), "--baseline", str(bench.folder / "base")]
    options = SETTINGS | settings
    ended = bench.run_inim(*words, folder=bench.folder, variables=bench.variables, **options)
    assert not ended.stderr
    regression = read_document(out / "report.json")["regression"]
    names = [change["name"] for change in regression["inputs"]]
    assert all(any(name in listed for listed in names) for name in named), names
    assert bool(names) is bool(named)
    assert regression["verdict"] == verdict or verdict is None, ended.stdout
    expected = EXIT_CHECK_FAILED if regression["verdict"] == SCORES_CHANGED else EXIT_PASSED
    assert ended.code == expected, ended
    junit = ElementTree.parse(out / "junit.xml").getroot()
    assert (int(junit.get("failures")) > 0) is (expected == EXIT_CHECK_FAILED)
    assert junit.find("properties/property").get("value") == regression["verdict"]
    for text in (ended.stdout, (out / "summary.md").read_text("utf-8")):
        assert regression["verdict"] in text
    page = (out / "report.html").read_text("utf-8")
    assert page.index("Changed inputs" if named else "Other differences") < page.index('"scores"')


def test_allowed_changes_pass_and_the_report_has_the_command_that_accepts_them(bench):
    ended = bench.judged("allowed", "--allow-changed-inputs", lens_model="pinhole")
    assert ended.code == EXIT_PASSED, ended.stdout
    assert f"{SCORES_CHANGED}: " in ended.stdout
    assert "to accept: inim accept allowed --reason TEXT" in ended.stdout
    summary = (bench.folder / "allowed" / "summary.md").read_text("utf-8")
    assert "To accept: `inim accept allowed --reason TEXT`" in summary


def test_nothing_to_compare_ends_with_4_and_all_files(bench):
    ended = bench.judged("other", viewpoints="up")
    assert ended.code == EXIT_BASELINE
    assert "not comparable" in ended.stdout
    assert bench.data("other")["regression"]["verdict"] == "not comparable"
    assert (bench.folder / "other" / "summary.md").is_file()
    assert nothing_left(bench.folder)


# --- What cannot be read ------------------------------------------------------------------------


def _set(path: Path, **values: Any) -> None:
    data = json.loads(path.read_text())
    path.write_text(json.dumps(data | values))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda f: (f / "baseline.json").unlink(), ["no such file", "inim accept"]),
        (lambda f: (f / "baseline.npz").write_bytes(b"PK junk"), ["damaged"]),
        (lambda f: _set(f / "baseline.json", pictures={}), ["no image or no score"]),
        (lambda f: _set(f / "baseline.json", scores={}), ["no image or no score"]),
    ],
)
def test_an_invalid_baseline_ends_with_4(bench, tmp_path, change, words):
    base = Path(shutil.copytree(bench.folder / "base", tmp_path / "base"))
    change(base)
    ended = bench.run("-o", "out4", "--baseline", str(base))
    assert ended.code == EXIT_BASELINE
    assert_one_line(ended.stderr, words)
    assert not (bench.folder / "out4").exists()


# --- Accepting ----------------------------------------------------------------------------------


def test_accepted_change_passes_from_then_on(noisy, tmp_path):
    to = tmp_path / "base"
    words = ["accept", str(noisy.folder / "noisy"), "--reason", "meant", "-o"]
    assert main([*words, str(to)]) == EXIT_PASSED
    ended = noisy.run("-o", "again", "--baseline", str(to), fault="noisy lens", seed="3")
    assert ended.code == EXIT_PASSED, noisy.failed("again")


def test_run_that_failed_on_its_own_cannot_be_accepted(bench):
    assert bench.judged("nan", fault="nan").code == EXIT_CHECK_FAILED
    assert "eia/planted: pixels not finite" in bench.failed("nan")
    words = ("accept", "nan", "--reason", "hide it", "-o", "hidden")
    assert_refused(*words, folder=bench.folder, says=["pixels not finite"])


# --- Comparing two reports ----------------------------------------------------------------------


def test_compare_gives_the_verdicts_of_the_baseline_check(noisy, tmp_path, capsys):
    out = tmp_path / "cmp"
    folders = [str(noisy.folder / name) for name in ("first", "noisy")]
    assert main(["compare", *folders, "-o", str(out)]) == EXIT_CHECK_FAILED
    text = capsys.readouterr().out
    assert "changed: planted: changed pixels of the reference input: " in text
    assert "changed: eia/planted: tiles: " in text
    assert "worse: " in text
    assert "baseline" not in text
    data = read_document(out / "compare.json")
    assert data["schema"] == "inim.compare/3"
    failed = {check["name"] for check in data["verdict"]["checks"] if not check["passed"]}
    assert failed == {name.replace(" against the baseline", "") for name in noisy.failed("noisy")}
    assert set(data["files"]) == files_in(out)
    page = (out / "compare.html").read_text(encoding="utf-8")
    assert "What changed" in page
    assert page.count("data:image/") == 3
    assert ElementTree.parse(out / "junit.xml").getroot().get("failures") == str(len(failed))
    assert main(["compare", folders[0], folders[0], "-o", str(out), "--quiet"]) == EXIT_PASSED


# --- The workflow and the project's own baselines -----------------------------------------------


def workflow() -> dict[str, Any]:
    import yaml

    text = (PROJECT / ".github" / "workflows" / "inim.yml").read_text(encoding="utf-8")
    return dict(yaml.safe_load(text))


def steps() -> list[dict[str, Any]]:
    return list(workflow()["jobs"]["regression"]["steps"])


def test_workflow_s_commands_plan_runs_that_its_baselines_can_be_compared_with(monkeypatch):
    """Up to where the worker would begin: options, settings, scene and baseline's conditions."""
    planned = []

    def plan_only(make_request: Callable[[], Request], *_: object, **__: object) -> bool:
        planned.append(make_plan(make_request()))
        return True

    monkeypatch.chdir(PROJECT)
    monkeypatch.setattr(launch, "validate_in_worker", plan_only)
    small = workflow()["jobs"]["regression"]["env"]["SMALL"]
    for step in steps():
        words = shlex.split(step.get("run", "").replace("$SMALL", small))
        if words[:3] == ["python", "-m", "inim.validate"]:
            assert main(["validate", "--quiet", *words[3:]]) == EXIT_PASSED
    assert [plan.request.baseline.name for plan in planned] == ["jade", "wine_coin"]
    assert all(plan.baseline is not None for plan in planned)
    assert all(plan.request.backend == "llvm" for plan in planned), "that of the baselines"


# --- The pytest plugin --------------------------------------------------------------------------

pytest_plugins = ["pytester"]
TEST = """
def test_sphere(inim_validate):
    report = inim_validate("tiny.xml", definitions={definitions}, algorithms="{algorithms}")
    assert report.passed
"""


def plugin_test(
    pytester: pytest.Pytester, *words: str, others: Mapping[str, str] | None = None, **changes: str
) -> pytest.RunResult:
    """Run the plugin's test with these settings, and with `others` also a second one."""
    small = {"lens_columns": "8", "lens_rows": "6", "viewpoints": "left"}
    settings = {k: v for k, v in SETTINGS.items() if k != "algorithms"} | small | changes
    text = ""
    for name, more in {"sphere": {}, "other": others}.items():
        if more is not None:
            options = {f"inim.{key}": value for key, value in (settings | more).items()}
            text += TEST.replace("sphere", name).format(definitions=options, algorithms="template")
    write_scene(pytester.path)
    pytester.makepyfile(test_it=text)
    if words == ("--inim-update",):  # a session that ends before it begins
        return pytester.runpytest_subprocess("-q", *words, timeout=120)
    with worker_here():
        return pytester.runpytest_inprocess("-q", "-p", "no:cacheprovider", *words)


def test_plugin_asks_for_a_baseline_accepts_one_and_compares(bench, pytester):
    """Runs in this process, where `bench` has loaded the renderer; it can be loaded only once."""
    missing = plugin_test(pytester)
    missing.assert_outcomes(failed=1)
    missing.stdout.fnmatch_lines(["*no such file*", "*--inim-update*"])
    accepted = plugin_test(pytester, "--inim-update", "--inim-reason", "the first")
    accepted.assert_outcomes(passed=1)
    baselines = pytester.path / "inim_baselines"
    assert (baselines / "test_sphere" / "baseline.json").is_file()
    shutil.copytree(baselines / "test_sphere", baselines / "test_other")
    compared = plugin_test(pytester, seed="5", others={"gap_mm": "3.2"})
    compared.assert_outcomes(passed=1, failed=1)
    compared.stdout.fnmatch_lines(["*display: gap_mm: 3.3 → 3.2*", "*inputs changed*"])
