"""Frames in which places are told, by number: the world's, and two that go with each of an obstacle's free bodies."""

WORLD = 0


def koenig_frame(body: int) -> int:
    """The Koenig frame of free body number `body`: its centre, with the world's axes."""
    return 1 + 2 * body


def body_frame(body: int) -> int:
    """The frame of free body number `body` itself: its centre, with its own axes."""
    return 2 + 2 * body
