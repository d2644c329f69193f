"""Commands of the program: only the module of the named one is imported."""

import os
import pkgutil
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import inim.apps
import inim.cli
from inim.apps import APPS
from inim.cli.main import COMMANDS, main
from inim.system.errors import EXIT_USAGE

HEAVY = ("numpy", "numba", "mitsuba", "drjit", "matplotlib", "PIL", "scipy", "trimesh")


def loaded_by(*words: str) -> set[str]:
    """Modules that a fresh process has imported once its command line is parsed."""
    code = (
        "import sys; from inim.cli.main import main\n"
        "try:\n    main(sys.argv[1:])\nexcept SystemExit:\n    pass\n"
        "print(*sorted(sys.modules), file=sys.stderr)"
    )
    ended = subprocess.run(
        [sys.executable, "-c", code, *words], capture_output=True, text=True, check=True
    )
    return set(ended.stderr.split())


def test_the_table_has_every_command_of_every_module():
    folders = {m.name for m in pkgutil.iter_modules(inim.apps.__path__)}
    assert folders == APPS.keys()
    modules = {f"inim.apps.{folder}.command" for folder in folders}
    modules |= {f"inim.cli.{m.name}" for m in pkgutil.iter_modules(inim.cli.__path__)}
    commands = {
        name: module
        for module in modules
        for name in getattr(import_module(module), "COMMANDS", ())
        if module != "inim.cli.main"
    }
    assert commands == COMMANDS


@pytest.mark.parametrize(
    "words", [("--help",), ("validate", "--help"), ("generate", "--help"), ("new-scene", "--help")]
)
def test_help_loads_no_large_module(words):
    assert loaded_by(*words).isdisjoint(HEAVY)


def test_only_the_named_command_is_imported():
    loaded = loaded_by("info", "--help") & set(COMMANDS.values())
    assert loaded == {"inim.cli.info"}


@pytest.mark.parametrize(
    ("word", "says"),
    [("validat", "did you mean validate?"), ("xyz", "new-scene"), ("", "validate")],
)
def test_unknown_command_is_one_line_that_names_those_there_are(capsys, word, says):
    with pytest.raises(SystemExit) as ended:
        main([word])
    assert ended.value.code == EXIT_USAGE
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"inim: error: {word}: no such command; ")
    assert says in line


@pytest.mark.parametrize(
    ("line", "proposed", "not_proposed"),
    [
        ("inim val", {"validate "}, {"view"}),
        ("inim validate a.xml --algorithms tem", {"template "}, {"wang2024"}),
        ("inim validate a.xml --algorithms gu2020,tem", {"gu2020,template "}, {"template "}),
        ("inim validate a.xml --display ph", {"phone "}, {"nominal"}),
        ("inim inspect phone --lens-model thi", {"thin", "thick"}, {"full"}),
        ("inim validate a.xml --viewpoints le", {"left "}, {"right"}),
        (
            "inim validate a.xml -D inim.pitch",
            {"inim.pitch_mm=", "inim.pitch_y_mm="},
            {"inim.gap_mm="},
        ),
        ("inim validate a.xml --allow-f", {"--allow-folder "}, {"--lazy"}),
    ],
)
def test_shells_complete_the_words_of_a_command(tmp_path, line, proposed, not_proposed):
    answer = tmp_path / "answer"
    variables = {
        "_ARGCOMPLETE": "1",
        "_ARGCOMPLETE_STDOUT_FILENAME": str(answer),
        "_ARGCOMPLETE_IFS": "\n",
        "_ARGCOMPLETE_SUPPRESS_SPACE": "0",
        "COMP_LINE": line,
        "COMP_POINT": str(len(line)),
        "COMP_TYPE": "9",
    }
    ended = subprocess.run(
        [sys.executable, "-m", "inim"], env=os.environ | variables, capture_output=True, check=False
    )
    assert (ended.stdout, ended.stderr) == (b"", b"")
    completions = set(answer.read_text().split("\n"))
    assert proposed <= completions
    assert not completions & not_proposed


@pytest.mark.parametrize("words", [("validate", "scenes/jade.xml"), ("info", "algorithms")])
def test_a_python_without_the_dependencies_is_refused_with_the_one_to_use(words):
    isolated = [sys.executable, "-I", "-S", "-c"]  # no site-packages
    root = str(Path(inim.cli.__file__).parents[2])
    code = f"import sys; sys.path.insert(0, {root!r}); from inim.cli.main import main; "
    code += "sys.exit(main())"
    ended = subprocess.run([*isolated, code, *words], capture_output=True, text=True, cwd=root)
    assert ended.returncode == EXIT_USAGE, ended.stderr
    assert ended.stderr.count("\n") == 1
    assert f"inim: error: {sys.executable} has no package " in ended.stderr
    assert ".venv/bin/python" in ended.stderr
