"""An open run folder: its checkpoints, tables and trained network. The files are listed in `sfmrl/runs/__init__.py`."""

import io
import json
import os
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sfmrl.config import Config, ConfigError, json_object
from sfmrl.fast import FastNetwork
from sfmrl.runs.files import (
    DamagedFile,
    append,
    csv_text,
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
    CHECKPOINT,
    KINDS,
    RUNS,
    TABLES,
    WEIGHTS,
    finished,
    in_training,
    leftovers,
    locked,
    run_folders,
)
from sfmrl.runs.weights import weights_file

OLDER = ("0.1.", "0.2.")  # versions whose runs have other weights and checkpoints
KEEP = 2  # checkpoints: the newest, and one to fall back on if it is damaged


@dataclass(frozen=True)
class Run:
    """An open run folder: its path, its kind ("il" or "rl"), its config, and the contents of run.json."""

    folder: Path
    kind: str
    config: Config
    facts: dict[str, Any]

    @property
    def imitation(self) -> Path | None:
        """The imitation run that this training started from; None without one."""
        source = self.facts.get("imitation")
        return None if source is None else Path(os.path.normpath(self.folder / source))

    def save_checkpoint(self, state: dict[str, Any]) -> None:
        """Save everything that resuming needs under the next number, and delete all but the newest checkpoints."""
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
        """Remove what killed processes left: temporary files, digests without files, checkpoints of a finished run."""
        for path in leftovers(self.folder):
            path.unlink()
        gone = {name for name in read_sums(self.folder) if not (self.folder / name).exists()}
        if finished(self.folder):  # then only checkpoints may be missing: any other missing file stays listed
            gone = set(filter(CHECKPOINT.fullmatch, gone))
            remove_checked(self.checkpoints())
        unlist(gone, self.folder)

    def load_checkpoint(self) -> dict[str, Any] | None:
        """Load the newest checkpoint's state; None if there is none. Raises DamagedFile with the remedy."""
        saved = self.checkpoints()
        if not saved:
            return None
        try:
            data = read_checked(saved[-1])
        except DamagedFile as error:
            before = f"to go on from {saved[-2].name}" if len(saved) > 1 else "to start this run over"
            raise DamagedFile(f"{error}, or delete it {before}") from None
        with self.restoring(), np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            state = json.loads(str(arrays["json"]), object_hook=lambda d: arrays[d["array"]] if "array" in d else d)
            if not isinstance(state, dict) or not state:
                raise ValueError("it is empty")
            return state

    @contextmanager
    def restoring(self) -> Iterator[None]:
        """Raise DamagedFile for any error in the block, which restores a checkpoint that may be another run's."""
        try:
            yield
        except (LookupError, TypeError, ValueError, AttributeError, zipfile.BadZipFile) as error:
            reason = str(error).strip().partition("\n")[0].rstrip(":")
            raise DamagedFile(f"{self.checkpoints()[-1]} is no checkpoint of this run ({reason}); delete it") from None

    def write_table(self, name: str, rows: list[dict[str, Any]]) -> None:
        """Write a CSV file atomically."""
        write_text(self.folder / name, csv_text(rows))

    def append_rows(self, name: str, rows: list[dict[str, Any]]) -> None:
        """Add rows to a CSV file."""
        path = self.folder / name
        append(path, csv_text(rows, header=not path.exists() or path.stat().st_size == 0).encode())

    def write_json(self, name: str, content: dict[str, Any]) -> None:
        """Write a JSON file atomically."""
        write_text(self.folder / name, json.dumps(content, indent=2) + "\n")


def _state_file(state: dict[str, Any]) -> bytes:
    """The bytes of a checkpoint (.npz): the nested state as JSON, and its arrays, which the JSON names."""
    arrays: dict[str, np.ndarray] = {}

    def put_aside(array: np.ndarray) -> dict[str, str]:
        arrays[name := f"array{len(arrays)}"] = array
        return {"array": name}

    text, buffer = json.dumps(state, default=put_aside), io.BytesIO()
    np.savez(buffer, json=text, **arrays)
    return buffer.getvalue()


def open_run(folder: Path, kind: str | None = None) -> Run:
    """Open a run folder; raises ConfigError if it is none, or of another kind, and DamagedFile if it is damaged."""
    if not (folder / "run.json").is_file() or not (folder / "config.json").is_file():
        what = "is not a run folder: it has no run.json and config.json" if folder.exists() else "does not exist"
        runs = [f"{path} (being trained)" if in_training(path) else str(path) for path in run_folders()]
        known = ", ".join(runs) or "none yet, sfmrl il makes one"
        raise ConfigError(f"{folder} {what}; known runs: {known}")
    facts = _read_facts(folder / "run.json")
    version = str(facts["versions"].get("sfmrl"))
    if version.startswith(OLDER):
        raise ConfigError(f"{folder} was made by sfmrl {version}; install that version to play it or go on with it")
    try:
        config = Config.from_json(read_checked(folder / "config.json"))
    except ConfigError as error:
        raise ConfigError(f"{folder / 'config.json'} cannot be used: {error}") from None
    if kind and facts["kind"] != kind:
        raise ConfigError(f"{folder} is a run of sfmrl {facts['kind']}, not of sfmrl {kind}; name one of those")
    return Run(folder, facts["kind"], config, facts)


def _read_facts(path: Path) -> dict[str, Any]:
    """Read a run.json; raises DamagedFile if it is not what `create_run` writes."""
    try:
        facts = json_object(read_checked(path))
    except ValueError as error:
        raise DamagedFile(f"{path} is damaged: {error}; put back a copy") from None
    types = {"kind": str, "variant": str, "created": str, "command": str, "versions": dict}
    types |= {"imitation": str | None, "weights": dict | None}
    if facts.get("kind") not in KINDS or not all(isinstance(facts.get(name), kind) for name, kind in types.items()):
        raise DamagedFile(f"{path} is damaged: it does not say {', '.join(types)} of a run; put back a copy")
    return facts


def newest_run() -> Path:
    """The newest finished run under runs/, by the times in their run.json.

    Raises ConfigError if there is none, and DamagedFile if a run.json is damaged, whose time then cannot be trusted.
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

    Raises ConfigError if another process is training the run, or has replaced it since it was opened.
    """
    with locked(run.folder):
        if open_run(run.folder) != run:
            raise ConfigError(f"{run.folder} has just been replaced by another process; name another --run")
        run.tidy()
        yield
