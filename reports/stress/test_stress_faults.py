"""Planted faults: each text occurs once, and a planted fault is found and removed again."""

import json
import pathlib

import pytest

from reports.stress import faults
from reports.stress.planted import FAULTS

CATEGORIES = {
    "sign", "half", "type", "off by one", "axes", "guard", "rounding", "constant", "unit",
    "branch", "weight", "stale",
}  # fmt: skip


def test_every_text_occurs_once_and_every_kind_of_fault_is_there():
    for fault in FAULTS:
        text = (faults.ROOT / "inim" / fault.file).read_text("utf-8")
        assert text.count(fault.old) == 1 and fault.old != fault.new, fault
        compile(text.replace(fault.old, fault.new), fault.file, "exec")
    assert {fault.category for fault in FAULTS} == CATEGORIES
    assert len(FAULTS) >= 80 and sum(f.is_rare for f in FAULTS) >= len(FAULTS) / 2


def test_unit_tests_of_a_module_are_those_that_import_it():
    names = {path.name for path in faults.test_files("inim.display.layouts.lenticular")}
    assert "test_lenticular.py" in names
    assert "test_ssim.py" not in names


def test_a_fault_is_planted_and_removed_with_its_time_stamp(tmp_path):
    fault = FAULTS[0]
    path = tmp_path / "copy" / "inim" / fault.file
    path.parent.mkdir(parents=True)
    path.write_text(f"before {fault.old} after", "utf-8")
    stamp = path.stat().st_mtime_ns
    for module in faults.planted(tmp_path / "copy", fault):
        assert module == "inim.display.display"
        assert path.read_text("utf-8") == f"before {fault.new} after"
    assert path.read_text("utf-8") == f"before {fault.old} after"
    assert path.stat().st_mtime_ns == stamp


@pytest.mark.slow
def test_a_fault_of_a_constant_is_found_by_all_columns(tmp_path, monkeypatch):
    monkeypatch.setattr(faults, "STORED", tmp_path / "faults.json")
    monkeypatch.setattr(faults, "write_table", lambda _: None)
    assert faults.main(["--only", "image/color.py"]) == 0
    results = json.loads(pathlib.Path(tmp_path / "faults.json").read_text("utf-8"))
    assert len(results) == 2
    assert all(r[column] for column in faults.COLUMNS for r in results.values())
