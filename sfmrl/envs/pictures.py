"""A moment of an episode, as text like the stills of `sfmrl ascii-render`, or as an image."""

from dataclasses import replace

import numpy as np

from sfmrl.config import Config
from sfmrl.envs.crowd import Crowd
from sfmrl.episodes import Record
from sfmrl.geometry import length
from sfmrl.replay.frames import Replay
from sfmrl.replay.story import make_story
from sfmrl.rewards import RUNNING, TIMEOUT, Transition
from sfmrl.scenes import Scenes
from sfmrl.world import World, transition

ROBOT, PERSON, SQUARE, GOAL = (0, 139, 167), (70, 70, 70), (160, 160, 160), (46, 160, 67)  # red, green, blue
DISCOUNT = Config().discount  # of the return that is shown, per second at 1 m/s
PIXELS = 400  # of an image's side
MARGIN = 1.5  # m around all goals


def as_text(crowd: Crowd, past: list[tuple[World, Transition]]) -> str:
    """The present moment in 80 x 24 characters, after the `past`: the world before each step so far, and the step."""
    steps, running = list(past), not past or past[-1][1].outcome[0] == RUNNING
    if running:  # a story needs an end, so add a step that times out
        rest = transition(crowd.world, np.zeros((1, 2)))
        steps.append((crowd.world, replace(rest, outcome=np.array([TIMEOUT]))))
    story = make_story(_recorded(crowd, steps), None, crowd.reward, DISCOUNT)
    if running:
        story = replace(story, time=np.append(story.time[:-1], story.time_limit))
    return Replay((story,), ("",)).frame(len(past)).plain


def _recorded(crowd: Crowd, steps: list[tuple[World, Transition]]) -> Record:
    """The record, without rewards, of a crowd's one episode."""
    worlds = [world for world, _ in steps] + [crowd.world]
    parts = zip(*(vars(step).values() for _, step in steps), strict=True)
    at, headings = worlds[0], [world.heading for world in worlds if world.heading is not None]
    return Record(
        scenes=Scenes(at.position, at.goal, at.radius, at.v_pref, at.square, crowd.labels, at.episode),
        simulation=crowd.simulation,
        steps=np.array([len(steps)]),
        position=np.stack([world.position for world in worlds], axis=1),
        velocity=np.stack([world.velocity for world in worlds], axis=1),
        transition=Transition(*(np.stack(part, axis=1) for part in parts)),
        reward=np.zeros((1, len(steps))),
        discounted_return=np.zeros(1),
        heading=np.stack(headings, axis=1) if headings else None,
    )


def as_image(world: World, e: int) -> np.ndarray:
    """Episode `e` of the world from above, uint8 (400, 400, 3): the robot's goal, squares, people, and the robot."""
    position, radius, square = world.position[e], world.radius[e], world.square[e]
    half = np.nanmax(np.abs(world.goal[e])) + MARGIN
    axis = half * np.linspace(-1.0, 1.0, PIXELS)
    points = np.stack(np.meshgrid(axis, -axis), axis=-1)  # (400, 400, 2) m, the upper line first
    image = np.full((PIXELS, PIXELS, 3), 255, dtype=np.uint8)
    image[length(points - world.goal[e, 0]) <= radius[0]] = GOAL
    for row in reversed(range(len(position))):  # the robot, row 0, above all
        away = points - position[row]
        distance = np.abs(away).max(axis=-1) if square[row] else length(away)
        image[distance <= radius[row]] = SQUARE if square[row] else PERSON if row else ROBOT
    return image
