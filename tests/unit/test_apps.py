"""An application is removed by deleting its folder and its line in the table of applications.

Expected: the rest imports, and the commands and schemas of all others work. Type checkers also read
the names of public functions in `inim/__init__.py`.
"""

import ast
import shutil
import subprocess
import sys
from pathlib import Path

import inim
from inim.apps import APPS

PACKAGE = Path(inim.__file__).parent
# Loads what the package imports, then forks for each copy: imports all its modules, and every name
# that a function imports.
USE = """
import ast, importlib, os, sys, traceback
from pathlib import Path

def imported_in(path):
    tree = ast.parse(path.read_text("utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING":
            node.body = []
    froms = (node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom))
    return {node.module for node in froms if node.module.startswith("inim")}

def use():
    import inim
    assert Path(inim.__file__).parent.parent == Path.cwd()
    for module, (path, imported) in modules.items():
        if path.exists():
            for name in (module, *imported):
                importlib.import_module(name)
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

package, *copies = map(Path, sys.argv[1:])
modules = {}
for path in sorted(package.rglob("*.py")):
    local = path.relative_to(package.parent)
    module = ".".join(local.with_suffix("").parts).removesuffix(".__init__")
    if not module.endswith("__main__"):
        modules[module] = local, imported_in(path)
        importlib.import_module(module)
for name in [name for name in sys.modules if name.partition(".")[0] == "inim"]:
    del sys.modules[name]
for copy in copies:
    if os.fork() == 0:
        code = 1
        try:
            os.chdir(copy)
            sys.path[0], sys.stdout = str(copy), open("output", "w")
            use()
            sys.stdout.close()
            code = 0
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(code)
    if os.wait()[1]:
        sys.exit(f"{copy.name} is needed")
"""


def without(app: str, folder: Path) -> None:
    """Copy the package without an application into a folder."""
    shutil.copytree(PACKAGE, folder / "inim", ignore=shutil.ignore_patterns("*.nbi", "*.nbc"))
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


def test_the_rest_works_without_any_application(tmp_path):
    for app in APPS:
        without(app, tmp_path / app)
    ended = subprocess.run(
        [sys.executable, "-c", USE, PACKAGE, *(tmp_path / app for app in APPS)],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr[-2000:]
    for app, entry in APPS.items():
        usages = (tmp_path / app / "output").read_text()
        assert "usage: inim validate" in usages
        for command in entry["commands"]:
            assert f"usage: inim {command} " not in usages
