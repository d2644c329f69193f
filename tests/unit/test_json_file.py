"""The door for documents: whatever is no report, or not one as its schema says, is one line."""

from __future__ import annotations

import copy
import hashlib
import io
import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from inim.errors import BaselineError, FileError
from inim.regression import BASELINE, read_statistics
from inim.report import Report
from tests.schemas import completed

SOUND = completed(
    "report",
    {
        "viewpoints": [{"name": "centre", "position_mm": [0.0, 0.0, 400.0]}],
        "algorithms": {"template": {"views": {"centre": {}}, "precision": {"centre": {}}}},
        "ceiling": {"views": {"centre": {}}, "precision": {"centre": {}}},
        "not_finite": [],
    },
)


def refusal(folder: Path, content: Any) -> str:
    """What is said of a `report.json`."""
    text = content if isinstance(content, (str, bytes)) else json.dumps(content)
    path = folder / "report.json"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    with pytest.raises(FileError) as caught:
        Report.load(folder)
    said = str(caught.value)
    assert said.startswith(f"{path}: ") and said.endswith("; make it anew with inim validate")
    assert "\n" not in said and len(said) < len(str(path)) + 250
    return said


def changed(**changes: Any) -> dict[str, Any]:
    return {**copy.deepcopy(SOUND), **changes}


def test_a_sound_one_is_read(tmp_path: Path) -> None:
    (tmp_path / "report.json").write_text(json.dumps(SOUND))
    assert Report.load(tmp_path).data == SOUND


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("", "not a JSON document"),
        (b"\xff\xfe", "not a JSON document"),
        ("[" * 100_000, "nested too deeply"),
        ('{"a":' * 100_000, "nested too deeply"),
        (json.dumps(SOUND)[:-1] + f', "title": {"[" * 500}{"]" * 500}' + "}", "title: is a list"),
        ("[]", "schema is null, not inim.report/1 or inim.picture/1"),
        ({"schema": "inim.report/9"}, "schema is 'inim.report/9'"),
        ({"schema": ["inim.report/1"]}, "schema is a list"),
        ({"schema": "inim.report/1"}, "the document: title is missing"),
        (changed(viewpoints=None), "viewpoints: is null, not of type array"),
        (changed(title=7), "title: is 7, not of type string"),
        (changed(mine=1), "the document: 'mine' is no key of it"),
        (changed(title="x" * 10**6, lens_model=1), "lens_model: is 1"),
        (changed(warnings=["x" * 10**6, {"x": 1}]), "warnings.1: is an object"),
        (changed(algorithms={"a": {}}), "algorithms.a: eia is missing"),
        (json.dumps(SOUND).replace("400.0", "NaN"), "NaN is no finite number"),
        (json.dumps(SOUND).replace("400.0", "1e999"), "1e999 is no finite number"),
        (json.dumps(SOUND).replace("400.0", "9" * 5000), "a whole number of 5000 digits"),
        ("[" + "0," * 300_001 + "0]", "of 300001 values; at most 300000"),
        (changed(warnings=["x" * 2**24]), "at most 16 MiB are read"),
    ],
)  # fmt: skip
def test_what_is_none_is_told_where_and_in_one_line(
    content: Any, said: str, tmp_path: Path
) -> None:
    assert said in refusal(tmp_path, content)


def test_a_whole_number_is_no_float(tmp_path: Path) -> None:
    """JSON Schema takes 12.0 for an integer; nobody indexes with it."""
    wrong = changed()
    wrong["display"]["given"]["lens_columns"] = 12.0
    assert "display.given.lens_columns: is 12.0" in refusal(tmp_path, wrong)


@pytest.mark.parametrize("name", ["../secret", "a/b", "", ".", "a\0", "a\\b", "\ud800"])
def test_a_name_that_leads_out_of_the_folder_is_refused(name: str, tmp_path: Path) -> None:
    algorithm = SOUND["algorithms"]["template"]
    assert "names no file" in refusal(tmp_path, changed(algorithms={name: algorithm}))
    viewpoint = {**SOUND["viewpoints"][0], "name": name}
    assert "names no file" in refusal(tmp_path, changed(viewpoints=[viewpoint]))


def test_scores_of_a_viewpoint_that_is_not_there_are_refused(tmp_path: Path) -> None:
    viewpoint = {**SOUND["viewpoints"][0], "name": "left"}
    assert "'centre', which is no viewpoint" in refusal(tmp_path, changed(viewpoints=[viewpoint]))


def test_a_display_that_cannot_be_is_told_with_the_file(tmp_path: Path) -> None:
    wrong = changed()
    wrong["display"]["given"]["pitch_mm"] = -1.0
    (tmp_path / "report.json").write_text(json.dumps(wrong))
    with pytest.raises(FileError, match=r"report\.json: pitch_mm = -1"):
        Report.load(tmp_path).design()


# --- Baselines ----------------------------------------------------------------------------------


def npz(**members: bytes) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as out:
        for name, content in members.items():
            out.writestr(f"{name}.npy", content)
    return packed.getvalue()


def npy(shape: tuple[int, ...], descr: str = "<f4", values: bytes = b"") -> bytes:
    """A member whose header declares whatever it likes."""
    stream = io.BytesIO()
    about = {"descr": descr, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_2_0(stream, about)  # type: ignore[arg-type]
    return stream.getvalue() + values


def write_baseline(folder: Path, document: Mapping[str, Any], arrays: bytes) -> None:
    own = {"arrays_sha256": hashlib.sha256(arrays).hexdigest()}
    (folder / "baseline.json").write_text(json.dumps(completed("baseline", document) | own))
    (folder / "baseline.npz").write_bytes(arrays)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "no readable arrays"),
        (npz(a=b"no array"), "no readable arrays"),
        (npz(a=npy((10**12,))), "has 0 bytes for the shape (1000000000000,)"),
        (npz(a=npy((2**62, 4))), "bytes for the shape"),
        (npz(a=npy((-2, -3), values=b"\0" * 24)), "of shape (-2, -3)"),
        (npz(a=npy((1,), "|O", b"\x80\x04N.")), "holds object"),
        (npz(a=npy((1,), "<c8", b"\0" * 8)), "holds complex64"),
        (npz(a=bytes(2**26 + 1)), "unpacks to more than"),
        (npz(**{f"a{k}": b"" for k in range(20_001)}), "more than 20000 arrays"),
    ],
)
def test_arrays_that_are_none_are_refused_before_they_take_memory(
    content: bytes, said: str, tmp_path: Path
) -> None:
    write_baseline(tmp_path, {}, content)
    with pytest.raises(BaselineError) as caught:
        read_statistics(tmp_path, BASELINE)
    assert said in str(caught.value)
    assert "inim baseline accept" in str(caught.value)


@pytest.mark.parametrize("name", ["../outside", "/etc/x", "truth/../../x", "a\0"])
def test_a_baseline_s_picture_stays_in_the_report(name: str, tmp_path: Path) -> None:
    """Pictures of what changed are written under its name."""
    write_baseline(tmp_path, {"pictures": {name: {}}}, npz())
    with pytest.raises(BaselineError, match="lies outside the report"):
        read_statistics(tmp_path, BASELINE)
