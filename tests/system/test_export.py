"""`inim export` as its users run it: whose EIA, which views, and back again.

Expected: without a name it is the best algorithm's EIA; a light field comes back as what it was
made of; a quilt's tiles are what eyes see from left to right across the viewing zone; every mistake
is one line before anything is rendered.
"""

import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from inim.apps.own_picture.depth_values import DepthValues
from inim.apps.own_picture.fit import fit_picture, map_depth
from inim.cli.main import main
from inim.display import Display
from inim.display.lens import white_exposure
from inim.display.viewpoint import zone_eyes
from inim.generators import generate
from inim.image.color import to_srgb
from inim.image.files.eia_file import read_eia, write_eia
from inim.image.files.image import read_rgbd, write_exr
from inim.image.files.light_field import eia_from_views, read_hci
from inim.image.rgbd import RGBD
from inim.pipeline.stages.scene import seed_of
from inim.render.scene_files.file import read_scene_file
from inim.report import Report
from inim.scores.metrics import ssim
from inim.system.errors import EXIT_PASSED, EXIT_USAGE
from tests.conftest import scene_text, small_display, sphere, square
from tests.system.conftest import (
    Ended,
    assert_one_line,
    assert_refused,
    definitions,
    nothing_left,
    run_here,
)
from tests.unit.test_light_field import quilt_views

#: Few samples of few pixels, and still lenses enough for a picture to be told from another.
QUICK = {"lens_columns": 20, "lens_rows": 16, "pixel_pitch_mm": 1 / 9, "lens_model": "pinhole"}
QUICK |= {"capture_spp": 16, "eia_spp": 8, "view_spp": 8, "reconstruction_spp": 8}
QUICK |= {"algorithms": "wang2024,template", "viewpoints": "centre", "view_pixels_per_lens": 2}
DISPLAY = small_display(20, 16, 9)


def words(settings: dict[str, object], *names: str) -> list[str]:
    """Settings, all or those named, for the command line."""
    chosen = names or tuple(settings)
    return definitions({f"inim.{name}": str(settings[name]) for name in chosen})


@pytest.fixture(scope="module")
def export_folder(no_page, tmp_path_factory):
    """A folder with a scene, of a colour given by -D, and its report OUT; the worse is first."""
    folder = tmp_path_factory.mktemp("export")
    shapes = (
        sphere((0, 0, 1), 1.2),
        square((-1, 1, 0), 1.5, "$red"),
        square((1, -1, 2), 0.7, "0.1,0.9,0.1"),
    )
    text = scene_text('<default name="red" value="0.1,0.1,0.9"/>', *shapes)
    (folder / "scene.xml").write_text(text, encoding="utf-8")
    options = [*words(QUICK), "-D", "red=0.9,0.1,0.1"]
    ended = run_here("validate", "scene.xml", "-o", "OUT", *options, "--quiet", folder=folder)
    assert ended.code == EXIT_PASSED, ended.stderr
    return folder


@pytest.fixture
def folder(export_folder, tmp_path):
    """The same, to be changed."""
    return Path(shutil.copytree(export_folder, tmp_path / "made"))


def export(folder: Path, *more: str) -> Ended:
    return run_here("export", "OUT", *more, folder=folder)


def test_the_best_algorithm_is_exported_unless_another_is_named(folder):
    pictures = {n: Image.open(folder / f"OUT/eia/{n}.png") for n in ("template", "wang2024")}
    pictures["truth"] = Image.open(folder / "OUT/truth/eia.png")
    best = ", the best of 2 by SSIM on the relic, to the reference"
    for options, name, why in (
        ([], "template", best),
        (["--algorithms", "wang2024"], "wang2024", ""),
        (["--algorithms", "truth"], "truth", ""),
    ):
        ended = export(folder, "--hci", name, *options)
        assert (ended.code, ended.stdout) == (0, f"{name}\nexported {name}{why}\n"), ended.stderr
        eia = eia_from_views(read_hci(folder / name).views, DISPLAY)
        np.testing.assert_array_equal(eia, np.asarray(pictures[name]))


def once_a_lens(rgbd: RGBD, display: Display) -> RGBD:
    """The picture's samples at lens centres, as a camera of one pixel a lens on the array."""
    at = [
        np.floor((np.arange(n) - (n - 1) / 2) / rgbd.pixel_mm + size / 2).astype(int)
        for n, size in zip((display.lens_rows, display.lens_columns), rgbd.shape, strict=True)
    ]
    place = np.ix_(*at)
    return RGBD(rgbd.color[place], rgbd.depth_mm[place], rgbd.covered[place], display.pitch_mm)


