"""A request: what a user asks for, as values. Text is parsed by the command line, next to it."""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from inim.display import Display
from inim.display.misalignment import misalignment_text
from inim.display.viewpoint import Viewpoint, viewpoints_text
from inim.errors import UsageError
from inim.settings import DISPLAY_KEYS, NOT_SET, PREFIX, Settings, value_text

#: Settings of a preview, unless the request has its own: one algorithm from one place, by few
#: samples, and judged by nothing.
PREVIEW = {
    "inim.algorithms": "template",
    "inim.viewpoints": "centre",
    "inim.capture_spp": "8",
    "inim.eia_spp": "8",
    "inim.view_spp": "16",
    "inim.reconstruction_spp": "16",
    "inim.score_error": "0",
    "inim.min_ssim_to_reference": "",
}


def option_words(options: Mapping[str, Any]) -> list[str]:
    """Words of a command line, for its record: options with their values.

    Parameters
    ----------
    options : mapping
        By option (``--display``), a value; a list, of which each item repeats the option; or True
        for a switch. An option without a value (None, False, empty list) is left out.
    """
    words: list[str] = []
    for option, value in options.items():
        if value is True:
            words.append(option)
        elif isinstance(value, list | tuple):
            words += [word for item in value for word in (option, str(item))]
        elif value is not None and value is not False:
            words += [option, str(value)]
    return words


@dataclass(frozen=True, kw_only=True)
class Choices:
    """Choices of a user for a display, its viewer and its EIAs; None: as the scene states.

    Attributes
    ----------
    definitions : dict of str to str
        Single settings and scene parameters.
    display : Display, str or Path, optional
        A display, a preset's name, or a file with `inim.*` settings; see
        `inim.scene.file.choose_display`.
    algorithms : tuple of str, optional
        Names with options; see `inim.generators.algorithm_items`.
    viewpoints : tuple of str or Viewpoint, optional
        See `inim.display.viewpoint.viewpoint_items`.
    lens_model : str, optional
    misalign : dict of str to float, optional
        See `inim.display.misalignment.parse_misalignment`.
    """

    definitions: Mapping[str, str] = field(default_factory=dict)
    display: Display | str | Path | None = None
    algorithms: tuple[str, ...] | None = None
    viewpoints: tuple[str | Viewpoint, ...] | None = None
    lens_model: str | None = None
    misalign: Mapping[str, float] | None = None

    def overrides(self) -> dict[str, Any]:
        """Settings that these choices replace, besides the display's, by field of `Settings`."""
        chosen: dict[str, Any] = {}
        if self.algorithms is not None:
            chosen["algorithms"] = ",".join(self.algorithms)
        if self.viewpoints is not None:
            chosen["viewpoints"] = viewpoints_text(self.viewpoints)
        if self.lens_model is not None:
            chosen["lens_model"] = self.lens_model
        if self.misalign is not None:
            chosen["misalign"] = misalignment_text(self.misalign)
        return chosen | self._pupil()

    def _pupil(self) -> dict[str, float | None]:
        """Pupil and focus of all eyes, if some are values."""
        eyes = [eye for eye in self.viewpoints or () if isinstance(eye, Viewpoint)]
        if len({(eye.pupil_mm, eye.focus_mm) for eye in eyes}) > 1:
            raise UsageError("viewpoints: have different pupils or focus; a run has one for all")
        for key in (f"{PREFIX}pupil_mm", f"{PREFIX}focus_mm"):
            if eyes and key in self.definitions:
                raise UsageError(f"viewpoints: a Viewpoint has its own; take {key} out")
        return {"pupil_mm": eyes[0].pupil_mm, "focus_mm": eyes[0].focus_mm} if eyes else {}

    def options(self, settings: Settings, stated: Container[str] = ()) -> dict[str, Any]:
        """Options of the command line that make these choices, for the record.

        Parameters
        ----------
        settings : Settings
            Settings of the run.
        stated : container of str
            Keys of the settings that the scene states.
        """
        options = {f"--{name.replace('_', '-')}": v for name, v in self.overrides().items()}
        for name in self._pupil():
            del options[f"--{name.replace('_', '-')}"]
        own = isinstance(self.display, Display)
        return {
            "-D": definition_words(self.recorded_definitions(settings, stated)),
            "--display": settings.display if own else self.display,
            **options,
        }

    def recorded_definitions(
        self, settings: Settings, stated: Container[str] = ()
    ) -> dict[str, str]:
        """Definitions with the values that have no option: a `Display`, an eye's pupil."""
        keys = [*self._pupil(), *(DISPLAY_KEYS if isinstance(self.display, Display) else ())]
        values = {key: getattr(settings, key) for key in keys}
        return {**self.definitions} | {
            f"{PREFIX}{key}": NOT_SET if value is None else value_text(key, value)
            for key, value in values.items()
            if value != getattr(Settings(), key) or f"{PREFIX}{key}" in stated
        }


def definition_words(definitions: Mapping[str, str]) -> list[str]:
    """Definitions as after -D."""
    return [f"{key}={text}" for key, text in definitions.items()]


@dataclass(frozen=True)
class Request(Choices):
    """A validation of a scene.

    Attributes
    ----------
    scene, out : Path
    eias : dict of str to Path
        Finished EIAs to score next to the algorithms, by name.
    backend : {"auto", "llvm", "cuda"}
    baseline : Path, optional
        Folder of the baseline to compare with.
    preview : bool
        A first look: `PREVIEW` in place of the scene's settings.
    time : bool
        Time the generators, too.
    lazy : bool
        Make and render only the panel pixels that the viewpoints observe.
    no_skip : bool
        Do everything, also what changes no result; use no store.
    allow_folders : tuple of Path
        Folders besides the scene's own where files that it names may lie.
    """

    scene: Path
    out: Path
    eias: Mapping[str, Path] = field(default_factory=dict)
    backend: str = "auto"
    baseline: Path | None = None
    preview: bool = False
    time: bool = False
    lazy: bool = False
    no_skip: bool = False
    allow_folders: tuple[Path, ...] = ()

    def command(self, settings: Settings, stated: Container[str] = ()) -> list[str]:
        """The command line that repeats this request, after `python -m inim.validate`.

        Parameters are those of `Choices.options`.
        """
        flags = ("preview", "time", "lazy", "no_skip")
        return [
            str(self.scene),
            *option_words(
                {
                    "-o": self.out,
                    **self.options(settings, stated),
                    "--allow-folder": self.allow_folders,
                    "--eia": [f"{name}={path}" for name, path in self.eias.items()],
                    "--backend": None if self.backend == "auto" else self.backend,
                    "--baseline": self.baseline,
                    **{f"--{flag.replace('_', '-')}": getattr(self, flag) for flag in flags},
                }
            ),
        ]
