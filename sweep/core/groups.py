"""The groups of the configuration: what stands here is chosen by `group=choice` and set by `group.name=value`.

Schemas, `sweep list`, completion and a project's folders follow from this table; `Case` has those of a rollout.
"""

from collections.abc import Callable
from pkgutil import resolve_name
from typing import Any, NamedTuple


class Group(NamedTuple):
    """Where its parameters are defined; as text, so that a list of them loads no simulator."""

    classes: str  # module:name of its parameter dataclass, or of all of them by their `kind`
    in_case: bool = False  # whether a rollout's world and belief have it
    kinds: bool = False  # whether `kind` chooses among classes
    whole: bool = False  # whether its files speak of the whole configuration
    free: bool = False  # whether its parts are named freely; it may be left out
    numbers: str = ""  # module:function that tells the numbers of one of its files by path

    @property
    def sources(self) -> str:
        """Folder or module of its classes' sources, from that of the package."""
        return self.classes.partition(":")[0].partition(".")[2].replace(".", "/")

    @property
    def table(self) -> str:
        """Name of its class, or of the table of them by kind."""
        return self.classes.partition(":")[2]

    @property
    def one_class(self) -> bool:
        """Whether one parameter dataclass is its schema."""
        return not (self.kinds or self.whole or self.free)

    def numbers_of(self, file: str, read: Callable[[str], str]) -> dict[str, float | str]:
        """The numbers of one of its files by path, formulas as they are; `read` gives the text of a file's name."""
        return resolve_name(self.numbers)(file, read)

    def load(self) -> Any:
        """Its parameter dataclass, or the table of them by kind."""
        return resolve_name(self.classes)


GROUPS = {
    "scenario": Group("sweep.study.study:ScenarioSchema", whole=True),
    "study": Group("sweep.study.study:StudySchema", whole=True),
    "robot": Group("sweep.models.robot:Robot", in_case=True),
    "obstacle": Group("sweep.models.obstacles:OBSTACLES", in_case=True, kinds=True),
    "manoeuvre": Group("sweep.controllers.manoeuvres:MANOEUVRES", in_case=True, kinds=True),
    "plan": Group(
        "sweep.models.plan_table:PlanTable", in_case=True, free=True, numbers="sweep.systems.hexapod:plan_numbers"
    ),
    "drive": Group("sweep.models.drive:Drive", in_case=True),
    "contact": Group("sweep.models.contact:Contact", in_case=True),
    "noise": Group("sweep.models.noise:Noise", in_case=True),
    "execution": Group("sweep.models.disturbance:Execution", in_case=True),
    "control": Group("sweep.models.control:Control", in_case=True),
    "engine": Group("sweep.engines.settings:EngineSettings"),
    "outcome": Group("sweep.metrics.outcome:Thresholds"),
    "cluster": Group("sweep.study.clusters:CLUSTERS", kinds=True),
}
