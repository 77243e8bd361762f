"""Switch off the ingredients of the quick preset one at a time: `python tests/make_ablation.py FOLDER [SEEDS [NAMES]]`.

For each ingredient and seed, a training with the SFM reward is made under FOLDER and tested alone, without recovery:
in the 500 test episodes, and in 300 scenes with few people. NAMES limits the ingredients ("nothing,value prior"). The
trainings are those of `sfmrl table 1 --rows sarl-sfm2`, with other options. Their figures go to
tutorials/results/ablation.csv, and the means with their differences from the whole recipe, paired by seed, to
ablation.md. What is in the CSV file is not trained again, so the same command goes on after a stop: delete the file
after a change of the recipe.
"""

import csv
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console

from sfmrl.config import json_object
from sfmrl.episodes import play
from sfmrl.geometry import length
from sfmrl.policies import available_cores
from sfmrl.runs.files import csv_text, read_listed
from sfmrl.runs.folders import finished
from sfmrl.runs.progress import Interrupted, StopSignal, show_progress
from sfmrl.scenes import Scenes
from sfmrl.study.jobs import Failed, Job, Processes, run_jobs
from sfmrl.study.sheets import Sheet, estimate, number, rate, seconds
from sfmrl.study.statistics import mean_difference
from sfmrl.study.tables import make_jobs, parse_seeds

Run = tuple[int, str, str, str, str]  # a seed, and an entry of INGREDIENTS
CSV = Path(__file__).parents[1] / "tutorials" / "results" / "ablation.csv"
# What is switched off: the name of its runs, and the options for both commands, for imitation, for reinforcement.
INGREDIENTS: dict[str, tuple[str, str, str, str]] = {
    "nothing": ("whole", "", "", ""),
    "value prior": ("prior", "--no-value-prior", "", ""),
    "careful lookahead": ("careful", "--no-careful", "", ""),
    "mirrored batches": ("mirror", "--no-mirror", "", ""),
    "learning from returns": ("returns", "", "", "--targets td"),
    "falling share of random actions": ("epsilon", "", "", "--epsilon-start 0.1 --epsilon-end 0.1"),
    "one fit instead of two": ("refit", "", "--refit", ""),
    "batches of 200": ("batches", "", "--batch-size 100", "--batch-size 100 --batches 12"),
    "reinforcement": ("imitated", "", "", "--learning-rate 0 --episodes 1"),
    "all learning": ("untrained", "", "--learning-rate 0 --epochs 1", "--learning-rate 0 --episodes 1"),
}
FIGURES = ("success", "collision", "timeout", "navigation_time", "total_reward", "success_among_few")
CHANGES = ("success", "navigation_time", "total_reward", "success_among_few")


def trainings(folder: Path, seed: int, name: str, both: str, il_options: str, rl_options: str) -> tuple[Job, Job]:
    """The imitation, which is the whole recipe's if its options are, and the reinforcement."""
    il, rl = make_jobs(1, "quick", [seed], ["sarl-sfm2"], folder)
    if name == "whole":
        return il, rl
    source = folder / f"{name}-il-seed{seed}" if both or il_options else il.folder
    run = folder / f"{name}-seed{seed}"
    changed = {str(il.folder): str(source), str(rl.folder): str(run)}
    il_words = [*(changed.get(word, word) for word in il.words), *both.split(), *il_options.split()]
    rl_words = [*(changed.get(word, word) for word in rl.words), *both.split(), *rl_options.split()]
    return Job(source, tuple(il_words)), replace(rl, folder=run, words=tuple(rl_words), needs=source)


def few_people(episodes: int = 300) -> Scenes:
    """Scenes of one to three people; starts and goals are anywhere up to 12 m in x and y, 1 m from anybody else's."""
    rng = np.random.default_rng(5)
    people = rng.integers(1, 4, episodes)

    def places(robot: tuple[float, float]) -> np.ndarray:
        at = np.full((episodes, 4, 2), robot, dtype=float)
        for i in range(1, 4):
            crowded = np.ones(episodes, dtype=bool)
            while crowded.any():
                at[crowded, i] = rng.uniform(-12, 12, (crowded.sum(), 2))
                crowded = (length(at[:, :i] - at[:, i : i + 1]) < 1).any(axis=1)
        at[np.arange(4) > people[:, None]] = np.nan
        return at

    return Scenes(places((0, -4)), places((0, 4)))


