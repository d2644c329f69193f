"""Compare the program with photographs through a real lens array and a plenoptic camera's picture.

    git clone https://github.com/Ni-Chen/LF-based-Synthetic-Holography
    git clone https://github.com/cicwi/plenoptomos
    python -m reports.reality.run LF-based-Synthetic-Holography plenoptomos -o reports/reality

The first folder has photographs through a lens array with a pitch of 1 mm and a focal length of 3.3
mm, of four objects. Each was taken four times, with the array moved by half a pitch. Its code is
under GPL-2, and its data have no licence. The second, under GPL-3, has a plenoptic camera's raw,
white and dark picture. Only numbers are written.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

import inim
from inim.apps.own_picture.picture_files import read_color
from inim.apps.pickup.elemental_images import pickup
from inim.apps.pickup.lattice import Lattice, find_lattice
from inim.display import Viewpoint
from inim.image.color import linear_from_srgb
from inim.report.study import PagePart
from inim.scores.metrics import psnr_db, ssim
from reports.study import CODE, Results, Study, entry, table

PITCH_MM, GAP_MM = 1.0, 3.3
#: Pixels per elemental image and depths of reconstruction in mm, in the authors' parameters.
OBJECTS: dict[str, tuple[int, tuple[int, int]]] = {
    "girl": (64, (45, 75)),
    "bear": (54, (45, 63)),
    "foot": (50, (45, 80)),
    "GN": (46, (30, 80)),
}
CAPTURES = ("11", "12", "21", "22")
SAMPLES = 48
_BOOTSTRAPS = 400
# Part of the median brightness of an object's elemental images that counts as lit.
_LIT = 0.2


def read_linear(path: Path) -> np.ndarray:
    """Linear light of a photograph, (rows, columns, 3) float32."""
    return linear_from_srgb(read_color(path).astype(np.float32) / 255)


def sample(light: np.ndarray, centres: np.ndarray, lattice: Lattice, at: np.ndarray) -> np.ndarray:
    """Light at offsets, (m, 2) pitches, from centres, (n, 2) pixels: (n, m, channels) float32."""
    angle = math.radians(lattice.rotation_deg.value)
    c, s = math.cos(angle), math.sin(angle)
    pitch = np.array([lattice.pitch_px.value, lattice.row_pitch_px.value])
    turned = (at * pitch) @ np.array([[c, -s], [s, c]])
    x, y = (centres[:, None] + turned).transpose(2, 0, 1) - 0.5
    channels = np.moveaxis(light.astype(np.float32, copy=False), -1, 0)
    sampled = [ndimage.map_coordinates(channel, [y, x], order=1) for channel in channels]
    return np.stack(sampled, axis=-1)


def grid() -> np.ndarray:
    """Offsets of samples from the centre of an elemental image, (n, 2) pitches."""
    axis = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5
    return np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)


def disparities(light: np.ndarray, lattice: Lattice, step: int = 2) -> np.ndarray:
    """Shifts of the object between elemental images `step` columns apart, in pitches per lens.

    The best normalised correlation of the middle two thirds, for the lit elemental images.
    """
    centres = lattice.centres_px()
    grey = light.mean(axis=-1, keepdims=True)
    images = sample(grey, centres.reshape(-1, 2), lattice, grid())
    images = images.reshape(*centres.shape[:2], SAMPLES, SAMPLES)
    lit = images.mean(axis=(2, 3)) > _LIT * np.quantile(images.mean(axis=(2, 3)), 0.98)
    shifts = np.arange(-2, 11)
    half = SAMPLES // 2 - 4 - shifts[-1]
    middle = slice(SAMPLES // 2 - half, SAMPLES // 2 + half)
    results = []
    for row, column in np.argwhere(lit[:, :-step] & lit[:, step:]):
        first = images[row, column, 4:-4, middle]
        scores = []
        for shift in shifts:
            # The object moves right by more than the lens: its offset from the centre grows.
            moved = slice(middle.start + shift, middle.stop + shift)
            second = images[row, column + step, 4:-4, moved]
            scores.append(np.corrcoef(first.ravel(), second.ravel())[0, 1])
        best = int(np.argmax(scores))
        if 0 < best < len(shifts) - 1 and scores[best] > 0.8:
            low, top, high = scores[best - 1 : best + 2]
            peak = shifts[best] + (low - high) / (2 * (low - 2 * top + high))
            results.append(peak / SAMPLES / step)
    return np.array(results)


def depth(light: np.ndarray, lattice: Lattice) -> dict[str, Any]:
    """Distance of the object from the array, from its shift between elemental images.

    An object at z repeats every P (1 + g / z). Interval of the median from a bootstrap.
    """
    shifts = disparities(light, lattice)
    random = np.random.default_rng(0)
    medians = np.median(random.choice(shifts, (_BOOTSTRAPS, len(shifts))), axis=1)
    low, high = np.quantile(medians, (0.025, 0.975))
    middle = float(np.median(shifts))
    return {
        "pairs": len(shifts),
        "disparity_pitches": middle,
        "repeat_px": (1 + middle) * lattice.pitch_px.value,
        "depth_mm": GAP_MM / middle,
        "depth_interval_mm": [GAP_MM / high, GAP_MM / low],
        "depth_quartiles_mm": [float(GAP_MM / q) for q in np.quantile(shifts, (0.75, 0.25))],
    }


def predict(
    lights: dict[str, np.ndarray], lattices: dict[str, Lattice], disparity: float
) -> dict[str, Any]:
    """Predict capture 22 from the others: rays through the object's plane against interpolation.

    Each of its elemental images is the mean of the nearest ones of the other captures, moved by the
    object's disparity, or not moved.
    """
    target = lattices["22"]
    centres = target.centres_px().reshape(-1, 2)
    offsets = grid()
    true = sample(lights["22"], centres, target, offsets)
    mean = true.mean(axis=(1, 2))
    lit = mean > _LIT * np.quantile(mean, 0.98)
    centres, true = centres[lit], true[lit]
    sums = {"moved": np.zeros_like(true), "not moved": np.zeros_like(true)}
    weights = {name: np.zeros(true.shape[:2]) for name in sums}
    for capture in ("11", "12", "21"):
        others = lattices[capture].centres_px().reshape(-1, 2)
        difference = others[None] - centres[:, None]
        near = np.argsort((difference**2).sum(axis=-1), axis=1)[:, :4]
        for k in range(4):
            chosen = others[near[:, k]]
            # Of a lens that is half a pitch away; farther ones are hardly better than none.
            apart = (chosen - centres) / target.pitch_px.value
            close = np.hypot(*apart.T) < 0.8
            for name, factor in (("moved", disparity), ("not moved", 0.0)):
                at = offsets[None] + factor * apart[:, None]
                inside = (np.abs(at) < 0.48).all(axis=-1) & close[:, None]
                pixels = np.stack(
                    [
                        sample(lights[capture], c[None], lattices[capture], a)[0]
                        for c, a in zip(chosen, at, strict=True)
                    ]
                )
                sums[name] += pixels * inside[..., None]
                weights[name] += inside
    compared = (weights["moved"] > 0) & (weights["not moved"] > 0)

    def windows(pixels: np.ndarray) -> np.ndarray:
        light = np.clip(np.where(compared[..., None], pixels, 0), 0, 1).astype(np.float32)
        return light.reshape(-1, SAMPLES, SAMPLES, 3)

    results: dict[str, Any] = {
        "elemental_images": int(lit.sum()), "compared_share": float(compared.mean()),
    }  # fmt: skip
    for name, total in sums.items():
        predicted = total / np.maximum(weights[name], 1)[..., None]
        pairs = list(zip(windows(true), windows(predicted), strict=True))
        results[name] = {
            score.__name__: float(np.mean([score(*pair) for pair in pairs]))
            for score in (psnr_db, ssim)
        }
    return results


def vignetting(light: np.ndarray, lattice: Lattice, disparity: float) -> dict[str, float]:
    """Light of the same object points towards the sides of lenses, relative to the middle.

    A point moves by the disparity from lens to lens: the ratio of its light in both gives the
    slope of the logarithm of vignetting. Median over elemental images, and its integral.
    """
    centres = lattice.centres_px()
    axis = np.linspace(-0.45, 0.45, 19)
    across = np.stack(np.meshgrid(axis, np.linspace(-0.2, 0.2, 9)), axis=-1).reshape(-1, 2)
    step = 2
    first = sample(light, centres[:, :-step].reshape(-1, 2), lattice, across)[..., 1]
    moved = across + np.array([step * disparity, 0])
    second = sample(light, centres[:, step:].reshape(-1, 2), lattice, moved)[..., 1]
    usable = (first > 0.05) & (second > 0.02) & (first < 0.9) & (second < 0.9)
    usable &= np.abs(moved[:, 0]) < 0.47
    ratio = np.where(usable, np.log(np.maximum(second, 1e-6) / np.maximum(first, 1e-6)), np.nan)
    slope = np.nanmedian(ratio.reshape(-1, 9, 19), axis=(0, 1)) / (step * disparity)
    middle = axis + step * disparity / 2
    valid = np.isfinite(slope)
    log = np.concatenate([[0], np.cumsum(slope[valid][1:] * np.diff(middle[valid]))])
    log -= np.interp(0, middle[valid], log)
    sides = [float(np.exp(np.interp(u, middle[valid], log))) for u in (-0.4, 0.4)]
    return {"left_0.4_pitch": sides[0], "right_0.4_pitch": sides[1]}


def lens_vignetting() -> float:
    """`thick`: on-axis light of a point of the panel 0.4 pitches from the lens's axis."""
    from inim.display.lens import trace_to_panel

    display = inim.Display(
        pitch_mm=PITCH_MM, focal_length_mm=GAP_MM, gap_mm=GAP_MM, pixel_pitch_mm=1 / 64,
        lens_columns=1, lens_rows=1, depth_min_mm=-80, depth_max_mm=-30,
    )  # fmt: skip
    axis = np.linspace(-0.49, 0.49, 61)
    x, y = (values.ravel() for values in np.meshgrid(axis, axis))
    light = []
    for slope in (0.0, 0.4 * PITCH_MM / GAP_MM):
        slopes = np.full_like(x, slope), np.zeros_like(x)
        light.append(float(trace_to_panel(display, "thick", x, y, *slopes)[2].mean()))
    return light[1] / light[0]


