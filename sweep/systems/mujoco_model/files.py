"""Files of a MuJoCo model, and the Python functions or the network that control it."""

import ast
import contextlib
import functools
import hashlib
import importlib
import importlib.util
import inspect
import re
import sys
import sysconfig
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib.machinery import PathFinder
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Any, NamedTuple
from xml.etree import ElementTree

import mujoco
import numpy as np

from sweep.backends.binary import model_bytes
from sweep.core import project
from sweep.core.errors import USER_CODE_ERRORS, InputError, format_name_suggestion, format_user_exception
from sweep.core.user_code import describe_user_error, report_slow_call, run_user_code
from sweep.systems.mujoco_model import learned_policy, onnx_network, policy_spec, torch_network
from sweep.systems.mujoco_model.actuation import JointPdControl
from sweep.systems.mujoco_model.onnx_network import Network
from sweep.systems.mujoco_model.terrain import TerrainConfig, replace_floor, require_level_floor
from sweep.systems.mujoco_model.torch_network import TORCH_SUFFIXES

ONNX_SUFFIX, BINARY_SUFFIX, PACKAGE_PREFIX = ".onnx", ".mjb", "package://"
NETWORK_SUFFIXES = (ONNX_SUFFIX, *TORCH_SUFFIXES)
ASSET_FOLDER_OPTIONS = ("meshdir", "texturedir", "assetdir")  # of a model's files, as its compiler's options name them
MODULE_MEMBERS = {  # what a module may say beside its functions
    "PARAMETERS": (Mapping, "numbers by name"),
    "BELIEVES": (Mapping, "paths by name"),
    "FIGURES": (Mapping, "meanings by name"),
    "FILES": ((list, tuple), "a list of names"),
}
STANDARD_LIBRARY, INSTALL_FOLDERS = (
    sysconfig.get_path("stdlib"),
    {"site-packages", "dist-packages"},
)  # of Python's own modules
_READ: dict[str, tuple[Path, str]] = {}  # of modules by name: the project that they were read in, and their digest


class LoadedController(NamedTuple):
    """Functions and tables of a loaded controller: from a user's Python module, or made from a neural network."""

    policy: Callable[..., Any]
    files: tuple[Path, ...]  # its source, what lies beside it in a package, and its `FILES`
    digest: str  # of these
    is_batched: bool  # of NumPy: from observations (n, k) to controls (n, nu), and told nothing else
    begin: Callable[..., Any] | None = None
    parameters: Mapping[str, float] = MappingProxyType({})  # its own numbers, which are axes: `PARAMETERS`
    belief_paths: Mapping[str, str] = MappingProxyType({})  # paths of what it is told of the model, by name: `BELIEVES`
    figures: Callable[..., Any] | None = None  # of a rollout, from the state that it ended with
    metric_meanings: Mapping[str, str] = MappingProxyType({})  # what these figures mean, by name: `FIGURES`
    measure: Callable[..., Any] | None = None  # what figures are made of, besides, as every tick begins
    observe: Callable[..., Any] | None = None  # what the policy is told, of all that can be observed by name
    folder: Path = Path()  # that its relative paths are from
    fitted_policy: learned_policy.LearnedPolicy | None = None  # of a network with a specification beside it

    @property
    def joint_control(self) -> JointPdControl | None:
        """Law that turns joint targets into controls at every physics step; None if commands are controls."""
        return self.fitted_policy.joint_control if self.fitted_policy else None


def project_folder() -> Path:
    """Return the folder that paths in a configuration are relative to."""
    return project.find_project() or Path.cwd()


def load_model(mjcf: str, ground: TerrainConfig | None = None, fields: int = 1) -> mujoco.MjModel:
    """Load and compile the model in an MJCF or URDF file. Raises `InputError`.

    Args:
        mjcf: The file, from the project's folder.
        ground: Terrain in the place of its floor.
        fields: Number of height fields of the terrain.
    """
    file = require_file("mjcf", mjcf, ".xml")
    return _compiled(file, file.stat().st_mtime_ns, ground, fields)


