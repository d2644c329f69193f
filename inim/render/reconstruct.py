"""Reconstruction: the view of an EIA on a display from an eye position."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from inim.display import Display
from inim.display.lens import (
    LensModel,
    LensModelName,
    SheetMesh,
    channel_indices,
    lens_array,
    lens_model_name,
)
from inim.display.lens import lens_model as find_lens_model
from inim.display.panel import emitted_picture
from inim.display.viewpoint import Viewpoint, check_viewpoint, viewpoint_of
from inim.render import variant
from inim.render.display_emitter import LensedPanel
from inim.render.library import dr, mi
from inim.render.rays import eye_rays
from inim.render.scene_files.file import display_of
from inim.render.trace import FilmCamera, Light, mean_light
from inim.system.errors import UsageError
from inim.system.process.observer import Observer

# Into the glass, out of it, and the panel is seen.
_MAX_DEPTH = 3
_NEVER = 100
_BLACK = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}


class LensMesh:
    """EIA seen through the lens array as a refracting mesh, path traced by Mitsuba.

    No optical formula of inim is involved: the renderer's `dielectric` implements Snell's and
    Fresnel's laws, and `inim.display.lens.full` gives the lenses. It is the independent check of
    the analytic models. It takes thirty times longer for the same number of samples, and hundreds
    of times for the same noise: each ray is reflected or refracted at random, at two faces, among
    millions of facets.

    A path is followed for two changes of direction, in and out of the glass, and then only the
    panel counts: the analytic models do not include other paths through the sheet either.

    Accuracy: facets deviate from the surface by a hundredth of a panel pixel. The renderer starts
    each refracted ray 8.94e-5 (1 + max |p|) off the surface: 3e-3 mm at the edge of an array 64 mm
    wide. The sideways error is this distance times the sine of the ray's angle to the normal (at
    most a half): 3 per cent of a nominal panel pixel.

    * `eia`, (rows, columns, 3) float32: linear RGB, row 0 on top.

    Its attributes:
    * `start_mm`: start plane of the rays, outside and near the glass, so that coordinates stay
      small.
    """

    def __init__(self, eia: np.ndarray, display: Display, sheet: SheetMesh) -> None:
        indices = channel_indices(display)
        self.start_mm = sheet.front_mm + display.pitch_mm
        # A colour whose index is its own has its own glass, and so its own scene.
        self._scenes = {
            index: mi.load_dict(_mesh_scene(eia, display, sheet, index)) for index in set(indices)
        }
        self._indices = indices
        self._integrator = mi.load_dict(
            {"type": "path", "max_depth": _MAX_DEPTH, "rr_depth": _NEVER}
        )

    def light(self, camera: FilmCamera) -> Light:
        """Function that returns the light of a camera's rays."""

        def light(index: Any, sampler: Any) -> Any:
            ray = mi.RayDifferential3f(camera.rays(*camera.sample(index, sampler)))
            by_glass = {}
            for glass, scene in self._scenes.items():
                by_glass[glass] = self._integrator.sample(scene, sampler, ray)[0]
                # On CUDA a kernel traces rays in one scene only: in others they hit nothing.
                sampler.schedule_state()
                dr.eval(by_glass[glass])
            channels = (by_glass[glass][channel] for channel, glass in enumerate(self._indices))
            return mi.Color3f(*channels)

        return light


def _mesh_scene(
    eia: np.ndarray, display: Display, sheet: SheetMesh, index: float
) -> dict[str, Any]:
    glass = {"type": "dielectric", "int_ior": float(index), "ext_ior": 1.0}
    return {
        "type": "scene",
        # Rays through pixel centres meet edges of facets, where Embree's default lets some slip.
        "embree_use_robust_intersections": True,
        "glass": mesh_shape("glass", sheet, sheet.is_glass, glass),
        "mount": mesh_shape("mount", sheet, ~sheet.is_glass, _BLACK),
        "panel": _emitting_panel(eia, display, sheet),
        **_black_screens(display, sheet),
    }


