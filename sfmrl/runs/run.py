"""An open run folder and its checkpoints. The files of a run are listed in `sfmrl/runs/__init__.py`."""

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
from sfmrl.own_code.trust import check_unchanged
from sfmrl.runs.files import (
    DamagedFile,
    read_arrays,
    read_checked,
    read_regular,
    read_sums,
    remove,
    remove_checked,
    unlist,
    write_together,
)
from sfmrl.runs.folders import CHECKPOINT, KINDS, TABLES, WEIGHTS, finished, in_training, leftovers, locked, run_folders

OLDER = ("0.1.", "0.2.")  # versions whose runs have other weights and checkpoints
KEEP = 2  # checkpoints: the newest, and one to fall back on if it is damaged


@dataclass(frozen=True)
class Run:
    """An open run folder: its path, its kind ("il" or "rl"), its config, and the contents of run.json."""

    folder: Path
    kind: str
    config: Config
    facts: dict[str, Any]

    def check_reward(self) -> None:
        """Raise ConfigError if the user's own reward has changed since the run began."""
        check_unchanged(self.config.reward.reward, self.facts.get("own_reward"))

    @property
    def imitation(self) -> Path | None:
        """The imitation run that this training started from; None without one."""
        source = self.facts.get("imitation")
        return None if source is None else Path(os.path.normpath(self.folder / source))

    def checkpoints(self) -> list[Path]:
        """The checkpoint files, oldest first."""
        return sorted(path for path in self.folder.iterdir() if CHECKPOINT.fullmatch(path.name))

    def save_checkpoint(self, state: dict[str, Any]) -> None:
        """Save a nested state as a checkpoint (JSON, and the arrays that it names); delete all but the newest."""
        arrays: dict[str, Any] = {}

        def put_aside(array: np.ndarray) -> dict[str, str]:
            arrays[name := f"array{len(arrays)}"] = array
            return {"array": name}

        buffer = io.BytesIO()
        np.savez(buffer, json=json.dumps(state, default=put_aside), **arrays)
        number = 1 + max((int(path.stem.rpartition("-")[2]) for path in self.checkpoints()), default=0)
        write_together(self.folder, {f"checkpoint-{number:06d}.npz": buffer.getvalue()})
        remove_checked(self.checkpoints()[:-KEEP])

    def load_checkpoint(self) -> dict[str, Any] | None:
        """The state in the newest checkpoint; None without one. Raises DamagedFile, with the remedy."""
        saved = self.checkpoints()
        if not saved:
            return None
        try:
            data = read_checked(saved[-1])
        except DamagedFile as error:
            before = f"to resume from {saved[-2].name}" if len(saved) > 1 else "to start this run over"
            raise DamagedFile(f"{error}, or delete it {before}") from None
        with self.restoring():
            arrays = read_arrays(data)
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

    def finish(self, weights: bytes) -> None:
        """Write the weights file, and the tables again, so that SHA256SUMS lists them; delete the checkpoints."""
        tables = {name: read_regular(self.folder / name) for name in TABLES if (self.folder / name).exists()}
        write_together(self.folder, tables | {WEIGHTS: weights})
        remove_checked(self.checkpoints())


def open_run(folder: Path, kind: str | None = None) -> Run:
    """Open a run folder; raises ConfigError if it is none, or of another kind, and DamagedFile if it is damaged."""
    if (folder / "run.json").is_file() and not (folder / "config.json").exists():
        raise DamagedFile(f"{folder / 'config.json'} is missing; put back a copy")
    if not (folder / "run.json").is_file() or not (folder / "config.json").is_file():
        what = "is not a run folder: it has no run.json and config.json" if folder.exists() else "does not exist"
        runs = [f"{path} (being trained)" if in_training(path) else str(path) for path in run_folders()]
        raise ConfigError(f"{folder} {what}; known runs: {', '.join(runs) or 'none yet, sfmrl il makes one'}")
    facts = _read_facts(folder / "run.json")
    version = str(facts["versions"].get("sfmrl"))
    if version.startswith(OLDER):
        raise ConfigError(f"{folder} was made by sfmrl {version}; install that version to play or resume it")
    config = Config.from_json(read_checked(folder / "config.json"), folder / "config.json")
    if kind and facts["kind"] != kind:
        raise ConfigError(f"{folder} is a run of sfmrl {facts['kind']}; name a run of sfmrl {kind}")
    return Run(folder, facts["kind"], config, facts)


def _read_facts(path: Path) -> dict[str, Any]:
    """Read a run.json; raises DamagedFile if it is not what `create_run` writes."""
    try:
        facts = json_object(read_checked(path))
    except ValueError as error:
        raise DamagedFile(f"{path} is damaged: {error}; put back a copy") from None
    types: dict[str, Any] = {"kind": str, "variant": str, "created": str, "command": str, "versions": dict}
    types |= {"imitation": str | None, "weights": dict | None}
    if facts.get("kind") not in KINDS or not all(isinstance(facts.get(name), kind) for name, kind in types.items()):
        raise DamagedFile(f"{path} is damaged: it does not say {', '.join(types)} of a run; put back a copy")
    return facts


@contextmanager
def sole_use(run: Run) -> Iterator[None]:
    """Keep other processes from training the same run, where the system can, and tidy its folder.

    Raises ConfigError if another process is training the run, or has replaced it since it was opened.
    """
    with locked(run.folder):
        if open_run(run.folder) != run:
            raise ConfigError(f"{run.folder} has just been replaced by another process; name another --run")
        _tidy(run)
        yield


def _tidy(run: Run) -> None:
    """Remove what killed processes left: temporary files, digests without files, checkpoints of a finished run."""
    for path in leftovers(run.folder):
        remove(path)
    gone = {name for name in read_sums(run.folder) if not (run.folder / name).exists()}
    if finished(run.folder):  # then only checkpoints may be missing: any other missing file stays listed
        gone = set(filter(CHECKPOINT.fullmatch, gone))
        remove_checked(run.checkpoints())
    unlist(gone, run.folder)
