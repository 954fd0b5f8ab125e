"""Base classes of obstacles: defaults of optional members, and obstacles that never move."""

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, ClassVar

from jaxtyping import Array, Float

from sweep.models.obstacles.charts import Chart
from sweep.models.obstacles.geoms import add_solids
from sweep.models.obstacles.surface import BodyPoses, FreeBodyState, identity_poses
from sweep.models.solids import Solid

if TYPE_CHECKING:
    import mujoco


class ObstacleDefaults:
    """Defaults for optional members of an obstacle: no named coordinates, no sizes to estimate, no external wrench."""

    charts: ClassVar[dict[str, Chart]] = {}
    forward: tuple[float, float] = (0.0, -1.0)
    heights: tuple[str, ...] = ()
    sizes_learnable_from_height: tuple[str, ...] = ()
    sizes_learnable_from_feet: tuple[str, ...] = ()

    def external_wrench(self, free: FreeBodyState) -> Float[Array, "k 6"] | None:
        """Return the wrenches on free bodies other than weight and contact: by default None, for no such wrench."""
        return None


class StaticObstacle(ObstacleDefaults, ABC):
    """Base class of obstacles that do not move; a subclass adds a kind, sizes, solids and a surface."""

    free_bodies: tuple[str, ...] = ()
    contact_sites: tuple[tuple[str, int], ...] = ()

    @abstractmethod
    def solids(self, bodies: BodyPoses) -> tuple[Solid, ...]:
        """Return the solids of which the obstacle consists."""

    def add_to(self, spec: "mujoco.MjSpec", friction: float) -> None:
        """Add the obstacle's solids to a MuJoCo spec as geoms."""
        add_solids(spec, self.solids(identity_poses(0)), friction)

    def batched_model_fields(self) -> dict[str, dict[str, Array]]:
        """Return the MuJoCo model fields that depend on varied masses and sizes: none, since nothing moves."""
        return {}
