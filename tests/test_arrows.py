"""The rooms of the package and which of them may know which: imports as the sources say them, lazy ones too."""

import ast
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from sweep.systems.hexapod import Hexapod
from sweep.systems.mujoco_model import MujocoModel

PACKAGE = Path(__file__).parents[1] / "sweep"
# from the ground up: a room knows those before it; modules beside the rooms, which users import, know all of them
BELOW_RUNS = (
    "fused",
    "core",
    "contract",
    "backends",
    "formulas",
    "models",
    "dynamics",
    "controllers",
    "planning",
    "manoeuvres",
    "estimation",
    "metrics",
    "engines",
    "systems",
    "study",
    "config",
    "analysis",
)
ROOMS = (*BELOW_RUNS, "runs", "replay", "report", "cli", "")
# a controller and a model of a user's own; one rollout's surfaces; physics measured alone
JAX_ABOVE_ENGINES = {
    "sweep.systems.mujoco_model.learned_policy",
    "sweep.systems.mujoco_model.onnx_network",
    "sweep.systems.mujoco_model.onnx_operators",
    "sweep.systems.mujoco_model.batch",
    "sweep.systems.mujoco_model.policy",
    "sweep.systems.mujoco_model.tracking",
    "sweep.systems.hexapod.exported",
    "sweep.systems.mujoco_model.kernel.agreement",
    "sweep.systems.mujoco_model.kernel.guard",
    "sweep.systems.mujoco_model.kernel.scalars",
    "sweep.systems.mujoco_model.kernel.solver",
    "sweep.systems.mujoco_model.kernel.step",
    "sweep.systems.mujoco_model.kernel_engine",
    "sweep.systems.mujoco_model.mjx",
    "sweep.cli.template_model.trot",
    "sweep.cli.commands.bench",
}
# the sources' own text; compiled programs; a study's name for its folder and its table of points; what a system is read
# from, which goes with a study; a command's arguments
FILES_BELOW_RUNS = {
    "sweep.systems.mujoco_model.schedules",
    "sweep.systems.mujoco_model.learned_policy",
    "sweep.systems.mujoco_model.onnx_network",
    "sweep.systems.mujoco_model.torch_network",
    "sweep.core.arguments",
    "sweep.core.plot_style",
    "sweep.core.files",
    "sweep.core.project",
    "sweep.core.provenance",
    "sweep.core.user_code",
    "sweep.fused.cuda",
    "sweep.backends.program_cache",
    "sweep.config.experiment",
    "sweep.study.study",
    "sweep.contract.system",
    "sweep.systems.hexapod",
    "sweep.systems.mujoco_model",
    "sweep.systems.mujoco_model.files",
}


# the built-in robot: what knows it of the other modules is the table of systems
ROBOT = ("formulas", "models", "dynamics", "controllers", "planning", "manoeuvres", "estimation", "metrics", "engines")
TABLE = "sweep.systems"
# its own subcommands, which the command line finds by their files
ROBOT_COMMANDS = (
    "sweep.cli.plan_limits",
    "sweep.cli.plan_rollouts",
    "sweep.cli.plan_search",
    *(f"sweep.cli.commands.{name}" for name in ("bench", "export_model", "formula", "tune")),
)


# of a system, what every one of them has: engines' protocol, settings and devices, and the choice among systems
CONTRACT = {
    "sweep.systems",
    "sweep.contract.system",
    "sweep.contract.engine",
    "sweep.contract.engine_settings",
    "sweep.backends.devices",
}
ALIKE = {("ROUNDS", "4")}  # constants with one name and number, of two things


