"""`inim generate`: EIAs from the user's own colour and depth pictures."""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from inim.apps.own_picture.options import add_picture, classify_input, picture_of
from inim.pipeline.options import (
    Command,
    add_shared,
    choices_of,
    display_and_settings,
    finish,
    open_page,
    print_lines,
    print_warning,
)
from inim.system.errors import EXIT_PASSED, FileError, OutOfMemoryError, UsageError, naming

if TYPE_CHECKING:
    import numpy as np

    from inim.apps.own_picture.fit import DepthMap, PictureFit
    from inim.apps.own_picture.picture import CameraPicture, ColorDepth
    from inim.display import Display
    from inim.display.settings import Settings
    from inim.image.rgbd import RGBD

_DEFAULT_ALGORITHM = "template"
_EPILOG = """depth
  Depth with a unit (--depth-unit mm, cm, m, or 5000 for 5000 units per metre) is missing where the
  value is 0, negative or not finite. Depth without a unit (--depth-unit none) is missing where the
  value is not finite or is listed by --missing, and needs --near-is-large or --far-is-large.
  Distances that no depth camera has are refused, unless --near and --far confirm them.

photographs that contain depth
  Give only the file name: the file contains the depth, its unit and its direction. The photograph
  is treated as taken with parallel rays. With --intrinsics photo, it is unprojected with the camera
  parameters in the file. The default of --fit is auto.
  --estimate-depth MODEL does the same for a photograph without depth.

perspective
  --intrinsics unprojects the picture: it moves every pixel to its position in space, and the
  display shows the pixels there. At the distance --frame-at, the picture fits the lens array.
  --orthographic omits this step.
  Straight lines stay straight with --intrinsics and linear depth, or with --orthographic and
  reciprocal depth.
"""


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Generate an elemental image array (EIA) from a colour picture with depth, a photograph "
        "that contains depth, an RGB-D picture of inim, pictures of several cameras, a light "
        "field, a mesh, Gaussian splats, or a scene."
    )
    parser.epilog = f"{_EPILOG}\n{parser.epilog}"
    add = parser.add_argument
    add(
        "input",
        type=Path,
        metavar="INPUT",
        help="a colour picture with --depth; a photograph that contains depth (HEIC, or JPEG from "
        "Android or Apple), or a folder of these; an RGB-D picture of inim (.exr); a .json that "
        "lists the pictures of several cameras; the folder of an HCI 4D light field; a mesh or "
        "Gaussian splats (see inim new-scene), lit and fitted to the display; or a scene (.xml); "
        "both are rendered with -D inim.capture_spp=N samples per pixel",
    )
    add_shared(parser, "up", "front")
    add_picture(parser)
    out = "EIA to write, .png or .exr (default: eia.png); a folder if INPUT is a folder"
    add_shared(parser, "display", "definitions", "debug", out=out)
    add(
        "--all-views",
        action="store_true",
        help="light field: use all views instead of the centre view",
    )
    add(
        "-a",
        "--algorithms",
        dest="algorithm",
        metavar="ALGORITHM",
        help="one algorithm with options, such as template:samples=1; see `inim info algorithms` "
        "(default: template; for several cameras: cameras)",
    )
    add(
        "--fill",
        help="holes to fill: none, hidden (behind a nearer surface), all, or auto (default: the "
        "algorithm's own)",
    )
    add_shared(parser, "open")
    add("--pdf", type=Path, help="also write a PDF that prints at true size")
    add(
        "--save-rgbd",
        type=Path,
        metavar="FILE",
        help="also write the fitted colour and depth as .exr",
    )


def _run(args: argparse.Namespace) -> int:
    classify_input(args)
    if args.photo is not None and args.photo.is_dir():
        return _generate_folder(args)
    args.out = args.out or Path("eia.png")
    _run_one(args)
    if args.open:
        from inim.report.view_page import view_eia

        open_page(view_eia(args.out, args.display, choices_of(args)["definitions"]))
    return EXIT_PASSED


def _generate_folder(args: argparse.Namespace) -> int:
    """Generate an EIA from each photograph of a folder, and list the failures."""
    from inim.apps.own_picture.depth_photo import SUFFIXES
    from inim.image.files.eia_file import EIA_SUFFIXES
    from inim.system.worker.output import default_out

    for option in ("pdf", "save_rgbd", "open"):
        if getattr(args, option):
            name = option.replace("_", "-")
            raise UsageError(f"--{name}: needs a single picture; leave it out with a folder")
    folder, out = args.photo, args.out or default_out(args.photo, "eia")
    if out.suffix.lower() in EIA_SUFFIXES or out.is_file():
        raise UsageError(f"-o {out}: {folder} is a folder; name a folder for its EIAs")
    photos = sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES)
    if not photos:
        raise FileError(f"{folder}: no photograph in it ({', '.join(SUFFIXES)})")
    stems = [path.stem for path in photos]
    failed = 0
    _check_options(args)
    for path in photos:
        name = path.stem if stems.count(path.stem) == 1 else path.name
        print_lines(path)
        single_args = argparse.Namespace(**vars(args) | {"photo": path, "out": out / f"{name}.png"})
        try:
            _run_one(single_args)
        except (FileError, UsageError, OutOfMemoryError) as error:
            failed += 1
            print_warning(str(error), "failed")
    converted = f"{len(photos) - failed} of {len(photos)} photographs converted"
    return finish(not failed, f"{converted}; EIAs: {out}")


