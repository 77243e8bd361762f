"""The robot-centred state, the input of the value network: a row for each element around the robot.

The paper has two states. The robot's own columns are repeated in every element's row, as in SARL: 6 + 7 columns, or
8 + 9 with social forces. The origin is the robot, and the x axis points to the goal. theta is 0, or the heading
of a unicycle robot, in rad from the x axis, wrapped to -pi to pi; CrowdNav does not wrap it.
"""

import numpy as np

from sfmrl.config import Config
from sfmrl.geometry import direction, length, numbers, vectors, wrapped
from sfmrl.sfm import repulsive_forces, resultant

OWN = ("goal_distance", "v_pref", "theta", "radius", "velocity_x", "velocity_y")
ELEMENT = (
    *("element_x", "element_y", "element_velocity_x", "element_velocity_y"),
    *("element_radius", "distance", "radius_sum"),
)
COLUMNS = OWN + ELEMENT
COLUMNS_WITH_FORCES = (*OWN, "resultant_x", "resultant_y", *ELEMENT, "force_x", "force_y")


def column_names(forces: bool) -> tuple[str, ...]:
    """Names of the state's columns, 13 or, with forces, 17."""
    return COLUMNS_WITH_FORCES if forces else COLUMNS


def own_columns(forces: bool) -> int:
    """The number of the robot's own columns, which come first: 6 or, with forces, 8."""
    return column_names(forces).index("element_x")


def robot_states(
    position: np.ndarray,
    velocity: np.ndarray,
    goal: np.ndarray,
    radius: np.ndarray,
    v_pref: np.ndarray,
    element_position: np.ndarray,
    element_velocity: np.ndarray,
    element_radius: np.ndarray,
    *,
    heading: np.ndarray | None = None,
    forces: bool = False,
) -> np.ndarray:
    """Robot-centred states (..., K, F) as float32, F = 13 or 17; the leading axes (...) of all inputs broadcast.

    The robot's `position`, `velocity`, `goal` (..., 2), `radius`, `v_pref` (...), and its `heading` (...) in rad if it
    is a unicycle; its elements' `element_position`, `element_velocity` (..., K, 2), `element_radius` (..., K); m and
    m/s. An element with a NaN position is absent: its place, distance and force are NaN. If K = 0, one absent element
    holds the robot's columns. Raises ValueError for other shapes.
    """
    position, velocity, goal = vectors("position", position), vectors("velocity", velocity), vectors("goal", goal)
    element_position, element_velocity, element_radius = _elements(element_position, element_velocity, element_radius)
    radius, v_pref = np.asarray(radius)[..., None], np.asarray(v_pref)[..., None]
    goal_distance, way = length(goal - position)[..., None], direction(goal - position)
    # The rotation that lays the goal on the x axis; at the goal itself, no rotation.
    cos, sin = np.where(goal_distance == 0, 1.0, way[..., :1]), way[..., 1:]
    theta = 0.0 if heading is None else wrapped(np.asarray(heading)[..., None] - np.arctan2(sin, cos))

    def turned(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return x * cos + y * sin, y * cos - x * sin

    dx, dy = (element_position[..., axis] - position[..., axis, None] for axis in (0, 1))
    own: list[np.ndarray | float]
    own = [goal_distance, v_pref, theta, radius, *turned(velocity[..., :1], velocity[..., 1:])]  # the columns in OWN
    element = [*turned(dx, dy), *turned(element_velocity[..., 0], element_velocity[..., 1])]  # those in ELEMENT
    element += [element_radius, np.sqrt(dx * dx + dy * dy), radius + element_radius]
    if forces:  # in the robot's frame
        push = repulsive_forces(np.stack((-element[0], -element[1]), axis=-1))
        pushed = resultant(push)
        own += [pushed[..., :1], pushed[..., 1:]]
        element += [push[..., 0], push[..., 1]]
    return _joined([*own, *element])


def _elements(
    position: np.ndarray, velocity: np.ndarray, radius: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The elements' arrays, checked; one absent element if there are none. Raises ValueError for other shapes."""
    position, velocity = vectors("element_position", position), vectors("element_velocity", velocity)
    radius = numbers("element_radius", radius)
    counts = {position.shape[-2:-1], velocity.shape[-2:-1], radius.shape[-1:]}  # (K,) of each
    if len(counts) > 1 or () in counts:
        raise ValueError(
            "element_position, element_velocity and element_radius must have shapes (..., K, 2), (..., K, 2) and "
            f"(..., K) with the same K, not {position.shape}, {velocity.shape} and {radius.shape}"
        )
    if radius.shape[-1]:
        return position, velocity, radius
    absent = np.full((*radius.shape[:-1], 1, 2), np.nan)
    return absent, absent, absent[..., 0]


def _joined(columns: list[np.ndarray | float]) -> np.ndarray:
    """Columns that broadcast to (..., K) as one float32 array (..., K, F)."""
    shape = np.broadcast_shapes(*(np.shape(column) for column in columns))
    states = np.empty((len(columns), *shape), dtype=np.float32)  # filled row by row, and then turned, which is faster
    for row, column in enumerate(columns):
        states[row] = column
    return np.ascontiguousarray(np.moveaxis(states, 0, -1))


def states_of(
    position: np.ndarray,
    velocity: np.ndarray,
    goal: np.ndarray,
    radius: np.ndarray,
    v_pref: np.ndarray,
    heading: np.ndarray | None,
    config: Config,
) -> np.ndarray:
    """`robot_states` (E, K, F) of agents (E, N, ...), row 0 the robot, with a config's columns and reach."""
    robot = position[:, 0], velocity[:, 0], goal[:, 0], radius[:, 0], v_pref[:, 0]
    elements = elements_within(config.reach, position), velocity[:, 1:], radius[:, 1:]
    return robot_states(*robot, *elements, heading=heading, forces=config.forces)


def elements_within(reach: float, position: np.ndarray) -> np.ndarray:
    """Positions of the elements (..., K, 2), NaN if more than `reach` m from the robot, row 0 of `position`."""
    elements = position[..., 1:, :]
    if reach == np.inf:
        return elements
    near = length(elements - position[..., :1, :]) <= reach
    return np.where(near[..., None], elements, np.nan)


def mirrored_columns(forces: bool) -> np.ndarray:
    """The factors (F,) that mirror a state's columns left to right: -1 for those along y and theta, else 1."""
    return np.where([name.endswith(("_y", "theta")) for name in column_names(forces)], -1, 1).astype(np.float32)
