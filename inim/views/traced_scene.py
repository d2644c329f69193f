"""The scene of a report, to be traced again: for a quilt of it, or a film beside it."""

from __future__ import annotations

import itertools
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from inim.errors import FileError
from inim.report import Report
from inim.scene.file import SceneFile, parse_definitions, read_scene_file


@dataclass(frozen=True)
class TracedScene:
    """The scene of a report, to be traced again.

    Attributes
    ----------
    path : Path
    sha256 : str
        That the report has of it.
    definitions : tuple of str
        `key=value`, as after -D, that the report was made with.
    allow_folders : tuple of Path
        Where files that it names may lie, too.
    fit_share : float
        Share of the array that the relic fills.
    """

    path: Path
    sha256: str
    definitions: tuple[str, ...]
    allow_folders: tuple[Path, ...]
    fit_share: float

    @classmethod
    def of(
        cls, report: Report, path: Path | None = None, allow_folders: Sequence[Path] = ()
    ) -> TracedScene:
        """A report's, with the definitions that its command gives.

        Parameters
        ----------
        report : Report
        path : Path, optional
            Where it is now, if not where the report says.
        allow_folders : sequence of Path

        Raises
        ------
        FileError
            The report's command cannot be read.
        """
        scene, settings = report.data["scene"], report.data["settings"]
        try:
            words = shlex.split(report.data["command"])
        except ValueError as error:
            raise FileError(
                f"{report.folder}: the report's command is not readable ({error})"
            ) from None
        given = tuple(word for flag, word in itertools.pairwise(words) if flag == "-D")
        return cls(
            path or Path(scene["path"]),
            scene["sha256"],
            given,
            tuple(allow_folders),
            settings["fit_share"],
        )

    def file(self) -> SceneFile:
        """The scene file, scanned.

        Raises
        ------
        InimError
            It cannot be read, or is no longer what the report was made of.
        """
        definitions = parse_definitions(list(self.definitions))
        found = read_scene_file(self.path, definitions, self.allow_folders)
        if found.sha256 != self.sha256:
            raise FileError(
                f"{self.path}: is not what the report was made of: another scene, or it or a file "
                "that it names has changed; validate it anew, or name the scene with --scene"
            )
        return found
