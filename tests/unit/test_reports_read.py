"""Reports and baselines that cannot be: each is refused with one line that names the file."""

import copy
import hashlib
import io
import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from inim.report import Report
from inim.report.document import ReportDocument
from inim.scores.regression.run_statistics import BASELINE, read_statistics
from inim.system.errors import BaselineError, FileError
from tests.schemas import completed

SOUND = completed(
    "report",
    {
        "viewpoints": [{"name": "centre", "position_mm": [0.0, 0.0, 400.0]}],
        "algorithms": {"template": {"views": {"centre": {}}, "precision": {"centre": {}}}},
        "reference": {"views": {"centre": {}}, "precision": {"centre": {}}},
        "noise_floor": {"views": {"centre": {}}},
        "scene": {},
        "misalign": "",
    },
)


def refusal(folder: Path, content: Any) -> str:
    """Message about a `report.json`."""
    text = content if isinstance(content, (str, bytes)) else json.dumps(content)
    path = folder / "report.json"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    with pytest.raises(FileError) as caught:
        Report.load(folder)
    message = str(caught.value)
    assert message.startswith(f"{path}: ") and message.endswith("; make it anew with inim validate")
    assert "\n" not in message and len(message) < len(str(path)) + 250
    return message


CHECK = {"name": "SSIM", "value": 0.9, "relation": ">=", "limit": 0.5, "passed": True, "detail": ""}


def changed(**changes: Any) -> dict[str, Any]:
    return {**copy.deepcopy(SOUND), **changes}


def test_a_sound_one_is_read(tmp_path):
    (tmp_path / "report.json").write_text(json.dumps(SOUND))
    assert Report.load(tmp_path).data == msgspec.convert(SOUND, ReportDocument)


@pytest.mark.parametrize("name", ["../secret", "a/b", "", ".", "a\0", "a\\b", "\udc80"])
def test_a_name_that_leads_out_of_the_folder_is_refused(name, tmp_path):
    algorithm = SOUND["algorithms"]["template"]
    assert "names no file" in refusal(tmp_path, changed(algorithms={name: algorithm}))
    viewpoint = {**SOUND["viewpoints"][0], "name": name}
    assert "names no file" in refusal(tmp_path, changed(viewpoints=[viewpoint]))


def test_scores_of_a_viewpoint_that_is_not_there_are_refused(tmp_path):
    viewpoint = {**SOUND["viewpoints"][0], "name": "left"}
    assert "has no scores of 'left'" in refusal(tmp_path, changed(viewpoints=[viewpoint]))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d["display"]["parameters"].update(pitch_mm=-1.0), "pitch_mm = -1"),
        (lambda d: d["display"]["parameters"].update(lens_columns=12.0), "got `float`"),
        (lambda d: d.update(misalign="text"), "misalign 'text': write KEY=NUMBER"),
        (lambda d: d.update(misalign="gap_mm=-99"), "misalign: "),
        (lambda d: d["timings"].pop("total"), "timings: total is missing"),
        (lambda d: d["reference"]["views"]["centre"].pop("ssim"), "ssim is missing"),
        (lambda d: d["verdict"].update(checks=[CHECK | {"value": None}]), "not a number"),
        (lambda d: d["verdict"].update(checks=[CHECK | {"passed": False}]), "checks failed"),
        (lambda d: d.update(schema="inim.report/1"), "is 'inim.report/1', not inim.report/2"),
        (lambda d: d.update(algorithms={"a": {}}), "missing required field `eia` - at"),
    ],
)
def test_report_that_cannot_be_is_refused_with_the_file(change, message, tmp_path):
    wrong = changed()
    change(wrong)
    assert message in refusal(tmp_path, wrong)


# --- Baselines ----------------------------------------------------------------------------------


def npz(**members: bytes) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as out:
        for name, content in members.items():
            # Without the time: parallel test runs name tests by these bytes.
            out.writestr(zipfile.ZipInfo(f"{name}.npy"), content, zipfile.ZIP_DEFLATED)
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
    ("content", "message"),
    [
        (b"", "no readable arrays"),
        (npz(a=b"no array"), "no readable arrays"),
        (npz(a=npy((10**12,))), "has 0 bytes for the shape (1000000000000,)"),
        (npz(a=npy((2**62, 4))), "bytes for the shape"),
        (npz(a=npy((-2, -3), values=b"\0" * 24)), "of shape (-2, -3)"),
        (npz(a=npy((1,), "|O", b"\x80\x04N.")), "holds object"),
        (npz(a=npy((1,), "<c8", b"\0" * 8)), "holds complex64"),
        ({"a": bytes(2**26 + 1)}, "unpacks to more than"),
        ({f"a{k}": b"" for k in range(20_001)}, "more than 20000 arrays"),
    ],
)
def test_invalid_arrays_are_refused_before_they_take_memory(content, message, tmp_path):
    packed = npz(**content) if isinstance(content, dict) else content
    write_baseline(tmp_path, {}, packed)
    with pytest.raises(BaselineError) as caught:
        read_statistics(tmp_path, BASELINE)
    assert message in str(caught.value)
    assert "inim accept" in str(caught.value)


@pytest.mark.parametrize("name", ["../outside", "/etc/x", "truth/../../x", "a\0"])
def test_a_baseline_s_picture_stays_in_the_report(name, tmp_path):
    """Pictures of what changed are written under its name."""
    write_baseline(tmp_path, {"pictures": {name: {}}}, npz())
    with pytest.raises(BaselineError, match="lies outside the report"):
        read_statistics(tmp_path, BASELINE)
