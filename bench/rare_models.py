"""Coverage of rare-failure intervals on small MuJoCo models.

`python bench/rare_models.py [ENGINE [SEARCHES [PLAIN [MODEL...]]]]` writes research/data/rare_models.json, which
research/certainty.md cites; models of another call stay in it. Three models with contacts are pushed: a box that tips
over, a tripod on sprung legs, and the quadruped of `sweep init --model`. The spread of the push is chosen so that about
one of a thousand draws fails. Fresh plain draws give the probability; repeated importance sampling, all repetitions
side by side, shows how often its interval holds it. `formulas` as a model does so with formulas in place of rollouts,
and rounds of several sizes. `draw` as an engine draws the intervals of what the file has.
"""

import contextlib
import os
import sys
import tempfile
import time
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import rare
import shared
from scipy.special import ndtri

from sweep.analysis.intervals import clopper_pearson
from sweep.backends.run_id import describe_device
from sweep.config.experiment import compose
from sweep.contract.engine_settings import EngineSettings
from sweep.core.plot_style import LEG_COLORS, new_figure, plot_style, save_figure
from sweep.core.provenance import version_record
from sweep.runs.batches import make_engine, make_nominal_batch
from sweep.study import importance_sampling
from sweep.study.adaptive_sampling import RoundDraws, RoundSummary
from sweep.study.design_kinds.base import FailureEstimate
from sweep.study.design_kinds.importance import ImportanceSampling
from sweep.study.study import make_points

FILE = shared.DATA / "rare_models.json"
NUM = int(os.environ.get("RARE_NUM", "2048"))  # draws of a round, as in conf/study/any_rare.yaml
HOLDS, MISSES = LEG_COLORS[0], LEG_COLORS[5]  # colours of intervals
TRIED, WIDTH = 256, int(os.environ.get("RARE_WIDTH", "65536"))  # pushes tried, rollouts of a batch
TARGET, TRIALS = 1e-3, 4  # probability that the spread of the push aims at, batches that look for it
HEAD = ["model", "failures of plain draws", "probability", "median of the searches", "rollouts of a search",
        "intervals hold the probability", "touch its interval", "called reliable", "of these hold it"]  # fmt: skip
BOX = """<mujoco><option timestep="0.002"/>
<worldbody><geom name="floor" type="plane" size="0 0 1"/>
<body name="trunk" pos="0 0 0.3"><freejoint/><geom name="box" type="box" size="0.12 0.1 0.3" mass="3"/>
<body name="head" pos="0 0 0.3"><joint name="neck" type="slide" axis="0 0 1" range="0 0.02"/>
<geom type="sphere" size="0.02" mass="0.1" contype="0" conaffinity="0"/></body></body></worldbody>
<actuator><motor name="neck" joint="neck"/></actuator></mujoco>"""
STILL = "import jax.numpy as jnp\ndef policy(belief, seen, state, key): return jnp.zeros(1), state\n"
LEG = """<body name="{name}" pos="{x} {y} 0"><joint name="{name}" axis="0 1 0" range="-60 60" damping="0.2"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.36" size="0.02" mass="0.3" contype="0" conaffinity="0"/>
<geom type="sphere" size="0.06" pos="0 0 -0.36" mass="0.1"/></body>"""
PLACES = {"left": (0.2, 0.15), "right": (0.2, -0.15), "rear": (-0.2, 0.0)}
TRIPOD = f"""<mujoco><option timestep="0.002" integrator="Euler"/>
<worldbody><geom name="floor" type="plane" size="0 0 1" friction="0.8"/>
<body name="trunk" pos="0 0 0.42"><freejoint/><geom name="trunk" type="sphere" size="0.1" mass="2" contype="0"/>
{"".join(LEG.format(name=name, x=x, y=y) for name, (x, y) in PLACES.items())}</body></worldbody>
<actuator>{"".join(f'<position name="{name}" joint="{name}" kp="150" kv="4"/>' for name in PLACES)}</actuator>
</mujoco>"""
HOLD = "import jax.numpy as jnp\ndef policy(belief, seen, state, key): return jnp.zeros(3), state\n"
# by name: what is simulated, model, controller, seconds, condition of failure, and the largest push (N s) that is tried
MODELS = {
    "box": ("box that is pushed", "box.xml", "still:policy", 1.0, "tilt_max_deg > 45", 8.0),
    "tripod": ("tripod that is pushed", "tripod.xml", "hold:policy", 1.5, "tilt_max_deg > 60", 16.0),
    "quadruped": ("quadruped that trots and is pushed", "quadruped.xml", "trot:policy", 2.0,
                  "base_height_min_m < 0.15", 40.0),
}  # fmt: skip
MEAN = 0.7  # of the push, in units of the push that fails at nominal values
FILES = {"box.xml": BOX, "still.py": STILL, "tripod.xml": TRIPOD, "hold.py": HOLD, "sweep.yaml": "modules: []\n"}


