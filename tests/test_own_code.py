"""Users' functions cannot change the simulator, their slips are one line, and no file's reward is run unasked."""

import subprocess
import sys
from collections.abc import Callable
from dataclasses import FrozenInstanceError, fields
from pathlib import Path

import numpy as np
import pytest
import torch

from sfmrl.cli import main
from sfmrl.config import Config, ConfigError, Planner, Reward, Simulation, Untrusted
from sfmrl.episodes import Record, play, play_episodes
from sfmrl.evaluation import evaluate
from sfmrl.imitation import fill_memory
from sfmrl.network import ValueNetwork
from sfmrl.own_code import UntrustedReward
from sfmrl.own_code.trust import code_digest, trusted
from sfmrl.policies import load_policy
from sfmrl.recovery import with_recovery
from sfmrl.rewards import Transition, reward_terms
from sfmrl.runs import training
from sfmrl.runs.create import create_run
from sfmrl.runs.files import read_sums
from sfmrl.runs.folders import DEMONSTRATIONS, finished
from sfmrl.runs.progress import StopSignal, no_progress
from sfmrl.runs.training import run_imitation, run_reinforcement
from sfmrl.runs.weights import load_weights, save_weights
from sfmrl.scenes import Scenes, sample_scenes
from sfmrl.variants import make_config

SCENES = sample_scenes("circle5", 3)

OWN = """\
import sys
import numpy as np
open("it-was-run", "a").close()


def calm(transition, settings):
    return -0.01 * np.linalg.norm(transition.velocity, axis=-1)

def forges(transition, settings):
    transition.outcome[...] = 1
    return calm(transition, settings)

def raises_the_prize(transition, settings):
    settings.success = 9.0

def goes_round(transition, settings):
    for array in (transition.outcome, transition.outcome.base):
        if array is not None:
            array.flags.writeable = True
            array[...] = 1
    return calm(transition, settings)

def stops(transition, settings):
    sys.exit("enough")

def forgets(transition, settings):
    calm(transition, settings)

def widens(transition, settings):
    return transition.separations

def breaks(transition, settings):
    return np.full(transition.time.shape, np.nan)

def takes_one(transition):
    return transition.time

def asks(transition, settings):
    return 1.0 if transition.outcome == 1 else 0.0

def errs(transition, settings):
    return calm(transition, settings) * transition.speed
"""


