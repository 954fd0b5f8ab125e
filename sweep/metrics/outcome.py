"""From a row's figures to its outcome: success, failure with a cause, or invalid."""

from collections.abc import Mapping, Sequence

import numpy as np

from sweep.core.parameters import parameters, quantity

SUCCESS, FAILURE, INVALID = "success", "failure", "invalid"
TIMED_CAUSES = ("fell", "slipped", "unreachable", "link_collision", "leg_crossing", "off_course", "fell_off",
                "obstacle_moved", "overload")  # fmt: skip
FREE_BODY_CAUSES = ("fell_off", "obstacle_moved")  # their figures are there where the obstacle has free bodies
CAUSES = {
    "fell": "the base tilted beyond tilt_max_deg",
    "slipped": "a standing foot slipped beyond slip_max_m",
    "unreachable": "a foot target was out of the leg's reach by more than reach_shortfall_max_m",
    "link_collision": "a link or the base came closer to the obstacle than clearance_min_m",
    "leg_crossing": "two legs came closer to each other than leg_gap_min_m",
    "off_course": "the heading was off by more than heading_error_max_deg",
    "fell_off": "the base sank to less than ride_height_min_m over the centre of the body it rides on",
    "obstacle_moved": "a free body went farther than obstacle_moved_max_m",
    "overload": "no forces within the believed friction and torque limit hold a planned stance (imbalance_max), or a "
    "kind of joint was saturated for more than saturation_share_max of the time",
    "stalled": "the plan was not finished, or progress stayed below progress_min",
}
DOUBTS = {
    "not_finite": "a number was not finite",
    "solver": "the contact solver's residual exceeded solver_residual_max_n",
    "energy": "mechanical energy grew beyond the drives' work by more than energy_gain_max_j",
}
MEANING = {**CAUSES, **DOUBTS}


@parameters
class Thresholds:
    """When a rollout counts as failed, or as not to be trusted."""

    tilt_max_deg: float = quantity(20.0, "deg", above=0)
    slip_max_m: float = quantity(1e3, "m", at_least=0)
    reach_shortfall_max_m: float = quantity(5e-3, "m", at_least=0)
    clearance_min_m: float = quantity(-5e-3, "m")
    leg_gap_min_m: float = quantity(-5e-3, "m")
    heading_error_max_deg: float = quantity(5.0, "deg", above=0)
    ride_height_min_m: float = quantity(-1e3, "m")
    obstacle_moved_max_m: float = quantity(1e3, "m", at_least=0)
    imbalance_max: float = quantity(0.01, "-", at_least=0)  # of the weight, that planned forces leave unheld
    saturation_share_max: float = quantity(1.0, "-", at_least=0, at_most=1)
    progress_min: float = quantity(0.9, "-")
    solver_residual_max_n: float = quantity(100.0, "N", above=0)
    energy_gain_max_j: float = quantity(1.0, "J", above=0)


def classify(figures: Mapping[str, np.ndarray], thresholds: Thresholds, stages: Sequence[str]) -> dict[str, np.ndarray]:
    """Outcome, cause, stage and time of the cause of each row; a pure function of the stored figures.

    The first cause in time wins. With thresholds other than those of the run a cause may lack its time: it then
    comes last, with its time NaN. An invalid row's cause is why it is not trusted.
    """
    f = {key: np.asarray(value) for key, value in figures.items()}
    holds = _causes(f, thresholds)
    times = np.stack([
        np.where(holds[cause], np.nan_to_num(f[f"{cause}_time_s"], nan=np.inf) if cause in TIMED_CAUSES else np.inf,
                 np.nan) for cause in holds
    ])  # fmt: skip
    failed = ~np.isnan(times).all(axis=0)
    first = np.argmin(np.nan_to_num(times, nan=np.inf, posinf=np.finfo(float).max), axis=0)
    names = np.array(list(holds), dtype=object)
    doubts = _doubts(f, thresholds)
    invalid = np.any(list(doubts.values()), axis=0)
    why = np.select(list(doubts.values()), [np.full(len(invalid), name, dtype=object) for name in doubts], "")
    outcome = np.where(invalid, INVALID, np.where(failed, FAILURE, SUCCESS))
    time = np.take_along_axis(times, first[None], axis=0)[0]
    timed = failed & np.isfinite(time)
    stage = np.where(timed, _stage_of(f, tuple(holds), first), f["end_stage"]).astype(int)
    labels = np.array([*stages, ""], dtype=object)
    return {
        "outcome": outcome,
        "cause": np.where(invalid, why, np.where(failed, names[first], "")),
        "stage": np.where(failed | invalid, labels[np.clip(stage, -1, len(stages) - 1)], ""),
        "t_cause_s": np.where(timed & ~invalid, time, np.nan),
    }


def _causes(f: Mapping[str, np.ndarray], limits: Thresholds) -> dict[str, np.ndarray]:
    saturation = np.max([f[f"saturation_share_{joint}"] for joint in ("alpha", "beta", "gamma")], axis=0)
    on_free_body = {} if "ride_height_min_m" not in f else {
        "fell_off": f["ride_height_min_m"] < limits.ride_height_min_m,
        "obstacle_moved": f["obstacle_moved_m"] > limits.obstacle_moved_max_m,
    }  # fmt: skip
    return {
        "fell": f["tilt_max_deg"] > limits.tilt_max_deg,
        "slipped": f["slip_max_m"] > limits.slip_max_m,
        "unreachable": f["reach_shortfall_max_m"] > limits.reach_shortfall_max_m,
        "link_collision": f["clearance_min_m"] < limits.clearance_min_m,
        "leg_crossing": f["leg_gap_min_m"] < limits.leg_gap_min_m,
        "off_course": f["heading_error_max_deg"] > limits.heading_error_max_deg,
        **on_free_body,
        "overload": (f["imbalance_max"] > limits.imbalance_max) | (saturation > limits.saturation_share_max),
        "stalled": ~f["finished"].astype(bool) | (f["progress"] < limits.progress_min),
    }


def _doubts(f: Mapping[str, np.ndarray], limits: Thresholds) -> dict[str, np.ndarray]:
    """Why rows are not to be trusted. A comparison with NaN is false, hence the explicit check of every figure."""
    optional = {f"{cause}_{what}" for cause in TIMED_CAUSES for what in ("time_s", "stage")}
    numbers = [value.astype(float) for key, value in f.items() if key not in optional]
    broken = ~f["finite"].astype(bool) | np.any([np.isnan(value) for value in numbers], axis=0)
    return {
        "not_finite": broken,
        "solver": f["solver_residual_max_n"] > limits.solver_residual_max_n,
        "energy": f["energy_gain_max_j"] > limits.energy_gain_max_j,
    }


def _stage_of(f: Mapping[str, np.ndarray], causes: Sequence[str], first: np.ndarray) -> np.ndarray:
    stages = [f[f"{cause}_stage"] if cause in TIMED_CAUSES else f["end_stage"] for cause in causes]
    return np.take_along_axis(np.stack(stages), first[None], axis=0)[0]
