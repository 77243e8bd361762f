"""The command as people and programs use it: real processes, their output, exit codes and error lines."""

import csv
import errno
import hashlib
import inspect
import json
import math
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import fields, is_dataclass
from itertools import pairwise
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
import torch
import typer
from conftest import ROOT, Call, assert_one_line_error, environment
from rich.console import Console

from sfmrl import __version__, cli, config
from sfmrl.cli import app, completion
from sfmrl.cli.console import print_sheet
from sfmrl.cli.train import on_run
from sfmrl.config import Config, ConfigError, Reward, override
from sfmrl.episodes import play
from sfmrl.fast import Sizes, as_fast
from sfmrl.network import ValueNetwork
from sfmrl.policies import POLICIES, load_policy
from sfmrl.rewards import REWARDS
from sfmrl.runs.bits import machine_bits
from sfmrl.runs.create import create_run, start_run
from sfmrl.runs.folders import locked, why_unfinished
from sfmrl.runs.weights import load_weights, model_names
from sfmrl.scenes import ENVIRONMENTS, sample_scenes
from sfmrl.sfm import SocialForce
from sfmrl.study.sheets import Sheet
from sfmrl.variants import MIXES, PRESETS, VARIANTS, make_config

COMMANDS = typer.main.get_command(app).commands
TINY_IL = ("--episodes", "6", "--epochs", "2")
TINY_RL = ("--episodes", "4", "--parallel", "4", "--validation-episodes", "2", "--test-episodes", "4")


def test_eval_measures_how_people_are_treated_only_where_it_is_asked_to(in_process, monkeypatch):
    measured = []
    monkeypatch.setattr("sfmrl.study.social.social_metrics", lambda record: measured.append(record) or {})
    words = ("eval", "linear", "--environment", "circle0", "--episodes", "1")
    for more, times in (((), 0), (("--csv", "e.csv"), 0), (("--social",), 1), (("--json",), 2)):
        assert in_process(*words, *more).returncode == 0
        assert len(measured) == times


