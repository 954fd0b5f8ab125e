"""Manoeuvres in parts: some stages follow laws of their own, the others the plan."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from sweep.controllers.layers import Now
from sweep.controllers.manoeuvres.balancing.ball import BallDrive, DriveMemory
from sweep.controllers.observation import Observation
from sweep.controllers.plan import Plan, Stage, Support, led_by, reference
from sweep.controllers.tracker import Eventful, Guidance, Guided, TrackerState
from sweep.models.case import Case
from sweep.models.frames import WORLD, koenig
from sweep.models.obstacles.surface import FreeState


class InParts(ABC):
    """Guided in the stages of its parts, and as planned in the others."""

    @property
    @abstractmethod
    def parts(self) -> Mapping[str, Guided]:
        """What guides the stages under each law, by the law's name."""

    def memory(self, belief: Case, plan: Plan) -> dict[str, Any]:
        """The memories of all parts, by law."""
        return {name: part.memory(belief, plan) for name, part in self.parts.items()}

    def guide(self, belief: Case, now: Now, state: TrackerState) -> Guidance:
        """By the part whose stage it is."""
        plan, stage = now.plan, now.stage
        wanted, goal = reference(plan, stage, now.phase, state.feet, state.position), plan.foothold[stage]
        memory = dict(state.memory)
        for name, part in self.parts.items():
            told = part.guide(belief, now, state._replace(memory=state.memory[name]))
            leads, before = led_by(plan, stage, name), (wanted, goal, state.memory[name])
            wanted, goal, memory[name] = jax.tree.map(partial(jnp.where, leads), tuple(told), before)
        return Guidance(wanted, goal, memory)

    def ends(self, belief: Case, plan: Plan, state: TrackerState, seen: Observation) -> Bool[Array, ""]:
        """Where the part says so whose stage it is."""
        over = jnp.asarray(False)
        for name, part in self.parts.items():
            if isinstance(part, Eventful):
                own = state._replace(memory=state.memory[name])
                over = over | (led_by(plan, state.stage, name) & part.ends(belief, plan, own, seen))
        return over


@dataclass(frozen=True)
class Driven(ABC):
    """Tripods that roll a ball by the law of a drive, as many as it needs."""

    drive: BallDrive

    def memory(self, belief: Case, plan: Plan) -> DriveMemory:
        """The memory of the drive."""
        return self.drive.memory(belief, plan)

    def guide(self, belief: Case, now: Now, state: TrackerState) -> Guidance:
        """A tick of the drive's law."""
        return self.led(belief, now.seen.free).guide(belief, now, state)

    def led(self, belief: Case, free: FreeState) -> Guided:
        """The drive, with the place that it goes to."""
        return self.drive

    @abstractmethod
    def arrived(self, belief: Case, free: FreeState) -> Bool[Array, ""]:
        """Whether the ball needs no further step."""

    def ends(self, belief: Case, plan: Plan, state: TrackerState, seen: Observation) -> Bool[Array, ""]:
        """No step is begun where the ball needs none."""
        has_just_begun = state.clock < 0.05 * plan.duration[state.stage]
        return has_just_begun & self.arrived(belief, seen.free)


@dataclass(frozen=True)
class Settling(Driven):
    """Until it is calm, and where it is to be."""

    calm: Array | float  # m/s
    within: Array | float  # m, of the drive's place

    def arrived(self, belief: Case, free: FreeState) -> Bool[Array, ""]:
        """By its place along x, and its speed."""
        near = jnp.abs(free.position[0, 0] - self.drive.place) < self.within
        return near & (jnp.linalg.norm(free.velocity[0]) < self.calm)


class OfBall(NamedTuple):
    """A law for the only ball, on one of several."""

    law: Any  # Guided, and Eventful where it ends stages
    ball: int

    def memory(self, belief: Case, plan: Plan) -> Any:
        """The law's memory, as if there were no other ball."""
        return self.law.memory(belief, plan)

    def guide(self, belief: Case, now: Now, state: TrackerState) -> Guidance:
        """What the law says as if there were no other ball."""
        return self.law.guide(belief, now._replace(seen=self._seen(now.seen)), state)

    def ends(self, belief: Case, plan: Plan, state: TrackerState, seen: Observation) -> Bool[Array, ""]:
        """What the law says as if there were no other ball."""
        return self.law.ends(belief, plan, state, self._seen(seen))

    def stages(self, of_only: Sequence[Stage]) -> list[Stage]:
        """Stages on the only ball, on this one."""

        def of(frame: int) -> int:
            return frame if frame == WORLD else frame + koenig(self.ball) - koenig(0)

        return [
            replace(
                stage,
                foot_frames=tuple(map(of, stage.foot_frames)),
                base_frame=of(stage.base_frame),
                support=(Support(),) * self.ball + stage.support if stage.support else (),
            )
            for stage in of_only
        ]

    def _seen(self, seen: Observation) -> Observation:
        return seen._replace(free=jax.tree.map(lambda x: x[self.ball : self.ball + 1], seen.free))
