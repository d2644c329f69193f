"""The table of misaligned displays: worst case first, ambiguous shifts, and every miss listed."""

from typing import Any

from reports.calibration.run import COLUMNS, table


def case(number: int, *names: str, certain: bool = True, **off: float) -> dict[str, Any]:
    """A case with disturbances, and errors `off` in standard errors of 0.01 each."""
    estimates, error = {}, 0.01
    for name in COLUMNS:
        value = 1.0 + off.get(name, 0.0) * error
        interval = [value - 1.96 * error, value + 1.96 * error]
        estimates[name] = {
            "value": value, "standard_error": error, "interval": interval, "known": True
        }  # fmt: skip
    return {
        "case": number,
        "display": "nominal",
        "truth": dict.fromkeys(COLUMNS, 1.0),
        "found": estimates,
        "shift_is_certain": {"shift_x_mm": certain, "shift_y_mm": True},
        "refused": "",
        "seconds": {"photographs": 60.0, "calibration": 20.0},
        "disturbances": dict.fromkeys(names, 1.0),
        "photographs": 14,
    }


def rows(text: str) -> list[str]:
    return [line for line in text.splitlines() if "| nominal |" in line]


def test_a_shift_error_of_a_pitch_counts_only_for_a_certain_shift():
    a_pitch = 1.0 / 0.01
    certain, modulo = (case(k, certain=not k, shift_x_mm=a_pitch + 1) for k in (0, 1))
    assert "**+1.01e+03 (+101.0)**" in rows(table([certain], [], "python"))[0]
    assert "| +10 (+1.0) |" in rows(table([modulo], [], "python"))[0]


def test_cases_have_their_coverage_by_parameter_and_by_disturbance():
    refused = case(2, "shake") | {"found": {}, "refused": "position-2: unsharp"}
    results = [case(0, "steady"), case(1, "shake", "bow", gap_mm=5.0), refused]
    lines = table(results, [], "python").splitlines()
    # Wilson's interval of 13 of 14.
    assert "| all | 14 | 13 | 92.9% (68.5% to 98.7%) | | | | |" in lines
    (gap,) = (line for line in lines if line.startswith("| `gap_mm`"))
    assert gap.startswith("| `gap_mm` | 2 | 1 | 50.0% (")
    for row in ("| shake | 2 | 1 | 0 |", "| bow | 1 | 0 | 0 |", "| none | 1 | 0 | 1 |"):
        assert row in lines
    assert [row.split("|")[1].strip() for row in rows("\n".join(lines))] == ["1", "0"]
    assert "**+50 (+5.0)**" in rows("\n".join(lines))[0]
    assert lines[-1] == "* Case 2 (nominal; shake) refused: position-2: unsharp"


def test_undetermined_parameters_do_not_count():
    result = case(0, gap_mm=9.0)
    result["found"]["gap_mm"]["known"] = False
    text = table([result], [], "python")
    assert "| all | 6 | 6 |" in text and "| none | 1 | 0 | 1 |" in text


def test_a_repeated_case_stands_below_the_same_case_with_few_photographs():
    repeat = case(1, gap_mm=0.5) | {"photographs": 168}
    text = table([case(0), case(1, gap_mm=1.0)], [repeat], "python")
    original, repeated = rows(text.partition("The same displays with 168 photographs")[2])
    assert "| 1 | nominal | 14 |" in original and "+10 (+1.0)" in original
    assert "| 1 | nominal | 168 |" in repeated and "+5 (+0.5)" in repeated
