"""An own model with an own controller: any that MuJoCo compiles, and any function that JAX traces.

Paths are `model.<kind>.<name>.<field>[.component]` (see `fields`), `noise.white`, `noise.bias`, `noise.delay`, and
`controller.<name>` for what its module has in `PARAMETERS`.
"""

import dataclasses
import hashlib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from sweep.core import provenance
from sweep.core.errors import InputError, suggest
from sweep.core.parameters import build, checked, quantity
from sweep.engines.base import Engine
from sweep.engines.settings import EngineSettings
from sweep.systems.base import Kinds, Nominal, Parameter, Values, Way, by_side, side_and_path
from sweep.systems.own import fields, figures, files, outcome
from sweep.systems.own.native import Native, substeps
from sweep.systems.own.outcome import Condition
from sweep.systems.own.subject import About, Noise, Side, Subject

if TYPE_CHECKING:
    import pandas as pd

SET = ("name", "width", "control_period")  # what an own model's engine has of the settings


@dataclass(frozen=True)
class Own(Subject):
    """A model and its controller: a `System`."""

    conditions: tuple[Condition, ...] = ()

    case = Side()
    groups = ("model", "controller", "noise")
    doubts = tuple(outcome.DOUBTS)
    silent = frozenset(figures.SILENT)
    undrawn = "rollouts of an own model are not drawn: replay compares figures, study.keep keeps its states"

    @property
    def causes(self) -> dict[str, str]:
        """See `System`."""
        return {one.cause: one.sentence for one in self.conditions} | outcome.DOUBTS

    @property
    def recorded(self) -> tuple[str, ...]:
        """See `System`."""
        return tuple(self.record(self.model.qpos0[None], np.zeros((1, self.model.nv))))

    @property
    def ways(self) -> dict[str, Way]:
        """See `System`."""
        return {"again": Way("as before, in batches of another width", lambda s: s)}

    def words(self, settings: EngineSettings) -> dict[str, str]:
        """See `System`."""
        about = {"model": self.about.mjcf, "controller": self.about.controller, "engine": settings.name}
        return {**about, "step": f"{1000 * self.model.opt.timestep:g} ms"}

    def parameter(self, column: str, settings: EngineSettings) -> Parameter:
        """See `System`."""
        path = side_and_path(column)[1]
        root, _, name = path.partition(".")
        if root == "engine":
            raise InputError(f"axis {column} cannot be varied: an own model has the engine native alone")
        if root == "noise":
            known = {f.name: f for f in dataclasses.fields(Noise)}
            if name not in known:
                raise InputError(f"axis {column} names nothing: {name} is unknown{suggest(name, known)}")
            bounds = {key: known[name].metadata[key] for key in ("unit", "above", "at_least", "at_most")}
            return quantity(self.noise[path], bounds.pop("unit"), **bounds)
        if root == "controller":
            if path not in dict(self.numbers):
                known = list(self.controller.parameters)
                raise InputError(f"axis {column} names nothing: {name} is unknown{suggest(name, known)}")
            return quantity(dict(self.numbers)[path], "")
        if root != "model":
            raise InputError(f"axis {column} names nothing: {root} is unknown{suggest(root, self.groups)}")
        return fields.parameter(self.model, path)

    def nominal(self, column: str, settings: EngineSettings) -> Any:
        """See `System`."""
        return self.parameter(column, settings).default

    def inputs(self, paths: Sequence[str]) -> Iterator[tuple[str, Any]]:
        """See `System`: the model as a whole, and what is varied of it."""
        yield from self.errors
        yield from self.numbers
        yield "model", self.about.content
        yield "model.rollout", repr((self.about.period, self.about.duration, self.about.keyframe, self.about.observe))
        yield from self.unsaid(paths)

    def unsaid(self, paths: Sequence[str]) -> Iterator[tuple[str, Any]]:
        """See `System`: a model's number that is varied counts where it is not that of the model."""
        yield from ((path, self._default(path)) for path in paths if path.startswith("model."))

    def check(self, table: "pd.DataFrame", settings: EngineSettings) -> None:
        """See `System`: whether the controller is one, too."""
        Native(self, settings)

    def random(self, rows: "pd.DataFrame", settings: EngineSettings) -> np.ndarray:
        """See `System`: a controller may draw, too."""
        return np.ones(len(rows), dtype=bool)

    def sides(self, values: Values) -> tuple[Side, Side]:
        """See `System`."""
        world, belief = (Side(tuple(own.items())) for own in by_side(values).values())
        return world, belief

    def with_room(self, table: "pd.DataFrame") -> "Own":
        """See `System`."""
        columns = [c for c in table.columns if side_and_path(c)[1] == "noise.delay"]
        longest = max([self.noise["noise.delay"], *(table[c].max() for c in columns)])
        return replace(self, room=math.ceil(longest))

    def engine(self, settings: EngineSettings, world: Side, belief: Side, limits: Any) -> Engine:
        """See `System`."""
        return Native(self, settings)

    def device(self, settings: EngineSettings) -> str:
        """See `System`."""
        return f"cpu, {provenance.processor()}"

    def run_id(self, settings: EngineSettings) -> str:
        """See `System`: nothing of width or threads changes bits."""
        here = (replace(settings, width=0), self.device(settings), provenance.code_version(), _content(self))
        return hashlib.blake2b(repr(here).encode(), digest_size=6).hexdigest()

    def judge(
        self, figures: Mapping[str, np.ndarray], limits: tuple[Condition, ...], stages: Sequence[str]
    ) -> dict[str, np.ndarray]:
        """See `System`."""
        return outcome.judge(figures, limits)

    def thresholds(self, limits: tuple[Condition, ...]) -> dict[str, float]:
        """See `System`."""
        return {one.limit[0]: one.limit[1] for one in limits if one.limit}

    def why(self, row: Mapping[str, Any], limits: tuple[Condition, ...]) -> str:
        """See `System`."""
        for one in limits:
            if one.cause == row["cause"] and one.limit:
                return f"{one.sentence} ({one.limit[0]} {float(row[one.limit[0]]):.4g})"
        return self.causes.get(str(row["cause"]), "")


