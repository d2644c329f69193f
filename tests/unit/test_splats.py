"""Splats: their files, their turns, and rays through them against closed forms and a mesh."""

import math
from dataclasses import replace

import numpy as np
import pytest

from inim.display import Viewpoint
from inim.image.color import linear_from_srgb, srgb_from_linear
from inim.render.meshes.ply import write_ply
from inim.render.meshes.splat_ply import check_splats, is_splats, read_splats, write_splats
from inim.render.meshes.triangle_mesh import Mesh
from inim.render.scene_files.relic_scene import SIZE_MM, Frame, place_splats, rotate_splats
from inim.system.errors import FileError, SceneError, UsageError
from inim.system.process.observer import Observer
from tests.conftest import box_surface, small_display, square
from tests.splat_relics import joined, on_triangles, random_splats, splat_scene, splats_at

DISPLAY = small_display()
PER_PITCH = 4


def rotation(seed=1):
    """Some rotation."""
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q *= np.sign(np.diag(r))
    return q * np.linalg.det(q)


# --- Files --------------------------------------------------------------------------------------


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_splats_come_back_as_they_were_written(tmp_path, degree):
    splats, path = random_splats(50, degree), tmp_path / "s.ply"
    write_splats(path, splats)
    data = path.read_bytes()
    assert is_splats(data) and check_splats(path, data) == 50
    back = read_splats(path, data)
    for name in splats.__dataclass_fields__:
        np.testing.assert_allclose(getattr(back, name), getattr(splats, name), rtol=1e-6)


def _changed(data, name, value):
    """A file whose fourth splat has another value."""
    head, mark, body = data.partition(b"end_header\n")
    names = [w.split()[2] for w in head.decode().splitlines() if w.startswith("property")]
    table = np.frombuffer(body, "<f4").reshape(-1, len(names)).copy()
    for part in name.split():
        table[3, names.index(part)] = value
    return head + mark + table.tobytes()


DAMAGES = {
    "cut short": (lambda d: d[:-5], "cut short"),
    "counts too many": (lambda d: d.replace(b"vertex 20", b"vertex 21"), "cut short"),
    "counts absurdly": (lambda d: d.replace(b"vertex 20", b"vertex 9999999999999"), "cut short"),
    "counts none": (lambda d: d.replace(b"vertex 20", b"vertex 0"), "no splats"),
    "counts too few": (lambda d: d.replace(b"vertex 20", b"vertex 19"), "does not match"),
    "no header end": (lambda d: d.replace(b"end_header", b"comment x."), "no end"),
    "no opacity": (lambda d: d.replace(b"float opacity", b"float opacitz"), "no 'opacity'"),
    "no scale": (lambda d: d.replace(b"float scale_1", b"float scalf_1"), "no 'scale_1'"),
    "odd harmonics": (lambda d: d.replace(b"float f_rest_3\n", b"float g_rest_3\n"), "f_rest"),
    "packed": (lambda d: d.replace(b"float opacity", b"float packed_position"), "packed"),
    "twice": (lambda d: d.replace(b"float ny", b"float nx"), "twice"),
    "nan": (lambda d: _changed(d, "f_rest_1", np.nan), "splat 3 is not finite"),
    "infinite": (lambda d: _changed(d, "z", np.inf), "splat 3 is not finite"),
    "no turn": (lambda d: _changed(d, "rot_0 rot_1 rot_2 rot_3", 0), "splat 3 has no orientation"),
    "huge": (lambda d: _changed(d, "scale_0", 80), "splat 3 has an implausible position"),
    "thin": (lambda d: _changed(d, "scale_2", -80), "splat 3 is implausibly thin"),
    "far": (lambda d: _changed(d, "x", 1e20), "splat 3 has an implausible position"),
}  # fmt: skip


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_file_gets_one_line(tmp_path, damage):
    path = tmp_path / "s.ply"
    write_splats(path, random_splats(20, 1))
    harm, says = DAMAGES[damage]
    harmed = harm(path.read_bytes())
    assert harmed != path.read_bytes()
    path.write_bytes(harmed)
    for reader in (lambda: read_splats(path, harmed), lambda: check_splats(path, harmed)):
        with pytest.raises(FileError, match=says) as caught:
            reader()
        assert "\n" not in str(caught.value) and "s.ply" in str(caught.value)


# --- Frame and turn -----------------------------------------------------------------------------


