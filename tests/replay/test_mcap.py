"""The MCAP file, read back by another library than the one that wrote it."""

import dataclasses
import json
import resource
import struct
from collections import Counter, defaultdict

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from moved import arm
from scipy.spatial import ConvexHull

from sweep.contract import trace_frames
from sweep.contract.engine import Trace
from sweep.core.errors import Fault
from sweep.core.json_values import to_json_value
from sweep.models.legs import JOINT_KINDS
from sweep.replay.arrows import FORCE_SCALE, arrow_tips
from sweep.replay.hulls import geom_hull
from sweep.replay.mcap import rotation_from_x_axis, write_mcap

CONFIG = {"robot": {"thigh": 0.52, "shin": np.float64(0.335)}, "limits": [np.inf, 1]}
OUTCOME = {"outcome": "success", "cause": "", "slip_max_m": np.float32(0.25), "clearance_min_m": float("nan")}


@pytest.fixture(scope="module")
def written(trace, tmp_path_factory):
    path = tmp_path_factory.mktemp("mcap") / "walk.mcap"
    write_mcap(path, trace, CONFIG, OUTCOME)
    return path


def _messages(path):
    found = defaultdict(list)
    with path.open("rb") as stream:
        for schema, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
            found[channel.topic].append((schema and schema.name, message))
    return found


def test_file_is_sound(written):
    with written.open("rb") as stream:
        records = Counter(type(record).__name__ for record in StreamReader(stream, validate_crcs=True).records)
    with written.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert records["DataEnd"] == 1
    assert summary.statistics.message_count == sum(len(m) for m in _messages(written).values())


def test_channels_schemas_and_counts(written, trace):
    found = _messages(written)
    assert {topic: (messages[0][0], len(messages)) for topic, messages in found.items()} == {
        "/scene": ("foxglove.SceneUpdate", 1),
        "/contact_force": ("foxglove.SceneUpdate", 50),
        "/tf": ("foxglove.FrameTransforms", 50),
        "/joint_states": ("foxglove.JointStates", len(trace.time)),
        "/foot_load": ("sweep.FootLoad", len(trace.time)),
        "/stage": ("sweep.Stage", 3),
        "/outcome": ("sweep.Outcome", 1),
    }


def test_log_time_is_simulated_time(written, trace):
    for messages in _messages(written).values():
        times = [message.log_time for _, message in messages]
        assert times == sorted(times)
        assert times[0] == 4_000_000
    loads = _messages(written)["/foot_load"]
    np.testing.assert_allclose([m.log_time / 1e9 for _, m in loads], trace.time, atol=1e-9)


def test_json_messages(written, trace):
    found = _messages(written)
    load = json.loads(found["/foot_load"][100][1].data)
    assert list(load) == [f"foot{leg}" for leg in range(1, 7)]
    np.testing.assert_allclose(list(load.values()), np.linalg.norm(trace.foot_force[100], axis=-1))
    assert [json.loads(m.data)["name"] for _, m in found["/stage"]] == list(trace.stages)
    expected = {"outcome": "success", "cause": "", "slip_max_m": 0.25, "clearance_min_m": None}
    assert json.loads(found["/outcome"][0][1].data) == expected


def test_joints_are_numbers_of_foxgloves_own_schema(written, trace):
    """Name, angle, rate and torque of each joint, in the order of the fields of `foxglove.JointState`."""
    message = _messages(written)["/joint_states"][100][1].data
    angle, rate, torque = (
        trace_frames.joint_positions(trace)[100],
        trace_frames.joint_rates(trace)[100],
        trace.joint_torque[100],
    )
    for k, name in enumerate(f"{kind}{leg}" for leg in range(1, 7) for kind in JOINT_KINDS):
        assert message.count(name.encode()) == 1
        rest = message[message.index(name.encode()) + len(name) :]
        found = {rest[at] >> 3: struct.unpack_from("<d", rest, at + 1)[0] for at in (0, 9, 18)}
        assert found == pytest.approx({2: angle[k], 3: rate[k], 5: torque[k]})


def test_bodies_and_forces_are_in_the_messages(written):
    """Names are stored as plain text in the encoded messages; an arrow makes its message longer."""
    found = _messages(written)
    scene, transforms = found["/scene"][0][1].data, found["/tf"][0][1].data
    for name in (b"base", b"ball", b"thigh1", b"shin6"):
        assert name in scene
        assert name in transforms
    assert b"step" in scene
    assert b"step" not in transforms  # it cannot move
    sizes = [len(m.data) for _, m in found["/contact_force"]]
    assert min(sizes) > 3 * 80  # three arrows of eleven doubles and more