def test_a_report_s_light_field_regenerates_its_picture_sampled_once_per_lens(folder):
    """Disparity is of the true depth: what differs from the report's own EIA is the sampling.

    Lenses see the picture's pixel at their centre; the light field has one sample a lens, in codes
    of 8 bits. The EIA in the report is replaced with nearest colours, which are the picture's own.
    """
    nearest = "template:samples=1:colour=nearest"
    display, own = Report.load(folder / "OUT").display, read_rgbd(folder / "OUT/rgbd.exr")
    fine = generate(own, display, nearest)
    write_exr(folder / "OUT/eia/template.exr", fine)
    assert export(folder, "--hci", "hci", "--algorithms", "template").code == EXIT_PASSED
    options = words(QUICK, "lens_columns", "lens_rows", "pixel_pitch_mm")
    out = ["-o", "eia.exr", "--save-rgbd", "rgbd.exr", "--algorithms", nearest]
    ended = run_here("generate", "hci", *options, *out, folder=folder)
    assert ended.code == EXIT_PASSED, ended.stderr
    assert "clipped    0.0%" in ended.stdout
    coarse = once_a_lens(own, display)
    depth = np.where(coarse.covered, coarse.depth_mm, np.nan).astype(np.float32)
    values, ends = DepthValues(depth, True, False, 0.0, ()), display.depth_range_mm[::-1]
    to_range = map_depth("linear", values, ends, display)
    expected = fit_picture(
        coarse.color, values, to_range, display, camera=None, pixels_per_pitch=5
    ).rgbd
    back = read_rgbd(folder / "rgbd.exr")
    np.testing.assert_array_equal(back.covered, expected.covered)
    np.testing.assert_allclose(back.depth_mm, expected.depth_mm, atol=1e-3)
    codes = [to_srgb(layer.color).astype(int)[expected.covered] for layer in (back, expected)]
    assert np.abs(codes[0] - codes[1]).max() <= 1
    # So as an EIA it is as near to the report's as sampling once a lens lets it be.
    sampled = ssim(fine, generate(expected, display, nearest))
    score = ssim(fine, read_eia(folder / "eia.exr", display)[0])
    assert score == pytest.approx(sampled, abs=0.005)
    # With all of it in one plane it would be another.
    plane = np.where(expected.covered, np.float32(30), np.float32(0))
    flat = RGBD(expected.color, plane, expected.covered, expected.pixel_mm)
    assert ssim(fine, generate(flat, display, nearest)) < sampled - 0.02


def test_a_quilt_of_the_truth_is_the_scene_traced_again(folder, renderer):
    from inim.render.ground_truth import true_view
    from inim.render.scene import open_scene

    quilt = ["--algorithms", "truth", "--quilt", "q.png", "--tiles", "3x2", "--view-size", "50x64"]
    ended = export(folder, *quilt, "--view-spp", "4")
    assert (ended.code, ended.stdout) == (0, "q_qs3x2a0.78125.png\nexported truth\n"), ended.stderr
    views = quilt_views(folder / "q_qs3x2a0.78125.png", 3, 2)
    file = read_scene_file(folder / "scene.xml", {"red": "0.9,0.1,0.1"})
    fitted = open_scene(file, DISPLAY, 0.85)
    eyes = zone_eyes(DISPLAY, 6)
    for k in (0, 4):
        view = true_view(
            fitted, DISPLAY, eyes[k], pixels_per_lens=2.5, spp=4, seed=seed_of("views", 0)
        )[0].image
        assert view.shape == (40, 50, 3)
        np.testing.assert_array_equal(views[k, 12:52], to_srgb(view))
    assert not views[:, :12].any()
    assert not views[:, 52:].any()
    assert nothing_left(folder)
    # Another scene than the report's is not traced in its place.
    text = (folder / "scene.xml").read_text("utf-8")
    (folder / "scene.xml").rename(folder / "kept.xml")
    ended = export(folder, *quilt)
    assert ended.code == EXIT_USAGE
    assert_one_line(ended.stderr, ["scene.xml"])
    (folder / "scene.xml").write_text(text.replace("1.2", "1.3"), encoding="utf-8")
    ended = export(folder, *quilt)
    assert ended.code == EXIT_USAGE
    assert_one_line(ended.stderr, ["scene.xml", "differs from the report's scene", "--scene"])
    assert export(folder, *quilt, "--scene", "kept.xml", "--view-spp", "2").code == EXIT_PASSED


