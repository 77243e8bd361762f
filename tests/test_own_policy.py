"""Policies that users write, by the name of their file: played like the built-in ones, with errors in one line."""

import hashlib
import json

import numpy as np
import pytest
from conftest import assert_one_line_error

from sfmrl.config import ConfigError, Planner
from sfmrl.episodes import play
from sfmrl.own_code.trust import code_digest
from sfmrl.policies import load_policy
from sfmrl.recovery import with_recovery
from sfmrl.scenes import sample_scenes

SCENES = sample_scenes("table1", 6)
OWN = """\
import numpy as np


def straight(world, crowd_velocity):
    way = world.goal[:, 0] - world.position[:, 0]
    return way / np.hypot(way[:, :1], way[:, 1:]) * world.v_pref[:, :1]


class Counting:
    batch = 2

    def begin(self, scenes, simulation):
        self.worlds = []

    def __call__(self, world, crowd_velocity):
        self.worlds.append(len(world))
        return straight(world, crowd_velocity)


def make():
    return Counting()


def fails(world, crowd_velocity):
    return world.speed


def takes_one(world):
    return straight(world, None)


def one_for_all(world, crowd_velocity):
    return np.zeros(2)


def too_fast(world, crowd_velocity):
    return 2 * straight(world, crowd_velocity)


def overwrites(world, crowd_velocity):
    world.position[:] = 0


def makes_nothing():
    return None


number = 3


class Configured(Counting):
    config = {"hidden": 64}
"""


@pytest.fixture
def own(tmp_path):
    path = tmp_path / "own.py"
    path.write_text(OWN)
    return path


def test_it_plays_as_the_same_policy_inside_does(own):
    record, expected = play(SCENES, f"{own}:straight"), play(SCENES, "linear")
    np.testing.assert_array_equal(record.outcome, expected.outcome)
    np.testing.assert_allclose(record.position, expected.position)
    assert code_digest(f"{own}:straight") == hashlib.sha256(OWN.encode()).hexdigest()


def test_what_a_function_makes_keeps_its_batch_and_its_beginning(own):
    policy = load_policy(f"{own}:make()")
    play(SCENES, policy)
    assert max(policy.worlds) == 2
    np.testing.assert_array_equal(play(SCENES, policy).position, play(SCENES, f"{own}:straight").position)


def test_a_module_is_found_by_its_name(own, monkeypatch):
    monkeypatch.syspath_prepend(own.parent)
    np.testing.assert_array_equal(play(SCENES, "own:straight").position, play(SCENES, f"{own}:straight").position)


@pytest.mark.parametrize(
    ("name", "error"),
    [
        ("fails", r"own.py:fails \(line 25\) failed: AttributeError: 'World' object has no attribute 'speed'"),
        ("takes_one", r"own.py:takes_one failed: .*; define it with the arguments \(world, crowd_velocity\)"),
        ("one_for_all", r"own.py:one_for_all \(line 32\) returned an array of shape \(2,\); it must .* shape \(6, 2\)"),
        ("too_fast", r"own.py:too_fast returned a velocity of 2 m/s; it must return none above v_pref, 1 m/s"),
        ("overwrites", r"own.py:overwrites \(line 41\) failed: .* read-only: work on a copy"),
        ("makes_nothing()", r"own.py:makes_nothing\(\) returned None; it must return a policy"),
        ("strait", r"own.py has no function 'strait'; did you mean straight"),
        ("number", r"own.py has no function 'number'"),
    ],
)
def test_a_slip_is_one_line_with_its_place(own, name, error):
    with pytest.raises(ConfigError, match=error) as raised:
        play(SCENES, f"{own}:{name}")
    assert "\n" not in str(raised.value)
    assert str(raised.value).startswith("policy ")


def test_a_file_that_is_missing_or_broken_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"policy nowhere.py:f: there is no file nowhere.py"):
        load_policy("nowhere.py:f")
    (tmp_path / "broken.py").write_text("def f(:\n")
    with pytest.raises(ConfigError, match=r"broken.py:f \(line 1\) cannot be imported: SyntaxError"):
        load_policy(f"{tmp_path / 'broken.py'}:f")


def test_the_commands_play_it_and_name_the_file_that_they_ran(own, sfmrl):
    words = ("--environment", "circle5", "--episodes", 4, "--json")
    done = sfmrl("eval", f"{own}:straight", *words)
    assert done.returncode == 0, done.stderr
    mine, linear = json.loads(done.stdout), json.loads(sfmrl("eval", "linear", *words).stdout)
    assert mine.pop("sha256") == {f"{own}:straight": code_digest(f"{own}:straight")}
    assert mine.pop("policy") == f"{own}:straight"
    assert linear.pop("policy") == "linear"
    assert mine == linear
    compared = json.loads(sfmrl("compare", "linear", f"{own}:make()", *words).stdout)
    assert list(compared["sha256"]) == [f"{own}:make()"]
    configured = json.loads(sfmrl("eval", f"{own}:Configured()", *words).stdout)  # its config is not one of sfmrl's
    assert configured["success"] == linear["success"]
    for command in ("ascii-render", "explain"):
        shown = sfmrl(command, f"{own}:straight", "--environment", "circle5")
        assert shown.returncode == 0, shown.stderr
    wrong = sfmrl("eval", f"{own}:fails", *words)
    assert (wrong.returncode, wrong.stderr.count("\n")) == (2, 1)


