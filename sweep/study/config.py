"""From Hydra's configuration to checked parameters, and from Hydra's errors to one clear line.

The parameter dataclasses are the schemas: Hydra checks names and types while it composes, `build` checks bounds.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import hydra
from hydra.core.config_store import ConfigStore
from hydra.errors import ConfigCompositionException, HydraException, MissingConfigException, OverrideParseException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import ConfigKeyError, OmegaConfBaseException, ValidationError

from sweep.controllers.manoeuvres import MANOEUVRES
from sweep.controllers.observation import Noise
from sweep.core import project
from sweep.core.parameters import InputError, build, checked, suggest
from sweep.engines.settings import EngineSettings
from sweep.metrics.outcome import Thresholds
from sweep.models.case import Case
from sweep.models.contact import Contact
from sweep.models.disturbance import Execution
from sweep.models.drive import Drive
from sweep.models.obstacles import OBSTACLES
from sweep.models.robot import Robot
from sweep.runs.clusters import CLUSTERS, Cluster
from sweep.study import sources
from sweep.study.study import Study, nominal, parameter

CONFIG_MODULE, CONFIG_NAME, HYDRA_VERSION = "sweep.conf", "config", "1.3"
GROUPS: dict[str, type] = {
    "robot": Robot, "drive": Drive, "contact": Contact, "noise": Noise, "execution": Execution,
    "engine": EngineSettings, "outcome": Thresholds,
}  # fmt: skip
KINDS: dict[str, dict[str, type]] = {
    "obstacle": OBSTACLES,
    "manoeuvre": MANOEUVRES,
    "cluster": CLUSTERS,
}  # the class is named by `kind`


@dataclass
class ScenarioSchema:
    """What is simulated nominally; `expect` must hold when it runs without a study."""

    name: str = "nominal"
    expect: list[Any] = field(default_factory=list)


@dataclass
class DesignSchema:
    """How axes are combined and sampled; see `sweep.study.designs.Design`."""

    grid: str = "full"
    kind: str = "monte_carlo"
    num: int = 0
    scrambles: int = 1
    correlation: list[Any] = field(default_factory=list)


@dataclass
class StudySchema:
    """Which variations of the scenario are run; see `sweep.study.study.Study`."""

    name: str = ""
    axes: dict[str, Any] = field(default_factory=dict)
    design: DesignSchema = field(default_factory=DesignSchema)
    points: str | None = None
    where: str | None = None
    replicates: int = 1
    seed: int = 0
    resolution: float = 0.0
    level: float = 0.5
    budget: int = 0
    audit: int = 0
    invalid_max: float = 0.01
    expect: list[Any] = field(default_factory=list)
    theory: list[Any] = field(default_factory=list)


@dataclass
class ExperimentSchema:
    """The whole configuration; the other groups are merged in by their own schemas."""

    scenario: ScenarioSchema = field(default_factory=ScenarioSchema)
    robot: Any = None
    drive: Any = None
    contact: Any = None
    obstacle: Any = None
    manoeuvre: Any = None
    noise: Any = None
    execution: Any = None
    engine: Any = None
    outcome: Any = None
    cluster: Any = None
    study: StudySchema = field(default_factory=StudySchema)
    out: str | None = None


@dataclass(frozen=True)
class Experiment:
    """A checked configuration: what a run needs to know."""

    scenario: str
    case: Case  # nominal
    settings: EngineSettings
    thresholds: Thresholds
    cluster: Cluster
    study: Study
    out: str | None
    values: dict[str, Any]  # the resolved configuration it was made from

    @property
    def folder(self) -> Path:
        """Where its rows are kept."""
        return Path(self.out or f"results/{self.study.name}")


def register() -> None:
    """Tell Hydra the schemas, those of users' modules too, and where files are. Raises `InputError`."""
    sources.register()
    add_modules()
    store = ConfigStore.instance()
    whole = OmegaConf.structured(ExperimentSchema)
    OmegaConf.set_struct(whole.study.axes, False)  # axes are named freely
    store.store(name="experiment_schema", node=whole)
    for group, cls in GROUPS.items():
        store.store(group=group, name=f"{group}_schema", node=_schema(cls))
    for group, kinds in KINDS.items():
        for kind, cls in kinds.items():
            store.store(group=group, name=f"{kind}_schema", node=_schema(cls))


def add_modules() -> None:
    """Add the obstacles and manoeuvres of users' modules to ours. Raises `InputError`."""
    for module in project.modules():
        for group, name in (("obstacle", "OBSTACLES"), ("manoeuvre", "MANOEUVRES")):
            for kind, cls in getattr(module, name, {}).items():
                if KINDS[group].setdefault(kind, cls) is not cls:
                    raise InputError(f"module {module.__name__}: {group} {kind} is there already: give it another name")


