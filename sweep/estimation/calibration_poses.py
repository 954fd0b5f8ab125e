"""Manoeuvre that moves the base through the poses of a calibration before another manoeuvre starts."""

from dataclasses import replace
from typing import ClassVar

import jax.numpy as jnp

from sweep.controllers.plan import KEEP, SMOOTH, Plan, Stage
from sweep.core.parameters import choice, parameters
from sweep.core.rotations import conjugate, logarithm, multiply
from sweep.estimation import calibration
from sweep.manoeuvres.goals import ON_ITS_FEET
from sweep.models.case import Case, Manoeuvre
from sweep.planning.compile_plan import compile_plan

MOVE, HOLD = 1.0, 0.6  # s, from one pose to the next, and at rest in each; soft drives lag by 0.14 s


@parameters
class CalibrationPoses(Manoeuvre):
    """Manoeuvre that moves the base through the calibration poses, with all feet standing, and back to the start."""

    goal: ClassVar = ON_ITS_FEET
    next_manoeuvre: Manoeuvre  # manoeuvre that follows, in whose start stance the robot stands
    kind: str = choice("poses", "poses")

    def plan(self, belief: Case) -> Plan:
        """Return the plan that moves the base through all calibration poses, with all feet standing."""
        start = self.next_manoeuvre.plan(replace(belief, manoeuvre=self.next_manoeuvre)).start
        position, quat = calibration.base_poses(belief.control, start)
        turn = logarithm(multiply(jnp.roll(quat, -1, axis=0), conjugate(quat)))
        stages = []
        for k in range(len(position)):
            stages.append(Stage(f"calibrate.hold{k}", HOLD, onset=KEEP))
            following = (k + 1) % len(position)
            path = {"position": position[following], "turn": turn[k], "pace": SMOOTH}
            stages.append(Stage(f"calibrate.to{following}", MOVE, onset=KEEP, **path))
        stages.append(Stage("calibrate.rest", HOLD, onset=KEEP))
        return compile_plan(start, stages, 0.0)


def held_pose_index(time: float) -> int:
    """Return the index of the calibration pose held still at `time` (s), in the second half of its rest; else -1."""
    pose, since = divmod(time, MOVE + HOLD)
    return int(pose) if HOLD / 2 < since <= HOLD else -1