def mesh_shape(name: str, sheet: SheetMesh, chosen: np.ndarray, bsdf: dict[str, Any]) -> Any:
    """Some of the sheet's faces as a mesh of one material."""
    used, faces = np.unique(sheet.faces[chosen], return_inverse=True)
    properties = mi.Properties()
    properties["mesh_bsdf"] = mi.load_dict(bsdf)
    mesh = mi.Mesh(name, len(used), int(chosen.sum()), has_vertex_normals=True, props=properties)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = sheet.vertices[used].astype(np.float32).ravel()
    parameters["vertex_normals"] = sheet.normals[used].astype(np.float32).ravel()
    parameters["faces"] = faces.astype(np.uint32).ravel()
    parameters.update()
    return mesh


def _emitting_panel(eia: np.ndarray, display: Display, sheet: SheetMesh) -> dict[str, Any]:
    """The panel's picture as a light, each pixel of one colour; the gap behind the lenses."""
    rows, columns = display.eia_shape
    half_x, half_y = (count * display.pixel_pitch_mm / 2 for count in (columns, rows))
    array = lens_array(display)
    place = [
        [half_x, 0, 0, 0],
        [0, half_y, 0, 0],
        [
            -array.tilt_x * half_x,
            -array.tilt_y * half_y,
            1,
            sheet.rear_principal_mm - display.gap_mm,
        ],
        [0, 0, 0, 1],
    ]
    if display.subpixels == "rgb-stripe":  # `full` accepts no other areas of a colour
        eia = (eia[:, :, None, :] * (3 * np.eye(3, dtype=np.float32))).reshape(rows, -1, 3)
    # The renderer's texture has its first row at the rectangle's bottom.
    picture = mi.Bitmap(np.ascontiguousarray(eia[::-1], np.float32))
    return {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f(place),
        "emitter": {
            "type": "area",
            "radiance": {
                "type": "bitmap",
                "bitmap": picture,
                "raw": True,
                "filter_type": "nearest",
            },
        },
    }


def _black_screens(display: Display, sheet: SheetMesh) -> dict[str, Any]:
    """Black screens about the sheet, in its flat face's plane: no ray gets to the panel past it."""
    flat = sheet.vertices[sheet.vertices[:, 2] == sheet.flat_mm, :2]
    array = lens_array(display)
    turned = np.array([[array.cosine, -array.sine], [array.sine, array.cosine]])
    along = (flat - (array.shift_x, array.shift_y)) @ turned
    half_x, half_y = along.max(axis=0)
    wide = half_x + half_y + display.gap_mm
    to_display = np.eye(4)
    to_display[:2, :2] = turned
    to_display[:3, 3] = array.shift_x, array.shift_y, sheet.flat_mm
    screens = {}
    for name, (x, y), (size_x, size_y) in (
        ("right", (half_x + wide, 0), (wide, half_y + 2 * wide)),
        ("left", (-half_x - wide, 0), (wide, half_y + 2 * wide)),
        ("top", (0, half_y + wide), (half_x, wide)),
        ("bottom", (0, -half_y - wide), (half_x, wide)),
    ):
        place = to_display @ np.array(
            [[size_x, 0, 0, x], [0, size_y, 0, y], [0, 0, 1, 0], [0, 0, 0, 1]]
        )
        screens[f"screen_{name}"] = {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f(place),
            "bsdf": {"type": "twosided", "bsdf": _BLACK},
        }
    return screens