def _schema(cls: type) -> DictConfig:
    node = OmegaConf.structured(cls)
    OmegaConf.set_readonly(node, None)  # frozen dataclasses make frozen configs, which no file could fill in
    return node


def compose(overrides: list[str]) -> Experiment:
    """The experiment of command-line `overrides`, for use from Python. Raises `InputError`."""
    register()
    try:
        with hydra.initialize_config_module(CONFIG_MODULE, version_base=HYDRA_VERSION):
            return experiment(resolve(hydra.compose(CONFIG_NAME, overrides)))
    except (HydraException, OmegaConfBaseException) as error:
        raise InputError(one_line(error, overrides)) from None


def resolve(config: DictConfig) -> dict[str, Any]:
    """Plain values, interpolations resolved."""
    values: Any = OmegaConf.to_container(config, resolve=True)
    return values


def experiment(values: Mapping[str, Any]) -> Experiment:
    """Check plain `values` (as composed, or as stored in study.yaml). Raises `InputError`."""
    add_modules()
    parts = {group: build(cls, values[group], group) for group, cls in GROUPS.items()}
    settings, thresholds = parts.pop("engine"), parts.pop("outcome")
    for group, kinds in KINDS.items():
        kind = values[group]["kind"]
        if kind not in kinds:
            raise InputError(f"{group}.kind = {kind!r} is unknown{suggest(str(kind), kinds)}")
        parts[group] = build(kinds[kind], values[group], group)
    cluster = parts.pop("cluster")
    case = Case(**parts)
    scenario = values["scenario"]
    chosen = {**dataclasses.asdict(StudySchema()), **values["study"]}  # rows of before a key was there had its default
    single = not (chosen["name"] or chosen["axes"] or chosen["points"] or chosen["replicates"] != 1)
    if single:
        chosen = {**chosen, "expect": scenario["expect"]}
    study = Study.parse({**chosen, "name": chosen["name"] or scenario["name"]}, single)
    for theory in study.theory:  # refuses inputs that mean nothing
        parameter(theory.of, case, settings)
        theory.numbers(lambda path: nominal(path, case, settings))
    return Experiment(scenario["name"], case, settings, thresholds, cluster, study, values["out"], dict(values))


def one_line(error: Exception, overrides: list[str]) -> str:
    """Hydra's or OmegaConf's error as one line naming the key, the value and what is allowed."""
    if isinstance(error, MissingConfigException) and error.options is not None and error.missing_cfg_file:
        group, _, name = error.missing_cfg_file.partition("/")
        if name.endswith(".yaml"):
            return f"{group} = {name} is not a file"
        return f"{group} = {name} is unknown{suggest(name, choices(error.options))}"
    if isinstance(error, OverrideParseException):
        reason = next((line for line in error.message.splitlines() if "missing" in line), "put quotes around its value")
        return f"{error.override} cannot be read: {reason}"
    cause = error.__cause__ or error.__context__ if isinstance(error, ConfigCompositionException) else error
    if isinstance(cause, ConfigKeyError | AttributeError) and isinstance(cause, OmegaConfBaseException):
        key, given = str(cause.full_key), _given(str(cause.full_key), overrides)
        allowed = [str(k) for k in cause.parent_node or () if k != "hydra"]  # pyright: ignore[reportGeneralTypeIssues]
        return f"{key}{given} is unknown{suggest(str(cause.key), allowed)}"
    if isinstance(cause, ValidationError):
        return _wrong_type(cause, overrides)
    return ": ".join(line.strip().rstrip(":") for line in str(error).splitlines()[:2] if line.strip())


def _wrong_type(error: ValidationError, overrides: list[str]) -> str:
    cls, key = error.object_type, str(error.full_key)
    for member in dataclasses.fields(cls) if dataclasses.is_dataclass(cls) else ():
        if member.name == str(error.key):
            try:
                checked(member, error.value, key)
            except InputError as known:
                return str(known)
    return f"{key}{_given(key, overrides)} is not allowed: {str(error.msg).splitlines()[0]}"


def _given(key: str, overrides: list[str]) -> str:
    """` = value` where the command line gave `key` one."""
    texts = (o.lstrip("+~").partition("=") for o in overrides)
    return next((f" = {value}" for name, sign, value in texts if sign and name == key), "")


def choices(options: Sequence[str]) -> list[str]:
    """The files of a group a user may choose: schemas are not among them."""
    return [o for o in options if not o.endswith("_schema")]