def lattice_record(lattice: Lattice) -> dict[str, Any]:
    """Pitch of a lattice with the half width of its interval, and the scatter of its centres."""
    return {"pitch_px": list(lattice.pitch_px), "residual_rms_px": lattice.rms_px}


def lens_array(folder: Path, name: str) -> dict[str, Any]:
    """All results of one object."""
    about_px, authors_mm = OBJECTS[name]
    lights = {k: read_linear(folder / "code" / "data" / name / f"eleImg_{k}.JPG") for k in CAPTURES}
    lattices = {
        k: find_lattice(light.mean(axis=-1), f"{name} {k}", about_px) for k, light in lights.items()
    }
    distance = depth(lights["11"], lattices["11"])
    return {
        "lattices": {k: lattice_record(lattice) for k, lattice in lattices.items()},
        "authors_px": about_px,
        "depth": distance,
        "authors_depth_mm": authors_mm,
        "prediction": predict(lights, lattices, distance["disparity_pitches"]),
        "vignetting": vignetting(lights["11"], lattices["11"], distance["disparity_pitches"]),
    }


def plenoptic(folder: Path) -> dict[str, Any]:
    """Lattice of the white picture; views through the lenses against sub-aperture pictures."""
    data = folder / "examples" / "data"
    # A focused display: a sub-aperture picture's rays are parallel.
    display = inim.Display(
        pitch_mm=0.3, focal_length_mm=18.6, gap_mm=18.6, pixel_pitch_mm=0.3 / 48,
        lens_columns=25, lens_rows=20, depth_min_mm=-20, depth_max_mm=20,
    )  # fmt: skip
    capture = pickup(
        data / "letters_ULF_M1.png", display, raw=True,
        white=data / "letters_ULF_M1_white.png", dark=data / "letters_ULF_M1_dark.png",
    )  # fmt: skip
    lattice, display = capture.lattice, capture.display
    correlations, views = {}, []
    distance = 2e4
    for u in (-0.25, 0.0, 0.25):
        # Light of the panel point at u pitches leaves with the slope -u P / g.
        eye = Viewpoint("eye", -u * display.pitch_mm / display.gap_mm * distance, 0, distance)
        view = inim.reconstruct(
            capture.eia, display, eye, "thin", pixels_per_lens=4, spp=64, allow_flips=True
        )
        view = view.reshape(display.lens_rows, 4, display.lens_columns, 4, 3).mean(axis=(1, 3, 4))
        light = sample(capture.eia, lattice.centres_px().reshape(-1, 2), lattice,
                       np.array([[u, 0.0]]))[:, 0, 1].reshape(view.shape)  # fmt: skip
        correlations[f"{u:+.2f}"] = float(np.corrcoef(view.ravel(), light.ravel())[0, 1])
        views.append(view)
    pitch_um = lattice.pitch_px.value * 6.45
    return {
        "lattice": lattice_record(lattice),
        "pitch_um": pitch_um,
        "from_data_sheet_um": 300 * 418.6 / 400,
        "correlation_with_sub_aperture": correlations,
        "correlation_left_right": float(np.corrcoef(views[0].ravel(), views[2].ravel())[0, 1]),
    }


