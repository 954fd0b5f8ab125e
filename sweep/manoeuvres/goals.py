"""Goals of manoeuvres: thresholds of metrics that a successful rollout has to meet."""

ARRIVED = {"progress_min": 0.9}
ON_ITS_FEET = {**ARRIVED, "feet_on_target_min": 6.0}
UPRIGHT = {**ON_ITS_FEET, "end_tilt_max_deg": 3.0}
