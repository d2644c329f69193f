"""Choice of a lens sheet: figures of a display, the search, the tables, and the command."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs

from inim.choose.search import Candidate, Need, front, parse_panel, search
from inim.choose.sheets import TABLE, LensSheet, any_sheets, read_sheets
from inim.cli import main
from inim.display import DISPLAYS, Display
from inim.display.viewpoint import default_distance_mm
from inim.errors import EXIT_PASSED, EXIT_USAGE, FileError, UsageError
from inim.inspection.suitability import detail_mm, suitability
from inim.scene.file import choose_display
from tests.schemas import read_text

ROOT = Path(__file__).parents[2]
NOMINAL = DISPLAYS["nominal"]
PHONE_PANEL = (2400, 1080, 0.06466)
NEED = Need(*PHONE_PANEL, 500.0, 30.0, 20.0)
SHEETS = any_sheets()[20:60:4]
TWO_SHEETS = """
[[sheet]]
name = "fine"
pitch_mm = 0.6
focal_length_mm = 2.4
source = "shop"
[[sheet]]
name = "coarse"
pitch_mm = 1.5
focal_length_mm = 4.5
"""


# --- Figures of a display -----------------------------------------------------------------------


def test_zone_of_the_nominal_display_leaves_no_room_for_the_head():
    """63 mm wide, and in its border of V p / 2g the neighbour's picture begins."""
    figures = suitability(NOMINAL, 415.8, "pinhole")
    assert figures.zone_width_mm == pytest.approx(63.0)
    assert not figures.two_eyes_fit and figures.head_movement_mm is None
    patch = 3.3 * (1 / 33 - 1 / 600)
    border = (patch + 1 / 17) / 2 * 600 / 3.3
    half = 600 / 6.6 - 31.5
    head = suitability(NOMINAL, 600.0, "pinhole").head_movement_mm
    assert head == pytest.approx(half - border - 31.5, rel=1e-6)


def test_first_display_has_finer_details_and_room_for_the_head():
    fine, distance = DISPLAYS["fine"], default_distance_mm(DISPLAYS["fine"])
    assert distance == pytest.approx(542.7, abs=0.1)  # where its elemental images aim
    figures = suitability(fine, distance, "thick")
    assert figures.head_movement_mm > 25
    nominal = suitability(NOMINAL, default_distance_mm(NOMINAL), "thick")
    assert figures.details_across > 2 * nominal.details_across


def test_detail_without_a_spot_is_footprint_and_blur_at_the_far_end():
    """k |z| + A |z - D| / |D| with k = P_D / g, worked out by hand for the near end."""
    high = NOMINAL.depth_range_mm[1]
    by_hand = high / 17 / 3.3 + (high - 33) / 33
    assert detail_mm(NOMINAL, np.array([high]))[0] == pytest.approx(by_hand, rel=1e-6)


@pytest.mark.parametrize("gap", [1.7, 1.9, 2.0, 2.05, 2.3])
def test_sharp_depth_agrees_with_a_scan_of_depths(gap):
    display = NOMINAL.replace(
        focal_length_mm=2.0, gap_mm=gap, depth_min_mm=-10, depth_max_mm=10, lens_columns=16
    )
    figures = suitability(display, 300.0, "pinhole")
    z = np.linspace(-400, 400, 800_001)
    widths = detail_mm(display, z)
    scanned = np.ptp(z[widths <= 2 * widths.min()])
    assert figures.sharp_depth_mm == pytest.approx(scanned, rel=1e-3, abs=2e-3)


def test_brightness_loses_only_what_two_faces_reflect():
    through_thick = suitability(NOMINAL, 500.0, "thick").brightness
    through_pinhole = suitability(NOMINAL, 500.0, "pinhole").brightness
    assert through_pinhole == pytest.approx(1.0, abs=0.01)
    reflected = ((1.4917 - 1) / (1.4917 + 1)) ** 2
    assert through_thick == pytest.approx((1 - reflected) ** 2, abs=0.01)


def test_error_of_a_stated_accuracy_moves_the_point_by_a_tenth_of_a_pixel():
    accuracy = suitability(NOMINAL, 500.0, "thick").accuracy
    assert accuracy["shift_x_mm"] == pytest.approx(NOMINAL.pixel_pitch_mm / 10)
    moved = np.radians(accuracy["rotation_deg"]) * NOMINAL.width_mm / 2
    assert moved == pytest.approx(NOMINAL.pixel_pitch_mm / 10)


# --- Search -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def candidates() -> list[Candidate]:
    return search(NEED, SHEETS)


def test_each_display_of_the_search_meets_the_need(candidates):
    assert candidates
    for candidate in candidates:
        figures, display = candidate.suitability, candidate.display
        assert figures.head_movement_mm >= NEED.move_mm
        assert figures.depth_mm == pytest.approx(NEED.depth_mm)
        assert display.eia_shape == (1080, 2400)
        assert display.panel_excess_mm == (0.0, 0.0)


def test_no_other_gap_has_finer_details(candidates):
    """A finer scan of gaps and ranges improves on the search by a few percent at most."""
    candidate = candidates[0]
    display, half = candidate.display, NEED.depth_mm / 2
    finest = min(
        float(detail_mm(tried, np.array([centre - half, centre + half])).max())
        for gap in np.linspace(0.8, 1.3, 101) * candidate.sheet.focal_length_mm
        if (tried := display.replace(gap_mm=float(gap))).flip_limit_mm(500.0)[0] >= 51.5
        for centre in np.linspace(-60, 60, 61)
    )
    ends = np.array(display.depth_range_mm)
    assert float(detail_mm(display, ends).max()) <= 1.1 * finest