def page(results: Results) -> tuple[list[str], list[PagePart]]:
    """The numbers, with agreements and disagreements."""
    raw = results["plenoptic"]
    pitch, half = raw["lattice"]["pitch_px"]
    correlations = ", ".join(f"{v:.4f}" for v in raw["correlation_with_sub_aperture"].values())
    sheet = raw["from_data_sheet_um"]
    remarks = [
        f"Plenoptic camera's raw picture: pitch {pitch:.4f} ± {half:.4f} px. Published: 48.2 and "
        f"48.2273, on two axes. {raw['pitch_um']:.2f} um on the sensor; {sheet:.2f} um by lens "
        "pitch and distances of the data sheet, which differ by "
        f"{100 * (sheet / raw['pitch_um'] - 1):.1f} %.",
        "Correlation of views through `thin` lenses, from -0.25, 0 and 0.25 pitches, with "
        f"sub-aperture pictures: {correlations}. Left and right view: "
        f"{raw['correlation_left_right']:.4f}.",
        "Lens array: pitch in pixels, with 95 % interval; distance of the object from its shift "
        "between elemental images, with the range in which the authors reconstruct; fourth "
        "capture, predicted from the other three with the object's shift and without it.",
        "Light of the same object points 0.4 pitches left and right of a lens's centre is relative "
        f"to the centre; by `thick`: {results['thick_vignetting_0.4_pitch']:.3f}.",
    ]

    def pitches(result: Any) -> str:
        measured = [lattice["pitch_px"] for lattice in result["lattices"].values()]
        lengths = [length for length, _ in measured]
        interval = "{:.3f} ± {:.3f}".format(*measured[0])
        return f"{interval} (4 captures: {min(lengths):.3f} to {max(lengths):.3f})"

    def pair(text: str) -> Callable[[Any], str]:
        return lambda values: text.format(*values)

    columns = {
        "object": entry("name"),
        "pitch": pitches,
        "authors' pitch": entry("authors_px"),
        "scatter, px": entry("lattices", "11", "residual_rms_px", text="{:.2f}".format),
        "distance, mm": entry("depth", "depth_mm", text="{:.1f}".format),
        "quartiles": entry("depth", "depth_quartiles_mm", text=pair("{:.1f} to {:.1f}")),
        "authors' distance": entry("authors_depth_mm", text=pair("{} to {}")),
        "PSNR, dB": entry("prediction", "moved", "psnr_db", text="{:.2f}".format),
        "PSNR without": entry("prediction", "not moved", "psnr_db", text="{:.2f}".format),
        "SSIM": entry("prediction", "moved", "ssim", text="{:.3f}".format),
        "SSIM without": entry("prediction", "not moved", "ssim", text="{:.3f}".format),
        "light, left and right": lambda r: "{:.3f}, {:.3f}".format(*r["vignetting"].values()),
    }
    objects = [results[name] | {"name": name} for name in OBJECTS if name in results]
    tables = [table("Photographs through a lens array", objects, columns)]
    return remarks, [PagePart("array", "Lens array", "", tables)]


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the folders of the data."""
    parser.add_argument("lens_array", type=Path, help="LF-based-Synthetic-Holography")
    parser.add_argument("plenoptic", type=Path, help="plenoptomos")


def cases(args: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """The plenoptic camera, the lens model and all objects."""
    objects = {name: {"folder": args.lens_array, "name": name} for name in OBJECTS}
    return {"plenoptic": {"folder": args.plenoptic}, "thick_vignetting_0.4_pitch": {}, **objects}


def measure(folder: Path | None = None, name: str = "") -> Any:
    """Measure an object, the plenoptic camera, or the lens model."""
    if folder is None:
        return lens_vignetting()
    return lens_array(folder, name) if name else plenoptic(folder)


STUDY = Study(
    "reports.reality.run", "Photographs of elemental images", __doc__, arguments, cases, measure,
    page, code=(*CODE, "inim/apps/own_picture", "inim/apps/pickup"),
)  # fmt: skip

if __name__ == "__main__":
    sys.exit(STUDY.main())
