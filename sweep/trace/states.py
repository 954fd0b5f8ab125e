"""A rollout for other programs: its states as a table, and the MuJoCo model that they belong to."""

import pandas as pd

from sweep.engines.base import Trace
from sweep.engines.batching import step_time
from sweep.engines.native import native_spec
from sweep.engines.settings import EngineSettings
from sweep.models import scene
from sweep.models.case import Case


def states(trace: Trace) -> pd.DataFrame:
    """One row a control tick, one column a number; `qpos_k` and `qvel_k` are MuJoCo's, forces are on the robot."""
    columns: dict[str, object] = {"time_s": trace.time, "stage": [trace.stages[k] for k in trace.stage]}
    for name, values in (("qpos", trace.qpos), ("qvel", trace.qvel)):
        columns |= {f"{name}_{k}": column for k, column in enumerate(values.T)}
    columns |= {f"torque_peak_{j}_nm": column for j, column in zip(scene.JOINTS, trace.joint_torque.T, strict=True)}
    for leg in scene.LEGS:
        columns |= {f"foot{leg}_force_{axis}_n": trace.foot_force[:, leg - 1, k] for k, axis in enumerate("xyz")}
    return pd.DataFrame(columns)


def model_xml(world: Case, settings: EngineSettings) -> str:
    """The world's MuJoCo model as MJCF, to six digits; mjx has a contact of its own in place of MuJoCo's."""
    if settings.name == "native":
        spec = native_spec(world, settings.native_time_step, settings.solid)
    else:
        spec = scene.describe(world)
        spec.option.timestep = step_time(settings)
    spec.compile()
    return spec.to_xml()
