"""The Foxglove layout file that is written beside an MCAP trace."""

from itertools import cycle
from typing import Any

from sweep.contract.engine import Trace
from sweep.contract.trace_frames import base_body_id, joint_names
from sweep.core.plot_style import LEG_COLORS
from sweep.replay.model_geoms import body_name

_EFFORT = '/joint_states.joints[:]{{name=="{}"}}.effort'


def foxglove_layout(trace: Trace) -> dict[str, Any]:
    """Return a layout of Foxglove panels for a recorded rollout, as its "import from file" reads it.

    It has a 3D view that follows the base, and panels of torques, foot loads, stages and outcome.
    """
    legs = [str(leg + 1) for leg in range(trace.foot_position.shape[1])]
    plots = {"Plot!torque": _plot("torque of joints (N·m)", _EFFORT.format("{}"), joint_names(trace.model))}
    if legs:
        kinds = dict.fromkeys(name.rstrip("0123456789") for name in joint_names(trace.model))
        plots = {f"Plot!{kind}": _plot(f"torque of {kind} (N·m)", _EFFORT.format(kind + "{}"), legs) for kind in kinds}
        plots["Plot!load"] = _plot("load of feet (N)", "/foot_load.foot{}", legs)
    panels = {
        "3D!robot": _view(body_name(trace.model, base_body_id(trace.model))),
        **plots,
        "StateTransitions!stage": {
            "paths": [{"value": "/stage.name", "timestampMethod": "receiveTime"}],
            "isSynced": True,
        },
        "RawMessages!outcome": {"topicPath": "/outcome"},
    }
    left = _split("column", "3D!robot", "StateTransitions!stage", 85)
    right = _split("column", _column(list(plots)), "RawMessages!outcome", 70)
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _split("row", left, right, 60),
    }


def _split(direction: str, first: Any, second: Any, percentage: float) -> dict[str, Any]:
    return {"direction": direction, "first": first, "second": second, "splitPercentage": percentage}


def _column(panels: list[str]) -> Any:
    """Stack panels of equal height."""
    first, *rest = panels
    return _split("column", first, _column(rest), 100 / len(panels)) if rest else first


def _view(followed: str) -> dict[str, Any]:
    return {
        "cameraState": {
            "perspective": True,
            "distance": 4,
            "phi": 65,
            "thetaOffset": 60,
            "target": [0, 0, 0],
            "targetOffset": [0, 0, 0],
            "targetOrientation": [0, 0, 0, 1],
            "fovy": 45,
            "near": 0.01,
            "far": 500,
        },
        "followMode": "follow-position",
        "followTf": followed,
        "scene": {"transforms": {"visible": False}},
        "topics": {"/scene": {"visible": True}, "/contact_force": {"visible": True}},
    }


def _plot(title: str, path: str, names: list[str]) -> dict[str, Any]:
    """Plot panel with a line for each name or leg, which is inserted at the braces of `path`."""
    series = [
        {
            "value": path.replace("{}", name),
            "label": f"leg {name}" if name.isdecimal() else name,
            "enabled": True,
            "timestampMethod": "receiveTime",
            "color": color,
        }
        for name, color in zip(names, cycle(LEG_COLORS), strict=False)
    ]
    return {
        "foxglovePanelTitle": title,
        "paths": series,
        "xAxisVal": "timestamp",
        "isSynced": True,
        "showLegend": True,
        "legendDisplay": "floating",
        "showXAxisLabels": True,
        "showYAxisLabels": True,
    }
