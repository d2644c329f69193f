"""A display's parameters from decoded photographs.

Expected: lenses are counted right whatever the camera's roll, with half the sheet covered; the
model of a photograph is that of the lens models; hidden parameters are found within their standard
errors, and these are small; what photographs cannot tell is said and keeps the design's value.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from inim.calibration.decode import Decoded
from inim.calibration.fit import fit_display, fit_pose
from inim.calibration.lattice import Lenses, find_lenses
from inim.calibration.model import (
    PARAMETERS,
    Guess,
    Intrinsics,
    Observations,
    Pose,
    centres,
    directions,
    panel_points,
    project,
    rays,
)
from inim.calibration.output import (
    calibration_document,
    display_file,
    next_positions,
    residual_maps,
)
from inim.calibration.result import Calibration
from inim.display import DISPLAYS
from inim.documents.display import CalibrationDocument
from inim.documents.document import decode, encode
from inim.errors import FileError, UsageError
from inim.lens import trace_to_panel
from inim.scene.file import choose_display
from tests.calibration_photographs import Lens, look_at, photograph

DESIGN = DISPLAYS["phone"].replace(
    lens_columns=28, lens_rows=20, panel_columns=470, panel_rows=344, name="small"
)
ROWS, COLUMNS = DESIGN.eia_shape
HIDDEN = DESIGN.replace(
    pitch_mm=1.0073, gap_mm=3.05, panel_rows=ROWS, panel_columns=COLUMNS,
    rotation_deg=0.9, shift_x_mm=0.31, shift_y_mm=-0.22, tilt_x_deg=0.4, tilt_y_deg=-0.3,
)  # fmt: skip
CAMERA = Lens((360, 480), 1900.0, (246.0, 175.0), k1=0.4, k2=-1.0)
TRUE_CAMERA = Intrinsics(CAMERA.focal, *CAMERA.centre, CAMERA.k1, CAMERA.k2)
# Eyes, what they look at, and the camera's roll.
EYES = {
    "near": ((2.0, -1.0, 120.0), (0.3, 0.2, 0), 2.0),
    "far": ((-3.0, 2.0, 190.0), (-0.5, 0.0, 0), -1.0),
    "left": ((-32.0, 3.0, 125.0), (0.0, 0.4, 0), 1.0),
    "above": ((2.0, 34.0, 128.0), (0.2, 0.0, 0), -3.0),
}


@cache
def photograph_from(name: str, seed: int = 0) -> Decoded:
    eye, target, roll = EYES[name]
    return photograph(HIDDEN, CAMERA, eye, look_at(eye, target, roll), seed + len(name))


def covered(name: str, hides: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Decoded:
    """A photograph of which a part, by row and column, shows nothing."""
    photo = copied(photograph_from(name))
    for part in (photo.column, photo.row):
        part[hides(*np.mgrid[:360, :480])] = np.nan
    return photo


def copied(photo: Decoded) -> Decoded:
    return photo._replace(column=photo.column.copy(), row=photo.row.copy())


@cache
def fitted(*names: str) -> Calibration:
    return fit_display({name: lenses(name) for name in names}, DESIGN)


@cache
def straight_photograph() -> Decoded:
    """Photograph from a viewer's distance, square to the display."""
    eye, long = (1.0, -1.0, 350.0), CAMERA._replace(focal=5400.0)
    return photograph(HIDDEN, long, eye, look_at(eye, (1.0, -1.0, 0)), 5)


@cache
def straight_on() -> Calibration:
    return fit_display({"straight": find_lenses(straight_photograph(), DESIGN, "straight")}, DESIGN)


@cache
def lenses(name: str) -> Lenses:
    return find_lenses(photograph_from(name), DESIGN, name)


def truth(name: str) -> float:
    return float(getattr(HIDDEN, name, TRUE_CAMERA._asdict().get(name)))


# -- the camera -----------------------------------------------------------------------------------


def test_directions_undo_the_projection():
    camera = Intrinsics(1900.0, 246.0, 175.0, 0.4, -1.0)
    pose = Pose(look_at((5.0, 3, 120)), np.array([5.0, 3.0, 120.0]))
    points = np.random.default_rng(0).uniform(-14, 14, (200, 2))
    image_points = project(camera, pose, np.hstack([points, np.zeros((200, 1))]))
    straight = project(camera._replace(k1=0, k2=0), pose, np.hstack([points, np.zeros((200, 1))]))
    assert np.abs(image_points - straight).max() > 1, "the distortion shows"
    x, y, *_ = rays(camera, pose, image_points)
    np.testing.assert_allclose(np.stack([x, y], axis=-1), points, atol=1e-9)
    assert np.abs(directions(camera, np.array([[246.0, 175.0]]))).max() == 0


