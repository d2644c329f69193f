"""A turning relic: `inim.turn_deg`, `inim export --turntable`, and `inim film` of it.

Expected: a turned relic gives the EIA of a relic whose file is turned; a whole turn is none; the
relic keeps its size. An interrupted export continues where it ended.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image, ImageSequence

from inim.errors import SceneError
from inim.render import ground_truth
from inim.views import turntable
from inim.views.turntable import JSON
from tests.conftest import scene_text, small_display, sphere
from tests.schemas import read_document
from tests.splat_relics import random_splats, splat_scene
from tests.system.conftest import (
    TINY,
    Ended,
    assert_refused,
    definitions,
    nothing_left,
    run_here,
)

DISPLAY = small_display(16, 12, 8)
QUICK = definitions(TINY | {"inim.lens_model": "pinhole", "inim.pixel_pitch_mm": "0.125"})


def vane(turn_deg: float = 0.0) -> trimesh.Trimesh:
    """Two crossed plates of unequal size, whose bounding box stays centred at every turn."""
    plates = [trimesh.creation.box((4, 2, 0.4)), trimesh.creation.box((0.4, 3, 1.5))]
    mesh = trimesh.util.concatenate(plates)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.radians(20), (0, 1, 0)))
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.radians(turn_deg), (0, 1, 0)))
    return mesh


def mesh_scene(folder: Path, mesh: trimesh.Trimesh) -> str:
    mesh.export(folder / "vane.ply")
    return scene_text('<shape type="ply"><string name="filename" value="vane.ply"/></shape>')


@pytest.fixture
def turned(open_fitted, renderer, tmp_path):
    """The fitted scene of a text at a turn."""
    from inim.render.scene import open_scene
    from inim.scene.file import read_scene_file

    def opened(text: str, turn_deg: float | None):
        path = tmp_path / "scene.xml"
        path.write_text(text, encoding="utf-8")
        return open_scene(read_scene_file(path), DISPLAY, 0.85, turn_deg=turn_deg)

    return opened


def eia_of(fitted) -> np.ndarray:
    return ground_truth.pickup(fitted, DISPLAY, spp=16, seed=3).image


def test_turned_relic_gives_the_eia_of_its_turned_file(turned, tmp_path):
    """Coordinates of the two differ by rounding, which decides samples at outlines only."""
    text = mesh_scene(tmp_path, vane())
    own = eia_of(turned(text, 55))
    other = eia_of(turned(mesh_scene(tmp_path, vane(55)), 0))
    backwards = eia_of(turned(text, -55))
    assert (abs(own - other) > 1e-3).mean() < 1e-3 < 0.1 < (own > 0).mean()
    assert (abs(backwards - other) > 1e-3).mean() > 0.05


def test_whole_turn_is_none_and_the_relic_keeps_its_place(turned, tmp_path):
    text = mesh_scene(tmp_path, vane())
    first = turned(text, 0)
    assert np.array_equal(eia_of(first), eia_of(turned(text, 360)))
    low, high = DISPLAY.depth_range_mm
    for angle in (0, 33, 90, 200):
        fitted = turned(text, angle)
        np.testing.assert_array_equal(fitted.fit.display_from_world, first.fit.display_from_world)
        corners = vane(angle).vertices @ fitted.fit.display_from_world[:3, :3].T
        corners += fitted.fit.display_from_world[:3, 3]
        assert low < corners[:, 2].min() and corners[:, 2].max() < high
        assert np.all(abs(corners[:, :2]) <= DISPLAY.half_extent_mm)
    # The radius of the plate's corners fills the width, as no bounding box would.
    radius = np.hypot(2, 0.2)
    limits = 0.85 * DISPLAY.width_mm / (2 * radius), 0.85 * DISPLAY.height_mm / 3
    assert first.fit.scale_xy == pytest.approx(min(limits), rel=1e-5)


def test_sphere_and_lights_do_not_change(turned):
    """An off-centre light shows if it turned with the relic."""
    lamp = """<shape type="sphere"><point name="center" x="30" y="5" z="20"/>
        <emitter type="area"><rgb name="radiance" value="20"/></emitter></shape>"""
    text = scene_text(sphere((1, 2, 3), 1.5), lamp)
    first, other = (eia_of(turned(text, angle)) for angle in (0, 130))
    # Shading by the lamp is random, with the same numbers; hit points differ by rounding.
    assert first.max() > 0.1
    np.testing.assert_allclose(other.mean(), first.mean(), rtol=1e-4)
    assert abs(first - other).mean() < 1e-2 * first.mean()


def test_instances_turn_once(turned, tmp_path):
    mesh_scene(tmp_path, vane())
    text = """<shape type="shapegroup" id="g"><shape type="ply">
        <string name="filename" value="vane.ply"/></shape></shape>
        <shape type="instance"><ref id="g"/></shape>"""
    own = eia_of(turned(scene_text(text), 55))
    plain = eia_of(turned(mesh_scene(tmp_path, vane()), 55))
    # An instance's box, which is fitted, need not be that of its mesh.
    assert own.mean() == pytest.approx(plain.mean(), rel=0.1)


def test_splats_are_refused(turned, tmp_path):
    with pytest.raises(SceneError, match="splats do not turn"):
        turned(splat_scene(tmp_path, random_splats(20)), 10)


@pytest.fixture(scope="module")
def folder(tmp_path_factory, renderer):
    """A folder with a coloured GLB and its turntable OUT of four angles."""
    folder = tmp_path_factory.mktemp("turntable")
    mesh = vane()
    mesh.visual.vertex_colors = np.where(mesh.vertices[:, :1] > 0, (220, 60, 40), (40, 90, 220))
    mesh.export(folder / "vane.glb")
    ended = export(folder, "-o", "OUT")
    assert ended.code == 0, ended.stderr
    assert ended.stdout.splitlines()[-1] == "written: OUT"
    assert nothing_left(folder)
    return folder


def export(folder: Path, *more: str, angles: int = 4) -> Ended:
    words = ("export", "vane.glb", "--turntable", str(angles), *QUICK, *more)
    return run_here(*words, folder=folder, variables={"INIM_CACHE": str(folder / "store")})


def codes(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path)).astype(int)


def test_frames_are_the_eias_of_the_turned_scene_with_their_scores(folder):
    document = read_document(folder / "OUT" / JSON)
    assert [frame["angle_deg"] for frame in document["frames"]] == [0, 90, 180, 270]
    assert set(document["files"]) >= {"eia/truth/0003.png", "eia/layered/0000.png"}
    words = ["OUT-scene/vane.xml", "-o", "one", *QUICK, "--viewpoints", "centre"]
    words += ["-D", "inim.turn_deg=90", "--algorithms", "layered,template"]
    assert run_here("validate", *words, folder=folder).code == 0
    report = read_document(folder / "one" / "report.json")
    for name in ("layered", "template"):
        own = document["frames"][1]["algorithms"][name]
        assert own["views"] == report["algorithms"][name]["views"]
        file = codes(folder / f"one/eia/{name}.png")
        np.testing.assert_array_equal(codes(folder / f"OUT/eia/{name}/0001.png"), file)
    truth = codes(folder / "one/truth/eia.png")
    np.testing.assert_array_equal(codes(folder / "OUT/eia/truth/0001.png"), truth)


def test_interrupted_export_continues(folder, monkeypatch):
    """The first run ends at its third angle; the second computes what is missing, and no more."""
    evaluated: list[float] = []

    def evaluate(plan, *rest):
        if len(evaluated) == 2 and plan.settings.turn_deg not in evaluated:
            raise KeyboardInterrupt
        evaluated.append(plan.settings.turn_deg)
        return own(plan, *rest)

    own = turntable.evaluate
    monkeypatch.setattr(turntable, "evaluate", evaluate)
    with pytest.raises(KeyboardInterrupt):
        export(folder, "-o", "second", "-D", "inim.seed=5")
    assert evaluated == [0, 90] and not (folder / "second").exists()
    monkeypatch.setattr(
        turntable, "evaluate", lambda p, *r: evaluated.append(p.settings.turn_deg) or own(p, *r)
    )
    assert export(folder, "-o", "second", "-D", "inim.seed=5").code == 0
    assert evaluated == [0, 90, 180, 270]
    assert len(read_document(folder / "second" / JSON)["frames"]) == 4
    # Fewer angles need no rendering, and replace the files of more.
    assert export(folder, "-o", "second", "-D", "inim.seed=5", angles=2).code == 0
    assert len(evaluated) == 4
    assert sorted(p.name for p in (folder / "second/eia/truth").iterdir()) == [
        "0000.png",
        "0001.png",
    ]


def test_videos_keep_every_pixel_of_the_panel(folder):
    """Rounding of Y by 1/438 and of chroma by 1/448 of white changes blue the most, 1.7 codes."""
    import imageio_ffmpeg

    for name in ("truth", "layered", "template"):
        reader = imageio_ffmpeg.read_frames(folder / f"OUT/eia/{name}.mp4")
        columns, rows = next(reader)["size"]
        for number, data in enumerate(reader):
            frame = np.frombuffer(data, np.uint8).reshape(rows, columns, 3).astype(int)
            assert abs(frame - codes(folder / f"OUT/eia/{name}/{number:04}.png")).max() <= 3
        assert number == 3


def test_film_shows_every_angle(folder):
    """The mesh is red on its right and blue on its left; its front turns to the right."""
    words = ("-o", "film.gif", "--view-spp", "4", "--algorithms", "layered")
    ended = run_here("film", "OUT", *words, folder=folder)
    assert (ended.code, ended.stdout) == (0, "film.gif\n"), ended.stderr
    with Image.open(folder / "film.gif") as film:
        frames = [np.asarray(f.convert("RGB")).astype(int) for f in ImageSequence.Iterator(film)]
    redness = [(frame[28:, :, 0] - frame[28:, :, 2]) for frame in frames]
    left, right = ([float(np.hsplit(r, 2)[side].mean()) for r in redness] for side in (0, 1))
    assert left[0] < -5 < 5 < right[0] and right[2] < -5 < 5 < left[2]
    assert max(left[1], right[1]) < -5 and min(left[3], right[3]) > 5
    default = run_here("film", "OUT", "--view-spp", "1", folder=folder)
    assert default.code == 0
    with Image.open(folder / "OUT/film.webp") as film:
        assert film.width > 1.9 * frames[0].shape[1]  # the ground truth next to `layered`


def test_format_without_axes_needs_its_upward_one(renderer, tmp_path):
    """Lying on its back, the vane is 1.5 high instead of 3; its larger radius fills the width."""
    vane().export(tmp_path / "vane.ply")
    words = ("vane.ply", "--turntable", "1", *QUICK, "--algorithms", "template")
    spread = []
    for axis in ("y", "z"):
        assert run_here("export", *words, "--up", axis, "-o", axis, folder=tmp_path).code == 0
        light = codes(tmp_path / axis / "eia/truth/0000.png")[..., :3].sum(axis=(1, 2))
        middle = np.average(np.arange(len(light)), weights=light)
        spread.append(np.average((np.arange(len(light)) - middle) ** 2, weights=light) ** 0.5)
    assert spread[1] < 0.95 * spread[0]  # in an EIA, each point is spread over lenses


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["vane.glb", "--turntable", "0"], ["--turntable 0", "1..2000"]),
        (["vane.glb", "--turntable", "4", "--rate", "0"], ["--rate 0"]),
        (["vane.glb", "--turntable", "4", "--pdf", "a.pdf"], ["--pdf"]),
        (["vane.ply", "--turntable", "4"], ["vane.ply", "give --up"]),
        (["tiny.xml", "--turntable", "4", "--up", "y"], ["tiny.xml is not a mesh"]),
        (["vane.glb", "-o", "a"], ["--out", "--turntable"]),
    ],
)
def test_mistakes_are_one_line(tmp_path, words, message):
    vane().export(tmp_path / "vane.glb")
    vane().export(tmp_path / "vane.ply")
    assert_refused("export", *words, folder=tmp_path, says=message)


@pytest.mark.parametrize(
    ("words", "message"),
    [(["--frames", "3"], ["turntable"]), (["--algorithms", "gu2020"], ["layered", "truth"])],
)
def test_mistakes_of_a_film_are_one_line(folder, words, message):
    assert_refused("film", "OUT", *words, folder=folder, says=message)
