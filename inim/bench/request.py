"""What a bench was asked to do, checked before anything heavy is loaded."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from inim.errors import UsageError
from inim.pipeline.plan import Plan, make_plan
from inim.pipeline.request import Request
from inim.pipeline.timing import Rounds, most_threads

__all__ = ["BenchRequest", "check_request", "default_out", "scene_plan"]


@dataclass(frozen=True)
class BenchRequest:
    """What the user asked for; None and empty mean "as the scene says".

    Attributes
    ----------
    out : Path
    scene : Path, optional
        Without one, another part must be asked for.
    definitions : tuple of str
        `key=value` overrides, as after -D.
    display, algorithms : str, optional
    runs, warmups : int
    threads : int, optional
        All there are if None.
    scaling, paper, views : bool
    layers : tuple of Path
        Scenes to bench with and without their layers; -D and `display` hold for them too.
    commands : Path, optional
        Scene to time whole commands on; -D and `display` hold for it too.
    """

    out: Path
    scene: Path | None = None
    definitions: tuple[str, ...] = ()
    display: str | None = None
    algorithms: str | None = None
    runs: int = Rounds.runs
    warmups: int = Rounds.warmups
    threads: int | None = None
    scaling: bool = False
    paper: bool = False
    views: bool = False
    layers: tuple[Path, ...] = ()
    commands: Path | None = None

    @property
    def rounds(self) -> Rounds:
        """How often everything runs, and on how many threads."""
        return Rounds(self.runs, self.warmups, self.threads)

    def command(self) -> list[str]:
        """The command line that repeats this request, after `python -m inim.bench`."""
        words = [] if self.scene is None else [str(self.scene)]
        words += ["-o", str(self.out)]
        for item in self.definitions:
            words += ["-D", item]
        for name in ("display", "algorithms", "threads"):
            if getattr(self, name) is not None:
                words += [f"--{name}", str(getattr(self, name))]
        words += [f"--{name}" for name in ("scaling", "paper", "views") if getattr(self, name)]
        words += ["--layers", *map(str, self.layers)] if self.layers else []
        words += [] if self.commands is None else ["--commands", str(self.commands)]
        defaults = Rounds()
        for name in ("runs", "warmups"):
            if getattr(self, name) != getattr(defaults, name):
                words += [f"--{name}", str(getattr(self, name))]
        return words


def default_out(scene: Path | None) -> Path:
    """Where a bench goes when nobody says: beside where the command is typed."""
    return Path("bench" if scene is None else f"{scene.stem}-bench")


def check_request(request: BenchRequest) -> None:
    """Raise the `InimError` that fits where a request cannot be carried out; costs no rendering."""
    from inim.bench.commands import check_commands
    from inim.bench.scene import choose_algorithms

    scenes = [scene for scene in (request.scene, *request.layers, request.commands) if scene]
    if not (scenes or request.scaling or request.paper or request.views):
        raise UsageError(
            "bench: name a scene, or ask for --scaling, --paper, --views, --layers or --commands"
        )
    if not scenes and (request.definitions or request.display):
        raise UsageError("bench: -D and --display belong to a scene; name one")
    if not request.scene and request.algorithms:
        raise UsageError("bench: --algorithms belongs to a scene; name one")
    Rounds(request.runs, request.warmups)  # checks both
    if request.threads is not None and not 1 <= request.threads <= most_threads():
        raise UsageError(f"--threads {request.threads}: this machine has 1 to {most_threads()}")
    for scene in scenes:
        plan = scene_plan(request, scene)
        if scene == request.commands:
            check_commands(plan)
    if request.algorithms is not None:
        choose_algorithms(request.algorithms)


def scene_plan(request: BenchRequest, scene: Path) -> Plan:
    """The plan of a validation of one of the scenes: its display, viewpoints and sampling."""
    return make_plan(
        Request(
            scene,
            request.out,
            request.definitions,
            request.display,
            algorithms="template",  # contenders are chosen apart: their options are not settings
        )
    )
