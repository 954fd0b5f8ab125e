"""From Hydra's configuration to checked parameters, and from Hydra's errors to one clear line.

The parameter dataclasses are the schemas: Hydra checks names and types while it composes, `build` checks bounds.
"""

import dataclasses
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import hydra
from hydra._internal.core_plugins.file_config_source import FileConfigSource
from hydra._internal.sources_registry import SourcesRegistry
from hydra.core.config_store import ConfigStore
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import QuotedString
from hydra.core.plugins import Plugins
from hydra.errors import ConfigCompositionException, HydraException, MissingConfigException, OverrideParseException
from hydra.plugins.config_source import ConfigResult
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import ConfigKeyError, OmegaConfBaseException, ValidationError

from sweep.controllers.manoeuvres import MANOEUVRES
from sweep.controllers.observation import Noise
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
from sweep.study.designs import known
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


SCHEMA = tuple(f.name for f in dataclasses.fields(ExperimentSchema))


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


class Unexecuted(FileConfigSource):
    """Files of a user, such as studies in a `--config-dir`: they choose and set values, and have nothing run."""

    def load_config(self, config_path: str) -> ConfigResult:
        """Raises `InputError` where Hydra would be told what to run."""
        result = super().load_config(config_path)
        values = OmegaConf.to_container(result.config, resolve=False)
        where = [config_path, str(result.header.get("package")), *_texts(values, "defaults")]
        named = [key for key in _keys(values) if key in ("hydra", "_target_")]
        named += ["hydra" for text in where if re.search(r"\bhydra\b", text)]
        if named:
            raise InputError(f"{config_path} has {named[0]}, which runs code: a file of yours sets parameters only")
        return result


def _keys(values: Any) -> Iterator[str]:
    if isinstance(values, Mapping):
        for key, value in values.items():
            yield str(key)
            yield from _keys(value)
    elif isinstance(values, list):
        for value in values:
            yield from _keys(value)


def _texts(values: Any, key: str) -> list[str]:
    found = values.get(key) if isinstance(values, Mapping) else None
    return [str(one) for one in found] if isinstance(found, list) else []


def register() -> None:
    """Tell Hydra the schemas, and that a user's files are not run."""
    Plugins.instance()  # which would put its own source in the place of ours
    SourcesRegistry.instance().types[Unexecuted.scheme()] = Unexecuted
    store = ConfigStore.instance()
    whole = OmegaConf.structured(ExperimentSchema)
    OmegaConf.set_struct(whole.study.axes, False)  # axes are named freely
    store.store(name="experiment_schema", node=whole)
    for group, cls in GROUPS.items():
        store.store(group=group, name=f"{group}_schema", node=_schema(cls))
    for group, kinds in KINDS.items():
        for kind, cls in kinds.items():
            store.store(group=group, name=f"{kind}_schema", node=_schema(cls))


def _schema(cls: type) -> DictConfig:
    node = OmegaConf.structured(cls)
    OmegaConf.set_readonly(node, None)  # frozen dataclasses make frozen configs, which no file could fill in
    return node


def compose(overrides: list[str]) -> Experiment:
    """The experiment of command-line `overrides`, for use from Python. Raises `InputError`."""
    register()
    try:
        check_choices(overrides)
        with hydra.initialize_config_module(CONFIG_MODULE, version_base=HYDRA_VERSION):
            return experiment(resolve(hydra.compose(CONFIG_NAME, overrides)))
    except (HydraException, OmegaConfBaseException, OverflowError) as error:
        raise InputError(one_line(error, overrides)) from None


def check_choices(overrides: list[str]) -> None:
    """Raises `InputError` where a group's choice is no name, which Hydra has no words for."""
    groups = {*GROUPS, *KINDS, "scenario", "study"}
    chosen = [text for text in overrides if text.partition("=")[0].lstrip("+") in groups]
    for one in OverridesParser.create().parse_overrides(chosen):
        if one.is_sweep_override() or isinstance(one.value(), dict):
            continue
        value = one.value()
        if not all(isinstance(name, str | QuotedString) for name in (value if isinstance(value, list) else [value])):
            raise InputError(f"{one.input_line} is not allowed: the name of a choice (`sweep list` shows them)")


