"""Orientations as arrays, of NumPy or of JAX as those are that they are worked out from."""

from typing import Any


def namespace(array: Any) -> Any:
    """NumPy or JAX's of it, whichever an array is of."""
    return array.__array_namespace__()


def tilt(quat: Any, start: Any) -> Any:
    """Angle (°) between upward axes of two orientations (..., 4), each as it stands in the world."""
    return angle(level(quat, start))


def level(quat: Any, start: Any) -> Any:
    """Cosine of the tilt."""
    a, b = (up(namespace(quat).moveaxis(one, -1, 0)) for one in (quat, start))
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def up(quat: Any) -> tuple[Any, Any, Any]:
    """The upward axis of an orientation (4, ...), each of its components (...)."""
    w, x, y, z = quat
    return 2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)


def angle(cosine: Any) -> Any:
    """In degrees, of a cosine that may be beyond 1 by rounding."""
    xp = namespace(cosine)
    return xp.degrees(xp.arccos(xp.clip(cosine, -1, 1)))