def name_of(path):
    """`sweep.models` of sweep/models/__init__.py."""
    return ".".join(("sweep", *path.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(".__init__")


MODULES = {name_of(path): path for path in PACKAGE.rglob("*.py")}


def imported(path):
    """All modules that the source at `path` names in imports, wherever they stand in it."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} imports relatively"
            parts = [f"{node.module}.{alias.name}" for alias in node.names]
            yield from (part if part in MODULES else node.module for part in parts)


ARROWS = {name: set(imported(path)) for name, path in MODULES.items()}


def room(module):
    return next((part for part in module.split(".")[1:2] if part in ROOMS), "")


def above(place):
    return ROOMS[ROOMS.index(place) + 1 :]


@pytest.mark.parametrize("place", ROOMS)
def test_no_room_knows_one_above_it(place):
    arrows = [(name, other) for name in MODULES if room(name) == place for other in ARROWS[name] & set(MODULES)]
    assert not [(name, other) for name, other in arrows if room(other) in above(place)]


def is_robots_own(module):
    """Whether a module belongs to the built-in robot, its physics or its judge."""
    return room(module) in ROBOT or module.startswith("sweep.systems.hexapod") or module in ROBOT_COMMANDS


def test_the_runner_knows_the_built_in_robot_by_the_table_of_systems_alone():
    """Who reads the runner for another robot need not read this one."""
    arrows = {
        name: {other for other in ARROWS[name] & set(MODULES) if is_robots_own(other)}
        for name in MODULES
        if not is_robots_own(name) and name != TABLE
    }
    assert not {name: others for name, others in arrows.items() if others}


def test_no_module_needs_itself():
    TopologicalSorter({name: others & set(MODULES) for name, others in ARROWS.items()}).prepare()


def test_every_module_has_a_room():
    beside = {name for name in MODULES if not room(name)}
    assert beside == {"sweep", "sweep.api"}


@pytest.mark.parametrize("place", ["study", "config", "analysis", "runs", "report"])
def test_studies_know_systems_by_their_contract(place):
    """Nothing of a robot, its physics or its judge: another system needs no change here."""
    own = {
        name
        for name in MODULES
        if room(name) in BELOW_RUNS[BELOW_RUNS.index("models") : BELOW_RUNS.index("systems") + 1]
    }
    mine = [name for name in MODULES if room(name) == place]
    assert not [(name, other) for name in mine for other in ARROWS[name] & (own - CONTRACT)]


def test_nothing_asks_which_system_it_has():
    """What one can and another cannot is a part of the contract; their classes are named where they are made."""
    classes = {Hexapod.__name__, MujocoModel.__name__}
    others = {name: ast.parse(path.read_text()) for name, path in MODULES.items() if room(name) != "systems"}
    found = {
        name
        for name, tree in others.items()
        for node in ast.walk(tree)
        if (isinstance(node, ast.Name) and node.id in classes)
        or (isinstance(node, ast.Attribute) and node.attr in classes)
        or (isinstance(node, ast.alias) and node.name in classes)
    }
    assert not found


def test_only_engines_and_what_is_below_know_jax():
    roots = {name: {other.partition(".")[0] for other in others} for name, others in ARROWS.items()}
    assert {n for n in MODULES if "jax" in roots[n] and room(n) in above("engines")} == JAX_ABOVE_ENGINES


def test_one_module_knows_what_is_private_to_hydra():
    """So that a version of Hydra that moves it needs one change."""
    private = {name for name in MODULES if any(other.startswith("hydra._internal") for other in ARROWS[name])}
    assert private == {"sweep.config.hydra_sources"}


def test_only_runs_and_what_is_above_know_files():
    files = {"pathlib", "tempfile", "shutil"}
    assert {n for n in MODULES if files & ARROWS[n] and room(n) in BELOW_RUNS} == FILES_BELOW_RUNS


def test_a_constant_stands_once():
    """Names with numbers or words of their own; two modules may well call two things alike."""
    found = {}
    for name, path in MODULES.items():
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name) and node.targets[0].id.isupper():
                found.setdefault((node.targets[0].id, ast.unparse(node.value)), []).append(name)
    twice = {key: places for key, places in found.items() if len(places) > 1}
    assert twice.keys() <= ALIKE, twice
