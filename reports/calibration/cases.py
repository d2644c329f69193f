"""Random displays, cameras and positions for simulated photographs; the fit does not use them.

The number of a case determines it. Even numbers are nominal displays, odd numbers are phones.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from inim.display import DISPLAYS, Display
from reports.calibration.landing import Camera, Pose, look_at

_SEED = 19
# Columns, rows and focal length in pixels. The lens sheet fills the sensor from about 20 cm
# (nominal) and 35 cm (phone).
_SENSORS = {"nominal": (1600, 1200, 3400.0), "phone": (2400, 1350, 5000.0)}
# Share of the photograph that the sheet fills from the first position.
_FILLED = 0.86
# Distance relative to the first position; range of the angle to the display's axis, degrees;
# mean azimuths, degrees (None: any).
_POSITIONS = (
    (1.0, (0.0, 4.0), None),
    (1.55, (0.0, 4.0), None),
    (1.15, (15.0, 25.0), (0.0, 180.0)),
    (1.15, (15.0, 25.0), (90.0, 270.0)),
)


@dataclass(frozen=True)
class Sensor:
    """Radiometry of panel and camera.

    Attributes
    ----------
    panel_gamma, panel_black, pixel_fill : float
        Light of a code c is ``black + (1 - black) c^gamma``; lit width of a panel pixel, in pixels.
    blur_px : float
        Sigma of the Gaussian blur of demosaicking and optics.
    full_well, read_noise : float
        Electrons of the brightest code; read noise as a share of that code.
    exposure : float
        Light of the brightest hundredth of the white photograph.
    tint : (float, float, float)
        Colour of the panel's white: red, green, blue.
    """

    panel_gamma: float
    panel_black: float
    pixel_fill: float
    blur_px: float
    full_well: float
    read_noise: float
    exposure: float
    tint: tuple[float, float, float]


@dataclass(frozen=True)
class Case:
    """A misaligned display with the camera and the positions that photograph it.

    Attributes
    ----------
    number : int
    design : Display
        The nominal display, input to the calibration.
    display : Display
        The misaligned display, hidden from the calibration.
    camera : Camera
    poses : tuple of Pose
    sensor : Sensor
    """

    number: int
    design: Display
    display: Display
    camera: Camera
    poses: tuple[Pose, ...]
    sensor: Sensor


def draw_case(number: int) -> Case:
    """Draw the case with this number."""
    random = np.random.default_rng([_SEED, number])
    design = DISPLAYS["phone" if number % 2 else "nominal"]
    camera = _camera(random, design)
    return Case(
        number,
        design,
        _misaligned(random, design),
        camera,
        tuple(_poses(random, design, camera)),
        _sensor(random),
    )


def _misaligned(random: np.random.Generator, design: Display) -> Display:
    """Draw rotation to 2 degrees, pitch to 1 %, gap to 10 %, any shift, tilt to 0.5 degrees."""

    def deviation(limit: float) -> float:
        return float(random.uniform(-limit, limit))

    return design.with_fixed_panel().replace(
        name=f"{design.name}, hidden",
        pitch_mm=design.pitch_mm * (1 + deviation(0.01)),
        rotation_deg=deviation(2.0),
        gap_mm=design.gap_mm * (1 + deviation(0.1)),
        shift_x_mm=deviation(design.pitch_mm / 2),
        shift_y_mm=deviation(design.pitch_mm / 2),
        tilt_x_deg=deviation(0.5),
        tilt_y_deg=deviation(0.5),
    )


def _camera(random: np.random.Generator, design: Display) -> Camera:
    columns, rows, focal_length = _SENSORS[design.name]
    return Camera(
        columns,
        rows,
        focal_length * random.uniform(0.9, 1.1),
        columns * (0.5 + random.uniform(-0.01, 0.01)),
        rows * (0.5 + random.uniform(-0.01, 0.01)),
        random.uniform(-0.05, 0.05),
        random.uniform(-0.05, 0.05),
        random.uniform(1.5, 3.5),
    )


def _poses(random: np.random.Generator, design: Display, camera: Camera) -> list[Pose]:
    mm_per_pixel = max(design.width_mm / camera.columns, design.height_mm / camera.rows)
    first_distance_mm = camera.focal_length_px * mm_per_pixel / _FILLED
    poses = []
    for distance, angles, mean_azimuths in _POSITIONS:
        distance_mm = distance * first_distance_mm * random.uniform(0.97, 1.03)
        angle = math.radians(random.uniform(*angles))
        azimuth_deg = random.uniform(0, 360)
        if mean_azimuths is not None:
            azimuth_deg = random.choice(mean_azimuths) + random.uniform(-15, 15)
        azimuth = math.radians(azimuth_deg)
        target = np.array([*random.uniform(-2, 2, 2), 0.0])
        sine = math.sin(angle)
        direction = np.array([sine * math.cos(azimuth), sine * math.sin(azimuth), math.cos(angle)])
        poses.append(
            look_at(
                target + distance_mm * direction,
                target,
                random.uniform(-5, 5),
                random.uniform(0.985, 1.015),
            )
        )
    return poses


def _sensor(random: np.random.Generator) -> Sensor:
    return Sensor(
        panel_gamma=random.uniform(2.1, 2.4),
        panel_black=random.uniform(0.001, 0.004),
        pixel_fill=random.uniform(0.85, 1.0),
        blur_px=random.uniform(0.4, 0.8),
        full_well=random.uniform(4000, 15000),
        read_noise=random.uniform(0.001, 0.004),
        exposure=random.uniform(0.65, 0.85),
        tint=(1.0, random.uniform(0.92, 1.0), random.uniform(0.85, 1.0)),
    )
