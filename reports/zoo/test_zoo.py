"""Public files of other people; INIM_ZOO names a folder that has them (`reports.zoo.expect`)."""

import json
import os
from pathlib import Path

import pytest

from reports.zoo.run import CRASHED, WRONG, ZOO, check_folder

FOLDER = os.environ.get("INIM_ZOO")


@pytest.mark.slow
@pytest.mark.skipif(FOLDER is None, reason="INIM_ZOO names no folder with public files")
def test_no_public_file_crashes_and_nearly_all_are_right():
    rows = check_folder(Path(str(FOLDER)))
    verdicts = [row[0] for row in rows]
    assert len(rows) > 300
    assert CRASHED not in verdicts
    assert verdicts.count(WRONG) < 0.03 * len(rows)


def test_every_file_has_a_place_a_digest_and_an_expectation():
    entries = [json.loads(line) for line in ZOO.read_text("utf-8").splitlines()]
    assert len(entries) >= 300
    assert len({(e["repository"], e["path"]) for e in entries}) == len(entries)
    assert all(len(entry["sha256"]) == 64 and "expected" in entry for entry in entries)
