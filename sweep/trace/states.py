"""A rollout for other programs: its states as a table, and the MuJoCo model that they belong to."""

import numpy as np
import pandas as pd

from sweep.engines.base import Trace
from sweep.engines.settings import EngineSettings
from sweep.engines.states import offered
from sweep.models import scene
from sweep.models.case import Case


def states(trace: Trace) -> pd.DataFrame:
    """One row a control tick, one column a number, see `offered`."""
    record = {name: np.moveaxis(getattr(trace, name), 0, -1) for name in ("qpos", "qvel", "joint_torque", "foot_force")}
    columns = {name: np.asarray(column(record)) for name, column in offered(trace.world).items()}
    return pd.DataFrame({"time_s": trace.time, "stage": [trace.stages[k] for k in trace.stage], **columns})


def model_xml(world: Case, settings: EngineSettings) -> str:
    """The world's MuJoCo model as MJCF, to six digits; mjx has a contact of its own in place of MuJoCo's."""
    if settings.name == "native":
        spec = scene.native_spec(world, settings.native_time_step, settings.solid)
    else:
        spec = scene.describe(world)
        spec.option.timestep = settings.step
    spec.compile()
    return spec.to_xml()
