"""A first look: previews, the bar on a terminal, kernels compiled beside the worker.

Expected: a preview says what it is and is no baseline; the bar names each stage, never runs
backwards and ends full; kernels compiled ahead are those the worker needs, and where none can be,
a run is what it is without them.
"""

from __future__ import annotations

import fcntl
import os
import pty
import re
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

import inim
from inim.cli import main
from inim.errors import EXIT_PASSED, EXIT_USAGE, UsageError
from inim.pipeline import compile_ahead, compiled_marks
from inim.pipeline.compile_ahead import compiling_ahead
from inim.pipeline.plan import Plan, make_plan
from inim.pipeline.request import PREVIEW, Request
from inim.process.python_process import child_environment, python_code
from tests.schemas import read_document
from tests.system.conftest import TINY, Ended, assert_one_line, command, write_scene

Run = Callable[..., Ended]
# Few enough for every test, over what a preview sets.
FEW = {key: TINY[f"inim.{key}"] for key in ("lens_columns", "lens_rows")}


@pytest.fixture(scope="module")
def previewed(tmp_path_factory: pytest.TempPathFactory, run_inim: Run) -> tuple[Path, Ended]:
    """A preview's folder, and how its command ended."""
    folder = tmp_path_factory.mktemp("preview")
    scene = write_scene(folder)
    return folder, run_inim(scene, "--preview", "-o", "out", folder=folder)


def test_preview_says_so_everywhere_and_names_the_full_command(
    previewed: tuple[Path, Ended],
) -> None:
    folder, ended = previewed
    assert ended.code == EXIT_PASSED
    assert "preview" in ended.stdout.splitlines()[-1]
    assert "min_ssim_to_ceiling" not in ended.stdout, "scores this rough suggest no criteria"
    data = read_document(folder / "out" / "report.json")
    full = data["preview"]["full_command"]
    assert full.startswith("inim validate ")
    assert "--preview" not in full
    assert "--preview" in data["command"]
    for name in ("summary.md", "report.html"):
        text = (folder / "out" / name).read_text("utf-8")
        assert "preview" in text.lower()
        assert "inim validate" in text


def test_a_full_report_is_no_preview(tmp_path: Path, run_inim: Run) -> None:
    ended = run_inim(write_scene(tmp_path), "-o", "out", folder=tmp_path, algorithms="template")
    data = read_document(tmp_path / "out" / "report.json")
    assert "preview" not in data
    assert "preview" not in ended.stdout


def test_preview_is_refused_as_a_baseline(
    previewed: tuple[Path, Ended], capsys: pytest.CaptureFixture[str]
) -> None:
    out = previewed[0] / "out"
    assert main(["baseline", "accept", str(out), "--reason", "why"]) == EXIT_USAGE
    assert_one_line(capsys.readouterr().err, ["preview", "inim validate"])


def test_preview_with_a_baseline_is_refused_before_anything_is_rendered(tmp_path: Path) -> None:
    request = Request(write_scene(tmp_path), tmp_path, preview=True, baseline=tmp_path)
    with pytest.raises(UsageError, match="--preview"):
        make_plan(request)


def test_definitions_and_options_override_a_preview(tmp_path: Path) -> None:
    request = Request(write_scene(tmp_path), tmp_path, preview=True)
    asked = replace(request, definitions={"inim.eia_spp": "6"}, viewpoints=("left", "up"))
    plain, changed = make_plan(request), make_plan(asked)
    assert plain.settings.eia_spp == int(PREVIEW["inim.eia_spp"])
    assert [method.name for method in plain.methods] == ["template"]
    assert changed.settings.eia_spp == 6
    assert [eye.name for eye in changed.viewpoints] == ["left", "up"]
    assert changed.settings.view_spp == int(PREVIEW["inim.view_spp"])


def test_preview_drops_criteria_for_algorithms_that_it_leaves_out(tmp_path: Path) -> None:
    limits = '<default name="inim.min_ssim_to_ceiling" value="wang2024:0.5"/>'
    scene = write_scene(tmp_path)
    text = scene.read_text("utf-8")
    scene.write_text(re.sub(r"(<scene[^>]*>)", rf"\1{limits}", text, count=1), encoding="utf-8")
    assert make_plan(Request(scene, tmp_path, preview=True)).ssim_limits == {}


def test_preview_from_python(tmp_path: Path) -> None:
    report = inim.validate(
        write_scene(tmp_path),
        tmp_path / "out",
        preview=True,
        definitions={f"inim.{key}": value for key, value in FEW.items()},
    )
    assert list(report.data["algorithms"]) == ["template"]
    assert "preview" in report.data


def test_pictures_have_no_preview(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["validate", "--rgbd", str(tmp_path / "a.exr"), "--preview"]) == EXIT_USAGE
    assert_one_line(capsys.readouterr().err, ["--preview", "scene"])


