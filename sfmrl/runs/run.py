"""The run folder: config, command and versions, metrics as CSV, checkpoints; whole at every moment.

    config.json        every setting                    metrics.csv      a line an epoch, or an episode
    run.json           kind, command, versions          validation.csv   rates during the training
    checkpoint-N.npz   all that resuming needs          weights.npz      the trained network, when done
    demonstrations.npz what imitation learnt from       best.npz         the network of the best validation
    map.txt            the map, if it trains on one     test.csv         a line an episode of the final test
    SHA256SUMS         a digest of each file            result.json      the final test's metrics

A killed run goes on from its newest checkpoint to the same bits as one that was never stopped. The digests of what is
read back enter SHA256SUMS when it is written, those of the tables when the run ends.
"""

import io
import json
import os
import platform
import re
import shlex
import sys
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from sfmrl import __version__
from sfmrl.config import Config, ConfigError
from sfmrl.fast import FastNetwork, kernels
from sfmrl.own_code import reward_digest
from sfmrl.rewards import reward_terms
from sfmrl.runs.bits import machine_bits
from sfmrl.runs.files import (
    SUMS,
    TEMPORARY,
    DamagedFile,
    append,
    csv_text,
    json_object,
    read_checked,
    read_listed,
    read_sums,
    remove_checked,
    unlist,
    write_atomically,
    write_text,
    write_together,
)
from sfmrl.runs.folders import (
    BEST,
    DEMONSTRATIONS,
    KINDS,
    LOCK,
    MAP,
    OLD,
    RUNS,
    TABLES,
    WEIGHTS,
    as_words,
    finished,
    in_training,
    kind_of,
    locked,
    run_folders,
)
from sfmrl.runs.weights import weights_file
from sfmrl.scenes import DRAWN, parse_mix
from sfmrl.variants import variant_name

OLDER = ("0.1.", "0.2.")  # versions whose runs hold other weights and checkpoints
KEEP = 2  # checkpoints kept: the newest, and one to fall back on
CHECKPOINT = re.compile(r"checkpoint-\d{6}\.npz")
MADE = ("config.json", MAP, "run.json")  # with a new run, in this order: with run.json, the run is there
WRITTEN = {*MADE, *TABLES, WEIGHTS, BEST, *OLD, DEMONSTRATIONS, SUMS}  # with checkpoints, all that a run ever writes


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
        return finished(self.folder)

    def save_checkpoint(self, state: dict[str, Any]) -> None:
        """Keep all that resuming needs, under the next number; older checkpoints but one are removed."""
        number = 1 + max((int(path.stem.rpartition("-")[2]) for path in self.checkpoints()), default=0)
        write_atomically(self.folder / f"checkpoint-{number:06d}.npz", _state_file(state))
        remove_checked(self.checkpoints()[:-KEEP])

    def checkpoints(self) -> list[Path]:
        """The checkpoint files, oldest first."""
        return sorted(path for path in self.folder.iterdir() if CHECKPOINT.fullmatch(path.name))

    def finish(self, network: FastNetwork) -> None:
        """Save the trained network, list the tables in SHA256SUMS, and delete the checkpoints."""
        tables = [name for name in TABLES if (self.folder / name).exists()]
        write_together(self.folder, {WEIGHTS: weights_file(network, self.config)}, tables)
        remove_checked(self.checkpoints())

    def tidy(self) -> None:
        """Remove what killed processes left: temporary files, digests of files that are gone, old checkpoints."""
        for path in _leftovers(self.folder):
            path.unlink()
        gone = {name for name in read_sums(self.folder) if not (self.folder / name).exists()}
        if self.finished:
            gone = set(filter(CHECKPOINT.fullmatch, gone))
            remove_checked(self.checkpoints())
        unlist(gone, self.folder)

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
        with self.restoring(), np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            state = json.loads(str(arrays["json"]), object_hook=lambda d: arrays[d["array"]] if "array" in d else d)
            if not isinstance(state, dict) or not state:
                raise ValueError("it is empty")
            return state

    @contextmanager
    def restoring(self) -> Iterator[None]:
        """Turn what a checkpoint of another run, or an odd one, leads its readers to into DamagedFile."""
        try:
            yield
        except (LookupError, TypeError, ValueError, AttributeError, zipfile.BadZipFile) as error:
            said = str(error).strip().partition("\n")[0].rstrip(":")
            raise DamagedFile(f"{self.checkpoints()[-1]} is no checkpoint of this run ({said}); delete it") from None

    def write_table(self, name: str, rows: list[dict[str, Any]]) -> None:
        """A CSV file with a line a row, whole or as it was."""
        write_text(self.folder / name, csv_text(rows))

    def append_rows(self, name: str, rows: list[dict[str, Any]]) -> None:
        """Add lines to a CSV file."""
        path = self.folder / name
        append(path, csv_text(rows, header=not path.exists() or path.stat().st_size == 0).encode())

    def write_json(self, name: str, content: dict[str, Any]) -> None:
        """A JSON file, whole or as it was."""
        write_text(self.folder / name, json.dumps(content, indent=2) + "\n")


