"""Make the networks that come with sfmrl from the tables' run folders: `python tests/make_models.py runs/tables 0-9`.

For each row of both tables, quick preset, the seed whose validations in the second half of its training were the best
on the mean (of several, the lowest) is taken: the test episodes have no say in it. Its weights and card go to
sfmrl/models/; a card of the same weights stays. `unicycle RUN` makes the model of a robot that turns from its run.
Without arguments, test the shipped networks again and rewrite their cards.
"""

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from sfmrl.evaluation import evaluation_record, metrics
from sfmrl.policies import available_cores
from sfmrl.recovery import with_recovery
from sfmrl.recovery.remembering import RememberingPolicy
from sfmrl.runs.bits import machine_bits
from sfmrl.runs.folders import WEIGHTS
from sfmrl.runs.run import Run, open_run
from sfmrl.runs.weights import MODELS, load_weights, save_weights
from sfmrl.study.tables import TABLES, Trained, make_jobs, parse_seeds, read_row, run_folder

PRESET = "quick"
CHECKED = 100  # test episodes whose outcomes a card lists, for the tests
CHOICE = "best mean validation success in the second half of the training, of seeds"


def best_seed(tested: Trained) -> int:
    late = tested.episodes > tested.episodes[-1] / 2
    return tested.seeds[int(tested.validation[:, late].mean(axis=1).argmax())]


def figures(policy: Any, environment: str, episodes: int) -> tuple[dict[str, Any], list[str]]:
    """A test's figures with the Wilson interval of success, and the outcomes of its first episodes."""
    record = evaluation_record(policy, environment=environment, episodes=episodes)
    whole = metrics(record, policy)
    kept = ("episodes", "success", "collision", "timeout", "navigation_time", "total_reward", "recovered")
    found = {name: whole[name] for name in kept if name in whole}
    return found | {"interval": whole["intervals"]["success"]}, record.outcome[:CHECKED].tolist()


def write_card(card: dict[str, Any], episodes: int) -> None:
    """Test a model alone and with recovery, and write its card."""
    network, config = load_weights(MODELS / f"{card['name']}.npz")
    policy = RememberingPolicy(network, config, available_cores())
    alone, _ = figures(policy, card["environment"], episodes)
    helped, outcomes = figures(with_recovery(policy, config.planner), card["environment"], episodes)
    card = card | {"bits": machine_bits(), "alone": alone, "with_recovery": helped}
    card["outcomes"] = "".join(outcome[0] for outcome in outcomes)
    (MODELS / f"{card['name']}.json").write_text(json.dumps(card, indent=2) + "\n")
    found = f"alone {alone['success']:.3f}, with recovery {helped['success']:.3f}"
    print(f"{card['name']}: seed {card['seed']}, {found}", flush=True)


def make_model(name: str, row: str, run: Run, chosen: str, commands: list[str], test: tuple[str, int]) -> None:
    """Copy a run's network and write its card; `test` is its environment and number of episodes."""
    network, config = load_weights(run.folder / WEIGHTS)
    config = replace(config, planner=replace(config.planner, recover=True))  # in tests only; no training sees it
    digest, path = save_weights(network, config, MODELS / f"{name}.npz"), MODELS / f"{name}.json"
    (MODELS / "SHA256SUMS").unlink()  # the card has it
    if path.exists() and json.loads(path.read_text())["sha256"] == digest:
        return
    path.unlink(missing_ok=True)  # the card of other weights, which would be refused
    card = {
        "name": name,
        "variant": row,
        "preset": PRESET,
        "seed": config.seed,
        "chosen": chosen,
        "commands": commands,
        "trained": run.facts["created"][:10],
        "versions": {key: value for key, value in run.facts["versions"].items() if key != "system"},
        "parameters": len(network.flat),
        "sha256": digest,
        "environment": test[0],
    }
    write_card(card, test[1])


def make_models(place: Path, seeds: list[int]) -> None:
    for number, table in TABLES.items():
        for row in table.paper:
            tested = read_row(place, number, PRESET, row, seeds)
            if tested is None:
                print(f"no finished run of row {row} of table {number}")
                continue
            seed = best_seed(tested)
            commands = [job.command for job in make_jobs(number, PRESET, [seed], [row], Path("runs/tables"))]
            chosen = f"{CHOICE} {', '.join(map(str, tested.seeds))}"
            run, test = open_run(run_folder(place, number, PRESET, row, seed)), (table.environment, table.test_episodes)
            make_model(row + ("-table2" if number == 2 else ""), row, run, chosen, commands, test)


def make_unicycle(folder: Path) -> None:
    run = open_run(folder)
    commands = [open_run(folder / run.facts["imitation"]).facts["command"], run.facts["command"]]
    commands = [command.replace(f"{folder.parent}/", "runs/") for command in commands]
    test = run.config.reinforcement.test_environment, run.config.reinforcement.test_episodes
    make_model(f"{run.facts['variant']}-unicycle", run.facts["variant"], run, "the first seed", commands, test)


if __name__ == "__main__":
    if sys.argv[1:2] == ["unicycle"]:
        make_unicycle(Path(sys.argv[2]))
    elif len(sys.argv) > 1:
        make_models(Path(sys.argv[1]), parse_seeds(sys.argv[2]))
    else:
        for path in sorted(MODELS.glob("*.json")):
            known = json.loads(path.read_text())
            write_card(known, known["alone"]["episodes"])
