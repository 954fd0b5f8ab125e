"""Composed configurations as checked experiments, and Hydra's errors as one line.

The parameter dataclasses are the schemas. Hydra checks names and types while it composes; `build` checks bounds.
"""

import dataclasses
import functools
import re
import sys
import typing
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import hydra
from hydra.core.config_store import ConfigStore
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import QuotedString
from hydra.errors import ConfigCompositionException, HydraException, MissingConfigException, OverrideParseException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import (
    ConfigKeyError,
    ConfigTypeError,
    InterpolationResolutionError,
    KeyValidationError,
    OmegaConfBaseException,
    ValidationError,
)

from sweep import systems
from sweep.config import hydra_sources
from sweep.contract.engine_settings import EngineSettings
from sweep.contract.system import Limits, System
from sweep.core import project
from sweep.core.errors import InputError, format_name_suggestion, require_choice
from sweep.core.groups import GROUPS
from sweep.core.parameters import build_instance_by_kind, convert_and_check_value
from sweep.core.yaml_check import explain_ambiguous_number
from sweep.study import design_kinds, designs
from sweep.study.clusters import Cluster
from sweep.study.columns import LABEL_COLUMNS, PLACEMENT_COLUMNS, TIMING_COLUMNS, VERDICT_COLUMNS
from sweep.study.designs import rename_legacy_side_keys
from sweep.study.distributions import require_known_keys
from sweep.study.study import ScenarioSchema, Study, StudySchema, check_kept_time_series, expand_kept_time_series

NON_FINITE_WORD = re.compile(r"(?<=[=\[:, ])[-+]?\.(nan|inf)(?=[\]}, ]|$)", re.IGNORECASE)  # of YAML, to Hydra a word
# whole numbers without quotes in the value of an override
WHOLE_NUMBER = re.compile(r"(?:^|(?<=[\[{, ])|(?<=[A-Za-z_]:))[-+]?[0-9][0-9_]*(?=[\]}, ]|$)")
TYPE_NAMES = {bool: "true or false", int: "a whole number", float: "a number", str: "a word", list: "a list",
              tuple: "a list", dict: "keys and values"}  # what values of a type are  # fmt: skip
CONFIG_MODULE, HYDRA_VERSION = "sweep.conf", "1.3"
REQUIRED_MEMBERS = {"obstacle": ("surface", "solids", "charts"), "manoeuvre": ("plan", "needs", "goal")}  # of classes
GLOBAL_GROUP_CLASSES: dict[str, type] = {name: group.load() for name, group in GROUPS.items() if group.is_global}
CLASSES_BY_KIND: dict[str, dict[str, type]] = {name: group.load() for name, group in GROUPS.items() if group.has_kinds}
SINGLE_CLASSES: dict[str, type] = {name: group.load() for name, group in GROUPS.items() if group.has_single_class}


@dataclass(frozen=True)
class Experiment:
    """A checked experiment: system, study, engine settings and thresholds; made by `build_experiment`."""

    scenario: str
    system: System
    settings: EngineSettings
    thresholds: Limits
    cluster: Cluster
    study: Study
    out: str | None
    values: dict[str, Any]  # the resolved configuration it was made from

    @property
    def case(self) -> Any:
        """The nominal parameters of the simulated world and of the controller's belief about it."""
        return self.system.case

    @property
    def folder(self) -> Path:
        """Folder in which the study's rows are stored."""
        return Path(self.out or f"results/{self.study.name}")


def register_schemas() -> None:
    """Register configuration files and schemas with Hydra, including those of user modules. Raises `InputError`."""
    add_user_classes(project.import_user_modules())
    _register_classes()
    _register_systems(tuple(design_kinds.DESIGN_BY_KIND))
    for group, kinds in CLASSES_BY_KIND.items():
        hydra_sources.SCHEMA_MAKERS[group] = {kind: partial(_schema, cls) for kind, cls in kinds.items()}


@functools.cache
def _register_classes() -> None:
    hydra_sources.register_hydra_sources()
    for group, cls in SINGLE_CLASSES.items():
        hydra_sources.SCHEMA_MAKERS[group] = {group: partial(_schema, cls)}


