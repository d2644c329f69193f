"""Plant the faults of `reports.stress.planted`, one at a time, and list what finds each.

``python -m reports.stress.faults`` copies the package twice, and plants one fault at a time in each
copy. There it runs all relations of `inim stress --quick` that reach the changed module, those of
the full run if none of them is broken, the unit tests that import the module up to the first that
fails, and a validation of the jade disc against the baseline of the sound package. Results are kept
in ``out/stress/faults.json``, from which it writes ``reports/stress/faults.md``.
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
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import Queue
from typing import Any

from inim.report.summary import markdown_section
from inim.system.cache import value_digest
from reports.stress.planted import FAULTS, Fault

ROOT = Path(__file__).parents[2]
WORK = ROOT.parent if ROOT.name.startswith("copy") else ROOT / "out" / "stress"
STORED = WORK / "faults.json"
# Seconds after which a run counts as found: a fault must not hang a check.
_LONGEST = {"quick": 300, "full": 600, "tests": 300, "baseline": 120}
COLUMNS = ("quick", "full", "tests", "baseline")
_VALIDATION = (
    "-W", "ignore", "-m", "inim.validate", "scenes/jade.xml", "-D", "inim.lens_columns=16",
    "-D", "inim.lens_rows=16", "--algorithms", "template,wang2024,gu2020,li2012",
    "--viewpoints", "centre", "-D", "inim.capture_spp=16", "-D", "inim.eia_spp=16",
    "-D", "inim.view_spp=32", "--quiet",
)  # fmt: skip


# -- inside the copy ----------------------------------------------------------------------------


def check_relations(module: str, effort: str) -> list[str]:
    """Names of the broken relations among those that reach a module; the first of a full run."""
    from inim.apps.stress.relation import FULL, QUICK, run_relation
    from inim.apps.stress.run import StressRequest
    from inim.render import variant

    timed = effort == "costs"
    costs = {} if timed else json.loads((WORK / "costs.json").read_text())
    chosen = [
        (relation, subject)
        for relation, subject in StressRequest(Path("unused")).chosen_relations()
        if timed or (relation.reaches(module) and _uses(subject, module))
    ]
    chosen.sort(key=lambda pair: costs.get(f"{pair[0].name}|{pair[1]}", 1.0))
    if any(relation.topic in ("rays", "views") for relation, _ in chosen):
        variant.use("llvm")
    broken = []
    for relation, subject in chosen:
        result = run_relation(relation, subject, FULL if effort == "full" else QUICK)
        costs[f"{relation.name}|{subject}"] = result.seconds
        if not result.passed:
            broken.append(f"{relation.name}{f' ({subject})' if subject else ''}")
            if effort == "full":
                break
    if timed:
        (WORK / "costs.json").write_text(json.dumps(costs))
    return broken


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
    texts = {p: p.read_text("utf-8") for p in (ROOT / "inim" / "generators").rglob("*.py")}
    while changed != before:
        before = set(changed)
        for path, text in texts.items():
            name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
            if any(f"from {c} import" in text for c in before):
                changed.add(name)
    stems = tuple(f"{name.rpartition('.')[2]}." for name in changed)
    for file in folder.rglob("*.nb?"):
        if file.name.startswith(stems):
            file.unlink()


# -- outside ------------------------------------------------------------------------------------


def _run(copy: Path, words: Sequence[str], seconds: float) -> tuple[int, str]:
    """Exit code and output of a command in a copy, messages first; 124 if it takes too long."""
    environment = os.environ | {
        "PYTHONPATH": str(copy), "XDG_CACHE_HOME": str(copy / "cache"), "INIM_CACHE": "off",
        "NUMBA_CACHE_DIR": str(copy / "cache" / "inim" / "kernels"),
        "PYTHONDONTWRITEBYTECODE": "1",
    }  # fmt: skip
    try:
        ended = subprocess.run(
            [sys.executable, *words], cwd=copy, env=environment, timeout=seconds, text=True,
            capture_output=True, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return 124, "takes too long"
    return ended.returncode, ended.stderr + ended.stdout


def _last_line(code: int, output: str) -> list[str]:
    return [output.strip().rpartition("\n")[2][:150] or f"ends with {code}"]


def _relations(copy: Path, module: str, effort: str) -> list[str]:
    words = ("-W", "ignore", "-m", "reports.stress.faults", "--inside", module, effort)
    code, output = _run(copy, words, _LONGEST.get(effort, 3600))
    if code == 0:
        broken: list[str] = json.loads(output.strip().rpartition("\n")[2])
        return broken
    return _last_line(code, output)


def _tests(copy: Path, module: str) -> list[str]:
    files = [str(path.relative_to(ROOT)) for path in test_files(module)]
    if not files:
        return []
    words = ("-m", "pytest", "-x", "-q", "-m", "not slow", "-p", "no:cacheprovider", *files)
    code, output = _run(copy, words, _LONGEST["tests"])
    if code in (0, 5):
        return []
    failed = re.search(r"^(?:FAILED|ERROR) (\S+)", output, re.MULTILINE)
    return [failed[1].rpartition("/")[2]] if failed else _last_line(code, output)


def _baseline(copy: Path) -> list[str]:
    """Checks that fail against the baseline of the sound package, or why the run ends."""
    out = copy / "out" / "jade"
    shutil.rmtree(out, ignore_errors=True)
    words = (*_VALIDATION, "--baseline", str(WORK / "baseline"), "-o", str(out))
    code, output = _run(copy, words, _LONGEST["baseline"])
    if code == 0:
        return []
    if code != 1:
        return _last_line(code, output)
    checks = json.loads((out / "report.json").read_text())["verdict"]["checks"]
    return [check["name"] for check in checks if not check["passed"]]


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


def prepare_copies() -> None:
    """Copy the package and its tests, compile its kernels, time relations, make a baseline."""
    first, *others = copies()
    for name in ("inim", "tests", "reports", "pyproject.toml", "docs", "scenes", "README.md"):
        source, target = ROOT / name, first / name
        if source.is_dir():
            shutil.copytree(source, target, dirs_exist_ok=True, symlinks=True,
                            ignore=shutil.ignore_patterns("__pycache__", "out"))  # fmt: skip
        elif source.exists():
            shutil.copy2(source, target)
    if broken := _relations(first, "inim", "costs"):
        sys.exit(f"faults: the copy does not run: {broken}")
    accept = ("-m", "inim", "accept", "out/jade", "--reason", "sound", "-o", f"{WORK}/baseline")
    for words in ((*_VALIDATION, "-o", "out/jade"), accept):
        code, output = _run(first, words, 600)
        if code:
            sys.exit(f"faults: {words}: {output}")
    folders = sorted((first / "cache" / "inim" / "kernels").glob("inim-*"), key=os.path.getmtime)
    shutil.copytree(folders[-1], WORK / "kernels")
    for copy in others:
        shutil.copytree(first, copy, symlinks=True)


def copies() -> list[Path]:
    """Folders of the copies, one for each core of a small machine."""
    return [WORK / "copy-1", WORK / "copy-2"]


def planted(copy: Path, fault: Fault) -> Iterator[str]:
    """Plant a fault in a copy while the caller works, and remove it afterwards."""
    path = copy / "inim" / fault.file
    text, stamp = path.read_text("utf-8"), path.stat()
    if text.count(fault.old) != 1:
        sys.exit(f"faults: {fault.file} has {text.count(fault.old)} times: {fault.old}")
    kernels = copy / "cache" / "inim" / "kernels"
    before = set(kernels.glob("inim-*"))
    path.write_text(text.replace(fault.old, fault.new), "utf-8")
    try:
        yield "inim." + fault.file.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
    finally:
        path.write_text(text, "utf-8")
        os.utime(path, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
        for folder in set(kernels.glob("inim-*")) - before:
            shutil.rmtree(folder, ignore_errors=True)


def run_fault(copy: Path, fault: Fault, columns: Sequence[str], result: dict[str, Any]) -> None:
    """Fill in what finds a fault; relations of a full run only if quick ones do not."""
    for module in planted(copy, fault):
        _run(copy, ("-m", "reports.stress.faults", "--inside", module, "kernels"), 60)
        for column in columns:
            if column in result:
                continue
            started = time.perf_counter()
            if column == "tests":
                result[column] = _tests(copy, module)
            elif column == "baseline":
                result[column] = _baseline(copy)
            else:
                result[column] = result.get("quick") or _relations(copy, module, column)
            result[f"{column}_s"] = round(time.perf_counter() - started, 1)


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
    parser.add_argument("--keep-copies", action="store_true", help="use the copies as they are")
    args = parser.parse_args(words)
    if args.inside:
        module, effort = args.inside
        _kernels_of(module)
        print(json.dumps([] if effort == "kernels" else check_relations(module, effort)))
        return 0
    if not args.keep_copies:
        for folder in (*copies(), WORK / "kernels", WORK / "baseline"):
            shutil.rmtree(folder, ignore_errors=True)
        prepare_copies()
    stored: dict[str, dict[str, Any]] = json.loads(STORED.read_text()) if STORED.exists() else {}
    columns = args.columns.split(",")
    free: Queue[Path] = Queue()
    for copy in copies():
        free.put(copy)

    def run(fault: Fault) -> dict[str, Any]:
        result = stored.get(fault_key(fault), {})
        if args.again:
            result = {k: v for k, v in result.items() if v or k not in columns}
        if not set(columns) <= result.keys():
            copy = free.get()
            try:
                run_fault(copy, fault, columns, result)
            finally:  # the others wait for it
                free.put(copy)
        return result

    faults = [f for f in FAULTS if args.only in f.file and not f.equivalent]
    with ThreadPoolExecutor(len(copies())) as pool:
        for fault, result in zip(faults, pool.map(run, faults), strict=True):
            stored[fault_key(fault)] = result
            STORED.write_text(json.dumps(stored, indent=1))
            verdict = " | ".join(f"{c}: {', '.join(result[c]) or '-'}" for c in columns)
            print(f"{fault.file}: {fault.description} | {verdict}", flush=True)
    write_table(stored)
    return 0


def write_table(stored: Mapping[str, Mapping[str, Any]]) -> None:
    """Write what finds each fault, and the shares, as Markdown."""
    rows, counts = [], {column: [0, 0] for column in (*COLUMNS, "all together")}
    for fault in FAULTS:
        result = stored.get(fault_key(fault), {})
        cells = {c: result.get(c) for c in COLUMNS}
        columns_run = {} if fault.equivalent else {c: v for c, v in cells.items() if v is not None}
        for column, value in {**columns_run, "all together": any(columns_run.values())}.items():
            counts[column][0] += bool(value)
            counts[column][1] += bool(columns_run)
        texts = ["not run" if v is None else _cell(v) for v in cells.values()]
        if fault.equivalent:
            texts = [f"equivalent: {fault.equivalent}"] * len(texts)
        rows.append([fault.file, fault.description, fault.category, "rare" * fault.is_rare, *texts])
    heads = ["module", "fault", "kind", "", "quick stress", "stress", "unit tests", "baseline"]
    shares = [f"{column}: {n} of {total}" for column, (n, total) in counts.items() if total]
    text = [
        "# Planted faults",
        "What finds each fault first, by `python -m reports.stress.faults`. A full run of "
        "`inim stress` includes the quick one.",
        "Found: " + ", ".join(shares or ["none was run in all columns"]) + ".",
        markdown_section("Faults", heads, rows),
    ]
    (ROOT / "reports" / "stress" / "faults.md").write_text("\n\n".join(text) + "\n", "utf-8")


def _cell(checks: Sequence[str]) -> str:
    if not checks:
        return "**escapes**"
    return checks[0] + f" and {len(checks) - 1} more" * (len(checks) > 1)


if __name__ == "__main__":
    sys.exit(main())