def test_projection_is_opencv_s():
    cv2 = pytest.importorskip("cv2")
    axes, eye = look_at((5.0, 3, 120), roll_deg=20), np.array([5.0, 3.0, 120.0])
    points = np.random.default_rng(0).uniform(-14, 14, (200, 3))
    # Pixel centres are at whole numbers there.
    matrix = np.array([[1900.0, 0, 246 - 0.5], [0, 1900.0, 175 - 0.5], [0, 0, 1]])
    there, _ = cv2.projectPoints(points, axes, -axes @ eye, matrix, np.array([0.4, -1, 0, 0]))
    here = project(Intrinsics(1900.0, 246.0, 175.0, 0.4, -1.0), Pose(axes, eye), points)
    np.testing.assert_allclose(here, there[:, 0] + 0.5, atol=1e-8)


# -- the lattice ----------------------------------------------------------------------------------


def true_index(numbering: Lenses, name: str, roll: float | None = None) -> np.ndarray:
    """Index of each lens by the crossing of its middle ray with the array."""
    eye, target, own = EYES[name]
    pose = Pose(look_at(eye, target, own if roll is None else roll), np.array(eye))
    x, y, *_ = rays(TRUE_CAMERA, pose, numbering.centre_px)
    angle = np.radians(HIDDEN.rotation_deg)
    x, y = x - HIDDEN.shift_x_mm, y - HIDDEN.shift_y_mm
    across, up = np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x
    column = np.floor(across / HIDDEN.pitch_mm + HIDDEN.lens_columns / 2)
    row = np.floor(HIDDEN.lens_rows / 2 - up / HIDDEN.pitch_mm)
    return np.stack([column, row], axis=-1).astype(int)


def offset(numbering: Lenses, name: str, roll: float | None = None) -> np.ndarray:
    """True indices less those found, one for all."""
    off = np.unique(true_index(numbering, name, roll) - numbering.index, axis=0)
    assert len(off) == 1, f"{name}: indices are off by {off.tolist()}"
    return np.asarray(off[0])


@pytest.mark.parametrize("name", EYES)
def test_every_lens_is_counted_right(name):
    numbering = lenses(name)
    offset(numbering, name)
    columns, rows = HIDDEN.lens_columns, HIDDEN.lens_rows
    assert len(numbering.index) >= 0.97 * columns * rows
    # Two lenses from the edges.
    assert 0.95 < numbering.is_whole.sum() / ((columns - 4) * (rows - 4)) <= 1
    inside = np.isfinite(numbering.panel_px).all(axis=-1)
    assert inside.mean() > 0.95


@pytest.mark.parametrize("roll", [35.0, 90.0, 180.0])
def test_a_camera_held_otherwise_counts_the_same(roll):
    eye, target, _ = EYES["far"]
    numbering = find_lenses(
        photograph(HIDDEN, CAMERA, eye, look_at(eye, target, roll), 1), DESIGN, "rolled"
    )
    offset(numbering, "far", roll)
    assert len(numbering.index) > 400


def test_a_thumb_over_half_the_sheet_hides_its_lenses_and_no_others():
    thumb = covered("near", lambda v, u: (u - 240) + 0.6 * (v - 180) > 10)
    numbering = find_lenses(thumb, DESIGN, "thumb")
    offset(numbering, "near")
    assert 200 < len(numbering.index) < 320


def test_a_lens_decoded_a_period_off_is_left_out():
    photo = copied(photograph_from("near"))
    before = lenses("near")
    wrong = 200
    at = before.centre_px[wrong]
    v, u = np.mgrid[:360, :480]
    photo.column[np.maximum(abs(u + 0.5 - at[0]), abs(v + 0.5 - at[1])) < 8] += 16
    numbering = find_lenses(photo, DESIGN, "wrong")
    offset(numbering, "near")
    off = true_index(before, "near")[wrong] - offset(numbering, "near")
    assert not (numbering.index == off).all(axis=1).any()
    assert len(numbering.index) >= len(before.index) - 2


