"""The benchmark on two small cases: inputs, truth, scores, and mistakes that are named."""

import hashlib
import json
import math
import os
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs
from PIL import Image

from inim.apps.benchmark import definition, published, score
from inim.apps.benchmark.board import entries_of, read_results, write_board
from inim.apps.benchmark.definition import CONDITIONS, DISPLAYS, TIERS, case_of
from inim.apps.benchmark.document import StatisticsDocument, SubmissionDocument
from inim.apps.benchmark.make import MANIFEST, CaseJob, run_job
from inim.apps.benchmark.protocol import PROTOCOL
from inim.apps.benchmark.published import differs
from inim.apps.benchmark.run import RunJob
from inim.apps.benchmark.run import run_job as run_algorithm_job
from inim.apps.benchmark.score import ScoreJob, SubmissionError, plan_scores, score_case
from inim.apps.benchmark.submission import file_mistakes, write_submission
from inim.apps.benchmark.suite import made_cases
from inim.cli.main import main
from inim.display.misalignment import one_pixel_errors
from inim.image.color import linear_from_srgb, srgb_from_linear, to_srgb
from inim.image.files.image import read_exr_channels, write_exr
from inim.system.document import write_document
from inim.system.errors import EXIT_USAGE, FileError
from inim.system.process.observer import Observer

CASES = ("altar-sheet", "jade-phone")
SCENES = Path(__file__).parents[2] / "scenes"
SMALL = {"capture_spp": 8, "view_spp": 8, "reconstruction_spp": 16}


@pytest.fixture(scope="module")
def suite(tmp_path_factory):
    """Two cases with few lenses and samples."""
    folder = tmp_path_factory.mktemp("suite")
    with pytest.MonkeyPatch.context() as patch:
        for name in ("sheet", "phone"):
            small = DISPLAYS[name].replace(lens_columns=10, lens_rows=10)
            patch.setitem(definition.DISPLAYS, name, small)
            patch.setitem(definition.CONDITIONS, name, {**CONDITIONS[name], **SMALL})
        for name in ("altar", "jade"):
            relic = replace(definition.RELICS[name], eia_spp=8)
            patch.setitem(definition.RELICS, name, relic)
        for name in CASES:
            staging = folder / name
            staging.mkdir()
            job = CaseJob.of(case_of(name), SCENES / f"{name.split('-')[0]}.xml", 1, 1)
            run_job(job, staging, Observer())
        yield folder


@pytest.fixture(scope="module")
def template(suite, tmp_path_factory):
    return submission_of(suite, "template", tmp_path_factory.mktemp("template"))


def submission_of(suite, algorithm, folder):
    run_algorithm_job(RunJob(algorithm, made_cases(suite)), folder, Observer())
    return folder


def scored(suite, folder, out):
    """True if a submission passes, and the lines printed."""
    observer = Lines()
    out.mkdir(parents=True, exist_ok=True)
    try:
        score.run_job(plan_scores(suite, folder, as_is=False), out, observer)
    except SubmissionError as error:
        assert [f"mistake: {text}" for text in error.mistakes] == observer.lines
        return False, observer.lines
    return True, observer.lines


class Lines(Observer):
    def __init__(self):
        super().__init__()
        self.lines = []

    def line(self, text):
        self.lines.append(text)


def test_the_truth_scores_one_and_is_recognised(suite):
    for case in made_cases(suite):
        for blind in (False, True):
            truth = case.truth(blind=blind)
            result, _, is_copy = score_case(truth.eia.image, truth)
            assert result.headline == 1.0
            assert result.psnr_db == math.inf
            assert is_copy
            codes = linear_from_srgb(to_srgb(truth.eia.image) / np.float32(255))
            result, _, is_copy = score_case(codes, truth)
            assert result.headline > 0.98
            assert is_copy
            _, _, is_copy = score_case(np.roll(codes, 1, 0), truth)
            assert not is_copy


