"""Social metrics: how the robot treats people, by measures of the field beyond the paper's four.

Only people count here, squares do not. A gap is from surface to surface, the smallest during a step in which both discs
move straight on, as in rewards and collisions. A time-out counts the steps that were played.
"""

import numpy as np

from sfmrl.episodes import Record
from sfmrl.geometry import length, wrapped
from sfmrl.recovery.planner import shortest_path
from sfmrl.sfm import repulsive_forces, resultant

DANGER = 0.2  # m, CrowdNav's discomfort distance
ZONES = {"intimate": 0.45, "personal": 1.2, "social": 3.6}  # m, Hall (1966)
LONGEST_TTC = 10.0  # s, of a time to collision
MOVING = 1e-6  # m/s: a slower velocity has no direction

# Each metric's definition, unit and source, which `sfmrl eval --social` prints.
SOCIAL_METRICS = {
    "danger_frequency": "share of all steps that have a gap below 0.2 m, "
    "not counting an episode's last step (CrowdNav)",
    "danger_separation": "mean gap in those steps, m (CrowdNav)",
    "path_length": "length of the robot's path, m",
    "spl": "success x shortest path around the squares' outlines / the longer of it and the path, both to the goal "
    "itself (Anderson et al., 2018); the shortest path is accurate to 2 % over 8 m",
    "min_gap": "smallest gap of an episode, m",
    **{name: f"share of the steps with a gap below {gap} m (Hall, 1966)" for name, gap in ZONES.items()},
    "min_ttc": "smallest time to collision at the velocities before a step, s, at most "
    f"{LONGEST_TTC:g} (exact for discs)",
    "jerk": "mean of |v(t+1) - 2 v(t) + v(t-1)| / dt^2 from the first action on, m/s^3",
    "heading_change": "sum of the angles between successive directions of motion, rad",
    "social_work": "time integral of |all people's force on the robot| + sum of |the robot's on each|, with "
    "equation 2's forces, m/s (after HuNavSim, Perez-Higueras et al., 2023)",
}


def social_metrics(record: Record) -> dict[str, float | None]:
    """Every one of `SOCIAL_METRICS` over a record's episodes; None where there is nothing to measure.

    The two danger metrics are over all steps, as in CrowdNav; the others are means over episodes.
    """
    values = social_values(record)
    danger, gap = _danger(record)
    result = {name: mean_known(value) for name, value in values.items()}
    result["danger_frequency"] = mean_known(danger[record.played])
    result["danger_separation"] = mean_known(gap[danger])
    return result


def social_values(record: Record) -> dict[str, np.ndarray]:
    """Every one of `SOCIAL_METRICS` by episode, (E,); NaN where an episode has nothing to measure.

    Without people, gaps and times to collision are NaN, but shares of steps and social work are 0.
    """
    if not len(record.steps):
        return {name: np.zeros(0) for name in SOCIAL_METRICS}
    dt, steps, played = record.simulation.time_step, record.steps, record.played
    danger, gap = _danger(record)
    position = np.where(_people(record)[:, None, :, None], record.position[:, :-1, 1:], np.nan)
    offset = position - record.position[:, :-1, :1]  # (E, T, H, 2), from the robot to each person
    approach = record.velocity[:, :-1, 1:] - record.velocity[:, :-1, :1]
    reach = record.scenes.radius[:, :1] + record.scenes.radius[:, 1:]
    action = record.velocity[:, 1:, 0]  # (E, T, 2): what the robot did in each step
    path = _summed(length(np.diff(record.position[:, :, 0], axis=1)))
    force = repulsive_forces(-offset)
    change = _summed(length(np.diff(action, 2, axis=1))) / dt**2  # (E,) m/s^3, of all steps together
    work = length(resultant(force)) + np.nansum(length(force), axis=-1)
    nearest = np.where(played, gap, np.inf).min(axis=1)  # m, infinite without people
    until = np.where(played[..., None], _time_to_collision(offset, approach, reach[:, None]), np.inf)  # (E, T, H) s
    soonest = until.min(axis=(1, 2), initial=LONGEST_TTC)
    with np.errstate(invalid="ignore"):
        return {
            "danger_frequency": danger.sum(axis=1) / steps,
            "danger_separation": _ratio(_summed(np.where(danger, gap, 0.0)), danger.sum(axis=1)),
            "path_length": path,
            "spl": _spl(record, path),
            "min_gap": np.where(np.isfinite(nearest), nearest, np.nan),
            **{name: (played & (gap < zone)).sum(axis=1) / steps for name, zone in ZONES.items()},
            "min_ttc": np.where(np.isfinite(nearest), soonest, np.nan),
            "jerk": _ratio(change, np.maximum(steps - 2, 0)),
            "heading_change": _turned(action),
            "social_work": _summed(np.where(played, work, 0.0)) * dt,
        }


