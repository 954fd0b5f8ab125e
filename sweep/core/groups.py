"""Table of the configuration groups: `group=choice` selects a file of a group, `group.name=value` sets one of its
parameters.

Schemas, `sweep list`, completion and the folders of a project follow from this table. A `Case` holds the groups of a
rollout.
"""

from collections.abc import Callable
from pkgutil import resolve_name
from typing import Any, NamedTuple


class ConfigGroup(NamedTuple):
    """A configuration group, with its parameter classes named as text, so that listing imports no simulator."""

    class_location: str  # module:name of its parameter dataclass, or of all of them by their `kind`
    in_case: bool = False  # whether a rollout's world and belief have it
    has_kinds: bool = False  # whether `kind` chooses among classes
    is_global: bool = False  # whether its files set other groups, too
    has_free_keys: bool = False  # whether users choose the names of its keys, as in plans
    number_lister: str = ""  # module:function that lists the numbers of one of its files by path

    @property
    def source_path(self) -> str:
        """Source folder or module of the group's parameter classes, relative to the package."""
        return self.class_location.partition(":")[0].partition(".")[2].replace(".", "/")

    @property
    def class_name(self) -> str:
        """Name of the group's parameter class, or of the table that lists several such classes by `kind`."""
        return self.class_location.partition(":")[2]

    @property
    def has_single_class(self) -> bool:
        """Whether a single parameter dataclass is the schema of the group, instead of one for each `kind`."""
        return not (self.has_kinds or self.is_global or self.has_free_keys)

    def read_file_numbers(self, file: str, read: Callable[[str], str]) -> dict[str, float | str]:
        """Return the numbers and formulas in one of the group's files, by path.

        Args:
            file: Name of the file.
            read: Returns the text of the file of a name.
        """
        return resolve_name(self.number_lister)(file, read)

    def load(self) -> Any:
        """Import the group's parameter dataclass, or the table of its dataclasses by `kind`."""
        return resolve_name(self.class_location)


GROUPS = {
    "scenario": ConfigGroup("sweep.study.study:ScenarioSchema", is_global=True),
    "study": ConfigGroup("sweep.study.study:StudySchema", is_global=True),
    "robot": ConfigGroup("sweep.models.robot:Robot", in_case=True),
    "obstacle": ConfigGroup("sweep.models.obstacles:OBSTACLES", in_case=True, has_kinds=True),
    "manoeuvre": ConfigGroup("sweep.manoeuvres:MANOEUVRES", in_case=True, has_kinds=True),
    "plan": ConfigGroup(
        "sweep.models.plan_numbers:PlanTable",
        in_case=True,
        has_free_keys=True,
        number_lister="sweep.systems.hexapod:plan_numbers",
    ),
    "drive": ConfigGroup("sweep.models.drive:Drive", in_case=True),
    "contact": ConfigGroup("sweep.models.contact:Contact", in_case=True),
    "noise": ConfigGroup("sweep.models.noise:Noise", in_case=True),
    "execution": ConfigGroup("sweep.models.disturbance:ExecutionFaults", in_case=True),
    "control": ConfigGroup("sweep.models.control:Control", in_case=True),
    "engine": ConfigGroup("sweep.contract.engine_settings:EngineSettings"),
    "outcome": ConfigGroup("sweep.metrics.outcome:OutcomeThresholds"),
    "cluster": ConfigGroup("sweep.study.clusters:CLUSTERS", has_kinds=True),
}
