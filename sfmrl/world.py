"""The simulator of E episodes side by side: the crowd's next velocities, and the result of a robot's action.

A step is: `crowd_velocities` (independent of the robot's action), the policy's choice, `transition` (the one place that
judges outcomes), `advance`. The lookahead calls `transition` with all actions at once. As in CrowdNav, the gap to a
person is the smallest during the step, in which the robot moves with its action and the person as before the step.

A unicycle robot has a heading. In a step it first turns towards the wanted velocity, as far as it can, and then drives
along its new heading.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sfmrl.batch import Batch
from sfmrl.config import Simulation
from sfmrl.geometry import broadcast, closest_approach, direction, length, limit, square_gap, unit_at, vectors, wrapped
from sfmrl.orca import Edges, orca_velocities, polygon_edges
from sfmrl.rewards import COLLISION, RUNNING, SUCCESS, TIMEOUT, Transition
from sfmrl.scenes import Scenes
from sfmrl.sfm import CROWD_FORCE, sfm_velocities

TURN_RATE = np.pi  # rad/s, the fastest turn of a unicycle: CrowdNav's pi/4 in a step of 0.25 s


@dataclass(frozen=True)
class World(Batch):
    """E episodes at one moment, each of N rows: the robot (row 0), people, squares; absent rows are NaN.

    position (E, N, 2): m
    velocity (E, N, 2): m/s
    steps (E,): how many each episode has taken
    goal (E, N, 2): m; a square's is where it stands
    radius (E, N): m; half a square's side
    v_pref (E, N): m/s, highest speed
    preferred_speed (E, N): m/s, v_pref unless the scenes have their own
    square (E, N): bool, which rows are squares
    edges: the squares' outlines, for ORCA; they stay when a square is moved or made absent: change the scenes instead
    episode (E,): which row of the scenes each episode is
    simulation: time step, time limit and the crowd's model, a `Simulation`
    heading (E,): rad, where a unicycle robot points; None if the robot is holonomic
    """

    position: np.ndarray
    velocity: np.ndarray
    steps: np.ndarray
    goal: np.ndarray
    radius: np.ndarray
    v_pref: np.ndarray
    preferred_speed: np.ndarray
    square: np.ndarray
    edges: Edges
    episode: np.ndarray
    simulation: Simulation
    heading: np.ndarray | None

    @property
    def time(self) -> np.ndarray:
        """Seconds since the start, (E,)."""
        return self.steps * self.simulation.time_step

    @property
    def half_and_radius(self) -> tuple[np.ndarray, np.ndarray]:
        """Half sides of solid squares (0 for others), and radii of discs (0 for solid squares), each (E, N) m."""
        solid = self.square & (self.simulation.squares == "solid")
        return np.where(solid, self.radius, 0.0), np.where(solid, 0.0, self.radius)

    @property
    def gap(self) -> np.ndarray:
        """Gap from the robot to each element, (E, N - 1) m, NaN for absent ones."""
        half, radius = self.half_and_radius
        return square_gap(self.position[:, 1:] - self.position[:, :1], half[:, 1:])[0] - radius[:, 1:] - radius[:, :1]

    @property
    def preferred_velocity(self) -> np.ndarray:
        """Towards each agent's goal at its preferred speed; as in CrowdNav slower on the last metre, (E, N, 2) m/s."""
        return limit(self.goal - self.position, self.preferred_speed)

    def position_after(self, action: np.ndarray) -> np.ndarray:
        """The robot's position in m after a step with `action`, (E, 2) or (E, A, 2) in m/s."""
        return self.position[:, 0][_axes(action)] + action * self.simulation.time_step

    def with_elements(self, chosen: np.ndarray) -> "World":
        """The world with the `chosen` elements, (E, N - 1) bool; episodes with fewer keep others as padding."""
        most = int(chosen.sum(1).max(initial=0))
        if most == chosen.shape[1]:
            return self
        elements = 1 + np.argsort(~chosen, axis=1, kind="stable")[:, :most]
        rows = np.arange(len(self))[:, None], np.concatenate((np.zeros((len(self), 1), dtype=int), elements), axis=1)
        each = ("position", "velocity", "goal", "radius", "v_pref", "preferred_speed", "square")
        return replace(self, **{name: getattr(self, name)[rows] for name in each})


