"""Explain an episode: what the reward paid in every step, term by term, and what other rewards would have paid.

Step n leads from (n - 1) dt to n dt. The repulsion and the actions' values are those at its start, when the robot
chooses; the gap is the smallest during it; everything else is from its end.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np

from sfmrl.config import ConfigError, Reward
from sfmrl.episodes import Record
from sfmrl.geometry import length, wrapped
from sfmrl.lookahead import step_discount
from sfmrl.replay.story import Story, make_story
from sfmrl.rewards import Transition, reward_terms, total
from sfmrl.sfm import resultant

# The paper's rewards, by the names under which their accounts are shown.
PAPER_REWARDS = {
    "crowd": Reward(),
    "sfm": Reward(reward="sfm"),
    "sfm-discount": Reward(reward="sfm-discount"),
    "sfm, k 0.003": Reward(reward="sfm", k=0.003),
}
ROWS = 12  # steps shown, about, besides those with events
LONG_EVENT = 6  # steps; of a longer event, the first and the last step are shown
# An event's mark: how its words begin, and what the legend says.
MARKS = {
    "!": (("too close",), "too close"),
    "~": (("stuck", "free again"), "stuck, or free again"),
    "^": (("best action",), "best action passed over, it may lead into a trap"),
    "*": (("goal reached",), "goal reached"),
    "X": (("collision",), "collision"),
    "T": (("time is up",), "time is up"),
}


@dataclass(frozen=True)
class Explanation:
    """One episode: a row of plain values per step, and what its own reward and the paper's pay in all, term by term."""

    name: str  # environment and episode, in words
    steps: list[dict[str, Any]]
    own: str  # the name of the episode's own reward
    plain: dict[str, float]  # sums of the own reward's terms, which are keys of the steps
    discounted: dict[str, dict[str, float]]  # sums of every reward's terms, discounted to the start

    def sums(self) -> dict[str, Any]:
        """Return sums and steps as plain values, ready for JSON."""
        own = self.discounted[self.own]
        rewards = [
            {"reward": name, "terms": paid, "return": sum(paid.values())} for name, paid in self.discounted.items()
        ]
        totals = {"plain": self.plain, "discounted": own}
        return {"totals": totals, "return": sum(own.values()), "rewards": rewards, "steps": self.steps}


def explain_episode(record: Record, row: int, policy: Any, reward: Reward, discount: float) -> Explanation:
    """Explain the episode in one row of a record, under a reward and a discount per second at 1 m/s.

    Each step's row has the terms of `reward` by their names, and those of all rewards as "sfm: distance" and so on. It
    has values of actions if the policy looks ahead and the scene has elements.
    """
    one = record.take(np.array([row]))
    story = make_story(one, policy, reward, discount)
    transition = one.transition[0, : story.last]
    factors = float(step_discount(discount, one.scenes.v_pref[0, 0], one.simulation)) ** np.arange(story.last)
    rewards = PAPER_REWARDS
    if reward not in rewards.values():
        rewards = {f"own {reward.reward.rpartition(':')[2]}": reward} | rewards
    terms = {name: reward_terms(chosen)(transition) for name, chosen in rewards.items()}
    columns = _columns(story, transition, factors)
    columns |= {f"{name}: {term}": paid for name in rewards for term, paid in terms[name].items()}
    lists = [np.asarray(column).tolist() for column in columns.values()]  # of Python's own numbers
    steps = [dict(zip(columns, values, strict=True)) for values in zip(*lists, strict=True)]
    return Explanation(
        name=story.name.replace(" · ", ", "),
        steps=steps,
        own=next(name for name in rewards if rewards[name] == reward),
        plain={term: float(paid.sum()) for term, paid in story.terms.items()},
        discounted={name: {term: float(factors @ paid) for term, paid in terms[name].items()} for name in rewards},
    )