def require_file(key: str, name: str, suffix: str, group: str = "model") -> Path:
    """Return the file that a configuration key names. Raises `InputError` if it does not exist or is a study's result.

    Args:
        key: The key.
        name: The file, from the project's folder.
        suffix: End of the names of such files, for suggestions.
        group: The group that the key is in.
    """
    file = project_folder() / name
    if not name or not file.is_file():
        near = [str(f.relative_to(project_folder())) for f in sorted(project_folder().glob(f"**/*{suffix}"))[:50]]
        raise InputError(f"{group}.{key} = {name!r} is not a file{format_name_suggestion(name, near) if near else ''}")
    _refuse_results(f"{group}.{key}", name, [file])
    return file


def _refuse_results(key: str, name: str, found: Iterable[Path]) -> None:
    """Refuse files of a folder of results or of a crate, which may come from a stranger. Raises `InputError`."""
    if around := next(filter(None, map(project.find_enclosing_results, found)), None):
        raise InputError(
            f"{key} = {name} is not allowed: it lies in {around}, which holds results, perhaps of a stranger; to "
            "trust it, copy it into your project"
        )


def _refuse_foreign_module(controller: str, name: str) -> None:
    """Refuse a module of a folder of results, or of Python itself, before anything of it is imported.

    Args:
        controller: The controller, as the configuration names it.
        name: The module.

    Raises:
        InputError: The module, or a package that it is in, is not allowed.
    """
    first, *rest = name.split(".")
    spec = next(filter(None, (finder.find_spec(first, None) for finder in sys.meta_path)), None)
    while spec is not None:  # else the import reports it
        origin = str(spec.origin or "")
        own = origin in ("built-in", "frozen") or (
            origin.startswith(STANDARD_LIBRARY) and not INSTALL_FOLDERS & {*Path(origin).parts}
        )
        if own:
            raise InputError(f"model.controller = {controller} is not allowed: {name} is a module of Python itself")
        path = list(spec.submodule_search_locations or ())
        _refuse_results(
            "model.controller", controller, [*([Path(origin)] if origin else ()), *(Path(one, "any") for one in path)]
        )
        # by its last name, as packages around it are not imported yet
        spec = PathFinder.find_spec(rest.pop(0), path) if rest else None


@functools.lru_cache(maxsize=16)
def _compiled(file: Path, changed: int, ground: TerrainConfig | None, fields: int) -> mujoco.MjModel:
    mujoco.set_mju_user_warning(lambda _: None)  # what cannot be read is told below, and a row is invalid
    try:
        binary = file.suffix == BINARY_SUFFIX
        with report_slow_call(f"MuJoCo, which compiles model.mjcf = {file.name},"):
            if binary and not ground:
                made = mujoco.MjModel.from_binary_path(str(file))
            else:
                made = load_spec(file.name if binary else str(file), ground, fields).compile()
    except InputError:
        raise
    except (ValueError, RuntimeError) as error:
        reason, near = " ".join(str(error).split()), ""
        if lost := re.search(r"opening file '(?:.*/)?([^/']+)'", reason):
            there = {one.name for one in project_folder().rglob(f"*{Path(lost[1]).suffix}")}
            near = format_name_suggestion(lost[1], there) if there else ""
        raise InputError(f"model.mjcf = {file.name} does not compile: {reason}{near}") from None
    if ground:
        require_level_floor(made)
        bare = _compiled(file, changed, None, 1)  # pictures show the robot, and not the whole terrain
        made.stat.extent, made.stat.center[:] = bare.stat.extent, bare.stat.center
    if not made.nv:
        raise InputError(f"model.mjcf = {file.name} is not allowed: it has no joints, and nothing moves")
    return made


def load_spec(mjcf: str, ground: TerrainConfig | None = None, fields: int = 1) -> mujoco.MjSpec:
    """Load the editable source (`MjSpec`) of a model. Raises `InputError` where the model is a compiled file.

    Args:
        mjcf: The model's file, from the project's folder.
        ground: Terrain in the place of its floor.
        fields: Number of height fields of the terrain.
    """
    file = project_folder() / mjcf
    if file.suffix == BINARY_SUFFIX:
        what = "a terrain needs" if ground else "sizes and positions of geoms can vary in"
        raise InputError(f"model.mjcf = {mjcf} is compiled: {what} MJCF or URDF{'' if ground else ' only'}")
    source = _source(file, file.stat().st_mtime_ns)
    if ground:
        source = source.copy()
        replace_floor(source, ground, fields)
    return source


