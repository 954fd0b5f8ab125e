"""Settings of a simulation run, as opposed to what is simulated."""

from sweep.core.errors import InputError
from sweep.core.parameters import choice, count, exclude_from_run_id, flag, parameters, quantity


@parameters
class EngineSettings:
    """Engine, time steps, precision, compiler and batch width; the `engine` group of the configuration.

    `mjx` is the primary engine; `native` (C MuJoCo with its own contact solver) is an independent check.
    """

    name: str = choice("mjx", "mjx", "native")  # which engine simulates: mjx, or native as the independent check
    # smooth dynamics of mjx: structured (arrowhead), MJX's own, or structured wherever robot and obstacle fit
    dynamics: str = choice("auto", "auto", "arrowhead", "mjx")
    time_step: float = quantity(2e-3, "s", above=0, at_most=0.01)  # physics step of mjx
    native_time_step: float = quantity(
        1e-3, "s", above=0, at_most=0.01
    )  # physics step of native, whose contact solver fails at 2 ms
    # of the closed loop: XLA, this package's own (fused), or fused wherever it has rules for the whole program
    compiler: str = choice("auto", "auto", "xla", "fused")
    # between two commands of the controller: a whole number of physics steps
    control_period: float = quantity(4e-3, "s", above=0, at_most=0.05)
    iterations: int = count(8, at_least=1, at_most=20)  # Newton iterations of a contact step, at most
    precision: str = choice("float32", "float32", "float64")  # of all numbers in mjx and in the controller
    width: int = count(0, at_most=1 << 24)  # rollouts in a batch; 0 selects the device's best
    solid: bool = flag(False)  # base and links collide with the obstacle and each other; native only
    # user models: mjx and warp compare the first ticks of a study with C MuJoCo; not part of a row's `run_id`
    cross_check: bool = exclude_from_run_id(flag(True))

    def __post_init__(self) -> None:
        """Raise `InputError` if an engine cannot do what the settings ask."""
        if self.solid and self.name != "native":
            raise InputError("engine.solid = True is not allowed: false, or engine=native (elsewhere only feet touch)")
        if self.compiler == "fused" and self.dynamics == "mjx":
            raise InputError("engine.compiler = fused is not allowed with engine.dynamics = mjx: auto or xla")

    @property
    def time_step_s(self) -> float:
        """Time step of the chosen engine (s): `native_time_step` or `time_step`."""
        return self.native_time_step if self.name == "native" else self.time_step

    @property
    def is_fusible(self) -> bool:
        """Whether the package's own compiler can compile simulation and controller together."""
        return self.compiler != "xla" and self.dynamics != "mjx"
