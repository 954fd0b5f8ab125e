"""Export of a study to the experiment trackers MLflow, Weights & Biases and TensorBoard, as one run each."""

import importlib
import json
import math
import shutil
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from sweep.analysis import rare
from sweep.analysis.sample import pooled_success_rate
from sweep.config.experiment import flatten_values
from sweep.core.errors import InputError
from sweep.report.headline import study_headline
from sweep.runs.results import Results
from sweep.study.columns import metric_columns

MODULES = {"mlflow": "mlflow", "wandb": "wandb", "tensorboard": "tensorboardX"}  # by name of tracker and extra
MAX_PARAMETERS_PER_REQUEST = 100  # of MLflow's server


@dataclass(frozen=True)
class TrackedStudy:
    """A study in the form that trackers store: a run with parameters and metrics."""

    name: str
    headline: str
    parameters: dict[str, bool | float | str]  # configuration by dotted path; lists as JSON
    metrics: dict[str, float]  # finite numbers


def import_tracker(name: str) -> ModuleType:
    """Import the package of a tracker.

    Args:
        name: `mlflow`, `wandb` or `tensorboard`.

    Raises:
        InputError: The package is not installed.
    """
    try:
        return importlib.import_module(MODULES[name])
    except ModuleNotFoundError as error:
        if error.name != MODULES[name]:  # a dependency of the installed package
            raise
        raise InputError(f"--{name} needs {MODULES[name]}: pip install 'insect-sweep[{name}]'") from None


def describe_tracked_study(results: Results) -> TrackedStudy:
    """Collect what a tracker stores of a study: its configuration, counts of outcomes and causes, success rate or
    failure probability with its interval, and medians of metrics."""
    rows, exp = results.rows, results.exp
    rate = pooled_success_rate(rows, exp)
    failures = rate.valid_count - rate.successes
    metrics = {"rollouts": rate.total, "successes": rate.successes, "failures": failures, "invalid": rate.invalid}
    metrics |= {f"causes/{cause}": int((rows["cause"] == cause).sum()) for cause in results.occurring_causes}
    if exp.study.is_adaptive:  # rollouts lie where failures are expected: shares and medians say nothing
        metrics |= estimated_failure_probability(results)
    else:
        metrics |= {"success_rate": rate.share, "success_rate_low": rate.low, "success_rate_high": rate.high}
        numbers = rows[metric_columns(rows)].select_dtypes("number")
        metrics |= {f"median/{name}": value for name, value in numbers.median().items()}
    return TrackedStudy(
        results.name,
        study_headline(rows, exp),
        {
            path: value if isinstance(value, bool | int | float | str) else json.dumps(value)
            for path, value in flatten_values(results.stored["config"]).items()
        },
        {name: float(value) for name, value in metrics.items() if math.isfinite(value)},
    )


def estimated_failure_probability(results: Results) -> dict[str, float]:
    """Return the failure probability of an adaptive study with its interval; empty while it is unknown."""
    try:
        found = rare.estimate_failure_probability(results.rows, results.exp)
    except InputError:
        return {}
    low, high = found.interval
    return {"failure_probability": found.probability, "failure_probability_low": low, "failure_probability_high": high}


def log_study_to_mlflow(mlflow: Any, study: TrackedStudy, page: Path) -> str:
    """Store a study as a run of MLflow, on the server and in the experiment that MLflow's variables name.

    Args:
        mlflow: The package.
        study: What to store.
        page: The study's HTML page, which becomes an artifact.

    Returns:
        Where the run is.
    """
    items = list(study.parameters.items())
    with mlflow.start_run(run_name=study.name, description=study.headline) as run:
        for first in range(0, len(items), MAX_PARAMETERS_PER_REQUEST):
            mlflow.log_params(dict(items[first : first + MAX_PARAMETERS_PER_REQUEST]))
        mlflow.log_metrics(study.metrics)
        mlflow.log_artifact(str(page))
    return f"MLflow run {run.info.run_id} at {mlflow.get_tracking_uri()}"


def log_study_to_wandb(wandb: Any, study: TrackedStudy, page: Path) -> str:
    """Store a study as a run of Weights & Biases, in the project that its variables name.

    Args:
        wandb: The package.
        study: What to store.
        page: The study's HTML page, which becomes a panel.

    Returns:
        Where the run is.
    """
    with wandb.init(name=study.name, notes=study.headline, config=study.parameters) as run:
        run.log({"page": wandb.Html(page.read_text(encoding="utf-8"), inject=False)})
        run.summary.update(study.metrics)
    return f"W&B run {run.url or run.dir}"


def log_study_to_tensorboard(tensorboard: Any, study: TrackedStudy, page: Path, folder: Path) -> str:
    """Write a study as a run of TensorBoard, with the page beside its event file.

    Args:
        tensorboard: The package tensorboardX.
        study: What to store.
        page: The study's HTML page, which is copied.
        folder: Log folder of TensorBoard; the run is the folder of it that has the study's name.

    Returns:
        Where the run is.
    """
    place = folder / study.name
    with tensorboard.SummaryWriter(str(folder)) as writer:
        writer.add_hparams(study.parameters, study.metrics, name=study.name, global_step=0)
        writer.add_text(study.name, f"{study.headline}\n\n[page]({place / page.name})")
    shutil.copyfile(page, place / page.name)
    return f"TensorBoard run {place}"