def write_study(name: str, threshold: float, deviations: float) -> str:
    """Write the study of a model and return its file.

    Args:
        name: name of the model.
        threshold: push (N s) that fails at nominal values.
        deviations: by how many standard deviations the mean push is below it.
    """
    _, model, controller, duration, fell, _ = MODELS[name]
    mean, spread = MEAN * threshold, (1 - MEAN) * threshold / deviations
    extra = ", keyframe: home, observe: [turn, spin], sensors: current" if model == "quadruped.xml" else ""
    Path("study.yaml").write_text(f"""system: mujoco
model: {{mjcf: {model}, controller: "{controller}", duration: {duration}{extra}}}
push: {{kick: {{body: trunk, start: 0.3}}}}
outcome: {{fell: {fell}}}
study:
  name: rare
  replays: 0
  design: {{kind: importance, num: {NUM}, rounds: 2}}
  axes:
    kick: {{path: push.kick.impulse, distribution: {{kind: normal, mean: {mean}, std: {spread}}}}}
    way: {{path: push.kick.direction, distribution: {{kind: normal, mean: 0, std: 0.3}}}}
    rise: {{path: push.kick.elevation, distribution: {{kind: normal, mean: 0, std: 0.1}}}}
    begin: {{path: push.kick.start, distribution: {{kind: uniform, from: 0.2, to: 0.4}}}}
""")
    return "study.yaml"


class Rollouts:
    """Rollouts of a study on one engine."""

    def __init__(self, study: str, engine: str):
        self.name = engine
        self.load(study)
        first = self.points(rare.plain_draws(self.exp, 1, 0))
        self.engine = make_engine(self.exp, make_nominal_batch(self.exp, first.assign(width=WIDTH), WIDTH))

    def load(self, study: str) -> None:
        """Read a study that the same engine can simulate."""
        self.exp = compose([f"study={study}", f"engine={self.name}", f"engine.width={WIDTH}"])

    def points(self, draws: RoundDraws) -> pd.DataFrame:
        """Return the points of a round."""
        return make_points(self.exp.study, self.exp.system, self.exp.settings, round_=draws)

    def run(self, tables: list[pd.DataFrame]) -> list[pd.DataFrame]:
        """Return the rows of each table, simulated side by side."""
        return rare.simulate_tables(self.exp, self.engine, WIDTH, tables)


def count_failures(rollouts: Rollouts, num: int, before: int) -> int:
    """Count the failures of `num` plain draws that differ from the `before` ones."""
    (rows,) = rollouts.run([rollouts.points(rare.plain_draws(rollouts.exp, num, before))])
    return int((rows["outcome"] != "success").sum())


