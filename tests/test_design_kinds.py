"""Designs as plug-ins: rooms ask the design of a study, and a project adds one in a file."""

import ast
import re
import sys

import numpy as np
import pytest
from small_study import one_line
from test_arrows import MODULES, ROOMS, imported, room

from sweep.analysis.intervals import wilson
from sweep.analysis.sample import pooled_success_rate
from sweep.cli.main import main
from sweep.core import project, provenance
from sweep.runs import store
from sweep.runs.results import load_experiment
from sweep.study import design_kinds
from sweep.study.design_kinds.base import Design

OWN = """
from dataclasses import dataclass
from typing import ClassVar
import numpy as np
from sweep.study.design_kinds.base import Design, SamplingUnit


@dataclass(frozen=True)
class Antithetic(Design):
    kind: ClassVar[str] = "own_pairs"
    meaning: ClassVar[str] = "means of monotonic columns"
    can_add_draws: ClassVar[bool] = True
    centre: float = 0.5  # about which draws are mirrored

    @property
    def sampling_unit(self):
        return SamplingUnit("pair")

    def block_size(self, d):
        return 2

    def sample(self, ctx):
        x = np.random.default_rng([ctx.seed]).random((self.num, len(ctx.axes)))
        return np.stack([x, (2 * self.centre - x) % 1], axis=1).reshape(-1, len(ctx.axes))


DESIGNS = {"own_pairs": Antithetic}
"""
STUDY = [
    "run", "scenario=walk_tripod", "study.name=own", "scenario.expect=[]", "study.design.num=4",
    "+study.axes.friction={path: contact.friction, side: world, distribution: {kind: uniform, from: 0.2, to: 1.2}}",
]  # fmt: skip
ASKING = ROOMS[ROOMS.index("study") + 1 :]


@pytest.fixture
def home(fake_engine, monkeypatch, tmp_path):
    """A project with a module `own`; what that adds is forgotten."""
    (tmp_path / "sweep.yaml").write_text("modules: [own]\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.setattr(design_kinds, "DESIGN_BY_KIND", dict(design_kinds.DESIGN_BY_KIND))
    yield tmp_path
    provenance.code_version.cache_clear()
    project._imported.cache_clear()
    sys.modules.pop("own", None)


def test_a_project_adds_a_design_in_one_file(home, capsys):
    (home / "own.py").write_text(OWN)
    here = [*STUDY, "study.design.kind=own_pairs", "out=own"]
    assert main([*here, "study.design.centre=0.25"]) == 0
    rows = store.read_rows(home / "own").sort_values("replicate")
    shares = (rows["world.contact.friction"].to_numpy() - 0.2).reshape(4, 2)
    np.testing.assert_allclose(shares.sum(axis=1) % 1, 0.5)
    capsys.readouterr()
    assert main(["stats", "own"]) == 0
    assert "4 independent pairs" in capsys.readouterr().out
    alike = rows.assign(outcome=np.where(rows["replicate"] // 2 == 0, "failure", "success"))  # both of a pair
    found = pooled_success_rate(alike, load_experiment(home / "own"))
    four = wilson(3, 4)  # the interval of 8 draws would begin at 0.41
    assert found.low <= four.low < four.high - 0.01 <= found.high
    assert main([*here, "study.design.centre=0.75"]) == 2  # rows of other settings
    one_line(capsys.readouterr().err, "study.design.centre")
    assert main([*here, "study.design.centre=0.25", "study.design.num=8"]) == 0
    assert len(store.read_rows(home / "own")) == 16
    capsys.readouterr()
    assert main([*STUDY, "study.design.centre=0.25", "out=other"]) == 2
    one_line(capsys.readouterr().err, "study.design.centre = 0.25 is not allowed with study.design.kind = monte_carlo: "
             "it needs kind = own_pairs (default 0.5)")  # fmt: skip


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('{"own_pairs": Antithetic}', "[Antithetic]", "own.Antithetic'>] is not allowed: classes by kind"),
        ('{"own_pairs": Antithetic}', '{"own_pairs": 3}', "DESIGNS has own_pairs: 3, not a subclass of Design"),
        ('{"own_pairs": Anti', '{"anti": Anti', "whose kind is 'own_pairs'"),
        ("def sample", "def smple", "module own: design own_pairs has no sample"),
        ("    meaning:", "    means:", "module own: design own_pairs has no meaning"),
        ('"own_pairs"', '"sobol"', "module own: design sobol exists already: choose another name"),
        (
            "float = 0.5",
            'float = __import__("dataclasses").field(default_factory=float)',
            "setting centre of design own_pairs has no default",
        ),
        ("centre: float = 0.5", "scrambles: int = 4", "setting scrambles of design own_pairs has another type or def"),
    ],
)
def test_what_is_wrong_with_a_design_of_ones_own_is_one_line(home, capsys, old, new, told):
    (home / "own.py").write_text(OWN.replace(old, new))
    assert main([*STUDY, "study.design.kind=own_pairs"]) == 2
    one_line(capsys.readouterr().err, told)


@pytest.mark.parametrize("place", ASKING)
def test_rooms_ask_the_design_and_name_no_kind(place):
    """Neither in texts that are no docstrings, nor by imports of a kind's module."""
    kinds = re.compile(rf"\b({'|'.join(design_kinds.DESIGN_BY_KIND)})\b")
    own = {cls.__module__ for cls in design_kinds.DESIGN_BY_KIND.values()}
    for name, path in MODULES.items():
        if room(name) != place:
            continue
        assert not own & set(imported(path)), name
        tree = ast.parse(path.read_text())
        said = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
        texts = [node for node in ast.walk(tree) if isinstance(node, ast.Constant) and id(node) not in said]
        assert not [node.value for node in texts if kinds.search(str(node.value))], name


def test_every_kind_is_a_file_of_its_own():
    assert len({cls.__module__ for cls in design_kinds.DESIGN_BY_KIND.values()}) == len(design_kinds.DESIGN_BY_KIND)
    assert all(issubclass(cls, Design) and cls.meaning for cls in design_kinds.DESIGN_BY_KIND.values())
