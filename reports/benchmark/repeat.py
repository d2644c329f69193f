"""Compare the scores of two renderings of the suite, which differ by the noise of the renderer.

``python -m reports.benchmark.repeat SUITE OTHER`` compares the results of the cases that both have,
and writes ``reports/benchmark/repeat.md``. OTHER is made with another ``--seed``, and may be
rendered on one core: ``taskset -c 0 inim benchmark make --seed 2 --suite OTHER``.
"""

import math
import sys
from pathlib import Path
from statistics import fmean

from inim.apps.benchmark.board import read_results
from inim.report.summary import markdown_section


def main(words: list[str]) -> int:
    """Write the table; 1 if a mean of the board differs by more than its interval."""
    results, others = (
        {result.submission.name: result.scores for result in read_results(Path(word))}
        for word in words
    )
    rows, outside, scores = [], 0, 0
    for name in [name for name in results if name in others]:
        for track in [track for track in results[name] if track in others[name]]:
            own, other = results[name][track], others[name][track]
            cases = [case for case in own if case in other]
            changes = [other[case].headline - own[case].headline for case in cases]
            limits = [math.hypot(own[c].headline_error, other[c].headline_error) for c in cases]
            scores += len(cases)
            outside += sum(
                abs(change) > limit for change, limit in zip(changes, limits, strict=True)
            )
            change, limit = fmean(changes), math.hypot(*limits) / len(cases)
            numbers = [fmean(own[case].headline for case in cases), change, limit]
            is_within = "yes" if abs(change) <= limit else "no"
            rows.append([name, track, *(f"{number:+.4f}" for number in numbers), is_within])
    heads = ["algorithm", "track", "headline", "change", "interval of the change", "within"]
    text = [
        "# Two renderings of the suite",
        f"Scores of `python -m reports.benchmark.repeat {' '.join(words)}`, with other seeds of "
        f"the noise. Of {scores} scores of a case, {scores - outside} are within the 95 % interval "
        "of the difference.",
        markdown_section("Means over the cases", heads, rows),
    ]
    Path(__file__).with_name("repeat.md").write_text("\n\n".join(text) + "\n", "utf-8")
    print(text[1])
    print(*(" ".join(row) for row in rows), sep="\n")
    return int(any(row[-1] == "no" for row in rows))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
