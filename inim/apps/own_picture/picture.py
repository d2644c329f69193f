"""Colour and depth of a camera as a user gives them: reading, checks and fit to a display.

Depth is resampled to the colour picture's size by nearest pixel: a mean would invent surfaces
between an object and its background.
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inim.apps.own_picture.depth_values import (
    DepthConvention,
    DepthValues,
    interpret_depth,
    parse_unit,
)
from inim.apps.own_picture.fit import (
    DepthMap,
    PictureFit,
    Pinhole,
    check_pinhole,
    depth_range,
    fit_picture,
    map_depth,
    parse_intrinsics,
)
from inim.apps.own_picture.framing import Framing, choose_framing
from inim.apps.own_picture.missing_depth import fill_missing_depth
from inim.apps.own_picture.options import PictureOptions
from inim.apps.own_picture.picture_files import (
    SIDES,
    read_cutout,
    read_depth,
    read_side_by_side,
)
from inim.display import Display
from inim.pipeline.stages.picture import MAX_LOST_SHARE
from inim.system.errors import FileError, UsageError

# Relative difference of aspect ratios; cropped or letter-boxed pictures differ by more.
_ASPECT_TOLERANCE = 0.01
_PHOTO_CAMERA = "photo"


def is_side(depth: Path | None) -> bool:
    """True if ``--depth`` is a half of the colour picture, and not a file of that name."""
    return depth is not None and str(depth).lower() in SIDES and not depth.is_file()


def check_same_view(color: tuple[int, int], depth: tuple[int, int], name: str) -> None:
    """Raise `FileError` if the aspect ratios of two pictures, (rows, columns), differ."""
    aspects = [columns / rows for rows, columns in (color, depth)]
    if abs(aspects[0] / aspects[1] - 1) <= _ASPECT_TOLERANCE:
        return
    is_rotated = abs(aspects[0] * aspects[1] - 1) <= _ASPECT_TOLERANCE
    remedy = "rotate one of them upright" if is_rotated else "crop them to the same view"
    raise FileError(
        f"{name}: depth has {depth[1]} x {depth[0]} pixels, colour {color[1]} x {color[0]}: "
        f"different aspect ratios; {remedy}"
    )


def resample_nearest(depth: NDArray[Any], shape: tuple[int, int]) -> NDArray[Any]:
    """Resample depth to another size, by nearest pixel."""
    if depth.shape == shape:
        return depth
    rows, columns = (
        np.minimum(((np.arange(n) + 0.5) * m / n).astype(np.int64), m - 1)
        for n, m in zip(shape, depth.shape, strict=True)
    )
    nearest: NDArray[Any] = depth[np.ix_(rows, columns)]
    return nearest


@dataclass(frozen=True)
class ColorDepth:
    """Colour and depth of a camera on one grid."""

    color: np.ndarray  #: (H, W, 3) uint8 sRGB, or float32 linear RGB
    values: DepthValues  #: Same rows and columns as `color`.
    coarseness: float  #: Width of a depth sample in colour pixels, at least 1.
    depth_size: tuple[int, int]  #: (columns, rows): size of the depth file.
    missing: float  #: Share of the depth pixels without depth.
    warnings: tuple[str, ...]
    camera: Pinhole | None  #: None for orthographic pictures.
    notes: tuple[str, ...] = ()  #: Depth and camera properties that a photograph contains.


@dataclass(frozen=True)
class CameraPicture(PictureOptions):
    """Files of a picture, and the options for reading them.

    `photo` is a photograph with depth inside, or whose depth the model `estimate_depth` estimates;
    it replaces `color` and `depth`. `pinhole` replaces `intrinsics`.
    """

    color: Path | None = None
    photo: Path | None = None
    pinhole: Pinhole | None = None

    @property
    def fit_rule(self) -> str:
        """Rule for the fit: by default `auto` for a photograph with depth, else `cover`."""
        return self.fit or ("cover" if self.photo is None else "auto")

    @property
    def path(self) -> Path | None:
        """File that names the picture: the photograph or the colour file."""
        return self.color if self.photo is None else self.photo

    def check(self) -> None:
        """Raise `UsageError` for an impossible number, or without one projection."""
        for name in ("near", "far", "frame_at", "max_slope"):
            value, is_length = getattr(self, name), name in ("frame_at", "max_slope")
            if value is not None and not (math.isfinite(value) and (value > 0 or not is_length)):
                limit = "must be finite" + " and above 0" * is_length
                raise UsageError(f"--{name.replace('_', '-')} {value:g}: {limit}")
        if self.photo is None and self.intrinsics == _PHOTO_CAMERA:
            raise UsageError(
                "--intrinsics photo: needs a photograph with depth inside; give fx,fy,cx,cy"
            )
        if self.intrinsics and self.orthographic:
            raise UsageError("--orthographic and --intrinsics exclude each other; give one")
        if self.photo is None and not (self.intrinsics or self.orthographic):
            raise UsageError(
                "give either --intrinsics fx,fy,cx,cy (perspective picture, unprojected) or "
                "--orthographic"
            )
        if self.frame_at is not None and not self.intrinsics:
            raise UsageError("--frame-at: has no effect on an orthographic picture; omit it")
        self.camera()

    def camera(self) -> Pinhole | None:
        """Camera of `intrinsics`; None if orthographic or if the photograph's camera is used."""
        if self.orthographic or not self.intrinsics or self.intrinsics == _PHOTO_CAMERA:
            return self.pinhole
        return parse_intrinsics(self.intrinsics)

    def read(self) -> ColorDepth:
        """Read the files; raises an `InimError` if one is damaged or contradicts the options."""
        if self.photo is not None:
            return self._read_photo(self.photo)
        assert self.color is not None
        assert self.depth is not None
        convention, opaque = self._convention(self.depth), None
        color: np.ndarray
        if is_side(self.depth):
            side = str(self.depth).lower()
            color, opaque, file = read_side_by_side(self.color, side)
        else:
            color, opaque = read_cutout(self.color)
            file = read_depth(self.depth, swap_bytes=self.swap_bytes)
        rows, columns = color.shape[:2]
        size = file.values.shape
        check_same_view((rows, columns), (size[0], size[1]), str(self.depth))
        if opaque is not None:  # what is behind transparent pixels must not fill holes
            is_opaque = resample_nearest(opaque, (size[0], size[1]))
            if not is_opaque.any():
                raise FileError(
                    f"{self.path}: all of its pixels are transparent; save it without transparency"
                )
            file = replace(file, values=np.where(is_opaque, file.values, np.float32(np.nan)))
        values = interpret_depth(file, convention, str(self.depth))
        if size != (rows, columns):
            message = (
                f"{self.depth}: {size[1]} x {size[0]} pixels, colour {columns} x {rows}: depth was "
                "resampled to the colour's size by nearest pixel"
            )
            values = replace(values, warnings=(*values.warnings, message))
        return self._combine(color, values, self.camera(), opaque)

    def _convention(self, path: Path) -> DepthConvention:
        """Properties of the depth file's numbers; raises `UsageError` if one is not stated."""
        if self.depth_unit is None:
            raise UsageError(
                f"--depth-unit: missing; state the unit of {path}: mm, cm, m, none, or the number "
                "of units per metre (5000)"
            )
        unit_mm = parse_unit(self.depth_unit)
        if unit_mm == 0 and not (self.near_is_large or self.far_is_large):
            raise UsageError(
                f"--depth-unit none: state the direction of {path}: --near-is-large (white is "
                "near) or --far-is-large"
            )
        has_range = self.near is not None and self.far is not None
        missing = _numbers(self.missing)
        return DepthConvention(unit_mm, self.near_is_large, self.swap_bytes, missing, has_range)

    def _read_photo(self, path: Path) -> ColorDepth:
        """Read a photograph with depth inside, or estimate its depth."""
        from inim.apps.own_picture.depth_photo import read_depth_photo
        from inim.apps.own_picture.depth_photo.codes import invert_disparity

        if self.estimate_depth is None:
            photo = read_depth_photo(path)
            rows, columns = photo.values.depth.shape
            size = (photo.color.shape[0], photo.color.shape[1])
            check_same_view(size, (rows, columns), str(path))
        else:
            from inim.apps.own_picture.estimated_depth import estimate_photo

            photo = estimate_photo(path, self.estimate_depth)
        if np.isnan(photo.values.depth).all():
            raise FileError(f"{path}: no pixel has a depth; use the original file")
        camera, values = self.camera(), photo.values
        if self.intrinsics == _PHOTO_CAMERA:
            camera = photo.camera
            if camera is None:
                raise UsageError(
                    f"--intrinsics photo: {path} contains no camera; give fx,fy,cx,cy or omit "
                    "--intrinsics"
                )
        if camera is not None and values.near_is_large:
            values = invert_disparity(values)
        picture = self._combine(photo.color, values, camera)
        return replace(picture, notes=photo.notes)

    def _combine(
        self,
        color: np.ndarray,
        values: DepthValues,
        camera: Pinhole | None,
        opaque: np.ndarray | None = None,
    ) -> ColorDepth:
        """Fill depth and resample it to the colour's grid; transparent pixels have none."""
        rows, columns = color.shape[:2]
        size = values.depth.shape
        missing = float(np.isnan(values.depth).mean())
        depth = fill_missing_depth(
            values.depth, self.missing_depth, near_is_large=values.near_is_large
        )
        depth = resample_nearest(depth, (rows, columns))
        if opaque is not None:
            depth = np.where(opaque, depth, np.float32(np.nan))
            missing = float(np.isnan(depth).mean())
        values = replace(values, depth=depth)
        coarseness = max(1.0, columns / size[1])
        depth_size = size[1], size[0]
        return ColorDepth(color, values, coarseness, depth_size, missing, values.warnings, camera)

    def orient(self, picture: ColorDepth, display: Display) -> Display:
        """The display, turned on its side if it is wide and the picture is high, or vice versa.

        Displays that differ on their side remain as they are.
        """
        rows, columns = picture.color.shape[:2]
        is_alike = (rows - columns) * (display.height_mm - display.width_mm) >= 0
        return display if is_alike or display.differs_on_its_side else display.turned()

    def fit_to(
        self, picture: ColorDepth, display: Display, pixels_per_pitch: float
    ) -> tuple[PictureFit, DepthMap]:
        """Fit a picture from `read` to a display; also return the map of its depths."""
        if picture.camera is not None:
            rows, columns = picture.color.shape[:2]
            check_pinhole(picture.camera, (rows, columns))
        near, far, frame_at, fit, framing = self.near, self.far, self.frame_at, self.fit_rule, None
        values = picture.values
        if fit == "auto":
            framing = choose_framing(values, display.width_mm / display.height_mm)
            picture, fit = _crop(picture, framing), "cover"
            near, far = self._choose_range(framing, near_is_large=values.near_is_large)
            frame_at = framing.subject_depth if frame_at is None else frame_at
        ends = depth_range(values, near, far)
        depth_map = map_depth(self.depth_map, picture.values, ends, display)
        picture_fit = fit_picture(
            picture.color,
            picture.values,
            depth_map,
            display,
            camera=picture.camera,
            pixels_per_pitch=pixels_per_pitch,
            fit=fit,
            frame_at=frame_at,
            max_slope=self.max_slope,
            coarseness=picture.coarseness,
            drop=self.out_of_range == "drop",
        )
        return replace(picture_fit, framing=None if framing is None else framing.notes), depth_map

    def _choose_range(
        self, framing: Framing, *, near_is_large: bool
    ) -> tuple[float | None, float | None]:
        """User's near and far, completed by the framing's if the order is right."""
        if self.near is None and self.far is None and framing.near == framing.far:
            raise FileError(
                f"{self.depth or self.photo}: its depth is {framing.near:.5g} everywhere; "
                "give --near and --far, or show it flat with --fit cover"
            )
        near = framing.near if self.near is None else self.near
        far = framing.far if self.far is None else self.far
        if near > far if near_is_large else near < far:
            return near, far
        return self.near, self.far

    def describe(self, picture: ColorDepth, fit: PictureFit, depth_map: DepthMap) -> list[str]:
        """Lines on files, framing, depth and omitted parts."""
        (rows, columns), unit = picture.color.shape[:2], " mm" if picture.values.has_unit else ""
        projection = "orthographic"
        if picture.camera is not None:
            angle = 2 * math.degrees(math.atan(columns / (2 * picture.camera.fx)))
            projection = (
                f"unprojected ({angle:.3g} degrees wide), frame at {fit.frame_at:.5g}{unit}"
            )
        notes = {"photo": "; ".join(picture.notes), **(fit.framing or {})}
        ends = depth_map.z_mm(np.array([depth_map.near, depth_map.far]))
        lines = {name: text for name, text in notes.items() if text} | {
            "picture": f"colour {columns} x {rows}, depth {picture.depth_size[0]} x "
            f"{picture.depth_size[1]}, {projection}",
            "depth": f"{depth_map.near:.5g} (near) .. {depth_map.far:.5g} (far){unit}, "
            f"{depth_map.name}, onto {ends[0]:.4g} .. {ends[1]:.4g} mm",
            "missing": f"{picture.missing:.1%} of the depth picture, filled: {self.missing_depth}",
            "clipped": f"{fit.clipped:.1%} of the samples were out of range, "
            f"{'omitted' if self.out_of_range == 'drop' else 'moved to its ends'}",
            "empty": f"{fit.empty:.1%} of the array's area",
        }
        return [f"{name:<11}{text}" for name, text in lines.items()]

    def warnings(
        self, picture: ColorDepth, fit: PictureFit, depth_map: DepthMap
    ) -> tuple[str, ...]:
        """Warnings about the files, the depth map, and mostly clipped or empty pictures."""
        warnings = [*picture.warnings, *depth_map.warnings(fit.clipped)]
        is_auto_range = fit.framing is not None and (self.near, self.far) == (None, None)
        if fit.clipped > MAX_LOST_SHARE and depth_map.name != "printed" and not is_auto_range:
            warnings.append(self._clipped_warning(picture, fit, depth_map))
        if fit.empty > MAX_LOST_SHARE:
            warnings.append(self._empty_warning(picture, fit))
        return tuple(warnings)

    def _clipped_warning(self, picture: ColorDepth, fit: PictureFit, depth_map: DepthMap) -> str:
        valid = picture.values.depth[~np.isnan(picture.values.depth)]
        unit = " mm" if picture.values.has_unit else ""
        effect = "omitted" if self.out_of_range == "drop" else "clipped, which flattens them"
        warning = (
            f"{self.depth or self.photo}: {fit.clipped:.1%} of its depths are out of range and "
            f"were {effect}: they extend from {valid.min():.5g} to {valid.max():.5g}{unit}, the "
            f"range from --near {depth_map.near:.5g} to --far {depth_map.far:.5g}; give a wider "
            "range, or neither"
        )
        return warning + ", or --depth-map linear" * (depth_map.name == "reciprocal")

    def _empty_warning(self, picture: ColorDepth, fit: PictureFit) -> str:
        remedies = []
        if self.fit_rule == "contain":
            remedies.append("--fit cover fills an array of another shape")
        if picture.camera is not None:
            remedies.append("--orthographic instead of --intrinsics keeps the photograph's framing")
        if self.missing_depth == "none" and picture.missing > 0:
            remedies.append(f"--missing-depth behind fills the missing {picture.missing:.1%} of it")
        if self.out_of_range == "drop" and fit.clipped > 0:
            remedies.append("--out-of-range clip keeps depths beyond the range")
        warning = f"{self.path}: {fit.empty:.1%} of the lens array is empty"
        return f"{warning}: {'; '.join(remedies)}" if remedies else warning


def _crop(picture: ColorDepth, framing: Framing) -> ColorDepth:
    window, camera = (framing.rows, framing.columns), picture.camera
    if camera is not None:
        left, top = framing.columns.start, framing.rows.start
        camera = replace(camera, cx=camera.cx - left, cy=camera.cy - top)
    values = replace(picture.values, depth=np.ascontiguousarray(picture.values.depth[window]))
    color = np.ascontiguousarray(picture.color[window])
    return replace(picture, color=color, values=values, camera=camera)


def _numbers(text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split(",") if part.strip())
    except ValueError:
        raise UsageError(f"--missing {text}: write numbers, separated by commas") from None
