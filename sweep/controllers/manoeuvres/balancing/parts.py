"""Manoeuvres in parts: some stages follow laws of their own, the others the plan."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from sweep.controllers.layers import TickContext
from sweep.controllers.manoeuvres.balancing.ball import BallDrive, DriveMemory
from sweep.controllers.observation import Observation
from sweep.controllers.plan import Plan, Stage, Support, is_under_law, reference_stance
from sweep.controllers.tracker import EndsStages, Guidance, Guided, TrackerState
from sweep.models.case import Case
from sweep.models.frames import WORLD, koenig
from sweep.models.obstacles.surface import FreeState


class ByParts(ABC):
    """Guided in the stages of its parts, and as planned in the others."""

    @property
    @abstractmethod
    def parts(self) -> Mapping[str, Guided]:
        """What guides the stages under each law, by the law's name."""

    def init_memory(self, belief: Case, plan: Plan) -> dict[str, Any]:
        """The memories of all parts, by law."""
        return {name: part.init_memory(belief, plan) for name, part in self.parts.items()}

    def guide(self, belief: Case, ctx: TickContext, state: TrackerState) -> Guidance:
        """By the part whose stage it is."""
        plan, stage = ctx.plan, ctx.stage
        wanted, goal = reference_stance(plan, stage, ctx.phase, state.feet, state.position), plan.foothold[stage]
        memory = dict(state.memory)
        for name, part in self.parts.items():
            guidance = part.guide(belief, ctx, state._replace(memory=state.memory[name]))
            leads, unchanged = is_under_law(plan, stage, name), (wanted, goal, state.memory[name])
            wanted, goal, memory[name] = jax.tree.map(partial(jnp.where, leads), tuple(guidance), unchanged)
        return Guidance(wanted, goal, memory)

    def is_stage_over(self, belief: Case, plan: Plan, state: TrackerState, obs: Observation) -> Bool[Array, ""]:
        """Where the part says so whose stage it is."""
        over = jnp.asarray(False)
        for name, part in self.parts.items():
            if isinstance(part, EndsStages):
                part_state = state._replace(memory=state.memory[name])
                over = over | (
                    is_under_law(plan, state.stage, name) & part.is_stage_over(belief, plan, part_state, obs)
                )
        return over


@dataclass(frozen=True)
class DriveUntil(ABC):
    """Tripods that roll a ball by the law of a drive, as many as it needs."""

    drive: BallDrive

    def init_memory(self, belief: Case, plan: Plan) -> DriveMemory:
        """The memory of the drive."""
        return self.drive.init_memory(belief, plan)

    def guide(self, belief: Case, ctx: TickContext, state: TrackerState) -> Guidance:
        """A tick of the drive's law."""
        return self.drive_law(belief, ctx.obs.free).guide(belief, ctx, state)

    def drive_law(self, belief: Case, free: FreeState) -> Guided:
        """The drive, with the place that it goes to."""
        return self.drive

    @abstractmethod
    def has_arrived(self, belief: Case, free: FreeState) -> Bool[Array, ""]:
        """Whether the ball needs no further step."""

    def is_stage_over(self, belief: Case, plan: Plan, state: TrackerState, obs: Observation) -> Bool[Array, ""]:
        """No step is begun where the ball needs none."""
        has_just_begun = state.clock < 0.05 * plan.duration[state.stage]
        return has_just_begun & self.has_arrived(belief, obs.free)


@dataclass(frozen=True)
class SettleBall(DriveUntil):
    """Until it is calm, and where it is to be."""

    calm: Array | float  # m/s
    within: Array | float  # m, of the drive's place

    def has_arrived(self, belief: Case, free: FreeState) -> Bool[Array, ""]:
        """By its place along x, and its speed."""
        near = jnp.abs(free.position[0, 0] - self.drive.place) < self.within
        return near & (jnp.linalg.norm(free.velocity[0]) < self.calm)


class SingleBallLaw(NamedTuple):
    """A law for the only ball, on one of several."""

    law: Any  # Guided, and Eventful where it ends stages
    ball: int

    def init_memory(self, belief: Case, plan: Plan) -> Any:
        """The law's memory, as if there were no other ball."""
        return self.law.init_memory(belief, plan)

    def guide(self, belief: Case, ctx: TickContext, state: TrackerState) -> Guidance:
        """What the law says as if there were no other ball."""
        return self.law.guide(belief, ctx._replace(obs=self._obs_of_ball(ctx.obs)), state)

    def is_stage_over(self, belief: Case, plan: Plan, state: TrackerState, obs: Observation) -> Bool[Array, ""]:
        """What the law says as if there were no other ball."""
        return self.law.is_stage_over(belief, plan, state, self._obs_of_ball(obs))

    def stages_on_ball(self, single_ball_stages: Sequence[Stage]) -> list[Stage]:
        """Stages on the only ball, on this one."""

        def frame_on_ball(frame: int) -> int:
            return frame if frame == WORLD else frame + koenig(self.ball) - koenig(0)

        return [
            replace(
                stage,
                foot_frames=tuple(map(frame_on_ball, stage.foot_frames)),
                base_frame=frame_on_ball(stage.base_frame),
                support=(Support(),) * self.ball + stage.support if stage.support else (),
            )
            for stage in single_ball_stages
        ]

    def _obs_of_ball(self, obs: Observation) -> Observation:
        return obs._replace(free=jax.tree.map(lambda x: x[self.ball : self.ball + 1], obs.free))
