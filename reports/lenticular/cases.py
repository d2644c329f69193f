"""Random lenticular displays, cameras and positions for simulated photographs.

The number of a case determines it. The calibration reads only the photographs and the preset of
the model. Displays vary about the published files of their model: pitch, slope, centre and view
cone. Lenses differ from the preset's in index, thickness, focal length and glass over the panel,
which no file states. Cameras have distortion, a mosaic, noise, falloff, sharpening and JPEG. Half
of them are held by hand: they shake between photographs, which a rolling shutter skews.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from inim.display import DISPLAYS, Display
from inim.display.looking_glass import TYPICAL
from reports.calibration.cases import Case, Motion, Sensor
from reports.calibration.landing import Assembly, Camera, Pose, look_at, off_axis

# The priors and limits of the fit were chosen with other seeds.
_SEED = 90417
#: Models, with columns and rows of the camera's sensor: 3 to 4 pixels per lens.
MODELS = {
    "looking-glass-portrait-typical": (1050, 1400),
    "looking-glass-8.9-typical": (1480, 1110),
    "looking-glass-15.6-typical": (2400, 1800),
}
# Share of the photograph that the panel fills from straight on.
_FILLED = 0.85
# Distance relative to the first position, range of the angle to the axis, azimuths, degrees.
_POSITIONS = (
    (1.0, (0.0, 4.0), 0.0),
    (1.1, (9.0, 16.0), 0.0),
    (1.1, (9.0, 16.0), 180.0),
)


# Skew of photographs by hand, pixels per row.
_SKEW = 4e-4


def draw_case(number: int, seed: int = _SEED) -> Case:
    """Draw the case with this number; the models take turns."""
    random = np.random.default_rng([seed, number])
    name = [*MODELS][number % len(MODELS)]
    design = DISPLAYS[name]
    display = _hidden(random, name)
    columns, rows = MODELS[name]
    camera = Camera(
        columns,
        rows,
        columns * random.uniform(1.0, 1.5) * max(1.0, rows / columns),
        columns * (0.5 + random.uniform(-0.01, 0.01)),
        rows * (0.5 + random.uniform(-0.01, 0.01)),
        random.uniform(-0.1, 0.1),
        random.uniform(-0.1, 0.1),
        random.uniform(1.5, 3.5),
        random.uniform(-0.001, 0.001),
        random.uniform(-0.001, 0.001),
    )
    glass = random.uniform(0.0, 0.2) * (random.random() < 0.5)
    # On a support, or held by hand, whose motion a rolling shutter shows as a skew.
    is_steady = bool(random.random() < 0.5)
    shake, skews = random.uniform(0.0, 0.5), random.normal(0.0, _SKEW, len(_POSITIONS))
    by_hand = tuple(Motion(shake_px=shake, skew=skew) for skew in skews.tolist())
    breathing = 1 + random.uniform(-0.003, 0.003, len(_POSITIONS))
    return Case(
        number,
        design,
        display,
        camera,
        tuple(_poses(random, design, camera)),
        _sensor(random),
        Assembly(glass, random.uniform(1.49, 1.53)),
        zooms=tuple(breathing.tolist()),
        motions=(Motion(),) * len(_POSITIONS) if is_steady else by_hand,
        is_steady=is_steady,
    )


def _hidden(random: np.random.Generator, name: str) -> Display:
    """Draw a display of a model: its file, and lenses that the file does not describe."""
    typical = TYPICAL[name]
    file = replace(
        typical,
        pitch=typical.pitch * (1 + random.uniform(-0.015, 0.015)),
        slope=typical.slope * (1 + random.uniform(-0.05, 0.05)),
        center=random.uniform(0.0, 1.0),
        view_cone=typical.view_cone + random.uniform(-4.0, 4.0),
    )
    display = file.display(name=f"{name}, hidden")
    return display.replace(
        refractive_index=random.uniform(1.46, 1.53),
        lens_thickness_mm=display.pitch_mm * random.uniform(0.85, 1.1),
        focal_length_mm=display.gap_mm * random.uniform(0.97, 1.03),
    )


def _poses(random: np.random.Generator, design: Display, camera: Camera) -> list[Pose]:
    width, height = design.width_mm, design.height_mm
    mm_per_pixel = max(width / camera.columns, height / camera.rows)
    first_distance_mm = camera.focal_length_px * mm_per_pixel / _FILLED
    poses = []
    for distance, angles, azimuth_deg in _POSITIONS:
        distance_mm = distance * first_distance_mm * random.uniform(0.97, 1.03)
        angle = math.radians(random.uniform(*angles))
        azimuth = math.radians(azimuth_deg + random.uniform(-20, 20))
        target = np.array([*random.uniform(-3, 3, 2), 0.0])
        focus = random.uniform(0.985, 1.015)
        roll = random.uniform(-4, 4)
        eye = target + distance_mm * off_axis(angle, azimuth)
        poses.append(look_at(eye, target, roll, focus))
    return poses


def _sensor(random: np.random.Generator) -> Sensor:
    leaks = random.uniform(0, 0.06, (3, 3))
    np.fill_diagonal(leaks, 0)
    np.fill_diagonal(leaks, 1 - leaks.sum(axis=1))
    return Sensor(
        panel_gamma=random.uniform(2.1, 2.4),
        panel_black=random.uniform(0.001, 0.004),
        pixel_fill=random.uniform(0.7, 0.95),
        blur_px=random.uniform(0.4, 1.2),
        full_well=random.uniform(4000, 15000),
        read_noise=random.uniform(0.001, 0.004),
        exposure=random.uniform(0.65, 0.85),
        tint=(1.0, random.uniform(0.92, 1.0), random.uniform(0.85, 1.0)),
        subpixels="rgb",
        crosstalk=tuple(map(tuple, leaks.tolist())),
        has_mosaic=True,
        sharpening=float(random.uniform(0.3, 1.0) * (random.random() < 0.4)),
        quality=int(random.integers(80, 96)),
    )