def test_noise_is_no_lattice():
    random = np.random.default_rng(0)
    maps = [random.uniform(0, 48, (200, 300)).astype(np.float32) for _ in range(2)]
    noise = Decoded(*maps, maps[0] < 0, np.ones((2, 200, 300), complex), 0.0, ())
    with pytest.raises(FileError, match=r"^dark: no lattice of lenses"):
        find_lenses(noise, DESIGN, "dark")


def test_darkness_and_a_single_row_of_lenses_are_no_lattice():
    dark = covered("near", lambda v, _: v >= 0)
    row = covered("near", lambda v, _: (v >= 188) | (v < 174))
    for photo in (dark, row):
        with pytest.raises(FileError, match=r"^dark: no lattice of lenses"):
            find_lenses(photo, DESIGN, "dark")


# -- the model ------------------------------------------------------------------------------------


@pytest.mark.parametrize("side", ["viewer", "panel"])
def test_a_ray_lands_where_the_lens_model_has_it(side):
    display = HIDDEN.replace(curved_side=side)
    random = np.random.default_rng(2)
    index = random.integers(0, (28, 20), (500, 2))
    angle = np.radians(display.rotation_deg)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    lattice = (index + 0.5 - [14, 10]) * [1, -1] * display.pitch_mm
    near = lattice + random.uniform(-0.3, 0.3, (500, 2))
    at = near @ turn.T + [display.shift_x_mm, display.shift_y_mm]
    slopes = random.uniform(-0.25, 0.25, (2, 500))
    x, y, weight = trace_to_panel(display, "thick", *at.T, *slopes)
    assert weight.min() > 0.5
    landed = panel_points(display, index, np.stack([*at.T, *slopes]))
    np.testing.assert_allclose(landed, np.stack([x, y], axis=-1), atol=1e-12)


def test_a_ray_beyond_its_cell_stays_with_its_lens():
    index = np.array([[14, 10], [14, 10]])
    flat = HIDDEN.replace(rotation_deg=0, shift_x_mm=0, shift_y_mm=0, tilt_x_deg=0, tilt_y_deg=0)
    edge = np.array([[0.499, 0.501], [-0.5, -0.5], [0, 0], [0, 0]]) * 1.0073 + [
        [0.50365, 0.50365], [0, 0], [0, 0], [0, 0]]  # fmt: skip
    a, b = panel_points(flat, index, edge)
    assert np.abs(a - b).max() < 0.01


# Farther aside, behind a flat face, corners of the lenses reflect totally.
@pytest.mark.parametrize(
    ("side", "eye"), [("viewer", (-45.0, 30.0, 120.0)), ("panel", (-24.0, 18.0, 120.0))]
)
def test_outlines_are_at_the_visible_seams_of_the_relief(side, eye):
    display = HIDDEN.replace(curved_side=side)
    axes = look_at(eye)
    lens = Lens((540, 720), 2550.0, (360.0, 270.0))
    numbering = find_lenses(photograph(display, lens, eye, axes, 0, noise_px=0.0), DESIGN, "side")
    camera = Intrinsics(2550.0, 360.0, 270.0)
    pose = Pose(axes, np.array(eye))
    middle = len(numbering.index) // 2
    x, y, *_ = rays(camera, pose, numbering.centre_px[middle])
    angle = np.radians(display.rotation_deg)
    x, y = x - display.shift_x_mm, y - display.shift_y_mm
    column = np.floor((np.cos(angle) * x + np.sin(angle) * y) / display.pitch_mm + 14)
    row = np.floor(10 - (np.cos(angle) * y - np.sin(angle) * x) / display.pitch_mm)
    index = numbering.index - numbering.index[middle] + np.array([int(column), int(row)])
    whole = numbering.is_whole
    off = centres(display, camera, pose, index[whole]) - numbering.centre_px[whole]
    assert whole.sum() > 300
    assert np.abs(off.mean(axis=0)).max() < 0.05, "pixels"
    assert off.std(axis=0).max() < 0.3
    # As if seams were at z = 0: a lens much flatter, of the same pitch.
    flat = display.replace(focal_length_mm=1e4, gap_mm=3.0, lens_thickness_mm=1.0)
    shallow = centres(flat, camera, pose, index[whole]) - numbering.centre_px[whole]
    assert np.abs(shallow.mean(axis=0)).max() > 0.25


def at_truth() -> tuple[Observations, Guess]:
    """Photographs counted right, and what they are of."""
    counted = [replace(lenses(name), index=true_index(lenses(name), name)) for name in EYES]
    poses = [Pose(look_at(*way), np.array(way[0])) for way in EYES.values()]
    return Observations.of(counted, HIDDEN), Guess(HIDDEN, TRUE_CAMERA, tuple(poses))