@functools.lru_cache(maxsize=16)
def _source(file: Path, changed: int) -> mujoco.MjSpec:
    with warnings.catch_warnings(action="ignore"):  # of how it could be saved
        spec = mujoco.MjSpec.from_file(str(file))
    for mesh in spec.meshes:
        if mesh.file.startswith(PACKAGE_PREFIX):  # of ROS: a package is a folder above the file
            _, *rest = mesh.file.removeprefix(PACKAGE_PREFIX).split("/")
            found = (folder.joinpath(*rest) for folder in file.absolute().parents)
            mesh.file = str(next((one for one in found if one.is_file()), "/".join(rest)))
    return spec


def list_files(mjcf: str) -> list[Path]:
    """List the file of a model and all files that it refers to: meshes, textures, height fields, included files."""
    main = project_folder() / mjcf
    found, folders = [main], {""}
    for file in found:  # which grows
        every = [one.attrib for one in ElementTree.parse(file).iter()] if file.suffix in (".xml", ".urdf") else []
        folders |= {value for one in every for key, value in one.items() if key in ASSET_FOLDER_OPTIONS}
        for named in (value for one in every for key, value in one.items() if key.startswith("file") and value):
            name = "/".join(named.removeprefix(PACKAGE_PREFIX).split("/")[named.startswith(PACKAGE_PREFIX) :])
            above = file.absolute().parents if named.startswith(PACKAGE_PREFIX) else [file.parent, main.parent]
            there = (up / folder / n for up in above for folder in folders for n in (name, Path(name).name))
            there = next((one for one in there if one.is_file()), None)
            if there and there not in found:
                found.append(there)
    return found


def digest_model(compiled: mujoco.MjModel) -> str:
    """Return a hash of all numbers of a compiled model, meshes included."""
    return hashlib.blake2b(model_bytes(compiled), digest_size=8).hexdigest()


def read_terrain_image(name: str) -> np.ndarray:
    """Read the brightness (rows, columns) of the pixels, 0 to 1, from a terrain's PNG file. Raises `InputError`."""
    from matplotlib.image import imread  # slow to import

    file = require_file("terrain.file", name, ".png")
    try:
        pixels = np.asarray(imread(file, format="png"), float)
    except (OSError, ValueError, SyntaxError) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"model.terrain.file = {name} is no PNG image: {reason}") from None
    if pixels.ndim == 3:  # colours, and opacity beside them
        pixels = pixels[..., :3].mean(axis=2) if pixels.shape[2] > 2 else pixels[..., 0]
    if min(pixels.shape) < 2:
        raise InputError(f"model.terrain.file = {name} is not allowed: at least 2 x 2 pixels")
    return pixels


def digest_file_contents(listed: Sequence[Path]) -> str:
    """Return a hash of the contents of the given files."""
    return _digest(listed)


