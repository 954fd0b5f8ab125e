"""What can come of a rollout. A cause says why one failed, or why the simulation is not to be trusted."""

SUCCESS, FAILURE, INVALID = "success", "failure", "invalid"