def test_neither_blur_nor_hidden_seams_look_like_an_imperfect_sheet():
    numberings, guess = at_truth()

    def looks(numberings: Observations) -> np.ndarray:
        off = numberings.flat(guess)
        off = np.where(np.abs(off) < 0.5, off, 0)  # lenses at the edge of the sheet
        return np.array([of @ off / (of @ of) for of in numberings.imperfections(guess)[:2]])

    magnified, deeper = looks(numberings.without_blur(guess))
    assert abs(magnified) < 0.0006
    assert abs(deeper) < 0.02, "2 µm"
    blurred, _ = looks(numberings)
    assert blurred > 0.001, "found nearer to the axis than the rays of pixels' centres end"


@pytest.mark.parametrize("name", EYES)
def test_a_camera_pose_follows_from_photographs_of_a_known_display(name):
    eye, target, roll = EYES[name]
    pose = fit_pose(lenses(name), HIDDEN, TRUE_CAMERA, name)
    np.testing.assert_allclose(pose.eye_mm, eye, atol=0.1)
    np.testing.assert_allclose(pose.turn, look_at(eye, target, roll), atol=0.001)


def test_a_part_of_a_known_sheet_gives_the_pose():
    photo = covered("left", lambda _, u: (u < 120) | (u > 360))
    pose = fit_pose(find_lenses(photo, DESIGN, "part"), HIDDEN, TRUE_CAMERA, "part")
    np.testing.assert_allclose(pose.eye_mm, EYES["left"][0], atol=0.2)


def test_photographs_of_another_display_give_no_pose():
    with pytest.raises(FileError, match=r"^near: the photographs differ from display"):
        fit_pose(lenses("near"), HIDDEN.replace(rotation_deg=-2.0), TRUE_CAMERA, "near")


def test_noise_behind_the_black_matrix_is_not_another_display():
    position = lenses("near")
    noise = np.random.default_rng(2).normal(0, 0.8, position.panel_px.shape)
    noisy = replace(position, panel_px=position.panel_px + noise)
    pose = fit_pose(noisy, HIDDEN, TRUE_CAMERA, "near")
    np.testing.assert_allclose(pose.eye_mm, EYES["near"][0], atol=1.0)


# -- the fit --------------------------------------------------------------------------------------


def test_a_hidden_display_is_found_within_its_errors():
    result = fitted(*EYES)
    assert result.undetermined == [] and result.edges_seen == (True, True)
    for name, estimate in result.estimates.items():
        assert abs(estimate.value - truth(name)) < 4 * estimate.error, name
    # Of a sheet of 28 x 20 lenses in photographs of 480 x 360 pixels.
    most = {"pitch_mm": 0.002, "rotation_deg": 0.02, "shift_x_mm": 0.03, "gap_mm": 0.1}
    for name, limit in most.items():
        assert result.estimates[name].error < limit, name
        assert abs(truth(name) - getattr(DESIGN, name)) > 2 * limit, "the design would do"


def test_camera_poses_are_recovered():
    result = fitted(*EYES)
    for (eye, target, roll), pose, errors in zip(
        EYES.values(), result.guess.poses, result.pose_errors, strict=True
    ):
        assert (np.abs(pose.eye_mm - eye) < 4 * errors[3:6]).all()
        assert errors[3:5].max() < 0.5
        assert errors[5] < 0.03 * eye[2], "as the focal length of a position, which may change"
        np.testing.assert_allclose(pose.turn, look_at(eye, target, roll), atol=0.02)


@pytest.mark.slow
def test_one_straight_position_determines_the_rotation_only():
    result = straight_on()
    assert abs(result.display.rotation_deg - HIDDEN.rotation_deg) < 0.05
    assert {*result.undetermined} == {*PARAMETERS} - {"rotation_deg"}
    for name in result.undetermined:
        assert getattr(result.display, name) == getattr(DESIGN, name)
        estimate = result.estimates[name]
        assert abs(estimate.value - truth(name)) < 4 * estimate.error, name


