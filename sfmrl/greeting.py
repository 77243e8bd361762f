"""What to type next, for whoever types `sfmrl` alone: it depends on the runs that are there. Quick to import."""

import shlex
from pathlib import Path

from sfmrl import __version__
from sfmrl.files import DamagedFile, json_object, read_regular
from sfmrl.folders import RUNS, finished, in_training, kind_of, run_folders

Line = tuple[str, str]  # what to type, and what it does


def greeting() -> str:
    """Where the user stands, and a few commands with what they do."""
    where, lines = _next_steps(run_folders())
    lines.append(("sfmrl --help", "all commands"))
    width = max(len(command) for command, _ in lines)
    listed = [
        f"  {command:{width}}  {words}" if width <= 44 else f"  {command}\n      {words}" for command, words in lines
    ]
    return "\n".join([f"sfmrl {__version__} teaches a robot to cross a crowd.", where, *listed])


def _next_steps(folders: list[Path]) -> tuple[str, list[Line]]:
    """How far the runs in `folders`, the newest first, have come, and what to type then."""
    ended = [folder for folder in folders if finished(folder)]
    trained = next((folder for folder in ended if kind_of(folder) == "rl"), None)
    imitated = next((folder for folder in ended if kind_of(folder) == "il"), None)
    lines: list[Line] = []
    if folders and in_training(folders[0]):
        where = f"{folders[0]} is being trained now."
    elif folders and not finished(folders[0]):
        where = f"{folders[0]} has not ended."
        lines.append((f"sfmrl {kind_of(folders[0])} --resume {_quoted(folders[0])}", "go on with it"))
    elif trained:
        where = f"{trained} is trained."
    elif imitated:
        where = f"{imitated} has learnt from ORCA."
    else:
        where = f"There are no runs in {RUNS}/ yet."
        lines.append(("sfmrl il && sfmrl rl --reward sfm", "train one, in about two minutes"))
    if trained:
        lines.append((f"sfmrl eval {_quoted(trained)}", "test it on 500 episodes"))
        lines.append((f"sfmrl ascii-render {_quoted(trained)}", "watch it"))
        lines.append((f"sfmrl explain {_quoted(trained)}", "see what each step is paid for"))
        return where, lines
    if imitated:
        lines.append((f"sfmrl rl --reward sfm{_flags(imitated)}", "reinforce what it has learnt"))
        lines.append((f"sfmrl ascii-render {_quoted(imitated)}", "watch it"))
        return where, lines
    lines.append(("sfmrl ascii-render sarl-sfm6", "watch a trained robot now"))
    lines.append(("sfmrl doctor", "does all work here?"))
    return where, lines


def _flags(folder: Path) -> str:
    """The options under which a training finds this imitation run, where they are not the defaults."""
    try:
        config = json_object(read_regular(folder / "config.json"))
        given = {name: config[name] for name in ("preset", "seed")}
    except (OSError, ValueError, LookupError, DamagedFile):
        return ""
    return "".join(
        f" --{name} {given[name]}" for name, usual in (("preset", "quick"), ("seed", 0)) if given[name] != usual
    )


def _quoted(folder: Path) -> str:
    return shlex.quote(folder.as_posix())