def load_controller(name: str, model: mujoco.MjModel, keyframe: int, period: float) -> LoadedController:
    """Load a controller: a Python function named by `module:function`, or a network from a file.

    Args:
        name: `module:function`, or the network's file, from the project's folder.
        model: The model that it controls.
        keyframe: Index of the keyframe that rollouts start from; -1 for the model's default pose.
        period: s of a control tick.

    Returns:
        The controller.

    Raises:
        InputError: There is none, or it does not fit the model.
    """
    if name.endswith(NETWORK_SUFFIXES):
        return _load_network(name, model, keyframe, period)
    module_name, sign, function = name.partition(":")
    if not (sign and module_name and function):
        such = "a module and its function, such as my.walk:policy, or a network, such as walk.onnx"
        raise InputError(f"model.controller = {name!r} is not allowed: {such}")
    module = _module(name, module_name)
    if not callable(policy := getattr(module, function, None)):
        own = [key for key, value in vars(module).items() if callable(value) and not key.startswith("_")]
        raise InputError(f"model.controller = {name}: {function} is unknown{format_name_suggestion(function, own)}")
    named = [str(file) for file in getattr(module, "FILES", ())]
    folder = resolve_module_folder(Path(str(module.__file__)), named)
    files = [folder / file for file in named]
    for file in files:
        if not file.is_file():
            raise InputError(f"model.controller = {name}: FILES has {file.name}, which is not a file")
    files, more = (*project.module_source_files(module), *files), {"folder": folder, **_beside(name, module)}
    if batched := _batched(policy):
        return LoadedController(policy, files, _digest(files), batched, **more)
    parameters, believes = (getattr(module, key, {}) for key in ("PARAMETERS", "BELIEVES"))
    if both := {*parameters} & {*believes}:
        raise InputError(f"model.controller = {name}: {min(both)} is both in PARAMETERS and in BELIEVES")
    begin = getattr(module, "begin", None)
    return LoadedController(policy, files, _digest(files), batched, begin, parameters, believes, **more)


def controller_files(name: str) -> list[Path]:
    """List the files that a controller consists of, whatever model it drives. Raises `InputError`."""
    if not name.endswith(NETWORK_SUFFIXES):
        module = _module(name, name.partition(":")[0])
        named = [str(file) for file in getattr(module, "FILES", ())]
        folder = resolve_module_folder(Path(str(module.__file__)), named)
        return [*project.module_source_files(module), *(folder / file for file in named)]
    file = _require_network(name)
    found = list_network_files(file)
    found += [told] if (told := learned_policy.spec_path(file)).is_file() else []
    if file.with_suffix(".py").is_file():
        found += project.module_source_files(_module(name, ".".join(Path(name).with_suffix("").parts)))
    return found


def require_inside_project(path: str, name: str) -> None:
    """Raise `InputError` where a varied file name points outside the project's folder.

    Args:
        path: Path of the parameter, such as `model.mjcf`.
        name: File, from the project's folder, or a module and its function.
    """
    if Path(name).is_absolute() or ".." in Path(name).parts:
        raise InputError(f"{path} = {name} is not allowed as a value of an axis: a file within the project")


def _load_network(name: str, model: mujoco.MjModel, keyframe: int, period: float) -> LoadedController:
    """Load a network, which maps the observation to controls, or is as its specification says. Raises `InputError`."""
    file = _require_network(name)
    network, files, learned = read_network(name, file), list_network_files(file), None
    if spec := read_policy_spec(name):
        told = learned_policy.spec_path(file)
        files = [*files, told]
        learned = learned_policy.bind_policy_to_model(told.name, spec, network, model, keyframe, period)
        found = LoadedController(learned.policy, (), "", is_batched=False, begin=learned.begin, observe=learned.observe,
                                 parameters=spec.commands, fitted_policy=learned)  # fmt: skip
    else:
        found = LoadedController(onnx_network.make_stateless_policy(network), (), "", is_batched=False)
    digest = _digest(files)
    if file.with_suffix(".py").is_file():
        beside = project.module_source_files(module := _module(name, ".".join(Path(name).with_suffix("").parts)))
        said = _beside(name, module)
        if learned and said.pop("observe"):
            told = learned_policy.spec_path(file).name
            raise InputError(f"model.controller = {name}: `observe` is not allowed beside {told}")
        files, digest, found = [*files, *beside], f"{digest}-{_digest(beside)}", found._replace(**said)
    return found._replace(files=tuple(files), digest=digest, folder=project_folder())


def read_policy_spec(name: str) -> policy_spec.PolicySpec | None:
    """Read the specification file of a neural-network controller, by its name; None for other controllers."""
    if not name.endswith(NETWORK_SUFFIXES):
        return None
    told = learned_policy.spec_path(file := _require_network(name))
    return learned_policy.read_spec(told, read_network(name, file).metadata) if told.is_file() else None


def _require_network(name: str) -> Path:
    return require_file("controller", name, Path(name).suffix)


