"""The Gymnasium environments: the libraries' own checks, the simulator's numbers to the bit, an agent that learns."""

import subprocess
import sys
import warnings
from collections import defaultdict

import gymnasium
import numpy as np
import pytest
from conftest import environment
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.wrappers import FlattenObservation, RecordEpisodeStatistics
from gymnasium.wrappers.vector import RecordEpisodeStatistics as RecordVectorStatistics
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env as check_sb3
from stable_baselines3.common.vec_env import VecMonitor

import sfmrl
from sfmrl.config import ConfigError
from sfmrl.envs import CrowdEnv, CrowdVectorEnv, as_sb3, observe, robot_velocity
from sfmrl.envs.pictures import GOAL, PERSON, ROBOT
from sfmrl.replay.frames import Replay
from sfmrl.replay.story import make_story

NAME = "sfmrl.envs:sfmrl/Crowd-v0"
SOME_ABSENT = "2:0.5,circle5:0.5"  # ten elements or five
FORWARD = np.array([1.0, 0.0], dtype=np.float32)


def scripted(observation: dict[str, np.ndarray]) -> np.ndarray:
    """Actions (..., 2): forward, and to the right of what is near; float32, as agents' are."""
    nearest = observation["elements"][..., 0, :]
    near = np.exp(-nearest[..., 5])
    return np.stack((0.95 - near * (nearest[..., 0] > 0), -2 * near), axis=-1).astype(np.float32)


@pytest.mark.parametrize(
    "arguments",
    [
        {},
        {"forces": True, "actions": "discrete", "environment": SOME_ABSENT},
        {"environment": "circle0", "crowd": "sfm"},
        {"kinematics": "unicycle"},
        {"kinematics": "unicycle", "actions": "discrete"},
    ],
)
def test_both_libraries_checks_pass_without_a_warning(arguments):
    env = gymnasium.make(NAME, **arguments).unwrapped
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env)
        check_sb3(FlattenObservation(env))
        # A network for sets reads rows; SB3's own flattens them, as it says in its advice.
        warnings.filterwarnings("ignore", "Your observation elements has an unconventional shape")
        check_sb3(env, skip_render_check=False)


@pytest.mark.parametrize(
    "how",
    [
        {"reward": "sfm"},
        {"reward": "crowd", "crowd": "sfm", "robot_visible": False},
        {"reward": "sfm", "kinematics": "unicycle"},
    ],
)
def test_alone_side_by_side_and_in_play_the_rewards_are_the_same_bits(how):
    scene, numbers = {"environment": "table1", "phase": "test"}, range(12)
    scenes = sfmrl.sample_scenes(episodes=numbers, **scene)
    played = sfmrl.play(scenes, lambda world, _: robot_velocity(world, scripted(observe(world))), **how)
    expected = [(played.reward[e, : played.steps[e]].tolist(), played.outcome[e]) for e in numbers]
    assert len({outcome for _, outcome in expected}) > 1

    env, alone = gymnasium.make(NAME, **scene, **how), []
    for number in numbers:
        observation, info = env.reset(options=None if number else {"episode": 0})
        assert info["episode_number"] == number
        assert info["environment"] == scenes.environment[number]
        rewards, over = [], False
        while not over:
            observation, reward, ended, late, info = env.step(scripted(observation))
            rewards.append(reward)
            over = ended or late
        alone.append((rewards, info["outcome"]))
        assert info["is_success"] == (info["outcome"] == "success")
        assert info["time"] == played.time[number]
        assert info["separation"] == played.transition.separation[number, len(rewards) - 1]
    assert alone == expected

    envs = gymnasium.make_vec(NAME, num_envs=5, vectorization_mode="vector_entry_point", **scene, **how)
    rewards, outcomes = defaultdict(list), {}
    observation, info = envs.reset(options={"episode": 0})
    while not outcomes.keys() >= {*numbers}:
        playing = info["episode_number"]
        observation, reward, ended, late, info = envs.step(scripted(observation))
        for number, paid in zip(playing, reward, strict=True):
            rewards[number].append(paid)
        for e in np.flatnonzero(ended | late):
            outcomes[playing[e]] = info["final_info"]["outcome"][e]
    assert [(rewards[number], outcomes[number]) for number in numbers] == expected


