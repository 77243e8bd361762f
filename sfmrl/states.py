"""The robot-centred state: what the value network reads, a row for each element around the robot.

The paper's two states. The robot's own columns are repeated in every element's row, as in SARL: 6 + 7 columns, or
8 + 9 with social forces. The frame's origin is the robot and its x axis points to the goal. theta is 0 throughout:
it belongs to robots that cannot move sideways, which are left out.
"""

import numpy as np

from sfmrl.config import SocialForce
from sfmrl.geometry import length, numbers, vectors
from sfmrl.sfm import repulsive_forces, resultant

OWN = ("goal_distance", "v_pref", "theta", "radius", "velocity_x", "velocity_y")
ELEMENT = (
    "element_x",
    "element_y",
    "element_velocity_x",
    "element_velocity_y",
    "element_radius",
    "distance",
    "radius_sum",
)
COLUMNS = OWN + ELEMENT
COLUMNS_WITH_FORCES = (*OWN, "resultant_x", "resultant_y", *ELEMENT, "force_x", "force_y")


def column_names(forces: bool) -> tuple[str, ...]:
    """Names of the state's columns, 13 or, with forces, 17."""
    return COLUMNS_WITH_FORCES if forces else COLUMNS


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
    forces: bool = False,
    force: SocialForce = SocialForce(),
) -> np.ndarray:
    """Robot-centred states (..., K, F) as float32, F = 13 or 17; the leading axes (...) of all inputs broadcast.

    The robot's `position`, `velocity`, `goal` (..., 2), `radius`, `v_pref` (...); its elements' `element_position`,
    `element_velocity` (..., K, 2), `element_radius` (..., K); metres and m/s. Absent elements are NaN in, NaN out. With
    nobody around (K = 0) there is one absent element, since the robot's own columns need a row to stand in. Raises
    ValueError for other shapes.
    """
    position, velocity, goal = vectors("position", position), vectors("velocity", velocity), vectors("goal", goal)
    element_position = vectors("element_position", element_position)
    element_velocity = vectors("element_velocity", element_velocity)
    element_radius = numbers("element_radius", element_radius)
    shapes = element_position.shape, element_velocity.shape, element_radius.shape
    if not shapes[0][-2:-1] == shapes[1][-2:-1] == shapes[2][-1:] != ():
        raise ValueError(
            "element_position, element_velocity and element_radius must have shapes (..., K, 2), (..., K, 2) and "
            f"(..., K) with the same K, not {shapes[0]}, {shapes[1]} and {shapes[2]}"
        )
    if not element_radius.shape[-1]:
        nobody = np.full((*element_radius.shape[:-1], 1), np.nan)
        element_position = element_velocity = np.stack((nobody, nobody), axis=-1)
        element_radius = nobody
    to_goal = goal - position
    x, y = to_goal[..., 0], to_goal[..., 1]
    goal_distance = np.sqrt(x * x + y * y)
    # The rotation that lays the goal on the x axis; at the goal itself, no rotation.
    there = goal_distance == 0
    distance_or_one = np.where(there, 1.0, goal_distance)
    cos, sin = np.where(there, 1.0, x / distance_or_one)[..., None], (y / distance_or_one)[..., None]

    dx = element_position[..., 0] - position[..., 0, None]
    dy = element_position[..., 1] - position[..., 1, None]
    ux, uy = element_velocity[..., 0], element_velocity[..., 1]
    vx, vy = velocity[..., 0, None], velocity[..., 1, None]
    radius = np.asarray(radius)[..., None]

    columns = {
        "goal_distance": goal_distance[..., None],
        "v_pref": np.asarray(v_pref)[..., None],
        "theta": 0.0,
        "radius": radius,
        "velocity_x": vx * cos + vy * sin,
        "velocity_y": vy * cos - vx * sin,
        "element_x": dx * cos + dy * sin,
        "element_y": dy * cos - dx * sin,
        "element_velocity_x": ux * cos + uy * sin,
        "element_velocity_y": uy * cos - ux * sin,
        "element_radius": element_radius,
        "distance": np.sqrt(dx * dx + dy * dy),
        "radius_sum": radius + element_radius,
    }
    if forces:
        away = np.stack((-columns["element_x"], -columns["element_y"]), axis=-1)
        push = repulsive_forces(away, force)  # rotated like everything else, since `away` is
        pushed = resultant(push)
        columns["force_x"], columns["force_y"] = push[..., 0], push[..., 1]
        columns["resultant_x"], columns["resultant_y"] = pushed[..., 0, None], pushed[..., 1, None]

    names = column_names(forces)
    shape = np.broadcast_shapes(*(np.shape(column) for column in columns.values()))
    states = np.empty((len(names), *shape), dtype=np.float32)  # filled row by row, and then turned, which is faster
    for row, name in enumerate(names):
        states[row] = columns[name]
    return np.ascontiguousarray(np.moveaxis(states, 0, -1))


def elements_within(reach: float, position: np.ndarray) -> np.ndarray:
    """Positions of the elements (..., K, 2), NaN where more than `reach` m from the robot, row 0 of `position`."""
    elements = position[..., 1:, :]
    if reach == np.inf:
        return elements
    near = length(elements - position[..., :1, :]) <= reach
    return np.where(near[..., None], elements, np.nan)


def mirrored_columns(forces: bool) -> np.ndarray:
    """What to multiply a state's columns with to mirror it left to right: -1 for those along y, else 1; (F,)."""
    return np.where([name.endswith("_y") for name in column_names(forces)], -1, 1).astype(np.float32)


def is_alone(states: np.ndarray) -> np.ndarray:
    """Whether states (..., K, F) have no element in them, (...) bool."""
    own = len(OWN) + 2 * (states.shape[-1] == len(COLUMNS_WITH_FORCES))
    return np.isnan(states[..., own]).all(-1)
