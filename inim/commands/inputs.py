"""Preparation of inputs: `inim depth` for photographs, `inim pickup`, `inim new-scene` for relics.

`inim depth` estimates the depth of a single photograph, from the outline of its subject (see
`inim.from_camera.outline_depth`) or by a learned model, through `transformers`.

There are two kinds of models. Some return metres (ZoeDepth, Depth Pro, GLPN, the metric Depth
Anything); their numbers are kept. Most return inverse depth, larger for nearer objects, up to an
unknown scale and shift (MiDaS, DPT, Depth Anything). These are inverted: the smallest and the
largest value become the far and the near end, of the given ratio ``far / near`` (`--depth-ratio`).
The result is a relative distance from 1, near, to that ratio, far.

The models need the extra ``inim[depth]``.
"""

from __future__ import annotations

import math
import os
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

from inim.commands import Command, add_shared, choices_of, finish, print_warning
from inim.errors import EXIT_PASSED, FileError, OutOfMemoryError, UsageError
from inim.files import check_file

if TYPE_CHECKING:
    import argparse

    import numpy as np

_MODEL = "model"
_DEFAULT_MODEL = "depth-anything/Depth-Anything-V2-Small-hf"
_KINDS = ("auto", "inverse", "metres")
_INSTALL = "pip install 'inim[depth]'"
# By `model_type` of the model's configuration, where that alone decides.
_METRIC_TYPES = frozenset({"zoedepth", "depth_pro", "glpn", "prompt_depth_anything"})
_INVERSE_TYPES = frozenset({"dpt"})
_DEFAULT_RATIO = 4.0
_HALF_WHITE = 127
_WHITE_OF_16_BITS = 65535


def _add_depth_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Estimate the depth of a photograph, for `inim generate`: from the outline of its subject, "
        f"or with a depth-estimation model, which needs the extra: {_INSTALL}"
    )
    add = parser.add_argument
    add("photo", type=Path, help="PNG, JPEG, ... or EXR")
    add("-o", "--out", type=Path, required=True, help="depth, .exr, .npy, or .png to paint over")
    add(
        "--method",
        default="relief",
        help="relief: the subject bulges within its outline; layers: a flat subject before the "
        "background; model: a learned model (default: relief)",
    )
    add("--mask", type=Path, metavar="FILE", help="picture that is white where the subject is")
    add(
        "--model",
        default=_DEFAULT_MODEL,
        help=f"name or local folder of the model ({_DEFAULT_MODEL})",
    )
    add("--model-output", default="auto", help="output of the model: inverse, metres, or auto")
    add(
        "--depth-ratio",
        type=float,
        default=_DEFAULT_RATIO,
        help="ratio of the farthest to the nearest distance, for inverse depth (4)",
    )
    add_shared(parser, "debug")


def _depth(args: argparse.Namespace) -> int:
    _check_depth(args)
    if args.method == _MODEL:
        depth, kind, options = _depth_of_model(args)
    else:
        depth, kind, options = _depth_of_outline(args)
    next_command = ["inim", "generate", str(args.photo), "--depth", str(args.out), *options]
    print(f"method     {args.method}: {kind}")
    print(f"written    {args.out}, {depth.shape[1]} x {depth.shape[0]}")
    print(f"next       {shlex.join([*next_command, '--orthographic'])}")
    return EXIT_PASSED


def _depth_of_outline(args: argparse.Namespace) -> tuple[np.ndarray, str, list[str]]:
    """Write the depth by the outline; return it, its description and the options for it."""
    from inim.from_camera import outline_depth
    from inim.from_camera.picture_files import read_srgb

    color = read_srgb(args.photo)
    if args.mask is None:
        subject = outline_depth.find_subject(color, str(args.photo))
    else:
        subject = read_srgb(args.mask).max(axis=-1) > _HALF_WHITE
        if subject.shape != color.shape[:2] or not subject.any():
            raise FileError(
                f"{args.mask}: has {subject.shape[1]} x {subject.shape[0]} pixels, "
                f"{subject.mean():.0%} of them white; give a mask of the photograph's "
                f"{color.shape[1]} x {color.shape[0]} pixels that is white where the subject is"
            )
    method = outline_depth.METHODS[args.method]
    nearness = method.nearness(subject)
    _write_depth(args.out, nearness, "nearness from 0 to 1")
    kind = f"the subject covers {subject.mean():.0%}; white and 1 are nearest"
    # A PNG file holds codes.
    white = _WHITE_OF_16_BITS if args.out.suffix.lower() == ".png" else 1
    ends = [f"--near={method.near * white:g}", f"--far={method.far * white:g}"]
    return nearness, kind, ["--depth-unit", "none", "--near-is-large", *ends]