def test_from_imitation_to_replay(sfmrl: Call, tmp_path: Path):
    il = sfmrl("il", *TINY_IL)
    assert (il.returncode, il.stdout) == (0, "")
    assert "done: runs/il-sarl-seed0; next: sfmrl rl --reward sfm --from runs/il-sarl-seed0, or sfmrl eval" in il.stderr

    rl = sfmrl("rl", "--reward", "sfm", *TINY_RL)
    assert rl.returncode == 0, rl.stderr
    assert "from imitation run runs/il-sarl-seed0" in rl.stderr
    assert "learning from its demonstrations again" not in rl.stderr  # another reward goes on with the same network
    assert "test of runs/rl-sarl-sfm2-seed0, environment table1" in rl.stdout
    result = json.loads((tmp_path / "runs/rl-sarl-sfm2-seed0/result.json").read_text())
    assert result["episodes"] == 4

    assert result.pop("bits") == machine_bits()
    recovered = result.pop("with_recovery")
    again = sfmrl("eval", "--episodes", "4", "--json", "--csv", "out.csv")  # the newest run, as it was tested
    assert again.returncode == 0, again.stderr
    assert "policy: runs/rl-sarl-sfm2-seed0" in again.stderr
    found = json.loads(again.stdout)
    assert {name: found[name] for name in recovered} == recovered
    alone = json.loads(sfmrl("eval", "--episodes", "4", "--json", "--no-recover").stdout)
    assert {name: alone[name] for name in result} == result
    assert "recovered" not in alone
    assert (found["policy"], found["environment"], found["seed"]) == ("runs/rl-sarl-sfm2-seed0", "table1", 0)
    with open(tmp_path / "out.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["episode"] for row in rows] == ["0", "1", "2", "3"]
    assert sum(row["outcome"] == "success" for row in rows) == 4 * recovered["success"]

    refused = sfmrl("eval", "--episodes", "4", "--csv", "out.csv")
    assert_one_line_error(refused, "out.csv", "--overwrite")
    assert len((tmp_path / "out.csv").read_text().splitlines()) == 5
    assert sfmrl("eval", "linear", "--episodes", "2", "--csv", "out.csv", "--overwrite").returncode == 0
    assert len((tmp_path / "out.csv").read_text().splitlines()) == 3

    replay = sfmrl("ascii-render", "--frames", "2", "--episode", "1")
    assert replay.returncode == 0, replay.stderr
    assert replay.stdout.count("episode 1") == 2
    assert "\x1b" not in replay.stdout
    assert max(map(len, replay.stdout.splitlines())) <= 100  # COLUMNS

    finished = sfmrl("rl", "--resume", "runs/rl-sarl-sfm2-seed0")
    assert finished.returncode == 2
    assert "is finished; nothing is left to train" in finished.stderr


def test_an_existing_run_is_only_replaced_when_told(sfmrl: Call, tmp_path: Path):
    assert sfmrl("il", *TINY_IL, "--run", "mine").returncode == 0
    weights = (tmp_path / "mine" / "weights.npz").read_bytes()
    assert_one_line_error(sfmrl("il", *TINY_IL, "--run", "mine"), "mine already exists", "--overwrite")
    assert (tmp_path / "mine" / "weights.npz").read_bytes() == weights
    assert sfmrl("il", *TINY_IL, "--seed", "3", "--run", "mine", "--overwrite").returncode == 0
    assert (tmp_path / "mine" / "weights.npz").read_bytes() != weights
    # The run that a training starts from is not what it may replace.
    weights = (tmp_path / "mine" / "weights.npz").read_bytes()
    own = sfmrl("rl", *TINY_RL, "--from", "mine", "--run", "mine", "--overwrite")
    assert own.returncode == 2
    assert (tmp_path / "mine" / "weights.npz").read_bytes() == weights


def test_a_run_from_scratch_needs_no_imitation(sfmrl: Call):
    done = sfmrl("rl", "--from-scratch", *TINY_RL, "--forces", "--environment", "5", "--json-is-no-option")
    assert_one_line_error(done, "--json-is-no-option")
    done = sfmrl("rl", "--from-scratch", *TINY_RL, "--forces", "--environment", "5", "--time-limit", "4")
    assert done.returncode == 0, done.stderr
    assert "environment 5" in done.stdout


def test_a_network_of_crowdnav_s_is_trained_on_from_its_file(sfmrl: Call, tmp_path: Path):
    sizes = Sizes((40, 30), (40, 20), (30, 30, 1), (40, 30, 20, 1))  # not the usual ones
    network = ValueNetwork(seed=3, sizes=sizes)
    path = tmp_path / "il_model.pth"
    torch.save(network.state_dict(), path)
    short = [*TINY_RL, "--environment", "5", "--time-limit", "4", "--learning-rate", "0", "--no-recover"]
    short += ["--run", "mine"]
    assert_one_line_error(sfmrl("rl", "--from", path, "--forces", *short), "reads 13 columns, but this training has 17")
    done = sfmrl("rl", "--from", path, *short)  # on a process of its own, too, since --parallel is above 1
    assert done.returncode == 0, done.stderr
    assert f"from the network in {path}, without --value-prior" in done.stderr
    trained, config = load_weights(tmp_path / "mine" / "weights.npz")
    assert not config.value_prior
    assert np.array_equal(trained.flat, as_fast(network).flat)  # at a learning rate of 0
    facts = json.loads((tmp_path / "mine" / "run.json").read_text())
    assert facts["weights"]["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
    assert "il_model.pth" in sfmrl("verify", "mine", "--episodes", "1").stdout
    # Before the first checkpoint, it starts again from the file, if that is unchanged.
    for name in ("weights.npz", "result.json", "best.npz"):
        (tmp_path / "mine" / name).unlink()
    torch.save(ValueNetwork(seed=4, sizes=sizes).state_dict(), path)
    assert_last_line(sfmrl("rl", "--resume", "mine"), "has changed or gone since this run began")


def test_a_model_is_trained_on_by_its_name(tmp_path: Path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    config = make_config(variant="sarl-sfm6", reinforcement={"episodes": 4})
    run = start_run(config, Path("sarl-sfm6"), False, tmp_path / "mine")
    network, _ = load_weights(Path(run.facts["weights"]["file"]))
    assert np.array_equal(network.flat, load_policy("sarl-sfm6").network.flat)
    assert start_run(config, Path("sarl-sfm6"), False, tmp_path / "mine", go_on=True) == run
    create_run("il", make_config(), Path("sarl-sfm6"))
    with pytest.raises(ConfigError, match="sarl-sfm6"):  # a folder of that name comes first; this one is not trained
        start_run(config, Path("sarl-sfm6"), False, tmp_path / "other")


def assert_last_line(done: subprocess.CompletedProcess, words: str) -> None:
    """Wrong use that is found after something has been said."""
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    assert words in done.stderr.splitlines()[-1]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes with names")
def test_pipes_are_no_files_and_are_not_waited_for(in_process: Call, tmp_path: Path):
    os.mkfifo(tmp_path / "pipe")
    os.mkfifo(tmp_path / "pipe.py")
    for words in (
        ("eval", "pipe"),
        ("compare", "orca", "pipe"),
        ("explain", "pipe"),
        ("ascii-render", "pipe"),
        ("eval", "orca", "--map", "pipe"),
        ("eval", "orca", "--episodes", "1", "--csv", "pipe", "--overwrite"),
        ("eval", "orca", "--episodes", "1", "--reward", "pipe.py:mine"),
        ("ascii-render", "orca", "--svg", "pipe", "--overwrite"),
        ("rl", "--from", "pipe"),
        ("verify", "pipe"),
    ):
        assert_one_line_error(in_process(*words), "pipe")


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"sha256": 3}', "[" * 100_000])
def test_a_model_s_odd_card_is_one_error(in_process: Call, monkeypatch, tmp_path: Path, text):
    monkeypatch.setattr("sfmrl.runs.weights.MODELS", tmp_path)
    (tmp_path / "odd.json").write_text(text)
    (tmp_path / "odd.pt").write_bytes(b"")
    for words in (("models",), ("eval", "odd", "--episodes", "1")):
        assert_one_line_error(in_process(*words), "not what sfmrl came with; install sfmrl again")


SECTIONS = [each for each in (*vars(config).values(), SocialForce) if isinstance(each, type) and is_dataclass(each)]


@pytest.mark.parametrize("section", SECTIONS)
def test_every_number_of_the_config_has_both_ends_and_takes_nothing_beyond(section):
    for item in fields(section):
        if isinstance(item.default, (int, float)) and not isinstance(item.default, bool):
            low, high = item.metadata["range"]
            assert low <= item.default <= high
            for bad in (low - 1, high + 1, math.nan, math.inf, -math.inf, 10**400, "1", None, True, [1]):
                with pytest.raises(ConfigError, match=item.name.replace("_", "-")):
                    section(**{item.name: bad})


WRONG_USE = [
    (("eval", "orca", "--k", "0.1"), ("--k changes nothing with --reward crowd",)),
    (("eval", "orca", "--stall-time", "2"), ("--stall-time changes nothing without recovery", "--recover")),
    (("il", "--discount-rate", "0.1"), ("--discount-rate changes nothing",)),
    (("il", "--run", "x", "--continue", "--overwrite"), ("--continue and --overwrite exclude each other",)),
    (("eval", ""), ("the name of a policy is empty", "leave it out to take the newest run")),
    (("eval", "orac"), ("there is no policy orac", "linear, orca, sfm", "did you mean orca?")),
    (("eval", "runs/none"), ("there is no policy runs/none",)),
    (("eval", "mine.py"), ("mine.py is Python code; name the policy in it, mine.py:FUNCTION",)),
    (("eval", "orca", "--episode", "5"), ("--episode", "--episodes")),
    (("eval", "orca", "--episodes", "0"), ("--episodes",)),
    (("eval", "orca", "--environment", "7"), ("there is no environment '7'", "table1")),
    (("eval", "orca", "--environment", ""), ("there is no environment ''",)),
    (("eval", "orca", "--environment", "table1,table2"), ("table1 is a mix itself", "write shares, as in 1:0.7,2:0.3")),
    (("eval", "orca", "--environment", "circle" + "9" * 30), ("there is no environment 'circle999",)),
    (("eval", "orca", "--environment", "circle1000"), ("there is no environment 'circle1000'",)),
    (("eval", "orca", "--environment", "circle999", "--episodes", "1"), ("no room for person",)),
    (("eval", "orca", "--time-step", "0.001", "--time-limit", "3600"), ("steps; it may have 100000",)),
    (("table", "1", "--seeds", "0-999999999999"), ("--seeds", "at most 1000")),
    (("table", "1", "--seeds", "9" * 5000), ("--seeds",)),
    (("table", "1", "--seeds", "0-\u00b2"), ("--seeds",)),
    (("eval", "orca", "--reward", "smf"), ("there is no reward 'smf'", "did you mean sfm?")),
    (("eval", "orca", "--crowd", "orka"), ("crowd is 'orka'; choose orca, sfm", "did you mean orca?")),
    (("eval", "orca", "--csv", "no/such/folder.csv"), ("no folder no/such",)),
    (("eval", "orca", "--episodes", "2", "--csv", ".", "--overwrite"), (". is not a regular file",)),
    (("eval", "orca", "--humans", "0.5"), ("--humans", "integer")),
    (("eval", "orca", "--environment", "map-rooms"), ("there is no environment 'map-rooms'", "did you mean map-room?")),
    (("eval", "orca", "--recover", "--resolution", "0"), ("resolution",)),
    (("eval", "."), (". holds no network",)),
    (("eval",), ("no finished run", "sfmrl il")),
    (("il", "--variant", "sarl-sfn"), ("there is no variant 'sarl-sfn'", "did you mean sarl-sfm?")),
    (("il", "--preset", "papre"), ("did you mean paper?",)),
    (("il", "--seed", "-1"), ("seed is -1",)),
    (("il", "--resume", "nowhere", "--seed", "1"), ("--resume takes every setting",)),
    (("rl",), ("no finished imitation run", "sfmrl il --preset quick --seed 0", "--from-scratch")),
    (("rl", "--preset", "paper", "--seed", "3"), ("sfmrl il --preset paper --seed 3",)),
    (("rl", "--from", "nowhere"), ("nowhere does not exist",)),
    (("rl", "--from", "x", "--from-scratch"), ("--from and --from-scratch",)),
    (("ascii-render", "orca", "--episode", "-1"), ("--episode",)),
    (("ascii-render", "orca", "--environment", "9"), ("there is no environment '9'",)),
    (("train",), ("train",)),
    (("rl", "--resume", "nowhere"), ("nowhere does not exist", "none yet, sfmrl il makes one")),
    (("il", "--continue"), ("--continue needs the folder to continue", "--run")),
    (("il", "--overwrite"), ("--overwrite needs the folder to replace", "--run")),
    (("eval", "orca", "--humans", "201"), ("--humans is 201; it must be at most 200",)),
    (("eval", "orca", "--reward", "mine.py:mine"), ("there is no file mine.py", "path")),
    (("eval", "orca", "--reward", "mine.py:fire"), ("reward mine.py:fire: there is no file",)),  # not an emoji
    (("explain", "orca", "--steps", "x"), ("--steps is 'x'", "as in 10:20")),
    (("explain", "orca", "--every", "0"), ("--every",)),
    (("explain", "orca", "--csv", "."), (". is not a regular file", "name a file")),
    (("verify",), ("run", "--help")),
    (("verify", "nowhere"), ("nowhere does not exist",)),
    (("verify", ".", "--tolerance", "2"), ("--tolerance is 2.0; it must be at most 1",)),
    (("figure", "1", "--preset", "papre"), ("choose paper, quick",)),
    (("doctor", "--hlp"), ("--help",)),
    (("rl", "--reward", "sfmm"), ("did you mean sfm?",)),  # before the missing imitation run is an error
    (("rl", "--environment", "7"), ("there is no environment '7'",)),
    (("rl", "--tme-step", "1"), ("--tme-step", "--time-step")),
    (("il", "--threads", "1"), ("No such option: --threads", "sfmrl il --help")),
    (("runs", "nowhere"), ("there is no folder nowhere",)),
]


@pytest.mark.parametrize(("words", "said"), WRONG_USE, ids=[" ".join(words) for words, _ in WRONG_USE])
def test_wrong_use_is_one_line_that_says_how_to_go_on(in_process: Call, tmp_path: Path, words, said):
    assert_one_line_error(in_process(*words), *said)
    assert list(tmp_path.iterdir()) == []  # nothing is left behind


class Begun(Exception):
    """A command has taken its options and begins to work."""


def numbers(command: Callable) -> list[str]:
    """The options of a command that take a number, by its own declaration."""
    kinds = {name: parameter.annotation for name, parameter in inspect.signature(command).parameters.items()}
    found = [name for name, kind in kinds.items() if {int, float} & {kind, *get_args(kind)} and name != "number"]
    return [f"--{name.replace('_', '-')}" for name in found]


NUMBERS = {command.name: numbers(command.callback) for command in app.registered_commands}
NEEDED = {"compare": ["orca", "linear"], "verify": ["nowhere"], "table": ["1"], "figure": ["1"]}
NO_NUMBER = ("nan", "inf", "-inf", "1e308", str(2**63), "9" * 4000, "9" * 5000, "", "x")


@pytest.mark.parametrize("command", ["eval linear", "compare linear sfm", "explain linear"])
def test_a_full_disk_does_not_cost_the_result(in_process, monkeypatch, command):
    def fail(path, text):
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    monkeypatch.setattr("sfmrl.cli.console.write_text", fail)
    few = [] if command.startswith("explain") else ["--episodes", "1"]
    done = in_process(*command.split(), "--environment", "circle5", "--csv", "some.csv", *few)
    assert done.returncode == 1
    assert "reward" in done.stdout
    assert "sfmrl: some.csv: No space left on device" in done.stderr


@pytest.mark.parametrize("name", [name for name, options in NUMBERS.items() if options])
def test_no_option_takes_what_is_no_number_or_far_too_large(in_process: Call, monkeypatch, name):
    def begin(*_: object, **__: object) -> None:
        raise Begun

    monkeypatch.setattr(cli, "app", typer.main.get_command(app))  # built once
    for function in ("train.TrainingOptions.new_config", "session.TestOptions.choose_all", "study._train"):
        monkeypatch.setattr(f"sfmrl.cli.{function}", begin)
    for option in NUMBERS[name]:
        for value in NO_NUMBER:
            done = in_process(name, *NEEDED.get(name, []), option, value)
            assert_one_line_error(done, option.removeprefix("--"))
            assert len(done.stderr) < 2000
        with suppress(Begun):  # some may be below 0
            assert_one_line_error(in_process(name, *NEEDED.get(name, []), option, "-1"), option.removeprefix("--"))


def test_every_command_s_numbers_are_found():
    assert {"--episodes", "--seed", "--threads", "--time-limit", "--max-neighbors", "--k"} <= set(NUMBERS["eval"])
    assert {"--speed", "--frames", "--at", "--episode"} <= set(NUMBERS["ascii-render"])
    assert {"--memory", "--learning-rate", "--test-episodes", "--discount"} <= set(NUMBERS["rl"])
    assert NUMBERS["verify"] == ["--episodes", "--tolerance", "--threads"]


@pytest.mark.parametrize(
    "words",
    [
        ("il", *TINY_IL, "--environment", "9"),
        ("il", *TINY_IL, "--reward", "smf"),
        ("rl", "--from-scratch", *TINY_RL, "--environment", "9"),
        ("rl", "--from-scratch", *TINY_RL, "--test-environment", "9"),
        ("rl", "--from-scratch", *TINY_RL, "--reward", "missing.py:mine"),
    ],
    ids=" ".join,
)
def test_a_training_that_cannot_begin_leaves_no_run_folder(in_process: Call, tmp_path: Path, words):
    done = in_process(*words)
    assert done.returncode == 2, done.stderr
    assert not (tmp_path / "runs").exists()


def test_demonstrations_that_all_time_out_are_an_error_that_says_so(sfmrl: Call):
    done = sfmrl("il", *TINY_IL, "--time-limit", "2")
    assert done.returncode in (1, 2)
    assert "Traceback" not in done.stderr
    assert "time" in done.stderr.splitlines()[-1]


def test_a_failure_of_the_system_is_exit_code_1(sfmrl: Call, tmp_path: Path):
    (tmp_path / "file").write_text("")
    done = sfmrl("il", *TINY_IL, "--run", "file/run")
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1
    assert "file/run" in done.stderr


def test_a_damaged_run_is_one_line_too(sfmrl: Call, tmp_path: Path):
    assert sfmrl("il", *TINY_IL, "--run", "il").returncode == 0
    for name in ("weights.npz", "config.json"):
        path = tmp_path / "il" / name
        path.write_bytes(path.read_bytes()[:1000])
        assert_one_line_error(sfmrl("eval", "il"), f"il/{name} is damaged")


def test_what_to_type_next_can_be_typed(sfmrl: Call, tmp_path: Path):
    """It names the run just made, whatever its name, and what its demonstrations were made under."""
    done = sfmrl("il", *TINY_IL, "--run", "my run", "--seed", "2", "--time-limit", "14", "--no-robot-visible")
    reinforce, test = re.findall(r"sfmrl (.*?)(?=, or|$)", done.stderr.splitlines()[-1])
    done = sfmrl(*shlex.split(reinforce), *TINY_RL, "--threads", "1", "--run", "it's")
    assert done.returncode == 0, done.stderr
    assert "from imitation run my run" in done.stderr
    for words in (test, *re.findall(r"sfmrl (.*?)(?=, |$)", done.stderr.splitlines()[-1])):
        assert shlex.split(words)[1] == ("my run" if words is test else "it's")


def test_what_to_type_says_to_trust_the_reward_of_a_run_that_needs_it(in_process: Call, tmp_path: Path):
    (tmp_path / "mine.py").write_text("def mine(transition, settings):\n    return 0 * transition.time\n")
    for reward, trust in (("sfm", ""), ("mine.py:mine", " --trust-reward")):
        name = Path(f"runs/my {reward[:3]}")
        run = create_run("rl", Config(reward=Reward(reward=reward)), name)
        assert on_run("eval", run) == f"sfmrl eval '{name}'{trust}"
        assert why_unfinished(name).endswith(f"sfmrl rl --resume '{name}'{trust}")
        assert f"with --resume '{name}'{trust}" in in_process("rl", "--from-scratch", "--run", str(name)).stderr


def test_results_go_to_standard_output_and_what_to_do_next_to_standard_error(sfmrl: Call, tmp_path: Path):
    (tmp_path / "my reward.py").write_text("def none(transition, settings):\n    return 0 * transition.time\n")
    reward = ("--reward", "my reward.py:none")
    done = sfmrl("eval", "orca", "--environment", "2", "--episodes", "6", *reward, "--no-robot-visible")
    assert done.returncode == 0
    assert re.search(r"all\s+│\s+0\.\d{3}", done.stdout)
    line = done.stderr.splitlines()[-1]
    assert "failed; see one: sfmrl ascii-render orca --environment 2 --seed 0 --episode" in line
    shown = sfmrl(*shlex.split(line.partition("see one: sfmrl ")[2]), "--frames", "1")
    assert shown.returncode == 0, shown.stderr
    assert shown.stdout.strip()


def test_a_training_that_repeats_imitation_has_the_same_bits_on_one_thread_and_on_two(sfmrl: Call, tmp_path: Path):
    assert sfmrl("il", *TINY_IL).returncode == 0
    longer = [*TINY_RL, "--episodes", "8", "--reward", "sfm", "--forces"]
    for threads in (1, 2):
        done = sfmrl("rl", *longer, "--threads", threads, "--run", f"run{threads}")
        assert done.returncode == 0, done.stderr
        assert "learning from its demonstrations again" in done.stderr  # from states without forces
    one, two = (load_weights(tmp_path / f"run{threads}" / "weights.npz")[0] for threads in (1, 2))
    assert np.array_equal(one.flat, two.flat)
    replay = sfmrl("ascii-render", "run2", "--frames", "2")
    assert replay.returncode == 0, replay.stderr


def test_recovery_on_the_maps_by_name_and_an_unsolvable_one_is_called_so(sfmrl: Call):
    done = sfmrl("eval", "orca", "--recover", "--environment", "maps", "--episodes", "20")
    assert done.returncode == 0, done.stderr
    assert "with recovery (stuck in" in done.stdout
    assert "narrow-corridor" in done.stdout
    assert "…" not in done.stdout
    closed = sfmrl("eval", "orca", "--recover", "--environment", "map-closed", "--episodes", "2")
    assert "unsolvable, since the squares leave no path to the goal: episodes 0, 1" in closed.stderr
    assert "--recover" in closed.stderr


def test_another_crowd_is_said_and_is_the_same_one_in_every_command(sfmrl: Call):
    crowd = ("--humans", "12", "--human-speed", "1.5")
    done = sfmrl("eval", "linear", "--environment", "2", "--episodes", "3", *crowd)
    assert done.returncode == 0, done.stderr
    assert "12 humans on a circle of 4.8 m, humans at 1.5 m/s" in re.sub(r"\s+", " ", done.stdout)
    see = done.stderr.splitlines()[-1].partition("see one: sfmrl ")[2]
    assert see.endswith(" ".join(crowd))
    shown = sfmrl(*shlex.split(see), "--at", "0")
    assert shown.returncode == 0, shown.stderr
    assert " c" in shown.stdout  # the twelfth, after 9 of them a and b
    found = json.loads(
        sfmrl("compare", "linear", "orca", "--environment", "2", "--episodes", "3", *crowd, "--json").stdout
    )
    assert (found["humans"], found["human_speed"]) == (12, 1.5)


def test_random_attributes_are_part_of_a_training_and_of_its_tests(sfmrl: Call, tmp_path: Path):
    mix = ("--environment", "circle5:0.5,square5:0.5")
    il = sfmrl("il", *TINY_IL, *mix, "--random-attributes")
    assert il.returncode == 0, il.stderr
    assert " --random-attributes" in il.stderr.splitlines()[-1]  # what to type next
    assert_one_line_error(sfmrl("rl", *TINY_RL, *mix, "--from", "runs/il-sarl-seed0"), "another simulation")
    training = ("rl", *TINY_RL, *mix, "--random-attributes", "--run", "rl")
    rl = sfmrl(*training, "--episodes", "8", "--threads", "1")
    assert rl.returncode == 0, rl.stderr
    for run in ("runs/il-sarl-seed0", "rl"):
        assert sfmrl("verify", run, "--episodes", "4").returncode == 0
    tested = json.loads((tmp_path / "rl" / "result.json").read_text())
    found = json.loads(sfmrl("eval", "rl", "--episodes", "4", "--no-recover", "--json").stdout)
    assert found["total_reward"] == tested["total_reward"]  # among people as in training, without another word
    plain = json.loads(
        sfmrl("eval", "rl", "--episodes", "4", "--no-random-attributes", "--no-recover", "--json").stdout
    )
    assert plain["total_reward"] != tested["total_reward"]


def test_every_command_plays_the_same_people_with_random_attributes(sfmrl: Call):
    where = ("--environment", "square5", "--random-attributes")
    done = sfmrl("eval", "linear", *where, "--episodes", "20")
    assert done.returncode == 0, done.stderr
    see = done.stderr.splitlines()[-1].partition("see one: sfmrl ")[2]
    assert "--environment square5" in see
    assert see.endswith("--random-attributes")
    replay = sfmrl(*shlex.split(see), "--frames", "1")
    assert replay.returncode == 0, replay.stderr
    assert "collision" in replay.stdout.lower()
    compared = sfmrl("compare", "linear", "orca", *where, "--episodes", "20", "--json")
    shown = json.loads(sfmrl("eval", "linear", *where, "--episodes", "20", "--json").stdout)
    assert json.loads(compared.stdout)["policies"][0]["success"] == shown["success"]
    drawings = [sfmrl("ascii-render", "--scenes", *where[:stop]).stdout for stop in (2, 3)]
    assert drawings[0] != drawings[1]
    assert "cross a square" in sfmrl("ascii-render", "--scenes", "--environment", "square").stdout
    assert_one_line_error(sfmrl("eval", "orca", *where, "--human-speed", "1.5"), "exclude each other")


def test_the_reader_of_a_pipe_may_leave_early():
    words = [sys.executable, "-m", "sfmrl", "ascii-render", "orca", "--frames", "90"]
    process = subprocess.Popen(words, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout.readline()
    process.stdout.close()
    assert process.stderr.read() == ""
    assert process.wait() == 0


def test_scenes_are_drawn_without_playing(sfmrl: Call):
    done = sfmrl("ascii-render", "--scenes", "--ascii")
    assert done.returncode == 0, done.stderr
    assert done.stdout.isascii()
    assert all(f"environment {name}" in done.stdout for name in "12345")


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_help_answers_without_numpy_or_torch(command, tmp_path: Path):
    done = importing(tmp_path, *command.split(), "--help")
    assert done.stderr.strip() == "[]"
    assert "Usage" in done.stdout
    if command:
        assert "default" in done.stdout or command == "doctor"  # which takes no options
        assert "Example: sfmrl" in done.stdout


def importing(folder: Path, *words: str) -> subprocess.CompletedProcess:
    """Call the command; the last line of its standard error lists which of NumPy and torch it has imported."""
    code = (
        "import sys\n"
        "from sfmrl.cli import main\n"
        f"sys.argv = ['sfmrl', *{words!r}]\n"
        "try: main()\n"
        "finally: print(sorted({'numpy', 'torch'} & set(sys.modules)), file=sys.stderr)"
    )
    call = [sys.executable, "-c", code]
    done = subprocess.run(call, env=environment(), cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done


def help_lines(in_process: Call, monkeypatch, *words: str) -> list[str]:
    """A help in 80 columns."""
    monkeypatch.setenv("COLUMNS", "80")
    done = in_process(*words)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout.splitlines()


WITH_SETTINGS = [name for name, command in COMMANDS.items() if "--help-all" in str([p.opts for p in command.params])]


@pytest.mark.parametrize("words", [["--help"], *([name, "--help"] for name in COMMANDS)], ids=" ".join)
def test_help_fits_into_80_columns(words, in_process: Call, monkeypatch):
    lines = help_lines(in_process, monkeypatch, *words)
    if words[0] in WITH_SETTINGS:
        lines += help_lines(in_process, monkeypatch, words[0], "--help-all")
    assert max(map(len, lines)) <= 80
    assert not [line for line in lines if "…" in line]  # an option's name cut off
    prose = [line.rstrip() for line in lines[3 : next(n for n, line in enumerate(lines) if line.startswith("╭"))]]
    short = [
        (line, after) for line, after in pairwise(prose) if line and after and len(line) + len(after.split()[0]) < 78
    ]
    assert not short  # lines that end where the docstring's did


@pytest.mark.parametrize("name", WITH_SETTINGS)
def test_help_shows_the_common_options_at_a_glance_and_help_all_every_one(name, in_process: Call, monkeypatch):
    short, whole = (help_lines(in_process, monkeypatch, name, flag) for flag in ("--help", "--help-all"))
    options = [line for line in short if line.startswith("│")]
    assert len(options) <= 40
    shown = re.findall(r"^│ +(--\S+)", "\n".join(short), re.MULTILINE)
    assert {"--reward", "--environment", "--seed", "--[no-]recover", "--overwrite"} <= set(shown)
    last = f"sfmrl {name} --help-all shows all {len(COMMANDS[name].params)} options, by section."
    assert " ".join("".join(short).split()).endswith(last)
    every = {option.opts[0] for option in COMMANDS[name].params if option.opts[0].startswith("--")}
    listed = re.findall(r"^│ +(--\S+)", "\n".join(whole), re.MULTILINE)
    assert {flag.replace("[no-]", "") for flag in listed} == every | {"--help"}
    assert any("─ Simulation ─" in line for line in whole)


def test_help_shows_the_config_s_own_defaults(in_process: Call):
    text = re.sub(r"[\s│]+", " ", in_process("rl", "--help-all").stdout)
    paper, quick = (make_config(preset).reinforcement for preset in ("paper", "quick"))
    for words in (
        f"training episodes (paper {paper.episodes}, quick {quick.episodes})",
        f"learning rate (paper {paper.learning_rate:g}, quick {quick.learning_rate:g})",
        f"episodes between validations (default {paper.validation_interval})",
        "what drives the humans (orca | sfm) (default orca)",
    ):
        assert words in text
    text = re.sub(r"[\s│]+", " ", in_process("eval", "--help-all").stdout)
    assert "what drives the humans (orca | sfm) (default the policy's, else orca)" in text


@pytest.mark.parametrize("words", [["--help"], ["eval", "linear", "--environment", "5", "--episodes", "2", "--json"]])
def test_the_launcher_works_from_a_checkout_without_installing(tmp_path, words):
    plain = {name: value for name, value in environment().items() if name != "PYTHONPATH"}
    command = [sys.executable, str(ROOT / "sfmrl.py"), *words]
    done = subprocess.run(command, env=plain, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "Teach a robot" in done.stdout or json.loads(done.stdout)["episodes"] == 2


def lay_runs(folder: Path, *runs: tuple[str, str, bool]) -> None:
    """Run folders as far as `sfmrl` alone looks at them: (name, kind, finished), the last the newest."""
    for number, (name, kind, finished) in enumerate(runs):
        run = folder / "runs" / name
        run.mkdir(parents=True)
        (run / "run.json").write_text(json.dumps({"kind": kind, "created": f"2026-01-0{number + 1}"}))
        (run / "config.json").write_text(json.dumps({"preset": "paper", "seed": 3} if "paper" in name else {}))
        if finished:
            (run / "weights.npz").touch()


STANDS = {
    "no runs": ((), ["sfmrl il && sfmrl rl --reward sfm", "sfmrl ascii-render sarl-sfm6"]),
    "trained": ([("a", "il", True), ("b", "rl", True)], ["sfmrl eval runs/b", "sfmrl ascii-render runs/b"]),
    "stopped": ([("a", "il", True), ("b c", "rl", False)], ["sfmrl rl --resume 'runs/b c'", "sfmrl eval runs/a"]),
    "stopped at once": ([("a", "il", False)], ["sfmrl il --resume runs/a", "sfmrl ascii-render sarl-sfm6"]),
    "stopped before": ([("a", "rl", False), ("b c", "rl", True)], ["sfmrl eval 'runs/b c'"]),
}


@pytest.mark.parametrize("stand", STANDS)
def test_sfmrl_alone_says_what_to_type_next(in_process: Call, tmp_path: Path, stand):
    runs, said = STANDS[stand]
    lay_runs(tmp_path, *runs)
    done = in_process()
    assert (done.returncode, done.stderr) == (0, "")
    assert all(words in done.stdout for words in said), done.stdout
    assert len(done.stdout.splitlines()) <= 8
    assert max(map(len, done.stdout.splitlines())) <= 80
    for line in re.findall(r"(?:^  |: )(sfmrl .*?)(?:  |$)", done.stdout, re.MULTILINE):
        for words in (shlex.split(part)[1:] for part in line.split("&&")):  # what it says can be typed
            if words[0] != "--help":
                known = {flag for parameter in COMMANDS[words[0]].params for flag in parameter.opts}
                assert {word for word in words if word.startswith("--")} <= known


def test_sfmrl_alone_says_what_is_being_trained_now(in_process: Call, tmp_path: Path):
    lay_runs(tmp_path, ("a", "il", True), ("b", "rl", False))
    with locked(tmp_path / "runs" / "b"):
        said = in_process().stdout
        assert completion.unfinished_runs() == []
    assert "runs/b is being trained now" in said
    assert "--resume" not in said
    assert "sfmrl ascii-render runs/a" in said
    assert completion.unfinished_runs() == ["runs/b"]


def test_runs_that_cannot_be_read_do_not_keep_sfmrl_from_greeting(in_process: Call, tmp_path: Path):
    lay_runs(tmp_path, ("a", "il", True), ("b", "rl", True))
    (tmp_path / "runs" / "b" / "run.json").write_bytes(b"\xff")
    (tmp_path / "runs" / "a" / "config.json").write_text("null")
    assert "sfmrl eval runs/a" in in_process().stdout


@pytest.mark.parametrize("words", [[], ["--version"]])
def test_greeting_and_version_need_neither_numpy_nor_torch(tmp_path: Path, words):
    done = importing(tmp_path, *words)
    assert done.stderr == "[]\n"
    assert done.stdout.startswith(f"sfmrl {__version__}")


@pytest.mark.parametrize(
    "words",
    ["eval sarl --episodes 1", "ascii-render sarl --frames 1", "compare sarl orca --episodes 1", "explain sarl-sfm6"],
)
def test_networks_are_played_and_explained_without_torch(tmp_path: Path, words):
    assert importing(tmp_path, *words.split()).stderr.splitlines()[-1] == "['numpy']"


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_an_example_that_can_be_typed(name):
    line = COMMANDS[name].epilog.removeprefix("Example: ")
    program, command, *words = shlex.split(line)
    assert (program, command) == ("sfmrl", name)
    context = COMMANDS[name].make_context(f"sfmrl {name}", words)  # parsed as it would be, but not run
    assert context.params or name == "doctor"  # which takes none


def completed(in_process: Call, monkeypatch, *words: str) -> set[str]:
    """What the shell is offered for the last of the words."""
    monkeypatch.setattr(sys.modules["__main__"], "__package__", "")  # the command is called sfmrl, not pytest
    monkeypatch.setenv("_SFMRL_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", " ".join(("sfmrl", *words)))
    monkeypatch.setenv("COMP_CWORD", str(len(words)))
    return set(in_process().stdout.split())


def test_the_shell_completes_commands_names_and_runs(in_process: Call, monkeypatch, tmp_path: Path):
    lay_runs(tmp_path, ("a", "il", True), ("b", "rl", True), ("c", "rl", False))
    for words, offered in (
        (("",), set(COMMANDS)),
        (("il", "--variant", "sarl-"), {name for name in VARIANTS if name.startswith("sarl-")}),
        (("il", "--preset", ""), set(PRESETS)),
        (("rl", "--test-environment", "t"), {"table1", "table2"}),
        (("rl", "--reward", "sfm"), {name for name in REWARDS if name.startswith("sfm")}),
        (("eval", "orca", "--environment", ""), {*ENVIRONMENTS, *MIXES}),
        (("eval", "orca", "--crowd", ""), {"orca", "sfm"}),
        (("eval", ""), {*POLICIES, *model_names(), "runs/a", "runs/b"}),
        (("eval", "runs/"), {"runs/a", "runs/b"}),
        (("rl", "--from", ""), {"runs/a", *model_names()}),
        (("rl", "--resume", ""), {"runs/c"}),
        (("verify", ""), {"runs/a", "runs/b", "runs/c"}),
    ):
        assert completed(in_process, monkeypatch, *words) == offered, words


def test_too_little_memory_is_one_line_with_what_helps(in_process: Call, monkeypatch):
    monkeypatch.setattr("sfmrl.episodes.memory_size", lambda: 1e6)
    done = in_process("eval", "orca", "--episodes", "20", "--time-limit", "1000")
    assert (done.returncode, done.stdout) == (1, "")
    assert len(done.stderr.splitlines()) == 1
    assert "out of memory" in done.stderr
    assert "--time-limit" in done.stderr
    assert "20 episodes of up to 3997 steps" in done.stderr


def listed_runs(done: subprocess.CompletedProcess) -> dict[str, list[str]]:
    """What `sfmrl runs` prints of each run, by folder."""
    assert (done.returncode, done.stderr) == (0, "")
    assert max(map(len, done.stdout.splitlines())) <= 80
    heads, *rows = (line.split() for line in done.stdout.splitlines())
    assert heads == ["folder", "kind", "variant", "seed", "state", "success"]
    return {row[0]: row[1:] for row in rows}


def test_runs_are_listed_a_line_each_with_state_and_success(in_process: Call, monkeypatch, tmp_path: Path):
    monkeypatch.setenv("COLUMNS", "80")
    for name in ("il", "stopped", "running", "done", "cut", "gone", "lost"):
        create_run("il" if name == "il" else "rl", make_config(variant="sarl-sfm2", seed=7), Path("runs", name))
    for name in ("il", "done"):
        Path("runs", name, "weights.npz").touch()
    Path("runs/done/result.json").write_text(json.dumps({"success": 0.5, "with_recovery": {"success": 0.75}}))
    Path("runs/cut/run.json").write_text('{"kind": "rl", ')
    Path("runs/gone/config.json").unlink()
    Path("runs/lost/result.json").write_text("[]")
    Path("runs/nothing").mkdir()
    with locked(tmp_path / "runs" / "running"):
        found = listed_runs(in_process("runs"))
    assert found == {
        "runs/il": ["il", "sarl-sfm2", "7", "done", "-"],
        "runs/stopped": ["rl", "sarl-sfm2", "7", "stopped", "-"],
        "runs/running": ["rl", "sarl-sfm2", "7", "running", "-"],
        "runs/done": ["rl", "sarl-sfm2", "7", "done", "0.750"],
        "runs/cut": ["-", "-", "-", "damaged", "-"],
        "runs/gone": ["rl", "sarl-sfm2", "-", "damaged", "-"],
        "runs/lost": ["rl", "sarl-sfm2", "-", "damaged", "-"],
    }
    assert list(found) == ["runs/cut", "runs/lost", "runs/gone", "runs/done", "runs/running", "runs/stopped", "runs/il"]


def test_runs_of_a_folder_are_listed_and_of_none_it_is_said(in_process: Call, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert "no run in runs; sfmrl il makes one" in in_process("runs").stderr
    create_run("il", Config(), Path("mine", "z" * 70))
    long = in_process("runs", "mine").stdout
    assert max(map(len, long.splitlines())) <= 80
    assert long.count("z") == 70  # it is not cut off


@pytest.mark.parametrize("columns", [40, 80])
def test_no_cell_of_a_table_is_cut_in_a_narrow_terminal(in_process: Call, monkeypatch, capsys, columns):
    monkeypatch.setattr("sfmrl.cli.console.out", Console(width=columns))
    mix = ("--environment", "map-narrow-corridor:0.5,map-u:0.5", "--episodes", "4")
    for words in (("eval", "linear", *mix, "--social"), ("models",), ("explain", "linear", "--environment", "5")):
        done = in_process(*words)
        assert (done.returncode, "…" in done.stdout) == (0, False)
        assert words[0] != "eval" or "map-narrow-corridor" in done.stdout
    cells = {"policy": "sarl"} | {f"number {k}": "-.123 (-.456 to -.012)" for k in range(9)}
    print_sheet(Sheet("Nine", [cells]))
    assert capsys.readouterr().out.splitlines()[3].split() == " ".join(cells.values()).split()


def test_letters_that_the_output_lacks_are_replaced(tmp_path: Path):
    create_run("il", Config(), tmp_path / "runs" / "größe")
    plain = environment() | {"PYTHONIOENCODING": "ascii"}
    command = [sys.executable, "-m", "sfmrl", "runs"]
    done = subprocess.run(command, cwd=tmp_path, env=plain, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert "runs/gr??e" in done.stdout


def config_of(in_process: Call, monkeypatch, *words: str) -> Config:
    """The config that a training would begin with."""
    taken = []

    def begin(run, work):
        taken.append(run.config)
        raise Begun

    monkeypatch.setattr("sfmrl.cli.train._train", begin)
    with pytest.raises(Begun):
        in_process(*words)
    return taken[0]


def test_a_config_file_gives_the_settings_and_options_override_it(in_process: Call, monkeypatch):
    begun = make_config("paper", "sarl-sfm4", seed=5, discount=0.8, simulation={"time_limit": 20.0})
    Path("config.json").write_text(begun.to_json())
    training = ("rl", "--from-scratch", "--config", "config.json")
    assert config_of(in_process, monkeypatch, *training) == begun
    il = config_of(in_process, monkeypatch, "il", "--config", "config.json", "--epochs", "3", "--time-limit", "15")
    assert il == override(begun, {"imitation": {"epochs": 3}, "simulation": {"time_limit": 15.0}})
    # A variant and a preset override all that variants and presets decide, and nothing else.
    kept = {"seed": 5, "discount": 0.8, "simulation": {"time_limit": 20.0}}
    assert config_of(in_process, monkeypatch, *training, "--variant", "sarl") == make_config("paper", "sarl", **kept)
    quick = config_of(in_process, monkeypatch, *training, "--preset", "quick", "--seed", "6")
    assert quick == make_config("quick", "sarl-sfm4", **kept | {"seed": 6})


def test_a_config_file_that_cannot_be_used_is_one_line(in_process: Call):
    Path("mine.py").write_text("def mine(transition, settings):\n    return 0 * transition.time\n")
    for text, said in (("{", "it is not JSON"), ('{"sed": 1}', "did you mean seed?"), ('{"seed": -1}', "seed is -1")):
        Path("config.json").write_text(text)
        assert_one_line_error(in_process("il", "--config", "config.json"), "config.json cannot be used", said)
    assert_one_line_error(in_process("il", "--config", "none.json"), "there is no file none.json")
    assert_one_line_error(in_process("il", "--config", "."), "name a file")
    assert_one_line_error(in_process("il", "--resume", "x", "--config", "config.json"), "takes every setting")
    Path("config.json").write_text(json.dumps({"reward": {"reward": "mine.py:mine"}}))
    assert_one_line_error(in_process("il", "--config", "config.json"), "mine.py:mine", "--trust-reward")
    assert not Path("runs").exists()


def test_the_crowd_and_the_seed_that_are_asked_for_are_those_that_are_played(in_process):
    record = play(sample_scenes("1", 6, 4, people=12, people_speed=1.5), "linear")
    words = ("--environment", "1", "--episodes", "6", "--json", "--humans", "12", "--human-speed", "1.5", "--seed", "4")
    alone = json.loads(in_process("eval", "linear", *words).stdout)
    both = json.loads(in_process("compare", "linear", "orca", *words).stdout)["policies"][0]
    for found in (alone, both):
        assert found["success"] == (record.outcome == "success").mean()
        assert found["total_reward"] == record.discounted_return.mean()


def test_resuming_where_other_bits_are_computed_is_said(in_process, monkeypatch):
    create_run("il", make_config(), Path("run"))
    monkeypatch.setattr("sfmrl.runs.bits.machine_bits", lambda: "0123456789ab")
    monkeypatch.setattr("sfmrl.runs.training.run_imitation", lambda *_: None)
    assert "its numbers will not be those of an uninterrupted run" in in_process("il", "--resume", "run").stderr


def test_how_a_crowdnav_file_was_trained_otherwise_is_said(in_process, tmp_path):
    torch.save(ValueNetwork().state_dict(), tmp_path / "rl_model.pth")
    (tmp_path / "env.config").write_text("[robot]\nvisible = false\n")
    done = in_process("eval", "rl_model.pth", "--environment", "circle0", "--episodes", "1")
    assert "--no-robot-visible plays it so" in done.stderr


def test_a_setting_that_changes_nothing_is_refused_by_the_policy_that_judges(in_process):
    words = ("sarl-sfm2", "orca", "--k", "0.003", "--environment", "circle0", "--episodes", "1")
    assert in_process("compare", *words).returncode == 0  # the first one's reward reads k
    assert_one_line_error(in_process("compare", "orca", "sarl-sfm2", *words[2:]), "--k changes nothing")
    recovery = ("--stall-time", "2", *words[4:])
    assert in_process("compare", "orca", "sarl-sfm2", *recovery).returncode == 0  # the second has recovery
    assert_one_line_error(in_process("compare", "orca", "linear", *recovery), "--stall-time changes nothing")


def test_what_is_trained_further_on_another_task_is_told(in_process):
    words = ("--episodes", "1", "--validation-episodes", "1", "--test-episodes", "1", "--run")
    said = in_process("rl", "--from", "sarl-sfm2-unicycle", *words, "one").stderr
    changed = "trained with --reward sfm --kinematics unicycle; this training has --reward crowd --kinematics holonomic"
    assert changed in said
    same = in_process("rl", "--variant", "sarl-sfm2", "--from", "sarl-sfm2", *words, "two").stderr
    assert "this training has" not in same


def test_what_il_says_to_type_next_has_its_own_variant(in_process):
    said = in_process("il", *TINY_IL, "--variant", "sarl-sfm6", "--run", "six").stderr
    assert "next: sfmrl rl --variant sarl-sfm6 --from six" in said
    assert_one_line_error(in_process("rl", "--crowd", "sfm"), "type sfmrl il --preset quick --seed 0 --crowd sfm")
    solid = in_process("rl", "--preset", "paper", "--squares", "solid")  # paper's own are discs
    assert_one_line_error(solid, "type sfmrl il --preset paper --seed 0 --squares solid")


def test_a_run_is_replaced_only_if_the_new_one_can_start(in_process, tmp_path):
    for words in (("il", *TINY_IL, "--run", "il"), ("rl", "--from", "il", *TINY_RL, "--run", "rl")):
        assert in_process(*words).returncode == 0
    (tmp_path / "bad.py").write_text("def reward(transition, settings):\n    return [1.0]\n")
    before = {path: path.read_bytes() for path in (tmp_path / "rl").iterdir()}
    again = ("rl", *TINY_RL, "--run", "rl", "--overwrite")
    assert_one_line_error(in_process(*again, "--from", "rl/best.npz"), "--run rl would replace rl/best.npz, from which")
    assert_one_line_error(in_process(*again, "--from-scratch", "--reward", "bad.py:reward"), "shape (1,)")
    over_il = ("rl", *TINY_RL, "--run", "runs/il", "--overwrite")
    assert in_process("il", *TINY_IL, "--run", "runs/il").returncode == 0
    assert_one_line_error(in_process(*over_il), "--run runs/il would replace runs/il, from which")  # the newest
    (tmp_path / "il" / "demonstrations.npz").unlink()
    assert_one_line_error(in_process(*again, "--from", "il"), "il/demonstrations.npz")
    assert {path: path.read_bytes() for path in (tmp_path / "rl").iterdir()} == before
    (tmp_path / "il" / "test.csv").write_text("mine")
    assert in_process("il", *TINY_IL, "--run", "il", "--overwrite").returncode == 0
    assert (tmp_path / "il" / "test.csv").read_text() == "mine"


def test_a_result_names_the_settings_that_it_was_measured_with(in_process: Call):
    words = ["eval", "linear", "--episodes", "2", "--environment", "circle5", "--crowd", "sfm", "--no-robot-visible"]
    title = " ".join(line.strip() for line in in_process(*words).stdout.splitlines()[:2])
    assert title.startswith("linear, environment circle5, 2 episodes, seed 0, --crowd sfm --no-robot-visible")
    told = json.loads(in_process(*words, "--json").stdout)
    assert told["reward"] == "crowd"
    assert told["settings"] == {"simulation": {"crowd": "sfm", "robot_visible": False}}
    plain = json.loads(in_process(*words[:6], "--json").stdout)
    assert plain["settings"] == {}


def test_completion_is_that_of_sfmrl_however_it_is_called(in_process: Call, monkeypatch):
    monkeypatch.setenv("SHELL", "/bin/bash")
    assert "complete -o default -F _sfmrl_completion sfmrl" in in_process("--show-completion").stdout
