"""`sweep export-model`: the six-legged robot, its plan and its metrics as a project with a user model."""

import argparse
from pathlib import Path

from sweep.cli.command import Command, Section
from sweep.cli.exits import DONE
from sweep.core.arguments import Arguments, is_positional
from sweep.core.errors import InputError
from sweep.core.files import write_atomically

COMMAND = Command(Section.SHARE, "export the built-in robot as a MuJoCo model")
EPILOG = """C MuJoCo and MJX simulate the exported robot with their own physics, a check of this
package's. The folder is a project.
MuJoCo reads robot.mjb, which has all digits; robot.xml is the same to read, to six.
example:
  sweep export-model scenario=pole_climb out=pole
  cd pole; sweep run scenario=own; sweep run scenario=own engine=mjx"""
CONTROLLER_TEMPLATE = '''\
"""Plan, tracker and metrics of {scenario} for a user model; written by `sweep export-model`."""

from pathlib import Path

import yaml

from sweep.config.experiment import build_experiment
from sweep.systems.hexapod.exported import make_controller

FILES = ["case.yaml"]
exp = build_experiment(yaml.safe_load(Path(__file__).with_name(FILES[0]).read_text(encoding="utf-8")))
begin, policy, figures, PARAMETERS, FIGURES = make_controller(exp.case, exp.settings, exp.thresholds)
'''


def add_arguments(parser: Arguments) -> None:
    """Add no flags: every word after `sweep export-model` is an override of the configuration."""
    parser.others = is_positional
    parser.usage = "sweep export-model scenario=NAME [group.name=value ...] out=DIR"
    parser.description = __doc__
    parser.epilog = EPILOG


def run(args: argparse.Namespace) -> int:
    """Export a scenario as a project with a MuJoCo model. Raises `InputError` if it cannot, or a file is there."""
    import yaml

    from sweep.backends.binary import model_bytes
    from sweep.config.experiment import compose
    from sweep.systems.hexapod import exported

    exp = compose(args.overrides)
    if why := exp.system.unsupported_commands.get("export-model"):
        raise InputError(f"export-model is not allowed: {why}")
    if not exp.study.single:
        raise InputError("study is not allowed: export-model exports a single scenario")
    if not exp.values["out"]:
        raise InputError("out is missing: a new or empty folder")
    exported.check_exportable_to_mjcf(exp.case)
    folder, module = Path(exp.values["out"]), f"{exp.scenario}_policy"
    about = exported.make_exported_scenario(exp.case, exp.settings, exp.thresholds, "robot.mjb", f"{module}:policy")
    spec = exported.make_mujoco_spec(exp.case, exp.settings)
    model, case = spec.compile(), {key: value for key, value in exp.values.items() if key != "out"}
    texts = {
        "sweep.yaml": "# A sweep project, written by `sweep export-model`\nmodules: []\n",
        "scenarios/own.yaml": f"# {exp.scenario} as a user model\n{yaml.safe_dump(about, sort_keys=False, width=110)}",
        "case.yaml": yaml.safe_dump({**case, "out": None}, sort_keys=False),
        f"{module}.py": CONTROLLER_TEMPLATE.format(scenario=exp.scenario),
        "robot.xml": spec.to_xml(),
    }
    for name in (*texts, "robot.mjb"):
        if (folder / name).exists():
            raise InputError(f"out = {folder} is not allowed: {name} is there already")
    folder.mkdir(parents=True, exist_ok=True)
    # the largest file first: a full disk then leaves no other
    write_atomically(folder / "robot.mjb", model_bytes(model))
    for name, text in texts.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        write_atomically(folder / name, text.encode())
    print(f"{folder}: cd {folder}; sweep run scenario=own")
    return DONE
