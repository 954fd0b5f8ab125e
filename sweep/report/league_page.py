"""Page of `sweep league --page`: several policies as a sortable table with intervals, small maps and all pairs."""

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pandas as pd
from markupsafe import Markup

from sweep.analysis.league import NOT_DECIDED, PairedPolicyOutcomes
from sweep.config.experiment import Experiment
from sweep.core.files import write_atomically
from sweep.report.league import (
    BETTER,
    CAUSE,
    OPEN,
    WON,
    WORSE,
    count_decided_pairs,
    describe_confidence,
    describe_points,
)
from sweep.report.page import data
from sweep.report.page.script import bundle_script, content_security_policy, load_page_template, style_sheet
from sweep.runs import store
from sweep.runs.results import Results

CLASSES = {BETTER: "better", WORSE: "worse", OPEN: "open"}


@dataclass(frozen=True)
class LeagueContent:
    """Outcomes of several policies and what follows from them."""

    league: PairedPolicyOutcomes
    table: pd.DataFrame  # sorted policies, see `league.standings_and_pair_table`
    pairs: pd.DataFrame  # with their verdicts
    level: float  # confidence of all statements together
    unit: str  # plural of the independent unit


def write_league_page(
    path: Path, content: LeagueContent, exp: Experiment, first: Path, folders: Sequence[Path]
) -> Path:
    """Write the page of a league.

    Args:
        path: File to write.
        content: Outcomes and tables.
        exp: Experiment of the first policy, which names parameters and causes.
        first: Folder of the first policy.
        folders: Folder of each policy, whose page the table links to; empty if the policies share a folder.

    Returns:
        `path`.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, render_league_page(path, content, exp, first, folders).encode())
    return path


def render_league_page(
    path: Path, content: LeagueContent, exp: Experiment, first: Path, folders: Sequence[Path]
) -> str:
    """Render the page of a league as HTML; see `write_league_page` for the arguments."""
    league, table, pairs = content.league, content.table, content.pairs
    own = [c for k in range(len(league.policies)) for c in (WON.format(k), CAUSE.format(k))]
    results = Results(first, store.read_study(first), exp, league.conditions.drop(columns=own), None)
    results = replace(results, rows=results.rows.assign(outcome="success", cause="", stage=""))
    about: dict[str, Any] = data.page_data(results) | {"curves": [], "replays": []}
    sides = {name: policy_outcomes(league, name) for name in table["policy"]}
    about["sides"] = data.describe_sides(results, sides, [])
    style, script = style_sheet(), bundle_script()
    pages = dict(zip(league.policies, (link_to_report(folder, path) for folder in folders), strict=False))
    points, shown = len(league.success), about["rows"]
    return load_page_template("league.html.j2").render(
        policy=content_security_policy(style, script),
        style=Markup(style),
        script=Markup(script),
        data=Markup(data.json_for_script_element(about)),
        name=results.name,
        headline=league_headline(content),
        points=describe_points(league, content.unit),
        left_out=[
            f"{number:,} points are invalid for {name} and left out for all"
            for name, number in zip(league.policies, league.invalid, strict=True)
            if number
        ],
        sure="low" in table,
        confidence=describe_confidence(content.level),
        lines=[{**line, "page": pages.get(line["policy"], "")} for line in table.to_dict("records")],
        mapped=any(one["axis"] and "names" not in one for one in about["columns"]),
        sampled=f"The maps show {shown:,} of the {points:,} points, drawn at random" if shown < points else "",
        matrix=list(pair_matrix(pairs, list(table["policy"]))),
    )


def policy_outcomes(league: PairedPolicyOutcomes, policy: str) -> pd.DataFrame:
    """Return the columns `outcome` and `cause` of a policy at each point of a league.

    Args:
        league: Outcomes of the policies, whose conditions hold these columns for each policy.
        policy: Name of the policy.
    """
    k = league.policies.index(policy)
    return league.conditions[[WON.format(k), CAUSE.format(k)]].set_axis(["outcome", "cause"], axis="columns")


def league_headline(content: LeagueContent) -> str:
    """State in a sentence which policies can be the best one, and how many pairs are decided."""
    table = content.table
    if "beaten_by" not in table:
        best = table["share"].max()
        names = list(table.loc[table["share"] == best, "policy"])
        leading = f"{names[0]} succeeds" if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]} succeed"
        return f"{leading} most often, at {100 * best:.1f} % of these points."
    unbeaten = list(table.loc[table["beaten_by"] == 0, "policy"])
    decided = count_decided_pairs(content.pairs)
    if len(unbeaten) == 1:
        return f"{unbeaten[0]} is the best policy; {decided}."
    return f"The best policy is one of {', '.join(unbeaten[:-1])} and {unbeaten[-1]}; {decided}."


def link_to_report(folder: Path, page: Path) -> str:
    """Return the relative address of a folder's own page; empty if it has none.

    Args:
        folder: Folder of a study.
        page: File from which the link leads.
    """
    if not (report := folder / "report.html").exists():
        return ""
    return quote(Path(os.path.relpath(report, page.parent)).as_posix())


def pair_matrix(pairs: pd.DataFrame, policies: list[str]) -> Iterator[tuple[str, list[dict[str, Any] | None]]]:
    """Yield for each policy the comparison with every policy, None with itself.

    Args:
        pairs: Pairs of policies, with verdicts if the points are a random sample.
        policies: Names of the policies in the order of the result.

    Yields:
        The policy, and for each policy difference of the rates, its interval, `sign` and `verdict`.
    """
    cells: dict[tuple[str, str], dict[str, Any]] = {}
    for one in pairs.to_dict("records"):
        verdict, low, high = one.get("verdict"), one.get("low", 0.0), one.get("high", 0.0)
        for first, second, way in ((one["a"], one["b"], 1), (one["b"], one["a"], -1)):
            if verdict is None:
                sign = ""
            elif verdict == NOT_DECIDED:
                sign = OPEN
            else:
                sign = BETTER if verdict == first else WORSE
            cells[first, second] = {
                "difference": way * one["difference"],
                "low": low if way > 0 else -high,
                "high": high if way > 0 else -low,
                "sign": sign,
                "verdict": CLASSES.get(sign, "open"),
            }
    for first in policies:
        yield first, [cells.get((first, second)) for second in policies]
