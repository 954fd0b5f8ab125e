"""How late drives may know of their own joints: C MuJoCo with time steps much shorter than that, and the formula.

    python bench/drive_delay.py

It writes research/data/drive_delay.json, which research/robustness.md cites.
The robot of `walk_tripod` stands, or hangs in
the air, a joint's reference jumps by a milliradian, and for 0.2 s every drive's torque, which has no limit here, comes
of the angle and rate that its joint had `delay` before. Where the joints' accelerations are larger in the last quarter
of that than in the one before, it swings by itself; the shortest such delay is found by bisection. `formula` is
`servo_delay` about the least inertia that a joint has with the base held, and its drive's.
"""

import time
from dataclasses import replace

import mujoco
import numpy as np
import shared

from sweep.engines import devices
from sweep.engines.closed_loop import start_state
from sweep.formulas import evaluate
from sweep.models.case import Case
from sweep.models.drive import Drive
from sweep.models.legs import JOINT_Q, JOINT_V
from sweep.models.scene import compile_model
from sweep.study.config import compose

STEP, TIME, JUMP, AWAY = 1e-5, 0.2, 1e-3, 1e5  # s, s, rad, rad/s^2
DRIVES = {"as they are": {}, "of the ladder": {"stiffness": 1.5e4, "damping": 335.0},
          "soft, of the calibration": {"stiffness": 1500.0, "damping": 200.0}}  # fmt: skip


def grows(model: mujoco.MjModel, qpos: np.ndarray, drive: Drive, ticks: int) -> bool:
    """Whether joints swing ever more with a delay of `ticks` steps."""
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


def longest(case: Case, air: bool) -> float:
    """Delay (s) from which on it swings by itself."""
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
        low, high = (low, middle) if grows(model, qpos, case.drive, middle) else (middle, high)
    return high * STEP


def least_inertia(case: Case) -> float:
    """Of a joint with all others and the base held (kg m^2), its drive's rotor included."""
    model = compile_model(case)
    data = mujoco.MjData(model)
    data.qpos[:] = np.asarray(start_state(case, case, case.manoeuvre.plan(case)).qpos)
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    return float(np.min(np.diag(mass)[JOINT_V]))


def main() -> None:
    """One line for each kind of drives."""
    start = time.perf_counter()
    devices.configure()
    case = compose(["scenario=walk_tripod"]).case
    rows = [["drives", "stiffness, N m/rad", "damping, N m s/rad", "`servo_delay`, ms", "swings in the air from, ms",
             "standing from, ms"]]  # fmt: skip
    for name, gains in DRIVES.items():
        other = replace(case, drive=replace(case.drive, **gains))
        inertia, drive = least_inertia(other), other.drive
        said = evaluate("servo_delay", {"J": inertia, "stiffness": drive.stiffness, "damping": drive.damping,
                                        "c_e": drive.back_emf})["delay"]  # fmt: skip
        delays = (said, *(longest(other, air) for air in (True, False)))
        rows.append([name, f"{drive.stiffness:g}", f"{drive.damping:g}", *(f"{1e3 * delay:.2f}" for delay in delays)])
        print(*rows[-1], flush=True)
    shared.keep("drive_delay", ("native",), start, {"delays": rows})


if __name__ == "__main__":
    main()