@functools.lru_cache(maxsize=1)
def _register_systems(design_names: tuple[str, ...]) -> None:
    """Register the schemas of systems, whose studies have the settings of all designs."""
    design = design_kinds.make_schema()
    typed = [("design", design, field(default_factory=design))]
    whole_types = {
        **GLOBAL_GROUP_CLASSES,
        "study": dataclasses.make_dataclass("StudySchema", typed, bases=(StudySchema,), frozen=True),
    }
    # the whole configuration of a system; what stands open in it is merged in by schemas of its own
    for kind in systems.SYSTEMS.values():
        every = {*systems.COMMON_KEYS, *kind.keys} - {"out"}
        names = [*(n for n in GROUPS if n in every), *(n for n in kind.keys if n not in GROUPS)]
        made = {**whole_types, **dict.fromkeys(kind.open_keys, dict)}
        parts = [(n, whole_types.get(n, Any), field(default_factory=made[n]) if n in made else None) for n in names]
        whole = _schema(dataclasses.make_dataclass("ExperimentSchema", [*parts, ("out", str | None, None)]))
        for node in (whole.study.axes, *(whole[n] for n in kind.open_keys)):
            OmegaConf.set_struct(node, False)  # their parts are named freely
        ConfigStore.instance().store(name=f"{kind.config}_schema", node=whole)


def add_user_classes(modules: tuple[ModuleType, ...]) -> None:
    """Add the obstacles, manoeuvres and designs of user modules to the built-in ones. Raises `InputError`."""
    tables = {name: group.class_name for name, group in GROUPS.items() if group.in_case and group.has_kinds}
    for module in modules:
        design_kinds.register_designs(module)
        for group, name in tables.items():
            if not isinstance(own := getattr(module, name, {}), Mapping):
                raise InputError(f"module {module.__name__}: {name} = {own} is not allowed: classes by kind")
            for kind, cls in own.items():
                if not isinstance(cls, type) or "kind" not in vars(cls).get("__dataclass_fields__", ()):
                    wanted = "a class with @parameters and a field `kind`"
                    raise InputError(f"module {module.__name__}: {name} has {kind}: {cls}, not {wanted}")
                if lacks := [one for one in REQUIRED_MEMBERS[group] if not hasattr(cls, one)]:
                    raise InputError(f"module {module.__name__}: {group} {kind} has no {lacks[0]}")
                if CLASSES_BY_KIND[group].setdefault(kind, cls) is not cls:
                    raise InputError(f"module {module.__name__}: {group} {kind} exists already: choose another name")


def _schema(cls: type) -> DictConfig:
    return _open(OmegaConf.structured(cls))


def _open(node: DictConfig) -> DictConfig:
    """Make a node and its parts writable; those of frozen dataclasses are read-only."""
    OmegaConf.set_readonly(node, None)
    for key in node:
        if isinstance(part := node._get_node(key), DictConfig):
            _open(part)
    return node


def compose(overrides: list[str]) -> Experiment:
    """Compose and check the experiment that command-line overrides such as `study=first` select. Raises
    `InputError`."""
    return build_experiment(compose_values(overrides))


def compose_values(overrides: list[str]) -> dict[str, Any]:
    """Compose command-line overrides into plain values whose names and types are checked. Raises `InputError`."""
    register_schemas()
    try:
        check_overrides(overrides)
        with hydra.initialize_config_module(CONFIG_MODULE, version_base=HYDRA_VERSION):
            return resolve_interpolations(hydra.compose(primary_config(overrides), overrides))
    except (HydraException, OmegaConfBaseException, OverflowError, RecursionError) as error:
        raise InputError(format_error(error, overrides)) from None


def primary_config(overrides: list[str]) -> str:
    """Return the name of Hydra's primary configuration for the system that overrides select. Raises `InputError`."""
    name = hydra_sources.find_system_name({key: value for key, _, value in (one.partition("=") for one in overrides)})
    return systems.find_kind_by_name(name).config


def check_overrides(overrides: list[str]) -> None:
    """Raise `InputError` for overrides whose errors Hydra would not explain, such as `=x` or `robot=1`."""
    if nameless := [text for text in overrides if text.lstrip("+~").startswith(("=", "@"))]:
        raise InputError(f"{nameless[0]} cannot be read: group=choice or group.name=value")
    for text in overrides:
        if found := NON_FINITE_WORD.search(text):
            raise InputError(f"{text.lstrip('+~').partition('=')[0]} = {found[0]} is not allowed: a finite number")
        for word in WHOLE_NUMBER.findall(text.partition("=")[2]):
            if why := explain_ambiguous_number(word):
                raise InputError(f"{text.lstrip('+~').partition('=')[0]} = {word} is not allowed: {why}")
    chosen = [text for text in overrides if text.partition("=")[0].lstrip("+") in GROUPS]
    for one in OverridesParser.create().parse_overrides(chosen):
        if one.is_sweep_override() or isinstance(one.value(), dict):
            continue
        value = one.value()
        if not all(isinstance(name, str | QuotedString) for name in (value if isinstance(value, list) else [value])):
            raise InputError(f"{one.input_line} is not allowed: the name of a choice (`sweep list` shows them)")


