"""Commands of the program: only the module of the named one is imported."""

import argparse
import json
import os
import pkgutil
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest

import inim.apps
import inim.cli
from inim.apps import APPS
from inim.cli.main import COMMANDS, _parser, _parsers, main
from inim.display import DISPLAYS
from inim.pipeline.options import default_out
from inim.system.errors import EXIT_CHECK_FAILED, EXIT_INTERNAL, EXIT_PASSED, EXIT_USAGE

#: Two screens of 50 lines.
MOST_LINES_OF_HELP = 100
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
        ("inim inspect ph", {"phone "}, {"nominal"}),
        ("inim inspect scenes/jad", {"scenes/jade.xml "}, {"phone"}),
        ("inim generate a.exr -D inim.gap", {"inim.gap_mm="}, {"inim.pitch_mm="}),
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


# --- Rules for all commands -----------------------------------------------------------------------


def parsers_with_out() -> Iterator[tuple[str, argparse.ArgumentParser, argparse.Action]]:
    """Commands and tasks of commands with -o: name, parser, and the option."""
    for name in COMMANDS:
        for parser in _parsers(_parser(name)):
            for action in parser._actions:
                if "-o" in action.option_strings:
                    yield parser.prog.partition(" ")[2], parser, action


def test_results_are_named_after_the_first_input_by_default():
    others = {"demo": "amphora-report", "accept": "that of the comparison", "inspect": "write none"}
    rule = {}
    for name, parser, action in parsers_with_out():
        positional = [a for a in parser._actions if not a.option_strings]
        first = (positional[0].metavar or positional[0].dest.upper()) if positional else ""
        words = others.get(name, f"({first})-\\w")
        assert re.search(f"default: {words}", action.help), (name, action.help)
        rule[name] = action
    assert len(rule) > 10 and others.keys() < rule.keys()
    assert default_out(Path("in/jade.xml"), "report") == Path("jade-report")
    assert default_out(Path(), "eia") == Path(f"{Path.cwd().name}-eia")


def test_every_option_is_part_of_a_document_or_a_workflow():
    root = Path(inim.cli.__file__).parents[2]
    folders = [root / name for name in ("docs", ".github")]
    files = [path for folder in folders for path in folder.rglob("*")] + [*root.iterdir()]
    files = [path for path in files if path.name != "CHANGELOG.md"]
    suffixes = (".md", ".yml", ".ipynb")
    used: set[str] = set()
    for path in files:
        if path.suffix in suffixes and "generated" not in path.parts and path.is_file():
            used.update(re.findall(r"(?<![\w-])--[a-z][a-z-]+", path.read_text("utf-8")))
    options = {
        option
        for name in COMMANDS
        for parser in _parsers(_parser(name))
        for action in parser._actions
        for option in action.option_strings
        if option.startswith("--")
    }
    assert len(options) > 80, "or this test looks at nothing"
    assert options - used == {"--version"}


@pytest.mark.parametrize("option", ["-a", "--algorithms", "--algorithm"])
@pytest.mark.parametrize("name", ["validate", "generate", "bench"])
def test_algorithms_have_one_option_in_all_commands(name, option):
    assert _parser(name).parse_args([name, "x", option, "li2012"]).algorithms == "li2012"


@pytest.mark.parametrize("name", COMMANDS)
def test_help_opens_with_a_sentence_and_an_example_and_is_short(name, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    parser = _parser(name)
    with pytest.raises(SystemExit):
        parser.parse_args([name, "--help"])
    text = capsys.readouterr().out
    usage, description, example, *_ = text.split("\n\n")
    assert usage.startswith(f"usage: inim {name} [options]")
    assert len(usage.split("\n")) == 1
    assert re.fullmatch(r"[A-Zi].*\.", description, re.DOTALL)
    assert "%%" not in text
    title, line = example.split("\n")
    assert title == "example:"
    parser.parse_args(shlex.split(line)[1:])
    assert len(text.split("\n")) <= MOST_LINES_OF_HELP


@pytest.mark.parametrize("words", [("info", "cache", "--debug"), ("--debug", "info", "cache")])
def test_debug_shows_the_traceback_of_any_command(words, monkeypatch, capsys):
    monkeypatch.setattr("inim.system.cache.open_store", lambda: 1 / 0)
    assert main(["info", "cache"]) == EXIT_INTERNAL
    assert "ZeroDivisionError: division by zero; run again with --debug" in capsys.readouterr().err
    with pytest.raises(ZeroDivisionError):
        main([*words])


@pytest.mark.parametrize("code", [EXIT_PASSED, EXIT_CHECK_FAILED])
def test_validate_opens_its_report_and_prints_it_as_json(code, tmp_path, monkeypatch, capsys):
    opened: list[str] = []
    document = {"title": "L\u00f6we\x7f", "scores": [0.1, 1e-05]}
    (tmp_path / "report.json").write_text(json.dumps(document), "utf-8")
    monkeypatch.setattr("webbrowser.open", opened.append)
    monkeypatch.setattr("inim.cli.validate._validate", lambda args: code if args.quiet else 9)
    assert main(["validate", "a.xml", "-o", str(tmp_path), "--json", "--open"]) == code
    assert json.loads(capsys.readouterr().out) == document
    assert opened == [(tmp_path / "report.html").as_uri()]


@pytest.mark.parametrize(
    ("variable", "is_terminal", "options", "opens"),
    [
        ("DISPLAY", True, (), True),
        ("WAYLAND_DISPLAY", True, (), True),
        ("DISPLAY", True, ("--no-open",), False),
        ("DISPLAY", False, (), False),
        ("TERM", True, (), False),
        ("TERM", False, ("--open",), True),
    ],
)
def test_view_opens_its_page_on_a_terminal_with_a_screen(
    variable, is_terminal, options, opens, tmp_path, monkeypatch
):
    opened: list[str] = []
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("webbrowser.open", opened.append)
    monkeypatch.setattr("inim.report.view_page.view_eia", lambda *_, **__: None)
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.setattr(sys.stdout, "isatty", lambda: is_terminal)
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv(variable, "1")
    assert main(["view", "goblet.png", *options]) == EXIT_PASSED
    assert opened == [(tmp_path / "goblet-view.html").as_uri()] * opens


def test_info_lists_every_preset_with_its_figures(capsys):
    assert main(["info", "displays"]) == EXIT_PASSED
    _, *lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == [*DISPLAYS]
    # 64 lenses of 1 mm, 17 pixels each: D = f g / (g - f) = 33 mm, and the depth range ends at
    # D +- D^2 / 17 g. The outermost lens, at 31.5 mm, shows no flipped view to an eye on the axis
    # at 31.5 * 2 g = 207.9 mm; the usual distance is twice that.
    figures = "64.0 x 64.0 1.000 13.6 to 52.4 +-31.5 at 416"
    assert lines[0].split() == ["nominal", *figures.split()]