def check_names(config: Config) -> None:
    """Raise ConfigError where the config names an environment or a reward that does not exist."""
    schedule = config.reinforcement
    for environment in (config.imitation.environment, schedule.environment, schedule.test_environment):
        parse_mix(environment)
    reward_terms(config.reward)


def _state_file(state: dict[str, Any]) -> bytes:
    """The bytes of a file with a nested state: JSON, and beside it the arrays, which the JSON names."""
    arrays: dict[str, np.ndarray] = {}

    def put_aside(array: np.ndarray) -> dict[str, str]:
        arrays[name := f"array{len(arrays)}"] = array
        return {"array": name}

    text, buffer = json.dumps(state, default=put_aside), io.BytesIO()
    np.savez(buffer, json=text, **arrays)
    return buffer.getvalue()


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
    `overwrite` is not set; then only a run (or an empty folder) is ever replaced, and only what a run writes is
    removed. What is left of a run whose making was killed counts as nothing. With `go_on` a run that is there already
    is opened instead, if it has this very config. `imitation` is the run that this one goes on from; it is kept
    relative to the new folder, so that both can be moved. `facts` go into run.json.
    """
    check_names(config)
    schedule = config.reinforcement
    if go_on and folder is not None and kind_of(folder):
        return _same_run(folder, kind, config)
    files = {"config.json": config.to_json()}
    if schedule.environment.startswith(DRAWN):
        files[MAP] = schedule.environment.removeprefix(DRAWN).replace("/", "\n") + "\n"
    facts = {
        "kind": kind,
        "variant": variant_name(config),
        "created": datetime.now(UTC).isoformat(),
        "command": shlex.join(["sfmrl", *sys.argv[1:]]),
        "versions": versions(),
        "own_reward": reward_digest(config.reward),
        **facts,
    }
    name = f"{kind}-{variant_name(config)}-seed{config.seed}"
    for place in [folder] if folder else (RUNS / (name if n == 1 else f"{name}-{n}") for n in count(1)):
        facts["imitation"] = None if imitation is None else os.path.relpath(imitation, place)
        try:
            _make(place, files | {"run.json": json.dumps(facts, indent=2)}, overwrite)
        except ConfigError:
            if folder:
                raise
            continue  # another run has this name
        return replace(open_run(place), config=config)  # whose reward the user has named
    raise AssertionError("there is always one more number")


def _make(folder: Path, files: dict[str, str], overwrite: bool) -> None:
    """Put the first files of a new run into a folder; raises ConfigError where something else is there."""
    _refuse(folder, overwrite)
    folder.mkdir(parents=True, exist_ok=True)
    with locked(folder):
        _refuse(folder, overwrite)  # another process may have been there first
        if _listed(folder, MAP):
            (folder / MAP).unlink(missing_ok=True)
        elif MAP in files and (folder / MAP).exists():
            raise ConfigError(f"{folder / MAP} does not belong to the run; move it away, or name another --run")
        # Without SHA256SUMS the old run cannot be opened, but replaced, whenever this is interrupted.
        (folder / SUMS).unlink(missing_ok=True)
        old = [path for path in folder.iterdir() if path.name not in MADE and _is_of_a_run(path.name)]
        for path in old + _leftovers(folder):
            path.unlink()
        write_together(folder, {name: text.encode() for name, text in files.items()})


def _refuse(folder: Path, overwrite: bool) -> None:
    """Raises ConfigError where no new run may be made: something is in the folder, and it is not to be replaced."""
    if not folder.exists() or (folder.is_dir() and not _holds_something(folder)):
        return
    if kind_of(folder) is None:
        said = ", so --overwrite leaves it alone" if overwrite else ""
        raise ConfigError(f"{folder} is there already, and is not a run folder{said}; name another --run")
    if not overwrite and in_training(folder):
        raise ConfigError(f"{folder} is being trained by another process; name another --run")
    if not overwrite:
        ways = [
            "name another --run",
            "replace it with --overwrite",
            f"go on with it by --resume {as_words(folder)}",
        ]
        raise ConfigError(f"{folder} is there already; {', or '.join(ways[: 2 + (not finished(folder))])}")


def _holds_something(folder: Path) -> bool:
    """Whether there is more in a folder than what is left of a run whose making was killed, which lacks run.json."""
    there = {path.name for path in folder.iterdir()} - {path.name for path in _leftovers(folder)} - {LOCK}
    listed = set(read_sums(folder)) if there else set()
    return bool(there) and not (listed and there <= (listed | {SUMS}) - {"run.json"} and listed <= set(MADE))


def _listed(folder: Path, name: str) -> bool:
    """Whether a folder's SHA256SUMS lists a file; it does not where it is damaged."""
    try:
        return name in read_sums(folder)
    except DamagedFile:
        return False


