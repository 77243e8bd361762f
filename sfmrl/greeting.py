"""What to type next, for whoever types `sfmrl` alone. Quick to import."""

from sfmrl import __version__
from sfmrl.folders import as_words, finished, run_folders, unfinished


def greeting() -> str:
    """A few commands and what they do, with the newest finished run (or a model) as their policy."""
    folders = run_folders()
    policy = next((as_words(folder) for folder in folders if finished(folder)), "sarl-sfm6")
    lines = [f"sfmrl {__version__} teaches a robot to cross a crowd."]
    if folders and not finished(folders[0]):
        lines.append(unfinished(folders[0]))
    commands = {
        "sfmrl il && sfmrl rl --reward sfm": "train a robot (a minute or two)",
        f"sfmrl eval {policy}": "test it on 500 episodes",
        f"sfmrl ascii-render {policy}": "watch it",
        "sfmrl --help": "all commands",
    }
    width = max(map(len, commands))
    return "\n".join([*lines, *(f"  {command:{width}}  {words}" for command, words in commands.items())])
