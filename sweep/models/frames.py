"""Numbers of coordinate frames: the world's, and two for each free body of the obstacle."""

WORLD_FRAME = 0


def koenig_frame_number(body: int) -> int:
    """Number of the Koenig frame of free body `body`: origin at its mass centre, axes of the world."""
    return 1 + 2 * body


def body_frame_number(body: int) -> int:
    """Number of the body frame of free body `body`: origin at its mass centre, axes of the body."""
    return 2 + 2 * body
