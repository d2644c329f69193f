"""Plant the faults of `reports.stress.planted`, one at a time, and list what finds each.

``python -m reports.stress.faults`` copies the package, and for each fault runs there the relations
of `inim stress` that reach the changed module, quick first, then in full, and the unit tests that
import it. It stops at the first that fails. Results are kept in ``out/stress/faults.json``, from
which it writes ``reports/stress/faults.md``.
"""

import argparse
import ast
import json
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from inim.report.summary import markdown_section
from inim.system.cache import value_digest
from reports.stress.planted import FAULTS, Fault

ROOT = Path(__file__).parents[2]
WORK = ROOT.parent if ROOT.name == "copy" else ROOT / "out" / "stress"
COPY, STORED = WORK / "copy", WORK / "faults.json"
# Seconds after which a run counts as found: a fault must not hang a check.
_LONGEST = {"quick": 900, "full": 1800, "tests": 900}
COLUMNS = ("quick", "full", "tests")


# -- inside the copy ----------------------------------------------------------------------------


def check_relations(module: str, effort: str) -> str:
    """Name of the first broken relation among those that reach a module; cheap ones first."""
    from inim.apps.stress.relation import FULL, QUICK, run_relation
    from inim.apps.stress.run import StressRequest
    from inim.render import variant

    request = StressRequest(Path("unused"))
    costs = json.loads((WORK / "costs.json").read_text()) if effort != "costs" else {}
    chosen = [
        (relation, subject)
        for relation, subject in request.chosen_relations()
        if effort == "costs" or (relation.reaches(module) and _uses(subject, module))
    ]
    chosen.sort(key=lambda pair: costs.get(f"{pair[0].name}|{pair[1]}", 1.0))
    if any(relation.topic in ("rays", "views") for relation, _ in chosen):
        variant.use("llvm")
    for relation, subject in chosen:
        result = run_relation(relation, subject, FULL if effort == "full" else QUICK)
        costs[f"{relation.name}|{subject}"] = result.seconds
        if effort != "costs" and not result.passed:
            return f"{relation.name}{f' ({subject})' if subject else ''}"
    if effort == "costs":
        (WORK / "costs.json").write_text(json.dumps(costs))
    return ""


def _uses(subject: str, module: str) -> bool:
    """False if an algorithm or a lens model certainly does not use a module."""
    name, own = subject.partition(":")[0], module.rpartition(".")[2]
    algorithms = ("gu2020", "wang2024", "li2012", "layered", "template")
    if module.startswith("inim.generators.raycast.") and not module.endswith("cells"):
        return name not in ("gu2020", "wang2024", "li2012")
    if own in algorithms or own in ("thin", "pinhole"):
        return name in (own, "")
    return True


def _kernels_of(module: str) -> None:
    """Take over the compiled kernels of all files that do not depend on a changed one."""
    from inim.system.backend.kernels import cache_folder

    folder, sound = cache_folder(), WORK / "kernels"
    if not sound.is_dir() or any(folder.iterdir()):
        return
    shutil.copytree(sound, folder, dirs_exist_ok=True)
    changed: set[str] = {module}
    before: set[str] = set()
    texts = {p: p.read_text("utf-8") for p in (COPY / "inim" / "generators").rglob("*.py")}
    while changed != before:
        before = set(changed)
        for path, text in texts.items():
            name = ".".join(path.relative_to(COPY).with_suffix("").parts)
            if any(f"from {c} import" in text for c in before):
                changed.add(name)
    stems = tuple(f"{name.rpartition('.')[2]}." for name in changed)
    for file in folder.rglob("*.nb?"):
        if file.name.startswith(stems):
            file.unlink()


# -- outside ------------------------------------------------------------------------------------


def _environment() -> dict[str, str]:
    return os.environ | {
        "PYTHONPATH": str(COPY), "XDG_CACHE_HOME": str(WORK / "cache"), "INIM_CACHE": "off",
        "NUMBA_CACHE_DIR": str(WORK / "cache" / "inim" / "kernels"),
        "PYTHONDONTWRITEBYTECODE": "1",
    }  # fmt: skip


