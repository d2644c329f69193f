"""The plugins in anybody's scene: `inim_display`, `inim_eye`, `inim_pickup`."""

from pathlib import Path

import numpy as np
import pytest

from inim.display import Viewpoint
from inim.display.settings import plain_parameters
from inim.system.errors import SceneError
from tests.conftest import small_display

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.usefixtures("renderer")

DISPLAY = small_display(12, 10, pixels=8)
HALF = (6.0, 5.0)


def parameters_of(display=DISPLAY) -> dict:
    return plain_parameters(display)


def film(width: int, height: int, **more) -> dict:
    return {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}, **more}


def diffuse(*rgb: float) -> dict:
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": [*rgb]}}


def picture(seed: int = 1, display=DISPLAY) -> np.ndarray:
    rows, columns = display.eia_shape
    random = np.random.default_rng(seed).random((rows // 16, columns // 16, 3), np.float32)
    return random.repeat(16, axis=0).repeat(16, axis=1)


def turned(name: str):
    """A world: what is done to a display at the origin, in millimetres."""
    import mitsuba as mi

    world = mi.ScalarTransform4f()
    axis = [1 / 14**0.5, 2 / 14**0.5, 3 / 14**0.5]
    return {
        "as it is": world,
        "moved": world.translate([1000, 0, 0]),
        "turned": world.rotate(axis, 77),
        "in metres": world.scale(1e-3),
        "in micrometres": world.scale(1e3),
        "all": world.translate([1, -0.3, 0.2]).rotate(axis, 130).scale(1e-3),
    }[name]


def rectangle(world, half=HALF):
    import mitsuba as mi

    return world @ mi.ScalarTransform4f().scale([*half, 1])


def panel(world, **changes) -> dict:
    import mitsuba as mi

    emitter = {"type": "inim_display", **parameters_of(), "eia": mi.TensorXf(picture())}
    emitter = {k: v for k, v in (emitter | changes).items() if v is not None}
    return {"type": "rectangle", "to_world": rectangle(world), "emitter": emitter}


def eye(world, **changes) -> dict:
    place = {"x_mm": 3.0, "y_mm": -2.0, "z_mm": 200.0}
    return {"type": "inim_eye", "to_world": rectangle(world), **parameters_of(), **place, **changes}


def loaded(*, integrator: str = "path", **parts):
    import mitsuba as mi

    return mi.load_dict({"type": "scene", "integrator": {"type": integrator}, **parts})


def rendered(scene, spp: int = 64, **options) -> np.ndarray:
    import mitsuba as mi

    return np.array(mi.render(scene, spp=spp, **options))


def before(world) -> np.ndarray:
    return rendered(loaded(panel=panel(world), eye=eye(world)))


@pytest.mark.parametrize("pupil", [0.0, 4.0])
def test_the_eye_sensor_agrees_with_reconstruct(pupil):
    from inim.render.reconstruct import reconstruct

    world = turned("as it is")
    scene = loaded(panel=panel(world), eye=eye(world, pupil_mm=pupil))
    image, again = (rendered(scene, spp=256, seed=seed) for seed in (0, 1))
    viewpoint = Viewpoint("eye", 3, -2, 200, pupil_mm=pupil)
    view = reconstruct(picture(), DISPLAY, viewpoint, pixels_per_lens=4, spp=256)
    assert image.shape == view.shape
    noise = np.abs(image - again).mean()
    assert np.abs(image - view).mean() < 1.1 * noise < 0.01, "the bench's samples are better spread"
    for other in (view[::-1], view[:, ::-1], view[..., ::-1]):
        assert np.abs(image - other).mean() > 0.1, "the comparison can tell a flip"


@pytest.mark.parametrize("name", ["moved", "turned", "in metres", "in micrometres", "all"])
def test_display_and_eye_may_be_anywhere_in_any_unit(name):
    """Rigid motion and uniform scale of both change the picture by float32's rounding alone.

    A ray's place on the array is known to a few units in the last place (2^-24) of the largest
    coordinate, some 1200 mm here. Where that takes a ray across the border of a panel pixel, of
    which there are two in x and two in y, the sample shows its neighbour.
    """
    here, there = before(turned("as it is")), before(turned(name))
    error_mm = 8 * 2.0**-24 * 1200
    assert np.abs(here - there).mean() < 4 * error_mm / DISPLAY.pixel_pitch_mm
    assert here.mean() > 0.2


def pickup(world, **changes) -> dict:
    return {"type": "inim_pickup", **parameters_of(), "to_world": rectangle(world), **changes}


@pytest.mark.parametrize(
    ("plugin", "changes", "says"),
    [
        (panel, {"gap_m": 3.0}, "unknown parameter 'gap_m'; did you mean 'gap_mm'?"),
        (panel, {"zzz": 3.0}, "unknown parameter 'zzz'; use filename, bitmap, eia, lens_model"),
        (panel, {"lens_model": "full"}, "'full' is traced by the renderer only; use 'thick' here"),
        (panel, {"lens_model": "fish"}, "lens model 'fish': use pinhole or thin"),
        (panel, {"preset": "tablet"}, "inim_display: preset = 'tablet'; use nominal or phone"),
        (panel, {"brightness": -1.0}, "inim_display: brightness = -1: must be finite and not neg"),
        (panel, {"brightness": "hell"}, "inim_display: brightness = 'hell': must be a number"),
        (panel, {"lens_columns": 13}, r"eia has shape \(80, 96, 3\); .* needs \(80, 104, 3\)"),
        (panel, {"gap_mm": "3"}, "inim_display: gap_mm = '3': must be a finite number"),
        (panel, {"pitch_mm": -1.0}, "inim_display: pitch_mm = -1.0: must be a positive length"),
        (panel, {"filename": "x.png"}, "both filename and eia; give one of"),
        (panel, {"eia": None}, "inim_display: has no EIA; give one of"),
        (panel, {"eia": None, "filename": "x.png"}, "x.png: no such file"),
        (panel, {"eia": None, "filename": "x.jpg"}, "not an EIA; give a .png"),
        (panel, {"misalign": "rotation=1"}, "did you mean rotation_deg?"),
        (panel, {"thick": True}, "unknown parameter 'thick'"),
        (eye, {"film": {"type": "hdrfilm", "width": 48, "height": 48}}, "use 48 x 40"),
        (eye, {"z_mm": -1.0}, "must be finite with z > 0"),
        (eye, {"pupil_mm": "wide"}, "pupil_mm = 'wide': must be a number"),
        (eye, {"pupil": 3.0}, "did you mean 'pupil_mm'?"),
        (eye, {"fov": 30.0}, "unknown parameter 'fov'"),
        (pickup, {"film": {"type": "hdrfilm"}}, "its film is the panel, 96 x 80 pixels"),
        (pickup, {"subpixels": "rgb-stripe"}, "omit subpixels"),
        (pickup, {"start_mm": "near"}, "start_mm = 'near': must be a number"),
    ],
)
def test_mistakes_are_reported_in_one_line(plugin, changes, says):
    world = turned("as it is")
    with pytest.raises(RuntimeError, match=says) as raised:
        loaded(wrong=plugin(world, **changes))
    assert before(world).mean() > 0.2, f"other scenes are none the worse for {raised}"


@pytest.mark.parametrize(
    ("scale", "says"),
    [
        ((6, 6, 1), "12 x 12, does not match the array, 12 x 10 mm"),
        ((-6, 5, 1), "mirrors the display"),
        ((6, 5, -1), "mirrors the display"),
    ],
)
def test_a_rectangle_that_is_no_display_is_refused_at_first_use(scale, says):
    import mitsuba as mi

    world = turned("as it is")
    expected = before(world)
    wrong = loaded(
        panel=panel(world) | {"to_world": mi.ScalarTransform4f().scale(scale)}, eye=eye(world)
    )
    with pytest.raises(RuntimeError) as raised:
        rendered(wrong, spp=1)
    assert says in str(raised.value.__cause__)
    assert np.array_equal(before(world), expected), "other scenes are none the worse"
    assert not rendered(wrong, spp=1).any(), "with a warning"
    with pytest.raises(RuntimeError, match=says):
        mi.load_dict(eye(world) | {"to_world": mi.ScalarTransform4f().scale(scale)})


def test_the_pickup_is_the_true_eia_of_its_surroundings(open_fitted):
    """Squares in front of the array and behind it, by the bench's own camera and by the plugin."""
    import mitsuba as mi

    from inim.render.rays import pickup_rays
    from inim.render.trace import FilmCamera, mean_light, scene_light

    sky = {"type": "constant", "radiance": 1.0}
    near = {"type": "rectangle", "bsdf": diffuse(0.8, 0.1, 0.1)}
    far = {"type": "rectangle", "bsdf": diffuse(0.1, 0.7, 0.2)}

    def scene(world):
        places = {"near": (near, [1, 0.5, 20], 2), "far": (far, [-1, 1, -10], 4)}
        shapes = {
            name: shape | {"to_world": world @ mi.ScalarTransform4f().translate(at).scale(half)}
            for name, (shape, at, half) in places.items()
        }
        return loaded(light=sky, **shapes)

    start = DISPLAY.depth_range_mm[1]
    camera = FilmCamera(pickup_rays(DISPLAY, start), np.eye(4))
    light = scene_light(scene(turned("as it is")), mi.load_dict({"type": "path"}), camera)
    expected = mean_light(light, camera.shape, 64, seed=0)
    world = turned("all")
    plugin = mi.load_dict(pickup(world))
    image, again = (
        np.array(mi.render(scene(world), sensor=plugin, spp=64, seed=seed)) for seed in (0, 1)
    )
    assert image.shape == (*DISPLAY.eia_shape, 3)
    noise = np.abs(again - image).mean()
    assert np.abs(image - expected).mean() < 1.1 * noise < 0.02, "other samples of the sky's light"
    for other in (image[::-1], image[:, ::-1]):
        assert np.abs(other - expected).mean() > 5 * noise


def test_the_displayed_eia_can_be_changed():
    import mitsuba as mi

    world = turned("all")
    scene = loaded(panel=panel(world), eye=eye(world))
    parameters = mi.traverse(scene)
    first = rendered(scene, 4)
    parameters["panel.emitter.brightness"] = 3.0
    parameters.update()
    assert rendered(scene, 4) == pytest.approx(3 * first, rel=1e-5)
    parameters["panel.emitter.brightness"] = 1.0
    parameters["panel.emitter.eia"] = mi.TensorXf(1 - picture())
    parameters.update()
    fresh = loaded(panel=panel(world, eia=mi.TensorXf(1 - picture())), eye=eye(world))
    assert np.array_equal(rendered(scene, 4), rendered(fresh, 4))
    parameters["panel.to_world"] = mi.Transform4f(rectangle(world.translate([0.3, 0, 0])))
    parameters["eye.to_world"] = mi.Transform4f(rectangle(world.translate([0.3, 0, 0])))
    parameters.update()
    assert np.abs(rendered(scene, 4) - rendered(fresh, 4)).mean() < 2e-3, "both moved, one picture"
    parameters["panel.emitter.eia"] = mi.TensorXf(np.zeros((4, 4, 3), np.float32))
    with pytest.raises(SceneError, match=r"eia has shape \(4, 4, 3\)"):
        parameters.update()
    assert not rendered(scene, 4).any(), "with a warning"


def camera(fov: float, origin, target) -> dict:
    """A stock camera of nine pixels."""
    import mitsuba as mi

    look = mi.ScalarTransform4f().look_at(origin, target, [0, 1, 0])
    return {"type": "perspective", "fov": fov, "to_world": look, "film": film(3, 3)}


def lit_wall(integrator: dict):
    """A wall on the display's axis, lit by it alone, as a stock camera sees it."""
    import mitsuba as mi

    place = mi.ScalarTransform4f().look_at([0, 0, 30], [0, 0, 0], [0, 1, 0])
    place = place @ mi.ScalarTransform4f().scale(10)
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": integrator,
            "panel": panel(turned("as it is")),
            "wall": {"type": "rectangle", "to_world": place, "bsdf": diffuse(0.6, 0.6, 0.6)},
            "camera": camera(20.0, [14, 0, 3], [0, 0, 30]),
        }
    )