def find_spread(rollouts: Rollouts, name: str) -> int:
    """Load the study whose push fails about `TARGET` of the draws; return how many plain draws were used."""
    tried = rollouts.points(rare.plain_draws(rollouts.exp, TRIED, 0))
    tried["push.kick.impulse"] = np.linspace(0, MODELS[name][-1], TRIED)
    (rows,) = rollouts.run([tried.assign(**{"push.kick.direction": 0.0, "push.kick.elevation": 0.0})])
    threshold = float(rows["push.kick.impulse"][rows["outcome"] != "success"].min())
    deviations, used = -float(ndtri(TARGET)), 0
    for _ in range(TRIALS):
        rollouts.load(write_study(name, threshold, deviations))
        failed, used = count_failures(rollouts, WIDTH, used), used + WIDTH
        print(f"{name}: {failed} of {WIDTH} fail, threshold {threshold:.3g}, {deviations:.3g} deviations", flush=True)
        if 0.8 * TARGET <= failed / WIDTH <= 1.2 * TARGET:
            break
        deviations += float(ndtri((failed + 0.5) / (WIDTH + 1)) - ndtri(TARGET))
    return used


def run_searches(rollouts: Rollouts, searches: int) -> list[FailureEstimate]:
    """Return the estimates of repeated importance sampling, one for each seed, simulated side by side."""
    studies = [replace(rollouts.exp, study=replace(rollouts.exp.study, seed=seed)) for seed in range(searches)]
    rounds = [rare.adaptive_rounds(exp) for exp in studies]
    asked, found = [next(one) for one in rounds], {}
    while len(found) < searches:
        open_ = [k for k in range(searches) if k not in found]
        for k, rows in zip(open_, rollouts.run([rollouts.points(asked[k]) for k in open_]), strict=True):
            try:
                asked[k] = rounds[k].send(rows)
            except StopIteration as done:
                found[k] = studies[k].study.adaptive_design.estimate_failure(done.value, studies[k].study.draw_context)
    return [found[k] for k in range(searches)]


def measure_model(name: str, engine: str, searches: int, plain: int) -> dict[str, Any]:
    """Return the probability by plain draws, the intervals of searches, and how many hold it as a line of a table."""
    rollouts = Rollouts(write_study(name, 1.0, 3.0), engine)
    used, failed, counted = find_spread(rollouts, name), 0, 0
    while counted < plain:
        num = min(WIDTH, plain - counted)
        failed, counted = failed + count_failures(rollouts, num, used + counted), counted + num
    truth, (low, high) = failed / counted, map(float, clopper_pearson(failed, counted))
    found = run_searches(rollouts, searches)
    held = [one.interval[0] <= truth <= one.interval[1] for one in found]
    touched = sum(one.interval[0] <= high and low <= one.interval[1] for one in found)
    reliable = [one.is_reliable for one in found]
    median = float(np.median([one.probability for one in found]))
    both = sum(a and b for a, b in zip(held, reliable, strict=True))
    row = [MODELS[name][0], f"{failed} of {counted:,}", f"{truth:.2g} ({low:.2g} to {high:.2g})", f"{median:.2g}",
           f"{3 * NUM:,}", f"{sum(held)} of {searches}", f"{touched} of {searches}", f"{sum(reliable)} of {searches}",
           f"{both} of {sum(reliable)}"]  # fmt: skip
    return {"row": row, "truth": [low, truth, high], "intervals": [one.interval for one in found]}


