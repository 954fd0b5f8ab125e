"""A controller of a user's own, as one program of a fixed shape that is called tile by tile.

XLA gives other last bits at other widths, and at other places of one, so that a row would depend on what runs beside
it. A tile never changes, and goes through its rollouts by the same instructions one after the other; a controller of
NumPy's is called with a whole tile, whose width never changes.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from sweep.core.errors import InputError
from sweep.engines import devices
from sweep.systems.own.files import Controller

TILE = 64
Belief = Mapping[str, Any]


def _each(function: Callable[..., Any], *rows: Any) -> Any:
    """What `function` gives of each row."""
    return jax.lax.map(lambda row: function(*row), rows)


def _drawn(key: Array, like: Array) -> Array:
    """Normal numbers, the same in any precision."""
    return jax.random.normal(key, like.shape, jnp.float32).astype(like.dtype)


class Programs:
    """A controller for any number of rollouts. Raises `InputError` where it is none.

    `begin(belief, key) -> (start, state, duration)`: positions (nq,) and seconds, or None for the model's own.
    `policy(belief, observation, state, key) -> (ctrl, state)`: once a tick, of an observation (k,), controls (nu,).
    One that is `batched` is `policy(observations) -> ctrl`, of NumPy's (n, k) and (n, nu).
    """

    def __init__(self, name: str, control: Controller, belief: Belief, sizes: tuple[int, int, int], room: int):
        self._name, self._room = name, room
        self._begin = control.begin or (lambda belief, key: (None, (), None))
        self._policy, self._figures = control.policy, control.figures
        each = self.begin_one, self.enter_one, self.finish_one
        self.first, self.enter, self.finish = (jax.jit(partial(_each, one)) for one in each)
        if control.batched:
            seen, self._controls, _ = sizes
            self._controlled(np.zeros((TILE, seen), jnp.zeros(0).dtype))
            self._tell = jax.jit(partial(_each, lambda *row: self.told_one(*row)[:2]), donate_argnums=(1,))
            self.tick = self._tick_batched
        else:
            self._check(belief, control.measured, *sizes)
            self.tick = jax.jit(partial(_each, self.tick_one), donate_argnums=(1,))

    def begin_one(self, given: Mapping[str, Any]) -> tuple[Any, Any, Any]:
        """Start, state and duration of one rollout."""
        return self._begin(given["belief"], jax.random.fold_in(jax.random.wrap_key_data(given["key"]), 0))

    def enter_one(self, given: Mapping[str, Any], state: Any, seen: Array) -> dict[str, Any]:
        """What one rollout carries from tick to tick, of its `state` and what is seen (k,) at first."""
        key = jax.random.fold_in(jax.random.wrap_key_data(given["key"]), 1)
        bias = given["bias"] * _drawn(key, seen)
        return {"state": state, "late": jnp.tile(seen, (self._room + 1, 1)), "bias": bias, "tick": jnp.int32(0)}

    def told_one(self, given: Mapping[str, Any], carried: Any, seen: Array) -> tuple[Array, Any, Array]:
        """What one rollout's controller is told (k,) of what is seen (k,), what is carried on, and a key of its own."""
        tick = carried["tick"]
        own, noise = jax.random.split(jax.random.fold_in(jax.random.wrap_key_data(given["key"]), 2 + tick))
        late = jnp.concatenate([seen[None], carried["late"][:-1]])
        told = late[given["delay"]] + carried["bias"] + given["white"] * _drawn(noise, seen)
        return told, {**carried, "late": late, "tick": tick + 1}, own

    def tick_one(self, given: Mapping[str, Any], carried: Any, seen: Array) -> tuple[Array, Any]:
        """Controls (nu,) of one rollout, and what it carries on, after what is seen (k,)."""
        told, carried, own = self.told_one(given, carried, seen)
        ctrl, state = self._policy(given["belief"], told, carried["state"], own)
        return ctrl, {**carried, "state": state}

    def finish_one(self, given: Mapping[str, Any], carried: Any) -> dict[str, Array]:
        """The controller's own figures of one rollout, by name."""
        return self._figures(given["belief"], carried["state"]) if self._figures else {}

    def _tick_batched(self, given: Mapping[str, Any], carried: Any, seen: np.ndarray) -> tuple[np.ndarray, Any]:
        told, carried = self._tell(given, carried, seen)
        return self._controlled(np.array(told)), carried

    def _controlled(self, told: np.ndarray) -> np.ndarray:
        """Controls (n, nu) of a batched controller that is told (n, k)."""
        try:
            ctrl = np.asarray(self._policy(told))
        except InputError:
            raise
        except Exception as error:
            raise self._fails(error) from None
        if ctrl.shape != (len(told), self._controls) or ctrl.dtype.kind not in "fiu":
            wanted = f"numbers ({len(told)}, {self._controls}) are wanted of ({len(told)}, {told.shape[1]})"
            raise InputError(f"model.controller = {self._name} gives {ctrl.dtype} {ctrl.shape}: {wanted}")
        return ctrl

    def _fails(self, error: Exception) -> InputError:
        """Whatever a user's function raises, in one line."""
        reason = (str(error).splitlines() or [""])[0]
        return InputError(f"model.controller = {self._name} fails: {type(error).__name__}: {reason}")

    def _check(self, belief: Belief, measured: Collection[str], seen: int, controls: int, positions: int) -> None:
        key = jax.random.key(0)
        try:
            start, state, _ = jax.eval_shape(self._begin, belief, key)
            ctrl, after = jax.eval_shape(self._policy, belief, jnp.zeros(seen), state, key)
            found = jax.eval_shape(self._figures, belief, after) if self._figures else {}
        except InputError:
            raise
        except Exception as error:
            raise self._fails(error) from None
        forms = [jax.tree.map(lambda x: (x.shape, x.dtype), tree) for tree in (state, after)]
        if getattr(ctrl, "shape", None) != (controls,):
            shape = getattr(ctrl, "shape", type(ctrl).__name__)
            raise InputError(f"model.controller = {self._name} gives controls {shape}: ({controls},) are wanted")
        if forms[0] != forms[1]:
            raise InputError(f"model.controller = {self._name} gives a state of another form than it was given")
        if {*found} != {*measured} or any(one.shape for one in found.values()):
            has = ", ".join(f"{name} {one.shape}" for name, one in found.items())
            raise InputError(f"model.controller = {self._name} has figures {has}: numbers are wanted, named in FIGURES")
        if start is not None and start.shape != (positions,):
            raise InputError(f"model.controller = {self._name} begins at {start.shape}: ({positions},) are wanted")