def test_known_intrinsics_are_kept_and_help():
    result = fit_display({name: lenses(name) for name in EYES}, DESIGN, camera=TRUE_CAMERA)
    assert result.guess.camera == TRUE_CAMERA
    assert [*result.estimates] == [*PARAMETERS]
    own = fitted(*EYES)
    for name, estimate in result.estimates.items():
        assert abs(estimate.value - truth(name)) < 4 * estimate.error, name
        assert estimate.error < 1.3 * own.estimates[name].error


def test_a_steady_camera_has_narrower_intervals_and_has_not_moved():
    positions = {name: lenses(name) for name in ("left", "above")}
    steady = fit_display(positions, DESIGN, is_steady=True)
    free = fitted("left", "above")
    for name, estimate in steady.estimates.items():
        assert abs(estimate.value - truth(name)) < 4 * estimate.error, name
    ratio = max(free.estimates[k].error / steady.estimates[k].error for k in PARAMETERS)
    assert ratio > 1.05 and free.excess_by_skew == pytest.approx(ratio, rel=0.1)
    assert steady.excess_by_skew < 1.1
    moved = positions | {"above": replace(positions["above"], motion_px=0.3)}
    with pytest.raises(UsageError, match=r"^--steady: the camera moved by 0\.30 pixels.* of above"):
        fit_display(moved, DESIGN, is_steady=True)


def test_the_change_without_a_position_is_that_of_a_fit_without_it():
    whole, without = fitted(*EYES), fitted("far", "left", "above")
    assert np.abs(whole.left_out).max() < 4, "all positions show the same display"
    for n, name in enumerate(PARAMETERS):
        error = without.estimates[name].error
        change = (without.estimates[name].value - whole.estimates[name].value) / error
        assert whole.left_out[0, n] == pytest.approx(change, abs=0.5), name


@pytest.mark.slow
def test_half_the_sheet_under_a_thumb_still_works():
    photos = {name: covered(name, lambda _, u: u > 260) for name in EYES}
    numberings = {name: find_lenses(photo, DESIGN, name) for name, photo in photos.items()}
    result = fit_display(numberings, DESIGN)
    assert result.edges_seen == (False, True)
    for name in PARAMETERS:
        estimate = result.estimates[name]
        assert abs(estimate.value - truth(name)) < 4 * estimate.error, name
    assert result.estimates["rotation_deg"].is_known


@pytest.mark.slow
def test_without_its_edges_the_shift_nearest_to_the_design_is_given():
    def edges(name: str) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
        across = 95 if name == "far" else 150
        return lambda _, u: np.abs(u - 240) > across

    design = DESIGN.replace(shift_x_mm=2.0, panel_rows=ROWS, panel_columns=COLUMNS)
    cut = {name: find_lenses(covered(name, edges(name)), DESIGN, name) for name in EYES}
    result = fit_display(cut, design)
    assert result.edges_seen == (False, True)
    shift = result.guess.display.shift_x_mm
    angle = np.radians(HIDDEN.rotation_deg)
    # Whole steps along the array's own rows; 0.31 and 2.31 are 2 off, 1.3 is nearest to 2.
    steps = (shift - HIDDEN.shift_x_mm) / (HIDDEN.pitch_mm * np.cos(angle))
    assert abs(steps - 2) < 0.2


# -- what is refused ------------------------------------------------------------------------------


def test_photographs_of_another_display_are_refused():
    other = DESIGN.replace(pitch_mm=1.08, panel_rows=ROWS, panel_columns=COLUMNS)
    with pytest.raises(FileError, match=r"^near: the marks .* are not those of display small;"):
        find_lenses(photograph_from("near"), other, "near")


@pytest.mark.parametrize(
    "zoom", [1.25, *(pytest.param(z, marks=pytest.mark.slow) for z in (0.9, 1.1))]
)
def test_patterns_that_the_browser_scaled_are_refused(zoom):
    near = lenses("near")
    scaled = replace(near, panel_px=near.panel_px / zoom, middle_px=near.middle_px / zoom)
    with pytest.raises(
        FileError,
        match=r"^near: the lenses are .* show the patterns in the browser pixel for pixel",
    ):
        fit_display({"near": scaled}, DESIGN)


def test_more_lenses_than_there_are_is_another_display():
    fewer = DESIGN.replace(lens_columns=20, panel_rows=ROWS, panel_columns=COLUMNS)
    with pytest.raises(
        FileError, match=r"28 columns of lenses are visible, but display small has 20"
    ):
        fit_display({"near": lenses("near"), "far": lenses("far")}, fewer)