def test_the_frame_leaves_out_floaters_and_holds_the_relic():
    relic = random_splats(4000, 0)
    relic = replace(relic, log_scale=relic.log_scale - 2)
    far = splats_at(np.array([[90.0, 0, 0], [0, -70, 0], [0, 0, 200]]), 0.1, 0.9, np.ones(3))
    wide = splats_at(np.zeros((1, 3)), 20.0, 0.9, np.ones(3))
    faint = splats_at(np.zeros((1, 3)), 0.1, 0.005, np.ones(3))
    frame = Frame.around(joined(relic, far))
    assert (frame.low > -1.3).all() and (frame.high < 1.3).all()
    placed, half = place_splats(joined(relic, far, wide, faint), np.eye(3), frame)
    assert 0.9 * len(relic) < len(placed) <= len(relic)
    assert 2 * half.max() == pytest.approx(SIZE_MM)


def test_crop_keeps_the_splats_in_the_box():
    splats = splats_at(np.array([[0.0, 0, 0], [5, 0, 0]]), 0.01, 0.9, np.ones(3))
    cropped, _ = place_splats(splats, np.eye(3), Frame.parse("4,6,-1,1,-1,1"))
    assert len(cropped) == 1
    with pytest.raises(UsageError, match=r"no splat can be shown: 0 of .* outside the box"):
        place_splats(splats, np.eye(3), Frame.parse("8,9,-1,1,-1,1"))


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_colours_turn_with_the_splats(renderer, degree):
    """Mitsuba's own harmonics agree: a turned splat shows its colour in the turned direction."""
    import drjit as dr
    import mitsuba as mi

    splats, turn = random_splats(40, degree), rotation()
    directions = np.random.default_rng(2).normal(size=(30, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)

    def colours(splats, directions):
        along = mi.Vector3f(*(mi.Float(column.astype(np.float32)) for column in directions.T))
        basis = np.stack(
            [np.asarray(values + dr.zeros(mi.Float, 30)) for values in dr.sh_eval(along, degree)]
        )
        return np.einsum("nkc,kd->dnc", splats.harmonics, basis)

    after = colours(rotate_splats(splats, turn), directions @ turn.T)
    np.testing.assert_allclose(after, colours(splats, directions), atol=2e-6)


def light_along(scene, origin, direction):
    import mitsuba as mi

    from inim.render.splats import absorption, radiance

    ray = mi.Ray3f(*(
        kind(*(mi.Float(column.astype(np.float32)) for column in vectors.T))
        for kind, vectors in ((mi.Point3f, origin), (mi.Vector3f, direction))
    ))  # fmt: skip
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, len(origin))
    colour = np.stack(
        [np.asarray(c) for c in radiance(scene, scene.integrator(), sampler, ray)], -1
    )
    return colour, absorption(scene, scene.integrator(), ray)


# --- Rays ---------------------------------------------------------------------------------------


def pane(z, opacity, rgb, sigma=30.0):
    """One wide flat splat that faces the viewer: an even sheet about its middle."""
    return splats_at(
        np.array([[0.0, 0, z]]), np.array([sigma, sigma, 0.02]), opacity, np.array(rgb)
    )


def rays_at(places):
    places = np.atleast_2d(np.asarray(places, float))
    origin = np.column_stack([places, np.full(len(places), 20.0)])
    return origin, np.tile([0.0, 0, -1], (len(places), 1))


def test_a_pane_transmits_the_rest_of_its_gaussian(open_fitted, tmp_path):
    fitted = open_fitted(splat_scene(tmp_path, pane(0, 0.6, [0.5, 0.2, 0.1], 4.0)), DISPLAY)
    places = np.array([[0.1, 0.2], [3.0, 1.0], [-2.0, 5.0]])
    colour, lost = light_along(fitted.scene, *rays_at(places))
    opacity = 0.6 * np.exp(-((places / 4) ** 2).sum(axis=1) / 2)
    np.testing.assert_allclose(1 - lost.left, opacity, atol=1e-5)
    shade = srgb_from_linear(np.array([0.5, 0.2, 0.1]))
    np.testing.assert_allclose(colour, linear_from_srgb(opacity[:, None] * shade), atol=1e-4)
    assert lost.half[0] == pytest.approx(20, abs=1e-3) and np.isinf(lost.half[2])
    assert not lost.twice.any()


