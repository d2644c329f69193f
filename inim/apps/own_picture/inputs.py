"""Inputs of `inim generate`: each kind is read as a picture in the display frame."""

import argparse
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from inim.apps.own_picture.options import option_defaults
from inim.apps.own_picture.picture import CameraPicture
from inim.display import Display
from inim.generators import merge_cameras, parse_algorithm
from inim.generators.base import outside_depth_range, outside_depth_text
from inim.generators.options import FILLS, one_of
from inim.image.files.image import read_rgbd
from inim.image.rgbd import RGBD
from inim.pipeline.options import choices_of, display_and_settings, print_warning
from inim.pipeline.scene_capture import generate_from_scene
from inim.render.meshes.triangle_mesh import MESH_SUFFIXES
from inim.system.errors import UsageError, naming
from inim.system.process.atomic_file import temporary_folder


class Input(NamedTuple):
    """An input as a picture in the display frame.

    `lines` are its lines of output. `generated` is the EIA with its holes if it exists already; an
    input without a picture has one.
    """

    display: Display
    rgbd: RGBD | None
    lines: list[str]
    warnings: tuple[str, ...] = ()
    generated: tuple[np.ndarray, np.ndarray | None] | None = None


def _read_camera_picture(args: argparse.Namespace) -> Input:
    """Colour and depth of a camera, in two files or in one."""
    display, settings = display_and_settings(args)
    picture = picture_of(args)
    photograph = picture.read()
    display = picture.orient(photograph, display)
    with naming(args.input):
        fit, depth_map = picture.fit_to(photograph, display, settings.capture_pixels_per_pitch)
    lines = picture.describe(photograph, fit, depth_map)
    return Input(display, fit.rgbd, lines, picture.warnings(photograph, fit, depth_map))


def _read_cameras(args: argparse.Namespace) -> Input:
    from inim.apps.own_picture.cameras import read_cameras

    display, settings = display_and_settings(args)
    cameras = read_cameras(args.input, picture_of(args), display)
    with naming(args.input):
        rgbd = merge_cameras(cameras.pictures, display, settings.capture_pixels_per_pitch)
    near, far = cameras.depth_map.near, cameras.depth_map.far
    lines = [
        f"cameras    {len(cameras.pictures.pictures)}, frame at {cameras.frame_at:.5g} mm of the "
        "first",
        f"depth      {near:.5g} (near) .. {far:.5g} (far) mm of the first",
        f"layers     {len(rgbd.layers)}, covering "
        + ", ".join(f"{layer.covered.mean():.1%}" for layer in rgbd.layers),
    ]
    return Input(display, rgbd, lines, cameras.warnings)


def _read_light_field(args: argparse.Namespace) -> Input:
    from inim.apps.own_picture import light_field
    from inim.image.files.light_field import read_hci

    display, settings = display_and_settings(args)
    field = read_hci(args.input)
    down, across, height, width = field.views.shape[:4]
    lines = [
        f"views      {across} x {down} of {width} x {height} pixels",
        f"disparity  1 pixel is {light_field.step_mm(field, display):.4g} mm of depth; "
        f"{light_field.shift_px(field, display):+.4g} pixels added",
    ]
    if args.all_views:
        eia, covered = light_field.eia_of_all_views(field, display)
        return Input(display, None, lines, generated=(eia, ~covered))
    rgbd, clipped = light_field.centre_view_picture(
        field, display, settings.capture_pixels_per_pitch, str(args.input)
    )
    lines.append(f"clipped    {clipped:.1%} of the samples were beyond the depth range")
    return Input(display, rgbd, lines)


def _read_rgbd(args: argparse.Namespace) -> Input:
    """An RGB-D picture in millimetres of the display frame."""
    display, _ = display_and_settings(args)
    return _of_rgbd(args, display, read_rgbd(args.input))


def _read_scene(args: argparse.Namespace) -> Input:
    return _capture(args, args.input)


def _read_mesh(args: argparse.Namespace) -> Input:
    """A mesh of any size, as a new scene."""
    from inim.render.scene_files.new_scene import ANY_UNIT, new_scene

    axes = {"up": args.up, "front": args.front}
    with temporary_folder(Path(tempfile.gettempdir()), "inim-mesh-") as folder:
        scene = folder / f"{args.input.stem}.xml"
        lines: list[str] = []
        choices = {"unit": ANY_UNIT, **axes}
        new_scene(args.input, scene, **choices, warn=print_warning, say=lines.append)
        source = _capture(args, scene)
        # The account is that of the mesh, not of the scene's files.
        account = [f"read       {line.removeprefix('read ')}" for line in lines]
        own = [line for line in source.lines if not line.startswith("read ")]
        return source._replace(lines=[*account, *own])