def test_mirrored_photographs_are_refused():
    photo = photograph_from("near")
    mirrored = Decoded(*(part[..., ::-1] for part in photo[:4]), 0.0, ())
    with pytest.raises(FileError, match=r"^near: the photographs are mirrored"):
        fit_display({"near": find_lenses(mirrored, DESIGN, "near")}, DESIGN)


def test_another_size_of_photograph_is_another_camera():
    other = replace(lenses("far"), shape=(480, 360))
    with pytest.raises(FileError, match="480 x 360 and of 360 x 480 pixels"):
        fit_display({"near": lenses("near"), "far": other}, DESIGN)


@pytest.mark.slow
def test_a_sheet_that_slipped_between_positions_is_refused():
    eye, target, roll = EYES["far"]
    slipped = HIDDEN.replace(rotation_deg=HIDDEN.rotation_deg + 1)
    photo = photograph(slipped, CAMERA, eye, look_at(eye, target, roll), 3)
    numberings = {"near": lenses("near"), "far": find_lenses(photo, DESIGN, "far")}
    with pytest.raises(FileError, match="all show the same sheet"):
        fit_display(numberings, DESIGN)


def test_a_strip_of_the_sheet_is_too_little():
    strip = covered("near", lambda _, u: u >= 90)
    with pytest.raises(FileError, match=r"^strip: \d+ lenses are completely visible"):
        fit_display({"strip": find_lenses(strip, DESIGN, "strip")}, DESIGN)


def test_other_lattices_are_refused():
    with pytest.raises(UsageError, match="lattice = 'hexagonal' cannot be calibrated"):
        fit_display({"near": lenses("near")}, DESIGN.replace(lattice="hexagonal"))


# -- what is written ------------------------------------------------------------------------------


def test_the_display_file_is_the_display(tmp_path):
    result = fitted(*EYES)
    path = tmp_path / "mine.xml"
    path.write_text(display_file(result, "phone"), "utf-8")
    display, _ = choose_display(str(path))
    for key, value in result.display.parameters().items():
        if key in PARAMETERS:  # digits end at a hundredth of the error
            assert abs(getattr(display, key) - value) <= 0.005 * result.estimates[key].error, key
        elif key != "name":
            assert getattr(display, key) == value, key
    assert display.name == "phone, changed"
    assert path.read_text("utf-8").count("±") == len(PARAMETERS)


def test_a_file_of_undetermined_parameters_is_marked():
    result = fitted(*EYES)
    vague = {n: result.estimates[n]._replace(error=9.0) for n in ("gap_mm", "tilt_x_deg")}
    result = replace(result, estimates=result.estimates | vague)
    lines = display_file(result, "phone").splitlines()
    for name in vague:
        (line,) = [line for line in lines if f"inim.{name}" in line]
        assert "not determined" in line
        assert f'value="{getattr(DESIGN, name):g}"' in line
    assert sum("not determined" in line for line in lines) == len(vague)


def test_maps_of_residuals_have_no_pattern(tmp_path):
    for values in residual_maps(fitted(*EYES)).maps.values():
        panel, outline = values[..., :2], values[..., 2:]
        assert panel.shape == outline.shape == (20, 28, 2)
        # Noise of a lens: a third of a panel pixel and a fifth of a photograph's.
        assert np.nanmedian(np.abs(panel)) < 20
        assert np.nanmedian(np.abs(outline)) < 0.2
        left, right = np.nanmean(panel[:, :14, 0]), np.nanmean(panel[:, 14:, 0])
        assert abs(left - right) < 5


@pytest.mark.slow
def test_advice_estimates_the_gain_of_a_further_position():
    three = fitted("near", "left", "above")
    advised = next_positions(three)
    document = calibration_document(three, "Calibration", "inim calibrate")
    assert decode(encode(document), CalibrationDocument) == document
    assert len(document.next) == 3
    own = three.estimates
    assert all(
        advice.standard_errors[name] <= own[name].error for advice in advised for name in PARAMETERS
    )
    best = advised[0]
    photo = photograph(HIDDEN, CAMERA, best.eye_mm, look_at(best.eye_mm), 9)
    numberings = {name: lenses(name) for name in ("near", "left", "above")}
    more = fit_display({**numberings, "new": find_lenses(photo, DESIGN, "new")}, DESIGN)
    for name in ("gap_mm", "focal_length_mm"):
        promised = best.standard_errors[name] / own[name].error
        ratio = more.estimates[name].error / own[name].error
        assert promised / 2 < ratio < 2 * promised, name
