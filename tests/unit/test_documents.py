"""The documents keep to the program: what drifts is found here, without running anything slow.

Expected: every command parses, every block of Python compiles, every link leads somewhere, README
is short, pages quote the examples that the tests run, each picture of the gallery has complete
code, and the Python reference has all public names.
"""

import argparse
import ast
import builtins
import re
import shlex
from importlib import import_module
from pathlib import Path

import pytest

import inim
from inim.cli.main import COMMANDS
from inim.system import errors
from reports.gallery.examples import Example, read_examples
from tests.documents import ROOT, blocks, check_syntax, commands, pages

EXAMPLES = ROOT / "tests" / "example_package"
MOST_CHARACTERS_OF_README = 7_000
GALLERY = "docs/gallery.md"
MOST_LINES_OF_AN_EXAMPLE = 15
MOST_BYTES_OF_THE_GALLERY = 300_000
_LINK = re.compile(r"\]\(([^)\s]*)\)")
_CODE = re.compile(r"```.*?```|`[^`\n]*`", re.S)


def parser_of(name: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(exit_on_error=False)
    import_module(COMMANDS[name]).COMMANDS[name].add_arguments(parser)
    return parser


@pytest.mark.parametrize("page", pages())
def test_its_commands_are_the_program_s(page):
    for block in blocks(page):
        for line in commands(block) if block.language == "sh" else ():
            words = shlex.split(re.split(r"\s(?:\|\||&&|[|>])\s", line)[0])
            if words[:2] == ["python", "-m"] and words[2].startswith("inim."):
                words = ["inim", words[2].removeprefix("inim."), *words[3:]]
            if words[0] == "inim" and not words[1].startswith("-"):
                parser_of(words[1]).parse_args(words[2:])


@pytest.mark.parametrize("page", pages())
def test_its_blocks_compile_and_its_exceptions_have_a_reason(page):
    for block in blocks(page):
        if block.language == "python":
            check_syntax(block)
        assert block.language in {"sh", "python", "text", "toml", "sql", "xml", "json", "yaml"} or (
            block.language.startswith("{")
        ), block
        assert block.not_run is None or len(block.not_run) > 10, block


@pytest.mark.parametrize("page", pages())
def test_its_links_lead_somewhere(page):
    text = _CODE.sub("", (ROOT / page).read_text("utf-8"))
    for target in _LINK.findall(text):
        if not re.match(r"[a-z]+:", target) and not target.startswith("#"):
            path = (ROOT / page).parent / target.partition("#")[0]
            generated = "generated" in path.parts
            assert generated or path.exists() or path.with_suffix(".ipynb").exists(), target


def test_readme_is_short():
    assert len((ROOT / "README.md").read_text("utf-8")) <= MOST_CHARACTERS_OF_README


def test_every_picture_of_the_gallery_has_an_example_whose_code_writes_it():
    examples, folder = read_examples(), ROOT / "docs/images/gallery"
    pictures = re.findall(r"\]\((images/.+)\)", (ROOT / GALLERY).read_text("utf-8"))
    assert pictures == [example.picture for example in examples] and len(pictures) > 10
    assert {path.name for path in folder.iterdir()} == {f"{e.name}.webp" for e in examples}
    assert sum(path.stat().st_size for path in folder.iterdir()) < MOST_BYTES_OF_THE_GALLERY
    code = [block.text for block in blocks(GALLERY) if block.not_run is None]
    assert code == [example.code for example in examples]


@pytest.mark.parametrize("example", read_examples(), ids=lambda example: example.name)
def test_an_example_of_the_gallery_is_short_and_needs_no_other(example: Example):
    lines = [line for line in example.code.splitlines() if line and "import" not in line]
    assert len(lines) <= MOST_LINES_OF_AN_EXAMPLE
    if example.language == "python":
        assert names_without_definition(example.code) == set()


def names_without_definition(code: str) -> set[str]:
    names = [node for node in ast.walk(ast.parse(code)) if isinstance(node, ast.Name)]
    imports = [n for n in ast.walk(ast.parse(code)) if isinstance(n, ast.Import | ast.ImportFrom)]
    defined = {node.id for node in names if isinstance(node.ctx, ast.Store)}
    defined |= {a.asname or a.name.partition(".")[0] for node in imports for a in node.names}
    return {node.id for node in names} - defined - set(dir(builtins))


def test_the_python_reference_has_all_public_names():
    text = "".join(p.read_text("utf-8") for p in (ROOT / "docs/reference").glob("python-*.md"))
    described = set(re.findall(r"^\.\. auto\w+:: inim\.(\w+)$", text, re.M))
    assert described == set(inim.__all__) - {"__version__"}


def test_exit_codes_are_the_program_s():
    text = (ROOT / "docs/reference/exit-codes.md").read_text("utf-8")
    for name, value in vars(errors).items():
        if name.startswith("EXIT_"):
            assert f"| {value} |" in text, name


@pytest.mark.parametrize(
    ("page", "example"),
    [
        ("own-algorithm", "inim_example.py"),
        ("own-lens-model", "inim_example_lens.py"),
        ("own-metric", "inim_example_metric.py"),
    ],
)
def test_example_is_the_one_that_the_tests_run(page, example):
    text = (EXAMPLES / example).read_text("utf-8")
    assert text in [block.text for block in blocks(f"docs/how-to/{page}.md")]


def test_the_documents_workflow_runs_the_contributors_commands():
    steps = (ROOT / ".github/workflows/docs.yml").read_text("utf-8")
    for target in ("make docs", "make test-docs"):
        assert target in steps
    assert f"{target}:".removeprefix("make ") in Path(ROOT / "Makefile").read_text("utf-8")
