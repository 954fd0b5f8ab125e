"""Numbers of coordinate frames: of the world, and of two frames for each free body of the obstacle."""

WORLD_FRAME = 0


def koenig_frame_number(body: int) -> int:
    """Return the number of free body `body`'s Koenig frame: origin at its mass centre, axes of the world."""
    return 1 + 2 * body


def body_frame_number(body: int) -> int:
    """Return the number of free body `body`'s own frame: origin at its mass centre, axes of the body."""
    return 2 + 2 * body
