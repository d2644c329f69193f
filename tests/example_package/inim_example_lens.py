"""A lens model for inim: pinholes with natural vignetting (cos^4)."""

from inim.display.lens import LensModel, PanelRay, lens_centre


def trace(array, traits, ops, x, y, sx, sy, index):
    """Pass rays straight through the lens's centre; cos^2 of the angle is 1 / (1 + sx^2 + sy^2)."""
    centre_x, centre_y, inside = lens_centre(array, traits, ops, x, y)
    light = 1 / (1 + sx * sx + sy * sy) ** 2
    return PanelRay(
        centre_x + array.gap * sx, centre_y + array.gap * sy, sx, sy, ops.where(inside, light, 0.0)
    )


model = LensModel(
    "vignetted", summary="pinholes with natural vignetting", trace=trace, refracts=False,
    stand_in="pinhole",
)  # fmt: skip
