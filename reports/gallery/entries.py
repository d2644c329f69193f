"""What the gallery shows, and how README's pictures are taken: titles, settings, colours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

_TWO = ("--algorithms", "template,layered")
_ANGLES = (0.25, 0.5, 1)
_CENTRE = ("--viewpoints", "centre", "--algorithms", "template")


@dataclass(frozen=True)
class Entry:
    """An entry.

    Attributes
    ----------
    title, text : str
    scene : str
    runs : mapping
        Label of each run, empty where there is one, to options of `inim validate`.
    lens : (column, row)
        From which on elemental images are shown.
    view : str
        Whose view from the centre is shown, where there are several runs.
    shows_scene : bool
        Before these.
    """

    title: str
    text: str
    scene: str
    runs: Mapping[str, Sequence[str]] = field(default_factory=lambda: {"": _TWO})
    lens: tuple[int, int] = (26, 26)
    view: str = "template"
    shows_scene: bool = False


ENTRIES = {
    "amphora": Entry(
        "Painted amphora",
        "A round body with fine figures. `template` gives each panel pixel the colour of one "
        "picture pixel, and the figures' edges fray; `layered` gives it a mean of what it sees.",
        "scenes/amphora.xml",
        lens=(18, 21),
    ),
    "wine_coin": Entry(
        "Goblet and coin",
        "Two things at two depths: what the coin hides from the centre is seen from the side, and "
        "one colour and depth picture does not have it.",
        "scenes/wine_coin.xml",
        lens=(30, 34),
    ),
    "tripod": Entry(
        "Bronze tripod",
        "Thin legs and handles before black, and a band in low relief.",
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
        "Thin legs, horns and a ring that hang over gaps: what lies behind them is seen as soon as "
        "the eye moves.",
        "scenes/ibex.xml",
        lens=(32, 10),
    ),
    "altar": Entry(
        "Altar group",
        "Five bodies at different depths, before and beside each other and none touching the next.",
        "scenes/altar.xml",
        lens=(18, 32),
    ),
    "phone": Entry(
        "The tripod on a phone",
        "A panel of 2400 × 1080 pixels with 15.7 pixels per lens: lenses and pixels do not "
        "divide evenly. The pictures show the middle of the display.",
        "scenes/tripod.xml",
        {"": ("--display", "phone", *_TWO)},
        lens=(70, 16),
    ),
    "amphora_virtual": Entry(
        "Virtual mode",
        "The panel is nearer to the lenses than their focal length (2.7 mm of 3 mm), and the "
        "picture stands behind the array.",
        "scenes/amphora_virtual.xml",
        lens=(18, 21),
    ),
    "amphora_focused": Entry(
        "Focused mode",
        "The panel is at the focal length: each lens shows one panel pixel at a time, and the "
        "picture has as many pixels as the display has lenses.",
        "scenes/amphora_focused.xml",
        lens=(18, 21),
    ),
    "lens_models": Entry(
        "Lens models",
        "The reference through four models of the lens array. Through `pinhole` each lens shows an "
        "eye one point of the panel; `thin` is a paraxial lens with its aperture; `thick` is "
        "refracted exactly at both faces; `full` traces a mesh of the array, to check `thick`.",
        "scenes/amphora.xml",
        {m: ("--lens-model", m, *_CENTRE) for m in ("pinhole", "thin", "thick", "full")},
        view="reference",
    ),
    "rotation": Entry(
        "Array turned on its panel",
        "The array is rotated on its panel. If the algorithms do not use the angle "
        "(`inim.misalign`), the image is rotated about ten times as much and breaks up where "
        "lenses show their neighbours' elemental images. If they use it (`-D inim.rotation_deg`), "
        "nothing is lost.",
        "scenes/amphora.xml",
        {
            **{
                f"{angle}°, not known": ("-D", f"inim.misalign=rotation_deg={angle}", *_CENTRE)
                for angle in _ANGLES
            },
            "0°": _CENTRE,
            **{
                f"{angle}°, known": ("-D", f"inim.rotation_deg={angle}", *_CENTRE)
                for angle in _ANGLES
            },
        },
        shows_scene=True,
    ),
    "gap": Entry(
        "Panel too far from the lenses",
        "The gap is 0.1 or 0.3 mm wider than the 3.3 mm of the design, and the algorithm does not "
        "know. Lenses focus elsewhere, so that even the reference, which is made for the gap as it "
        "is, loses.",
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
        "Beyond the zone a lens shows the eye its neighbour's elemental image: the picture flips, "
        "lens after lens, until the eye is in the next zone and sees the picture again. "
        "`inim film` keeps the eye in the zone; this is the report's virtual display of the true "
        "EIA, with thin lenses.",
        "scenes/wine_coin.xml",
        {"": _TWO},
    ),
    "museum_room": Entry(
        "In a room of a museum",
        "A display is a light source in any scene of Mitsuba's: the amphora on its plinth, and on "
        "a phone before it, whose EIA the command below made. The room is "
        "`scenes/museum_room/room.xml`; [how such scenes are made](how-to/mitsuba-scenes.md).",
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

#: The room's picture, beside what `scenes/museum_room/room.xml` says.
ROOM = {"scene": "scenes/museum_room/room.xml", "eia": "eia/layered.png", "spp": "256"}


@dataclass(frozen=True)
class _Eye:
    """How an eye is moved, and how its film looks."""

    scene: str = "scenes/wine_coin.xml"
    algorithm: str = "layered"
    options: tuple[str, ...] = (
        *("--algorithms", "layered"),
        *("-D", "inim.view_pixels_per_lens=6"),
        *("-D", "inim.view_spp=64"),
        *("-D", "inim.fit_share=0.78"),
    )
    distance_mm: float = 1000
    across_mm: float = 100
    up_mm: float = 40
    frames: int = 32
    frame_ms: int = 100
    lens: tuple[int, int] = (28, 33)
    words: tuple[str, str, str] = (
        "the scene",
        "the panel, magnified",
        "the panel through its lenses",
    )
    quality: int = 80
    # The eye's way out of the zone in its half widths: to the middle of the next zone, at 4. The
    # line below the picture reaches from `line[0]` to `line[1]`.
    zone_way: float = 4
    line: tuple[float, float] = (-2, 6)
    zones: tuple[tuple[float, float], ...] = ((-1, 1), (3, 5))
    zone_frames: int = 48
    zone_ms: int = 125
    zone_px: int = 320
    zone_words: str = "white: viewing zones"
    # The look.
    space: int = 16
    below: int = 64
    text: int = 18
    ground: str = "#101012"
    ink: str = "#e6e6e6"
    rail: str = "#77777c"
    eye: str = "#f0b44c"
    # The report.
    report_scene: str = "scenes/amphora.xml"
    report_options: tuple[str, ...] = (
        *("--algorithms", "wang2024,template,layered"),
        "--no-skip",  # else the times are of the first run, which compiled
    )
    report_window: Mapping[str, Any] = field(
        default_factory=lambda: {"width": 1280, "height": 926, "deviceScaleFactor": 1.25}
    )


EYE = _Eye()