def _check_options(args: argparse.Namespace) -> None:
    """Reject options that are invalid for every photograph."""
    from inim.generators import parse_algorithm

    picture = picture_of(args)
    picture.check_files()
    picture.check_choices()
    display_and_settings(args)
    parse_algorithm(_algorithm(args))


def _run_one(args: argparse.Namespace) -> None:
    try:
        report, warnings = _generate(args)
    except MemoryError as error:
        raise OutOfMemoryError(
            f"{args.input}: not enough memory for a picture of this size; scale it down"
        ) from error
    for warning in warnings:
        print_warning(warning)
    print_lines(*report)


def _generate(args: argparse.Namespace) -> tuple[list[str], tuple[str, ...]]:
    """Generate and write the requested files; return the lines of output, and warnings."""
    from inim.generators import parse_algorithm

    started = time.perf_counter()
    picture = picture_of(args)
    _check(args, picture)
    options = _new_scene_options(args)
    if options is not None:
        return _generate_from_mesh(args, options)
    if args.scene is not None or args.fitted is not None:
        return _generate_from_rgbd(args, args.scene)
    display, settings = display_and_settings(args)
    if args.light_field is not None:
        return _generate_from_light_field(args, display, settings), ()
    if args.cameras_file is not None:
        return _generate_from_cameras(args, picture, display, settings)
    picture.camera()
    parse_algorithm(_algorithm(args))
    photograph = picture.read()
    display = picture.orient(photograph, display)
    with naming(args.input):
        fitted, depth_map = picture.fit_to(photograph, display, settings.capture_pixels_per_pitch)
    eia, empty = _generate_eia(args, fitted.rgbd, display)
    report = _report(picture, photograph, fitted, depth_map, display, empty, _fill_words(args))
    report.append(_write_outputs(args, fitted.rgbd, eia, empty, display))
    report.append(f"seconds    {time.perf_counter() - started:.1f}")
    return report, picture.warnings(photograph, fitted, depth_map)


def _new_scene_options(args: argparse.Namespace) -> dict[str, Any] | None:
    """Options of `new_scene` for a mesh of any size, from --up and --front; None for others."""
    axes = {"up": args.up, "front": args.front}
    if args.mesh is not None:
        from inim.render.scene_files.new_scene import ANY_UNIT

        return {"unit": ANY_UNIT, **axes}
    if any(axis is not None for axis in axes.values()):
        raise UsageError(f"--up, --front: {args.input} is not a mesh; leave them out")
    return None


def _generate_from_light_field(
    args: argparse.Namespace, display: Display, settings: Settings
) -> list[str]:
    """Generate and write the EIA of a light field; return the lines of output."""
    from inim.apps.own_picture.light_field import (
        centre_view_picture,
        eia_of_all_views,
        shift_px,
        step_mm,
    )
    from inim.image.files.light_field import read_hci

    field = read_hci(args.light_field)
    rgbd, clipped = None, None
    if args.all_views:
        if args.save_rgbd is not None:
            raise UsageError(
                "--save-rgbd: the light field's views have no depth; leave it or --all-views out"
            )
        eia, fitted = eia_of_all_views(field, display)
        empty: np.ndarray | None = ~fitted
    else:
        pixels_per_pitch = settings.capture_pixels_per_pitch
        rgbd, clipped = centre_view_picture(field, display, pixels_per_pitch, str(args.light_field))
        eia, empty = _generate_eia(args, rgbd, display)
    down, across, height, width = field.views.shape[:4]
    report = [
        _display_line(display),
        f"views      {across} x {down} of {width} x {height} pixels",
        f"disparity  1 pixel is {step_mm(field, display):.4g} mm of depth; "
        f"{shift_px(field, display):+.4g} pixels added",
    ]
    if clipped is not None:
        report.append(f"clipped    {clipped:.1%} of the samples were beyond the depth range")
    return [*report, _write_outputs(args, rgbd, eia, empty, display)]


