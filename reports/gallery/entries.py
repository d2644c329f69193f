"""Entries of the gallery, and settings of the picture in README: titles, options, colours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

_TWO = ("--algorithms", "template,layered")
_ANGLES = (0.25, 0.5, 1)
_CENTRE = ("--viewpoints", "centre", "--algorithms", "template")


@dataclass(frozen=True)
class Entry:
    """Entry of the gallery."""

    title: str
    text: str
    scene: str
    #: Options of `inim validate` by the run's label; the label is empty if there is one run.
    runs: Mapping[str, Sequence[str]] = field(default_factory=lambda: {"": _TWO})
    lens: tuple[int, int] = (26, 26)  #: Upper left lens of the magnified elemental images.
    view: str = "template"  #: Method whose view from the centre is shown if there are several runs.
    shows_scene: bool = False  #: If there are several runs, show the scene before their views.


ENTRIES = {
    "amphora": Entry(
        "Painted amphora",
        "A round body with fine painted figures. `template` reads one RGB-D picture; `layered` "
        "also reads the surfaces behind the front one, such as the far side of the handles.",
        "scenes/amphora.xml",
        lens=(18, 21),
    ),
    "wine_coin": Entry(
        "Goblet and coin",
        "Two objects at two depths. From the side, the eye sees parts of the goblet that the coin "
        "hides from the centre. A single RGB-D picture does not contain them.",
        "scenes/wine_coin.xml",
        lens=(30, 34),
    ),
    "tripod": Entry(
        "Bronze tripod",
        "Thin legs and handles in front of black, and a band in low relief.",
        "scenes/tripod.xml",
        lens=(26, 14),
    ),
    "jade": Entry(
        "Jade disc",
        "Dragons and grains in relief of less than a millimetre. The display keeps the dragons and "
        "blurs the grains, which are about as large as a lens.",
        "scenes/jade.xml",
        lens=(14, 18),
    ),
    "ibex": Entry(
        "Bronze ibex",
        "Thin legs, horns and a ring in front of gaps. The surfaces behind them become visible as "
        "soon as the eye moves.",
        "scenes/ibex.xml",
        lens=(32, 10),
    ),
    "altar": Entry(
        "Altar group",
        "Five separate figures at different depths, next to and in front of each other.",
        "scenes/altar.xml",
        lens=(18, 32),
    ),
    "phone": Entry(
        "The tripod on a phone",
        "A panel of 2400 × 1080 pixels with 15.7 pixels per lens, which is not a whole number. "
        "The pictures show the middle of the display.",
        "scenes/tripod.xml",
        {"": ("--display", "phone", *_TWO)},
        lens=(70, 16),
    ),
    "amphora_virtual": Entry(
        "Virtual mode",
        "The panel is nearer to the lenses than their focal length (2.7 mm instead of 3 mm). The "
        "image appears behind the array.",
        "scenes/amphora_virtual.xml",
        lens=(18, 21),
    ),
    "amphora_focused": Entry(
        "Focused mode",
        "The panel is at the focal length. An eye sees one panel pixel through each lens, so the "
        "image has as many pixels as the display has lenses.",
        "scenes/amphora_focused.xml",
        lens=(18, 21),
    ),
    "lens_models": Entry(
        "Lens models",
        "The reference view through four models of the lens array. `pinhole` shows one point of "
        "the panel through each lens. `thin` is a paraxial lens with an aperture. `thick` refracts "
        "exactly at both faces. `full` traces a mesh of the array and is the check of `thick`.",
        "scenes/amphora.xml",
        {m: ("--lens-model", m, *_CENTRE) for m in ("pinhole", "thin", "thick", "full")},
        view="reference",
    ),
    "rotation": Entry(
        "Rotated lens array",
        "The array is rotated relative to the panel. If the algorithms do not use the angle "
        "(`inim.misalign`), the image rotates by about ten times the angle and breaks up where "
        "lenses show their neighbours' elemental images. If they use it (`-D inim.rotation_deg`), "
        "no quality is lost.",
        "scenes/amphora.xml",
        {
            **{
                f"{a}°, not used": ("-D", f"inim.misalign=rotation_deg={a}", *_CENTRE)
                for a in _ANGLES
            },
            "0°": _CENTRE,
            **{f"{a}°, used": ("-D", f"inim.rotation_deg={a}", *_CENTRE) for a in _ANGLES},
        },
        shows_scene=True,
    ),
    "gap": Entry(
        "Panel too far from the lenses",
        "The gap is 0.1 or 0.3 mm wider than the designed 3.3 mm. The algorithm assumes the "
        "design. The lenses focus on another plane, so even the reference, which is ray traced "
        "for the actual gap, scores lower.",
        "scenes/amphora.xml",
        {
            "3.3 mm": _CENTRE,
            "3.4 mm": ("-D", "inim.misalign=gap_mm=0.1", *_CENTRE),
            "3.6 mm": ("-D", "inim.misalign=gap_mm=0.3", *_CENTRE),
        },
        shows_scene=True,
    ),
    "zone": Entry(
        "An eye leaves the viewing zone",
        "Outside the zone, the eye sees the neighbour's elemental image through a lens: the image "
        "flips, lens by lens, until the eye is in the next zone and sees the whole image again. "
        "This film is taken from the report's virtual display of the ground-truth EIA, with thin "
        "lenses.",
        "scenes/wine_coin.xml",
    ),
    "museum_room": Entry(
        "In a museum room",
        "A display is a light source that works in any Mitsuba scene. The amphora stands on its "
        "plinth, and a phone in front of it displays the EIA that the command below generated. The "
        "room is `scenes/museum_room/room.xml`; see [](how-to/mitsuba-scenes.md).",
        "scenes/amphora.xml",
        {
            "": (
                *("--display", "phone", "-D", "inim.lens_columns=68", "-D", "inim.lens_rows=152"),
                *("-D", "inim.panel_columns=1080", "-D", "inim.panel_rows=2400"),
                *("-D", "inim.fit_share=0.9", "--algorithms", "layered", "--viewpoints", "centre"),
            )
        },
    ),
}

#: Arguments for rendering `scenes/museum_room/room.xml`.
ROOM = {"scene": "scenes/museum_room/room.xml", "eia": "eia/layered.png", "spp": "256"}


@dataclass(frozen=True)
class _Eye:
    """Path of the moving eye, and style of the film."""

    scene: str = "scenes/wine_coin.xml"
    algorithm: str = "layered"
    options: tuple[str, ...] = (
        *("--display", "fine", "--algorithms", "layered"),
        *("-D", "inim.view_pixels_per_lens=4"),
        *("-D", "inim.view_spp=64"),
        *("-D", "inim.fit_share=0.78"),
    )
    distance_mm: float = 542.7
    across_mm: float = 54
    up_mm: float = 22
    frames: int = 32
    frame_ms: int = 100
    lens: tuple[int, int] = (39, 46)
    captions: tuple[str, ...] = (
        "the scene", "the panel, magnified", "the panel through its lenses",
    )  # fmt: skip
    quality: int = 80
    # The eye's farthest position in half widths of the zone: the middle of the next zone is at 4.
    # The line below the picture reaches from `line[0]` to `line[1]`.
    farthest: float = 4
    line: tuple[float, float] = (-2, 6)
    zones: tuple[tuple[float, float], ...] = ((-1, 1), (3, 5))
    zone_frames: int = 48
    zone_ms: int = 125
    zone_px: int = 320
    zone_caption: str = "white: viewing zones"
    # Style.
    space: int = 16
    below: int = 64
    text: int = 18
    ground: str = "#101012"
    ink: str = "#e6e6e6"
    rail: str = "#77777c"
    eye: str = "#f0b44c"
    # The report.
    report_scene: str = "scenes/amphora.xml"
    report_options: tuple[str, ...] = ("--display", "fine")  # the tutorial's command
    report_window: Mapping[str, Any] = field(
        default_factory=lambda: {"width": 1280, "height": 926, "deviceScaleFactor": 1.25}
    )


EYE = _Eye()
