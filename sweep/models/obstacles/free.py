"""What obstacles have in common that have free bodies."""

from jaxtyping import Array, Float

from sweep.models.obstacles.surface import FreeState


class Free:
    """Nothing is learned of it by touch, and nothing loads it, as long as it says nothing else."""

    forward: tuple[float, float] = (0.0, -1.0)
    heights: tuple[str, ...] = ()
    lying: tuple[str, ...] = ()
    stood_on: tuple[str, ...] = ()

    def load(self, free: FreeState) -> Float[Array, "k 6"] | None:
        """Nothing beside weight and contact."""
        return None
