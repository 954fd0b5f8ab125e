"""Calibration in physics: what robots with wrong sizes learn when they really go through the poses.

    python bench/calibration.py [key=value ...]     # overrides of the configuration, such as noise=sensors

Robots up to 2 % off in all lengths stand on level ground, hold each pose for a while, and the means over its end are
what calibration estimates from: on the drives as they are, and on soft ones. `computed` is what it learns without
physics, as engines do it. Errors are root mean squares over the robots, of the sizes in %.
"""

import dataclasses
import sys
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd

from sweep.controllers import calibration
from sweep.controllers.calibration import Ground, Measured
from sweep.controllers.manoeuvres.walking.walk import standing
from sweep.controllers.plan import KEEP, SMOOTH, Plan, Stage, assemble
from sweep.core.parameters import choice, parameters, quantity
from sweep.core.rotations import conjugate, exponential, logarithm, multiply
from sweep.engines import devices, prelude
from sweep.engines.base import Trace
from sweep.engines.native import Native
from sweep.models.case import Case
from sweep.models.legs import JOINT_Q, N_LEGS
from sweep.models.obstacles.plane import Plane
from sweep.study.config import compose

ROBOTS, SPREAD = 16, 0.02
SOFT = ("drive.stiffness=1500", "drive.damping=200")
LOADED = 5.0  # N


@parameters
class Poses:
    """Through the poses of calibration, one after the other."""

    goal: ClassVar = {}
    kind: str = choice("poses", "poses")
    move: float = quantity(0.5, "s", above=0)  # from pose to pose
    hold: float = quantity(0.4, "s", above=0)  # in each

    needs = (Plane,)

    def plan(self, belief: Case) -> Plan:
        """Each pose is reached smoothly, and held."""
        length = belief.robot.body_length
        start, _ = standing(belief, 0.3 * length, 0.5 * length)
        position, quat = calibration.poses(belief.control, start)
        turn = logarithm(multiply(quat, conjugate(jnp.roll(quat, 1, axis=0))))
        stages = []
        for k in range(len(position)):
            if k:
                way = {"position": position[k], "turn": turn[k], "pace": SMOOTH}
                stages.append(Stage(f"to{k}", self.move, onset=KEEP, **way))
            stages.append(Stage(f"hold{k}", self.hold, onset=KEEP))
        return assemble(start, stages, 0.0)


def measured(trace: Trace, case: Case, random: np.random.Generator) -> Measured:
    """What sensors make of the end of each hold; biases are not looked at here."""
    noise, samples = case.noise, round(float(case.control.samples))
    ends = [np.flatnonzero(trace.stage == k)[-samples:] for k, n in enumerate(trace.stages) if n.startswith("hold")]
    mean = np.stack([trace.qpos[rows].mean(axis=0) for rows in ends])
    loaded = np.stack([(trace.foot_force[rows, :, 2] > LOADED).all(axis=0) for rows in ends])
    draws = random.standard_normal((len(ends), 24)) / samples**0.5
    angles = mean[:, JOINT_Q] + noise.joint_noise * draws[:, 6:]
    turned = multiply(exponential(jnp.asarray(noise.orientation_noise * draws[:, 3:6])), jnp.asarray(mean[:, 3:7]))
    position = mean[:, :3] + noise.position_noise * draws[:, :3]
    return Measured(jnp.asarray(position), turned, jnp.asarray(angles.reshape(-1, N_LEGS, 3)), jnp.asarray(loaded))


def physics(overrides: list[str], world_of: Case) -> dict[str, float | int]:
    """Errors of what is learned from the simulated poses, and how still the feet stand."""
    exp = compose(["scenario=walk_tripod", "engine=native", *overrides])
    belief = dataclasses.replace(exp.case, manoeuvre=Poses())
    world = dataclasses.replace(belief, robot=world_of.robot)
    engine = Native(dataclasses.replace(exp.settings, width=ROBOTS), belief, belief, exp.thresholds)
    random, slips, off, found = np.random.default_rng(1), [], [], []
    ground = Ground(jnp.zeros(3), jnp.array([0.0, 0.0, 1.0]), jnp.asarray(False))
    learn = jax.jit(lambda seen: calibration.estimate(belief.control, belief.noise, belief.robot, ground, seen).robot)
    for trace in engine.traces(world, belief, np.arange(ROBOTS), 1):
        seen = measured(trace, belief, random)
        holds = [np.flatnonzero(trace.stage == k)[-1] for k, n in enumerate(trace.stages) if n.startswith("hold")]
        places = trace.foot_position[holds, :, :2]
        slips.append(np.linalg.norm(places - places.mean(axis=0), axis=-1))
        off.append(1 - np.mean(seen.loaded))
        found.append(learn(seen))
    slip = np.array(slips)
    return {
        **errors(jax.tree.map(lambda *x: np.array(x), *found), world.robot),
        "slip_mm": 1e3 * float(np.sqrt(np.mean(slip**2) / 2)),  # of one coordinate, as `control.slip`
        "slip_max_mm": 1e3 * float(slip.max()),
        "unloaded_%": 100 * float(np.mean(off)),
    }


def computed(overrides: list[str], world_of: Case) -> dict[str, float]:
    """The same without physics."""
    case = compose(["scenario=walk_tripod", "control=calibrate", *overrides]).case
    world = dataclasses.replace(case, robot=world_of.robot)
    over = (devices.axes(world), None, 0)
    learn = jax.vmap(lambda world, belief, key: prelude.prepared(world, belief, key)[0].robot, in_axes=over)
    args = devices.as_arrays(world), devices.as_arrays(case), devices.keys(np.arange(ROBOTS))
    return errors(jax.jit(learn)(*args), world.robot)


def errors(found, true) -> dict[str, float]:
    """Of the sizes (%)."""
    off = {name: np.asarray(getattr(found, name)) / getattr(true, name) - 1 for name in calibration.names(true)}
    return {f"{name}_%": 100 * float(np.sqrt(np.mean(value**2))) for name, value in off.items()}


def main(overrides: list[str]) -> None:
    """Print the table."""
    case, random = compose(["scenario=walk_tripod"]).case, np.random.default_rng(0)
    sizes = calibration.names(case.robot)
    wrong = {n: getattr(case.robot, n) * random.uniform(1 - SPREAD, 1 + SPREAD, ROBOTS) for n in sizes}
    world = dataclasses.replace(case, robot=dataclasses.replace(case.robot, **wrong))
    before = errors(case.robot, world.robot)
    rows = {"before": before, "drives as they are": physics(overrides, world)}
    rows |= {"soft drives": physics([*overrides, *SOFT], world), "computed": computed(overrides, world)}
    print(pd.DataFrame(rows).T.to_markdown(floatfmt=".3g"))


if __name__ == "__main__":
    devices.configure()
    main(sys.argv[1:])