def _generate_from_mesh(
    args: argparse.Namespace, options: dict[str, Any]
) -> tuple[list[str], tuple[str, ...]]:
    """Generate and write the EIA of a mesh, as that of a new scene."""
    import tempfile

    from inim.render.scene_files.new_scene import new_scene
    from inim.system.process.atomic_file import temporary_folder

    with temporary_folder(Path(tempfile.gettempdir()), "inim-mesh-") as folder:
        scene = folder / f"{args.mesh.stem}.xml"
        new_scene(args.mesh, scene, **options, warn=print_warning)
        return _generate_from_rgbd(args, scene)


def _generate_from_rgbd(
    args: argparse.Namespace, scene: Path | None
) -> tuple[list[str], tuple[str, ...]]:
    """Generate and write the EIA of a scene, or of an RGB-D picture in millimetres of the display
    frame.
    """
    from inim.generators import parse_algorithm
    from inim.generators.base import outside_depth_range, outside_depth_text
    from inim.image.files.image import read_rgbd

    parse_algorithm(_algorithm(args))
    started = time.perf_counter()
    if scene is not None:
        from inim.pipeline.scene_capture import generate_from_scene

        chosen = choices_of(args)
        rgbd, display, (eia, _, empty, _) = generate_from_scene(
            scene, chosen.get("display"), chosen["definitions"], _algorithm(args), debug=args.debug
        )
    else:
        display, _ = display_and_settings(args)
        rgbd = read_rgbd(args.fitted)
        eia, empty = _generate_eia(args, rgbd, display)
    rows, columns = rgbd.shape
    report = [
        _display_line(display),
        f"picture    {columns} x {rows} pixels of {rgbd.pixel_mm:.4g} mm, "
        f"{len(rgbd.layers)} layers",
        _write_outputs(args, rgbd, eia, empty, display),
        f"seconds    {time.perf_counter() - started:.1f}",
    ]
    if not outside_depth_range(rgbd, display):
        return report, ()
    return report, (f"{args.input}: {outside_depth_text(rgbd, display)}",)


def _generate_from_cameras(
    args: argparse.Namespace, picture: CameraPicture, display: Display, settings: Settings
) -> tuple[list[str], tuple[str, ...]]:
    """Generate and write the EIA of several cameras; return the lines of output, and warnings."""
    from inim.apps.own_picture.cameras import read_cameras
    from inim.generators import merge_cameras, parse_algorithm

    parse_algorithm(_algorithm(args))
    cameras = read_cameras(args.cameras_file, picture, display)
    with naming(args.input):
        rgbd = merge_cameras(cameras.pictures, display, settings.capture_pixels_per_pitch)
    eia, empty = _generate_eia(args, rgbd, display)
    depth_map = cameras.depth_map
    report = [
        _display_line(display),
        f"cameras    {len(cameras.pictures.pictures)}, frame at {cameras.frame_at:.5g} mm of the "
        "first",
        f"depth      {depth_map.near:.5g} (near) .. {depth_map.far:.5g} (far) mm of the first",
        f"layers     {len(rgbd.layers)}, covering "
        + ", ".join(f"{layer.covered.mean():.1%}" for layer in rgbd.layers),
        _write_outputs(args, rgbd, eia, empty, display),
    ]
    return report, cameras.warnings


def _check(args: argparse.Namespace, picture: CameraPicture) -> None:
    """Reject arguments that are invalid independently of the files' content."""
    from inim.generators.options import FILLS, one_of
    from inim.image.files.eia_file import EIA_SUFFIXES

    if args.light_field is not None:
        for name in ("depth_unit", "intrinsics", "near", "far", "frame_at"):
            if getattr(args, name) is not None:
                option = f"--{name.replace('_', '-')}"
                raise UsageError(
                    f"{option}: the light field {args.input} has its own; leave it out"
                )
    elif args.all_views:
        raise UsageError(f"--all-views: {args.input} is not a light field; leave it out")
    elif args.color is not None or args.photo is not None:
        picture.check_files()
    if {args.cameras_file, args.fitted, args.scene, args.mesh} == {None}:
        picture.check_choices()
    if args.fill is not None and one_of("--fill", args.fill, FILLS) != "none" and args.all_views:
        raise UsageError("--fill: with --all-views no algorithm leaves holes; leave it out")
    suffixes = (("-o", args.out, EIA_SUFFIXES), ("--pdf", args.pdf, (".pdf",)))
    outputs: dict[str, str] = {}
    for option, path, allowed in (*suffixes, ("--save-rgbd", args.save_rgbd, (".exr",))):
        if path is None:
            continue
        if path.suffix.lower() not in allowed:
            raise UsageError(
                f"{option} {path}: name a {' or '.join(allowed)} file; only a folder of "
                "photographs gives a folder"
            )
        if path.is_dir():
            raise FileError(f"{path}: is a folder; name a file with {option}")
        place = os.path.realpath(path)
        inputs = [os.path.realpath(p) for p in (args.input, args.depth) if p]
        if place in inputs or place in outputs:
            raise UsageError(
                f"{option} {path}: is also {outputs.get(place, 'an input file')}; choose another "
                "name"
            )
        outputs[place] = option


