"""A camera's colour and depth picture as a user gives it: read, checked, fitted to a display.

Depth is brought to the colour picture's size by taking the nearest pixel, never a mean: between an
object and its background there is nothing. Edges say whether the two belong together.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from inim.display import Display
from inim.errors import FileError, UsageError
from inim.from_camera.depth_values import (
    FILL_RULES,
    DepthValues,
    DepthConvention,
    fill_missing_depth,
    parse_unit,
    interpret_depth,
)
from inim.from_camera.fit import (
    DEPTH_MAPS,
    FITS,
    DepthMap,
    PictureFit,
    Pinhole,
    check_pinhole,
    depth_range,
    fit_picture,
    map_depth,
    parse_intrinsics,
)
from inim.from_camera.framing import Framing, frame
from inim.from_camera.picture_files import read_color, read_depth
from inim.image.rgbd import RGBD

# Weights of red, green and blue; any that look at all three would do.
_LUMA = (0.3, 0.6, 0.1)
# Of width over height; cropped or letter-boxed pictures differ by more.
_ASPECT_TOLERANCE = 0.01
# Edges are compared on pictures about this wide; farther than this share of it is not looked.
_COMPARED_AT = 480
_FARTHEST = 0.06
# An edge of depth: neighbours that differ by this part of the depth range.
_EDGE = 0.05
# Fewer edge pixels say nothing.
_LEAST_EDGES = 200
# Depth sensors miss the true edge by a few pixels; a shift by less is no finding.
_TOLERATED = 4.0
#: From here on a picture shows little of itself, and its user should know why.
MOST = 0.5
# How much better the edges must match there than where they are, above their mean match.
_BETTER = 1.35
# What a photograph with depth inside says itself.
_OWN = (
    "color",
    "depth",
    "depth_unit",
    "near_is_large",
    "far_is_large",
    "missing",
    "swap_bytes",
)
_OF_PHOTO = "photo"
# A best match this many deviations above the others is none by chance: among the some thousand
# shifts, pictures that have nothing in common reach 4.
_BEYOND_CHANCE = 5.0


def check_same_view(color: tuple[int, int], depth: tuple[int, int], name: str) -> None:
    """Raise `FileError` where two pictures, (rows, columns), cannot show the same view."""
    aspects = [columns / rows for rows, columns in (color, depth)]
    if abs(aspects[0] / aspects[1] - 1) <= _ASPECT_TOLERANCE:
        return
    turned = abs(aspects[0] * aspects[1] - 1) <= _ASPECT_TOLERANCE
    way_out = "one of them is turned; turn it back" if turned else "crop them to the same view"
    raise FileError(
        f"{name}: depth has {depth[1]} x {depth[0]} pixels, colour {color[1]} x {color[0]}: "
        f"another shape; {way_out}"
    )


def resample_nearest(depth: NDArray[np.float32], shape: tuple[int, int]) -> NDArray[np.float32]:
    """Depth at another size, each pixel's that of the nearest pixel centre."""
    if depth.shape == shape:
        return depth
    rows, columns = (
        np.minimum(((np.arange(n) + 0.5) * m / n).astype(np.int64), m - 1)
        for n, m in zip(shape, depth.shape, strict=True)
    )
    nearest: NDArray[np.float32] = depth[np.ix_(rows, columns)]
    return nearest


def edge_shift(color: np.ndarray, depth: NDArray[np.float32]) -> tuple[int, int] | None:
    """Pixels to the right and down by which depth has to be moved to match the colour's edges.

    None unless the edges match so much better there that the two are likely misaligned.

    Parameters
    ----------
    color : (H, W, 3) array
    depth : (H, W) float32
        NaN where missing.
    """
    step = max(1, math.ceil(depth.shape[1] / _COMPARED_AT))
    small = depth[::step, ::step]
    grey = np.asarray(color[::step, ::step], np.float32) @ np.array(_LUMA, np.float32)
    edges, contrast = _depth_edges(small), _contrast(grey)
    farthest = max(1, round(_FARTHEST * max(small.shape)))
    if edges.sum() < _LEAST_EDGES or min(small.shape) <= 2 * farthest:
        return None
    padded = tuple(n + farthest for n in small.shape)
    spectrum = np.fft.rfft2(contrast - contrast.mean(), padded) * np.conj(
        np.fft.rfft2(edges, padded)
    )
    match = np.roll(np.fft.irfft2(spectrum, padded), (farthest, farthest), (0, 1))
    match = match[: 2 * farthest + 1, : 2 * farthest + 1]
    down, right = (int(v) - farthest for v in np.unravel_index(match.argmax(), match.shape))
    here, best = float(match[farthest, farthest]), float(match.max())
    base = float(np.median(match))
    deviation = 1.4826 * float(np.median(np.abs(match - base)))  # of a normal distribution
    misaligned = (
        math.hypot(down, right) * step > _TOLERATED
        and best - base > _BETTER * (here - base)
        and best - base > _BEYOND_CHANCE * deviation
    )
    return (right * step, down * step) if misaligned else None


