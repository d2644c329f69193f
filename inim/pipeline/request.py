"""Requests of a user, as values; `inim.pipeline.options` parses their text."""

from collections.abc import Container, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from inim.display import Display
from inim.display.misalignment import misalignment_text
from inim.display.settings import DISPLAY_KEYS, PREFIX, SETTINGS, Settings, definition_texts
from inim.display.viewpoint import Viewpoint, viewpoints_text
from inim.render.scene_files.file import parse_definitions
from inim.system.errors import UsageError
from inim.system.process.user_paths import user_text

#: Default settings of a preview: one algorithm, one viewpoint, few samples and no criteria.
PREVIEW: dict[str, Any] = {
    "inim.algorithms": "template",
    "inim.viewpoints": "centre",
    "inim.capture_spp": 32,
    "inim.eia_spp": 8,
    "inim.view_spp": 16,
    "inim.score_error": 0.0,
    "inim.min_ssim_to_reference": "",
}


def option_words(options: Mapping[str, Any]) -> list[str]:
    """Format options and their values as arguments of a command line.

    A list repeats its option, True is a switch, and options without a value (None, False, empty
    list) are omitted.
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
    """A user's choices of display, viewpoints and algorithms; None: as in the scene.

    `definitions` are settings and scene parameters, as texts or values; they become values.
    `display` is a display, a preset's name, or a file with `inim.*` settings. See
    `inim.render.scene_files.file.choose_display`, `inim.generators.algorithm_items`,
    `inim.display.viewpoint.viewpoint_items` and `inim.display.misalignment.parse_misalignment`.
    """

    definitions: Mapping[str, Any] = field(default_factory=dict)
    display: Display | str | Path | None = None
    algorithms: tuple[str, ...] | None = None
    cameras: str | None = None
    viewpoints: tuple[str | Viewpoint, ...] | None = None
    lens_model: str | None = None
    misalign: Mapping[str, float] | None = None

    def __post_init__(self) -> None:
        source = str(getattr(self, "scene", "definitions"))
        object.__setattr__(self, "definitions", parse_definitions(self.definitions, source))

    def overrides(self) -> dict[str, Any]:
        """Settings to replace, except the display's, by field of `Settings`."""
        settings: dict[str, Any] = {}
        if self.algorithms is not None:
            settings["algorithms"] = ",".join(self.algorithms)
        if self.cameras is not None:
            settings["cameras"] = self.cameras
        if self.viewpoints is not None:
            settings["viewpoints"] = viewpoints_text(self.viewpoints)
        if self.lens_model is not None:
            settings["lens_model"] = self.lens_model
        if self.misalign is not None:
            settings["misalign"] = misalignment_text(self.misalign)
        return settings | self._pupil()

    def _pupil(self) -> dict[str, float | None]:
        """Pupil and focus of the `Viewpoint` objects, if there are any."""
        eyes = [eye for eye in self.viewpoints or () if isinstance(eye, Viewpoint)]
        if len({(eye.pupil_mm, eye.focus_mm) for eye in eyes}) > 1:
            raise UsageError("viewpoints: have different pupils or focus; use one for all")
        for key in (f"{PREFIX}pupil_mm", f"{PREFIX}focus_mm"):
            if eyes and key in self.definitions:
                raise UsageError(
                    f"viewpoints: a Viewpoint has its own pupil and focus; remove {key}"
                )
        return {"pupil_mm": eyes[0].pupil_mm, "focus_mm": eyes[0].focus_mm} if eyes else {}

    def recorded_definitions(
        self, settings: Settings, scene_keys: Container[str] = ()
    ) -> dict[str, str]:
        """Texts of the definitions and of values without an option: a `Display`, a pupil."""
        keys = [*self._pupil(), *(DISPLAY_KEYS if isinstance(self.display, Display) else ())]
        if self.misalign is not None:
            keys.append("misalign")
        values = {
            f"{PREFIX}{key}": getattr(settings, key)
            for key in keys
            if getattr(settings, key) != SETTINGS[key].default or f"{PREFIX}{key}" in scene_keys
        }
        return definition_texts({**self.definitions, **values})


def definition_words(definitions: Mapping[str, str]) -> list[str]:
    """Format definitions as values of ``-D``."""
    return [f"{key}={text}" for key, text in definitions.items()]


@dataclass(frozen=True)
class Request(Choices):
    """Request to validate a scene; its attributes are the parameters of `inim.validate`."""

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
    plugins: tuple[str, ...] = ()
    allow_changed_inputs: bool = False

    def command(self, settings: Settings, scene_keys: Container[str] = ()) -> list[str]:
        """Arguments of `python -m inim.validate` that repeat this request.

        `scene_keys` are the keys of the settings in the scene file.
        """
        flags = ("preview", "time", "lazy", "no_skip", "allow_changed_inputs")
        choices = ("algorithms", "cameras", "viewpoints", "lens_model")
        texts = self.overrides()
        is_object = isinstance(self.display, Display)
        words = [
            str(self.scene),
            *option_words(
                {
                    "-o": self.out,
                    "-D": definition_words(self.recorded_definitions(settings, scene_keys)),
                    "--display": settings.display if is_object else self.display,
                    **{f"--{name.replace('_', '-')}": texts.get(name) for name in choices},
                    "--allow-folder": self.allow_folders,
                    "--plugin": self.plugins,
                    "--eia": [f"{name}={path}" for name, path in self.eias.items()],
                    "--backend": None if self.backend == "auto" else self.backend,
                    "--baseline": self.baseline,
                    **{f"--{flag.replace('_', '-')}": getattr(self, flag) for flag in flags},
                }
            ),
        ]
        return [user_text(word) for word in words]