def resolve_interpolations(config: DictConfig) -> dict[str, Any]:
    """Resolve the interpolations of a composed configuration.

    Args:
        config: The configuration as Hydra composed it.

    Returns:
        Plain values.

    Raises:
        InputError: An interpolation does more than name a key, or a key is reserved.
    """
    for key, text in flatten_values(OmegaConf.to_container(config, resolve=False)).items():
        if isinstance(text, str) and re.search(r"\$\{[^}]*:", text):  # such as oc.env, whose secret would be stored
            raise InputError(f"{key} = {text} is not allowed: an interpolation may only name another key")
    values: Any = OmegaConf.to_container(config, resolve=True)
    if made := [key for key in systems.DERIVED_KEYS if key in flatten_values(values)]:
        raise InputError(f"{made[0]} is not allowed: it is computed from the files")
    if not isinstance(values.get("study"), dict) or not isinstance(values["study"].get("axes"), dict):
        return values  # which `experiment` refuses
    designs.refuse_ignored_settings(values["study"])
    axes = rename_legacy_side_keys(values["study"]["axes"])
    if axes != values["study"]["axes"]:
        print("sweep: note: the key `on` of an axis is now called `side`", file=sys.stderr)
    return {**values, "study": {**values["study"], "axes": axes}}


def flatten_values(values: Any, path: str = "") -> dict[str, Any]:
    """Flatten nested plain values into a mapping by dotted path.

    Args:
        values: Nested mappings, or a single value.
        path: Dotted path of `values`; empty for the whole configuration.

    Returns:
        Values by dotted path.
    """
    if not isinstance(values, Mapping):
        return {path: values}
    items = ((f"{path}.{key}" if path else str(key), value) for key, value in values.items())
    return {k: v for key, value in items for k, v in flatten_values(value, key).items()}


def build_experiment(values: Mapping[str, Any]) -> Experiment:
    """Make an experiment from the plain values of a composed configuration, after checking them.

    Args:
        values: A resolved configuration, composed or stored in study.yaml.

    Returns:
        The experiment.

    Raises:
        InputError: A key or a value is not allowed.
    """
    add_user_classes(project.import_user_modules())
    kind = systems.find_kind_by_config_keys(values)
    allowed = (*systems.COMMON_KEYS, *kind.keys)
    for key in values:
        require_choice(key, allowed, str(key))
    usual = {"control": {}, "plan": None}  # which rows of before they were there have at their defaults
    values = {**{key: value for key, value in usual.items() if key in allowed}, **values}
    for group in (key for key in allowed if key != "out"):
        if not isinstance(said := values.get(group), Mapping) and (said or group not in kind.optional_keys):
            raise InputError(f"{group} = {said} is not allowed: `sweep list` shows the choices")
    system, settings, limits, told = kind.build_nominal_system(values, CLASSES_BY_KIND)
    if taken := {*PLACEMENT_COLUMNS, *LABEL_COLUMNS, *VERDICT_COLUMNS, *TIMING_COLUMNS} & {*system.metric_names}:
        raise InputError(f"a metric called {min(taken)} is not allowed: all rows have a column of this name")
    cluster = build_instance_by_kind(CLASSES_BY_KIND["cluster"], values["cluster"], "cluster")
    scenario = require_known_keys("scenario", values["scenario"], _names(ScenarioSchema))
    asked = require_known_keys("study", values["study"], _names(StudySchema))
    chosen = {**dataclasses.asdict(StudySchema()), **asked}  # rows of before a key was there had its default
    single = not (chosen["name"] or chosen["axes"] or chosen["points"] or chosen["replicates"] != 1)
    if single:
        chosen = {**chosen, "expect": scenario["expect"]}
    if isinstance(chosen["axes"], Mapping):
        chosen["axes"] = designs.expand_axis_patterns(chosen["axes"], partial(_numbers, system, settings))
    study = Study.parse({**chosen, "name": chosen["name"] or scenario["name"]}, single)
    study = dataclasses.replace(study, keep=expand_kept_time_series(study, system))
    check_kept_time_series(study, system, settings)
    for theory in study.theory:  # refuses inputs that mean nothing
        system.parameter(theory.of, settings)
        theory.formula_inputs(lambda path: system.nominal_parameter_value(path, settings))
    return Experiment(scenario["name"], system, settings, limits, cluster, study, values["out"], {**values, **told})


experiment = build_experiment  # imported by projects that earlier versions exported


def _numbers(system: System, settings: EngineSettings, start: str) -> list[str]:
    """List the paths of a system's quantities that begin with `start` and are not nominally zero."""
    floats = [
        path
        for path, value in system.iterate_physical_inputs(())
        if path.startswith(start) and isinstance(value, float) and value
    ]
    return [path for path in floats if system.parameter(path, settings).metadata.get("role") == "quantity"]


def _names(cls: type) -> tuple[str, ...]:
    return tuple(f.name for f in dataclasses.fields(cls))