def _algorithm(args: argparse.Namespace) -> str:
    """Algorithm with its hole filling."""
    default = _DEFAULT_ALGORITHM if args.cameras_file is None else "cameras"
    return (args.algorithm or default) + ("" if args.fill is None else f":fill={args.fill}")


def _fill_words(args: argparse.Namespace) -> str:
    from inim.generators import split_algorithm

    _, options = split_algorithm(_algorithm(args))
    return options.get("fill", "the algorithm's default")


def _generate_eia(
    args: argparse.Namespace, rgbd: RGBD, display: Display
) -> tuple[np.ndarray, np.ndarray | None]:
    """Linear RGB EIA of a picture; its holes, if files show them and the algorithm reports them."""
    from inim.image.files.eia_file import shows_holes
    from inim.pipeline.stages.generation import GeneratorHandle

    generator = GeneratorHandle(_algorithm(args), display, rgbd.shape, rgbd.pixel_mm)
    with naming(args.input):
        run = generator.run(rgbd, holes=shows_holes(display))
    return run.eia, run.holes


def _write_outputs(
    args: argparse.Namespace,
    rgbd: RGBD | None,
    eia: np.ndarray,
    empty: np.ndarray | None,
    display: Display,
) -> str:
    """Write the files of -o, --pdf and --save-rgbd; return the line of output."""
    from inim.image.files.eia_file import write_eia, write_true_size_pdf
    from inim.image.files.image import write_rgbd
    from inim.system.process.atomic_file import published_together

    with published_together():
        write_eia(args.out, eia, empty, display.pixel_pitch_mm)
        if args.pdf is not None:
            write_true_size_pdf(args.pdf, eia, display.pixel_pitch_mm)
        if args.save_rgbd is not None and rgbd is not None:
            write_rgbd(args.save_rgbd, rgbd)
    paths = [path for path in (args.out, args.pdf, args.save_rgbd) if path is not None]
    return f"written    {', '.join(map(str, paths))}"


def _display_line(display: Display) -> str:
    lenses = display.layout.lens_counts()
    return f"display    {display.name}: {lenses} lenses of {display.pitch_mm:g} mm"


def _report(
    picture: CameraPicture,
    photograph: ColorDepth,
    fitted: PictureFit,
    depth_map: DepthMap,
    display: Display,
    empty: np.ndarray | None,
    fill: str,
) -> list[str]:
    import numpy as np

    rows, columns = photograph.color.shape[:2]
    unit = " mm" if photograph.values.has_unit else ""
    pixel, panel = display.pixel_pitch_mm, display.eia_shape
    if photograph.camera is None:
        projection = "orthographic"
    else:
        angle = 2 * np.degrees(np.arctan(columns / (2 * photograph.camera.fx)))
        projection = f"unprojected ({angle:.3g} degrees wide), frame at {fitted.frame_at:.5g}{unit}"
    holes = "unknown"
    if empty is not None:
        share = (empty & display.lensed).sum() / max(1, display.lensed.sum())
        holes = f"{share:.1%} of the pixels of the EIA"
    return [
        _display_line(display),
        *picture.notes(photograph, fitted),
        f"picture    colour {columns} x {rows}, depth {photograph.depth_size[0]} x "
        f"{photograph.depth_size[1]}, {projection}",
        f"depth      {depth_map.near:.5g} (near) .. {depth_map.far:.5g} (far){unit}, "
        f"{depth_map.name}, onto {float(depth_map.z_mm(np.array(depth_map.near))):.4g} .. "
        f"{float(depth_map.z_mm(np.array(depth_map.far))):.4g} mm",
        f"missing    {photograph.missing:.1%} of the depth picture, filled: "
        f"{picture.missing_depth}",
        f"clipped    {fitted.clipped:.1%} of the samples were out of range, "
        f"{'omitted' if picture.out_of_range == 'drop' else 'moved to its ends'}",
        f"empty      {fitted.empty:.1%} of the array's area",
        f"holes      {holes}, fill: {fill}",
        f"size       {panel[1]} x {panel[0]} pixels of {pixel:.6g} mm: {panel[1] * pixel:.6g} x "
        f"{panel[0] * pixel:.6g} mm",
    ]


COMMANDS = {"generate": Command("generate EIAs from your own pictures", _add_arguments, _run)}