def test_the_rays_pass_the_lens_centres_of_their_pixels(suite):
    """The lens of a pixel follows from its column and row if a lens has 16 pixels."""
    channels = read_exr_channels(suite / "altar-sheet" / "input" / "rays.exr")
    columns = np.arange(160)
    centre = columns // 16 - 4.5
    pixel = (columns - 79.5) / 16
    for name in "RGB":
        np.testing.assert_allclose(channels[f"{name}.x"], np.tile(centre, (160, 1)), atol=1e-6)
        np.testing.assert_allclose(channels[f"{name}.y"][::-1].T, channels[f"{name}.x"], atol=1e-6)
        slope = (centre - pixel) / 3.3
        np.testing.assert_allclose(channels[f"{name}.right"][0], slope, atol=1e-6)


def test_a_point_has_one_place_in_all_pictures(suite):
    """A covered point of the middle picture projects to an equal depth in those of the corners,
    unless something is in front of it there.
    """
    folder = suite / "altar-sheet" / "input"
    document = json.loads((folder / "input.json").read_text())
    depths = [read_exr_channels(folder / p["depth"])["Z"] for p in document["pictures"]]
    alphas = [np.asarray(Image.open(folder / p["color"]))[..., 3] for p in document["pictures"]]
    rows, columns = depths[0].shape
    i, j = np.nonzero(alphas[0])
    z = depths[0][i, j]
    x = (j - (columns - 1) / 2) * document["pixel_mm"]
    y = ((rows - 1) / 2 - i) * document["pixel_mm"]
    for picture, depth, alpha in [*zip(document["pictures"], depths, alphas, strict=True)][1:]:
        column = np.rint((x - picture["right"] * z) / document["pixel_mm"] + (columns - 1) / 2)
        row = np.rint((rows - 1) / 2 - (y - picture["up"] * z) / document["pixel_mm"])
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        row, column = row[inside].astype(int), column[inside].astype(int)
        is_covered = alpha[row, column] > 0
        assert is_covered.mean() > 0.9  # a rim of a pixel is a twentieth of it
        behind = z[inside][is_covered] - depth[row, column][is_covered]
        # The range is 40 mm deep; pixels of steep surfaces differ by more.
        assert np.median(np.abs(behind)) < 1
        assert (behind < 4).mean() > 0.97


def test_deviations_are_within_a_pixel_and_differ_by_case_and_seed():
    draws = {}
    for name in TIERS["full"]:
        case = case_of(name)
        limits = one_pixel_errors(case.display)
        for seed in (1, 2):
            draw = case.misalignment(seed)
            assert draw == case.misalignment(seed)
            assert all(abs(value) <= limits[kind] for kind, value in draw.items())
            draws[name, seed] = tuple(draw.values())
    assert len(set(draws.values())) == len(draws)
    share = np.array([abs(d[2]) for d in draws.values()])
    assert share.min() < share.mean() / 3


def linear(path):
    return linear_from_srgb(np.asarray(Image.open(path)) / np.float32(255))


def half_a_lens(codes):
    return np.roll(codes, 8, axis=1)


