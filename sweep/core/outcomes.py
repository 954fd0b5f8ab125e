"""Names of a rollout's outcome. A cause says why a rollout failed, or why it is invalid."""

SUCCESS, FAILURE, INVALID = "success", "failure", "invalid"
