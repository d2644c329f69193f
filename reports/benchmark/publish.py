"""Publish a suite: its statistics, and its board.

``python -m reports.benchmark.publish SUITE`` writes ``inim/apps/benchmark/statistics.json``, which
`inim benchmark check` compares with, and the results below ``reports/benchmark/results``. The
command prints the largest interval of a headline, which the samples of the definition decide.
"""

import shutil
import sys
from pathlib import Path

from inim.apps.benchmark.board import read_results, write_board
from inim.apps.benchmark.document import StatisticsDocument
from inim.apps.benchmark.protocol import PROTOCOL
from inim.apps.benchmark.published import PUBLISHED
from inim.apps.benchmark.submission import check_name
from inim.apps.benchmark.suite import made_cases
from inim.system.document import write_document

HERE = Path(__file__).parent


def main(words: list[str]) -> int:
    """Write the statistics, the results and the board."""
    suite = Path(words[0])
    cases = {case.case.name: case.manifest.statistics for case in made_cases(suite)}
    write_document(PUBLISHED, StatisticsDocument(protocol=PROTOCOL, cases=cases))
    results = read_results(suite)
    for result in results:
        name = check_name(result.submission.name)
        target = HERE / "results" / name / "result.json"
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(suite / "results" / name / "result.json", target)
    write_board(suite, HERE, "inim benchmark board")
    errors = {
        (score.headline_error, f"{result.submission.name}, {track}, {case}")
        for result in results
        for track, scores in result.scores.items()
        for case, score in scores.items()
    }
    for error, name in sorted(errors)[-10:]:
        print(f"{error:.4f} {name}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
