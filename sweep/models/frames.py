"""Numbers of coordinate frames: of the world, and of two frames for each free body of the obstacle."""

WORLD_FRAME = 0


def koenig_frame_number(body: int) -> int:
    """Return the number of the frame at the mass centre of free body `body` with axes parallel to the world's."""
    return 1 + 2 * body


def body_frame_number(body: int) -> int:
    """Return the number of the frame at the mass centre of free body `body` with axes fixed in the body."""
    return 2 + 2 * body