def read_network(name: str, file: Path) -> Network:
    """Read a neural network from an ONNX or PyTorch file. Raises `InputError`.

    Args:
        name: The name that messages give.
        file: The file.
    """
    read = torch_network.read_torch_network if name.endswith(TORCH_SUFFIXES) else onnx_network.read_network
    return read(name, file)


def list_network_files(file: Path) -> list[Path]:
    """List the file of a neural network and the files of its weights."""
    return [file] if file.name.endswith(TORCH_SUFFIXES) else onnx_network.network_files(file)


def _beside(name: str, module: Any) -> dict[str, Any]:
    """What a module says of a policy of any kind. Raises `InputError`."""
    found = {key: getattr(module, key, None) for key in ("figures", "measure", "observe")}
    measured = getattr(module, "FIGURES", {})
    if bool(measured) != callable(found["figures"]):
        raise InputError(f"model.controller = {name}: the function `figures` and the names FIGURES need each other")
    if odd := next((one for one in measured if not one.isidentifier()), None):
        raise InputError(f"model.controller = {name}: FIGURES has {odd!r}: a name has letters, digits and _")
    return {**found, "metric_meanings": measured}


def _module(controller: str, name: str) -> ModuleType:
    """The module of a name, from the project's folder, as its files are now. Raises `InputError`.

    A process that goes on may know it as it was, or one of another project.
    """
    here, old, read = project_folder(), sys.modules.get(name), _READ.get(name)
    sys.path[:] = [str(here), *(path for path in sys.path if path != str(here))]
    if (
        old
        and read
        and read != (here, _digest(project.module_source_files(old)))
        and read[0] in Path(old.__file__ or "").parents
    ):
        package = name.partition(".")[0]
        for stale in [one for one in sys.modules if one == package or one.startswith(f"{package}.")]:
            del sys.modules[stale]
        importlib.invalidate_caches()
    _refuse_foreign_module(controller, name)
    try:
        with run_user_code(f"{name}, which is imported,", _folder_of_module(name)):
            module = importlib.import_module(name)
        _READ[name] = here, _digest(project.module_source_files(module))
    except USER_CODE_ERRORS as error:
        reason = describe_user_error(error, here) or format_user_exception(error)
        raise InputError(f"model.controller = {controller} cannot be imported: {reason}") from None
    for key, (form, what) in MODULE_MEMBERS.items():
        said = getattr(module, key, ())
        words = [*said, *(said.values() if key == "BELIEVES" else ())] if said and isinstance(said, form) else []
        if said != () and not (isinstance(said, form) and all(isinstance(one, str | Path) for one in words)):
            raise InputError(f"model.controller = {controller}: {key} = {said!r} is not allowed: {what}")
    return module


def resolve_module_folder(source: Path, file_names: Sequence[str]) -> Path:
    """Return the folder for relative paths in a user's module: its own if its `FILES` are there, else the project's."""
    beside = source.resolve().parent
    return (
        beside if file_names and all((beside / file).is_file() for file in file_names) else project_folder().resolve()
    )


def _folder_of_module(name: str) -> Path:
    """`resolve_module_folder` of a module that is not imported yet, by what its source says of `FILES`."""
    source = project_folder() / Path(*name.split(".")).with_suffix(".py")
    if not source.is_file():
        source = project_folder().joinpath(*name.split("."), "__init__.py")
    named: list[str] = []
    with contextlib.suppress(OSError, SyntaxError, ValueError, TypeError):  # which the import reports
        for node in ast.parse(source.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "FILES":
                named = [str(one) for one in ast.literal_eval(node.value)]
    return resolve_module_folder(source, named)


def _batched(policy: Callable[..., Any]) -> bool:
    """Whether a function takes observations only."""
    try:
        every = inspect.signature(policy).parameters.values()
    except ValueError:  # not known of what is built in, which is found out by calling it
        return False
    places = [one for one in every if one.kind in (one.POSITIONAL_ONLY, one.POSITIONAL_OR_KEYWORD)]
    return len([one for one in places if one.default is one.empty]) == 1


def _digest(files: Sequence[Path]) -> str:
    return hashlib.blake2b(b"\0".join(file.read_bytes() for file in files), digest_size=8).hexdigest()