def reset(scenes: Scenes, simulation: Simulation = Simulation()) -> World:
    """The world at the start of all `scenes`, everybody at rest, a unicycle robot pointing to its goal."""
    x, y = (scenes.goal[:, 0] - scenes.start[:, 0]).T
    return World(
        position=scenes.start,
        velocity=np.where(np.isnan(scenes.start), np.nan, 0.0),
        steps=np.zeros(len(scenes), dtype=int),
        goal=scenes.goal,
        radius=scenes.radius,
        v_pref=scenes.v_pref,
        preferred_speed=scenes.v_pref if scenes.preferred_speed is None else scenes.preferred_speed,
        square=scenes.square,
        edges=polygon_edges(scenes.polygons, scenes.start),
        episode=np.arange(len(scenes)),
        simulation=simulation,
        heading=np.arctan2(y, x) if simulation.kinematics == "unicycle" else None,
    )


def motion(played: Any) -> dict[str, Any]:
    """How everybody moves in a `World` or a record, by name: position (m), velocity (m/s) and heading (rad).

    Shapes are (E, ...) of a world, (E, T + 1, ...) of a record; a robot that is no unicycle has no heading.
    """
    parts = {name: getattr(played, name) for name in ("position", "velocity", "heading")}
    return {name: part for name, part in parts.items() if part is not None}


def crowd_velocities(world: World) -> np.ndarray:
    """Everybody's velocities in the coming step, (E, N, 2) m/s; squares rest, absent rows are NaN.

    Row 0 is how the crowd's model would move the robot; NaN if the people do not see the robot.
    """
    position = world.position
    if not world.simulation.robot_visible:
        position = position.copy()
        position[:, 0] = np.nan
    velocity = CROWDS[world.simulation.crowd](world, position)
    velocity[world.square] = 0.0
    return velocity


def orca_crowd(
    world: World, position: np.ndarray, agents: np.ndarray | None = None, safety_space: float = 0.0
) -> np.ndarray:
    """ORCA's velocities (E, N, 2), NaN for others than `agents`; `safety_space` m is added to every radius.

    `agents` broadcasts to (E, N); by default it is everybody.
    """
    simulation = world.simulation
    return orca_velocities(
        np.where(world.square[..., None], np.nan, position),
        world.velocity,
        world.preferred_velocity,
        world.radius + (simulation.clearance + safety_space),
        world.v_pref,
        world.edges,
        agents=agents,
        time_step=simulation.time_step,
        neighbor_distance=simulation.neighbor_distance,
        max_neighbors=simulation.max_neighbors,
        time_horizon=simulation.time_horizon,
        obstacle_time_horizon=simulation.obstacle_time_horizon,
    )


def sfm_crowd(world: World, position: np.ndarray) -> np.ndarray:
    """The Social Force Model's velocities, (E, N, 2)."""
    return sfm_velocities(
        position,
        world.velocity,
        world.preferred_velocity,
        world.v_pref,
        force=CROWD_FORCE,
        time_step=world.simulation.time_step,
        radius=world.radius,
        square=world.square,
    )


CROWDS = {"orca": orca_crowd, "sfm": sfm_crowd}


def transition(world: World, action: np.ndarray) -> Transition:
    """The step in which the robot moves with `action`, (E, 2) or many at once, (E, A, 2), in m/s.

    `action` is the robot's velocity; for a unicycle, what it can `drive`. Raises ValueError for other shapes and for
    numbers that are not finite.
    """
    action = _checked(world, action)
    agents = (world.position, world.velocity, world.goal, world.radius, world.v_pref)
    robot, velocity, goal, radius, v_pref = (part[:, 0][_axes(action)] for part in agents)
    steps = world.steps[_axes(action)]
    separations = smallest_gaps(world, action)  # (E, A, K)
    goal_distance = length(world.position_after(action) - goal)  # (E, A)
    late, hit = steps >= world.simulation.longest - 1, separations.min(axis=-1, initial=np.inf) < 0
    outcome = np.where(late, TIMEOUT, np.where(hit, COLLISION, np.where(goal_distance < radius, SUCCESS, RUNNING)))
    dt, shape = world.simulation.time_step, outcome.shape
    return Transition(
        time=np.broadcast_to(steps * dt + dt, shape),
        time_step=np.broadcast_to(dt, shape),
        velocity_before=np.broadcast_to(velocity, action.shape),
        velocity=action,
        preferred_velocity=np.broadcast_to(direction(goal - robot) * v_pref[..., None], action.shape),
        goal_distance_before=np.broadcast_to(length(robot - goal), shape),
        goal_distance=goal_distance,
        separations=separations,
        outcome=outcome,
    )


