"""What a stress run was asked to do, checked before anything heavy is loaded."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from inim.errors import UsageError
from inim.pipeline.plan import Plan, make_plan
from inim.pipeline.request import Request

__all__ = ["StressRequest", "check_request", "default_out", "scene_plan"]


@dataclass(frozen=True)
class StressRequest:
    """What the user asked for.

    Attributes
    ----------
    out : Path
    scene : Path, optional
        Whose captured picture is jittered, instead of two synthetic spheres.
    definitions : tuple of str
        `key=value` overrides, as after -D.
    quick : bool
        Fewer and smaller cases: under a minute.
    """

    out: Path
    scene: Path | None = None
    definitions: tuple[str, ...] = ()
    quick: bool = False

    def command(self) -> list[str]:
        """The command line that repeats this request, after `python -m inim.stress`."""
        words = [] if self.scene is None else [str(self.scene)]
        words += ["-o", str(self.out)]
        for item in self.definitions:
            words += ["-D", item]
        return [*words, "--quick"] if self.quick else words


def default_out(scene: Path | None) -> Path:
    """Where a stress run goes when nobody says: beside where the command is typed."""
    return Path("stress" if scene is None else f"{scene.stem}-stress")


def check_request(request: StressRequest) -> None:
    """Raise the `InimError` that fits where a request cannot be carried out."""
    if request.scene is None and request.definitions:
        raise UsageError("stress: -D belongs to a scene; name one")
    if request.scene is not None:
        scene_plan(request)


def scene_plan(request: StressRequest) -> Plan:
    """The plan of a validation of the scene: its display and sampling."""
    assert request.scene is not None
    return make_plan(
        Request(request.scene, request.out, request.definitions, algorithms="template")
    )
