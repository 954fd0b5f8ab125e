"""Certify the largest region of drawn parameters in which failures are guaranteed to be rare, for `sweep certify`."""

import argparse
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from sweep.analysis import certify, sensitivity
from sweep.analysis.intervals import clopper_pearson
from sweep.analysis.sampling_units import describe_sample_size, has_random_draws
from sweep.analysis.stats import format_percent
from sweep.cli.run_progress import report_progress
from sweep.config.experiment import Experiment, build_experiment
from sweep.core.errors import InputError
from sweep.core.files import path_inside_folder
from sweep.report.tables import markdown_table
from sweep.runs import certificates, engine_audit, extend, results, runner, store
from sweep.study import design_kinds

MAX_PARAMETERS = 8
FRESH_DRAWS_STUDY, CHECK_STUDY = "certify/fresh", "certify/again"  # studies of their own in the folder
CHECK_ROLLOUTS = 64  # rollouts of either kind that are run as a check of a certified region


def certify_region(args: argparse.Namespace) -> tuple[str, dict[str, Any]]:
    """Certify a region of few failures; return the printed text and its values for JSON. Raises `InputError`.

    With `--rollouts`, all rows of the folder order the candidate regions and fresh draws test them; without it, half of
    the rows does each. Fresh draws are a study in a folder of its own, so that the same command continues it.
    """
    check_arguments(args)
    folder, rows = args.dir, store.read_rows(args.dir)
    if args.engines_agree:
        rows = select_agreed_rows(rows)
    exp = results.load_experiment(folder)
    names = drawn_parameter_columns(exp, rows)
    order = np.random.default_rng(0).permutation(len(rows))
    learned = parameter_matrix_and_failures(rows if args.rollouts else rows.iloc[order[::2]], names)
    if learned[1].all():
        raise InputError("no region can be formed: none of the rows to fit it to succeeds")
    least = certify.required_failure_free_rows(args.failures, args.confidence) / (args.rollouts or len(rows) // 2)
    with ThreadPoolExecutor() as pool:  # what is learned is learned while fresh draws are simulated
        score = pool.submit(certify.learn_region_score, args.shape, *learned, least)
        worst = pool.submit(certify.fit_log_odds, *learned, convex=False) if args.shape != "score" else score
        new = partial(simulate_fresh_draws, exp, path_inside_folder(folder, FRESH_DRAWS_STUDY), exp.study.seed + 1)
        fresh = new(args.rollouts) if args.rollouts else rows.iloc[order[1::2]]
    found = certify.certify_largest_region(
        score.result(), learned, parameter_matrix_and_failures(fresh, names), args.failures, args.confidence
    )
    lines = [format_certificate(found, args.shape, names)]
    if args.engines_agree:
        lines.append("a row counts as a success only if it succeeds on all audited engines")
    if not learned[1].any():
        lines.append("no region can be formed: none of the rows to fit it to failed; draw from wider distributions")
    again = (
        check_region_by_simulation(exp, folder, found, names, worst.result())
        if found.is_certified and args.rollouts
        else []
    )
    if again:
        lines += ["", markdown_table(pd.DataFrame([{**one, "95 %": format_failure_interval(one)} for one in again]))]
    values = certificate_as_json_values(found, args, names) | {"checked": again}
    certificates.save_certificate(folder, values, exp)
    return "\n".join(lines), values


def check_arguments(args: argparse.Namespace) -> None:
    """Raise `InputError` if a numeric option of `sweep certify` is out of range."""
    for name in ("failures", "confidence"):
        if not 0 < getattr(args, name) < 1:
            raise InputError(f"--{name} = {getattr(args, name):g} is not allowed: between 0 and 1")
    if args.engines_agree and args.rollouts is not None:
        raise InputError("--rollouts is not allowed with --engines-agree: fresh draws are simulated on one engine")
    if args.rollouts is not None and args.rollouts < (
        need := certify.required_failure_free_rows(args.failures, args.confidence)
    ):
        takes = (
            f"{args.failures:g} at {format_exact_percent(args.confidence)} takes at least {need}, if none of them fails"
        )
        raise InputError(f"--rollouts = {args.rollouts} is not allowed: {takes}")


def select_agreed_rows(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the rows that were audited on all engines, as failures where the engines do not agree.

    Args:
        rows: Rows of a folder.

    Returns:
        The audited rows (m), a random choice of all.

    Raises:
        InputError: No row was audited, or a condition chose the audited rows.
    """
    audited = rows[engine_audit.AGREE] != "" if engine_audit.AGREE in rows else pd.Series(False, rows.index)
    if not audited.any():
        raise InputError("--engines-agree needs an audit on several engines: sweep audit DIR --engines all")
    first = engine_audit.first_rows_by_point_id(rows["point_id"], int(audited.sum()))
    if not audited.iloc[first].all():
        raise InputError("--engines-agree is not allowed after an audit with --where: its rows are no random choice")
    chosen = rows[audited]
    return chosen.assign(outcome=chosen["outcome"].where(chosen[engine_audit.AGREE] == engine_audit.YES, "invalid"))


def drawn_parameter_columns(exp: Experiment, rows: pd.DataFrame) -> list[str]:
    """Return the columns of randomly drawn parameters. Raises `InputError` unless rows are independent draws of a few
    numeric parameters."""
    own = exp.study
    if not (has_random_draws(own) and own.design.has_independent_draws) or own.replicates > 1 or own.is_refined:
        kinds = " or ".join(design_kinds.list_kinds(lambda kind: kind.has_independent_draws))
        raise InputError(
            f"certify needs one rollout of each independent draw: study.design.kind = {kinds}, replicates = 1; "
            f"{own.name} has {len(rows):,} rollouts ({describe_sample_size(rows, exp)})"
        )
    if listed := sensitivity.listed_value_axes(rows, exp):
        raise InputError(f"axis {listed[0].name} has listed values: certify needs a distribution for every axis")
    names = [a.column for a in own.axes if a.distribution]
    if words := [name for name in names if rows[name].dtype.kind not in "fi"]:
        raise InputError(f"{words[0]} is a name: certify needs axes of numbers")
    if len(names) > MAX_PARAMETERS:
        raise InputError(f"{len(names)} parameters are drawn: certify allows at most {MAX_PARAMETERS}")
    return names


def parameter_matrix_and_failures(rows: pd.DataFrame, names: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Return the parameter values of all rows (n, d), and which rows failed (n,); invalid rollouts count as
    failures."""
    return rows[names].to_numpy(dtype=float), (rows["outcome"] != "success").to_numpy()


def simulate_fresh_draws(exp: Experiment, folder: Path, seed: int, number: int) -> pd.DataFrame:
    """Simulate draws of the study with a new seed in a separate folder, and return their rows."""
    fresh = copy_with_seed_and_draws(exp, folder, seed, number)
    with report_progress("fresh draws", number, f"{exp.scenario} for fresh draws") as report:
        extend.extend_study(fresh, folder, number, report)
    rows = store.read_rows(folder)
    return rows[rows["replicate"] < number]


def copy_with_seed_and_draws(exp: Experiment, folder: Path, seed: int, number: int) -> Experiment:
    """Return a copy of the experiment whose study has another seed and another number of draws."""
    own = exp.values["study"]
    study = {**own, "seed": seed, "design": {**own["design"], "num": number}, "keep": [], "expect": []}
    return build_experiment({**exp.values, "study": study, "out": str(folder)})


def check_region_by_simulation(
    exp: Experiment, folder: Path, certificate: certify.Certificate, names: list[str], worst: certify.RegionScore
) -> list[dict[str, Any]]:
    """Count failures among new draws at the worst part of a certified region and outside it; these draws are not part
    of the guarantee.

    The region looks worst where `worst`, a learned probability of failure, is largest. Batches are as wide as those of
    the fresh draws, whose engine is compiled already.
    """
    number, width = (
        CHECK_ROLLOUTS * certify.CANDIDATE_COUNT,
        int(store.read_points(path_inside_folder(folder, FRESH_DRAWS_STUDY))["width"].iloc[0]),
    )
    place = path_inside_folder(folder, CHECK_STUDY)
    again = copy_with_seed_and_draws(exp, place, exp.study.seed + 2, number)
    again = replace(again, settings=replace(again.settings, width=width))
    table = runner.select_points_to_simulate(again)
    x = table[names].to_numpy(dtype=float)
    inside, order = certificate.contains(x), np.argsort(-worst(x))
    kinds = {
        "where the region looks worst": order[inside[order]][:CHECK_ROLLOUTS],
        "outside": np.flatnonzero(~inside)[:CHECK_ROLLOUTS],
    }
    chosen = np.unique(np.concatenate(list(kinds.values())))
    with store.lock_folder(place), report_progress("checks", len(chosen), f"{exp.scenario} for checks") as report:
        runner.repair_folder(again, place)
        runner.run_job(runner.prepare_job(again, place, table.iloc[chosen].reset_index(drop=True)), report)
    rows = store.read_rows(place).set_index("point_id")
    lines = []
    for kind, places in kinds.items():
        failed = rows.loc[table["point_id"].iloc[places], "outcome"] != "success"
        lines.append({"draws": kind, "rollouts": len(failed), "fail": int(failed.sum())})
    return lines


def format_failure_interval(check: dict[str, Any]) -> str:
    """Format the confidence interval of the share of failures among checked draws."""
    low, high = (format_percent(float(v)) for v in clopper_pearson(check["fail"], check["rollouts"]))
    return f"{low} to {high}"


def format_certificate(certificate: certify.Certificate, shape: str, names: list[str]) -> str:
    """Format the guarantee, its region and its assumptions as text."""
    where = f"{certificate.next_region_failed} of {certificate.next_region_rows} fresh rows fail in the next larger one"
    if not certificate.is_certified:
        return f"no {shape} is certified at {certificate.failures:g}: {where}; try more rows or larger --failures"
    promise = (
        f"with a confidence of {format_exact_percent(certificate.confidence)} "
        f"at most {format_exact_percent(certificate.failures)} "
        f"of the study's draws that fall into this {shape} fail: "
        f"{format_percent(certificate.region_draw_share)} of all draws, "
        f"{certificate.failed} of {certificate.rows} fresh rows failed there"
    )
    why = f"; {where}" if certificate.next_region_rows else "; there is no larger region"
    assumed = (
        "this holds for draws from the study's distributions, not for every point; invalid rollouts count as failures"
    )
    condition = certificate.score.format_region_condition(names, certificate.threshold)
    return f"{promise}{why}.\n{assumed}\nthe region, for --where:\n  {condition}"


def format_exact_percent(share: float) -> str:
    """Format a share as per cent without rounding: `1e-5` -> `0.001 %`."""
    return f"{100 * share:g} %"


def certificate_as_json_values(
    certificate: certify.Certificate, args: argparse.Namespace, names: list[str]
) -> dict[str, Any]:
    """Convert the certificate to plain values for JSON."""
    return {
        "study": str(args.dir),
        "shape": args.shape,
        "failures_at_most": certificate.failures,
        "confidence": certificate.confidence,
        "certified": certificate.is_certified,
        "where": certificate.score.format_region_condition(names, certificate.threshold)
        if certificate.is_certified
        else None,
        "region": certificate.score.region_values(names, certificate.threshold) if certificate.is_certified else None,
        "rows": certificate.rows,
        "failed": certificate.failed,
        "fresh_rows": certificate.fresh_draws,
        "next_rows": certificate.next_region_rows,
        "next_failed": certificate.next_region_failed,
        "share_of_draws": certificate.region_draw_share,
        "bound_of_its_rows": certificate.failure_probability_bound if certificate.is_certified else None,
    }