@pytest.fixture
def own(tmp_path: Path, monkeypatch) -> Path:
    """A file with rewards, in the current folder; whoever runs it leaves the file `it-was-run`."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.py").write_text(OWN)
    return tmp_path / "own.py"


def line_of(text: str) -> int:
    return OWN[: OWN.index(text)].count("\n") + 1


def was_run(own: Path) -> bool:
    """Whether the file has been run since this was asked last."""
    mark = own.with_name("it-was-run")
    there = mark.exists()
    mark.unlink(missing_ok=True)
    return there


@pytest.mark.parametrize(
    ("function", "line", "said"),
    [
        ("forges", "transition.outcome[...]", "ValueError: assignment destination is read-only; .*work on a copy"),
        ("raises_the_prize", "settings.success =", "FrozenInstanceError: .*work on a copy"),
        ("stops", 'sys.exit("enough")', "SystemExit: enough$"),
        ("errs", "return calm(transition, settings) *", "AttributeError: .*speed"),
        ("asks", "return 1.0 if", "ValueError: The truth value .*; its arguments are whole arrays: use numpy.where"),
        ("forgets", "def forgets", r"returned None; it must return .* shape \(3,\), one number per transition"),
        ("widens", "def widens", r"returned an array of shape \(3, 5\); it must return an array of shape \(3,\)"),
        ("breaks", "def breaks", "returned NaN or infinity; it must return finite numbers"),
    ],
)
def test_a_reward_s_slip_is_one_line_with_its_file_and_line_and_what_to_change(own, function, line, said):
    with pytest.raises(ConfigError, match=rf"^reward own.py:{function} \(line {line_of(line)}\) .*{said}") as caught:
        play(SCENES, "linear", reward=f"own.py:{function}")
    assert "\n" not in str(caught.value)


def test_a_reward_of_one_argument_is_an_error_that_names_both(own):
    with pytest.raises(ConfigError, match=r"takes_one.*; define it with the arguments \(transition, settings\)$"):
        play(SCENES, "linear", reward="own.py:takes_one")


def assert_same_episodes(one: Record, other: Record) -> None:
    np.testing.assert_array_equal(one.position, other.position)
    for item in fields(Transition):
        np.testing.assert_array_equal(getattr(one.transition, item.name), getattr(other.transition, item.name))


def test_a_reward_that_goes_round_its_limits_forges_nothing_all_the_same(own):
    honest, forger = (play(SCENES, "linear", reward=f"own.py:{name}") for name in ("calm", "goes_round"))
    assert_same_episodes(honest, forger)


def test_a_reward_may_be_a_function_with_the_numbers_of_the_same_one_in_a_file(own):
    def calm(transition, settings):
        return -0.01 * np.hypot(*np.moveaxis(transition.velocity, -1, 0)) + 0 * settings.success

    record = play(SCENES, "orca", reward=calm)
    np.testing.assert_allclose(record.reward, play(SCENES, "orca", reward="own.py:calm").reward, rtol=1e-12)
    assert evaluate("orca", environment="circle5", episodes=3, reward=calm)["total_reward"] == pytest.approx(
        record.discounted_return.mean()
    )
    with pytest.raises(ConfigError, match="reward is 5; it takes a name, a Reward, or a function"):
        play(SCENES, "orca", reward=5)


def test_a_policy_that_goes_round_its_limits_forges_nothing_all_the_same():
    def goes_round(world, moves):
        for array in (world.position, world.position.base):
            if array is not None:
                array.flags.writeable = True
                array[:, 0] = world.goal[:, 0]
        return np.zeros((len(world), 2))

    assert (play(SCENES, goes_round).outcome == "timeout").all()


def straight(world, moves):
    return world.preferred_velocity[:, 0]


def test_a_policy_may_return_lists_and_whole_numbers():
    expected = play(SCENES, straight)
    assert_same_episodes(play(SCENES, lambda world, moves: straight(world, moves).tolist()), expected)
    standing = play(SCENES, lambda world, moves: [[0, 0]] * len(world))
    assert (standing.position[:, :, 0] == SCENES.start[:, None, 0]).all()


def test_an_own_reward_judges_a_single_step_too():
    step = play(SCENES, "linear").transition[0, 3]
    assert reward_terms(lambda transition, settings: -transition.goal_distance)(step) == {"reward": -step.goal_distance}


def pushes_people(world, moves):
    moves += 1.0


def sits_on_its_goal(world, moves):
    world.position[:, 0] = world.goal[:, 0]


def moves_its_goal(world, moves):
    world.goal = world.position


def removes_the_walls(world, moves):
    world.edges.values[:] = np.nan


class MovesTheStarts:
    def begin(self, scenes, simulation):
        scenes.start[:, 0] += 1.0

    def __call__(self, world, moves):
        return straight(world, moves)


@pytest.mark.parametrize(
    ("policy", "said"),
    [
        (lambda world, moves: None, "returned None; it must return an array of shape (3, 2), a velocity (x, y) in m/s"),
        (lambda world, moves: 1.0, "returned 1.0; it must"),
        (lambda world, moves: torch.zeros(3, 2, requires_grad=True), "returned a Tensor; it must"),
        (lambda world, moves: "east", "returned 'east'; it must"),
        (lambda world, moves: (yield), "returned a generator; it must"),
        (lambda world, moves: np.zeros(2), "returned an array of shape (2,); it must return an array of shape (3, 2)"),
        (lambda world, moves: moves, "returned an array of shape (3, 6, 2); it must"),
        (lambda world, moves: [[0, 1], [0, 1], [1]], "returned a list; it must"),
        (lambda world, moves: np.full((3, 2), np.inf), "returned NaN or infinity; it must return finite numbers"),
        (
            lambda world, moves: np.full((3, 2), 1.0),
            "of 1.414 m/s; it must return none above v_pref, 1 m/s",
        ),
        ("no-policy", "there is no policy no-policy"),
        (5, "policy is 5; it takes a name, or a function of (world, crowd_velocity)"),
    ],
)
def test_a_policy_s_slip_is_one_error_that_says_what_it_must_return(policy, said):
    with pytest.raises(ConfigError) as caught:
        play(SCENES, policy)
    assert said in str(caught.value)


def test_a_policy_with_recovery_must_return_the_same():
    with pytest.raises(ConfigError, match=r"returned an array of shape \(2,\); it must return .* shape \(3, 2\)"):
        play(SCENES, with_recovery(lambda world, moves: np.zeros(2), Planner(recover=True)))
    east = with_recovery(lambda world, moves: "east", Planner(recover=True))
    with pytest.raises(ConfigError, match=r"returned 'east'; it must return an array of shape \(3, 2\)"):
        play_episodes(SCENES, east, "sfm", Simulation(), keep=True)


@pytest.mark.parametrize(
    "policy", [pushes_people, sits_on_its_goal, moves_its_goal, removes_the_walls, MovesTheStarts()]
)
def test_a_policy_cannot_change_the_world(policy):
    with pytest.raises((ValueError, FrozenInstanceError), match=r"read-only|cannot assign to field"):
        play(SCENES, policy)


def test_scenes_by_name_are_an_error_that_says_how_to_make_them():
    with pytest.raises(ConfigError, match=r"scenes is 'circle5'; it takes .* such as sample_scenes\('circle5', 100\)"):
        play("circle5", "orca")


def test_an_error_of_a_policy_s_own_stays_what_it_is():
    with pytest.raises(ZeroDivisionError):
        play(SCENES, lambda world, moves: 1 / 0)
    with pytest.raises(TypeError, match="takes 1 positional argument but 2 were given"):
        play(SCENES, lambda world: world.velocity[:, 0])


def test_a_robot_that_must_not_move_may_stand():
    assert play(Scenes([[[0, 0], [3, 0]]], [[[0, 4], [3, 1]]], v_pref=[[0, 1]]), "orca").outcome == "timeout"


@pytest.fixture
def handed(own: Path) -> Path:
    """A weights file whose config names a reward in a Python file."""
    save_weights(ValueNetwork(), Config(reward=Reward(reward=f"{own}:calm")), own.with_name("w.pt"))
    return own.with_name("w.pt")


def test_a_reward_that_a_file_names_is_run_only_if_the_user_names_or_trusts_it(own, handed):
    for call in (
        lambda: load_policy(handed),
        lambda: play(SCENES, handed),
        lambda: play(SCENES, handed, reward="own.py:errs"),
        lambda: evaluate(handed, environment="circle5", episodes=1),
        lambda: reward_terms(load_weights(handed)[1].reward),
        lambda: load_policy(handed, trust_reward=load_weights(handed)[1].reward.reward),  # a file's word again
    ):
        with pytest.raises(UntrustedReward, match=r"is not run; if you trust that code, add --trust-reward"):
            call()
        assert not was_run(own)
    assert load_policy(handed, trust_reward=True).config.reward == Reward(reward=f"{own}:calm")
    assert was_run(own)
    load_policy(handed, trust_reward="own.py:calm")
    play(SCENES.take([0]), handed, reward="own.py:calm")


def test_a_reward_whose_file_has_moved_is_trusted_by_its_digest(tmp_path):
    was, now = tmp_path / "was.py", tmp_path / "now.py"
    now.write_text("def same(transition, settings):\n    return 0.0 * transition.time\n")
    config, digest = Config.from_json(Config(reward=Reward(reward=f"{was}:same")).to_json()), code_digest(f"{now}:same")
    assert trusted(config, f"{now}:same", digest).reward.reward == f"{now}:same"
    assert isinstance(trusted(config, f"{now}:same").reward.reward, Untrusted)  # of a weights file alone
    assert isinstance(trusted(config, f"{now}:other", digest).reward.reward, Untrusted)
    with pytest.raises(ConfigError, match=r"now.py:same is not the reward that the network was trained with, .*was.py"):
        trusted(config, f"{now}:same", "another")
    was.write_text("")
    assert isinstance(trusted(config, f"{now}:same", digest).reward.reward, Untrusted)


def test_a_module_that_a_file_names_is_not_imported_and_sfmrl_s_own_rewards_need_no_trust():
    config = Config.from_json(Config(reward=Reward(reward="antigravity:calm")).to_json())
    with pytest.raises(UntrustedReward):
        reward_terms(config.reward)
    assert "antigravity" not in sys.modules
    config = Config.from_json(Config(reward=Reward(reward="sfm")).to_json())
    assert isinstance(config.reward.reward, Untrusted)
    assert "velocity" in reward_terms(config.reward)(play(SCENES, "linear").transition)
    assert config == Config(reward=Reward(reward="sfm")) == trusted(config, True)


@pytest.fixture
def command(capsys, monkeypatch) -> Callable[..., subprocess.CompletedProcess]:
    """Call `sfmrl` without a process of its own."""

    def call(*words: object) -> subprocess.CompletedProcess:
        monkeypatch.setattr(sys, "argv", ["sfmrl", *map(str, words)])
        with pytest.raises(SystemExit) as end:
            main()
        return subprocess.CompletedProcess(words, end.value.code, *capsys.readouterr())

    return call


@pytest.mark.parametrize("name", ["eval", "compare", "explain", "ascii-render"])
def test_a_command_runs_a_file_s_reward_only_if_it_names_or_trusts_it(own, handed, command, name):
    words = [name, handed, "--environment", "5", *(["orca"] if name == "compare" else [])]
    words += ["--at", "0"] if name == "ascii-render" else [] if name == "explain" else ["--episodes", "1"]
    done = command(*words, "--reward", "sfm")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert f"{own}:calm" in done.stderr
    assert "--trust-reward" in done.stderr
    assert not was_run(own)
    if name in ("eval", "explain"):
        words += ["--trust-reward"] if name == "eval" else ["--reward", "own.py:calm"]
        assert command(*words).returncode == 0
        assert was_run(own)


def test_a_run_with_a_reward_of_its_own_goes_on_only_if_that_is_trusted(own, command):
    """Named again with --continue or trusted with --resume; in both cases the file must be unchanged."""
    config = make_config(reward={"reward": f"{own}:calm"}, imitation={"episodes": 2, "epochs": 1})
    create_run("il", config, Path("run"))
    assert was_run(own)
    done = command("il", "--resume", "run")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "--trust-reward" in done.stderr
    assert not was_run(own)
    same = ("--reward", "own.py:calm", "--episodes", "2", "--epochs", "1")
    with own.open("a") as file:
        file.write("# another file\n")
    for words in (("il", "--resume", "run", "--trust-reward"), ("il", *same, "--run", "run", "--continue")):
        done = command(*words)
        assert done.returncode == 2
        assert "own.py:calm has changed since the run began" in done.stderr
    own.write_text(OWN)
    was_run(own)
    assert command("il", "--resume", "run", "--trust-reward").returncode == 0
    assert was_run(own)
    assert finished(Path("run"))


@pytest.mark.parametrize("threads", [1, 2])
def test_a_reward_that_changes_while_it_trains_ends_the_training(own, tmp_path, threads):
    schedule = {"episodes": 4, "parallel": 2, "batches": 1, "validation_interval": 2, "validation_episodes": 1}
    schedule |= {"test_episodes": 1, "environment": "circle5", "test_environment": "circle5"}
    config = make_config(reward={"reward": f"{own}:calm"}, reinforcement=schedule, simulation={"time_limit": 6.0})
    run = create_run("rl", config, tmp_path / "rl")

    def edit(said: str) -> None:
        if said.startswith("validation at episode 2"):
            own.write_text(own.read_text() + "# edited\n")

    with pytest.raises(ConfigError, match="has changed since the run began; put that file back and resume"):
        run_reinforcement(run, no_progress, StopSignal(), edit, threads=threads)
    assert not (run.folder / "test.csv").exists()


def test_a_reward_that_changes_before_the_second_fit_is_not_fitted_to(own, tmp_path, monkeypatch):
    tiny = {"imitation": {"episodes": 2, "epochs": 1, "environment": "circle5", "refit": True}}
    demonstrated = create_run("il", make_config(**tiny), tmp_path / "il")
    run_imitation(demonstrated, no_progress, StopSignal())
    config = make_config(reward={"reward": f"{own}:calm"}, **tiny)
    facts = {"demonstrations": read_sums(demonstrated.folder)[DEMONSTRATIONS]}
    run = create_run("rl", config, tmp_path / "rl", demonstrated.folder, **facts)

    def fill_and_edit(*arguments) -> None:
        fill_memory(*arguments)
        own.write_text(own.read_text() + "# edited\n")

    said: list[str] = []
    monkeypatch.setattr(training, "fill_memory", fill_and_edit)
    with pytest.raises(ConfigError, match="has changed since the run began"):
        run_reinforcement(run, no_progress, StopSignal(), said.append)
    assert said == []  # not "learning from its demonstrations again"
