"""Success in validation over the training, of a table's rows or of single runs, as lines for CSV and for figures."""

from pathlib import Path
from typing import Any

from sfmrl.config import ConfigError
from sfmrl.evaluation import wilson
from sfmrl.runs.files import read_table
from sfmrl.runs.run import open_run
from sfmrl.study.statistics import mean_interval
from sfmrl.study.tables import Trained


def table_validations(rows: dict[str, Trained]) -> list[dict[str, Any]]:
    """A line per validation of each row: mean over seeds, its 95 % interval, each seed's success; None for no value."""
    seeds = sorted({seed for tested in rows.values() for seed in tested.seeds})
    lines = []
    for name, tested in rows.items():
        for episode, success in zip(tested.episodes, tested.validation.T, strict=True):
            low, high = mean_interval(success, 0.0, 1.0)
            found = dict(zip(tested.seeds, success.tolist(), strict=True))
            by_seed = {f"seed {seed}": found.get(seed) for seed in seeds}
            mean = {"mean": float(success.mean()), "low": low, "high": high}
            lines.append({"row": name, "episode": int(episode), **mean, **by_seed})
    return lines


def run_validations(folders: list[str]) -> list[dict[str, Any]]:
    """A line per validation of each run: success, and its 95 % Wilson interval over the validation's episodes.

    Raises ConfigError if a folder is no reinforcement run or has no validation yet, DamagedFile if it is damaged.
    """
    lines: list[dict[str, Any]] = []
    for folder in folders:
        run = open_run(Path(folder), "rl")
        episodes = run.config.reinforcement.validation_episodes
        path, before = run.folder / "validation.csv", len(lines)
        try:
            for row in read_table(path) if path.exists() else []:
                success = float(row["success"])
                low, high = wilson(round(success * episodes), episodes)
                lines.append({"row": folder, "episode": int(row["episode"]), "mean": success, "low": low, "high": high})
        except (ValueError, LookupError, ArithmeticError) as error:  # as a killed training can leave it
            raise ConfigError(f"{path} cannot be read ({error!r}); resume the training, or put back a copy") from None
        if len(lines) == before:
            raise ConfigError(f"{folder} has no validation yet; wait for its first one")
    return lines