def test_light_sampled_towards_it_equals_light_hit_by_chance():
    """Next-event estimation is unbiased: it agrees with paths that merely meet the display."""
    by_chance = {"type": "direct", "emitter_samples": 0, "bsdf_samples": 1}
    aimed = {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0}
    path = {"type": "path", "max_depth": 2}
    images = {}
    for name, integrator in {"chance": by_chance, "aimed": aimed, "both": path}.items():
        scene = lit_wall(integrator)
        runs = np.stack([rendered(scene, 2**12, seed=seed) for seed in range(8)]).mean(axis=(1, 2))
        images[name] = runs.mean(axis=0), runs.std(axis=0, ddof=1) / np.sqrt(len(runs))
    for other in ("aimed", "both"):
        (a, error_a), (b, error_b) = images["chance"], images[other]
        assert (np.abs(a - b) < 5 * np.hypot(error_a, error_b)).all(), (other, images)
    assert (images["aimed"][1] < 0.01 * images["aimed"][0]).all(), "and is known well enough"


def gradient_scene(integrator: str):
    import mitsuba as mi

    world = turned("all")
    sensor = eye(world, film=film(12, 10, pixel_format="rgb"))
    scene = loaded(integrator=integrator, panel=panel(world), eye=sensor)
    return scene, mi.traverse(scene), "panel.emitter.eia"