def format_error(error: Exception, overrides: list[str]) -> str:
    """Format an error of Hydra or OmegaConf as one line.

    Args:
        error: The error.
        overrides: The command line that was composed.

    Returns:
        A line that names the key, the value and what is allowed.
    """
    if isinstance(error, RecursionError):
        return f"{' '.join(overrides)} is not allowed: the chosen files extend each other in a circle"
    group, _, name = ((isinstance(error, MissingConfigException) and error.missing_cfg_file) or "").partition("/")
    if group in GROUPS:
        if name.endswith(".yaml"):
            return f"{group} = {name} is not a file"
        return f"{group} = {name} is unknown{format_name_suggestion(name, hydra_sources.list_group_choices(group))}"
    if isinstance(error, OverrideParseException):
        key, given, value = str(error.override).partition("=")
        quoted = (
            f" that the shell leaves: '{key}=\"{value}\"'" if value and not re.search(r"[\"'\[\]{}]", value) else ""
        )
        reason = f"put quotes around its value{quoted}" if given else "group=choice or group.name=value"
        return f"{error.override} cannot be read: {reason}"
    if found := re.match(r"Ambiguous value for argument '(.*)'", str(error)):
        return f"{found[1]} cannot be read: write a list as key=[VALUE,VALUE], or run each value with --multirun"
    cause = error.__cause__ or error.__context__ if isinstance(error, ConfigCompositionException) else error
    if isinstance(cause, ConfigKeyError | AttributeError) and isinstance(cause, OmegaConfBaseException):
        key, given = str(cause.full_key), _given(str(cause.full_key), overrides)
        allowed = [str(k) for k in cause.parent_node or () if k != "hydra"]  # pyright: ignore[reportGeneralTypeIssues]
        if not allowed and (group := key.partition(".")[0]) in GROUPS:
            return f"{key}{given} is unknown: choose a {group} first, {group}=NAME (`sweep list` shows them)"
        suggestion = suggest_parameter_paths(key, allowed) or format_name_suggestion(str(cause.key), allowed)
        return f"{key}{given} is unknown{suggestion}"
    if isinstance(cause, KeyValidationError):
        return f"{cause.full_key} is not allowed: a name that is not a number"
    if isinstance(cause, InterpolationResolutionError):
        key = str(cause.full_key)
        return f"{key}{_given(key, overrides)} is not allowed: an interpolation may only name another key"
    if isinstance(cause, ValidationError | ConfigTypeError) and cause.full_key:
        return _wrong_type(cause, overrides)
    if isinstance(cause, ValidationError | ConfigTypeError):  # of a part of a file, which Hydra does not name
        file = re.match(r"In '(.*?)'", str(error))
        return f"{file[1] if file else 'the configuration'} has a list or a word where keys and values are needed"
    return ": ".join(line.strip().rstrip(":") for line in str(error).splitlines()[:2] if line.strip())


def suggest_parameter_paths(name: str, groups: Collection[str]) -> str:
    """Suggest the full paths of a parameter that a user named without its group.

    Args:
        name: Name of the parameter.
        groups: Groups to search.

    Returns:
        `: did you mean robot.thigh?`; empty where no group has the parameter.
    """
    every = {group: [cls] for group, cls in SINGLE_CLASSES.items()} | {
        group: [*own.values()] for group, own in CLASSES_BY_KIND.items()
    }
    found = [
        f"{group}.{name}" for group, own in every.items() if group in groups and any(name in _names(cls) for cls in own)
    ]
    return f": did you mean {' or '.join(found)}?" if found else ""


def _wrong_type(error: OmegaConfBaseException, overrides: list[str]) -> str:
    cls, key = error.object_type, str(error.full_key)
    if f"~{key}" in overrides:
        return f"~{key} is not allowed: a parameter cannot be removed"
    if below := next((o for o in overrides if o.lstrip("+~").startswith(f"{key}.")), None):
        return f"{below} is not allowed: {key} has no parts"
    for member in dataclasses.fields(cls) if dataclasses.is_dataclass(cls) else ():
        if member.name == str(error.key) and isinstance(error, ValidationError):
            try:
                convert_and_check_value(member, error.value, key)
            except InputError as known:
                return str(known)
    hint = typing.get_type_hints(cls).get(str(error.key)) if dataclasses.is_dataclass(cls) else error.ref_type
    found = (one for one in (typing.get_origin(hint), hint, *typing.get_args(hint), cls) if one in TYPE_NAMES)
    return f"{key}{_given(key, overrides)} is not allowed: {TYPE_NAMES.get(next(found, dict))}"


def _given(key: str, overrides: list[str]) -> str:
    """Return ` = value` where the command line sets `key`, else nothing."""
    texts = (o.lstrip("+~").partition("=") for o in overrides)
    return next((f" = {value}" for name, sign, value in texts if sign and name == key), "")
