"""Compare policies on the same episodes: where one succeeds and others fail, and how sure the differences are."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from sfmrl.actions import Policy
from sfmrl.config import ConfigError, counted
from sfmrl.episodes import Record
from sfmrl.evaluation import RATES, episode_rows, metrics
from sfmrl.study.sheets import Sheet, estimate, p_value, rate, rate_interval, seconds
from sfmrl.study.social import SOCIAL_METRICS, mean_known, social_rows, social_values
from sfmrl.study.statistics import holm, mean_difference, success_difference
from sfmrl.world import reset

LISTED = 20  # differing episodes that the terminal shows; JSON has all
GIVEN = ("position", "goal", "radius", "v_pref", "preferred_speed", "square")  # what makes two scenes the same
EXACT_BELOW = 25  # shared successes; with fewer, a t-test alone is too sure of times in whole time steps


def compare(records: Sequence[Record], policies: Sequence[Policy], names: Sequence[str]) -> dict[str, Any]:
    """Compare the records of policies that played the same test episodes; returns plain values, ready for JSON.

    `policies` holds the metrics of each, the `social` ones all as means over episodes (None without any value), and for
    all but the first `less_first`, the differences from the first: in `success`, in the `navigation_time` (s) of the
    episodes in which both succeed (None without any), and in the `social` metrics of those in which both have a value
    (None without any). p-values are adjusted by Holm for all policies compared. `differing` lists the episodes in which
    some policies succeed and some do not. Raises ConfigError unless the episodes are the same.
    """
    first, *others = records
    starts = [vars(reset(record.scenes)) for record in records]
    if not all(np.array_equal(start[name], starts[0][name], equal_nan=True) for start in starts for name in GIVEN):
        raise ConfigError("policies can only be compared on the same episodes; let all of them play the same scenes")
    rows, social = [], [social_values(record) for record in records]
    for record, policy, name, values in zip(records, policies, names, social, strict=True):
        measured = metrics(record, policy)
        compared = ("episodes", *RATES, "intervals", "navigation_time", "total_reward", "recovered")
        figures = {key: measured[key] for key in compared if key in measured}
        rows.append({"policy": name} | figures | {"social": {m: mean_known(value) for m, value in values.items()}})
    for row, record, values in zip(rows[1:], others, social[1:], strict=True):
        gaps = {metric: _mean_gap(values[metric] - social[0][metric]) for metric in SOCIAL_METRICS}
        row["less_first"] = _difference(record, first) | {"social": gaps}
    for metric in ("success", "navigation_time"):
        holm(row["less_first"][metric] for row in rows[1:])
    for metric in SOCIAL_METRICS:
        holm(row["less_first"]["social"][metric] for row in rows[1:])
    return {"policies": rows, "differing": _differing(records, names)}


def _difference(record: Record, first: Record) -> dict[str, Any]:
    """Return a record's success and navigation time minus the first's, and the episodes in which only one succeeds."""
    ours, theirs = (r.outcome == "success" for r in (record, first))
    only_this, only_first = int((ours & ~theirs).sum()), int((theirs & ~ours).sum())
    return {
        "success": success_difference(only_this, only_first, len(ours)),
        "navigation_time": _mean_gap(np.where(ours & theirs, record.time - first.time, np.nan)),
        "only_this": only_this,
        "only_first": only_first,
    }


def _mean_gap(gaps: np.ndarray) -> dict[str, Any] | None:
    """Return the figure of differences `gaps` (E,), one per episode and NaN where there is none; None without any."""
    known = gaps[~np.isnan(gaps)]
    return mean_difference(known, EXACT_BELOW) if len(known) else None


def _differing(records: Sequence[Record], names: Sequence[str]) -> list[dict[str, Any]]:
    """Return the episodes in which some policies succeed and some fail, with every policy's outcome."""
    success = np.array([record.outcome == "success" for record in records])
    scenes = records[0].scenes
    return [
        {
            "episode": int(scenes.episode[e]),
            "environment": str(scenes.environment[e]),
            "outcomes": {name: str(record.outcome[e]) for name, record in zip(names, records, strict=True)},
        }
        for e in np.flatnonzero(success.any(axis=0) & ~success.all(axis=0))
    ]


def comparison_rows(records: Sequence[Record], names: Sequence[str]) -> list[dict[str, Any]]:
    """Return a line for each episode of each policy, with its social metrics, for a CSV file."""
    return [
        {"policy": name} | row | social
        for name, record in zip(names, records, strict=True)
        for row, social in zip(episode_rows(record), social_rows(record), strict=True)
    ]


def comparison_sheets(comparison: dict[str, Any], title: str) -> list[Sheet]:
    """Return the result of `compare` as sheets for the terminal."""
    rows, differing = comparison["policies"], comparison["differing"]
    differences = f"Differences from {rows[0]['policy']}, with 95 % intervals over episodes"
    sheets = [
        Sheet(title, [_rates(row) for row in rows]),
        Sheet(differences, [_gaps(row["policy"], row["less_first"]) for row in rows[1:]]),
    ]
    if differing:
        count = counted(len(differing), "episode") + (f", the first {LISTED}" if len(differing) > LISTED else "")
        lines = [{"episode": str(d["episode"]), "env.": d["environment"], **d["outcomes"]} for d in differing[:LISTED]]
        sheets.append(Sheet(f"Where some succeed and some do not: {count}", lines))
    return sheets


def social_sheet(comparison: dict[str, Any]) -> Sheet:
    """Return the social metrics of `compare`, a line each: the first policy's value and the others' differences."""
    first, *others = comparison["policies"]

    def line(metric: str) -> dict[str, str]:
        value = first["social"][metric]
        gaps = {f"{row['policy']} - {first['policy']}": row["less_first"]["social"][metric] for row in others}
        cells = {"metric": metric, first["policy"]: "-" if value is None else rate(value)}
        return cells | {name: estimate(gap) for name, gap in gaps.items()}

    title = "How they treat people: means over episodes, and differences with 95 % intervals\n"
    title += "(sfmrl eval --social says what each is, and has danger over all steps together)"
    return Sheet(title, [line(metric) for metric in SOCIAL_METRICS])


def _rates(row: dict[str, Any]) -> dict[str, str]:
    return {
        "policy": row["policy"],
        "success": rate_interval(row["success"], *row["intervals"]["success"]),
        "collision": rate(row["collision"]),
        "time-out": rate(row["timeout"]),
        "nav.\ntime": seconds(row["navigation_time"]),
        "total\nreward": f"{row['total_reward']:.4f}",
    }


def _gaps(policy: str, gap: dict[str, Any]) -> dict[str, str]:
    return {
        "policy": policy,
        "success minus\nthe first's": estimate(gap["success"]),
        "p (Holm)": p_value(gap["success"]["p_holm"]),
        "only\nthis": str(gap["only_this"]),
        "only\nfirst": str(gap["only_first"]),
        "nav. time minus\nthe first's": estimate(gap["navigation_time"], seconds),
    }