@pytest.mark.parametrize("forces", [False, True])
def test_observations_are_the_columns_of_the_states_nearest_first(forces):
    scenes = sfmrl.sample_scenes(SOME_ABSENT, range(6), phase="validation")
    envs = CrowdVectorEnv(6, environment=SOME_ABSENT, phase="validation", forces=forces)
    observation, _ = envs.reset(options={"episode": 0})
    for _ in range(3):
        world = envs.crowd.world
        elements = slice(1, None)
        states = sfmrl.robot_states(
            *(part[:, 0] for part in (world.position, world.velocity, scenes.goal, scenes.radius, scenes.v_pref)),
            *(part[:, elements] for part in (world.position, world.velocity, scenes.radius)),
            forces=forces,
        )
        for e, (state, present) in enumerate(zip(states, ~np.isnan(scenes.start[:, elements, 0]), strict=True)):
            own = observation["robot"].shape[1]
            near = state[present][state[present][:, own + 5].argsort(kind="stable"), own:]
            assert (observation["robot"][e] == state[0, :own]).all()
            assert (observation["elements"][e, : len(near)] == near).all()
            assert not observation["elements"][e, len(near) :].any()
            assert (observation["mask"][e] == (np.arange(10) < len(near))).all()
        observation, *_ = envs.step(np.tile(FORWARD, (6, 1)))
    assert {*observation["mask"].sum(1)} == {5, 10}


def test_actions_are_shares_of_the_preferred_speed_in_the_direction_of_the_goal():
    world = sfmrl.reset(sfmrl.Scenes(start=[[[0, 0]]] * 4, goal=[[[3, 4]]] * 4, v_pref=2.0))
    velocity = robot_velocity(world, np.array([[1.0, 0.0], [0.0, 0.5], [-3.0, 0.0], [1.0, 1.0]]))
    diagonal = np.sqrt(2.0) * np.array([0.6 - 0.8, 0.8 + 0.6])
    np.testing.assert_allclose(velocity, [[1.2, 1.6], [-0.8, 0.6], [-1.2, -1.6], diagonal])
    np.testing.assert_allclose(
        robot_velocity(world, np.array([0, 5, 25, 45])), [[0, 0], [1.2, 1.6], [-1.6, 1.2], [-1.2, -1.6]]
    )


def test_a_time_out_is_truncated_and_its_last_observation_is_there():
    env, envs = gymnasium.make(NAME, environment="5"), CrowdVectorEnv(2, environment="5")
    env.reset(options={"episode": 0})
    envs.reset(options={"episode": 0})
    for step in range(1, 98):
        observation, _, ended, late, info = env.step(np.zeros(2, np.float32))
        after, _, all_ended, all_late, infos = envs.step(np.zeros((2, 2), np.float32))
        assert (ended, late) == (False, step == 97)
        assert all_ended.tolist() == [False] * 2
        assert all_late.tolist() == [step == 97] * 2
    assert info["outcome"] == "timeout"
    assert info["time"] == 24.25
    assert infos["final_info"]["outcome"].tolist() == ["timeout"] * 2
    assert infos["outcome"].tolist() == ["running"] * 2
    assert all((infos["final_obs"][0][name] == part).all() for name, part in observation.items())
    assert not all((after[name][0] == part).all() for name, part in observation.items())
    assert infos["episode_number"].tolist() == [2, 3]


def test_seeds_reproduce_and_choose_the_scenes():
    def run(seed: int | None) -> list[tuple]:
        first = env.reset(seed=seed)
        return [first, env.step(FORWARD), env.reset(), env.reset()]

    env, numbers = gymnasium.make(NAME), set()
    for seed in (0, 1):
        once, again = run(seed), run(seed)
        assert all(data_equivalence(a, b, exact=True) for a, b in zip(once, again, strict=True))
        start, *_, last = (moment[-1]["episode_number"] for moment in once)
        assert last == start + 2  # one after the other
        numbers.add(start)
    assert len(numbers) == 2


def test_a_phase_has_the_scenes_that_play_has():
    for phase in ("train", "test"):
        env = CrowdEnv(environment="3", phase=phase)
        env.reset(options={"episode": 17})
        scene = sfmrl.sample_scenes("3", [17], phase=phase)
        assert (env.crowd.world.position == scene.start).all()
        assert (env.crowd.world.goal == scene.goal).all()


def test_text_is_the_frame_that_the_replay_shows_at_that_time():
    scene, reward = sfmrl.sample_scenes("2", [1], phase="test"), sfmrl.Reward("crowd")
    env = CrowdEnv("ansi", environment="2", phase="test", reward=reward)
    env.reset(options={"episode": 1})
    assert "at the start" in env.render()
    assert "T 25 s" in env.render()
    record = sfmrl.play(scene, lambda world, _: robot_velocity(world, np.array([FORWARD])), reward=reward)
    replay = Replay((make_story(record, None, reward, 0.9),), ("",))
    for step in range(1, 1 + record.steps[0]):
        env.step(FORWARD)
        shown, frame = env.render().split("\n"), replay.frame(step).plain.split("\n")
        assert [line[46:] for line in shown[:-2]] == [line[46:] for line in frame[:-2]]  # the panel
    assert shown == frame