def _leftovers(folder: Path) -> list[Path]:
    """Temporary files of a run that killed processes left in its folder."""
    names = [(path, TEMPORARY.fullmatch(path.name)) for path in folder.iterdir()]
    return [path for path, name in names if name and _is_of_a_run(name[1])]


def _is_of_a_run(name: str) -> bool:
    """Whether a run writes files of this name."""
    return name in WRITTEN or bool(CHECKPOINT.fullmatch(name))


def _same_run(folder: Path, kind: str, config: Config) -> Run:
    """The run in a folder; raises ConfigError, naming a setting, where it was begun with another config."""
    run = open_run(folder, kind)
    for pair in zip(run.config.to_json().split("\n"), config.to_json().split("\n"), strict=True):
        begun, asked = (line.strip(" ,") for line in pair)
        if begun != asked:
            raise ConfigError(f"{folder} was begun with {begun}, not {asked}; name another --run")
    return replace(run, config=config)


def open_run(folder: Path, kind: str | None = None) -> Run:
    """Open a run folder; raises ConfigError where it is none (or of another kind), DamagedFile where it is damaged."""
    if not (folder / "run.json").is_file() or not (folder / "config.json").is_file():
        what = "is not a run folder: it has no run.json and config.json" if folder.exists() else "does not exist"
        runs = [f"{path} (being trained)" if in_training(path) else str(path) for path in run_folders()]
        known = ", ".join(runs) or "none yet, sfmrl il makes one"
        raise ConfigError(f"{folder} {what}; known runs: {known}")
    facts = _facts(folder / "run.json")
    made = str(facts["versions"].get("sfmrl"))
    if made.startswith(OLDER):
        raise ConfigError(f"{folder} was made by sfmrl {made}; this version only plays its {OLD[0]}, install that one")
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
    """The newest finished run under runs/, by the times in their run.json.

    Raises ConfigError where there is none, DamagedFile where a run.json is damaged.
    """
    for path in RUNS.glob("[!.]*/run.json"):
        read_listed(path)
    for folder in run_folders():
        if finished(folder):
            return folder
    raise ConfigError("there is no finished run under runs/ yet: type sfmrl il, or name a policy, as sarl-sfm6 or orca")


@contextmanager
def sole_use(run: Run) -> Iterator[None]:
    """Keep other processes from training the same run, where the system can, and tidy its folder.

    Raises ConfigError where another process trains the run, or has replaced it since it was opened.
    """
    with locked(run.folder):
        if open_run(run.folder) != run:
            raise ConfigError(f"{run.folder} has just been replaced by another process; name another --run")
        run.tidy()
        yield


def versions() -> dict[str, str]:
    """What the numbers of a run depend on beyond its config."""
    return {
        "sfmrl": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "system": platform.platform(),
        "processor": kernels(),
        "bits": machine_bits(),
    }
