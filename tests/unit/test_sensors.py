"""The sensors' rays against the display's own geometry, and stock use of the plugins."""

import numpy as np
import pytest

from inim.display import Viewpoint
from tests.conftest import scene_text, small_display, sphere

pytestmark = pytest.mark.usefixtures("renderer")


def rays_at_centres(family, world_from_display=None):
    from inim.render.trace import FilmCamera

    camera = FilmCamera(family, np.eye(4) if world_from_display is None else world_from_display)
    ray = camera.centre_rays()
    shape = family.shape
    origin = np.stack([np.asarray(c, np.float64).reshape(shape) for c in ray.o], -1)
    direction = np.stack([np.asarray(c, np.float64).reshape(shape) for c in ray.d], -1)
    return origin, direction


def at_depth(origin, direction, z):
    """Crossings of rays with a plane of constant z."""
    t = (z - origin[..., 2]) / direction[..., 2]
    return (origin + t[..., None] * direction)[..., :2]


def test_eye_rays_pass_through_the_eye_and_the_array():
    from inim.render.rays import eye_rays

    display = small_display()
    eye = (7.0, -3.0, 150.0)
    rays = eye_rays(display, Viewpoint("eye", *eye), 2, start_mm=20.0)
    origin, direction = rays_at_centres(rays)
    assert np.abs(at_depth(origin, direction, eye[2]) - np.array(eye[:2])).max() < 1e-3
    at_array = at_depth(origin, direction, 0.0)
    assert np.allclose(at_array[0, 0], (-5.75, 4.75), atol=1e-4), "row 0 is the top, left first"
    assert np.allclose(at_array[-1, -1], (5.75, -4.75), atol=1e-4)


def test_an_eye_s_film_of_any_size_is_filled_by_the_array():
    from inim.render.rays import eye_rays

    display = small_display(6, 5)
    rays = eye_rays(display, Viewpoint("eye", 7.0, -3.0, 150.0), (7 / 5, 20 / 6), start_mm=20.0)
    assert rays.shape == (7, 20)
    at_array = at_depth(*rays_at_centres(rays), 0.0)
    assert np.allclose(at_array[0, 0], (-3 + 3 / 20, 2.5 - 2.5 / 7), atol=1e-4)
    assert np.allclose(at_array[-1, -1], (3 - 3 / 20, -2.5 + 2.5 / 7), atol=1e-4)


def test_capture_rays_are_parallel_and_on_pixel_centres():
    from inim.render.rays import capture_rays

    display = small_display()
    rows, columns = display.capture_shape(2)
    origin, direction = rays_at_centres(capture_rays(display, 2, start_mm=10.0))
    assert origin.shape == (rows, columns, 3)
    assert np.allclose(direction, (0, 0, -1))
    right, up = (columns - 1) / 4, (rows - 1) / 4
    assert np.allclose(origin[0, 0], (-right, up, 10.0))
    assert np.allclose(origin[-1, -1], (right, -up, 10.0))


def test_an_affine_map_moves_rays_and_keeps_them_lines():
    from inim.render.rays import pickup_rays

    display = small_display()
    world = np.array([[2.0, 0, 0, 5], [0, 0, -3.0, 1], [0, 2.0, 0, -7], [0, 0, 0, 1]])
    origin, direction = rays_at_centres(pickup_rays(display, 40.0), world)
    back = np.linalg.inv(world)
    start = origin @ back[:3, :3].T + back[:3, 3]
    run = direction @ back[:3, :3].T
    reference = rays_at_centres(pickup_rays(display, 40.0))
    assert np.allclose(start, reference[0], atol=1e-4)
    assert np.allclose(run / run[..., 2:], reference[1] / reference[1][..., 2:], atol=1e-5)


def test_passes_of_any_size_give_the_same_pixels(open_fitted, monkeypatch):
    """A sample's numbers are counter-based: passes, bands and masks only sort the work."""
    from inim.render import trace
    from inim.render.rays import pickup_rays

    display = small_display()
    fitted = open_fitted(scene_text(sphere((0, 0, 0), 5.0)), display)
    camera = fitted.camera(pickup_rays(display, fitted.start_mm))
    light = trace.scene_light(fitted.scene, fitted.integrator, camera)

    def traced(mask=None):
        return trace.mean_light(light, camera.shape, 48, 1, mask)

    whole = traced()
    mask = np.random.default_rng(1).random(whole.shape[:2]) < 0.1
    assert np.array_equal(traced(mask), whole * mask[..., None])
    monkeypatch.setattr(trace, "_RAYS_PER_PASS", 48 * 1777)
    monkeypatch.setattr(trace, "_PIXELS_PER_BAND", 4321)
    assert np.array_equal(traced(), whole)
    monkeypatch.setattr(trace, "_RAYS_PER_PASS", 20)  # pixels whose samples take three passes
    first_50 = mask & (np.cumsum(mask).reshape(mask.shape) <= 50)
    assert np.abs((traced(first_50) - whole)[first_50]).max() < 1e-6, (
        "only sums are rounded elsewhere"
    )


def test_seeds_traced_together_give_the_pixels_of_each_alone(open_fitted):
    from inim.render import trace
    from inim.render.rays import pickup_rays

    display = small_display()
    fitted = open_fitted(scene_text(sphere((0, 0, 0), 5.0)), display)
    camera = fitted.camera(pickup_rays(display, fitted.start_mm))
    light = trace.scene_light(fitted.scene, fitted.integrator, camera)
    selected = np.random.default_rng(2).random(camera.shape) < 0.3
    together = np.zeros((3, *camera.shape, 3), np.float32)
    for pixels, means in trace.pixel_light(light, selected.ravel(), 5, [7, 1, 4]):
        together.reshape(3, -1, 3)[:, pixels] = means
    alone = [trace.mean_light(light, camera.shape, 5, seed, selected) for seed in (7, 1, 4)]
    assert np.array_equal(together, alone)
    assert not np.array_equal(alone[0], alone[1])


def test_lights_are_hidden_from_depth_and_colour(open_fitted):
    """A lamp in front of the relic lights it, hides nothing and is not seen."""
    from inim.render.ground_truth import capture

    lamp = """<shape type="rectangle"><transform name="to_world"><scale value="2"/>
        <rotate y="1" angle="180"/><translate z="4.5"/></transform>
        <emitter type="area"><rgb name="radiance" value="5"/></emitter></shape>"""
    display = small_display()
    plain = open_fitted(scene_text(sphere((0, 0, 0), 5.0)), display)
    lit = open_fitted(scene_text(sphere((0, 0, 0), 5.0), lamp), display)
    pictures = [capture(f, display, pixels_per_pitch=5, spp=16, seed=0) for f in (plain, lit)]
    assert np.array_equal(pictures[0].covered, pictures[1].covered)
    covered = pictures[0].covered & pictures[1].covered
    assert np.abs(pictures[0].depth_mm - pictures[1].depth_mm)[covered].max() < 1e-2
