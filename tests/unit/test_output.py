"""Output folders: what is written there, and what of it may go.

Expected: a result appears whole or not at all; of what lies in its folder, only what the program
has put there is replaced, and only what is still as it was put there is deleted; whatever links,
lists and files stand in the way, nothing outside the folder changes.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from pathlib import Path

import pytest

from inim.errors import FileError
from inim.worker import output
from inim.worker.output import SCHEMA, open_staging, publish
from tests.schemas import read_document

REPORT = ".report-files.json"


def finished(out: Path, **files: str) -> Path:
    """A staging folder as a run leaves it."""
    staging = open_staging(out)
    for name, text in {"report.json": "{}", **files}.items():
        (staging / name).parent.mkdir(parents=True, exist_ok=True)
        (staging / name).write_text(text)
    return staging


def tree(folder: Path) -> dict[str, str]:
    """All that is there, links unfollowed; files with their text."""
    found = {}
    for place, folders, files in os.walk(folder):
        for name in [*folders, *files]:
            path = Path(place, name)
            kind = f"-> {path.readlink()}" if path.is_symlink() else "folder"
            text = path.read_text() if path.is_file() and not path.is_symlink() else kind
            found[str(path.relative_to(folder))] = text
    return found


# --- What is written ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("out", "says"),
    [("file", "file: is a file"), ("file/out", "cannot be written"), ("link", "is a file"),
     ("n" * 300, "File name too long")],
)  # fmt: skip
def test_place_that_cannot_hold_a_folder_is_refused_at_once(
    tmp_path: Path, out: str, says: str
) -> None:
    (tmp_path / "file").write_text("mine")
    (tmp_path / "link").symlink_to("nowhere")
    with pytest.raises(FileError, match=says):
        open_staging(tmp_path / out)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "link"]
    assert (tmp_path / "file").read_text() == "mine"


def test_longest_name_a_file_system_allows_can_be_written(tmp_path: Path) -> None:
    out = tmp_path / ("n" * 255)
    publish(finished(out), out)
    assert (out / "report.json").is_file()


def test_what_was_written_is_listed_with_its_digest(tmp_path: Path) -> None:
    out = tmp_path / "out"
    for text in ("first", "second"):
        publish(finished(out, **{"eia/a.png": text}), out)
        files = read_document(out / REPORT)["files"]
        assert files == {
            name: [hashlib.sha256((out / name).read_bytes()).hexdigest()]
            for name in ("eia/a.png", "report.json")
        }


def test_own_files_are_replaced_or_deleted_and_others_kept(tmp_path: Path) -> None:
    out = tmp_path / "out"
    for names in (("a.png", "sub/b.png"), ("a.png", "sub/c.png")):
        publish(finished(out, **dict.fromkeys(names, names[1])), out)
        (out / "notes.txt").write_text("mine")
    found = tree(out)
    assert found.keys() == {"a.png", "sub", "sub/c.png", "report.json", "notes.txt", REPORT}
    assert found["a.png"] == "sub/c.png"
    assert not list(tmp_path.glob(".*partial"))


def test_report_of_another_kind_in_the_same_folder_stays(tmp_path: Path) -> None:
    out = tmp_path / "out"
    publish(finished(out, **{"eia/a.png": "a"}), out)
    staging = open_staging(out, ["bench.json"])
    (staging / "bench.json").write_text("{}")
    publish(staging, out, "bench.json")
    publish(finished(out), out)
    assert {"report.json", "bench.json"} <= tree(out).keys()


def test_folder_that_is_itself_a_link_is_the_user_s_choice(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    out = tmp_path / "out"
    out.symlink_to("real")
    for text in ("first", "second"):
        publish(finished(out, **{"eia/a.png": text}), out)
    assert out.is_symlink()
    assert (tmp_path / "real" / "eia" / "a.png").read_text() == "second"


def test_run_killed_while_it_moved_its_files_is_cleared_up_by_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At each move in turn: what lies there is the old report, the new one, or none at all."""
    first = {"eia/old.png": "old", "report.html": "old"}
    second = {"eia/new.png": "new", "report.html": "new"}
    move, left, seen = os.replace, 0, []

    class Killed(BaseException):
        pass

    def count(*words: object, **options: object) -> None:
        nonlocal left
        if left == 0:
            raise Killed
        left -= 1
        move(*words, **options)  # type: ignore[arg-type]

    for kill_at in range(1, 9):
        out = tmp_path / f"out-{kill_at}"
        publish(finished(out, **first), out)
        (out / "notes.txt").write_text("mine")
        staging, left = finished(out, **second), kill_at
        with monkeypatch.context() as patch:
            patch.setattr(output.os, "replace", count)
            try:
                publish(staging, out)
            except Killed:
                seen.append("none" if not (out / "report.json").exists() else "old")
            else:
                break
        publish(finished(out, **{"eia/third.png": "third"}), out)
        assert tree(out) == {
            "eia": "folder", "eia/third.png": "third", "report.json": "{}", "notes.txt": "mine",
            REPORT: (out / REPORT).read_text(),
        }  # fmt: skip
    assert seen == ["none", "none", "none", "old"], "the last move is that of the list"