def test_light_in_a_slab_is_lost_as_beer_and_lambert_say(open_fitted, tmp_path):
    """Panes 0.2 apart, each taking 5 %: half is gone where the exponential says, to one pane."""
    depths = np.arange(0, -10, -0.2)
    slab = joined(*(pane(z, 0.05, [0.3, 0.3, 0.3], 300.0) for z in depths))
    fitted = open_fitted(splat_scene(tmp_path, slab), DISPLAY)
    _, lost = light_along(fitted.scene, *rays_at([[0.0, 0.1], [0.5, -0.4]]))
    per_unit = -math.log(0.95) / 0.2
    for share, depth in ((0.1, lost.tenth), (0.5, lost.half), (0.9, lost.most)):
        expected = 20 - math.log(1 - share) / per_unit
        assert (depth > expected - 0.2 - 1e-3).all() and (depth < expected + 1e-3).all()
    np.testing.assert_allclose(lost.left, 0.95 ** len(depths), atol=1e-4)


def test_two_sheets_are_two_layers_each_with_its_own_colours(open_fitted, tmp_path):
    from inim.render.depth_peeling import peel
    from inim.render.ground_truth import capture, capture_layers
    from inim.render.scene import fit_to_display

    red, green = np.array([0.7, 0.02, 0.02]), np.array([0.02, 0.6, 0.02])
    sheets = joined(pane(3, 0.8, red), pane(-5, 0.7, green))
    fitted = open_fitted(splat_scene(tmp_path, sheets), DISPLAY)
    # The display sees the middle of the panes only, where they are even.
    middle = np.array([[x, y, z] for x in (-0.6, 0.6) for y in (-0.5, 0.5) for z in (-6, 4)])
    fit = fit_to_display(middle, np.eye(3), DISPLAY, 0.85, "panes")
    fitted = replace(fitted, fit=fit)
    peeled = peel(fitted, DISPLAY, pixels_per_pitch=PER_PITCH, hidden=True)
    layered = capture_layers(fitted, peeled, spp=2, seed=1)
    rows, columns = layered.shape
    middle = np.s_[rows // 2 - 2 : rows // 2 + 2, columns // 2 - 2 : columns // 2 + 2]
    z = (
        fitted.fit.display_from_world[2, 2] * np.array([3, -5])
        + fitted.fit.display_from_world[2, 3]
    )
    assert len(layered.layers) == 2
    whole = srgb_from_linear(red), srgb_from_linear(green)
    behind = 0.7 * whole[1]
    for layer, depth, shade in zip(
        layered.layers, z, (0.8 * whole[0] + 0.2 * behind, behind), strict=True
    ):
        assert layer.covered[middle].all()
        np.testing.assert_allclose(layer.front_mm[middle], depth, atol=1e-3)
        np.testing.assert_allclose(layer.back_mm[middle], depth, atol=1e-3)
        colors = layer.color[middle].reshape(-1, 3)
        np.testing.assert_allclose(colors, np.tile(linear_from_srgb(shade), (16, 1)), atol=0.01)
    captured = capture(fitted, DISPLAY, pixels_per_pitch=PER_PITCH, spp=2, seed=1)
    np.testing.assert_array_equal(captured.depth_mm[middle], layered.depth_mm[middle])


def test_ellipsoids_that_are_met_twice_are_noticed(open_fitted, tmp_path):
    """Mitsuba 3.9.1 rounds where it meets thin ellipsoids; shells of triangles it meets once."""
    thin = splats_at(np.zeros((1, 3)), np.array([2.0, 2.0, 0.003]), 0.5, np.ones(3))
    for shape, twice in (("ellipsoids", True), ("ellipsoidsmesh", False)):
        fitted = open_fitted(splat_scene(tmp_path, thin, shape), DISPLAY)
        _, lost = light_along(
            fitted.scene, *rays_at(np.random.default_rng(1).uniform(-1, 1, (50, 2)))
        )
        assert lost.twice.any() == twice


def test_black_splats_do_not_change_the_eia(open_fitted, tmp_path):
    from inim.render.ground_truth import pickup

    relic = random_splats(60, 1)
    relic = replace(relic, log_scale=relic.log_scale - 1.5)
    faint = replace(relic[:5], logit=np.full(5, -6, np.float32))  # Mitsuba's extents: not a number
    text = splat_scene(tmp_path, joined(relic, faint)).replace(
        "</shape>", '<boolean name="extent_adaptive_clamping" value="true"/></shape>'
    )
    fitted, observers = open_fitted(text, DISPLAY), (Observer(), Observer())
    eias = [
        pickup(fitted, DISPLAY, spp=2, seed=1, skip=skip, observer=observer).image
        for skip, observer in zip((True, False), observers, strict=True)
    ]
    assert eias[0].max() > 0.1
    np.testing.assert_array_equal(*eias)
    assert observers[0].samples < 0.9 * observers[1].samples


def test_more_splats_than_memory_holds_are_refused(open_fitted, tmp_path, monkeypatch):
    monkeypatch.setattr("inim.render.scene.memory_limit_bytes", lambda: 10_000)
    with pytest.raises(SceneError, match=r"60 splats take .* keep fewer"):
        open_fitted(splat_scene(tmp_path, random_splats(60, 0)), DISPLAY)


def test_splats_and_surfaces_do_not_mix(open_fitted, tmp_path):
    text = splat_scene(tmp_path, pane(0, 0.5, [0.5] * 3))
    with pytest.raises(SceneError, match="shows splats only"):
        open_fitted(text.replace("</scene>", square((0, 0, 1), 2, "0.5") + "</scene>"), DISPLAY)
    with pytest.raises(SceneError, match="volprim_rf_basic"):
        open_fitted(text.replace("volprim_rf_basic", "path"), DISPLAY)


# --- Against a mesh -----------------------------------------------------------------------------


def gem():
    """A turned box, convex, each corner with a colour of its own."""
    corner, faces = box_surface()
    corner = 2 * corner.astype(float) - 1
    return corner @ rotation(4).T * 5, faces, 0.45 + 0.35 * corner


def compared(open_fitted, tmp_path, per_edge):
    """Differences between a mesh and its splats: EIA, view, depth, coverage; size of the splats."""
    from inim.render.ground_truth import capture, pickup, true_view

    vertices, faces, colors = gem()
    mesh = Mesh(
        vertices.astype(np.float32), faces.astype(np.uint32), color=colors.astype(np.float32)
    )
    write_ply(tmp_path / "gem.ply", mesh)
    # A convex body in even light, which it reflects once: what it shows are its colours.
    lit = """<scene version="3.0.0"><integrator type="direct">
        <integer name="emitter_samples" value="0"/><integer name="bsdf_samples" value="1"/>
        </integrator><emitter type="constant"/>
        <shape type="ply"><string name="filename" value="gem.ply"/>
        <boolean name="face_normals" value="true"/><bsdf type="diffuse">
        <texture type="mesh_attribute" name="reflectance">
        <string name="name" value="vertex_color"/></texture></bsdf></shape></scene>"""
    truth = open_fitted(lit, DISPLAY, 0.7)
    splats, sigma = on_triangles(vertices, faces, colors, per_edge)
    scene = open_fitted(splat_scene(tmp_path, splats), DISPLAY, 0.7)
    # The same place in the display, and rays that start before both.
    truth = replace(truth, start_mm=truth.start_mm + 2)
    scene = replace(scene, fit=truth.fit, start_mm=truth.start_mm)
    eye = Viewpoint("aside", 60.0, -30.0, 400.0)
    pictures = []
    for fitted in (truth, scene):
        captured = capture(fitted, DISPLAY, pixels_per_pitch=6, spp=4, seed=1)
        eia = pickup(fitted, DISPLAY, spp=4, seed=1).image
        view = true_view(fitted, DISPLAY, eye, pixels_per_lens=6, spp=4, seed=1)[0].image
        pictures.append((captured, eia, view))
    (rgbd, eia, view), (own, own_eia, own_view) = pictures
    in_both = rgbd.covered & own.covered
    assert in_both.sum() > 500
    depth = np.abs(own.depth_mm - rgbd.depth_mm)[in_both].mean() / truth.fit.scale_z
    return {
        "eia": float(np.sqrt(np.mean((own_eia - eia) ** 2))),
        "view": float(np.sqrt(np.mean((own_view - view) ** 2))),
        "coverage": float((rgbd.covered != own.covered).mean()),
        "depth": float(depth),
    }, sigma


@pytest.mark.slow
@pytest.mark.parametrize(("coarse", "fine"), [(8, 16), (16, 32)])
def test_splats_of_a_mesh_become_the_mesh_as_they_shrink(open_fitted, tmp_path, coarse, fine):
    """Differences are a rim as wide as a splat; colours blend over the same distance."""
    (wide, sigma), (narrow, half) = (
        compared(open_fitted, tmp_path, per_edge) for per_edge in (coarse, fine)
    )
    print(coarse, wide, fine, narrow)
    assert half == pytest.approx(sigma / 2)
    assert wide["depth"] < sigma / 4 and narrow["depth"] < half / 4
    # Areas of a rim go by its width, their root mean square by its root.
    assert narrow["coverage"] < 0.7 * wide["coverage"] and narrow["depth"] < 0.6 * wide["depth"]
    assert narrow["eia"] < 0.8 * wide["eia"] and narrow["view"] < 0.8 * wide["view"]
    assert narrow["eia"] < 0.05 and narrow["view"] < 0.05
