"""The run folder: config, command and versions, metrics as CSV, checkpoints; whole at every moment.

    config.json        every setting                    metrics.csv      a line an epoch, or an episode
    run.json           kind, command, versions          validation.csv   rates during the training
    checkpoint-N.pt    all that resuming needs          weights.pt       the trained network, when done
    demonstrations.npz what imitation learnt from       best.pt          the network of the best validation
    SHA256SUMS         digests of what is read back     test.csv         a line an episode of the final test
                                                        result.json      the final test's metrics

A killed run goes on from its newest checkpoint to the same bits as one that was never stopped.
"""

import json
import os
import platform
import shlex
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import torch

from sfmrl import __version__
from sfmrl.config import Config, ConfigError
from sfmrl.files import DamagedFile, csv_text, json_object, read_checked, remove_checked, write_atomically
from sfmrl.folders import KINDS, RUNS, WEIGHTS, kind_of, run_folders
from sfmrl.network import ValueNetwork, resolved
from sfmrl.own_code import reward_digest
from sfmrl.rewards import reward_terms
from sfmrl.scenarios import parse_mix
from sfmrl.variants import variant_name
from sfmrl.weights import read_foreign, save_weights

KEEP = 2  # checkpoints kept: the newest, and one to fall back on


@dataclass(frozen=True)
class Run:
    """An open run folder: its path, its kind ("il" or "rl"), its config and what run.json says."""

    folder: Path
    kind: str
    config: Config
    facts: dict[str, Any]

    @property
    def imitation(self) -> Path | None:
        """The imitation run that this one goes on from; None without."""
        source = self.facts.get("imitation")
        return None if source is None else Path(os.path.normpath(self.folder / source))

    @property
    def finished(self) -> bool:
        """Whether the training has come to its end."""
        return (self.folder / WEIGHTS).exists()

    def save_checkpoint(self, state: dict[str, Any]) -> None:
        """Keep all that resuming needs, under the next number; older checkpoints but one are removed."""
        number = 1 + max((int(path.stem.rpartition("-")[2]) for path in self.checkpoints()), default=0)
        write_atomically(self.folder / f"checkpoint-{number:06d}.pt", lambda file: torch.save(state, file))
        remove_checked(self.checkpoints()[:-KEEP])

    def checkpoints(self) -> list[Path]:
        """The checkpoint files, oldest first."""
        return sorted(self.folder.glob("checkpoint-" + "[0-9]" * 6 + ".pt"))

    def finish(self, network: ValueNetwork) -> None:
        """Keep the trained network: the run has come to its end, and needs its checkpoints no more."""
        save_weights(network, self.config, self.folder / WEIGHTS)
        remove_checked(self.checkpoints())

    def load_checkpoint(self) -> dict[str, Any] | None:
        """The newest checkpoint's state, None where there is none yet; raises DamagedFile with the way out."""
        saved = self.checkpoints()
        if not saved:
            return None
        try:
            data = read_checked(saved[-1])
        except DamagedFile as error:
            before = f"to go on from {saved[-2].name}" if len(saved) > 1 else "to start this run anew"
            raise DamagedFile(f"{error}, or delete it {before}") from None
        state = read_foreign(data, saved[-1])
        if not isinstance(state, dict) or not state:
            raise DamagedFile(f"{saved[-1]} is no checkpoint of this run (it is empty); delete it")
        return state

    @contextmanager
    def restoring(self) -> Iterator[None]:
        """Turn what a checkpoint of another run, or an odd one, leads its readers to into DamagedFile."""
        try:
            yield
        except (LookupError, TypeError, ValueError, AttributeError, RuntimeError) as error:
            said = str(error).strip().partition("\n")[0].rstrip(":")
            raise DamagedFile(f"{self.checkpoints()[-1]} is no checkpoint of this run ({said}); delete it") from None

    def write_table(self, name: str, rows: list[dict[str, Any]]) -> None:
        """A CSV file with a line a row, whole or as it was."""
        write_atomically(self.folder / name, lambda file: file.write(csv_text(rows).encode()), checked=False)

    def append_rows(self, name: str, rows: list[dict[str, Any]]) -> None:
        """Add lines to a CSV file."""
        path = self.folder / name
        with open(path, "a", newline="") as file:
            file.write(csv_text(rows, header=path.stat().st_size == 0))

    def write_json(self, name: str, content: dict[str, Any]) -> None:
        """A JSON file, whole or as it was."""
        text = json.dumps(content, indent=2) + "\n"
        write_atomically(self.folder / name, lambda file: file.write(text.encode()), checked=False)


