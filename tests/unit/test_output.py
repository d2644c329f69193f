"""Output folders: what a run writes, replaces and deletes there.

Expected: a result appears whole or not at all; in an existing folder, only files that an earlier
run listed are replaced or deleted; whatever links, lists and files are in the way, nothing outside
the folder changes.
"""

import json
import os
import shutil
from concurrent.futures import ThreadPoolExecutor, wait
from pathlib import Path

import pytest

from inim.system.errors import FileError
from inim.system.process.locked_folder import lock_folder
from inim.system.worker.output import list_name, staging_folder

LIST = ".report-files.json"


def write_report(out: Path, **files: str) -> None:
    """Write a report as a run does."""
    with staging_folder(out) as staging:
        fill(staging, **files)


def fill(staging: Path, **files: str) -> None:
    for name, text in {"report.json": "{}", **files}.items():
        (staging / name).parent.mkdir(parents=True, exist_ok=True)
        (staging / name).write_text(text)


def tree(folder: Path) -> dict[str, str]:
    """All that is there, links unfollowed; files with their text."""
    contents = {}
    for place, folders, files in os.walk(folder):
        for name in [*folders, *files]:
            path = Path(place, name)
            kind = f"-> {path.readlink()}" if path.is_symlink() else "folder"
            text = path.read_text() if path.is_file() and not path.is_symlink() else kind
            contents[str(path.relative_to(folder))] = text
    return contents


def test_a_block_that_fails_changes_nothing(tmp_path):
    out = tmp_path / "out"
    write_report(out, **{"a.png": "first"})
    before = tree(tmp_path)
    with pytest.raises(ZeroDivisionError), staging_folder(out) as staging:
        fill(staging, **{"a.png": "second"})
        raise ZeroDivisionError
    assert tree(tmp_path) == before


def assert_refused(out: Path, message: str) -> None:
    """A run into this folder is refused before any work, and nothing changes."""
    before = tree(out.parent)
    with pytest.raises(FileError, match=message), staging_folder(out):
        raise AssertionError("the work begins")
    assert tree(out.parent) == before


@pytest.mark.parametrize(
    ("out", "message"),
    [("file", "file: is a file"), ("file/out", "cannot be written"), ("link", "is a file"),
     ("n" * 300, "File name too long")],
)  # fmt: skip
def test_place_that_cannot_hold_a_folder_is_refused_at_once(tmp_path, out, message):
    (tmp_path / "file").write_text("mine")
    (tmp_path / "link").symlink_to("nowhere")
    with pytest.raises(FileError, match=message), staging_folder(tmp_path / out):
        pass
    assert tree(tmp_path) == {"file": "mine", "link": "-> nowhere"}


def test_own_files_are_replaced_or_deleted_and_others_kept(tmp_path):
    out = tmp_path / "out"
    for names in (("a.png", "sub/b.png"), ("a.png", "sub/c.png")):
        write_report(out, **dict.fromkeys(names, names[1]))
        (out / "notes.txt").write_text("mine")
    contents = tree(out)
    assert contents.keys() == {"a.png", "sub", "sub/c.png", "report.json", "notes.txt", LIST}
    assert contents["a.png"] == "sub/c.png"
    assert json.loads(contents[LIST]) == ["a.png", "report.json", "sub/c.png"]
    assert list(tmp_path.iterdir()) == [out]


def test_folder_that_is_itself_a_link_is_the_user_s_choice(tmp_path):
    (tmp_path / "real").mkdir()
    out = tmp_path / "out"
    out.symlink_to("real")
    for text in ("first", "second"):
        write_report(out, **{"eia/a.png": text})
    assert out.is_symlink()
    assert (tmp_path / "real" / "eia" / "a.png").read_text() == "second"


def test_run_killed_while_it_moved_its_files_is_cleared_up_by_the_next(tmp_path, monkeypatch):
    """Kills at each move in turn: the folder has the old report, the new one, or none."""
    first = {"eia/old.png": "old", "report.html": "old"}
    second = {"eia/new.png": "new", "report.html": "new"}
    move, moves, outcomes = Path.replace, 0, []

    class KilledError(BaseException):
        pass

    def count(self: Path, target: Path) -> None:
        nonlocal moves
        if moves == 0:
            raise KilledError
        moves -= 1
        move(self, target)

    for kill_at in range(1, 9):
        out = tmp_path / f"out-{kill_at}"
        write_report(out, **first)
        (out / "notes.txt").write_text("mine")
        moves = kill_at
        with monkeypatch.context() as patch:
            patch.setattr(Path, "replace", count)
            try:
                write_report(out, **second)
            except KilledError:
                outcomes.append("none" if not (out / "report.json").exists() else "whole")
            else:
                break
        write_report(out, **{"eia/third.png": "third"})
        assert tree(out) == {
            "eia": "folder", "eia/third.png": "third", "report.json": "{}", "notes.txt": "mine",
            LIST: (out / LIST).read_text(),
        }  # fmt: skip
    assert outcomes == ["none", "none", "none", "whole"], "the last move is that of the list"


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
def test_link_to_a_folder_is_refused_before_any_work(tmp_path, elsewhere, place):
    out = tmp_path / "out"
    out.mkdir()
    (out / place).symlink_to(elsewhere)
    assert_refused(out, rf"out/{place}: is in the way.*choose another.* -o")


