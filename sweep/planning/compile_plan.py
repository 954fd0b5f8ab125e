"""Compilation of a list of stages into the arrays that the tracker follows."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array

from sweep.controllers.flywheel import FlywheelGains, MiddleLegFlywheel
from sweep.controllers.frames import stance_to_frame, stance_to_world
from sweep.controllers.layers import GradualFootholds, JointSpaceLegs
from sweep.controllers.plan import BasePaths, Plan, Stage, SupportMotion, SwingCurves
from sweep.controllers.reference_body_motion import FreeBodyReferenceMotion
from sweep.core.rotations import exponential, multiply
from sweep.models.legs import LEGS
from sweep.models.obstacles.surface import FreeBodyState
from sweep.models.posture import Stance


def compile_plan(
    start: Stance, stages: Sequence[Stage], patience: Array | float, gains: FlywheelGains | None = None,
    steered: bool = False, ease: Array | float | None = None, free: FreeBodyState | None = None, afloat: bool = False,
) -> Plan:  # fmt: skip
    """Compile a list of stages into a plan, the arrays that the tracker follows.

    Args:
        start: stance at the start, world axes.
        stages: the stages in order.
        patience: longest wait for the touchdown of swinging feet (s).
        gains: gains of the flywheel; None: there is none.
        steered: whether base errors are corrected in the plane and in heading only.
        ease: time (s) in which feet move over to new footholds; None: at once.
        free: free bodies at the start. If given, feet and base that no stage moves keep their place in the world when
            their frame changes; otherwise they keep their coordinates in the new frame.
        afloat: whether the free bodies float.
    """
    rows, (feet, position, quat) = [], start
    before = Stage("start", 0.0)
    for stage in stages:
        if free is not None and _moves_frames(before, stage):
            old_frames, new_frames = (
                (jnp.array(s.foot_frames, jnp.int32), jnp.int32(s.base_frame)) for s in (before, stage)
            )
            world = stance_to_world(Stance(feet, position, quat), *old_frames, free)
            feet, position, quat = stance_to_frame(world, *new_frames, free)
        before = stage
        swing = jnp.array([leg in stage.swing for leg in LEGS])
        guides, guided = jnp.zeros((6, 2, 3)), jnp.array([leg in stage.guides for leg in LEGS])
        for leg, foothold in stage.swing.items():
            feet = feet.at[leg - 1].set(foothold)
        for leg, points in stage.guides.items():
            guides = guides.at[leg - 1].set(points)
        position = position if stage.position is None else stage.position
        turn = jnp.zeros(3) if stage.turn is None else stage.turn
        pivot = jnp.zeros(3) if stage.pivot is None else stage.pivot
        rows.append({
            "duration": jnp.asarray(stage.duration, float), "swing": swing, "foothold": feet,
            "curve": SwingCurves(
                jnp.int32(stage.cycle), jnp.asarray(stage.height, float),
                jnp.broadcast_to(jnp.asarray(stage.plane, float), (6, 3)), guides, guided,
                jnp.asarray(stage.carry, float),
            ),
            "position": position, "quat": quat, "turn": turn,
            "path": BasePaths(
                jnp.int32(stage.pace), jnp.asarray(stage.rates, float), pivot, jnp.asarray(stage.arc, float)
            ),
            "foot_frame": jnp.asarray(stage.foot_frames, jnp.int32), "base_frame": jnp.int32(stage.base_frame),
            "press": jnp.stack([jnp.asarray(depth, float) for depth in stage.press]),
        })  # fmt: skip
        if stage.turn is not None:
            # Without the barrier, the compiler expands the product of all earlier turns at every stage.
            quat = jax.lax.optimization_barrier(multiply(exponential(turn), quat))
    table = jax.tree.map(lambda *values: jnp.stack(values), *rows)
    names = tuple(stage.name for stage in stages)
    onset, laws = tuple(stage.onset for stage in stages), tuple(stage.law for stage in stages)
    eased = None if ease is None else GradualFootholds(jnp.asarray(ease, float))
    layers = (eased, _held_legs(stages), _flywheel(stages, gains), _body_motion(stages, afloat))
    return Plan(names=names, start=start, patience=jnp.asarray(patience, float), steered=steered, onset=onset,
                laws=laws,
                layers=tuple(layer for layer in layers if layer is not None), **table)  # fmt: skip


def _flywheel(stages: Sequence[Stage], gains: FlywheelGains | None) -> MiddleLegFlywheel | None:
    mode = jnp.array([stage.flywheel for stage in stages], jnp.int32)
    return None if gains is None else MiddleLegFlywheel(mode, jax.tree.map(lambda x: jnp.asarray(x, float), gains))


def _moves_frames(before: Stage, stage: Stage) -> bool:
    """Whether the base, or a foot that does not swing, changes its frame."""
    feet = zip(LEGS, before.foot_frames, stage.foot_frames, strict=True)
    return before.base_frame != stage.base_frame or any(a != b and leg not in stage.swing for leg, a, b in feet)


def _body_motion(stages: Sequence[Stage], afloat: bool) -> FreeBodyReferenceMotion | None:
    """Layer of the free bodies' reference motion; None if no stage has one."""
    count = max(len(stage.support) for stage in stages)
    if not count:
        return None
    rows = [
        [SupportMotion(*map(jnp.asarray, each)) for each in stage.support or (SupportMotion(),) * count]
        for stage in stages
    ]
    support = jax.tree.map(lambda *leaves: jnp.stack(leaves).reshape(len(rows), count, *leaves[0].shape),
                           *[each for row in rows for each in row])  # fmt: skip
    return FreeBodyReferenceMotion(support, afloat)


def _held_legs(stages: Sequence[Stage]) -> JointSpaceLegs | None:
    """Layer of the legs that hold joint angles; None if no stage has a posture."""
    if not any(stage.posture for stage in stages):
        return None
    holding, angles, held, joints = set(), jnp.zeros((6, 3)), [], []
    for stage in stages:
        holding = (holding - set(stage.swing)) | set(stage.posture)
        for leg, goal in stage.posture.items():
            angles = angles.at[leg - 1].set(jnp.asarray(goal, float))
        held.append([leg in holding for leg in LEGS])
        joints.append(angles)
        holding = holding - set(stage.swing)
    return JointSpaceLegs(jnp.array(held), jnp.stack(joints))