def _depth_edges(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """1 on both sides of a jump of depth, 0 elsewhere and beside missing depth."""
    known = depth[~np.isnan(depth)]
    edges = np.zeros(depth.shape, np.float32)
    if known.size < 2:
        return edges
    low, high = np.quantile(known, (0.02, 0.98))
    limit = _EDGE * float(high - low)
    across = np.abs(np.diff(depth, axis=1)) > limit
    down = np.abs(np.diff(depth, axis=0)) > limit
    edges[:, :-1][across] = 1
    edges[:, 1:][across] = 1
    edges[:-1][down] = 1
    edges[1:][down] = 1
    return edges


def _contrast(grey: NDArray[np.float32]) -> NDArray[np.float32]:
    """Differences of neighbours, compressed so that a few hard edges do not decide."""
    across = np.zeros_like(grey)
    across[:, 1:-1] = np.abs(grey[:, 2:] - grey[:, :-2])
    across[1:-1] += np.abs(grey[2:] - grey[:-2])
    return np.asarray(np.sqrt(across), np.float32)


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
    camera : Pinhole or None
        None where the picture is taken as orthographic.
    said : tuple of str
        What a photograph says of the depth inside it.
    """

    color: np.ndarray
    values: DepthValues
    coarseness: float
    depth_size: tuple[int, int]
    missing: float
    warnings: tuple[str, ...]
    camera: Pinhole | None
    said: tuple[str, ...] = ()


@dataclass(frozen=True)
class CameraPicture:
    """The files of a picture, and what the user says of them; see `inim generate --help`.

    Every field is an option of that name. `photo` is a photograph with depth inside, in place of
    `color` and `depth`.
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
    out_of_range: str = "clip"
    missing: str = ""
    missing_depth: str = "none"
    fit: str | None = None
    frame_at: float | None = None
    max_slope: float = 10.0
    swap_bytes: bool = False
    photo: Path | None = None

    @property
    def fit_rule(self) -> str:
        """How it is fitted: a photograph with depth inside by itself, two files as they are."""
        return self.fit or ("contain" if self.photo is None else "auto")

    @property
    def shown(self) -> Path | None:
        """The file to name."""
        return self.color if self.photo is None else self.photo

    def check_files(self) -> None:
        """Raise `UsageError` unless there are two files, and it is said how they were taken."""
        if self.photo is not None:
            for name in _OWN:
                if getattr(self, name):
                    option = f"--{name.replace('_', '-')}"
                    raise UsageError(f"{option}: {self.photo} has its own depth; leave it out")
            if self.intrinsics and self.orthographic:
                raise UsageError("--orthographic: and --intrinsics; give one of them")
            return
        if self.intrinsics == _OF_PHOTO:
            raise UsageError("--intrinsics photo: is for photographs with depth inside")
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
            "--missing-depth": (self.missing_depth, FILL_RULES),
            "--fit": (self.fit_rule, (*FITS, "auto")),
            "--out-of-range": (self.out_of_range, ("clip", "drop")),
        }
        for option, (word, known) in words.items():
            if word not in known:
                raise UsageError(f"{option} {word}: use {', '.join(known[:-1])} or {known[-1]}")
        if not (math.isfinite(self.max_slope) and self.max_slope > 0):
            raise UsageError(f"--max-slope {self.max_slope:g}: a slope above 0; 10 is 84 degrees")
        if self.frame_at is not None and not self.intrinsics:
            raise UsageError("--frame-at: an orthographic picture is as large at every distance")

    def camera(self) -> Pinhole | None:
        """The camera that is stated; None where there is none, or it is a photograph's own."""
        if self.orthographic or not self.intrinsics or self.intrinsics == _OF_PHOTO:
            return None
        return parse_intrinsics(self.intrinsics)

    def read(self) -> ColorDepth:
        """Read the files.

        Raises
        ------
        InimError
            A file that is damaged or makes no sense with what is said of it.
        """
        if self.photo is not None:
            return self._read_photo(self.photo)
        assert self.color is not None
        assert self.depth is not None
        stated = DepthConvention(
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
        values = interpret_depth(file, stated, str(self.depth))
        taken = self._taken(color, values, self.camera(), str(self.depth))
        if size == (rows, columns):
            return taken
        resized = (
            f"{self.depth}: {size[1]} x {size[0]} pixels, colour {columns} x {rows}: depth was "
            "brought to the colour's size by nearest pixel"
        )
        of_values = len(values.warnings)
        said = (*taken.warnings[:of_values], resized, *taken.warnings[of_values:])
        return replace(taken, warnings=said)

    def _read_photo(self, path: Path) -> ColorDepth:
        """Read a photograph with depth inside."""
        from inim.from_camera.depth_photo import read_depth_photo
        from inim.from_camera.depth_photo.codes import distances

        photo = read_depth_photo(path)
        rows, columns = photo.values.depth.shape
        check_same_view((photo.color.shape[0], photo.color.shape[1]), (rows, columns), str(path))
        if np.isnan(photo.values.depth).all():
            raise FileError(f"{path}: no pixel of its depth has one; take the original file")
        camera, values = self.camera(), photo.values
        if self.intrinsics == _OF_PHOTO:
            camera = photo.camera
            if camera is None:
                raise UsageError(
                    f"--intrinsics photo: {path} does not say how it was taken; write "
                    "fx,fy,cx,cy, or leave it out"
                )
        if camera is not None and values.near_is_large:
            values = distances(values)
        taken = self._taken(photo.color, values, camera, str(path))
        return replace(taken, said=photo.said)

    def _taken(
        self, color: np.ndarray, values: DepthValues, camera: Pinhole | None, name: str
    ) -> ColorDepth:
        """Colour and depth on the colour's grid, and whether their edges agree."""
        rows, columns = color.shape[:2]
        size = values.depth.shape
        missing = float(np.isnan(values.depth).mean())
        filled = fill_missing_depth(values.depth, self.missing_depth, near_is_large=values.near_is_large)
        values = replace(values, depth=resample_nearest(filled, (rows, columns)))
        warnings = values.warnings
        shift = edge_shift(color, values.depth)
        if shift is not None:
            warnings = (
                *warnings,
                f"{name}: its edges match those of {self.shown} better "
                f"{shift[0]:+} pixels to the right and {shift[1]:+} down: the two may "
                "be misaligned; register depth to colour first",
            )
        coarseness = max(1.0, columns / size[1])
        return ColorDepth(color, values, coarseness, (size[1], size[0]), missing, warnings, camera)

    def fit_to(
        self, taken: ColorDepth, display: Display, pixels_per_pitch: float
    ) -> tuple[PictureFit, DepthMap]:
        """What was read, fitted to a display; and how its depths were mapped."""
        if taken.camera is not None:
            rows, columns = taken.color.shape[:2]
            check_pinhole(taken.camera, (rows, columns))
        near, far, frame_at, fit, framing = self.near, self.far, self.frame_at, self.fit_rule, None
        whole = taken.values
        if fit == "auto":
            framing = frame(whole, display.width_mm / display.height_mm)
            taken, fit = _cropped(taken, framing), framing.fit
            near, far = self._framed_range(framing, near_is_large=whole.near_is_large)
            frame_at = framing.middle if frame_at is None else frame_at
        ends = depth_range(whole, near, far)
        depth_map = map_depth(self.depth_map, taken.values, ends, display)
        fitted = fit_picture(
            taken.color,
            taken.values,
            depth_map,
            display,
            camera=taken.camera,
            pixels_per_pitch=pixels_per_pitch,
            fit=fit,
            frame_at=frame_at,
            max_slope=self.max_slope,
            coarseness=taken.coarseness,
            drop=self.out_of_range == "drop",
        )
        return replace(fitted, framing=None if framing is None else framing.said), depth_map

    def _framed_range(
        self, framing: Framing, *, near_is_large: bool
    ) -> tuple[float | None, float | None]:
        """The stated ends, and those of the framing where they go with them; else None."""
        if self.near is None and self.far is None and framing.near == framing.far:
            raise FileError(
                f"{self.depth or self.photo}: its depth is the same everywhere, "
                f"{framing.near:.5g}; state --near and --far, or show it flat with --fit contain"
            )
        near = framing.near if self.near is None else self.near
        far = framing.far if self.far is None else self.far
        if near > far if near_is_large else near < far:
            return near, far
        return self.near, self.far

    def fitted(
        self, display: Display, pixels_per_pitch: float
    ) -> tuple[RGBD, tuple[str, ...], tuple[str, ...]]:
        """Check, read and fit the picture; its RGB-D in the display frame, warnings, and notes."""
        self.check_files()
        self.check_choices()
        self.camera()
        taken = self.read()
        fitted, depth_map = self.fit_to(taken, display, pixels_per_pitch)
        return fitted.rgbd, self.warnings(taken, fitted, depth_map), self.notes(taken, fitted)

    def notes(self, taken: ColorDepth, fitted: PictureFit) -> tuple[str, ...]:
        """What a photograph says of its depth, and how a picture was framed, where by itself."""
        said = {"photo": "; ".join(taken.said), "framed": fitted.framing or ""}
        return tuple(f"{name:<11}{words}" for name, words in said.items() if words)

    def warnings(self, taken: ColorDepth, fitted: PictureFit, depth_map: DepthMap) -> tuple[str, ...]:
        """What to say of the files, the map, and of a picture most of which is lost in it."""
        said = [*taken.warnings, *depth_map.warnings(fitted.clipped)]
        chosen = fitted.framing is not None and (self.near, self.far) == (None, None)
        if fitted.clipped > MOST and depth_map.name != "printed" and not chosen:
            said.append(self._clipped_words(taken, fitted, depth_map))
        if fitted.empty > MOST:
            said.append(self._empty_words(taken, fitted))
        return tuple(said)

    def _clipped_words(self, taken: ColorDepth, fitted: PictureFit, depth_map: DepthMap) -> str:
        known = taken.values.depth[~np.isnan(taken.values.depth)]
        unit = " mm" if taken.values.has_unit else ""
        done = "left out" if self.out_of_range == "drop" else "moved to its ends, where they lie flat"
        words = (
            f"{self.depth or self.photo}: {fitted.clipped:.1%} of its depths lie beyond the range "
            f"that is mapped and were {done}; they run from {known.min():.5g} to "
            f"{known.max():.5g}{unit}, and --near {depth_map.near:.5g} --far {depth_map.far:.5g} "
            "were mapped: state a wider range, or neither"
        )
        return words + ", or --depth-map linear" * (depth_map.name == "reciprocal")

    def _empty_words(self, taken: ColorDepth, fitted: PictureFit) -> str:
        ways = []
        if self.fit_rule != "cover":
            ways.append("--fit cover fills an array of another shape")
        if taken.camera is not None:
            ways.append("--orthographic in place of --intrinsics keeps the photograph's framing")
        if self.missing_depth == "none" and taken.missing > 0:
            ways.append(
                f"--missing-depth behind gives a depth to the {taken.missing:.1%} of the picture that "
                "have none"
            )
        if self.out_of_range == "drop" and fitted.clipped > 0:
            ways.append("--out-of-range clip keeps what lies beyond the range")
        words = f"{self.shown}: {fitted.empty:.1%} of the lens array show nothing"
        return f"{words}: {'; '.join(ways)}" if ways else words


def _cropped(taken: ColorDepth, framing: Framing) -> ColorDepth:
    """What of a picture is shown."""
    window, camera = (framing.rows, framing.columns), taken.camera
    if camera is not None:
        left, top = framing.columns.start, framing.rows.start
        camera = replace(camera, cx=camera.cx - left, cy=camera.cy - top)
    values = replace(taken.values, depth=np.ascontiguousarray(taken.values.depth[window]))
    color = np.ascontiguousarray(taken.color[window])
    return replace(taken, color=color, values=values, camera=camera)


def _numbers(text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split(",") if part.strip())
    except ValueError:
        raise UsageError(f"--missing {text}: write numbers, separated by commas") from None