def _depth_of_model(args: argparse.Namespace) -> tuple[np.ndarray, str, list[str]]:
    """Write the depth of a model; return it, its description and the options for it."""
    import numpy as np

    estimator = _estimator(args.model)
    metric = returns_distance(estimator.model.config, args.model, args.model_output)
    predicted = _predict_depth(estimator, args.photo, args.model)
    if metric:
        depth, unit = predicted, ["--depth-unit", "m"]
        depth = np.where(depth > 0, depth, np.float32(np.nan))
    else:
        depth = relative_distance(predicted, args.depth_ratio)
        unit = ["--depth-unit", "none", "--far-is-large"]
    _write_depth(args.out, depth, "distance in metres" if metric else "relative distance")
    low, high = float(np.nanmin(depth)), float(np.nanmax(depth))
    kind = "metres" if metric else "inverse depth, converted to relative distance"
    return depth, f"{args.model}, {kind}, {low:.4g} (near) .. {high:.4g} (far)", unit


def _check_depth(args: argparse.Namespace) -> None:
    from inim.from_camera.outline_depth import METHODS
    from inim.generators.registry import one_of

    is_model = one_of("--method", args.method, (*METHODS, _MODEL)) == _MODEL
    suffixes = (".exr", ".npy") if is_model else (".exr", ".npy", ".png")
    if args.out.suffix.lower() not in suffixes:
        raise UsageError(f"-o {args.out}: depth is written as {' or '.join(suffixes)}")
    if is_model and args.mask is not None:
        raise UsageError("--mask: a model needs no outline; leave it out")
    if args.out.is_dir():
        raise FileError(f"{args.out}: is a folder; name a file with -o")
    check_file(args.photo)
    if os.path.realpath(args.out) == os.path.realpath(args.photo):
        raise UsageError(f"-o {args.out}: is the photograph; give it another name")
    if not is_model and args.model != _DEFAULT_MODEL:
        raise UsageError("--model: is for --method model; add that")
    if args.model_output not in _KINDS:
        raise UsageError(
            f"--model-output {args.model_output}: use {', '.join(_KINDS[:-1])} or {_KINDS[-1]}"
        )
    if not 1 < args.depth_ratio < math.inf:
        raise UsageError(
            f"--depth-ratio {args.depth_ratio:g}: far is farther than near; give more than 1"
        )


def _estimator(model: str) -> Any:
    """Load the `transformers` pipeline of a model."""
    if model == _DEFAULT_MODEL and os.path.lexists(model):  # transformers would prefer the folder
        raise UsageError(
            f"--model {model}: is also in the current folder; give --model ./{model}, or move it"
        )
    try:
        import torch  # noqa: F401 (the pipeline's error message is a page long)
        from transformers import pipeline
    except ImportError as error:
        raise UsageError(
            f"inim depth: needs torch and transformers ({error.name or error} is missing); "
            f"{_INSTALL}"
        ) from error
    try:
        return pipeline("depth-estimation", model=model)
    except MemoryError:
        raise
    except Exception as error:
        cause = " ".join(str(error).split())[:200] or type(error).__name__
        raise FileError(
            f"--model {model}: cannot be loaded ({cause}); give a folder with a depth-estimation "
            "model, or its name on huggingface.co while there is a network"
        ) from error


def returns_distance(config: Any, model: str, model_output: str = "auto") -> bool:
    """True if a model returns metres, by its configuration; otherwise it returns inverse depth.

    Raises `UsageError` for an unknown kind of model without an explicit option.
    """
    if model_output != "auto":
        return model_output == "metres"
    kind = getattr(config, "model_type", None)
    stated = getattr(config, "depth_estimation_type", None)
    if stated in ("metric", "relative"):
        return bool(stated == "metric")
    if kind in _METRIC_TYPES or kind in _INVERSE_TYPES:
        return kind in _METRIC_TYPES
    raise UsageError(
        f"--model {model}: the output of {kind} models is unknown; give "
        "--model-output inverse (larger is nearer) or --model-output metres"
    )


def _predict_depth(estimator: Any, photo: Path, model: str) -> np.ndarray:
    """Output of the model for a photograph, (H, W) float32."""
    import numpy as np
    from PIL import Image

    from inim.from_camera.picture_files import read_srgb

    color = read_srgb(photo)
    try:
        output = estimator(Image.fromarray(color))["predicted_depth"]
        depth = np.squeeze(np.asarray(output.detach().cpu().float().numpy(), np.float32))
    except MemoryError as error:
        raise OutOfMemoryError(f"{photo}: not enough memory; scale the picture down") from error
    except Exception as error:
        cause = " ".join(str(error).split())[:200] or type(error).__name__
        raise FileError(f"--model {model}: failed on {photo} ({cause}); try another") from error
    if depth.ndim != 2 or not np.isfinite(depth).all():
        raise FileError(
            f"--model {model}: its output has the shape {depth.shape}, or values not finite; "
            "it is not a depth-estimation model, or damaged"
        )
    return depth


def relative_distance(inverse: np.ndarray, ratio: float) -> np.ndarray:
    """Convert inverse depth, known up to scale and shift, to distances from 1 to `ratio`.

    The inverse depth is an (H, W) float array, larger for nearer objects. A flat one becomes 1.
    """
    import numpy as np

    low, high = float(inverse.min()), float(inverse.max())
    if high == low:
        return np.ones(inverse.shape, np.float32)
    share = (inverse.astype(np.float64) - low) / (high - low)
    distance: np.ndarray = (1 / (1 / ratio + (1 - 1 / ratio) * share)).astype(np.float32)
    return distance