def turned(codes):
    """Each elemental image of 16 pixels, rotated by 180 degrees."""
    rows, columns = (n - n % 16 for n in codes.shape[:2])
    whole = codes[:rows, :columns].reshape(rows // 16, 16, columns // 16, 16, 3)
    turned = codes.copy()
    turned[:rows, :columns] = whole[:, ::-1, :, ::-1].reshape(rows, columns, 3)
    return turned


def encoded_twice(codes):
    return to_srgb(srgb_from_linear(linear_from_srgb(codes / np.float32(255))))


def not_encoded(codes):
    return np.rint(255 * linear_from_srgb(codes / np.float32(255))).astype(np.uint8)


def bright(codes):
    return np.minimum(codes.astype(int) * 2, 255).astype(np.uint8)


def limited(codes):
    return np.rint(16 + codes * (219 / 255)).astype(np.uint8)


def grey(codes):
    return np.repeat(codes.mean(axis=-1, keepdims=True).astype(np.uint8), 3, axis=-1)


def reversed_in_x(codes):
    """Each elemental image of the sheet; the phone's have no whole number of pixels."""
    columns = codes.shape[1]
    width = 16 if columns == 160 else columns / 10
    place = np.arange(columns)
    lens = np.floor((place + 0.5) / width)
    mirrored = np.rint(2 * (lens + 0.5) * width - 1 - place).astype(int)
    return codes[:, mirrored.clip(0, columns - 1)]


CONTENTS = {
    "BGR": (lambda codes: codes[..., ::-1], "channels are BGR.*write RGB"),
    "GRB": (lambda codes: codes[..., [1, 0, 2]], "channels are GRB.*write RGB"),
    "limited range": (limited, "its black is code 16"),
    "grey": (grey, "2 pictures are grey"),
    "reversed in x": (reversed_in_x, "each elemental image is reversed from left to right"),
    "not encoded": (not_encoded, "linear light, where sRGB is expected"),
    "encoded twice": (encoded_twice, "sRGB, where linear light is expected"),
    "flipped rows": (lambda codes: codes[::-1], "rows are in reverse order"),
    "mirrored": (lambda codes: codes[:, ::-1], "columns are in reverse order"),
    "rotated": (lambda codes: codes[::-1, ::-1], "rotated by 180 degrees"),
    "pseudoscopic": (turned, "pseudoscopic"),
    "half a lens off": (half_a_lens, r"shifted by \+8 pixels to the right and \+0 down, \+0.5"),
    "a lens down": (lambda codes: np.roll(codes, 16, 0), r"shifted by \+0 pixels.*\+16 down"),
    "clipped": (bright, "pixels are clipped at white.*do not brighten"),
    "black": (lambda codes: codes * 0, "no more than a picture of one colour"),
}


@pytest.mark.parametrize("name", CONTENTS)
def test_mistakes_in_the_content_are_named(suite, template, tmp_path, name):
    change, words = CONTENTS[name]
    for case in CASES:
        codes = np.asarray(Image.open(template / f"{case}.png"))
        Image.fromarray(np.ascontiguousarray(change(codes))).save(tmp_path / f"{case}.png")
    describe(tmp_path)
    passed, lines = scored(suite, tmp_path, tmp_path / "out")
    assert not passed
    assert not (tmp_path / "out" / score.RESULT).exists()
    assert any(part.startswith("mistake: ") for part in lines)
    assert re.search(words, lines[0] if len(lines) == 1 else " ".join(lines))


def describe(folder, **fields):
    about = {"name": "mine", "authors": ["me"], "licence": "CC0", "tracks": ["rgbd"], **fields}
    write_submission(folder, **about)


@pytest.mark.parametrize(
    "algorithm", ["template", "wang2024", "gu2020", "li2012", "copy", "traced"]
)
def test_honest_entries_have_no_mistakes(suite, tmp_path, algorithm):
    submission_of(suite, algorithm, tmp_path)
    passed, lines = scored(suite, tmp_path, tmp_path / "out")
    assert passed
    assert all(": headline 0." in line for line in lines)


def test_values_up_to_255_and_alpha_are_named(suite, template, tmp_path):
    for case in CASES:
        write_exr(tmp_path / f"{case}.exr", 255 * linear(template / f"{case}.png"))
    describe(tmp_path)
    _, lines = scored(suite, tmp_path, tmp_path / "out")
    assert any("reach from 0 to 255" in line for line in lines)
    for case in CASES:
        (tmp_path / f"{case}.exr").unlink()
        codes = np.asarray(Image.open(template / f"{case}.png"))
        alpha = np.where(codes.any(axis=-1), 255, 0).astype(np.uint8)
        Image.fromarray(np.dstack([codes, alpha])).save(tmp_path / f"{case}.png")
    describe(tmp_path)
    _, lines = scored(suite, tmp_path, tmp_path / "out")
    assert any("transparent pixels" in line for line in lines)


def test_pictures_of_other_cases_are_named(suite, template, tmp_path):
    """Another display has another size; a case of equal size is recognised by its content."""
    shutil.copytree(template, tmp_path, dirs_exist_ok=True)
    shutil.copyfile(template / "jade-phone.png", tmp_path / "altar-sheet.png")
    describe(tmp_path)
    (tmp_path / "jade-phone.png").write_bytes(b"no picture")
    describe(tmp_path)
    passed, lines = scored(suite, tmp_path, tmp_path / "out")
    assert not passed
    size = r"altar-sheet\.png.*157 x 157.*; it has the size of the display phone"
    assert len(lines) == 2
    assert "jade-phone.png: not a readable PNG" in lines[0]
    assert re.search(size, lines[1])


def test_mistakes_in_the_files_are_all_named(suite, template, tmp_path):
    shutil.copytree(template, tmp_path, dirs_exist_ok=True)
    submission = json.loads((tmp_path / "submission.json").read_text())
    (tmp_path / "altar-sheet.png").unlink()
    data = bytearray((tmp_path / "jade-phone.png").read_bytes())
    data[len(data) // 2] ^= 1
    (tmp_path / "jade-phone.png").write_bytes(data)
    shutil.copyfile(tmp_path / "jade-phone.png", tmp_path / "jade-fone.png")
    changed = {"seconds": {"jade-phone": -1.0, "jade": 2.0}, "authors": [" "]}
    old = {
        **submission,
        **changed,
        "protocol": "inim-bench-0.9",
        "tracks": ["rgb"],
        "licence": " ",
    }
    (tmp_path / "submission.json").write_text(json.dumps(old))
    with pytest.raises(SubmissionError, match=r"and \d+ more") as caught:
        plan_scores(suite, tmp_path, as_is=False)
    text = "\n".join(caught.value.mistakes)
    for words in (
        "protocol is 'inim-bench-0.9', and this suite is inim-bench-1.0",
        "track 'rgb'",
        "licence is empty",
        "seconds of jade-phone is -1; give a positive time",
        "seconds of 'jade': ",
        "authors is empty; name the authors",
        "name 'template' is an algorithm of inim; choose another",
        "altar-sheet: has no picture; add altar-sheet.png or altar-sheet.exr",
        "altar-sheet.png: is listed in submission.json and missing",
        "jade-phone.png: is not the file of submission.json",
        "jade-fone.png: no case of that name; did you mean jade-phone?",
    ):
        assert words in text


def test_a_pipe_in_a_submission_is_refused(suite, template, tmp_path):
    """Reading it would never end."""
    shutil.copytree(template, tmp_path, dirs_exist_ok=True)
    (tmp_path / "jade-phone.png").unlink()
    os.mkfifo(tmp_path / "jade-phone.png")
    with pytest.raises(FileError, match=r"jade-phone\.png: (has no picture|not a regular file|is)"):
        plan_scores(suite, tmp_path, as_is=False)
    with pytest.raises(FileError, match="no such folder; name one with pictures"):
        plan_scores(suite, tmp_path / "nowhere", as_is=False)


def test_a_changed_byte_of_the_suite_is_found(suite, template, tmp_path):
    copy = tmp_path / "suite"
    shutil.copytree(suite, copy)
    path = copy / "jade-phone" / "truth" / "views.npz"
    data = bytearray(path.read_bytes())
    data[100] ^= 1
    path.write_bytes(data)
    with pytest.raises(FileError, match=r"views\.npz: is not the file that was made"):
        scored(copy, template, tmp_path / "out")
    case = next(case for case in made_cases(copy) if case.case.name == "jade-phone")
    assert case.changed_files() == ["truth/views.npz"]
    manifest = json.loads((copy / "jade-phone" / MANIFEST).read_text())
    (copy / "jade-phone" / MANIFEST).write_text(json.dumps({**manifest, "protocol": "other"}))
    with pytest.raises(FileError, match=f"is of other, and this is {PROTOCOL}"):
        made_cases(copy)


def test_a_made_case_is_kept_unless_its_inputs_change(suite):
    scene = SCENES / "jade.xml"
    manifest = suite / "jade-phone" / MANIFEST
    assert CaseJob.of(case_of("jade-phone"), scene, 1, 1).is_made(manifest)
    assert not CaseJob.of(case_of("jade-phone"), scene, 2, 1).is_made(manifest)
    assert not CaseJob.of(case_of("jade-phone"), scene, 1, 2).is_made(manifest)
    assert not CaseJob.of(case_of("jade-phone"), SCENES / "ibex.xml", 1, 1).is_made(manifest)
    assert not CaseJob.of(case_of("jade-phone"), scene, 1, 1).is_made(suite / "no" / MANIFEST)


def test_statistics_tell_scenes_apart_but_not_seeds(suite):
    statistics, others = (case.manifest.statistics for case in made_cases(suite))
    assert not differs(statistics["eia"], statistics["eia"], 1e-3)
    assert differs(statistics["eia"], others["eia"], 1e-3)


def test_a_suite_is_compared_with_the_published_one(suite, tmp_path, monkeypatch):
    """Equal statistics pass; another mean, another share and an unpublished case are named."""
    cases = made_cases(suite)
    statistics = {case.case.name: dict(case.manifest.statistics) for case in cases}
    monkeypatch.setattr(published, "PUBLISHED", tmp_path / "statistics.json")

    def mistakes():
        document = StatisticsDocument(protocol=PROTOCOL, cases=statistics)
        write_document(tmp_path / "statistics.json", document)
        return published.suite_mistakes(cases)

    assert mistakes() == []
    eia = statistics["altar-sheet"]["eia"]
    brighter = tuple(1.1 * value for value in eia.mean)
    statistics["altar-sheet"]["eia"] = structs.replace(eia, mean=brighter)
    (text,) = mistakes()
    assert text.startswith("altar-sheet: eia differs from the published suite, mean ")
    statistics["altar-sheet"]["eia"] = structs.replace(eia, share=eia.share + 0.01)
    assert len(mistakes()) == 1
    del statistics["altar-sheet"]
    assert mistakes()[0].startswith("altar-sheet: its statistics are not published")


def test_a_folder_without_cases_has_one_line(tmp_path, capsys):
    assert main(["benchmark", "check", "--suite", str(tmp_path)]) == EXIT_USAGE
    assert (
        "no case of inim-bench-1.0; make one with `inim benchmark make`" in capsys.readouterr().err
    )


def test_the_board_lists_entries_best_first_with_differences(suite, template, tmp_path):
    folder = tmp_path / "suite"
    shutil.copytree(suite, folder)
    for algorithm in ("template", "copy", "optimal"):
        source = tmp_path / algorithm
        source.mkdir()
        submission_of(folder, algorithm, source)
        passed, _ = scored(folder, source, folder / "results" / algorithm)
        assert passed or algorithm == "optimal"
        job = ScoreJob(source, SubmissionDocument(**about(source)), made_cases(folder), True)
        score.run_job(job, folder / "results" / algorithm, Observer())
    results = read_results(folder)
    entries = entries_of(results, "rgbd")
    assert [entry.name for entry in entries] == ["template", "copy"]
    best, other = entries
    assert best.difference is None
    mean, low, high = other.difference
    assert mean == pytest.approx(other.headline - best.headline)
    assert low < mean < high
    assert 0 < best.possible <= 1.05
    assert best.ms_per_megapixel > 0
    assert best.worst_headline <= best.headline
    out = tmp_path / "board"
    write_board(folder, out, "inim benchmark board")
    page, table = (out / "board.html").read_text(), (out / "board.tex").read_text()
    assert "Track rgbd" in page
    assert "data:image/webp" in page
    assert table.startswith(f"% Scores by {PROTOCOL}")
    assert r"\toprule" in table
    assert (out / "time-rgbd.svg").is_file()
    for result in (folder / "results").glob("*/result.json"):  # of a single relic
        content = json.loads(result.read_text())
        for track in content["scores"].values():
            del track["jade-phone"]
        result.write_text(json.dumps(content))
    write_board(folder, tmp_path / "single", "inim benchmark board")
    best, other = entries_of(read_results(folder), "rgbd")
    assert other.difference == (pytest.approx(other.headline - best.headline), None, None)


def about(folder):
    fields = json.loads((folder / "submission.json").read_text())
    return {key: value for key, value in fields.items() if key != "schema"}


def test_file_digests_are_sha256(template):
    fields = about(template)
    for name, digest in fields["files"].items():
        assert hashlib.sha256((template / name).read_bytes()).hexdigest() == digest
    assert set(fields["files"]) == {f"{case}.png" for case in CASES}
    assert file_mistakes(template, SubmissionDocument(**fields), []) == []
