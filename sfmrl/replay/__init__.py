"""The terminal replay: draw an episode as text, to be played live, printed, or written to files.

An episode first becomes a `Story`, arrays over its moments. A `Replay` of one or two stories draws each moment as a
`Frame` of any size. The frames go to a terminal (`play_live`), or into a picture or a recording (`to_svg`, `to_cast`).

    story.py        positions, gaps, forces, rewards, attention and values at every moment
    canvas.py       characters on a grid, drawn on in metres
    plane.py        the scene from above, on a canvas
    timeline.py     the time as a line of marks, the latest event as a sentence
    panel.py        the numbers beside the plane
    frames.py       plane, panel and timeline together, and two policies side by side
    screen.py       playback in a terminal, with keys and a legend
    recordings.py   SVG and asciinema recordings
    picture.py      scenes and episodes as SVG and HTML, for notebooks and web pages
"""
