"""An episode under the reward's microscope: what every step paid, term by term, and what other rewards would have paid.

Pure: a record in, rows of plain values out. Step n leads from (n - 1) dt to n dt. The repulsion and the actions' values
are those where it begins, as the robot chooses; the gap is the smallest during it, all else is of its end.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np

from sfmrl.config import ConfigError, Reward
from sfmrl.episodes import Record
from sfmrl.geometry import length
from sfmrl.lookahead import step_discount
from sfmrl.replay import Story, make_story
from sfmrl.rewards import Terms, reward_terms, total
from sfmrl.sfm import resultant

# The paper's rewards, by the names under which their accounts are shown.
REWARDS = {
    "crowd": Reward(),
    "sfm": Reward(reward="sfm"),
    "sfm-discount": Reward(reward="sfm-discount"),
    "sfm, k 0.003": Reward(reward="sfm", k=0.003),
}
ROWS = 12  # steps shown, about, besides those with events
LASTING = 6  # steps up to which an event is shown whole
# An event's mark by the beginning of its words; where a step has several, the first of these.
MARKS = {
    "goal": "*",
    "collision": "X",
    "time": "T",
    "too close": "!",
    "stuck": "~",
    "free": "~",
    "best action passed over": "^",
}
ENDS = {"success": "goal reached", "collision": "collision with ", "timeout": "time is up"}


@dataclass(frozen=True)
class Account:
    """What a reward pays for an episode: sums over the steps by term, as they are and discounted to the start."""

    name: str
    plain: dict[str, float]
    discounted: dict[str, float]

    @property
    def discounted_return(self) -> float:
        """The episode's return under this reward."""
        return sum(self.discounted.values())

    def any_of(self, term: str) -> bool:
        """Whether a term has paid or cost anything in all."""
        return bool(self.plain.get(term))


@dataclass(frozen=True)
class Explanation:
    """One episode: a row of plain values a step, and the accounts of its own reward and of the paper's."""

    name: str  # environment and episode, in words
    steps: list[dict[str, Any]]
    terms: tuple[str, ...]  # the reward's, keys of the steps
    own: Account
    accounts: list[Account]  # the paper's, and first the own reward where it is none of these


def explain_episode(record: Record, row: int, policy: Any, reward: Reward, discount: float) -> Explanation:
    """The explanation of the episode in one row of a record, under a reward and a discount per second at 1 m/s.

    Each step's row has the terms of `reward` by their names, and those of all rewards as "sfm: distance" and so on.
    Values of actions are there for policies that look ahead, and where anybody is to be seen.
    """
    story = make_story(record, row, policy, reward, discount)
    one = record.take(np.array([row]))
    transition = one.transition[0, : story.last]
    factors = float(step_discount(discount, one.scenes.v_pref[0, 0], one.simulation)) ** np.arange(story.last)
    rewards = REWARDS
    if reward not in REWARDS.values():
        rewards = {f"own {reward.reward.rpartition(':')[2]}": reward} | REWARDS
    paid = {name: reward_terms(chosen)(transition) for name, chosen in rewards.items()}
    accounts = [_account(name, terms, factors) for name, terms in paid.items()]
    own = next(account for account in accounts if rewards[account.name] == reward)
    pay = total(story.terms)
    columns = {
        "step": np.arange(1, story.last + 1),
        "time": story.time[1:],
        "event": _events(story),
        "velocity_x": story.velocity[1:, 0, 0],
        "velocity_y": story.velocity[1:, 0, 1],
        "goal_distance": transition.goal_distance,
        **_gaps(story),
        **_repulsion(story),
        **story.terms,
        "reward": pay,
        "discounted_reward": factors * pay,
        "return_so_far": story.returns[1:],
        **_values(story),
        **{f"{name}: {term}": values for name, terms in paid.items() for term, values in terms.items()},
    }
    rows = [dict(zip(columns, map(_plain, values), strict=True)) for values in zip(*columns.values(), strict=True)]
    return Explanation(story.name.replace(" · ", ", "), rows, tuple(story.terms), own, accounts)


