"""Scenes from maps and maps from scenes: `read_map` and its inverse `draw_map`, map files, unsolvable scenes."""

from pathlib import Path

import numpy as np

from sfmrl.config import ConfigError, Simulation
from sfmrl.maps.format import CELL, GOALS, MOST_PLACES, PEOPLE, Drawing, parse
from sfmrl.recovery.planner import shortest_path
from sfmrl.scenes import DRAWN, Scenes

LARGEST = 100_000  # bytes of a map's file


def read_map(text: str, name: str = "map") -> Scenes:
    """The one episode that a text draws, without noise; raises ConfigError (with `name`, line, column) on bad maps."""
    return _scenes(parse(text, name))


def load_map(path: str | Path) -> str:
    """The environment that a text file draws: a name for `sample_scenes` and others that holds the whole drawing.

    Raises ConfigError, with the file's name, line and column, if the file holds no map.
    """
    path = Path(path)
    if not path.exists():
        raise ConfigError(f"there is no map {path}; sfmrl ascii-render --draw prints one to start from")
    if not path.is_file():
        raise ConfigError(f"{path} is a folder, a pipe or a device; name a text file with a map")
    if path.stat().st_size > LARGEST:
        raise ConfigError(f"{path} is larger than a map can be, {LARGEST} bytes; name a text file with a map")
    try:
        data = path.read_bytes()
        encoding = "utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"  # > in Windows PowerShell
        drawing = parse(data.decode(encoding), str(path))
    except UnicodeDecodeError:
        raise ConfigError(f"{path} is not text in UTF-8 or UTF-16; save the map as UTF-8") from None
    return DRAWN + "/".join(_lines(_scenes(drawing)))


def draw_map(scenes: Scenes, episode: int = 0) -> str:
    """Draw the scene in row `episode` as a map for `read_map`, each element and goal in the nearest place.

    Sizes and speeds are lost. Raises ConfigError if a map cannot show the scene: more than nine people, or two things
    in one place.
    """
    text = "\n".join(_lines(scenes, episode)) + "\n"
    try:
        parse(text, "its map")
    except ConfigError as error:
        raise ConfigError(f"this scene cannot be drawn as a map; choose another ({error})") from None
    return text


def why_unsolvable(scenes: Scenes, simulation: Simulation) -> str | None:
    """Why no policy can reach the first episode's goal within the time limit; None if one could."""
    way = float(shortest_path(scenes.take([0]))[0])
    if np.isinf(way):
        return "unsolvable: the squares leave no path to the goal (a passage must be at least two characters wide)"
    # The last step is too late, and the robot has arrived as soon as its goal is within its radius.
    most = (simulation.longest - 1) * simulation.time_step * scenes.v_pref[0, 0] + scenes.radius[0, 0]
    if way >= most:
        limit = f"--time-limit {simulation.time_limit:g} (s)"
        return (
            f"the path to the goal is {way:.1f} m, and within {limit} the robot can reach goals up to {most:.1f} m away"
        )
    return None


def _scenes(drawing: Drawing) -> Scenes:
    """The drawing's one episode, without noise."""
    start, goal = (np.concatenate((end, drawing.squares))[None] for end in (drawing.start, drawing.goal))
    return Scenes(start, goal, square=np.arange(start.shape[1]) >= len(drawing.start), environment=drawing.label)


def _lines(scenes: Scenes, episode: int = 0) -> list[str]:
    """The lines of a scene's map; raises ConfigError as `draw_map` does."""
    start, goal, square = scenes.start[episode], scenes.goal[episode], scenes.square[episode]
    people = np.flatnonzero(~square & ~np.isnan(start[:, 0]))[1:]
    if len(people) > len(PEOPLE):
        raise ConfigError(f"a map shows at most {len(PEOPLE)} people, and this scene has {len(people)}; choose another")
    characters = ["R", "G", *PEOPLE[: len(people)], *"#" * square.sum(), *GOALS[: len(people)]]
    points = np.concatenate((start[:1], goal[:1], start[people], start[square], goal[people])) / CELL
    # The middle of the drawing is the middle of a place, or the corner of four: whichever fits better, in x and in y.
    fits = [np.floor(points + 0.5), np.floor(points) + 0.5]
    places = np.where(np.abs(fits[0] - points).sum(0) <= np.abs(fits[1] - points).sum(0), *fits)
    columns, rows = (2 * np.abs(places).max(0) + 1).astype(int)
    if max(rows, columns) > MOST_PLACES:
        raise ConfigError(f"a map is at most {MOST_PLACES} places wide and high, not {columns} and {rows}")
    drawn = np.full((rows, columns), ".")
    for character, place in zip(characters, places, strict=True):
        if character in GOALS and (place == -places[2 + GOALS.index(character)]).all():
            continue  # the opposite place is the default
        at = int((rows - 1) / 2 - place[1]), int(place[0] + (columns - 1) / 2)
        if drawn[at] != ".":
            raise ConfigError(
                f"a map has one character per place, but {drawn[at]} and {character} share one; choose another scene"
            )
        drawn[at] = character
    return ["".join(line) for line in drawn]
