"""The README says what the program does; what can drift is checked."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import inim
from inim.settings import setting_table

README = Path(__file__).parents[2] / "README.md"


@pytest.fixture(scope="module")
def readme():
    return README.read_text(encoding="utf-8")


def test_the_table_of_settings_is_the_program_s_own(readme):
    shown = readme.split("<!-- settings -->")[1].split("<!-- /settings -->")[0].strip()
    assert shown == setting_table(), "paste the output of `inim settings`"


def test_every_public_name_it_uses_exists(readme):
    used = set(re.findall(r"inim\.([A-Za-z]\w*)\(", readme)) | {"DISPLAYS"}
    assert {"Display", "RGBD", "Viewpoint", "generate", "reconstruct", "validate"} <= used
    for name in used:
        assert callable(getattr(inim, name)) or name == "DISPLAYS"


def test_its_exit_codes_are_the_program_s(readme):
    from inim import errors

    for name, value in vars(errors).items():
        if name.startswith("EXIT_"):
            assert f"| {value} |" in readme, name
