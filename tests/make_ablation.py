"""Switch off the ingredients of the quick preset one at a time: `python tests/make_ablation.py FOLDER [SEEDS]`.

For each ingredient and seed, a training with the SFM reward is made under FOLDER and tested alone, without recovery.
The trainings are those of `sfmrl table 1 --rows sarl-sfm2`, with other options; finished ones are kept, so the same
command goes on after a stop. The figures of every seed go to tutorials/results/ablation.csv, and the means with their
differences from the whole recipe, paired by seed, to ablation.md.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console

from sfmrl.config import json_object
from sfmrl.lookahead import available_cores
from sfmrl.runs.files import csv_text, read_listed
from sfmrl.runs.progress import Interrupted, StopSignal, show_progress
from sfmrl.study.jobs import Failed, Job, Processes, run_jobs
from sfmrl.study.sheets import Sheet, estimate, number, rate, seconds
from sfmrl.study.statistics import mean_difference
from sfmrl.study.tables import make_jobs, parse_seeds

CSV = Path(__file__).parents[1] / "tutorials" / "results" / "ablation.csv"
# What is switched off: the name of its runs, and the options for both commands, for imitation, for reinforcement.
INGREDIENTS: dict[str, tuple[str, str, str, str]] = {
    "nothing": ("whole", "", "", ""),
    "value prior": ("prior", "--no-value-prior", "", ""),
    "careful lookahead": ("careful", "--no-careful", "", ""),
    "mirrored batches": ("mirror", "--no-mirror", "", ""),
    "sparse scenes": ("sparse", "--sparse 0", "", ""),
    "one fit instead of two": ("refit", "", "--refit", ""),
    "failed scenes tried again": ("retry", "", "", "--no-retry"),
    "averaged weights": ("average", "", "", "--average 0"),
    "learning from returns": ("returns", "", "", "--targets td"),
    "falling share of random actions": ("epsilon", "", "", "--epsilon-start 0.1 --epsilon-end 0.1"),
    "batches of 200": ("batches", "", "--batch-size 100", "--batch-size 100 --batches 12"),
}
FIGURES = ("success", "collision", "timeout", "navigation_time", "total_reward")


def trainings(folder: Path, seed: int, name: str, both: str, il_options: str, rl_options: str) -> tuple[Job, Job]:
    """Imitation, the whole recipe's if its options are, and reinforcement."""
    il, rl = make_jobs(1, "quick", [seed], ["sarl-sfm2"], folder)
    if name == "whole":
        return il, rl
    source = folder / f"{name}-il-seed{seed}" if both or il_options else il.folder
    run = folder / f"{name}-seed{seed}"
    changed = {str(il.folder): str(source), str(rl.folder): str(run), "--test-best": "--no-test-best"}
    il_words = [*(changed.get(word, word) for word in il.words), *both.split(), *il_options.split()]
    rl_words = [*(changed.get(word, word) for word in rl.words), *both.split(), *rl_options.split()]
    return Job(source, tuple(il_words)), replace(rl, folder=run, words=tuple(rl_words), needs=source)


def ablation_lines(folder: Path, seeds: list[int]) -> list[dict]:
    """The lines of the CSV file: what was switched off, the options, the seed, and the figures of its test."""
    lines = []
    for ingredient, (name, *options) in INGREDIENTS.items():
        for seed in seeds:
            result = json_object(read_listed(trainings(folder, seed, name, *options)[1].folder / "result.json"))
            given = [f"{command} {o}".strip() for command, o in zip(("", "il", "rl"), options, strict=True) if o]
            line = {"switched off": ingredient, "options": ", ".join(given), "seed": seed}
            lines.append(line | {figure: result[figure] for figure in FIGURES})
    return lines


def ablation_markdown(lines: list[dict]) -> str:
    """The means over seeds, and their differences from the whole recipe, as tables."""
    rows: dict[str, list[dict]] = {}
    for line in lines:
        rows.setdefault(line["switched off"], []).append(line)
    of = {name: {f: np.array([float(line[f]) for line in row]) for f in FIGURES} for name, row in rows.items()}
    whole, means, differences = of["nothing"], [], []
    for name, figures in of.items():
        mean = {figure: float(values.mean()) for figure, values in figures.items()}
        means.append(
            {
                "switched off": name,
                "success of every seed": " ".join(map(rate, figures["success"])),
                "mean": rate(mean["success"]),
                "collisions": rate(mean["collision"]),
                "time-outs": rate(mean["timeout"]),
                "nav. time, s": seconds(mean["navigation_time"]),
                "total reward": number(mean["total_reward"]),
            }
        )
        if figures is not whole:
            line = {"switched off": name, "options": f"`{rows[name][0]['options']}`"}
            for figure in ("success", "total_reward"):
                line[figure.replace("_", " ")] = estimate(mean_difference(figures[figure] - whole[figure]))
            differences.append(line)
    titles = "Test episodes alone, without recovery", "Change from the whole recipe (95 %), paired by seed"
    return "\n".join(Sheet(title, part).markdown() for title, part in zip(titles, (means, differences), strict=True))


if __name__ == "__main__":
    folder, seeds = Path(sys.argv[1]), parse_seeds(sys.argv[2] if len(sys.argv) > 2 else "0-4")
    jobs = {job.folder: job for s in seeds for what in INGREDIENTS.values() for job in trainings(folder, s, *what)}
    try:
        with StopSignal(print) as stop:
            run_jobs(
                list(jobs.values()), Processes(available_cores()), show_progress(Console(stderr=True)), stop, print
            )
    except (Interrupted, Failed) as error:
        sys.exit(f"make_ablation: {error or 'stopped'}; the same command goes on")
    lines = ablation_lines(folder, seeds)
    CSV.write_text(csv_text(lines))
    CSV.with_suffix(".md").write_text(ablation_markdown(lines))
