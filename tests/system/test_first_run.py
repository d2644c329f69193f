"""A first look: previews and the bar on a terminal.

Expected: a preview says what it is and is no baseline; the bar counts the steps, names each and
never runs backwards.
"""

import fcntl
import os
import pty
import re
import struct
import subprocess
import termios
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from inim.pipeline.plan import make_plan
from inim.pipeline.request import PREVIEW, Request
from inim.system.errors import EXIT_PASSED
from tests.schemas import read_document
from tests.system.conftest import Ended, assert_refused, command, write_scene

Run = Callable[..., Ended]


@pytest.fixture(scope="module")
def previewed(tmp_path_factory, run_inim):
    """A preview's folder, and how its command ended."""
    folder = tmp_path_factory.mktemp("preview")
    scene = write_scene(folder)
    return folder, run_inim(scene, "--preview", "-o", "out", folder=folder)


def test_preview_is_marked_everywhere_with_the_full_command(previewed):
    folder, ended = previewed
    assert ended.code == EXIT_PASSED
    assert "preview" in ended.stdout.splitlines()[-1]
    assert "min_ssim_to_reference" not in ended.stdout, "scores this rough suggest no criteria"
    data = read_document(folder / "out" / "report.json")
    full = data["preview"]["full_command"]
    assert full.startswith("inim validate ")
    assert "--preview" not in full
    # Too few samples for intervals: `reports/coverage/preview`.
    for result in data["algorithms"].values():
        for scores in result["precision"].values():
            assert all(score["interval"] == [None, None] for score in scores.values())
    assert "--preview" in data["command"]
    for name in ("summary.md", "report.html"):
        text = (folder / "out" / name).read_text("utf-8")
        assert "preview" in text.lower()
        assert "inim validate" in text


def test_preview_is_refused_as_a_baseline(previewed):
    words, says = ("accept", "out", "--reason", "why"), ["preview", "inim validate"]
    assert_refused(*words, folder=previewed[0], says=says)


def test_definitions_and_options_override_a_preview(tmp_path):
    request = Request(write_scene(tmp_path), tmp_path, preview=True)
    with_options = replace(request, definitions={"inim.eia_spp": "6"}, viewpoints=("left", "up"))
    plain, changed = make_plan(request), make_plan(with_options)
    assert plain.settings.eia_spp == int(PREVIEW["inim.eia_spp"])
    assert [method.name for method in plain.methods] == ["template"]
    assert changed.settings.eia_spp == 6
    assert [eye.name for eye in changed.viewpoints] == ["left", "up"]
    assert changed.settings.view_spp == int(PREVIEW["inim.view_spp"])


def on_a_terminal(words: list[str], folder: Path) -> str:
    """Output of a command on a terminal of 40 rows and 100 columns."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 40, 100, 0, 0))
    with subprocess.Popen(words, cwd=folder, stdin=theirs, stdout=theirs, stderr=theirs) as child:
        os.close(theirs)
        output = b""
        while True:
            try:
                more = os.read(ours, 65536)
            except OSError:  # nobody has it open any more
                break
            if not more:
                break
            output += more
    os.close(ours)
    assert child.returncode == EXIT_PASSED, output
    return output.decode()


def test_bar_names_its_stages_and_never_runs_backwards(tmp_path):
    scene = write_scene(tmp_path)
    words = command(scene, "-o", "out", algorithms="template", viewpoints="centre")
    output = on_a_terminal(words, tmp_path)
    pattern = r"\r([^\r\n|]*), step (\d+) of (\d+) \|[^|\r\n]*\| (\d\d:\d\d)"
    bars = re.findall(pattern, output)
    for number in (1, 2, 3):
        values = [bar[number] for bar in bars]
        assert values == sorted(values, key=lambda text: int(text.replace(":", "")))
    assert 2 * int(bars[-1][1]) > int(bars[-1][2]) > 4
    assert len({name for name, *_ in bars}) >= 4
    assert "SSIM on the relic" in output, "lines stay readable between the bar's"
