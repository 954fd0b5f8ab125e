"""Exit codes of `sweep`, and their meanings."""

DONE, BAD_INPUT, INVALID, UNEXPECTED, FAULT, INTERRUPTED = 0, 2, 3, 4, 5, 130
MEANINGS = {
    DONE: "done",
    BAD_INPUT: "bad input",
    INVALID: "too many invalid rollouts",
    UNEXPECTED: "an expectation is not met",
    FAULT: "disk, memory or workers failed",
    INTERRUPTED: "interrupted",
}