def test_an_image_shows_everybody_in_place():
    env = CrowdEnv("rgb_array", environment="circle5")
    env.reset(options={"episode": 0})
    image, world = env.render(), env.crowd.world
    assert image.shape == (400, 400, 3)
    assert image.dtype == np.uint8
    half = np.abs(world.goal).max() + 1.5

    def pixel(point: np.ndarray) -> tuple[int, ...]:
        return tuple(image[round((1 - point[1] / half) * 199.5), round((1 + point[0] / half) * 199.5)])

    assert pixel(world.position[0, 0]) == ROBOT
    assert pixel(world.goal[0, 0]) == GOAL
    assert all(pixel(person) == PERSON for person in world.position[0, 1:6])


def test_a_reward_of_ones_own_is_paid_and_drawn():
    env = CrowdEnv("ansi", reward=lambda transition, settings: -transition.goal_distance)
    env.reset(seed=0)
    _, reward, *_ = env.step(FORWARD)
    assert -8 < reward < -7
    assert env.render().count(f"{reward:.4f}") == 2  # of the step, and so far


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"environment": "9"}, "there is no environment '9'"),
        ({"phase": "val"}, "there is no phase 'val'; choose train, validation"),
        ({"actions": "discreet"}, "actions is 'discreet'; choose continuous, discrete; did you mean discrete"),
        ({"render_mode": "human"}, "render_mode is 'human'; choose ansi, rgb_array or None"),
        ({"reward": "sfmm"}, "there is no reward 'sfmm'"),
        ({"forces": 1}, "forces is 1; it takes true or false"),
    ],
)
def test_bad_arguments_are_named(arguments, words):
    with pytest.raises(ConfigError, match=words):
        CrowdEnv(**arguments)


def test_actions_that_cannot_be_taken_are_named():
    envs = CrowdVectorEnv(2)
    with pytest.raises(RuntimeError, match="call reset first"):
        envs.step(np.zeros((2, 2)))
    envs.reset(seed=0)
    with pytest.raises(ValueError, match="an action is NaN"):
        envs.step(np.full((2, 2), np.nan))
    with pytest.raises(ValueError, match=r"shape \(1, 2\) .*; the environment takes .*, shape \(2, 2\)"):
        envs.step(np.zeros((1, 2)))


@pytest.mark.parametrize(
    ("kind", "bad", "good"),
    [
        ("continuous", [5, True, [0.0], [[0.0, 0.0]], "left", [np.nan, 0.0]], [[1, 0], FORWARD]),
        ("discrete", [81, -1, 2.0, True, [0.5, 0.5], [5], "left"], [5, np.int64(80), np.array(0), np.uint8(3)]),
    ],
)
def test_an_environment_takes_its_own_kind_of_action_alone(kind, bad, good):
    env, envs = CrowdEnv(actions=kind), CrowdVectorEnv(2, actions=kind)
    for action in bad:
        env.reset(seed=0)
        envs.reset(seed=0)
        for step in (lambda a: env.step(a), lambda a: envs.step([a, a])):
            with pytest.raises(ValueError, match=r"^(the actions have .*; the environment takes|an action is .*;) .*$"):
                step(action)
    for action in good:
        env.step(action)
        envs.step(np.array([action, action]))
    takes = r"numbers from -1 to 1, shape \(2, 2\)" if kind == "continuous" else r"indices from 0 to 80, shape \(2,\)"
    with pytest.raises(ValueError, match=takes):
        envs.step([3, 4] if kind == "continuous" else [0.1, 0.2])


def test_indices_are_those_of_the_81_actions():
    world = sfmrl.reset(sfmrl.sample_scenes("circle5", 2))
    for actions in ([0, -1], [0, 81], [0.1, 0.2]):
        with pytest.raises(ValueError, match="an action is not an index; it must be a whole number from 0 to 80"):
            robot_velocity(world, np.array(actions))


@pytest.mark.parametrize(("missing", "use"), [("gymnasium", ""), ("stable_baselines3", "sfmrl.envs.as_sb3(None)")])
def test_without_the_extra_one_line_says_what_to_install(missing, use):
    tried = f"try:\n import sfmrl.envs\n {use}\nexcept ImportError as error: print(error)"
    code = f"import sys\nsys.modules['{missing}'] = None\n{tried}"
    done = subprocess.run([sys.executable, "-c", code], env=environment(), capture_output=True, text=True, check=True)
    assert f"pip install {missing.replace('_', '-')}" in done.stdout
    assert done.stdout.count("\n") == 1