def resolve(config: DictConfig) -> dict[str, Any]:
    """Plain values, interpolations of each other resolved. Raises `InputError`."""
    for key, text in flat(OmegaConf.to_container(config, resolve=False)).items():
        if isinstance(text, str) and re.search(r"\$\{[^}]*:", text):  # such as oc.env, whose secret would be stored
            raise InputError(f"{key} = {text} is not allowed: an interpolation names another key")
    values: Any = OmegaConf.to_container(config, resolve=True)
    if not isinstance(values.get("study"), dict) or not isinstance(values["study"].get("axes"), dict):
        return values  # which `experiment` refuses
    # YAML 1.1 reads a bare `on` as true
    axes = {
        name: {"on" if key is True else key: v for key, v in axis.items()} if isinstance(axis, dict) else axis
        for name, axis in values["study"]["axes"].items()
    }
    return {**values, "study": {**values["study"], "axes": axes}}


def flat(values: Any, path: str = "") -> dict[str, Any]:
    """Nested plain values by dotted path."""
    if not isinstance(values, Mapping):
        return {path: values}
    items = ((f"{path}.{key}" if path else str(key), value) for key, value in values.items())
    return {k: v for key, value in items for k, v in flat(value, key).items()}


def experiment(values: Mapping[str, Any]) -> Experiment:
    """Check plain `values` (as composed, or as stored in study.yaml). Raises `InputError`."""
    for key in values:
        if key not in SCHEMA:
            raise InputError(f"{key} is unknown{suggest(str(key), SCHEMA)}")
    for group in (*GROUPS, *KINDS, "scenario", "study"):
        if not isinstance(values.get(group), Mapping):
            raise InputError(f"{group} = {values.get(group)} is not allowed: `sweep list` shows the choices")
    parts = {group: build(cls, values[group], group) for group, cls in GROUPS.items()}
    settings, thresholds = parts.pop("engine"), parts.pop("outcome")
    for group, kinds in KINDS.items():
        kind = values[group].get("kind")
        if kind not in kinds:
            raise InputError(f"{group}.kind = {kind!r} is unknown{suggest(str(kind), kinds)}")
        parts[group] = build(kinds[kind], values[group], group)
    cluster = parts.pop("cluster")
    case = Case(**parts)
    scenario = known("scenario", values["scenario"], _names(ScenarioSchema))
    given = known("study", values["study"], _names(StudySchema))
    chosen = {**dataclasses.asdict(StudySchema()), **given}  # rows of before a key was there had its default
    single = not (chosen["name"] or chosen["axes"] or chosen["points"] or chosen["replicates"] != 1)
    if single:
        chosen = {**chosen, "expect": scenario["expect"]}
    study = Study.parse({**chosen, "name": chosen["name"] or scenario["name"]}, single)
    for theory in study.theory:  # refuses inputs that mean nothing
        parameter(theory.of, case, settings)
        theory.numbers(lambda path: nominal(path, case, settings))
    return Experiment(scenario["name"], case, settings, thresholds, cluster, study, values["out"], dict(values))


def _names(cls: type) -> tuple[str, ...]:
    return tuple(f.name for f in dataclasses.fields(cls))


def one_line(error: Exception, overrides: list[str]) -> str:
    """Hydra's or OmegaConf's error as one line naming the key, the value and what is allowed."""
    if isinstance(error, MissingConfigException) and error.options is not None and error.missing_cfg_file:
        group, _, name = error.missing_cfg_file.rpartition("/")
        return f"{group} = {name} is unknown{suggest(name, choices(error.options))}"
    if isinstance(error, OverrideParseException):
        reason = next((line for line in error.message.splitlines() if "missing" in line), "put quotes around its value")
        return f"{error.override} cannot be read: {reason}"
    cause = error.__cause__ if isinstance(error, ConfigCompositionException) else error
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
