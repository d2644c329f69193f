"""What a user asks a validation for, and asking for it: a worker process carries it out."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

#: Settings that a request can also name directly.
SHORTHANDS = ("algorithms", "viewpoints", "lens_model", "misalign")
#: What a preview sets, unless `-D` or a shorthand says otherwise: one algorithm from one place, by
#: few samples, and judged by nothing.
PREVIEW = {
    "inim.algorithms": "template",
    "inim.viewpoints": "centre",
    "inim.capture_spp": "8",
    "inim.eia_spp": "8",
    "inim.view_spp": "16",
    "inim.reconstruction_spp": "16",
    "inim.score_error": "0",
    "inim.min_ssim_to_ceiling": "",
}


def repeated(option: str, values: Iterable[object]) -> list[str]:
    """The words of a command line that give an option once for each value."""
    return [word for value in values for word in (option, str(value))]


@dataclass(frozen=True)
class Request:
    """What the user asked for; None and empty mean "as the scene says".

    Attributes
    ----------
    scene, out : Path
    definitions : tuple of str
        `key=value` overrides, as after -D.
    display : str, optional
        A preset, or a file with `inim.*` settings; see `inim.scene.file.with_display`.
    algorithms, viewpoints, lens_model, misalign : str, optional
        Shorthands for the `inim.*` settings of those names.
    eias : tuple of str
        Finished EIAs to score beside the algorithms, as `NAME=FILE`.
    backend : {"auto", "llvm", "cuda"}
    baseline : Path, optional
        Folder of the baseline to compare with.
    preview : bool
        A first look: `PREVIEW` in place of what the scene says.
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
    definitions: tuple[str, ...] = ()
    display: str | None = None
    algorithms: str | None = None
    viewpoints: str | None = None
    lens_model: str | None = None
    misalign: str | None = None
    eias: tuple[str, ...] = ()
    backend: str = "auto"
    baseline: Path | None = None
    preview: bool = False
    time: bool = False
    lazy: bool = False
    no_skip: bool = False
    allow_folders: tuple[Path, ...] = ()

    def command(self) -> list[str]:
        """The command line that repeats this request, after `python -m inim.validate`."""
        words = [str(self.scene), "-o", str(self.out), *repeated("-D", self.definitions)]
        words += repeated("--allow-folder", self.allow_folders)
        for name in ("display", *SHORTHANDS):
            value = getattr(self, name)
            if value is not None:
                words += [f"--{name.replace('_', '-')}", value]
        words += repeated("--eia", self.eias)
        if self.backend != "auto":
            words += ["--backend", self.backend]
        if self.baseline is not None:
            words += ["--baseline", str(self.baseline)]
        flags = ("preview", "time", "lazy", "no_skip")
        words += [f"--{name.replace('_', '-')}" for name in flags if getattr(self, name)]
        return words