def _run(words: Sequence[str], seconds: float) -> tuple[int, str]:
    """Exit code and output of a command in the copy; 124 if it takes too long."""
    try:
        ended = subprocess.run(
            [sys.executable, *words], cwd=COPY, env=_environment(), timeout=seconds, text=True,
            capture_output=True, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return 124, "takes too long"
    return ended.returncode, ended.stdout + ended.stderr


def _relations(module: str, effort: str) -> str:
    words = ("-W", "ignore", "-m", "reports.stress.faults", "--inside", module, effort)
    code, output = _run(words, _LONGEST.get(effort, 3600))
    if code == 0:
        return output.strip().rpartition("\n")[2].removeprefix("=")
    return output.strip().rpartition("\n")[2][:150] or f"ends with {code}"


def _tests(module: str) -> str:
    files = [str(path.relative_to(ROOT)) for path in test_files(module)]
    if not files:
        return ""
    words = ("-m", "pytest", "-x", "-q", "-m", "not slow", "-p", "no:cacheprovider", *files)
    code, output = _run(words, _LONGEST["tests"])
    if code in (0, 5):
        return ""
    failed = re.search(r"^(?:FAILED|ERROR) (\S+)", output, re.MULTILINE)
    return failed[1].rpartition("/")[2] if failed else output.strip().rpartition("\n")[2][:150]


def test_files(module: str) -> list[Path]:
    """Unit tests that import a module, or name the layout, lens model or algorithm that it is."""
    path = ROOT / Path(*module.split(".")).with_suffix(".py")
    if not path.exists():
        path = ROOT / Path(*module.split(".")) / "__init__.py"
    tree = ast.parse(path.read_text("utf-8"))
    own = {n.name for n in tree.body if isinstance(n, (ast.FunctionDef, ast.ClassDef))}
    package, _, name = module.rpartition(".")
    files = []
    for test in sorted((ROOT / "tests" / "unit").glob("test_*.py")):
        for node in ast.walk(ast.parse(test.read_text("utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module:
                names = {alias.name for alias in node.names}
                direct = node.module == module or (node.module == package and name in names)
                if direct or (module.startswith(node.module) and names & own):
                    files.append(test)
                    break
        else:
            # Layouts, lens models and algorithms are chosen by their names.
            if path.parent.name in ("layouts", "lens", "generators") and (
                f'"{name}' in test.read_text("utf-8")
            ):
                files.append(test)
    return [f for f in files if f.stem not in ("test_stress", "test_structure", "test_documents")]


def prepare_copy() -> None:
    """Copy the package and its tests, compile the kernels, and time the relations."""
    COPY.mkdir(parents=True, exist_ok=True)
    for name in ("inim", "tests", "reports", "pyproject.toml", "docs", "scenes", "README.md"):
        source, target = ROOT / name, COPY / name
        if source.is_dir():
            shutil.copytree(source, target, dirs_exist_ok=True, symlinks=True,
                            ignore=shutil.ignore_patterns("__pycache__", "out"))  # fmt: skip
        elif source.exists():
            shutil.copy2(source, target)
    broken = _relations("inim", "costs")
    if broken or not (WORK / "costs.json").exists():
        sys.exit(f"faults: the copy does not run: {broken}")
    folders = sorted((WORK / "cache" / "inim" / "kernels").glob("inim-*"), key=os.path.getmtime)
    shutil.rmtree(WORK / "kernels", ignore_errors=True)
    shutil.copytree(folders[-1], WORK / "kernels")


def planted(fault: Fault) -> Iterator[str]:
    """Plant a fault in the copy while the caller works, and remove it afterwards."""
    path = COPY / "inim" / fault.file
    text, stamp = path.read_text("utf-8"), path.stat()
    if text.count(fault.old) != 1:
        sys.exit(f"faults: {fault.file} has {text.count(fault.old)} times: {fault.old}")
    kernels = WORK / "cache" / "inim" / "kernels"
    before = set(kernels.glob("inim-*"))
    path.write_text(text.replace(fault.old, fault.new), "utf-8")
    try:
        yield "inim." + fault.file.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
    finally:
        path.write_text(text, "utf-8")
        os.utime(path, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
        for folder in set(kernels.glob("inim-*")) - before:
            shutil.rmtree(folder, ignore_errors=True)


def run_fault(fault: Fault, columns: Sequence[str], result: dict[str, Any]) -> dict[str, Any]:
    """Fill in what finds a fault; relations of a full run only if quick ones do not."""
    for module in planted(fault):
        for column in columns:
            if column in result:
                continue
            if column == "full" and result.get("quick"):
                result["full"] = result["quick"]
                continue
            started = time.perf_counter()
            result[column] = _tests(module) if column == "tests" else _relations(module, column)
            result[f"{column}_s"] = round(time.perf_counter() - started, 1)
    return result


def fault_key(fault: Fault) -> str:
    """Key of a fault's result."""
    return value_digest([fault.file, fault.old, fault.new])[:16]


def main(words: Sequence[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inside", nargs=2, metavar=("MODULE", "EFFORT"), help=argparse.SUPPRESS)
    parser.add_argument("--columns", default=",".join(COLUMNS), help="what to run")
    parser.add_argument("--only", default="", help="part of the file name of the faults to plant")
    parser.add_argument("--again", action="store_true", help="also those that are kept and escaped")
    parser.add_argument("--keep-copy", action="store_true", help="use the copy as it is")
    args = parser.parse_args(words)
    if args.inside:
        _kernels_of(args.inside[0])
        print(f"={check_relations(*args.inside)}")
        return 0
    if not args.keep_copy:
        prepare_copy()
    stored: dict[str, dict[str, Any]] = json.loads(STORED.read_text()) if STORED.exists() else {}
    columns = args.columns.split(",")
    for fault in FAULTS:
        key = fault_key(fault)
        result = stored.get(key, {})
        if args.again:
            result = {k: v for k, v in result.items() if v or k not in columns}
        if args.only not in fault.file or fault.equivalent or set(columns) <= result.keys():
            continue
        stored[key] = run_fault(fault, columns, result)
        STORED.write_text(json.dumps(stored, indent=1))
        verdict = " | ".join(f"{c}: {stored[key].get(c) or '-'}" for c in columns)
        print(f"{fault.file}: {fault.description} | {verdict}", flush=True)
    write_table(stored)
    return 0


def write_table(stored: Mapping[str, Mapping[str, Any]]) -> None:
    """Write what finds each fault, and the shares, as Markdown."""
    rows, counts = [], {column: [0, 0] for column in (*COLUMNS, "all together")}
    for fault in FAULTS:
        result = stored.get(fault_key(fault), {})
        cells = {c: result.get(c) for c in COLUMNS}
        if not fault.equivalent and all(value is not None for value in cells.values()):
            for column, value in {**cells, "all together": any(cells.values())}.items():
                counts[column][0] += bool(value)
                counts[column][1] += 1
        texts = ["not run" if v is None else v or "**escapes**" for v in cells.values()]
        if fault.equivalent:
            texts = [f"equivalent: {fault.equivalent}"] * len(texts)
        rows.append([fault.file, fault.description, fault.category, "rare" * fault.is_rare, *texts])
    heads = ["module", "fault", "kind", "", "quick stress", "stress", "unit tests"]
    shares = [f"{column}: {n} of {total}" for column, (n, total) in counts.items() if total]
    text = [
        "# Planted faults",
        "What finds each fault first, by `python -m reports.stress.faults`. A full run of "
        "`inim stress` includes the quick one.",
        "Found: " + ", ".join(shares or ["none was run in all columns"]) + ".",
        markdown_section("Faults", heads, rows),
    ]
    (ROOT / "reports" / "stress" / "faults.md").write_text("\n\n".join(text) + "\n", "utf-8")


if __name__ == "__main__":
    sys.exit(main())