def _capture(args: argparse.Namespace, scene: Path) -> Input:
    chosen = choices_of(args)
    rgbd, display, run, notes = generate_from_scene(
        scene, chosen.get("display"), chosen["definitions"], algorithm_of(args), debug=args.debug
    )
    source = _of_rgbd(args, display, rgbd)
    lines = [f"read       {text}" for text in notes.imports] + source.lines
    warnings = (*notes.warnings, *source.warnings)
    return source._replace(lines=lines, warnings=warnings, generated=(run.eia, run.holes))


def _of_rgbd(args: argparse.Namespace, display: Display, rgbd: RGBD) -> Input:
    rows, columns = rgbd.shape
    line = f"picture    {columns} x {rows} pixels of {rgbd.pixel_mm:.4g} mm, "
    is_outside = outside_depth_range(rgbd, display)
    warnings = (f"{args.input}: {outside_depth_text(rgbd, display)}",) if is_outside else ()
    return Input(display, rgbd, [f"{line}{len(rgbd.layers)} layers"], warnings)


_PICTURE = option_defaults().keys()
_FILE = {"depth", "depth_unit", "near_is_large", "far_is_large", "missing", "swap_bytes"}
_CAMERA = {"intrinsics", "orthographic", "depth_map", "max_slope", "near_is_large"}
_GENERATION = {"algorithms", "fill", "open", "pdf", "save_rgbd"}
_PHOTO = _PICTURE - _FILE

# Kinds of inputs: words for messages, reader, and options that apply.
_KINDS: dict[str, tuple[str, Callable[[argparse.Namespace], Input], set[str]]] = {
    "color": ("a colour picture", _read_camera_picture, _PICTURE | _GENERATION),
    "photo": ("a photograph with its own depth", _read_camera_picture, _PHOTO | _GENERATION),
    "folder": ("a folder of photographs", _read_camera_picture, _PHOTO | {"algorithms", "fill"}),
    "cameras": ("pictures of several cameras", _read_cameras, _PICTURE - _CAMERA | _GENERATION),
    "light field": ("a light field", _read_light_field, _GENERATION),
    "views": ("all views of a light field", _read_light_field, {"all_views", "open", "pdf"}),
    "picture": ("an RGB-D picture of inim", _read_rgbd, _GENERATION),
    "scene": ("a scene", _read_scene, _GENERATION),
    "mesh": ("a mesh", _read_mesh, {"up", "front"} | _GENERATION),
}
_OPTIONS = _PICTURE | _GENERATION | {"all_views", "up", "front"}


def kind_of(args: argparse.Namespace) -> str:
    """Kind of the positional argument INPUT, by its content and its options."""
    path, suffix = args.input, args.input.suffix.lower()
    if args.depth is not None and args.estimate_depth is None:
        return "color"
    if path.is_dir():
        names = {entry.name for entry in path.iterdir()}
        if any(name == "parameters.cfg" or name.startswith("input_Cam") for name in names):
            return "views" if args.all_views else "light field"
        return "folder"
    if suffix in MESH_SUFFIXES and args.estimate_depth is None:
        return "mesh"
    kinds = {".xml": "scene", ".exr": "picture", ".json": "cameras"}
    return kinds.get(suffix, "photo") if args.estimate_depth is None else "photo"


def check_options(args: argparse.Namespace) -> None:
    """Reject options that do not apply to the kind of input."""
    words, _, applies = _KINDS[args.kind]
    defaults = option_defaults()
    for name in sorted(_OPTIONS - applies):
        if getattr(args, name) not in (None, False, defaults.get(name)):
            option = f"--{name.replace('_', '-')}"
            raise UsageError(f"{option}: does not apply to {words}, {args.input}; leave it out")
    if args.fill is not None:
        one_of("--fill", args.fill, FILLS)


def check_choices(args: argparse.Namespace) -> None:
    """Reject values of options that are invalid for every input of the kind."""
    if args.kind in ("color", "photo", "folder"):
        picture_of(args).check()
        display_and_settings(args)
    parse_algorithm(algorithm_of(args))


def read_input(args: argparse.Namespace) -> Input:
    """Read an input of `args.kind`; raises an `InimError` for mistakes in files and options."""
    check_choices(args)
    return _KINDS[args.kind][1](args)


def picture_of(args: argparse.Namespace) -> CameraPicture:
    """Camera picture defined by the input and the options of `add_picture`."""
    values: dict[str, Any] = {name: getattr(args, name) for name in _PICTURE}
    if args.kind != "cameras":  # whose document names the files
        values["color" if args.kind == "color" else "photo"] = args.input
    return CameraPicture(**values)


def algorithm_of(args: argparse.Namespace) -> str:
    """Algorithm with its hole filling."""
    default = "cameras" if args.kind == "cameras" else "template"
    return (args.algorithms or default) + ("" if args.fill is None else f":fill={args.fill}")