def nominal(values: Mapping[str, Any], kinds: Kinds) -> Nominal:
    """See `sweep.systems.nominal`."""
    given = {**values["model"]}
    for key in ("observe", "feet"):
        if isinstance(given.get(key, ()), str) or not all(isinstance(one, str) for one in given.get(key, ())):
            raise InputError(f"model.{key} = {given[key]!r} is not allowed: a list of names")
        given[key] = tuple(given.get(key, ()))
    about = build(About, {key: value for key, value in given.items() if value is not None}, "model")
    noise = build(Noise, values.get("noise") or {}, "noise")
    settings = build(EngineSettings, values["engine"], "engine")
    if settings.name != "native":
        raise InputError(f"engine.name = {settings.name} is not allowed: native, which is what an own model runs on")
    usual = EngineSettings()
    for field in dataclasses.fields(usual):
        if field.name not in SET and getattr(settings, field.name) != getattr(usual, field.name):
            raise InputError(f"engine.{field.name} is not allowed: the model's file says how it is simulated")
    errors = tuple((f"noise.{f.name}", getattr(noise, f.name)) for f in dataclasses.fields(noise))
    own = Own(about, errors, ())
    model, control = own.model, own.controller
    substeps(model, about.period)
    _ = own.seen  # refuses unknown names
    keys = [model.key(k).name for k in range(model.nkey)]
    if about.keyframe and about.keyframe not in keys:
        raise InputError(f"model.keyframe = {about.keyframe} is unknown{suggest(about.keyframe, keys)}")
    for name in about.feet:
        if model.sensor_type[own._sensor("feet", name)] != int(mujoco.mjtSensor.mjSENS_TOUCH):
            raise InputError(f"model.feet: {name} is no touch sensor")
    asked = values.get("controller") or {}
    for name in asked:
        if name not in control.parameters:
            raise InputError(f"controller.{name} is unknown{suggest(str(name), control.parameters)}")
    numbers = {name: checked(quantity(0.0, ""), value, f"controller.{name}")
               for name, value in {**control.parameters, **asked}.items()}  # fmt: skip
    conditions = outcome.parse(values.get("outcome") or {}, figures.names(model, own.base, own.feet))
    own = replace(own, numbers=tuple((f"controller.{k}", v) for k, v in numbers.items()), conditions=conditions)
    about = replace(about, content=about.content or _content(own))
    told = {"model": {**values["model"], "content": about.content}}
    return Nominal(replace(own, about=about), replace(settings, control_period=about.period), conditions, told)


def _content(own: Own) -> str:
    return f"{files.digest(own.model)}-{own.controller.digest}"