def _write_depth(path: Path, depth: np.ndarray, meaning: str) -> None:
    import numpy as np

    from inim.from_camera.picture_files import write_depth
    from inim.process.atomic_file import write_atomically

    if path.suffix.lower() == ".exr":
        write_depth(path, depth, meaning)
    elif path.suffix.lower() == ".png":
        from PIL import Image

        codes = np.rint(depth * np.float32(_WHITE_OF_16_BITS)).astype(np.uint16)
        write_atomically(path, lambda p: Image.fromarray(codes).save(p, "PNG"))
    else:
        write_atomically(path, lambda p: np.save(p, depth))


def _add_scene_arguments(parser: argparse.ArgumentParser) -> None:
    from inim.scene.new_scene import UNITS

    add = parser.add_argument
    add(
        "mesh",
        type=Path,
        metavar="MESH",
        help="mesh (PLY, OBJ, OFF, STL, GLB or glTF) or Gaussian splats (PLY), or a folder with "
        "one of these",
    )
    add("-o", "--out", type=Path, metavar="XML", help="scene to write (default: MESH-scene.xml)")
    add(
        "--unit",
        choices=UNITS,
        help="length of one unit of the mesh; required, except for glTF (m) and splats",
    )
    add_shared(parser, "up", "front")
    add(
        "--crop",
        metavar="BOX",
        help="splats: keep only this box, x0,x1,y0,y1,z0,z1 (default: a box of nearly all)",
    )
    add("--title", help="name of the scene in reports (default: the mesh file's name)")
    add("--display", help="display preset to write into the scene: nominal, fine or phone")
    add("--force", action="store_true", help="replace existing files")


def _new_scene(args: argparse.Namespace) -> int:
    from inim.scene.new_scene import new_scene

    options = ("unit", "up", "front", "crop", "title", "display", "force")
    choices = {name: getattr(args, name) for name in options}
    path = new_scene(args.mesh, args.out, **choices, warn=print_warning, say=print)
    print(f"wrote {path}; next: inim validate {shlex.quote(str(path))}")
    return 0


def _add_pickup_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Convert a picture of elemental images to an EIA (.png, .exr) and a display file (.xml): a "
        "plenoptic camera's raw picture, or a photograph through a lens array. Print the measured "
        "lattice with 95 % intervals."
    )
    add = parser.add_argument
    add("picture", type=Path, metavar="PICTURE", help="PNG, TIFF, JPEG or EXR")
    add("--white", type=Path, metavar="FILE", help="picture of a uniform bright surface")
    add(
        "--pitch-px",
        dest="about_px",
        type=float,
        metavar="PIXELS",
        help="without --white: pitch of the elemental images, within 2.5 %%",
    )
    add("--dark", type=Path, metavar="FILE", help="picture without light, to subtract")
    add("--raw", action="store_true", help="codes are proportional to light (default: sRGB)")
    add(
        "--orthoscopic",
        action="store_true",
        help="do not rotate elemental images (default: rotate each by 180 degrees)",
    )
    out = "display file to write (PICTURE-eia.xml); the EIA gets the same name"
    display = "lens pitch, focal length and gap: preset (nominal or phone) or an .xml file"
    add_shared(parser, "definitions", "debug", out=out, display=display)


def _pickup(args: argparse.Namespace) -> int:
    from inim.from_camera.elemental_images import pickup

    options = {
        name: getattr(args, name) for name in ("white", "about_px", "dark", "raw", "orthoscopic")
    }
    out = args.out or Path(f"{args.picture.stem}-eia.xml")
    choices = choices_of(args)
    capture = pickup(
        args.picture,
        choices.get("display"),
        definitions=choices["definitions"],
        out=out,
        **options,
    )
    lattice = capture.lattice
    if args.white is None:
        print_warning(
            f"{args.picture}: outlines of the object displace seams; intervals are approximate, "
            "a white picture with --white is better"
        )
    row_pitch = ", as in a regular lattice" if lattice.is_regular else ""
    print(f"lattice    {lattice.kind}, {lattice.columns} x {lattice.rows} elemental images")
    print(f"pitch      {lattice.pitch_px} px")
    print(f"row pitch  {lattice.row_pitch_px} px{row_pitch}")
    print(f"rotation   {lattice.rotation_deg} degrees")
    print(f"centre     {lattice.x_px} px from the left, {lattice.y_px} px from the top")
    print(f"residuals  {lattice.rms_px:.2g} px rms, in {lattice.used_count} elemental images")
    return finish(True, f"written    {', '.join(map(str, capture.files))}")


COMMANDS = {
    "depth": Command("estimate the depth of a photograph", _add_depth_arguments, _depth),
    "pickup": Command(
        "convert a picture of elemental images to an EIA", _add_pickup_arguments, _pickup
    ),
    "new-scene": Command(
        "create a lit scene from a mesh or Gaussian splats", _add_scene_arguments, _new_scene
    ),
}
