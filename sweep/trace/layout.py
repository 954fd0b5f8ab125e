"""The Foxglove layout that is written beside a trace."""

from typing import Any

from sweep.trace.sampling import BASE, KINDS

LEG_COLORS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00")  # Okabe and Ito, safe when colour-blind


def layout() -> dict[str, Any]:
    """3D view that follows the base, torques, loads, stages and outcome, as Foxglove's "import from file" reads it."""
    panels = {
        "3D!robot": _view(),
        **{f"Plot!{kind}": _torques(kind) for kind in KINDS},
        "Plot!load": _plot("load of feet (N)", "/foot_load.foot{}"),
        "StateTransitions!stage": {
            "paths": [{"value": "/stage.name", "timestampMethod": "receiveTime"}],
            "isSynced": True,
        },
        "RawMessages!outcome": {"topicPath": "/outcome"},
    }
    first, second, third = (f"Plot!{kind}" for kind in KINDS)
    torques = _split("column", first, _split("column", second, third, 50), 33)
    plots = _split("column", torques, "Plot!load", 75)
    left = _split("column", "3D!robot", "StateTransitions!stage", 85)
    right = _split("column", plots, "RawMessages!outcome", 70)
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _split("row", left, right, 60),
    }


def _split(direction: str, first: Any, second: Any, percentage: float) -> dict[str, Any]:
    return {"direction": direction, "first": first, "second": second, "splitPercentage": percentage}


def _view() -> dict[str, Any]:
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
        "followTf": BASE,
        "scene": {"transforms": {"visible": False}},
        "topics": {"/scene": {"visible": True}, "/contact_force": {"visible": True}},
    }


def _torques(kind: str) -> dict[str, Any]:
    return _plot(f"torque of {kind} (N m)", '/joint_states.joints[:]{{name=="' + kind + '{}"}}.effort')


def _plot(title: str, path: str) -> dict[str, Any]:
    """A line for each leg, whose number stands at the braces of `path`."""
    series = [
        {
            "value": path.format(leg),
            "label": f"leg {leg}",
            "enabled": True,
            "timestampMethod": "receiveTime",
            "color": color,
        }
        for leg, color in enumerate(LEG_COLORS, start=1)
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
