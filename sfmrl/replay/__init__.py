"""The terminal replay: an episode of a record as pictures of text, played live, printed, or written to files.

    story.py        an episode's numbers, moment by moment: positions, gaps, forces, rewards, attention, values
    canvas.py       characters on a grid, drawn on in metres
    plane.py        the scene from above, on a canvas
    panel.py        the numbers beside it, the timeline and the sentence below it
    frames.py       all of it put together in any size, for one policy or two side by side
    screen.py       played in a terminal, with keys
    recordings.py   written as SVG or as an asciinema recording

Each file imports only from those above it.
"""

from sfmrl.replay.frames import BESIDE, STACKED, Frame, Replay, scene_picture
from sfmrl.replay.recordings import to_cast, to_svg
from sfmrl.replay.screen import play_live
from sfmrl.replay.story import Story, tell

__all__ = ["BESIDE", "STACKED", "Frame", "Replay", "Story", "play_live", "scene_picture", "tell", "to_cast", "to_svg"]