def reconstruct(
    eia: np.ndarray,
    display: Display | str | Path,
    viewpoint: Viewpoint | str | Sequence[float],
    lens_model: LensModelName | LensModel = "thick",
    *,
    pixels_per_lens: int = 4,
    spp: int = 64,
    seed: int = 0,
    backend: str = "auto",
    allow_flips: bool = False,
) -> np.ndarray:
    """The view of a display from one eye position, ray traced through its lens array.

    In a program that uses Mitsuba itself, its variant and thread count are as before afterwards.

    Parameters
    ----------
    eia : (rows, columns, 3) float array
        Linear RGB, row 0 on top, of the display's `eia_shape`. Whole numbers, such as the sRGB
        codes of a PNG, are refused; `inim.image.files.eia_file.read_eia` reads files as linear RGB.
    display : Display, str or Path
        A display, the name of a preset, or a display file.
    viewpoint : Viewpoint, str or (x, y, z)
        A viewpoint, its text: ``"centre"``, ``"mine=10 -5 400"``, or its position in mm. Must be
        inside the viewing zone, with its pupil, unless `allow_flips`.
    lens_model : {"pinhole", "thin", "thick", "full"} or LensModel
        Of another package, pass the registered `inim.display.lens.LensModel`; its name works, too.
    pixels_per_lens : int
        Resolution of the view; it shows exactly the lens array.
    spp : int
        Samples per view pixel; few alias with the lens lattice.
    seed : int
    backend : {"auto", "llvm", "cuda"}
    allow_flips : bool
        Let the eye leave the viewing zone, where lenses show their neighbours' elemental images.

    Returns
    -------
    (lens_rows * pixels_per_lens, lens_columns * pixels_per_lens, 3) float32, linear RGB: the light
    that leaves the lenses. Views of reports are exposed for the panel's white: multiply by
    `inim.display.lens.white_exposure(display, lens_model)`; and they include reflected room light
    and veiling glare: apply `inim.display.panel.seen_light`.

    Raises
    ------
    UsageError, ViewpointError, DisplayError, BackendError, SceneError
    """
    display = display_of(display)
    viewpoint = viewpoint_of(viewpoint, display)
    check_viewpoint(viewpoint, display, allow_flips=allow_flips)
    eia = _check_linear(eia)
    with variant.temporary(backend):
        scene = DisplayScene(eia, display, lens_model_name(lens_model))
        return scene.view(viewpoint, pixels_per_lens=pixels_per_lens, spp=spp, seed=seed)


def _check_linear(eia: np.ndarray) -> np.ndarray:
    """An EIA as an array of finite floats.

    Raises `UsageError`: whole numbers, which are sRGB codes in most files, or values that are not
    finite.
    """
    eia = np.asarray(eia)
    if not np.issubdtype(eia.dtype, np.floating):
        raise UsageError(
            f"eia: is {eia.dtype}; give linear RGB as floats: read a file with "
            "inim.image.files.eia_file.read_eia, or convert 8-bit sRGB with "
            "inim.image.color.linear_from_srgb(eia[..., :3] / 255)"
        )
    bad = np.count_nonzero(~np.isfinite(eia))
    if bad:
        raise UsageError(
            f"eia: {bad} values are not finite; replace them, for example with numpy.nan_to_num"
        )
    return eia


class DisplayScene:
    """A display showing one EIA, ready for views from many viewpoints.

    Parameters are those of `reconstruct`.
    """

    def __init__(self, eia: np.ndarray, display: Display, lens_model: str) -> None:
        if eia.shape != (*display.eia_shape, 3):
            raise UsageError(
                f"EIA of shape {eia.shape}; display {display.name} needs {(*display.eia_shape, 3)}"
            )
        model = find_lens_model(lens_model)
        model.check(display)
        self.display = display
        self._lit_array: LensMesh | LensedPanel
        if model.mesh is not None:
            light = emitted_picture(eia, display)
            self._lit_array = LensMesh(light, display, model.mesh(display))
        else:
            picture = mi.Float(np.asarray(eia, np.float32).ravel())
            self._lit_array = LensedPanel(display, lens_model, picture)

    def view(
        self,
        viewpoint: Viewpoint,
        *,
        pixels_per_lens: int | tuple[float, float],
        spp: int,
        seed: int,
        observer: Observer | None = None,
    ) -> np.ndarray:
        """One view, (rows, columns, 3) float32; see `reconstruct` and `eye_rays`."""
        rays = eye_rays(self.display, viewpoint, pixels_per_lens, self._lit_array.start_mm)
        camera = FilmCamera(rays, np.eye(4))
        light = self._lit_array.light(camera)
        return mean_light(light, camera.shape, spp, seed, observer=observer)
