"""The file of ORCA's demonstrations in an imitation run.

It holds trajectories without rewards or states, so that trainings with any reward and state can learn from it.
"""

import io
from dataclasses import fields
from pathlib import Path

import numpy as np

from sfmrl.config import Simulation
from sfmrl.episodes import Record, check_memory
from sfmrl.geometry import length
from sfmrl.rewards import Transition
from sfmrl.runs.files import DamagedFile, read_arrays, read_checked, write_atomically
from sfmrl.scenes import Scenes

# Fields of Transition that follow from the rest of the file and the settings.
DERIVED = ("time_step", "goal_distance_before", "velocity_before")
STORED = [item.name for item in fields(Transition) if item.name not in DERIVED]


def save_demonstrations(record: Record, path: Path) -> None:
    """Write a record's trajectories: arrays (E, T, ...) as (S, ...), the steps of all episodes in one axis."""
    moments = np.arange(record.position.shape[1]) <= record.steps[:, None]
    scenes = {f.name: getattr(record.scenes, f.name) for f in fields(Scenes)}
    arrays = {f"scenes.{name}": part for name, part in scenes.items() if part is not None}
    arrays |= {f"transition.{name}": getattr(record.transition, name)[record.played] for name in STORED}
    arrays |= {"position": record.position[moments], "velocity": record.velocity[moments], "steps": record.steps}
    arrays |= {} if record.heading is None else {"heading": record.heading[moments]}
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    write_atomically(path, buffer.getvalue())


def load_demonstrations(path: Path, simulation: Simulation) -> Record:
    """Load the record that `save_demonstrations` wrote, without rewards; raises DamagedFile, also for NaN."""
    data = read_checked(path)
    try:
        arrays = read_arrays(data)
        steps = arrays["steps"]
        names = [name for name in arrays if name.startswith("scenes.")]
        scenes = Scenes(**{name.removeprefix("scenes."): arrays[name] for name in names})
        if steps.min() < 1 or steps.sum() != len(arrays["transition.outcome"]):
            raise ValueError("there are more or fewer steps than it says")
        check_memory(len(scenes), scenes.start.shape[1], int(steps.max()))
        played = np.arange(steps.max()) < steps[:, None]
        moments = np.arange(steps.max() + 1) <= steps[:, None]
        stored = {name: _spread(arrays[f"transition.{name}"], played) for name in STORED}
        position, velocity = _spread(arrays["position"], moments), _spread(arrays["velocity"], moments)
        heading = _spread(arrays["heading"], moments) if simulation.kinematics == "unicycle" else None
        present = np.isfinite(scenes.start)[:, None] & moments[..., None, None]  # (E, T+1, N, 2)
        parts = {name: values[played] for name, values in stored.items()}
        parts["separations"] = np.minimum(parts["separations"], 0.0)  # may be +inf, to absent elements
        moved = (position[present], velocity[present], np.zeros(0) if heading is None else heading[moments])
        if not all(np.isfinite(part).all() for part in (*moved, *parts.values())):
            raise ValueError("they are not finite")
    except Exception as error:  # damaged bytes can raise anything in NumPy
        raise DamagedFile(f"{path} does not hold demonstrations ({error}); make them again with sfmrl il") from None
    transition = Transition(
        **stored,
        time_step=np.where(played, simulation.time_step, np.nan),
        goal_distance_before=np.where(played, length(position[:, :-1, 0] - scenes.goal[:, None, 0]), np.nan),
        velocity_before=np.where(played[..., None], velocity[:, :-1, 0], np.nan),
    )
    unknown = np.full(played.shape, np.nan)  # rewards and returns
    return Record(scenes, simulation, steps, position, velocity, transition, unknown, unknown[:, 0], heading=heading)


def _spread(flat: np.ndarray, where: np.ndarray) -> np.ndarray:
    """Put rows (S, ...) at the S true entries of `where` (E, T): (E, T, ...), with NaN (0 for integers) elsewhere."""
    full = np.full(where.shape + flat.shape[1:], np.nan if flat.dtype.kind == "f" else 0, dtype=flat.dtype)
    full[where] = flat
    return full
