"""`inim choose --scene`: the displays with the finest details are validated with a relic."""

from inim.cli import main
from inim.errors import EXIT_PASSED
from tests.schemas import read_text
from tests.system.conftest import SHAPES, worker_here, write_scene

# The second has so few lenses that the relic is a few blocks.
SHEETS = """
[[sheet]]
name = "fine"
pitch_mm = 0.6
focal_length_mm = 2.4
source = "shop"
[[sheet]]
name = "coarse"
pitch_mm = 4.0
focal_length_mm = 14.0
source = "shop"
"""


def test_the_display_with_the_highest_score_is_recommended(tmp_path, capsys):
    settings = "".join(
        f'<default name="inim.{name}_spp" value="4"/>'
        for name in ("capture", "eia", "view", "reconstruction")
    )
    scene, table = write_scene(tmp_path, settings, *SHAPES), tmp_path / "shop.toml"
    table.write_text(SHEETS)
    words = ["--panel", "320x320, 100 um", "--distance", "500", "--move", "10", "--depth", "10"]
    words += ["--sheets", str(table), "--scene", str(scene), "--json"]
    with worker_here():
        assert main(["choose", *words]) == EXIT_PASSED
    document = read_text(capsys.readouterr().out)
    scores = {record["sheet"]: record["score"] for record in document["candidates"]}
    assert list(scores) == ["fine", "coarse"]
    assert 0 < scores["coarse"] < scores["fine"] < 1
    assert document["reason"].startswith("highest score")