# --- Links --------------------------------------------------------------------------------------


@pytest.fixture
def elsewhere(tmp_path: Path) -> Path:
    """A folder of the user's, which no run may touch."""
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    for name in ("a.png", "report.json", "old.png"):
        (folder / name).write_text("precious")
    return folder


@pytest.mark.parametrize("place", ["eia", "views", "truth"])
def test_link_to_a_folder_is_refused_before_any_work(
    tmp_path: Path, elsewhere: Path, place: str
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / place).symlink_to(elsewhere)
    before = tree(tmp_path)
    with pytest.raises(FileError, match=rf"out/{place}: is in the way.*choose another.* -o"):
        open_staging(out)
    assert tree(tmp_path) == before


@pytest.mark.parametrize("kind", ["folder", "file", "nothing"])
@pytest.mark.parametrize("place", ["eia", "eia/deep", "eia/deep/a.png"])
def test_link_put_there_while_the_run_renders_leads_nowhere(
    tmp_path: Path, elsewhere: Path, place: str, kind: str
) -> None:
    out = tmp_path / "out"
    publish(finished(out, **{"eia/deep/a.png": "first"}), out)
    staging = finished(out, **{"eia/deep/a.png": "second"})
    path = out / place
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    target = {"folder": elsewhere, "file": elsewhere / "a.png", "nothing": elsewhere / "gone"}
    path.symlink_to(target[kind])
    before = tree(tmp_path)
    with pytest.raises(FileError, match=f"out/{place}: is in the way"):
        publish(staging, out)
    assert tree(tmp_path) == before