def fails_in_three_ways(normal: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Return which pushes fail: ahead, or to either side, where less is needed but the direction is rare."""
    push, direction = 0.7 + 0.3 / 2.9 * normal[:, 0], 0.3 * normal[:, 1]
    needed = 1 + 0.06 * time
    return (push * np.cos(direction) > needed) | (push * np.abs(np.sin(direction)) > 0.65 * needed)


def fails_in_a_short_time(normal: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Return which pushes fail: large ones, and in a twentieth of the times smaller ones."""
    push = 0.7 + 0.1 * normal[:, 0]
    return (push * np.cos(0.3 * normal[:, 1]) > 1 + 0.06 * time) | ((push > 0.93) & (time > 0.8) & (time < 0.85))


FORMULAS = {"ahead, or to a side": fails_in_three_ways, "also in a twentieth of the times": fails_in_a_short_time}


def measure_formula(name: str, num: int, searches: int) -> list[str]:
    """Return how often intervals of searches with `num` draws a round hold the probability of a formula."""
    law, design, rng = FORMULAS[name], ImportanceSampling(num=num), np.random.default_rng(0)
    truth = np.mean([law(rng.standard_normal((1 << 20, 2)), rng.random(1 << 20)).mean() for _ in range(10)])
    context: Any = SimpleNamespace(study=name)  # all that the estimate reads of it
    held, reliable = [], []
    for seed in range(searches):
        search, rows = importance_sampling.start_search(4, num, design.wide, design.rounds, seed), []
        draws = next(search)
        with contextlib.suppress(StopIteration):
            while True:
                failed = law(ndtri(draws.quantiles), draws.quantiles[:, 3])
                columns = {f"axis.{key}": draws.columns[key] for key in ("weight", "round")}
                rows.append(pd.DataFrame(columns).assign(outcome=np.where(failed, "failure", "success")))
                draws = search.send(RoundSummary(failed, np.zeros(num)))
        found = design.estimate_failure(pd.concat(rows), context)
        held.append(found.low <= truth <= found.high)
        reliable.append(found.is_reliable)
    both = int(np.sum(np.array(held) & reliable))
    return [name, f"{truth:.2g}", f"{3 * num:,}", f"{sum(held)} of {searches}", f"{sum(reliable)} of {searches}",
            f"{both} of {sum(reliable)}"]  # fmt: skip


def join_tables(every: shared.Scenarios) -> dict[str, shared.Table]:
    """Return the tables of all models, and of the formulas."""
    head = ["fails", "probability", *HEAD[4:6], *HEAD[7:]]
    models = [one["row"] for one in every.values() if "row" in one]
    return {"models": [HEAD, *models], "formulas": [head, *every.get("formulas", {}).get("rows", [])]}


def draw_intervals(every: shared.Scenarios) -> None:
    """Draw the intervals of all searches of each model around the probability by plain draws."""
    shown = {name: every[name] for name in MODELS if "intervals" in every.get(name, ())}
    if not shown:
        return
    with plot_style():
        figure = new_figure(2.2)
        for ax, (name, one) in zip(figure.subplots(1, len(shown), squeeze=False)[0], shown.items(), strict=True):
            low, truth, high = one["truth"]
            ax.axhspan(low, high, color="0.85", lw=0)
            for k, (start, end) in enumerate(sorted(one["intervals"])):
                holds = start <= truth <= end
                ax.plot([k, k], [start, end], lw=0.8, color=HOLDS if holds else MISSES)
            ax.axhline(truth, color="black", lw=0.6)
            ax.set(
                title=name,
                yscale="log",
                xlabel="search",
                ylabel="P(failure)" if ax.get_subplotspec().is_first_col() else None,
            )
        save_figure(figure, shared.FIGURES / "rare_models.png")


def main(engine: str = "kernel", searches: str = "100", plain: str = "400000", *names: str) -> None:
    """Simulate models, by default all, and add them to the table."""
    if engine == "draw":
        return draw_intervals(shared.read_scenarios(FILE))
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for name, text in FILES.items():
            Path(name).write_text(text)
        for name in ("quadruped.xml", "trot.py"):
            Path(name).write_text((files("sweep.cli") / "template_model" / name).read_text(encoding="utf-8"))
        for name in names or (*MODELS, "formulas"):
            start = time.perf_counter()
            if name == "formulas":
                rows = [measure_formula(one, num, int(searches)) for one in FORMULAS for num in (256, 512, 1024, 2048)]
                print(*rows, sep="\n", flush=True)
                found, device = {"rows": rows}, describe_device(EngineSettings(name="native"))
            else:
                found = measure_model(name, engine, int(searches), int(plain))
                print(found["row"], flush=True)
                device = describe_device(EngineSettings(name=engine))
            content = {"device": device, **version_record(), "seconds": time.perf_counter() - start, **found}
            shared.add_scenario(
                shared.DATA / "rare_models.json",
                name,
                content,
                "python bench/rare_models.py",
                join_tables,
                f"`{engine}`",
            )


if __name__ == "__main__":
    main(*sys.argv[1:])