def social_rows(record: Record) -> list[dict[str, float | None]]:
    """`social_values` as a row of plain values for each episode, for a CSV file; None where nothing was measured."""
    columns = [[None if np.isnan(v) else float(v) for v in value] for value in social_values(record).values()]
    return [dict(zip(SOCIAL_METRICS, row, strict=True)) for row in zip(*columns, strict=True)]


def _people(record: Record) -> np.ndarray:
    """Which rows after the robot's are people, (E, N - 1) bool."""
    return ~record.scenes.square[:, 1:] & ~np.isnan(record.scenes.start[:, 1:, 0])


def _danger(record: Record) -> tuple[np.ndarray, np.ndarray]:
    """Which steps are dangerous, (E, T) bool, and the gap to the nearest person, (E, T) in m; inf without people."""
    separations = np.where(_people(record)[:, None], record.transition.separations, np.inf)
    gap = separations.min(axis=2, initial=np.inf)
    before_last = np.arange(gap.shape[1]) < record.steps[:, None] - 1
    return before_last & (gap < DANGER), gap


def _spl(record: Record, path: np.ndarray) -> np.ndarray:
    """Success weighted by path length, (E,); to the `path` (E,) in m, the distance left to the goal is added."""
    spl, arrived = np.zeros(len(path)), np.flatnonzero(record.outcome == "success")
    path = path[arrived] + record.transition.goal_distance[arrived, record.steps[arrived] - 1]
    shortest = shortest_path(record.scenes.take(arrived))
    spl[arrived] = np.divide(shortest, path, out=np.ones(len(path)), where=path > shortest)
    return spl


def _time_to_collision(offset: np.ndarray, approach: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Seconds until discs touch at constant velocities; inf if they never do, or if one is absent (NaN).

    `offset`, `approach` (..., 2) are one disc's position and velocity as seen from the other, `reach` (...) the sum of
    their radii. It is the first root of |offset + time approach| = reach.
    """
    speed2 = (approach * approach).sum(-1)
    along = (offset * approach).sum(-1)
    beyond = (offset * offset).sum(-1) - reach * reach
    root = along * along - speed2 * beyond
    meets = (along < 0) & (root >= 0)
    time = (-along - np.sqrt(np.where(meets, root, 0.0))) / np.where(meets, speed2, 1.0)
    return np.where(beyond <= 0, 0.0, np.where(meets, time, np.inf))


def _turned(velocity: np.ndarray) -> np.ndarray:
    """Sum of the absolute angles between successive directions of motion, (E,) in rad; velocity (E, T, 2)."""
    moving = length(velocity) > MOVING  # false where NaN
    # The latest step up to each step in which the robot moves; before the first such step, that one.
    last = np.maximum.accumulate(np.where(moving, np.arange(moving.shape[1]), -1), axis=1)
    last = np.where(last < 0, moving.argmax(axis=1)[:, None], last)
    angle = np.take_along_axis(np.arctan2(velocity[..., 1], velocity[..., 0]), last, axis=1)
    turn = np.diff(np.where(moving.any(axis=1, keepdims=True), angle, 0.0), axis=1)
    return _summed(np.abs(wrapped(turn)))


def _summed(values: np.ndarray) -> np.ndarray:
    """Sums (E,) of values (E, T), with NaN as 0: step by step, so that zeros after an episode's end change no bit."""
    total = np.zeros(len(values))
    for value in np.where(np.isnan(values), 0.0, values).T:
        total += value
    return total


def _ratio(total: np.ndarray, count: np.ndarray) -> np.ndarray:
    """total / count, NaN where there is nothing to count."""
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def mean_known(values: np.ndarray) -> float | None:
    """Mean of the values that are not NaN; None without any."""
    known = values[~np.isnan(values)]
    return float(known.mean()) if len(known) else None