class Rollouts:
    """The controllers of n rollouts, in whole tiles of which the last repeats the last rollout; `given` by row."""

    def __init__(self, programs: Programs, given: Mapping[str, Any], n: int):
        self._programs, self._n = programs, n
        self._rows = np.minimum(np.arange(-(-self._n // TILE) * TILE), self._n - 1).reshape(-1, TILE)
        self._given = [jax.device_put(jax.tree.map(lambda x, r=r: np.asarray(x)[r], given)) for r in self._rows]
        starts, states, durations = zip(*map(programs.first, self._given), strict=True)
        self._carried = [*states]
        self.start, self.duration = self._joined(starts), self._joined(durations)

    def enter(self, seen: np.ndarray) -> None:
        """Begin with what is seen (n, k)."""
        each = zip(self._given, self._carried, self._rows, strict=True)
        self._carried = [self._programs.enter(given, state, seen[rows]) for given, state, rows in each]

    def tick(self, seen: np.ndarray) -> np.ndarray:
        """Controls (n, nu) after what is seen (n, k) at the next tick."""
        parts = []
        for k, rows in enumerate(self._rows):
            ctrl, self._carried[k] = self._programs.tick(self._given[k], self._carried[k], seen[rows])
            parts.append(ctrl)
        return self._joined(parts)

    def finish(self) -> dict[str, np.ndarray]:
        """The controllers' own figures, (n,) by name."""
        parts = [self._programs.finish(*one) for one in zip(self._given, self._carried, strict=True)]
        return {name: self._joined([one[name] for one in parts]) for name in parts[0]}

    def _joined(self, parts: Sequence[Any]) -> Any:
        return None if parts[0] is None else np.concatenate([np.asarray(one) for one in parts])[: self._n].astype(float)


def keys(streams: np.ndarray) -> np.ndarray:
    """Data of a key for each rollout, from its stream alone."""
    return np.asarray(jax.random.key_data(devices.keys(streams)))
