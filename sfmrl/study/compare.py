"""Compare policies on the same episodes: where one succeeds and others fail, and how sure the differences are."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from sfmrl.config import ConfigError, counted
from sfmrl.episodes import Record
from sfmrl.evaluation import RATES, episode_rows, metrics
from sfmrl.intervals import episode_difference, holm, success_difference
from sfmrl.lookahead import Policy
from sfmrl.study.sheets import Sheet, estimate, p_value, rate, seconds

LISTED = 20  # differing episodes that the terminal shows; JSON has all


def compare(records: Sequence[Record], policies: Sequence[Policy], names: Sequence[str]) -> dict[str, Any]:
    """Compare the records of policies that played the same test episodes; returns plain values, ready for JSON.

    `policies` holds the metrics of each, and for all but the first the differences from the first: in `success`, and in
    the `navigation_time` (s) of the episodes in which both succeed. Each has a 95 % interval over episodes (None where
    episodes are too few), the p-value of no difference, and the same by Holm for all policies compared. `differing`
    lists the episodes in which some policies succeed and some do not. Raises ConfigError unless the episodes are the
    same.
    """
    first = records[0]
    for record in records:
        if not np.array_equal(record.scenes.start, first.scenes.start, equal_nan=True):
            raise ConfigError("policies can only be compared on the same episodes")
    found = []
    for record, policy, name in zip(records, policies, names, strict=True):
        whole = metrics(record, policy)
        kept = ("episodes", *RATES, "intervals", "navigation_time", "total_reward", "recovered")
        found.append({"policy": name} | {key: whole[key] for key in kept if key in whole})
    for row, record in zip(found[1:], records[1:], strict=True):
        row["less_first"] = _difference(record, first)
    for metric in ("success", "navigation_time"):
        gaps = [row["less_first"][metric] for row in found[1:] if row["less_first"][metric]]
        for gap, p in zip(gaps, holm(np.array([gap["p"] for gap in gaps])), strict=True):
            gap["p_holm"] = float(p)
    return {"policies": found, "differing": _differing(records, names)}


def _difference(record: Record, first: Record) -> dict[str, Any]:
    """A record's success and navigation time less the first's; None for the time where they share no success."""
    ours, theirs = (r.outcome == "success" for r in (record, first))
    both = ours & theirs
    only_this, only_first = int((ours & ~theirs).sum()), int((theirs & ~ours).sum())
    return {
        "success": vars(success_difference(only_this, only_first, len(ours))),
        "navigation_time": vars(episode_difference((record.time - first.time)[both])) if both.any() else None,
        "only_this": only_this,
        "only_first": only_first,
    }


def _differing(records: Sequence[Record], names: Sequence[str]) -> list[dict[str, Any]]:
    """List the episodes in which some policies succeed and some fail, with every policy's outcome."""
    success = np.array([record.outcome == "success" for record in records])
    where = np.flatnonzero(success.any(axis=0) & ~success.all(axis=0))
    scenes = records[0].scenes
    return [
        {
            "episode": int(scenes.episode[e]),
            "environment": str(scenes.environment[e]),
            "outcomes": {name: str(record.outcome[e]) for name, record in zip(names, records, strict=True)},
        }
        for e in where
    ]


def comparison_rows(records: Sequence[Record], names: Sequence[str]) -> list[dict[str, Any]]:
    """Return a line for each episode of each policy, for a CSV file."""
    return [{"policy": n} | row for n, record in zip(names, records, strict=True) for row in episode_rows(record)]


def comparison_sheets(found: dict[str, Any], title: str) -> list[Sheet]:
    """Return the result of `compare` as sheets for the terminal."""
    first, *others = found["policies"]
    rates = []
    for row in found["policies"]:
        low, high = row["intervals"]["success"]
        numbers = f"{rate(row['success'])} {rate(low)}-{rate(high)}", rate(row["collision"]), rate(row["timeout"])
        rates.append((row["policy"], *numbers, seconds(row["navigation_time"]), f"{row['total_reward']:.4f}"))
    gaps = []
    for row in others:
        gap = row["less_first"]
        success = estimate(gap["success"]), p_value(gap["success"]["p_holm"])
        counts = str(gap["only_this"]), str(gap["only_first"])
        gaps.append((row["policy"], *success, *counts, estimate(gap["navigation_time"], seconds)))
    names = [row["policy"] for row in found["policies"]]
    lines = [(str(d["episode"]), d["environment"], *d["outcomes"].values()) for d in found["differing"]]
    heads = (
        "policy",
        "success less\nthe first's",
        "p (Holm)",
        "only\nthis",
        "only\nfirst",
        "nav. time less\nthe first's",
    )
    sheets = [
        Sheet(title, ("policy", "success", "collision", "time-out", "nav.\ntime", "total\nreward"), rates),
        Sheet(f"Differences from {first['policy']}, with 95 % intervals over episodes", heads, gaps),
    ]
    if lines:
        count = counted(len(lines), "episode") + (f", the first {LISTED}" if len(lines) > LISTED else "")
        sheets.append(
            Sheet(f"Where some succeed and some do not: {count}", ("episode", "env.", *names), lines[:LISTED])
        )
    return sheets
