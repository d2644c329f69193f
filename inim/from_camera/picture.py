"""A camera's colour and depth picture as a user gives it: read, checked, fitted to a display."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from inim.display import Display
from inim.errors import UsageError
from inim.from_camera.depth_map import DEPTH_MAPS, DepthMap, depth_range, map_depth
from inim.from_camera.depth_values import (
    FILL_RULES,
    DepthValues,
    Meaning,
    fill_missing,
    parse_unit,
    read_meaning,
)
from inim.from_camera.fit import (
    FITS,
    Fitted,
    Pinhole,
    check_pinhole,
    fit_picture,
    parse_intrinsics,
)
from inim.from_camera.picture_files import read_color, read_depth
from inim.from_camera.registration import check_same_view, edge_shift, resampled
from inim.rgbd import RGBD

__all__ = ["CameraPicture", "ColorDepth"]


@dataclass(frozen=True)
class ColorDepth:
    """Colour and depth as taken, on one grid.

    Attributes
    ----------
    color : (H, W, 3) uint8 sRGB, or float32 linear RGB
    values : DepthValues
        Of the same rows and columns.
    coarseness : float
        Width of a sample of the depth picture in pixels of the colour picture, at least 1.
    depth_size : (columns, rows)
        Of the depth picture's file.
    missing : float
        Share of its pixels that have no depth.
    warnings : tuple of str
    """

    color: np.ndarray
    values: DepthValues
    coarseness: float
    depth_size: tuple[int, int]
    missing: float
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class CameraPicture:
    """The two files of a picture, and what the user says of them; see `inim generate --help`.

    Every field is an option of that name.
    """

    color: Path | None = None
    depth: Path | None = None
    depth_unit: str | None = None
    intrinsics: str | None = None
    orthographic: bool = False
    depth_map: str = "linear"
    near_is_large: bool = False
    far_is_large: bool = False
    near: float | None = None
    far: float | None = None
    outside: str = "clip"
    missing: str = ""
    fill: str = "none"
    fit: str = "contain"
    frame_at: float | None = None
    steepest: float = 10.0
    swap_bytes: bool = False

    def check_files(self) -> None:
        """Raise `UsageError` unless there are two files, and it is said how they were taken."""
        for name in ("color", "depth"):
            if getattr(self, name) is None:
                raise UsageError(f"--{name}: missing; give --color FILE and --depth FILE")
        if bool(self.intrinsics) == self.orthographic:
            raise UsageError(
                "give either --intrinsics fx,fy,cx,cy (a camera's picture, unprojected) or "
                "--orthographic (taken as it is)"
            )

    def check_choices(self) -> None:
        """Raise `UsageError` for words and numbers that are none of an option's."""
        words = {
            "--depth-map": (self.depth_map, DEPTH_MAPS),
            "--fill": (self.fill, FILL_RULES),
            "--fit": (self.fit, FITS),
            "--outside": (self.outside, ("clip", "drop")),
        }
        for option, (word, known) in words.items():
            if word not in known:
                raise UsageError(f"{option} {word}: use {', '.join(known[:-1])} or {known[-1]}")
        if not (math.isfinite(self.steepest) and self.steepest > 0):
            raise UsageError(f"--steepest {self.steepest:g}: a slope above 0; 10 is 84 degrees")
        if self.frame_at is not None and self.orthographic:
            raise UsageError("--frame-at: an orthographic picture is as large at every distance")

    def camera(self) -> Pinhole | None:
        """The camera; None where the picture is taken as orthographic."""
        return None if self.orthographic else parse_intrinsics(str(self.intrinsics))

    def read(self) -> ColorDepth:
        """Read the two files.

        Raises
        ------
        InimError
            A file that is damaged or makes no sense with what is said of it.
        """
        assert self.color is not None
        assert self.depth is not None
        stated = Meaning(
            None if self.depth_unit is None else parse_unit(self.depth_unit),
            True if self.near_is_large else False if self.far_is_large else None,
            _numbers(self.missing),
            self.near is not None and self.far is not None,
        )
        color = read_color(self.color)
        file = read_depth(self.depth, swap_bytes=self.swap_bytes)
        rows, columns = color.shape[:2]
        size = file.values.shape
        check_same_view((rows, columns), (size[0], size[1]), str(self.depth))
        values = read_meaning(file, stated, str(self.depth))
        warnings = [*values.warnings]
        missing = float(np.isnan(values.depth).mean())
        filled = fill_missing(values.depth, self.fill, near_is_large=values.near_is_large)
        values = replace(values, depth=resampled(filled, (rows, columns)))
        if size != (rows, columns):
            warnings.append(
                f"{self.depth}: {size[1]} x {size[0]} pixels, colour {columns} x {rows}: depth was "
                "brought to the colour's size by nearest pixel"
            )
        shift = edge_shift(color, values.depth)
        if shift.found:
            warnings.append(
                f"{self.depth}: its edges match those of {self.color} better "
                f"{shift.right:+.0f} pixels to the right and {shift.down:+.0f} down: the two may "
                "be misaligned; register depth to colour first"
            )
        return ColorDepth(
            color,
            values,
            max(1.0, columns / size[1]),
            (size[1], size[0]),
            missing,
            tuple(warnings),
        )

    def fit_to(
        self, taken: ColorDepth, display: Display, pixels_per_pitch: int
    ) -> tuple[Fitted, DepthMap]:
        """What was read, fitted to a display; and how its depths were mapped."""
        camera = self.camera()
        if camera is not None:
            rows, columns = taken.color.shape[:2]
            check_pinhole(camera, (rows, columns))
        ends = depth_range(taken.values, self.near, self.far)
        depth_map = map_depth(self.depth_map, taken.values, ends, display)
        fitted = fit_picture(
            taken.color,
            taken.values,
            depth_map,
            display,
            camera=camera,
            pixels_per_pitch=pixels_per_pitch,
            fit=self.fit,
            frame_at=self.frame_at,
            steepest=self.steepest,
            coarseness=taken.coarseness,
            drop=self.outside == "drop",
        )
        return fitted, depth_map

    def fitted(self, display: Display, pixels_per_pitch: int) -> tuple[RGBD, tuple[str, ...]]:
        """Check, read and fit the picture; its RGB-D in the display frame, and warnings."""
        self.check_files()
        self.check_choices()
        self.camera()
        taken = self.read()
        return self.fit_to(taken, display, pixels_per_pitch)[0].rgbd, taken.warnings


def _numbers(text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split(",") if part.strip())
    except ValueError:
        raise UsageError(f"--missing {text}: write numbers, separated by commas") from None