@pytest.mark.parametrize("model", ["pinhole", "thin"])
def test_a_quilt_s_tiles_are_views_across_the_zone(tmp_path, renderer, model):
    """Near things move against the eye: x = -e z / (V - z) on the array, for eyes at (e, V)."""
    from inim.render.reconstruct import reconstruct

    z, shape, pixel = 24.0, DISPLAY.capture_shape(5), 0.2
    color = np.zeros((*shape, 3), np.float32)
    middle = [n // 2 for n in shape]
    color[middle[0] - 7 : middle[0] + 8, middle[1] - 7 : middle[1] + 8] = 1
    rgbd = RGBD(color, np.full(shape, z, np.float32), np.ones(shape, bool), pixel)
    write_eia(tmp_path / "eia.exr", generate(rgbd, DISPLAY), None, DISPLAY.pixel_pitch_mm)
    names = ("lens_columns", "lens_rows", "pixel_pitch_mm")
    options = [*words(QUICK, *names), "-D", f"inim.lens_model={model}"]
    quilt = ["--quilt", "made/q.png", "--tiles", "3x2", "--view-size", "60x48", "--view-spp", "16"]
    ended = run_here("export", "eia.exr", *options, *quilt, folder=tmp_path)
    assert (ended.code, ended.stdout) == (0, "made/q_qs3x2a1.25.png\nexported eia.exr\n")
    views = quilt_views(tmp_path / "made/q_qs3x2a1.25.png", 3, 2)
    eyes, eia = zone_eyes(DISPLAY, 6), read_eia(tmp_path / "eia.exr", DISPLAY)[0]
    x = (np.arange(60) + 0.5 - 30) / 3
    for view, eye in zip(views, eyes, strict=True):
        eye_view = reconstruct(eia, DISPLAY, eye, model, pixels_per_lens=3, spp=16, seed=0)
        exposed = np.float32(white_exposure(DISPLAY, model)) * eye_view
        np.testing.assert_array_equal(view, to_srgb(exposed))
        light = eye_view[..., 0].sum(axis=0)
        expected = -eye.x_mm * z / (eye.z_mm - z)
        assert (light @ x) / light.sum() == pytest.approx(expected, abs=DISPLAY.pitch_mm / 2)
    assert eyes[0].x_mm < 0 < eyes[-1].x_mm
    assert nothing_left(tmp_path)


@pytest.mark.parametrize("pixels", [16, 15])
def test_views_are_exported_and_come_back(tmp_path, capsys, pixels):
    display = small_display(columns=6, rows=5, pixels=pixels)
    eia = np.random.default_rng(2).integers(0, 256, (*display.eia_shape, 3)).astype(np.uint8)
    Image.fromarray(eia).save(tmp_path / "eia.png")
    sizes = {"lens_columns": 6, "lens_rows": 5, "pixel_pitch_mm": repr(1 / pixels)}
    more = [word for k, v in sizes.items() for word in ("-D", f"inim.{k}={v}")]
    targets = {o: str(tmp_path / o[2:]) for o in ("--views", "--hci")}
    targets["--pdf"] = str(tmp_path / "sheet.pdf")
    targeted = [word for pair in targets.items() for word in pair]
    assert main(["export", str(tmp_path / "eia.png"), *more, *targeted]) == EXIT_PASSED
    views = read_hci(tmp_path / "hci").views
    np.testing.assert_array_equal(eia_from_views(views, display), eia)
    assert capsys.readouterr().out.splitlines()[-1] == "exported eia.png"
    page = (tmp_path / "sheet.pdf").read_bytes().split(b"/MediaBox [")[1].split(b"]")[0]
    assert [float(v) for v in page.split()] == pytest.approx([0, 0, 6 / 25.4 * 72, 5 / 25.4 * 72])
    view = np.asarray(Image.open(tmp_path / "views" / "view_02_03.png"))
    np.testing.assert_array_equal(view, views[2, 3])
    back = tmp_path / "back.png"
    options = [str(tmp_path / "hci"), "--all-views", *more, "-o", str(back)]
    assert main(["generate", *options]) == EXIT_PASSED
    np.testing.assert_array_equal(np.asarray(Image.open(back).convert("RGB")), eia)


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ((), "give --pdf FILE, --views DIR, --hci DIR, --quilt FILE or --native FILE"),
        (("--pdf", "sheet.png"), "not a PDF file name; use .pdf"),
        (("--quilt", "q.png", "--tiles", "8"), "--tiles 8: write ACROSSxDOWN"),
        (("--views", "eia.png"), "is a file; name a folder"),
        (("--views", "v", "--algorithms", "template"), "needs a report's folder"),
        (("--views", "v", "-D", "inim.rotation_deg=3"), "rotation_deg = 3"),
        (("--views", "v", "--display", "phone"), "needs 2400 x 1080"),
    ],
)
def test_an_export_that_cannot_be_is_one_line(tmp_path, more, says):
    Image.new("RGB", (1088, 1088)).save(tmp_path / "eia.png")
    assert_refused("export", "eia.png", *more, folder=tmp_path, says=[says])
