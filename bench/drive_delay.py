"""Largest delay of the drives' joint feedback: C MuJoCo with much shorter time steps, and the formula.

    python bench/drive_delay.py

It writes research/data/drive_delay.json, which research/robustness.md cites.

The robot of `walk_tripod` stands, or hangs in the air, and a joint's reference jumps by a milliradian. For 0.2 s, the
torque of every drive, without limit here, follows from the angle and rate of its joint `delay` earlier. If the joint
accelerations grow from the third to the last quarter, the robot oscillates by itself; bisection finds the shortest such
delay. `formula` is `servo_delay` about the least inertia of a joint with the base held, including its drive.
"""

import time
from dataclasses import replace

import mujoco
import numpy as np
import shared

from sweep.backends import devices
from sweep.config.experiment import compose
from sweep.engines.closed_loop import start_state
from sweep.formulas import evaluate
from sweep.models.case import Case
from sweep.models.drive import Drive
from sweep.models.legs import JOINT_Q, JOINT_V
from sweep.models.scene import compile_model

STEP, TIME, JUMP, AWAY = 1e-5, 0.2, 1e-3, 1e5  # s, s, rad, rad/s^2
DRIVES = {"as they are": {}, "of the ladder": {"stiffness": 1.5e4, "damping": 335.0},
          "soft, of the calibration": {"stiffness": 1500.0, "damping": 200.0}}  # fmt: skip


def is_unstable(model: mujoco.MjModel, qpos: np.ndarray, drive: Drive, ticks: int) -> bool:
    """Return whether joint oscillations grow with a delay of `ticks` steps."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    reference, history, sizes = qpos[JOINT_Q].copy(), [], []
    reference[2] += JUMP
    for _ in range(round(TIME / STEP)):
        history.append((data.qpos[JOINT_Q].copy(), data.qvel[JOINT_V].copy()))
        angle, rate = history[max(0, len(history) - 1 - ticks)]
        asked = drive.stiffness * (reference - angle) - drive.damping * rate
        data.qfrc_applied[JOINT_V] = asked - drive.back_emf * data.qvel[JOINT_V]
        mujoco.mj_step(model, data)
        sizes.append(np.max(np.abs(data.qacc[JOINT_V])))
        if not sizes[-1] < AWAY:  # MuJoCo would soon begin anew
            return True
        history = history[-ticks - 1 :]
    last, before = np.array_split(sizes, 4)[3:1:-1]
    return bool(np.max(last) > np.max(before))


def critical_delay(case: Case, air: bool) -> float:
    """Return the delay (s) from which on the robot oscillates by itself."""
    model = compile_model(case)
    model.opt.timestep, model.opt.integrator = STEP, mujoco.mjtIntegrator.mjINT_EULER
    start = start_state(case, case, case.manoeuvre.plan(case))
    qpos = np.asarray(start.qpos, float)
    if air:
        qpos[2] += 5.0
        model.opt.gravity[:] = 0.0
    low, high = 0, round(0.01 / STEP)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if is_unstable(model, qpos, case.drive, middle) else (middle, high)
    return high * STEP


def least_inertia(case: Case) -> float:
    """Return the least inertia of a joint with all others and the base held (kg m^2), including its drive's rotor."""
    model = compile_model(case)
    data = mujoco.MjData(model)
    data.qpos[:] = np.asarray(start_state(case, case, case.manoeuvre.plan(case)).qpos)
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    return float(np.min(np.diag(mass)[JOINT_V]))


def main() -> None:
    """Print and write one line for each kind of drives."""
    start = time.perf_counter()
    devices.configure_jax()
    case = compose(["scenario=walk_tripod"]).case
    rows = [["drives", "stiffness, N m/rad", "damping, N m s/rad", "`servo_delay`, ms", "swings in the air from, ms",
             "standing from, ms"]]  # fmt: skip
    for name, gains in DRIVES.items():
        other = replace(case, drive=replace(case.drive, **gains))
        inertia, drive = least_inertia(other), other.drive
        said = evaluate("servo_delay", {"J": inertia, "stiffness": drive.stiffness, "damping": drive.damping,
                                        "c_e": drive.back_emf})["delay"]  # fmt: skip
        delays = (said, *(critical_delay(other, air) for air in (True, False)))
        rows.append([name, f"{drive.stiffness:g}", f"{drive.damping:g}", *(f"{1e3 * delay:.2f}" for delay in delays)])
        print(*rows[-1], flush=True)
    shared.write_tables("drive_delay", ("native",), start, {"delays": rows})


if __name__ == "__main__":
    main()
