"""Parameters of a study outside the values that the controller, such as a stepping plan, was searched for."""

import pandas as pd

from sweep.config.experiment import Experiment


def describe_values_outside_tuned_range(exp: Experiment, points: pd.DataFrame) -> list[str]:
    """Describe which values of a study lie outside the ranges for which the controller's plan was optimised.

    Args:
        exp: The experiment.
        points: Points or rows of the study.

    Returns:
        A sentence for each parameter, with the command that searches for them.
    """
    words = f"scenario={exp.scenario} study={exp.study.name}"
    command = f"sweep tune {words} --follow --simulate out=plans/{exp.scenario}.yaml"
    lines = exp.system.controller_range_warnings(points, exp.settings) if len(points) else ()
    return [f"{line}: `{command}` searches for these" for line in lines]
