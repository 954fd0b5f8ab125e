"""Joints in torque mode beside joints in position mode: they give the torque that is asked for, up to the limit."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from sweep.backends import devices
from sweep.config.experiment import compose
from sweep.dynamics import interface as dynamics
from sweep.dynamics import mjx as mjx_dynamics
from sweep.dynamics.step import state_at_rest, step, unpack_physics_state
from sweep.engines import physics
from sweep.engines.batch_last import batch_last_vmap
from sweep.models.drive import ServoCommand, position_command
from sweep.models.scene import compile_native_model

H = 1e-3
CASE = compose([]).case
BETA_3 = (2, 1)
ANGLES = np.tile([0.1, 2.0, 0.9], (6, 1))


TORQUES = (-40.0, 0.0, 60.0, 400.0)  # N m, the last beyond the limit


@pytest.fixture(scope="module")
def one_step():
    """One step of a robot in the air, joint beta_3 given a torque only: its torque, and all joints' rates."""
    devices.configure_jax()
    top = dynamics.build_model_topology(CASE)
    smooth = mjx_dynamics.mjx_dynamics(top)(CASE)
    q = jnp.asarray(top.model.qpos0).at[2].set(9.0).at[1 + top.leg_dofs].set(ANGLES)
    limits = physics.drive_limits_at_step(CASE, jnp.int32(0), H)

    def run(torque):
        moving, report = step(smooth, CASE, limits, unpack_physics_state(state_at_rest(top, q)), _order(torque), H, 3)
        return report.torque[BETA_3[1]][BETA_3[0]], jnp.stack(moving.motion.leg, axis=-1)

    torques, rates = jax.jit(batch_last_vmap(run, (-1,), devices.recomputation_cost_threshold()))(jnp.array(TORQUES))
    return {torque: (np.asarray(torques)[k], np.asarray(rates)[..., k]) for k, torque in enumerate(TORQUES)}


def _order(torque) -> ServoCommand:
    servo = position_command(CASE.drive, jnp.asarray(ANGLES))
    return ServoCommand(
        servo.target,
        servo.stiffness.at[BETA_3].set(0.0),
        servo.damping.at[BETA_3].set(-CASE.drive.back_emf),
        servo.torque.at[BETA_3].set(torque),
    )


@pytest.mark.parametrize("torque", TORQUES[:3])
def test_the_torque_is_the_one_asked_for(one_step, torque):
    """The back-EMF at 10 N m s/rad is made up for."""
    got, rates = one_step[torque]
    assert got == pytest.approx(torque, abs=1e-3)
    assert abs(rates[BETA_3]) > 0.1 * (torque != 0)


def test_the_limit_holds(one_step):
    """Beyond the limit the voltage is cut and the back-EMF takes its part."""
    got, rates = one_step[400.0]
    assert got == pytest.approx(CASE.drive.torque_limit - CASE.drive.back_emf * rates[BETA_3], abs=1e-2)


def test_native_gives_the_same_rates(one_step):
    """C MuJoCo's servos with the gains of the joint changed."""
    model = compile_native_model(CASE, H)
    order = _order(60.0)
    gains = np.stack([np.asarray(order.stiffness), np.asarray(order.damping)], axis=-1).reshape(18, 2)
    model.actuator_biasprm[:, 1:3] = -gains
    data = mujoco.MjData(model)
    data.qpos[2], data.qpos[7:] = 9.0, ANGLES.ravel()
    data.ctrl = np.asarray(order.stiffness * order.target + order.torque).ravel()
    mujoco.mj_step(model, data)
    np.testing.assert_allclose(one_step[60.0][1].ravel(), data.qvel[6:], atol=0.02)  # rad/s, of 0.15 to 2
