"""Everything `inim inspect` has to say about a display, as one value."""

from __future__ import annotations

from dataclasses import dataclass

from inim.display import Display
from inim.display.pixel_rays import least_gap_mm
from inim.errors import DisplayError
from inim.inspect.crosstalk import (
    CrosstalkMap,
    LightShares,
    array_samples,
    crosstalk_map,
    light_shares,
)
from inim.inspect.geometry import PixelChoice, ViewingZone, pixel_choice, viewing_zone
from inim.inspect.spots import Spot, spots
from inim.inspect.voxel import VoxelCurve, voxel_curve
from inim.lens import check_lens_model
from inim.lens import lens_model as find_lens_model
from inim.settings import Settings

__all__ = ["DEFAULT_LENS_MODEL", "PIXEL_STEPS", "Findings", "inspect_display", "usable_model"]

#: Tried first where no model is asked for.
DEFAULT_LENS_MODEL = Settings.lens_model
#: Pixels per lens to compare: half as many, these, twice as many.
PIXEL_STEPS = (0.5, 1.0, 2.0)


@dataclass(frozen=True)
class Findings:
    """What a display can do.

    Attributes
    ----------
    source : str
        The scene file or preset asked for.
    design, mounted : Display
        As designed, and with its array as it really lies; mostly the same.
    lens_model : str
    model_reason : str or None
        Why this model and not `DEFAULT_LENS_MODEL`.
    choices : tuple of PixelChoice
        For `PIXEL_STEPS`.
    zone : ViewingZone
    voxels : VoxelCurve
    spots : tuple of Spot
        Field angle by field angle, colour by colour.
    light : dict of str to LightShares
        At each default eye position, by name; the one on the axis is ``"centre"``.
    crosstalk : CrosstalkMap
    """

    source: str
    design: Display
    mounted: Display
    lens_model: str
    model_reason: str | None
    choices: tuple[PixelChoice, ...]
    zone: ViewingZone
    voxels: VoxelCurve
    spots: tuple[Spot, ...]
    light: dict[str, LightShares]
    crosstalk: CrosstalkMap


def usable_model(asked: str | None, display: Display) -> tuple[str, str | None]:
    """The lens model to use, and why it is not `DEFAULT_LENS_MODEL` where nobody chose another.

    Raises
    ------
    InimError
        A model that was asked for and does not exist or cannot be made.
    """
    if asked is not None:
        check_lens_model(asked, display)
        return asked, None
    try:
        check_lens_model(DEFAULT_LENS_MODEL, display)
    except DisplayError as error:
        return find_lens_model(DEFAULT_LENS_MODEL).stand_in, str(error)
    return DEFAULT_LENS_MODEL, None


def inspect_display(
    design: Display,
    distance_mm: float,
    *,
    mounted: Display | None = None,
    lens_model: str | None = None,
    source: str = "",
) -> Findings:
    """Work out what a display can do, looked at from a distance.

    Parameters
    ----------
    design : Display
    distance_mm : float
        Viewing distance.
    mounted : Display, optional
        With its array as it really lies, if that is not as designed.
    lens_model : str, optional
        `DEFAULT_LENS_MODEL` unless given, or its stand-in where such lenses cannot be ground.
    source : str
        What the display was read from.

    Raises
    ------
    InimError
        A lens model that cannot be, or a panel tilted so far that it meets the array.
    """
    real = design if mounted is None else mounted
    least_gap_mm(real)
    model, reason = usable_model(lens_model, real)
    zone = viewing_zone(design, distance_mm)
    samples = array_samples(real)
    return Findings(
        source=source,
        design=design,
        mounted=real,
        lens_model=model,
        model_reason=reason,
        choices=tuple(pixel_choice(design, times) for times in PIXEL_STEPS),
        zone=zone,
        voxels=voxel_curve(design),
        spots=spots(real, model, design.central_depth_mm),
        light={
            eye.name: light_shares(design, real, model, eye.position_mm, samples)
            for eye in zone.viewpoints
        },
        crosstalk=crosstalk_map(design, real, model, distance_mm),
    )
