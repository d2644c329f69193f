"""An application is removed by deleting its folder and its line in the table of applications.

Expected: the rest imports, and the commands and schemas of all others work. Type checkers also read
the names of public functions in `inim/__init__.py`.
"""

import ast
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import inim
from inim.apps import APPS

PACKAGE = Path(inim.__file__).parent
# Run in a folder that holds the copy: imports every module, and every name that a function imports.
USE = """
import ast, importlib, sys
from pathlib import Path
import inim
assert Path(inim.__file__).parent.parent == Path.cwd()
for path in sorted(Path("inim").rglob("*.py")):
    module = ".".join(path.with_suffix("").parts).removesuffix(".__init__")
    if not module.endswith("__main__"):
        importlib.import_module(module)
    tree = ast.parse(path.read_text("utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING":
            node.body = []
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module.startswith("inim") and not node.level:
            importlib.import_module(node.module)
from inim.apps import APPS
from inim.cli import schemas
from inim.cli.main import COMMANDS, main
for name in schemas.NAMES:
    schemas.schema(name)
for name in dir(inim):
    getattr(inim, name)
for words in (["--help"], *([command, "--help"] for command in COMMANDS)):
    try:
        main(words)
    except SystemExit as ended:
        assert ended.code == 0, words
"""


def without(app: str, folder: Path) -> None:
    """Copy the package without an application into a folder."""
    compiled = shutil.ignore_patterns("__pycache__", "*.nbi", "*.nbc")
    shutil.copytree(PACKAGE, folder / "inim", ignore=compiled)
    shutil.rmtree(folder / "inim" / "apps" / app)
    table = folder / "inim" / "apps" / "__init__.py"
    text = table.read_text("utf-8")
    (entries,) = (
        node.value
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.AnnAssign) and isinstance(node.value, ast.Dict)
    )
    names = [ast.literal_eval(key) for key in entries.keys if key is not None]
    value = entries.values[names.index(app)]
    lines = text.splitlines(keepends=True)
    del lines[value.lineno - 1 : value.end_lineno]
    table.write_text("".join(lines), "utf-8")


@pytest.mark.parametrize("app", APPS)
def test_the_rest_works_without_an_application(app, tmp_path):
    without(app, tmp_path)
    ended = subprocess.run(
        [sys.executable, "-c", USE], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stderr[-2000:]
    assert "usage: inim validate" in ended.stdout
    for command in APPS[app]["commands"]:
        assert f"usage: inim {command} " not in ended.stdout
