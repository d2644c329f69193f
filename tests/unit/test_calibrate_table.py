"""The table of misaligned displays: worst case first, ambiguous shifts, and every miss listed."""

from typing import Any

from reports.calibration.run import TARGETS, disturbed_table, table


def case(number: int, *, certain: bool = True, **off: float) -> dict[str, Any]:
    """A case with errors `off` in standard errors, each a tenth of the parameter's target."""
    truth = dict.fromkeys((*TARGETS, "tilt_x_deg", "tilt_y_deg"), 1.0)
    estimates = {}
    for name in truth:
        error = TARGETS[name].max_error / 10 if name in TARGETS else 0.01
        value = 1.0 + off.get(name, 0.0) * error
        interval = [value - 1.96 * error, value + 1.96 * error]
        estimates[name] = {
            "value": value, "standard_error": error, "interval": interval, "known": True
        }  # fmt: skip
    return {
        "case": number,
        "display": "nominal",
        "truth": truth,
        "found": estimates,
        "shift_is_certain": {"shift_x_mm": certain, "shift_y_mm": True},
        "refused": "",
        "seconds": {"photographs": 60.0, "calibration": 20.0},
    }


def rows(text: str) -> list[str]:
    return [line for line in text.splitlines() if "| nominal |" in line]


def test_the_worst_case_is_first_and_a_missed_interval_is_bold():
    text = table([case(0, gap_mm=1.0), case(1, pitch_mm=3.0), case(2)])
    assert [row.split("|")[1].strip() for row in rows(text)] == ["1", "0", "2"]
    assert "**+0.3**" in rows(text)[0] and "**" not in rows(text)[1]
    assert "standard errors: none." in text
    (pitch,) = (line for line in text.splitlines() if line.startswith("| `pitch_mm`"))
    assert "| 100.0% |" in pitch and "| 66.7% |" in pitch, "all within, two intervals hold"


def test_a_determined_but_wrong_value_is_named():
    text = table([case(0, gap_mm=15.0), case(1)])
    assert "standard errors: 0 (gap_mm)." in text
    (gap,) = (line for line in text.splitlines() if line.startswith("| `gap_mm`"))
    assert "| 50.0% |" in gap


def test_a_shift_error_of_a_pitch_counts_only_for_a_certain_shift():
    a_pitch = 1.0 / (TARGETS["shift_x_mm"].max_error / 10)
    certain, modulo = (case(k, certain=not k, shift_x_mm=a_pitch + 1) for k in (0, 1))
    assert "standard errors: 0 (shift_x_mm)." in table([certain])
    text = table([modulo])
    assert "standard errors: none." in text and "Ambiguous shifts: 1 of 2." in text
    assert "+2.5 " in rows(text)[0]


def test_a_failed_case_is_listed_and_is_not_within_the_target():
    failed = case(1) | {"found": {}, "refused": "position-2: unsharp"}
    text = table([case(0), failed])
    assert "Case 1 failed: position-2: unsharp" in text
    (pitch,) = (line for line in text.splitlines() if line.startswith("| `pitch_mm`"))
    assert "| 50.0% |" in pitch


def disturbed(number: int, *names: str, **off: float) -> dict[str, Any]:
    """A disturbed case; see `case`."""
    return case(number, **off) | {"disturbances": dict.fromkeys(names, 1.0), "photographs": 14}


def test_disturbed_cases_have_their_coverage_by_parameter_and_by_disturbance():
    refused = disturbed(2, "shake") | {"found": {}, "refused": "position-2: unsharp"}
    results = [disturbed(0), disturbed(1, "shake", "bow", gap_mm=5.0), refused]
    lines = disturbed_table(results, "python").splitlines()
    # Wilson's interval of 13 of 14.
    assert "| all | 14 | 13 | 92.9% (68.5% to 98.7%) | | | | |" in lines
    (gap,) = (line for line in lines if line.startswith("| `gap_mm`"))
    assert gap.startswith("| `gap_mm` | 2 | 1 | 50.0% (")
    for row in ("| shake | 2 | 1 | 0 |", "| bow | 1 | 0 | 0 |", "| none | 1 | 0 | 1 |"):
        assert row in lines
    assert [row.split("|")[1].strip() for row in rows("\n".join(lines))] == ["1", "0"]
    assert "**+50 (+5.0)**" in rows("\n".join(lines))[0]
    assert lines[-1] == "* Case 2 (nominal; shake) refused: position-2: unsharp"


def test_undetermined_parameters_of_disturbed_cases_do_not_count():
    result = disturbed(0, gap_mm=9.0)
    result["found"]["gap_mm"]["known"] = False
    text = disturbed_table([result], "python")
    assert "| all | 6 | 6 |" in text and "| none | 1 | 0 | 1 |" in text
