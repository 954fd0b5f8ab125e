"""Manoeuvres in parts: each stage follows the feedback law that it names, or the plan if it names none."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from sweep.controllers.layers import TickContext
from sweep.controllers.observation import Observation
from sweep.controllers.plan import Plan, Stage, SupportMotion, is_guided_by_law, reference_stance
from sweep.controllers.tracker import FeedbackLaw, Guidance, TrackerState
from sweep.manoeuvres.balancing.ball import BallDrive, DriveMemory
from sweep.models.case import Case, Manoeuvre
from sweep.models.frames import WORLD_FRAME, koenig_frame_number
from sweep.models.obstacles.surface import FreeBodyState


class FeedbackLawManoeuvre(Manoeuvre, ABC):
    """Base class of manoeuvres whose stages each name the feedback law that guides them, or else follow the plan."""

    @property
    @abstractmethod
    def feedback_laws(self) -> Mapping[str, FeedbackLaw]:
        """Feedback laws that guide stages, by the name that stages of the plan use for them."""

    def init_memory(self, belief: Case, plan: Plan) -> dict[str, Any]:
        """Return the states of all feedback laws before the first tick, by name."""
        return {name: part.init_memory(belief, plan) for name, part in self.feedback_laws.items()}

    def guide(self, belief: Case, ctx: TickContext, state: TrackerState) -> Guidance:
        """Return the stance to command: from the feedback law of the current stage, else from the plan."""
        plan, stage = ctx.plan, ctx.stage
        stance, goal = reference_stance(plan, stage, ctx.phase, state.feet, state.position), plan.foothold[stage]
        memory = dict(state.memory)
        for name, part in self.feedback_laws.items():
            guidance = part.guide(belief, ctx, state._replace(memory=state.memory[name]))
            leads, unchanged = is_guided_by_law(plan, stage, name), (stance, goal, state.memory[name])
            stance, goal, memory[name] = jax.tree.map(partial(jnp.where, leads), tuple(guidance), unchanged)
        return Guidance(stance, goal, memory)

    def is_stage_over(self, belief: Case, plan: Plan, state: TrackerState, obs: Observation) -> Bool[Array, ""]:
        """Return whether the feedback law of the current stage ends that stage."""
        is_over = jnp.asarray(False)
        for name, part in self.feedback_laws.items():
            if part.ends_stages:
                part_state = state._replace(memory=state.memory[name])
                is_over = is_over | (
                    is_guided_by_law(plan, state.stage, name) & part.is_stage_over(belief, plan, part_state, obs)
                )
        return is_over


@dataclass(frozen=True)
class DriveUntilArrivalLaw(ABC):
    """Base class of feedback laws that roll a ball step by step until it has arrived."""

    drive: BallDrive
    ends_stages: ClassVar = True

    def init_memory(self, belief: Case, plan: Plan) -> DriveMemory:
        """Return the state of the ball-rolling law before the first tick."""
        return self.drive.init_memory(belief, plan)

    def guide(self, belief: Case, ctx: TickContext, state: TrackerState) -> Guidance:
        """Return the stance in which the robot rolls the ball in this tick."""
        return self.drive_law(belief, ctx.obs.free).guide(belief, ctx, state)

    def drive_law(self, belief: Case, free: FreeBodyState) -> FeedbackLaw:
        """Return the law that rolls the ball, with the position at which the ball is to stop."""
        return self.drive

    @abstractmethod
    def has_arrived(self, belief: Case, free: FreeBodyState) -> Bool[Array, ""]:
        """Return whether the ball has arrived and needs no further step."""

    def is_stage_over(self, belief: Case, plan: Plan, state: TrackerState, obs: Observation) -> Bool[Array, ""]:
        """Return whether the step that is about to start can be skipped because the ball has arrived."""
        has_just_begun = state.clock < 0.05 * plan.duration[state.stage]
        return has_just_begun & self.has_arrived(belief, obs.free)


@dataclass(frozen=True)
class SettleBallLaw(DriveUntilArrivalLaw):
    """Feedback law that drives a ball until it is nearly at rest at its goal."""

    calm: Array | float  # m/s, largest speed of a calm ball
    within: Array | float  # m, of the drive's place

    def has_arrived(self, belief: Case, free: FreeBodyState) -> Bool[Array, ""]:
        """Return whether the ball is near its goal along x, and nearly at rest."""
        near = jnp.abs(free.position[0, 0] - self.drive.place) < self.within
        return near & (jnp.linalg.norm(free.velocity[0]) < self.calm)


@dataclass(frozen=True)
class SingleBallLawAdapter:
    """Feedback law written for an obstacle with a single ball, applied to one ball of several."""

    law: FeedbackLaw
    ball: int  # index of the ball
    ends_stages: ClassVar = True

    def init_memory(self, belief: Case, plan: Plan) -> Any:
        """Return the wrapped law's state before the first tick."""
        return self.law.init_memory(belief, plan)

    def guide(self, belief: Case, ctx: TickContext, state: TrackerState) -> Guidance:
        """Return the stance that the wrapped law commands in one tick as if there were no other ball."""
        return self.law.guide(belief, ctx._replace(obs=self._obs_of_ball(ctx.obs)), state)

    def is_stage_over(self, belief: Case, plan: Plan, state: TrackerState, obs: Observation) -> Bool[Array, ""]:
        """Return whether the wrapped law ends the stage, as if there were no other ball."""
        return self.law.is_stage_over(belief, plan, state, self._obs_of_ball(obs))

    def retarget_stages(self, single_ball_stages: Sequence[Stage]) -> list[Stage]:
        """Return plan stages made for a single ball, with their coordinate frames changed to one ball of several."""

        def frame_on_ball(frame: int) -> int:
            return frame if frame == WORLD_FRAME else frame + koenig_frame_number(self.ball) - koenig_frame_number(0)

        return [
            replace(
                stage,
                foot_frames=tuple(map(frame_on_ball, stage.foot_frames)),
                base_frame=frame_on_ball(stage.base_frame),
                support=(SupportMotion(),) * self.ball + stage.support if stage.support else (),
            )
            for stage in single_ball_stages
        ]

    def _obs_of_ball(self, obs: Observation) -> Observation:
        return obs._replace(free=jax.tree.map(lambda x: x[self.ball : self.ball + 1], obs.free))