def test_gymnasiums_wrappers_count_the_same_returns_alone_and_side_by_side():
    env = RecordEpisodeStatistics(gymnasium.make(NAME, environment="2"))
    env.reset(options={"episode": 0})
    over = False
    while not over:
        *_, ended, late, alone = env.step(FORWARD)
        over = ended or late
    envs = RecordVectorStatistics(CrowdVectorEnv(1, environment="2"))
    envs.reset(options={"episode": 0})
    for _ in range(alone["episode"]["l"]):
        *_, infos = envs.step(FORWARD[None])
    assert infos["episode"]["r"][0] == alone["episode"]["r"]


def test_stable_baselines3_learns_and_its_agent_is_a_policy(tmp_path):
    envs = gymnasium.make_vec(NAME, num_envs=8, environment="circle5", render_mode="rgb_array")
    venv = VecMonitor(as_sb3(envs))
    model = PPO("MultiInputPolicy", venv, n_steps=64, batch_size=256, n_epochs=2, seed=0, device="cpu")
    before = [part.detach().clone() for part in model.policy.parameters()]
    model.learn(512)
    assert any((a != b).any() for a, b in zip(before, model.policy.parameters(), strict=True))
    assert len(model.ep_info_buffer) == len(model.ep_success_buffer) > 0
    assert venv.render().shape == (1200, 1200, 3)

    def agent(world: sfmrl.World, crowd_velocity: np.ndarray) -> np.ndarray:
        return robot_velocity(world, model.predict(observe(world), deterministic=True)[0])

    assert sfmrl.evaluate(agent, environment="circle5", episodes=2)["episodes"] == 2


def test_stable_baselines3_is_given_how_episodes_ended():
    venv = as_sb3(CrowdVectorEnv(3, environment="5", actions="discrete"))
    venv.seed(0)
    first = venv.reset()
    start = venv.reset_infos[0]["episode_number"]
    venv.set_options({"episode": start})
    assert data_equivalence(first, venv.reset(), exact=True)
    for _ in range(97):
        observation, reward, over, infos = venv.step(np.zeros(3, dtype=int))
    assert over.all()
    assert reward.shape == (3,)
    assert all(info["TimeLimit.truncated"] and not info["is_success"] for info in infos)
    assert [info["episode_number"] for info in infos] == [start, start + 1, start + 2]
    assert [info["episode_number"] for info in venv.reset_infos] == [start + 3, start + 4, start + 5]
    assert (infos[0]["terminal_observation"]["elements"] != observation["elements"][0]).any()


def test_a_saved_agent_of_stable_baselines_plays_by_the_name_of_its_file(tmp_path, sfmrl):
    envs = gymnasium.make_vec("sfmrl.envs:sfmrl/Crowd-v0", num_envs=4)
    PPO("MultiInputPolicy", as_sb3(envs), n_steps=4, batch_size=16, seed=0).save(tmp_path / "ppo.zip")
    (tmp_path / "ppo.py").write_text(
        "from stable_baselines3 import PPO\n"
        "from sfmrl.envs import observe, robot_velocity\n\n\n"
        "def make():\n"
        '    model = PPO.load("ppo.zip", device="cpu")\n'
        "    return lambda world, _: robot_velocity(world, model.predict(observe(world), deterministic=True)[0])\n"
    )
    done = sfmrl("eval", "ppo.py:make()", "--episodes", 3, "--json")
    assert done.returncode == 0, done.stderr


def test_a_unicycle_drives_and_turns_as_it_is_told_and_on_the_spot():
    env = gymnasium.make(NAME, environment="circle0", kinematics="unicycle").unwrapped
    env.reset(options={"episode": 0})
    heading, position = float(env.crowd.world.heading[0]), env.crowd.world.position[0, 0].copy()
    env.step(np.array([-1.0, 1.0], dtype=np.float32))
    assert env.crowd.world.heading[0] == pytest.approx(heading + np.pi / 4)
    np.testing.assert_allclose(env.crowd.world.position[0, 0], position, atol=1e-8)
    observation, *_ = env.step(np.array([0.0, -0.5], dtype=np.float32))
    assert observation["robot"][2] == pytest.approx(np.pi / 8, abs=0.02)  # theta: heading less the angle to the goal
    assert np.hypot(*env.crowd.world.velocity[0, 0]) == pytest.approx(0.5)


def test_rendering_before_reset_and_other_environments_for_sb3_are_refused():
    env, envs = gymnasium.make(NAME, render_mode="ansi"), gymnasium.make_vec(NAME, num_envs=2, render_mode="rgb_array")
    for not_begun in (env.unwrapped, envs.unwrapped):
        with pytest.raises(RuntimeError, match="render was called before reset"):
            not_begun.render()
    with pytest.raises(TypeError, match="as_sb3 takes gymnasium"):
        as_sb3(env)