def smallest_gaps(world: World, action: np.ndarray) -> np.ndarray:
    """The smallest gap to each element in a step with `action` (E, 2) or (E, A, 2): (E, K) or (E, A, K) m.

    Negative in a collision, +inf to absent elements.
    """
    axes = _axes(action)
    # Components first in memory: the same operations then run through long rows.
    position, velocity = (np.ascontiguousarray(part.transpose(2, 0, 1)) for part in (world.position, world.velocity))
    offset = (position[:, :, 1:] - position[:, :, :1])[:, *axes]  # (2, E, 1, K)
    moving = velocity[:, :, 1:][:, *axes] - action.transpose(-1, *range(action.ndim - 1))[..., None]  # (2, E, A, K)
    apart, moving = (part.transpose(*range(1, part.ndim), 0) for part in (offset, moving))  # (E, A, K, 2)
    half, radius = world.half_and_radius
    gap = closest_approach(apart, moving, world.simulation.time_step, half[:, 1:][axes])
    return np.fmin(gap - (radius[:, 1:] + radius[:, :1])[axes], np.inf)  # NaN, to absent elements, becomes +inf


def turned(world: World, wanted: np.ndarray) -> np.ndarray | None:
    """A unicycle robot's heading in rad after a step with the velocity `wanted` (E, 2) or (E, A, 2) in m/s.

    It turns towards that velocity, at most by `TURN_RATE`, and not at all if `wanted` is 0. None if holonomic.
    """
    if world.heading is None:
        return None
    heading, most = world.heading[_axes(wanted)], TURN_RATE * world.simulation.time_step
    turn = wrapped(np.arctan2(wanted[..., 1], wanted[..., 0]) - heading)
    return np.where(wanted.any(-1), wrapped(heading + np.clip(turn, -most, most)), heading)


def drive(world: World, wanted: np.ndarray) -> np.ndarray:
    """The part of the velocity `wanted` that the robot can drive, (E, 2) or (E, A, 2) in m/s; all of it if holonomic.

    A unicycle drives along its new heading with the part of the wanted velocity that points there, and never backwards.
    """
    if (heading := turned(world, wanted)) is None:
        return wanted
    ahead = unit_at(heading)
    speed = wanted[..., 0] * ahead[..., 0] + wanted[..., 1] * ahead[..., 1]
    return np.maximum(speed, 0.0)[..., None] * ahead


def turned_actions(actions: np.ndarray, before: World, after: World) -> np.ndarray:
    """A unicycle's actions (E, A, 2) in m/s, rotated by its turn from `before` to `after`; unchanged if holonomic."""
    if after.heading is None:
        return actions
    x, y = np.moveaxis(actions, -1, 0)
    cos, sin = unit_at(after.heading - before.heading).T[..., None]
    return np.stack((x * cos - y * sin, x * sin + y * cos), axis=-1)


def advance(world: World, velocity: np.ndarray, action: np.ndarray) -> World:
    """The world after a step with everybody's `velocity`, except the robot's, `action` (E, 2), in m/s.

    `velocity` broadcasts to (E, N, 2). A unicycle robot drives the part of the action that it can (`drive`). Raises
    ValueError for other shapes, and for an action that is not finite.
    """
    action = _checked(world, action, many=False)
    velocity = broadcast("velocity", velocity, world.position.shape).copy()
    velocity[:, 0] = drive(world, action)
    position = world.position + velocity * world.simulation.time_step
    heading = turned(world, action)
    return replace(world, position=position, velocity=velocity, steps=world.steps + 1, heading=heading)


def _checked(world: World, action: np.ndarray, many: bool = True) -> np.ndarray:
    """An action (E, 2) or, if `many`, (E, A, 2) as floats; raises ValueError for other shapes, and unless finite."""
    action = vectors("action", action)
    if action.ndim not in (2, 2 + many) or len(action) != len(world):
        shapes = f"({len(world)}, 2)" + (f" or ({len(world)}, A, 2)" if many else "")
        raise ValueError(f"action must have shape {shapes}, not {action.shape}")
    if not np.isfinite(action).all():
        raise ValueError("action is NaN or infinite; it must be a finite velocity in m/s")
    return action


def _axes(action: np.ndarray) -> tuple:
    """The index that gives an array (E, ...) an axis for the actions if these are (E, A, 2)."""
    return slice(None), *(None,) * (action.ndim - 2)
