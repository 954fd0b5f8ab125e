"""What manoeuvres aim at, as thresholds of figures: a rollout that misses one of them has failed."""

ARRIVED = {"progress_min": 0.9}
ON_ITS_FEET = {**ARRIVED, "feet_on_target_min": 6.0}
UPRIGHT = {**ON_ITS_FEET, "end_tilt_max_deg": 3.0}