def test_policies_are_written_in_a_line(own):
    assert repr(load_policy(f"{own}:straight")) == f"OwnPolicy({own}:straight)"
    alone = "SarlPolicy(reward sfm, state of 17 columns, with forces)"
    assert repr(load_policy("sarl-sfm6")) == f"RecoveringPolicy({alone})"
    assert repr(load_policy("sarl-sfm6").original) == alone


BROKEN = """\
import numpy as np


class Broken:
    batch = 4

    def __init__(self, what):
        self.what = what

    def begin(self, scenes, simulation):
        if self.what == "begin":
            1 / 0

    def explain(self, world, crowd_velocity):
        action = np.zeros((len(world), 2))
        if self.what == "explain":
            return action
        if self.what == "notes":
            return action, {"values": [0.5] * 3}
        if self.what == "shape":
            return action, {"own": np.zeros((len(world), 1 + world.steps.max()))}
        return action, {"values": np.full(len(world), 0.5)}

    def __call__(self, world, crowd_velocity):
        return np.zeros((len(world), 2))


class TakesOne(Broken):
    def begin(self, scenes):
        pass


def fails_to_begin():
    return Broken("begin")


def fails_to_explain():
    return Broken("explain")


def wrong_notes():
    return Broken("notes")


def other_notes_later():
    return Broken("shape")


def notes_of_its_own():
    return Broken("")


def takes_one():
    return TakesOne("")


def no_batch():
    made = Broken("")
    made.batch = 0
    return made


def network():
    from sfmrl import load_policy

    return load_policy("sarl").original


def fails_later():
    from sfmrl import SarlPolicy

    class Mine(SarlPolicy):
        def __call__(self, world, crowd_velocity):
            return 1 / 0

    policy = network()
    return Mine(policy.network, policy.config)
"""


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("fails_to_begin", "begin of policy FILE:fails_to_begin() (line 12) failed: ZeroDivisionError"),
        ("takes_one", "define it with the arguments (scenes, simulation)"),
        ("fails_to_explain", "must return (actions, notes), the notes a dict"),
        ("wrong_notes", "must return its notes as arrays with a row for each episode"),
        (
            "other_notes_later",
            "the policy's note 'own' is now (2,) of float64 per episode, and was (1,) of float64",
        ),
        ("no_batch", "batch is 0; it must be at least 1"),
    ],
)
def test_errors_in_the_rest_of_a_policy_are_one_line_too(in_process, tmp_path, name, said):
    (tmp_path / "broken.py").write_text(BROKEN)
    done = in_process("ascii-render", f"broken.py:{name}()", "--environment", "circle5", "--frames", "1")
    assert_one_line_error(done, said.replace("FILE", "broken.py"))


def test_a_policy_s_own_notes_are_no_network_s(in_process, tmp_path):
    (tmp_path / "broken.py").write_text(BROKEN)
    words = ("broken.py:notes_of_its_own()", "--environment", "circle5")
    for command in (("ascii-render", *words, "--frames", "1"), ("explain", *words)):
        assert in_process(*command).returncode == 0


def test_recovery_makes_a_network_of_a_user_s_look_farther_ahead_too(tmp_path):
    (tmp_path / "broken.py").write_text(BROKEN)
    policy = load_policy(f"{tmp_path}/broken.py:network()")
    assert with_recovery(policy, Planner(recover=True)).policy.trap_steps == load_policy("sarl").policy.trap_steps == 2
    assert policy.trap_steps == 1
    failing = with_recovery(load_policy(f"{tmp_path}/broken.py:fails_later()"), Planner(recover=True))
    with pytest.raises(ConfigError, match="ZeroDivisionError"):
        play(SCENES, failing)


def test_what_a_file_needs_must_be_in_it_or_installed(own):
    (own.parent / "beside.py").write_text("SPEED = 0.5")
    own.write_text("from beside import SPEED\n" + OWN)
    with pytest.raises(ConfigError, match="No module named 'beside'; a file cannot import the files beside it"):
        load_policy(f"{own}:straight")


def test_the_digest_of_a_module_is_its_file_s_and_no_package_is_run(own, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "package").mkdir()
    (tmp_path / "package" / "__init__.py").write_text("raise RuntimeError")
    (tmp_path / "package" / "inner.py").write_text("SPEED = 1")
    (tmp_path / "spaces" / "deep").mkdir(parents=True)
    (tmp_path / "spaces" / "deep" / "own.py").write_text("SPEED = 2")
    assert code_digest("own:straight") == hashlib.sha256(own.read_bytes()).hexdigest()
    assert code_digest("package.inner:SPEED") == hashlib.sha256(b"SPEED = 1").hexdigest()
    assert code_digest("spaces.deep.own:SPEED") == hashlib.sha256(b"SPEED = 2").hexdigest()
    assert code_digest("nowhere.inner:SPEED") is None
    assert code_digest("crowd") is None


def test_a_file_s_digest_does_not_depend_on_its_line_ends(own):
    before = code_digest(f"{own}:straight")
    own.write_bytes(own.read_bytes().replace(b"\n", b"\r\n"))
    assert code_digest(f"{own}:straight") == before
