"""The scene of a report, to be traced again: for a quilt of it, or a film beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from inim.errors import FileError
from inim.report import Report
from inim.scene.file import SceneFile, read_scene_file


@dataclass(frozen=True)
class TracedScene:
    """The scene of a report, to be traced again.

    Attributes
    ----------
    path : Path
    sha256 : str
        That the report has of it.
    definitions : dict of str to str
        Settings and scene parameters that the report's run overrode.
    allow_folders : tuple of Path
        Where files that it names may lie, too.
    fit_share : float
        Share of the array that the relic fills.
    """

    path: Path
    sha256: str
    definitions: Mapping[str, str]
    allow_folders: tuple[Path, ...]
    fit_share: float

    @classmethod
    def of(
        cls, report: Report, path: Path | None = None, allow_folders: Sequence[Path] = ()
    ) -> TracedScene:
        """The scene of a report, with the run's definitions.

        Parameters
        ----------
        report : Report
        path : Path, optional
            Where it is now, if not where the report says.
        allow_folders : sequence of Path
        """
        scene = report.data.scene
        return cls(
            path or Path(scene.path),
            scene.sha256,
            scene.definitions,
            tuple(allow_folders),
            report.data.settings.fit_share,
        )

    def file(self) -> SceneFile:
        """The scene file, scanned.

        Raises
        ------
        InimError
            It cannot be read, or is no longer what the report was made of.
        """
        file = read_scene_file(self.path, self.definitions, self.allow_folders)
        if file.sha256 != self.sha256:
            raise FileError(
                f"{self.path}: is not what the report was made of: another scene, or it or a file "
                "that it names has changed; validate it anew, or name the scene with --scene"
            )
        return file