def on_a_terminal(words: list[str], folder: Path) -> str:
    """What a command writes on a terminal of 40 rows and 100 columns."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 40, 100, 0, 0))
    with subprocess.Popen(words, cwd=folder, stdin=theirs, stdout=theirs, stderr=theirs) as child:
        os.close(theirs)
        said = b""
        while True:
            try:
                more = os.read(ours, 65536)
            except OSError:  # nobody has it open any more
                break
            if not more:
                break
            said += more
    os.close(ours)
    assert child.returncode == EXIT_PASSED, said
    return said.decode()


def test_bar_names_its_stages_never_runs_backwards_and_ends_full(tmp_path: Path) -> None:
    scene = write_scene(tmp_path)
    said = on_a_terminal(command(scene, "-o", "out", algorithms="template"), tmp_path)
    drawn = re.findall(r"\r([^\r\n:]*): +(\d+)%\|[^|\r\n]*\|, ([^\r\n]*)", said)
    shares = [int(share) for _, share, _ in drawn]
    assert shares == sorted(shares)
    assert shares[-1] == 100
    assert len({name for name, _, _ in drawn}) >= 4
    assert any(re.search(r"about \d+ (s|min) left", words) for _, _, words in drawn)
    assert "SSIM on the relic" in said, "lines stay readable between the bar's"


COMPILE = """
import sys
from pathlib import Path
from inim.pipeline.compile_ahead import compiling_ahead
from inim.pipeline.compiled_marks import is_compiled, wait_until_compiled
from inim.pipeline.plan import make_plan
from inim.pipeline.request import Request
import time
plan = make_plan(Request(Path(sys.argv[1]), Path("out"), algorithms=("template",)))
with compiling_ahead(plan):
    end = time.monotonic() + 100
    while not is_compiled("template", plan.display) and time.monotonic() < end:
        time.sleep(0.05)
    wait_until_compiled("template", plan.display)
print(is_compiled("template", plan.display))
"""
MAKE = """
import sys, numba.core.event as event
from pathlib import Path
from inim.pipeline.stages.generate import GeneratorHandle
from inim.pipeline.plan import make_plan
from inim.pipeline.request import Request
from inim.regression import reference_input
plan = make_plan(Request(Path(sys.argv[1]), Path("out"), algorithms=("template",)))
size = plan.capture_shape, plan.capture_pixel_mm
with event.install_recorder("numba:compile") as recorded:
    GeneratorHandle("template", plan.display, *size).run(reference_input(plan.display, *size))
print(len(recorded.buffer))
"""


def test_what_is_compiled_ahead_is_all_that_the_generator_needs(tmp_path: Path) -> None:
    scene, kept = write_scene(tmp_path), tmp_path / "kernels"
    variables = child_environment() | {"NUMBA_CACHE_DIR": str(kept)}

    def run(code: str) -> str:
        words = python_code(code, str(scene))
        return subprocess.run(
            words, env=variables, cwd=tmp_path, capture_output=True, text=True, check=True
        ).stdout.strip()

    assert run(COMPILE) == "True"
    assert run(MAKE) == "0"


@pytest.fixture
def plan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Plan:
    """Of an algorithm that nothing says was compiled, on two processors."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "kernels"))
    monkeypatch.setattr(compile_ahead, "cpu_count", lambda: 2)
    return make_plan(Request(write_scene(tmp_path), tmp_path / "out", algorithms=("template",)))


@pytest.fixture
def children(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[subprocess.Popen]]:
    """Processes that are started to compile."""
    found: list[subprocess.Popen] = []
    started = compile_ahead.started

    def noted(*words: object, **options: object) -> object:
        class Noted:
            def __enter__(self) -> subprocess.Popen:
                self.manager = started(
                    [sys.executable, "-c", "import time; time.sleep(60)"], **options
                )
                found.append(self.manager.__enter__())
                return found[-1]

            def __exit__(self, *error: object) -> object:
                return self.manager.__exit__(*error)

        return Noted()

    monkeypatch.setattr(compile_ahead, "started", noted)
    yield found


def test_the_compiling_process_ends_with_the_run(
    plan: Plan, children: list[subprocess.Popen]
) -> None:
    with compiling_ahead(plan):
        assert children[0].poll() is None
    assert children[0].returncode is not None


@pytest.mark.parametrize("why", ["one processor", "short of memory", "a part", "compiled before"])
def test_none_is_started_where_nothing_is_to_be_gained(
    why: str, plan: Plan, children: list[subprocess.Popen], monkeypatch: pytest.MonkeyPatch
) -> None:
    if why == "one processor":
        monkeypatch.setattr(compile_ahead, "cpu_count", lambda: 1)
    elif why == "short of memory":
        plan = replace(plan, rays_in_flight=2**16)
    elif why == "a part":
        plan = replace(plan, request=replace(plan.request, lazy=True))
    else:
        with compiled_marks.compiling("template", plan.display):
            pass
    with compiling_ahead(plan):
        assert not children


def test_who_needs_a_kernel_waits_for_who_compiles_it_and_no_longer(
    plan: Plan, tmp_path: Path
) -> None:
    code = (
        "import time\nfrom inim.display import DISPLAYS\n"
        "from inim.pipeline.compiled_marks import compiling\n"
        "with compiling('template', DISPLAYS['nominal']):\n"
        "    print('at it', flush=True)\n    time.sleep(1)\n"
    )
    variables = child_environment() | {"NUMBA_CACHE_DIR": str(tmp_path / "kernels")}
    with subprocess.Popen(python_code(code), env=variables, stdout=subprocess.PIPE) as child:
        assert child.stdout is not None
        assert child.stdout.readline()
        assert not compiled_marks.is_compiled("template", plan.display)
        begun = time.monotonic()
        compiled_marks.wait_until_compiled("template", plan.display)
        assert time.monotonic() - begun < 30
        assert compiled_marks.is_compiled("template", plan.display)
    compiled_marks.wait_until_compiled("layered", plan.display)  # which nobody compiles


def test_a_failure_to_compile_leaves_no_mark(plan: Plan, tmp_path: Path) -> None:
    with pytest.raises(RuntimeError), compiled_marks.compiling("template", plan.display):
        raise RuntimeError
    assert not compiled_marks.is_compiled("template", plan.display)
