"""Files for other repositories and package indexes: workflows, the action, metadata and links."""

import json
import re
import sys
from pathlib import Path
from typing import Any

import pytest

from inim.cli.main import main
from inim.system.version import __version__
from tests.system.conftest import TINY, definitions, run_child, write_scene

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

PROJECT = Path(__file__).parents[2]
METADATA = tomllib.loads((PROJECT / "pyproject.toml").read_text("utf-8"))
WORKFLOWS = [PROJECT / "action.yml", *sorted((PROJECT / ".github/workflows").glob("*.yml"))]


def read_yaml(path: Path) -> Any:
    import yaml

    return yaml.safe_load(path.read_text("utf-8"))


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_actions_are_pinned_and_keep_no_credentials(path):
    text = path.read_text("utf-8")
    actions = re.findall(r"uses: (\S+)", text)
    assert actions
    for action in actions:
        assert re.fullmatch(r"[\w./-]+@[0-9a-f]{40}", action), action
    assert text.count("actions/checkout@") == text.count("persist-credentials: false")


def test_links_of_the_readme_work_outside_the_repository():
    text = (PROJECT / "README.md").read_text("utf-8")
    hook = METADATA["tool"]["hatch"]["metadata"]["hooks"]["fancy-pypi-readme"]
    for rule in hook["substitutions"]:
        text = re.sub(rule["pattern"], rule["replacement"], text)
    targets = re.findall(r"\]\(([^)]+)\)", text)
    assert len(targets) > 30
    assert all(target.startswith("https://") for target in targets)


def test_metadata_files_agree():
    urls = METADATA["project"]["urls"]
    codemeta = json.loads((PROJECT / "codemeta.json").read_text("utf-8"))
    citation = read_yaml(PROJECT / "CITATION.cff")
    assert codemeta["version"] == citation["version"] == __version__
    assert codemeta["codeRepository"] == urls["Repository"]
    assert codemeta["description"] == METADATA["project"]["description"]
    assert all(url.startswith(urls["Repository"]) for name, url in urls.items() if name != "Paper")
    assert f"git+{urls['Repository']}" in (PROJECT / "README.md").read_text("utf-8")


@pytest.fixture(scope="module")
def runner(tmp_path_factory):
    """A function that executes the action's steps in a repository, as the hosted runner does.

    The environment is clean: no variable of this process. This Python takes the place of the step
    that downloads packages.
    """
    folder = tmp_path_factory.mktemp("runner")
    python = folder / "bin" / "python"
    python.parent.mkdir()
    python.write_text(f'#!/bin/sh\nPYTHONPATH="{PROJECT}" exec "{sys.executable}" "$@"\n')
    python.chmod(0o755)
    action = read_yaml(PROJECT / "action.yml")
    steps = {step["name"]: step for step in action["runs"]["steps"] if "run" in step}
    assert list(steps) == ["Install", "Validate", "Summary"]
    defaults = {name: item.get("default", "") for name, item in action["inputs"].items()}

    def run(repository: Path, **inputs: str) -> tuple[int, str]:
        values, code = defaults | inputs, 0
        temporary = repository / "temporary"
        temporary.mkdir(exist_ok=True)
        summary = temporary / "summary.md"
        environment = {
            "PATH": f"{python.parent}:/usr/bin:/bin",
            "HOME": str(folder),
            "RUNNER_TEMP": str(temporary),
            "GITHUB_STEP_SUMMARY": str(summary),
        }
        for name in ("Validate", "Summary"):
            if code and "!cancelled()" not in steps[name].get("if", ""):
                continue
            variables = {
                key: re.sub(r"\$\{\{ inputs\.([\w-]+) \}\}", lambda match: values[match[1]], text)
                for key, text in steps[name]["env"].items()
            }
            words = ["bash", "--noprofile", "--norc", "-eo", "pipefail", "-c", steps[name]["run"]]
            ended = run_child(words, cwd=repository, env=environment | variables)
            assert name == "Validate" or ended.code == 0, ended
            code = code or ended.code
        return code, summary.read_text("utf-8")

    return run


@pytest.mark.slow
def test_action_shows_the_summary_of_a_pass_a_failure_and_an_unreadable_scene(runner, tmp_path):
    scene = write_scene(tmp_path / "scenes")
    arguments = " ".join(["--viewpoints", "left", *definitions(TINY)])
    inputs = {"scene": "scenes/tiny.xml", "algorithms": "template,gu2020", "arguments": arguments}
    code, summary = runner(tmp_path, **inputs)
    assert code == 0
    assert "gu2020" in summary
    words = ["accept", str(tmp_path / "out/inim"), "--reason", "first"]
    assert main([*words, "-o", str(tmp_path / "base")]) == 0

    scene.write_text(scene.read_text().replace('value="1.2"', 'value="3"'))
    code, summary = runner(tmp_path, **inputs, baseline="base")
    assert code == 1
    assert "inputs changed, scores changed" in summary
    assert "shape sphere / float radius" in summary

    scene.write_text("<scene>")
    code, summary = runner(tmp_path, **inputs, baseline="base", output="out/other")
    assert code == 2
    assert "tiny.xml: no report" in summary
    assert "broken XML" in summary