@pytest.mark.parametrize("kind", ["folder", "file", "nothing"])
@pytest.mark.parametrize("place", ["eia", "eia/deep", "eia/deep/a.png"])
def test_link_created_while_the_run_renders_is_not_followed(tmp_path, elsewhere, place, kind):
    out = tmp_path / "out"
    write_report(out, **{"eia/deep/a.png": "first"})
    path = out / place
    target = {"folder": elsewhere, "file": elsewhere / "a.png", "nothing": elsewhere / "gone"}
    with (
        pytest.raises(FileError, match=f"out/{place}: is in the way"),
        staging_folder(out) as staging,
    ):
        fill(staging, **{"eia/deep/a.png": "second"})
        shutil.rmtree(path) if path.is_dir() else path.unlink()
        path.symlink_to(target[kind])
        before = tree(out), tree(elsewhere)
    assert (tree(out), tree(elsewhere)) == before


# --- Files of other origin ----------------------------------------------------------------------


@pytest.mark.parametrize("name", ["report.json", "report.html", "junit.xml", "summary.md"])
@pytest.mark.parametrize("kind", ["file", "folder", "link"])
def test_file_in_the_report_s_place_is_named_before_any_work(tmp_path, elsewhere, name, kind):
    out = tmp_path / "out"
    out.mkdir()
    if kind == "file":
        (out / name).write_text('{"files": ["report.json"]}')
    elif kind == "folder":
        (out / name).mkdir()
    else:
        (out / name).symlink_to(elsewhere / "report.json")
    assert_refused(out, rf"out/{name}: is in the way.*remove it, or.* -o$")


@pytest.mark.parametrize(
    ("mine", "theirs"), [("views", "views/a"), ("page/mine", "page"), ("eia/a.png", "eia/a.png")]
)
def test_file_in_the_way_is_named_and_nothing_is_touched(tmp_path, mine, theirs):
    out = tmp_path / "out"
    write_report(out, **{"eia.png": "earlier"})
    with (
        pytest.raises(FileError, match=f"out/{theirs.split('/')[0]}.*: is in the way"),
        staging_folder(out) as staging,
    ):
        fill(staging, **{theirs: "new"})
        (out / mine).parent.mkdir(parents=True, exist_ok=True)
        (out / mine).write_text("mine")
        before = tree(out)
    assert tree(out) == before


# --- Lists by another hand ----------------------------------------------------------------------


def test_names_that_lead_outside_or_nowhere_delete_nothing(tmp_path, elsewhere):
    out = tmp_path / "out"
    out.mkdir()
    (out / "folder").mkdir()
    (out / "mine").write_text("precious")
    (out / "link").symlink_to(elsewhere)
    (out / "old.png").symlink_to(elsewhere / "old.png")
    os.mkfifo(out / "fifo")
    names = [
        "../elsewhere/old.png", str(elsewhere / "old.png"), "link/old.png", "old.png", "folder",
        "folder/../../elsewhere/old.png", "/mine", "", ".", "..", "mine/", "a\0b",
        "n" * 10_000, "n/" * 10_000, "n/" * 10_000 + "n", "fifo", "gone",
    ]  # fmt: skip
    (out / LIST).write_text(json.dumps(names))
    before = tree(tmp_path)
    write_report(out)
    after = tree(tmp_path)
    del before[f"out/{LIST}"]
    assert {name: after.get(name) for name in before} == before
    assert json.loads((out / LIST).read_text()) == ["report.json"]


@pytest.mark.parametrize("text", ["[" * 100_000, "[", "", "{}", "\0", "3", "[3]", '{"files": 3}'])
def test_damaged_list_is_refused(tmp_path, text):
    out = tmp_path / "out"
    out.mkdir()
    (out / LIST).write_text(text)
    assert_refused(out, r"report-files\.json: is in the way")


def test_check_of_a_folder_waits_while_another_run_publishes(tmp_path):
    """Between the list of files and the files, a run looks like one of other origin."""
    out = tmp_path / "out"
    out.mkdir()
    (out / "report.json").write_text("{}")

    def check() -> bool:
        with staging_folder(out):
            return True

    with ThreadPoolExecutor(1) as pool:
        with lock_folder(tmp_path):
            entered = pool.submit(check)
            assert not wait([entered], timeout=0.3).done
            (out / list_name("report.json")).write_text('["report.json"]')
        assert entered.result(timeout=10)