def chosen_steps(
    rows: Sequence[dict[str, Any]], every: int | None = None, steps: str | None = None
) -> list[dict[str, Any]]:
    """The rows to show: every so manyth (by default about a dozen, or all within `steps`), and those with events.

    Of an event that lasts long, its first and its last step are shown, and every so manyth in between. `steps` is
    "10:20", "10:", ":20" or "10", counted from 1; raises ConfigError where it names no step of the episode.
    """
    first, last = _range(steps, len(rows)) if steps else (1, len(rows))
    every = every or (1 if steps else -(-len(rows) // ROWS))
    within = rows[first - 1 : last]
    kept = set(range(0, len(within), every))
    for event, stretch in groupby(range(len(within)), lambda k: within[k]["event"]):
        at = list(stretch)
        kept |= set(() if not event else at if len(at) <= LASTING else (at[0], at[-1]))
    return [within[k] for k in sorted(kept)]


def mark(event: str) -> str:
    """The one character that stands for a step's events, "" where there are none."""
    return next((MARKS[word] for word in MARKS for part in event.split("; ") if part.startswith(word)), "")


def _range(steps: str, count: int) -> tuple[int, int]:
    low, colon, high = steps.partition(":")
    try:
        first = int(low) if low.strip() else 1
        last = (int(high) if high.strip() else count) if colon else first
    except ValueError:
        raise ConfigError(f"--steps is {steps!r}; write the first and the last step, as in 10:20") from None
    if not 1 <= first <= min(last, count):
        raise ConfigError(f"--steps is {steps!r}; the episode has steps 1 to {count}, write e.g. 1:{min(10, count)}")
    return first, last


def _account(name: str, terms: Terms, factors: np.ndarray) -> Account:
    plain = {term: float(values.sum()) for term, values in terms.items()}
    return Account(name, plain, {term: float(factors @ values) for term, values in terms.items()})


def _events(story: Story) -> list[str]:
    """What happened in each step, in words; "" where nothing did."""
    events: list[list[str]] = [[] for _ in range(story.last)]
    if story.outcome == "collision":
        events[-1].append(ENDS["collision"] + " and ".join(map(story.called, story.hit)))
    else:
        events[-1].append(ENDS[story.outcome])
    for first, last in story.close:
        for step in range(first - 1, last):
            nearest = story.called(1 + int(story.separations[step].argmin()))
            events[step].append(f"too close to {nearest}")
    before = np.concatenate(([False], story.stuck[:-1]))
    for step in np.flatnonzero(story.stuck != before):
        events[step].append("stuck: led around the squares" if story.stuck[step] else "free again")
    if story.look is not None:
        rank = story.look.values.argmax(1) != _taken(story)
        for step in np.flatnonzero(rank & ~story.stuck):
            events[step].append("best action passed over: it may lead into a trap")
    return ["; ".join(words) for words in events]


def _gaps(story: Story) -> dict[str, Sequence]:
    """The smallest gap of each step, m, and to whom; None and "" where nobody else is there."""
    gap = story.separations.min(axis=1, initial=np.inf)
    someone = np.isfinite(gap)
    nearest = [
        story.called(1 + int(gaps.argmin())) if here else ""
        for gaps, here in zip(story.separations, someone, strict=True)
    ]
    return {"gap": [value if here else None for value, here in zip(gap, someone, strict=True)], "nearest": nearest}


def _repulsion(story: Story) -> dict[str, np.ndarray]:
    """The resultant social force on the robot before each step, m/s^2."""
    push = resultant(story.force[:-1])
    return {"repulsion_x": push[:, 0], "repulsion_y": push[:, 1], "repulsion": length(push)}


def _values(story: Story) -> dict[str, np.ndarray]:
    """The value of the action that was taken in each step, and the best one of the others; nothing without values."""
    if story.look is None:
        return {}
    at = np.arange(story.last), _taken(story)
    others = story.look.values.astype(float)
    others[at] = -np.inf
    return {"value": story.look.values[at], "runner_up": others.max(1)}


def _taken(story: Story) -> np.ndarray:
    """Which of the actions was taken in each step, (T,)."""
    return length(story.look.actions - story.velocity[1:, 0, None]).argmin(1)


def _plain(value: Any) -> Any:
    """A number of NumPy's as Python's own."""
    return value.item() if isinstance(value, np.generic) else value
