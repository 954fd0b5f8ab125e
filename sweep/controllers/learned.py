"""What a robot has found out, and what it does with it: belief, footholds and plan as they are by now."""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from sweep.controllers import touch
from sweep.controllers.calibration import Calibrated
from sweep.controllers.layers import Feedforward, HeldLegs
from sweep.controllers.observation import Observation
from sweep.controllers.plan import Plan, ends
from sweep.controllers.posture import joint_targets
from sweep.controllers.touch import Touched
from sweep.controllers.tracker import TrackerState
from sweep.models.case import Case
from sweep.models.frames import fixed
from sweep.models.obstacles.surface import Obstacle, free_start, landmarks


class Learned(NamedTuple):
    """What the robot has found out; None where it does not look."""

    calibrated: Calibrated | None = None
    touched: Touched | None = None
    plan: Plan | None = None  # the newest, where it plans again
    # m, by how much what is left of it leaves the legs' reach; infinite where there is no plan for what is known
    shortfall: Float[Array, ""] | None = None


def informed(belief: Case, learned: Learned) -> Case:
    """What is believed with what was learned, to plan and act by."""
    robot = learned.calibrated.robot if learned.calibrated else belief.robot
    obstacle = touch.planned_for(learned.touched) if learned.touched else belief.obstacle
    return replace(belief, robot=robot, obstacle=obstacle)


def at_first(belief: Case, learned: Learned) -> Obstacle:
    """The obstacle as the first plan was made for: it has the axes of free bodies in which plans are given."""
    return learned.touched.first if learned.touched else belief.obstacle


def felt(
    world: Case,
    belief: Case,
    plan: Plan,
    state: TrackerState,
    learned: Learned,
    seen: Observation,
    period: float,
) -> tuple[TrackerState, Plan, Float[Array, "6 3"] | None, Learned]:
    """Footholds, plan, how far those of swings are beside it (m), and what is known, after a tick of touching.

    `belief` and `plan` are those of the start.
    """
    now = learned.plan or plan
    if learned.touched is None or not touch.by_feet(belief.obstacle):
        return state, now, None, learned
    ground = touch.planned_on(learned.touched, plan, state.stage)
    robot = informed(belief, learned).robot
    known = world.control, belief.noise, robot, now, ground
    touched, moves, searches = touch.felt(*known, state, learned.touched, seen, period)
    swings = now.swing[state.stage]
    beside = jnp.where(swings[:, None], moves, 0.0)
    patience = jnp.where(jnp.any(searches & swings), jnp.inf, now.patience)
    # with planned forces, those that bear load are anchored where they stand
    goes = ~swings if plan.layer(Feedforward) is None else ~swings & ~seen.loaded
    state = state._replace(feet=state.feet + jnp.where(goes[:, None], moves, 0.0))
    return state, replace(now, patience=patience), beside, learned._replace(touched=touched)


def replanned(belief: Case, plan: Plan, stage: Int[Array, ""], learned: Learned) -> Learned:
    """What is left of the way after `stage` planned by what is known; as it was where there is no such plan.

    Planned forces stay: they are dear to work out, and sizes that differ by a per cent change them by about as much.
    """
    old = learned.plan or plan
    known = informed(belief, learned)
    fresh = replace(known.manoeuvre.plan(known), start=old.start)
    if (forces := old.layer(Feedforward)) is not None:
        fresh = fresh.with_layer(forces)
    there_is = jnp.all(jnp.stack([jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(fresh)]))
    left = jnp.arange(plan.duration.shape[0]) > stage
    shortfall = jnp.where(there_is, jnp.max(jnp.where(left, _shortfall(known, fresh), 0.0)), jnp.inf)
    later = there_is & left

    def chosen(a: Array, b: Array) -> Array:
        staged = a.ndim and a.shape[0] == later.shape[0]
        return jnp.where(later.reshape(-1, *[1] * (a.ndim - 1)), a, b) if staged else b

    fresh = _shifted(fresh, landmarks(at_first(belief, learned)) - landmarks(known.obstacle))
    newer = replace(jax.tree.map(chosen, fresh, old), start=old.start)
    return learned._replace(plan=newer, shortfall=shortfall)


def _shifted(plan: Plan, by: Float[Array, "k 3"]) -> Plan:
    """`plan` with what it gives in free bodies' own axes moved by `by` (m)."""

    def off(frame: Array) -> Array:
        return sum(((frame == fixed(k))[..., None] * by[k] for k in range(by.shape[0])), jnp.zeros(3))

    feet, base = off(plan.foot_frame), off(plan.base_frame)
    curve = plan.curve._replace(guides=plan.curve.guides + feet[..., None, :])
    way = plan.way._replace(pivot=plan.way.pivot + base)
    return replace(plan, foothold=plan.foothold + feet, curve=curve, position=plan.position + base, way=way)


def _shortfall(belief: Case, plan: Plan) -> Float[Array, " s"]:
    """How far the worst foot is out of reach (m) at the end of each stage, free bodies being where they start."""
    last = ends(plan, free_start(belief.obstacle))
    out = jax.vmap(lambda stance: joint_targets(belief.robot, stance)[1])(last)
    legs = plan.layer(HeldLegs)
    return jnp.max(out if legs is None else jnp.where(legs.held, 0.0, out), axis=1)
