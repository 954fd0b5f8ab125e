"""`sweep replay` on a small result folder; the engine is a stand-in, the files and the batch are real."""

import dataclasses
import json

import numpy as np
import pytest
from faultless import faultless
from mcap.reader import make_reader

from sweep.cli.commands import execute_command
from sweep.config.experiment import compose
from sweep.core.parameters import InputError
from sweep.replay import replay as module
from sweep.runs import batches, runner, store

WIDTH = 3
AXIS = "+study.axes.friction={path: contact.friction, side: world, values: [0.2, 0.4, 0.6, 0.8, 1.0]}"


class StandInEngine:
    """Slips the more the less friction there is, and depends on its batch's width as real engines do."""

    stages = ("stand", "left tripod", "right tripod")
    duration = 1.0
    width = WIDTH
    devices = 1
    dynamics = "none"

    def __init__(self, trace):
        self._trace = trace

    def run(self, world, belief, streams):
        assert len(streams) == WIDTH
        figures = {name: np.full(WIDTH, value) for name, value in faultless(world).items()}
        friction = np.asarray(world.contact.friction, np.float32)
        slow = np.where(friction < 0.5, 0.5, 1.0)
        return {**figures, "slip_max_m": 1e-4 / friction + 1e-3 * (streams % 7), "progress": slow}

    def trace(self, world, belief, streams, slot):
        figures = {name: values[slot] for name, values in self.run(world, belief, streams).items()}
        return dataclasses.replace(self._trace, metrics=figures)


@pytest.fixture(scope="module")
def folder(trace, tmp_path_factory):
    folder = tmp_path_factory.mktemp("replay") / "slip"
    with pytest.MonkeyPatch.context() as patch:
        for place in (batches, runner, module):
            patch.setattr(place, "make_engine", lambda *_: StandInEngine(trace))
        exp = compose(["scenario=walk_tripod", "study.name=slip", f"engine.width={WIDTH}", AXIS])
        with store.lock_folder(folder):
            runner.run_job(runner.prepare_job(exp, folder, runner.select_points_to_simulate(exp)), lambda rows: None)
        yield folder


@pytest.mark.parametrize("number", range(5))
def test_every_point_is_found_in_its_slot(folder, number, capsys):
    row = store.read_rows(folder).iloc[number]
    result = module.replay_rollout(folder, row["point_id"][:10])
    assert result.stored["point_id"] == row["point_id"]
    assert result.again["slip_max_m"] == row["slip_max_m"]
    friction = row["world.contact.friction"]
    assert result.again["outcome"] == row["outcome"] == ("failure" if friction < 0.5 else "success")
    assert result.config["point"]["world.contact.friction"] == friction
    assert execute_command(["replay", str(folder), str(number)]) == 0
    shown = capsys.readouterr().out
    assert row["point_id"] in shown
    assert "metrics are equal to the last bit" in shown
    assert "slip_max_m" not in shown  # only what differs is listed


def test_what_differs_is_shown(folder, trace, monkeypatch, capsys):
    class Other(StandInEngine):
        def run(self, world, belief, streams):
            return {**super().run(world, belief, streams), "tilt_max_deg": np.full(WIDTH, 30.0)}

    monkeypatch.setattr(module, "make_engine", lambda *_: Other(trace))
    monkeypatch.setattr("sweep.core.provenance.code_version", lambda: "another")
    execute_command(["replay", str(folder), "4"])
    lines = capsys.readouterr().out.splitlines()
    assert [line.split() for line in lines if line.startswith(("outcome", "tilt"))] == [
        ["outcome", "success", "failure"],
        ["tilt_max_deg", "0", "30"],
    ]
    assert lines[-1].startswith("the row was simulated with other code")


def test_files(folder, tmp_path):
    out = tmp_path / "new" / "walk"
    execute_command(["replay", str(folder), "1", "--mcap", f"{out}.mcap", "--plot", "base", "feet", "-o", f"{out}.svg"])
    assert {f.name for f in out.parent.iterdir()} == {"walk.mcap", "walk.layout.json", "walk-base.svg", "walk-feet.svg"}
    with out.with_suffix(".mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        config = json.loads(next(reader.iter_attachments()).data)
        outcome = next(reader.iter_metadata()).metadata
    assert config["point"]["world.contact.friction"] == 0.4
    assert config["engine"]["width"] == WIDTH
    assert outcome["cause"] == "goal_missed"


def test_one_plot_has_the_name_given(folder, tmp_path):
    execute_command(["replay", str(folder), "0", "--plot", "joints", "-o", str(tmp_path / "angles.png")])
    assert (tmp_path / "angles.png").exists()


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["99"], "99 is not a point"),
        (["0", "--plot", "base"], "go together"),
        (["0", "-o", "base.png"], "go together"),
        (["0", "--plot", "base", "-o", "base.doc"], r"base\.doc is not allowed"),
        (["0", "--video", "walk.avi"], r"walk\.avi is not allowed: a file that ends in mp4"),
    ],
)
def test_bad_arguments_are_one_line(folder, args, message):
    with pytest.raises(InputError, match=message) as error:
        execute_command(["replay", str(folder), *args])
    assert "\n" not in str(error.value)


def test_a_recording_for_foxglove_needs_its_extra(folder, monkeypatch):
    monkeypatch.setattr("sweep.cli.commands.replay.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"--mcap is not allowed: .* pip install 'insect-sweep\[mcap\]'"):
        execute_command(["replay", str(folder), "0", "--mcap", "walk.mcap"])


def test_folder_without_results(tmp_path):
    with pytest.raises(InputError, match="not a folder of results"):
        execute_command(["replay", str(tmp_path), "0"])