@pytest.mark.parametrize("integrator", ["prb", "path", "direct"])
def test_gradients_reach_the_eia(integrator):
    """The image is linear in the EIA: J v is a difference, and <J v, w> = <v, J^T w>."""
    import drjit as dr
    import mitsuba as mi

    random = np.random.default_rng(7)
    step = random.normal(size=(*DISPLAY.eia_shape, 3)).astype(np.float32)
    weights = random.normal(size=(10, 12, 3)).astype(np.float32)
    scene, parameters, key = gradient_scene(integrator)
    options = {"spp": 16, "seed": 5}

    eia = mi.TensorXf(picture())
    dr.enable_grad(eia)
    parameters[key] = eia
    parameters.update()
    image = mi.render(scene, parameters, spp=16, seed=3, seed_grad=5)
    dr.backward(dr.sum(image * mi.TensorXf(weights), axis=None))
    adjoint = np.array(dr.grad(eia))

    def image_of(values: np.ndarray) -> np.ndarray:
        parameters[key] = mi.TensorXf(values)
        parameters.update()
        return np.array(mi.render(scene, **options), np.float64)

    difference = image_of(picture() + step) - image_of(picture())
    forward = (difference * weights).sum()
    backward = (adjoint.astype(np.float64) * step).sum()
    # Sums of some thousand float32 terms of size one.
    assert backward == pytest.approx(forward, abs=2e-3 * np.abs(difference * weights).sum())
    row, column, channel = np.unravel_index(np.argmax(np.abs(adjoint)), adjoint.shape)
    nudged = picture()
    nudged[row, column, channel] += 0.5
    derivative = ((image_of(nudged) - image_of(picture())) * weights).sum() / 0.5
    assert adjoint[row, column, channel] == pytest.approx(derivative, rel=1e-3)


def test_scenes_leave_no_objects_behind():
    """Kernels are recorded of all emitters there are: they must go with their scenes."""
    import gc

    def alive() -> int:
        gc.collect()
        kinds = ("DisplayEmitter", "EyeSensor", "PickupSensor")
        return sum(type(item).__name__ in kinds for item in gc.get_objects())

    def used() -> None:
        import mitsuba as mi

        world = turned("all")
        scene = loaded(panel=panel(world), eye=eye(world))
        rendered(scene, 1)
        mi.traverse(scene).update()
        mi.load_dict(pickup(world))

    count = alive()
    for _ in range(3):
        used()
    assert alive() == count