def read_csv(path: Path) -> list[dict[str, str]]:
    """The lines of a CSV file, none if it does not exist."""
    return list(csv.DictReader(path.read_text().splitlines())) if path.exists() else []


def missing(known: list[dict], seeds: list[int], names: list[str]) -> Iterator[tuple[dict, Run]]:
    """What is not among the `known` lines: the beginning of its line, and its seed and entry of INGREDIENTS."""
    there = {(line["switched off"], line["options"], str(line["seed"])) for line in known}
    for seed in seeds:
        for ingredient in names:
            name, *options = INGREDIENTS[ingredient]
            given = [f"{command} {o}".strip() for command, o in zip(("", "il", "rl"), options, strict=True) if o]
            line = {"switched off": ingredient, "options": ", ".join(given), "seed": seed}
            if tuple(map(str, line.values())) not in there:
                yield line, (seed, name, *options)


def new_lines(folder: Path, known: list[dict], wanted: tuple[list[int], list[str]]) -> Iterator[dict]:
    """Lines of what has been trained since, with the figures of its tests."""
    scenes = few_people()
    for line, run in missing(known, *wanted):
        path = trainings(folder, *run)[1].folder
        if finished(path):
            few = {"success_among_few": float((play(scenes, str(path)).outcome == "success").mean())}
            result = json_object(read_listed(path / "result.json")) | few
            yield line | {figure: result[figure] for figure in FIGURES}


def ablation_markdown(lines: list[dict]) -> str:
    """The means over seeds, and their differences from the whole recipe, paired by seed, as tables."""
    rows: dict[str, dict[int, dict]] = {}  # by ingredient and seed
    for line in lines:
        rows.setdefault(line["switched off"], {})[int(line["seed"])] = line
    whole, means, differences = rows["nothing"], [], []

    def values(row: dict[int, dict], figure: str, seeds: list[int]) -> np.ndarray:
        return np.array([float(row[seed][figure]) for seed in seeds])

    for name, row in rows.items():
        of = {figure: values(row, figure, list(row)) for figure in FIGURES}
        means.append(
            {
                "switched off": name,
                "success of every seed": " ".join(map(rate, of["success"])),
                "mean": rate(of["success"].mean()),
                "collisions": rate(of["collision"].mean()),
                "time-outs": rate(of["timeout"].mean()),
                "nav. time, s": seconds(of["navigation_time"].mean()),
                "total reward": number(of["total_reward"].mean()),
                "among few": " ".join(map(rate, of["success_among_few"])),
            }
        )
        if row is not whole and (both := [seed for seed in row if seed in whole]):
            line = {"switched off": name, "options": f"`{row[both[0]]['options']}`", "seeds": " ".join(map(str, both))}
            for figure, form in zip(CHANGES, (rate, seconds, rate, rate), strict=True):
                change = values(row, figure, both) - values(whole, figure, both)
                line[figure.replace("_", " ")] = estimate(mean_difference(change), form)
            differences.append(line)
    titles = "Test episodes alone, without recovery", "Change from the whole recipe (95 %), paired by seed"
    return "\n".join(Sheet(title, part).markdown() for title, part in zip(titles, (means, differences), strict=True))


def main(folder: Path, seeds: list[int], names: list[str]) -> None:
    """Train what is missing, and write both files, also when stopped."""
    known = read_csv(CSV)
    jobs = {job.folder: job for _, run in missing(known, seeds, names) for job in trainings(folder, *run)}
    workers, progress = Processes(available_cores()), show_progress(Console(stderr=True))
    try:
        with StopSignal(print) as stop:
            run_jobs(list(jobs.values()), workers, progress, stop, print)
    except (Interrupted, Failed) as error:
        sys.exit(f"make_ablation: {error or 'stopped'}; the same command goes on")
    finally:
        order, lines = list(INGREDIENTS), known
        for line in new_lines(folder, known, (seeds, names)):
            lines = sorted([*lines, line], key=lambda line: (order.index(line["switched off"]), int(line["seed"])))
            CSV.write_text(csv_text(lines))
        if lines and lines[0]["switched off"] == "nothing":
            CSV.with_suffix(".md").write_text(ablation_markdown(lines))


if __name__ == "__main__":
    numbers = sys.argv[2] if len(sys.argv) > 2 else "0-4"
    ingredients = sys.argv[3].split(",") if len(sys.argv) > 3 else list(INGREDIENTS)
    main(Path(sys.argv[1]), parse_seeds(numbers), ingredients)
