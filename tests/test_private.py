"""Parts of others that they do not promise to keep, and that we need: a version that changes one of them is named."""

import ast
import inspect
from importlib.metadata import version
from pathlib import Path
from pkgutil import resolve_name

import mujoco
import pytest
from mujoco import mjx

PACKAGE = Path(__file__).parents[1] / "sweep"
TRIED = {"hydra-core": "1.3.8", "omegaconf": "2.3.1", "mujoco-mjx": "3.17.0", "jax": "0.12.0.1"}
PARTS = {  # what it belongs to, and what it is called with
    "hydra._internal.core_plugins.file_config_source:FileConfigSource.load_config": ("hydra-core", "self config_path"),
    "hydra._internal.utils:get_args_parser": ("hydra-core", ""),
    "hydra._internal.sources_registry:SourcesRegistry.instance": ("hydra-core", "args kwargs"),
    "hydra.plugins.config_source:ConfigSource._get_header_dict": ("hydra-core", "config_text"),
    "omegaconf:DictConfig._get_node": ("omegaconf", "self key validate_access validate_key throw_on_missing_value throw_on_missing_key"),  # noqa: E501
    "mujoco.mjx._src.math:inert_mul": ("mujoco-mjx", "i v"),
    "mujoco.mjx._src.smooth:kinematics": ("mujoco-mjx", "m d"),
    "mujoco.mjx._src.smooth:com_pos": ("mujoco-mjx", "m d"),
    "mujoco.mjx._src.smooth:crb": ("mujoco-mjx", "m d"),
    "mujoco.mjx._src.smooth:com_vel": ("mujoco-mjx", "m d"),
    "mujoco.mjx._src.smooth:rne": ("mujoco-mjx", "m d flg_acc"),
}  # fmt: skip


def changed(name: str, package: str, how: str) -> str:
    return f"{package} {version(package)} changed {name}: {how} (tried with {TRIED[package]})"


@pytest.mark.parametrize(("name", "package", "called"), [(name, *of) for name, of in PARTS.items()])
def test_a_private_part_is_as_it_was(name, package, called):
    try:
        found = " ".join(inspect.signature(resolve_name(name)).parameters)
    except (ImportError, AttributeError) as error:
        pytest.fail(changed(name, package, str(error)))
    assert found == called, changed(name, package, f"it takes {found}")


def test_composite_inertias_are_where_they_were():
    model = mjx.put_model(mujoco.MjModel.from_xml_string("<mujoco/>"))
    assert hasattr(mjx.make_data(model)._impl, "crb"), changed("Data._impl.crb", "mujoco-mjx", "it is gone")


def test_every_private_module_in_use_is_held_here():
    held = {name.partition(":")[0] for name in PARTS}
    for file in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            modules = [one.name for one in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                modules = [str(node.module), *(f"{node.module}.{one.name}" for one in node.names)]
            for module in modules:
                if any(part.startswith("_") and part != "__future__" for part in module.split(".")):
                    assert any(module.startswith(one) or one.startswith(module) for one in held), f"{file}: {module}"