def test_link_put_there_at_the_last_moment_leads_nowhere(
    tmp_path: Path, elsewhere: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After all was looked at: by whatever name a file is reached, no link is followed."""
    out = tmp_path / "out"
    publish(finished(out, **{"eia/a.png": "first", "eia/old.png": "precious"}), out)
    staging = finished(out, **{"eia/a.png": "second"})
    look = output._check_way

    def then_link(folder: int, name: str, *rest: object) -> None:
        look(folder, name, *rest)  # type: ignore[arg-type]
        if name == "report.json":  # the last that is looked at
            (out / "eia").rename(tmp_path / "eia")
            (out / "eia").symlink_to(elsewhere)

    monkeypatch.setattr(output, "_check_way", then_link)
    with pytest.raises(FileError, match="cannot be written"):
        publish(staging, out)
    assert set(tree(elsewhere).values()) == {"precious"}
    assert tree(elsewhere).keys() == {"a.png", "old.png", "report.json"}
    assert tree(tmp_path / "eia") == {"a.png": "first", "old.png": "precious"}


# --- Files of other origin ----------------------------------------------------------------------


@pytest.mark.parametrize("name", ["report.json", "report.html", "junit.xml", "summary.md"])
@pytest.mark.parametrize("kind", ["file", "folder", "link"])
def test_what_stands_where_the_report_goes_is_named_before_any_work(
    tmp_path: Path, elsewhere: Path, name: str, kind: str
) -> None:
    """So is the report of an earlier version, which kept no list."""
    out = tmp_path / "out"
    out.mkdir()
    if kind == "file":
        (out / name).write_text('{"files": ["report.json"]}')
    elif kind == "folder":
        (out / name).mkdir()
    else:
        (out / name).symlink_to(elsewhere / "report.json")
    before = tree(tmp_path)
    with pytest.raises(FileError, match=rf"out/{name}: is in the way.*remove it, or.* -o$"):
        open_staging(out)
    assert tree(tmp_path) == before


@pytest.mark.parametrize(
    ("mine", "theirs"), [("views", "views/a"), ("page/mine", "page"), ("eia/a.png", "eia/a.png")]
)
def test_file_in_the_way_is_named_and_nothing_is_touched(
    tmp_path: Path, mine: str, theirs: str
) -> None:
    out = tmp_path / "out"
    publish(finished(out, **{"eia.png": "earlier"}), out)
    staging = finished(out, **{theirs: "new"})
    (out / mine).parent.mkdir(parents=True, exist_ok=True)
    (out / mine).write_text("mine")
    before = tree(out)
    with pytest.raises(FileError, match=f"out/{theirs.split('/')[0]}.*: is in the way"):
        publish(staging, out)
    assert tree(out) == before


def test_file_of_an_earlier_run_that_has_changed_is_not_deleted(tmp_path: Path) -> None:
    out = tmp_path / "out"
    publish(finished(out, **{"eia/a.png": "a", "eia/b.png": "b"}), out)
    (out / "eia" / "a.png").write_text("painted over")
    publish(finished(out), out)
    assert tree(out / "eia") == {"a.png": "painted over"}
    with pytest.raises(FileError, match=r"eia/a\.png: is in the way"):  # it is the user's now
        publish(finished(out, **{"eia/a.png": "new"}), out)


# --- Lists by another hand ----------------------------------------------------------------------


def test_what_a_report_says_of_its_files_deletes_nothing(tmp_path: Path) -> None:
    out = tmp_path / "out"
    publish(finished(out), out)
    (out / "mine").write_text("mine")
    (out / "report.json").write_text('{"files": ["mine", "../mine", "report.json"]}')
    (tmp_path / "mine").write_text("mine")
    publish(finished(out), out)
    assert (out / "mine").read_text() == (tmp_path / "mine").read_text() == "mine"


def test_names_that_lead_outside_or_nowhere_delete_nothing(tmp_path: Path, elsewhere: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "folder").mkdir()
    (out / "mine").write_text("precious")
    (out / "link").symlink_to(elsewhere)
    (out / "old.png").symlink_to(elsewhere / "old.png")
    os.mkfifo(out / "fifo")
    names = [
        "../elsewhere/old.png", str(elsewhere / "old.png"), "link/old.png", "old.png", "folder",
        "folder/../../elsewhere/old.png", "./mine", "/mine", "", ".", "..", "mine/", "a\0b",
        "n" * 10_000, "n/" * 10_000, "n/" * 10_000 + "n", "fifo", "gone",
    ]  # fmt: skip
    right = hashlib.sha256(b"precious").hexdigest()
    content = {"schema": SCHEMA, "files": {name: [right] for name in names}}
    (out / REPORT).write_text(json.dumps(content))
    before = tree(tmp_path)
    publish(finished(out), out)
    after = tree(tmp_path)
    assert {name: after.get(name) for name in before if name != f"out/{REPORT}"} == {
        name: text for name, text in before.items() if name != f"out/{REPORT}"
    }
    assert read_document(out / REPORT)["files"].keys() == {"report.json"}


@pytest.mark.parametrize(
    "text",
    ["[" * 100_000, "[", "", "{}", "[]", "\0", "3", f'{{"schema": "{SCHEMA}"}}',
     f'{{"schema": "{SCHEMA}", "files": []}}', f'{{"schema": "{SCHEMA}", "files": {{"a": 3}}}}',
     '{"schema": "inim.files/9", "files": {}}'],
)  # fmt: skip
def test_what_is_no_list_is_refused(tmp_path: Path, text: str) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / REPORT).write_text(text)
    with pytest.raises(FileError, match=r"report-files\.json: is in the way"):
        open_staging(out)
    assert tree(tmp_path) == {"out": "folder", f"out/{REPORT}": text}


@pytest.mark.parametrize("kind", ["folder", "fifo", "link"])
def test_list_that_is_no_file_is_refused(tmp_path: Path, elsewhere: Path, kind: str) -> None:
    out = tmp_path / "out"
    publish(finished(out), out)
    if kind == "link":
        (out / REPORT).rename(elsewhere / REPORT)
        (out / REPORT).symlink_to(elsewhere / REPORT)
    else:
        (out / REPORT).unlink()
        (out / REPORT).mkdir() if kind == "folder" else os.mkfifo(out / REPORT)
    before = tree(tmp_path)
    with pytest.raises(FileError, match=r"report-files\.json: is in the way"):
        open_staging(out)
    assert tree(tmp_path) == before