def test_config_is_attached(written):
    with written.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        (attachment,) = reader.iter_attachments()
        (metadata,) = reader.iter_metadata()
    assert attachment.name == "config.json"
    assert json.loads(attachment.data) == {"limits": [None, 1], "robot": {"shin": 0.335, "thigh": 0.52}}
    assert metadata.metadata == {"outcome": "success", "cause": "", "slip_max_m": "0.25", "clearance_min_m": ""}


def test_a_device_has_no_layout_beside_it(trace, tmp_path):
    (tmp_path / "device.mcap").symlink_to("/dev/null")
    write_mcap(tmp_path / "device.mcap", trace, CONFIG, OUTCOME)
    assert [path.name for path in tmp_path.iterdir()] == ["device.mcap"]


def test_same_input_same_bytes(written, trace, tmp_path):
    write_mcap(tmp_path / "again.mcap", trace, CONFIG, dict(reversed(OUTCOME.items())))
    assert (tmp_path / "again.mcap").read_bytes() == written.read_bytes()


def test_a_model_without_feet_has_its_joints_and_meshes(tmp_path):
    trace = arm()
    write_mcap(tmp_path / "arm.mcap", trace, {}, {"outcome": "success"})
    panels = json.loads((tmp_path / "arm.layout.json").read_text())["configById"]
    assert [path["label"] for path in panels["Plot!torque"]["paths"]] == ["joint_1", "joint_3"]
    assert panels["3D!robot"]["followTf"] == "trunk"
    vertices, faces = geom_hull(trace.model, 1)
    assert len(faces) <= 2 * len(vertices) - 4 <= 76
    full = trace.model.mesh_vert
    assert 0.8 < ConvexHull(vertices).volume / ConvexHull(full).volume <= 1
    for face in faces:  # counterclockwise, seen from outside
        a, b, c = vertices[face]
        assert np.cross(b - a, c - a) @ (a + b + c) > 0


def test_layout_names_what_is_in_the_file(written):
    layout = json.loads(written.with_suffix(".layout.json").read_text())
    panels = layout["configById"]
    assert panels["3D!robot"]["followTf"] == "base"
    topics = set(_messages(written))
    values = [path["value"] for panel in panels.values() for path in panel.get("paths", [])]
    assert {value.split(".")[0] for value in values} | set(panels["3D!robot"]["topics"]) <= topics

    def leaves(node):
        return [node] if isinstance(node, str) else leaves(node["first"]) + leaves(node["second"])

    assert sorted(leaves(layout["layout"])) == sorted(panels)


def test_frames_after_the_simulation_broke_are_left_out(trace: Trace, tmp_path):
    qpos = trace.qpos.copy()
    qpos[100:] = np.nan
    write_mcap(tmp_path / "broken.mcap", dataclasses.replace(trace, qpos=qpos), {}, {"outcome": "invalid"})
    assert len(_messages(tmp_path / "broken.mcap")["/joint_states"]) == 100
    with pytest.raises(ValueError, match="no finite frame"):
        write_mcap(tmp_path / "x.mcap", dataclasses.replace(trace, qpos=np.full_like(qpos, np.nan)), {}, {})


def test_arrow_starts_at_the_foot_and_points_along_the_force():
    feet, force = np.arange(18.0).reshape(6, 3), np.zeros((6, 3))
    force[0], force[1] = [100, 0, -20], [0, 0, 0.1]  # the second is too small to show
    tips = arrow_tips(feet, force)
    np.testing.assert_allclose(tips[0] - feet[0], FORCE_SCALE * force[0])
    np.testing.assert_array_equal(tips[1:], feet[1:])


@pytest.mark.parametrize("force", [[1.0, 0, 0], [0, 0, 1], [0, 0, -1], [-0.5, 0.2, 0.7]])
def test_turning_x_into_the_force(force):
    w, x, y, z = rotation_from_x_axis(np.array(force))
    turned_x = [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)]
    np.testing.assert_allclose(turned_x, np.array(force) / np.linalg.norm(force), atol=1e-9)


def test_plain_is_json():
    assert to_json_value({2: np.arange(2), "1": (True, np.inf), "a": None}) == {
        "1": [True, None],
        "2": [0, 1],
        "a": None,
    }


@pytest.mark.parametrize("room", [0, 100, 5000])
def test_a_file_without_room_is_told_and_left_out(trace, tmp_path, room):
    """At whatever write it ends: Foxglove says it of the one that fails, or of one after it."""
    before, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, most))
    try:
        with pytest.raises(Fault, match=r"x\.mcap cannot be written"):
            write_mcap(tmp_path / "x.mcap", trace, CONFIG, OUTCOME)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (before, most))
    assert not list(tmp_path.iterdir())