def _columns(story: Story, transition: Transition, factors: np.ndarray) -> dict[str, Sequence | np.ndarray]:
    """Return the columns of the steps by name, (T,) each; `factors` (T,) discount their rewards to the start."""
    gap, push, paid = story.separations.min(axis=1, initial=np.inf), resultant(story.force[:-1]), total(story.terms)
    return {
        "step": np.arange(1, story.last + 1),
        "time": story.time[1:],
        "event": _events(story),
        "velocity_x": story.velocity[1:, 0, 0],
        "velocity_y": story.velocity[1:, 0, 1],
        **({} if story.heading is None else {"turn": np.degrees(wrapped(np.diff(story.heading)))}),  # to the left
        "goal_distance": transition.goal_distance,
        "gap": np.where(np.isfinite(gap), gap, None),
        "nearest": _nearest(story),
        "repulsion_x": push[:, 0],
        "repulsion_y": push[:, 1],
        "repulsion": length(push),
        **story.terms,
        "reward": paid,
        "discounted_reward": factors * paid,
        "return_so_far": story.returns[1:],
        **_values(story),
    }


def chosen_steps(
    rows: Sequence[dict[str, Any]], every: int | None = None, steps: str | None = None
) -> list[dict[str, Any]]:
    """Return the rows to show: every N-th step (by default about a dozen, or all within `steps`) and those with events.

    Of a long event, the first and last step are shown, and every N-th step. `steps` is "10:20", "10:", ":20"
    or "10", counted from 1; raises ConfigError where it names no step of the episode.
    """
    first, last = _range(steps, len(rows)) if steps else (1, len(rows))
    every = every or (1 if steps else -(-len(rows) // ROWS))
    within = rows[first - 1 : last]
    shown = set(range(0, len(within), every))
    for event, stretch in groupby(range(len(within)), lambda k: within[k]["event"]):
        at = list(stretch)
        if event:
            shown.update(at if len(at) <= LONG_EVENT else (at[0], at[-1]))
    return [within[k] for k in sorted(shown)]


def mark(event: str) -> str:
    """Return the mark of a step's first event, a character; "" without events."""
    return next((sign for sign, (beginnings, _) in MARKS.items() if event.startswith(beginnings)), "")


def _range(steps: str, count: int) -> tuple[int, int]:
    low, colon, high = steps.partition(":")
    try:
        first = int(low) if low.strip() else 1
        last = (int(high) if high.strip() else count) if colon else first
        if first > last:
            raise ValueError
    except ValueError:
        raise ConfigError(f"--steps is {steps!r}; write the first and the last step, as in 10:20") from None
    if not 1 <= first <= count:
        raise ConfigError(f"--steps is {steps!r}; the episode has steps 1 to {count}, write e.g. 1:{min(10, count)}")
    return first, last


def _events(story: Story) -> list[str]:
    """Return the events of each step in words, separated by "; ", the most important first; "" without any."""
    events: list[list[str]] = [[] for _ in range(story.last)]
    end = {"success": "goal reached", "collision": "collision with ", "timeout": "time is up"}[story.outcome]
    events[-1].append(end + " and ".join(map(story.called, story.hit)))
    nearest = _nearest(story)
    for first, last in story.close:
        for step in range(first - 1, last):
            events[step].append(f"too close to {nearest[step]}")
    before = np.concatenate(([False], story.stuck[:-1]))
    for step in np.flatnonzero(story.stuck != before).tolist():
        events[step].append("stuck: led around the squares" if story.stuck[step] else "free again")
    if story.look is not None:
        passed_over = story.look.values.argmax(1) != story.taken
        for step in np.flatnonzero(passed_over & ~story.stuck).tolist():
            events[step].append("best action passed over: it may lead into a trap")
    return ["; ".join(words) for words in events]


def _nearest(story: Story) -> list[str]:
    """Return the name of the element with the smallest gap in each step; "" without elements."""
    return [story.called(1 + int(gaps.argmin())) if np.isfinite(gaps).any() else "" for gaps in story.separations]


def _values(story: Story) -> dict[str, np.ndarray]:
    """Return the value of the action taken in each step and the best one of the others; nothing without values."""
    if story.look is None:
        return {}
    taken = np.arange(story.last), story.taken
    others = story.look.values.astype(float)
    others[taken] = -np.inf
    return {"value": story.look.values[taken], "runner_up": others.max(1)}
