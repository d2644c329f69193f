"""Files for other repositories and package indexes: workflows, the action, metadata and links."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from inim.system.version import __version__
from tests.system.conftest import TINY, definitions, write_scene

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


@pytest.mark.slow
def test_action_validates_a_scene_of_another_repository(tmp_path):
    """Its steps in bash, as the hosted runner executes them; this Python has inim already."""
    action = read_yaml(PROJECT / "action.yml")
    write_scene(tmp_path / "scenes")
    values = {name: item.get("default", "") for name, item in action["inputs"].items()}
    values |= {
        "scene": "scenes/tiny.xml",
        "algorithms": "template:samples=1,gu2020",
        "arguments": " ".join(["--viewpoints", "left", "--quiet", *definitions(TINY)]),
    }
    python = tmp_path / "bin" / "python"
    python.parent.mkdir()
    python.write_text(f'#!/bin/sh\nexec "{sys.executable}" "$@"\n')
    python.chmod(0o755)
    environment = os.environ | {
        "PATH": f"{python.parent}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(PROJECT),
        "GITHUB_STEP_SUMMARY": str(tmp_path / "summary.md"),
    }
    steps = {step["name"]: step for step in action["runs"]["steps"] if "run" in step}
    assert list(steps) == ["Install", "Validate", "Summary"]
    for name in ("Validate", "Summary"):
        variables = {
            key: re.sub(r"\$\{\{ inputs\.([\w-]+) \}\}", lambda match: values[match[1]], text)
            for key, text in steps[name]["env"].items()
        }
        ended = subprocess.run(
            ["bash", "-eo", "pipefail", "-c", steps[name]["run"]],
            cwd=tmp_path, env=environment | variables, capture_output=True, text=True,
        )  # fmt: skip
        assert ended.returncode == 0, (name, ended.stdout, ended.stderr)
    assert "gu2020" in (tmp_path / "summary.md").read_text("utf-8")
    assert (tmp_path / "out/inim/report.json").is_file()
