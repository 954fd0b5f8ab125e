"""How a command went, as its exit code tells."""

DONE, BAD_INPUT, INVALID, UNEXPECTED, FAULT, INTERRUPTED = 0, 2, 3, 4, 5, 130