def create_run(
    kind: str,
    config: Config,
    folder: Path | None,
    imitation: Path | None = None,
    *,
    overwrite: bool = False,
    go_on: bool = False,
    **facts: Any,
) -> Run:
    """Make a run folder: the one named, or a new one under runs/ whose name says kind, variant and seed.

    Raises ConfigError where a name in the config stands for nothing, and where the folder is there already and
    `overwrite` is not set; then only a run (or an empty folder) is ever replaced. With `go_on` a run that is there
    already is opened instead, if it has this very config. `imitation` is the run that this one goes on from; it is kept
    relative to the new folder, so that both can be moved. `facts` go into run.json.
    """
    schedule = config.reinforcement
    for environment in (config.imitation.environment, schedule.environment, schedule.test_environment):
        parse_mix(environment)
    reward_terms(config.reward)
    if go_on and folder is not None and kind_of(folder):
        return _same_run(folder, kind, config)
    config = replace(config, precision=resolved(config.precision))
    if folder is None:
        name = f"{kind}-{variant_name(config)}-seed{config.seed}"
        folder = _new_folder(name)
    elif folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        if not overwrite:
            unfinished = kind_of(folder) is not None and not (folder / WEIGHTS).exists()
            ways = ["name another --run", "replace it with --overwrite", f"go on with it by --resume {folder}"]
            raise ConfigError(f"{folder} is there already; {', or '.join(ways[: 2 + unfinished])}")
        if kind_of(folder) is None:
            raise ConfigError(f"{folder} is not a run folder, so --overwrite leaves it alone; name another --run")
        shutil.rmtree(folder)
    folder.mkdir(parents=True, exist_ok=True)
    facts = {
        "kind": kind,
        "variant": variant_name(config),
        "created": datetime.now(UTC).isoformat(),
        "command": shlex.join(["sfmrl", *sys.argv[1:]]),
        "versions": versions(),
        "own_reward": reward_digest(config.reward),
        "imitation": None if imitation is None else os.path.relpath(imitation, folder),
        **facts,
    }
    run = Run(folder, kind, config, facts)
    write_atomically(folder / "config.json", lambda file: file.write(config.to_json().encode()))
    write_atomically(folder / "run.json", lambda file: file.write(json.dumps(facts, indent=2).encode()))
    return run


def _same_run(folder: Path, kind: str, config: Config) -> Run:
    """The run in a folder; raises ConfigError, naming a setting, where it was begun with another config."""
    run = open_run(folder, kind)
    if config.precision == "auto":
        config = replace(config, precision=run.config.precision)  # as it was resolved where the run began
    for pair in zip(run.config.to_json().split("\n"), config.to_json().split("\n"), strict=True):
        begun, asked = (line.strip(" ,") for line in pair)
        if begun != asked:
            raise ConfigError(f"{folder} was begun with {begun}, not {asked}; name another --run")
    return replace(run, config=config)


def _new_folder(name: str) -> Path:
    """Make runs/name, or the first of runs/name-2, runs/name-3 ... that nobody has made."""
    RUNS.mkdir(exist_ok=True)
    for number in count(1):
        folder = RUNS / (name if number == 1 else f"{name}-{number}")
        try:
            folder.mkdir()
        except FileExistsError:
            continue
        return folder
    raise AssertionError("there is always one more number")


def open_run(folder: Path, kind: str | None = None) -> Run:
    """Open a run folder; raises ConfigError where it is none (or of another kind), DamagedFile where it is damaged."""
    if not (folder / "run.json").is_file() or not (folder / "config.json").is_file():
        what = "is not a run folder: it has no run.json and config.json" if folder.exists() else "does not exist"
        known = ", ".join(map(str, run_folders())) or "none yet, sfmrl il makes one"
        raise ConfigError(f"{folder} {what}; known runs: {known}")
    facts = _facts(folder / "run.json")
    try:
        config = Config.from_json(read_checked(folder / "config.json"))
    except ConfigError as error:
        raise ConfigError(f"{folder / 'config.json'} cannot be used: {error}") from None
    if kind and facts["kind"] != kind:
        raise ConfigError(f"{folder} is a run of sfmrl {facts['kind']}, not of sfmrl {kind}; name one of those")
    return Run(folder, facts["kind"], config, facts)


def _facts(path: Path) -> dict[str, Any]:
    """What a run.json says; raises DamagedFile where it is not what `create_run` writes."""
    try:
        facts = json_object(read_checked(path))
    except ValueError as error:
        raise DamagedFile(f"{path} is damaged: {error}; put back a copy") from None
    kinds = {"kind": str, "variant": str, "created": str, "command": str, "versions": dict}
    kinds |= {"imitation": str | None, "weights": dict | None}
    if facts.get("kind") not in KINDS or not all(isinstance(facts.get(n), kind) for n, kind in kinds.items()):
        raise DamagedFile(f"{path} is damaged: it does not say {', '.join(kinds)} of a run; put back a copy")
    return facts


def newest_run() -> Path:
    """The newest finished run under runs/; raises ConfigError where there is none."""
    for folder in run_folders():
        if (folder / WEIGHTS).exists():
            return folder
    raise ConfigError("there is no finished run under runs/ yet: type sfmrl il, or name a policy, as sarl-sfm6 or orca")


@contextmanager
def sole_use(run: Run) -> Iterator[None]:
    """Keep a second process from training the same run, where the system can; raises ConfigError where one does."""
    try:
        import fcntl
    except ImportError:
        yield
        return
    with open(run.folder / ".lock", "w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ConfigError(f"{run.folder} is being trained by another process; wait for it, or stop it") from None
        yield


def versions() -> dict[str, str]:
    """What the numbers of a run depend on beyond its config."""
    return {
        "sfmrl": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "torch": torch.__version__,
        "system": platform.platform(),
        "processor": torch.backends.cpu.get_cpu_capability(),
    }