def test_a_deeper_picture_has_coarser_details():
    deeper = Need(*PHONE_PANEL, 500.0, 60.0, 20.0)
    pairs = zip(search(NEED, SHEETS[:3]), search(deeper, SHEETS[:3]), strict=True)
    assert all(a.suitability.detail_mm < b.suitability.detail_mm for a, b in pairs)


def test_front_has_exactly_the_candidates_that_none_beats(candidates):
    def beats(a: Candidate, b: Candidate) -> bool:
        a_figures, b_figures = (
            (-f.detail_mm, f.sharp_depth_mm, f.zone_width_mm, f.accuracy["gap_mm"])
            for f in (a.suitability, b.suitability)
        )
        pairs = list(zip(a_figures, b_figures, strict=True))
        return all(x >= y for x, y in pairs) and any(x > y for x, y in pairs)

    first = candidates[0]
    coarser = structs.replace(first.suitability, detail_mm=9.0)
    candidates = [*candidates, dataclasses.replace(first, suitability=coarser)]
    unbeaten = front(candidates)
    assert 0 < len(unbeaten) < len(candidates)
    for candidate in candidates:
        assert (candidate in unbeaten) != any(beats(other, candidate) for other in candidates)


def test_lenticular_has_no_height_of_its_zone():
    (candidate,) = search(NEED, [LensSheet("ridges", 0.5, 2.0, "lenticular")])
    assert candidate.suitability.zone_height_mm is None
    assert candidate.display.layout.of_cylinders


def test_committed_report_has_a_display_that_beats_each_preset_on_each_relic():
    comparisons = json.loads((ROOT / "reports/choose/choose.json").read_text("utf-8"))
    assert [comparison["preset"] for comparison in comparisons] == ["nominal", "phone"]
    for comparison in comparisons:
        preset, *others = comparison["displays"]
        assert len(preset["scores"]) == 3
        assert any(
            all(other["scores"][relic] > score + 0.05 for relic, score in preset["scores"].items())
            for other in others
        )


# --- Tables and panels --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "pixel"),
    [
        ("2400x1080, 6.7 in", 0.06466),
        ("2400 x 1080, 17.02 cm", 0.06467),
        ("2400x1080,63.6 um", 0.0636),
        ("phone", 0.0636),
    ],
)
def test_panel_is_read_from_its_diagonal_its_pixel_or_a_preset(text, pixel):
    assert parse_panel(text) == pytest.approx((2400, 1080, pixel))


@pytest.mark.parametrize("text", ["2400x1080", "6.7 in", "2400x1080, 0 in", "x, 1 in", "fone"])
def test_other_panels_are_refused(text):
    with pytest.raises(UsageError, match="--panel"):
        parse_panel(text)


def test_sheets_of_the_table_name_their_source():
    assert all(sheet.source.startswith("https://") for sheet in read_sheets(TABLE))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "\\[\\[sheet\\]\\]"),
        ("sheet = 3", "\\[\\[sheet\\]\\]"),
        ("sheet = []", "no \\[\\[sheet\\]\\]"),
        ("[[sheet]]\nname = 'a'", "focal_length_mm"),
        ("[[sheet]]\nname = 'a'\npitch_mm = -1\nfocal_length_mm = 2", "pitch_mm"),
        ("[[sheet]]\nname = 3\npitch_mm = 1\nfocal_length_mm = 2", "0..name"),
        ("[[sheet]]\nname = 'a'\npitch_mm = 1\nfocal_length_mm = 2\nf = 2", "unknown field `f`"),
        ("[[sheet]]\nname = 'a'\npitch_mm = 1\nfocal_length_mm = 2\nlattice = 'x'", "lattice"),
    ],
)
def test_bad_tables_are_refused_in_one_line(tmp_path, text, words):
    path = tmp_path / "sheets.toml"
    path.write_text(text)
    with pytest.raises(FileError, match=words):
        read_sheets(path)


# --- Command ------------------------------------------------------------------------------------


def test_command_recommends_a_sheet_and_writes_its_display(tmp_path, capsys):
    table, out = tmp_path / "shop.toml", tmp_path / "display.xml"
    table.write_text(TWO_SHEETS)
    words = ["choose", "--panel", "2400x1080, 6.7 in", "--sheets", str(table)]
    assert main([*words, "-o", str(out)]) == EXIT_PASSED
    text = capsys.readouterr().out
    text, _, path = text.partition("\nwritten: ")
    assert "Recommended: fine" in text and path.strip() == str(out)
    assert max(map(len, text.splitlines())) <= 100
    assert main([*words, "--json"]) == EXIT_PASSED
    document = read_text(capsys.readouterr().out)
    names = [record["sheet"] for record in document["candidates"]]
    assert names[0] == "fine" and document["candidates"][0]["source"] == "shop"
    display, _ = choose_display(out, {}, "test")
    recommended = Display(**document["candidates"][0]["display"])
    assert display.replace(name="") == recommended.replace(name="")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--distance", "0"], "--distance 0"),
        (["--depth", "nan"], "--depth nan"),
        (["--move", "-1"], "--move -1"),
        (["--move", "400"], "lower --move"),
        (["--lattice", "round"], "--lattice round"),
    ],
)
def test_needs_that_cannot_be_met_are_refused_in_one_line(capsys, words, message):
    assert main(["choose", "--panel", "phone", *words]) == EXIT_USAGE
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1
