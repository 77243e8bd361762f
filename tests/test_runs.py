"""Run folders: whole files, honest errors about damaged ones, and trainings that survive being killed, to the bit."""

import errno
import io
import json
import os
import shutil
import signal
import stat
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from conftest import environment

from sfmrl import __version__
from sfmrl.cli import greeting
from sfmrl.config import Config, ConfigError, override
from sfmrl.imitation import demonstrate
from sfmrl.maps import load_map
from sfmrl.policies import load_policy
from sfmrl.runs.create import create_run, start_run
from sfmrl.runs.demonstrations import load_demonstrations
from sfmrl.runs.files import (
    SUMS,
    DamagedFile,
    append_rows,
    read_arrays,
    read_checked,
    read_sums,
    retried,
    write_atomically,
    write_text,
)
from sfmrl.runs.folders import (
    DEMONSTRATIONS,
    LOCK,
    WEIGHTS,
    finished,
    in_training,
    locked,
    newest_run,
    run_folders,
    why_unfinished,
)
from sfmrl.runs.progress import Interrupted, StopSignal, no_progress
from sfmrl.runs.run import Run, open_run, sole_use
from sfmrl.runs.training import run_imitation, run_reinforcement
from sfmrl.runs.weights import load_weights
from sfmrl.variants import make_config

TINY = make_config(imitation={"episodes": 10, "epochs": 3}, simulation={"time_limit": 14.0})


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """A finished imitation run; tests that damage it work on a copy."""
    run = create_run("il", TINY, tmp_path_factory.mktemp("finished") / "run")
    run_imitation(run, no_progress, StopSignal())
    return run.folder


@pytest.fixture
def folder(whole, tmp_path) -> Path:
    return Path(shutil.copytree(whole, tmp_path / "run"))


@pytest.fixture
def interrupted(whole, tmp_path) -> Path:
    """The same run, stopped after each of its three epochs and not taken to its end."""
    run = create_run("il", TINY, tmp_path / "interrupted")
    write_atomically(run.folder / DEMONSTRATIONS, (whole / DEMONSTRATIONS).read_bytes())
    stop = StopSignal()
    stop.requested = True
    for _ in range(3):
        with pytest.raises(Interrupted):
            run_imitation(run, no_progress, stop)
    return run.folder


def flip_a_bit(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 16
    path.write_bytes(data)


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "No space left on device", "odd"), KeyboardInterrupt()])
@pytest.mark.parametrize("call", ["builtins.open", "os.fsync", "os.replace"])
def test_a_failed_write_leaves_the_old_file_and_names_no_temporary_one(tmp_path, monkeypatch, call, error):
    path = tmp_path / "numbers"
    write_atomically(path, b"one")

    def fail(*_, **__) -> None:
        raise error

    with monkeypatch.context() as patched:
        patched.setattr(call, fail)
        with pytest.raises(type(error)) as caught:
            write_atomically(path, b"two")
    if isinstance(error, OSError):
        assert Path(caught.value.filename).name in ("numbers", SUMS)
        assert caught.value.strerror == "No space left on device"
    assert read_checked(path) == b"one"
    assert {p.name for p in tmp_path.iterdir()} == {SUMS, "numbers"}


def test_a_replaced_file_keeps_its_mode_and_the_link_to_it(tmp_path):
    path, link = tmp_path / "rows.csv", tmp_path / "link.csv"
    path.write_text("old")
    path.chmod(0o600)
    link.symlink_to(path)
    write_text(link, "new")
    assert link.is_symlink()
    assert (path.read_text(), path.stat().st_mode & 0o777) == ("new", 0o600)
    (tmp_path / "run").mkdir()
    part = tmp_path / "run" / "weights"
    part.symlink_to(path)
    write_atomically(part, b"trained")
    assert (read_checked(part), path.read_text()) == (b"trained", "new")  # a run's digests are of its own files


def test_a_file_that_is_not_listed_is_not_trusted(tmp_path):
    (tmp_path / "numbers").write_bytes(b"one")
    with pytest.raises(DamagedFile, match=r"numbers has no SHA-256"):
        read_checked(tmp_path / "numbers")


@pytest.mark.skipif(shutil.which("sha256sum") is None, reason="needs the command sha256sum")
def test_sha256sum_can_check_a_finished_run_folder(folder):
    assert {"config.json", "run.json", "metrics.csv", DEMONSTRATIONS, WEIGHTS} == set(read_sums(folder))
    assert not list(folder.glob("checkpoint-*.npz"))  # nothing is left to continue from
    check = ["sha256sum", "--quiet", "-c", SUMS]
    assert subprocess.run(check, cwd=folder, check=False).returncode == 0
    flip_a_bit(folder / WEIGHTS)
    assert subprocess.run(check, cwd=folder, capture_output=True, check=False).returncode == 1


def test_a_finished_run_opens_with_its_config_and_facts(folder):
    run = open_run(folder, "il")
    assert finished(folder)
    assert run.config == TINY
    assert {"kind", "variant", "created", "command", "versions"} <= set(run.facts)
    assert (folder / "metrics.csv").read_text().splitlines()[0] == "epoch,loss"
    assert len((folder / "metrics.csv").read_text().splitlines()) == 4


def test_a_run_of_an_older_version_is_refused_with_that_version_s_number(folder):
    text = (folder / "run.json").read_text().replace(f'"sfmrl": "{__version__}"', '"sfmrl": "0.2.1"')
    write_atomically(folder / "run.json", text.encode())
    with pytest.raises(ConfigError, match=r"was made by sfmrl 0\.2\.1; install that version"):
        open_run(folder)


READERS = {
    "config.json": [open_run, load_policy],
    "run.json": [open_run, load_policy],
    SUMS: [open_run, load_policy],
    WEIGHTS: [load_policy, lambda folder: load_weights(folder / WEIGHTS)],
    DEMONSTRATIONS: [
        lambda folder: load_demonstrations(folder / DEMONSTRATIONS, TINY.simulation),
        lambda folder: run_imitation(open_run(folder), no_progress, StopSignal()),
    ],
}


@pytest.mark.parametrize("name", READERS)
def test_a_damaged_file_is_named_by_all_that_read_it(folder, name):
    if name == SUMS:
        (folder / SUMS).write_bytes(b"\xff\xfe\x00 not text")
    else:
        flip_a_bit(folder / name)
    for read in READERS[name]:
        with pytest.raises(DamagedFile, match=rf"{name} is damaged"):
            read(folder)


def test_demonstrations_are_read_as_they_were_played_also_from_a_file_of_sfmrl_0_1(folder):
    """What a transition has had since then follows from the trajectories, and the file is what it was."""
    with np.load(folder / DEMONSTRATIONS) as arrays:
        kept = {name.removeprefix("transition.") for name in arrays if name.startswith("transition.")}
    assert kept == {"time", "velocity", "preferred_velocity", "goal_distance", "separations", "outcome"}
    read, played = load_demonstrations(folder / DEMONSTRATIONS, TINY.simulation), demonstrate(TINY)
    for name, values in vars(played.transition).items():
        np.testing.assert_array_equal(getattr(read.transition, name), values, err_msg=name)
        assert getattr(read.transition, name).dtype == values.dtype


def test_demonstrations_for_which_there_is_no_memory_are_not_spread_out(folder, monkeypatch):
    monkeypatch.setattr("sfmrl.episodes.memory_size", lambda: 1000)
    with pytest.raises(DamagedFile, match=r"need 0\.0 GB"):
        load_demonstrations(folder / DEMONSTRATIONS, TINY.simulation)


def test_arrays_that_unpack_to_more_than_their_file_are_not_read():
    buffer = io.BytesIO()
    np.savez_compressed(buffer, config=np.zeros(1_000_000))
    with pytest.raises(ValueError, match="compressed"):
        read_arrays(buffer.getvalue())


def test_a_damaged_checkpoint_is_named_and_the_one_before_offered(interrupted):
    folder = interrupted
    older, newest = open_run(folder).checkpoints()  # of three epochs: the first one's is gone
    flip_a_bit(newest)
    with pytest.raises(DamagedFile, match=rf"{newest.name} is damaged.*delete it to resume from {older.name}"):
        open_run(folder).load_checkpoint()
    newest.unlink()
    assert open_run(folder).load_checkpoint()["fit"]["epoch"] == 2
    flip_a_bit(older)
    with pytest.raises(DamagedFile, match="delete it to start this run over"):
        open_run(folder).load_checkpoint()


ODD_JSON = ["", "[]", "{}", '{"kind": "il"}', '{"kind": [], "reward": {"reward": []}}', '{"a":' * 100_000]


@pytest.mark.parametrize("text", ODD_JSON, ids=[text[:12] for text in ODD_JSON])
@pytest.mark.parametrize("name", ["config.json", "run.json"])
def test_odd_json_is_one_error_that_names_the_file(folder, monkeypatch, name, text):
    write_atomically(folder / name, text.encode())
    if (name, text) != ("config.json", "{}"):  # that is the plain config
        with pytest.raises((DamagedFile, ConfigError), match=name) as error:
            open_run(folder)
        assert "\n" not in str(error.value)
    monkeypatch.chdir(folder.parent)
    (folder.parent / "runs").mkdir()
    folder.rename(folder.parent / "runs" / "odd")
    assert isinstance(greeting(), str)


PIPES = {
    "config.json": open_run,
    "run.json": open_run,
    SUMS: load_policy,
    WEIGHTS: load_policy,
    LOCK: lambda folder: locked(folder).__enter__(),
    "metrics.csv": lambda folder: append_rows(folder / "metrics.csv", [{"loss": 1}]),
}


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes with names")
@pytest.mark.parametrize("name", PIPES)
def test_a_pipe_in_a_run_folder_is_not_waited_for(folder, name):
    (folder / name).unlink(missing_ok=True)
    os.mkfifo(folder / name)
    assert not in_training(folder)
    with pytest.raises((DamagedFile, ConfigError), match=f"{name} is not a regular file|has no run.json"):
        PIPES[name](folder)


def test_a_hint_can_be_typed_whatever_the_run_is_called(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, typed in (("-run", "./-run"), ("my run", "'my run'")):
        create_run("il", override(TINY, {"reward": {"reward": "sfm"}}), Path(name))
        assert why_unfinished(Path(name)).endswith(f"sfmrl il --resume {typed}")


ODD_CHECKPOINTS = {
    "empty": {},
    "another network": {"network": {"weight": np.zeros((3, 3)), "bias": np.zeros(3)}},
    "of an imitation that has not begun": {"fit": {}, "rows": []},
    "no rows": {"fit": {}, "rows": 3},
}


@pytest.mark.parametrize("what", ODD_CHECKPOINTS)
def test_a_checkpoint_of_something_else_is_one_error(interrupted, whole, tmp_path, what):
    other = override(TINY, {"forces": True})  # so that the network is fitted again
    for run in (open_run(interrupted), start_run(other, whole, False, tmp_path / "rl")):
        run.save_checkpoint(ODD_CHECKPOINTS[what])
        work = run_imitation if run.kind == "il" else partial(run_reinforcement, say=lambda text: None)
        with pytest.raises(DamagedFile, match=r"checkpoint-\d+.npz is no checkpoint of this run"):
            work(run, no_progress, StopSignal())


SPOILT = {
    "a place": lambda arrays: arrays["position"].__setitem__((3, 0), np.nan),
    "a velocity": lambda arrays: arrays["velocity"].__setitem__((-1, 0, 1), np.inf),
    "a distance": lambda arrays: arrays["transition.goal_distance"].__setitem__(5, np.nan),
    "a gap": lambda arrays: arrays["transition.separations"].__setitem__((5, 0), np.nan),
    "too many steps": lambda arrays: arrays["steps"].__setitem__(0, 10**12),
    "as many steps less than none": lambda arrays: arrays["steps"].__setitem__(
        slice(2), (10**12, arrays["steps"][:2].sum() - 10**12)
    ),
    "the steps": lambda arrays: arrays.update(steps=np.zeros(0)),
    "an array too few": lambda arrays: arrays.pop("velocity"),
    "a pickle": lambda arrays: arrays.update(steps=np.array([{}, None])),
}


@pytest.mark.parametrize("what", SPOILT)
def test_demonstrations_that_are_not_finite_are_not_learnt_from(folder, what):
    path = folder / DEMONSTRATIONS
    arrays = dict(np.load(path))
    SPOILT[what](arrays)
    np.savez(path, **arrays)
    write_atomically(path, path.read_bytes())
    with pytest.raises(DamagedFile, match=f"{DEMONSTRATIONS} does not hold demonstrations"):
        load_demonstrations(path, TINY.simulation)


def test_a_training_that_diverges_stops_and_names_its_learning_rate(whole, tmp_path, monkeypatch):
    wild = {"optimizer": "sgd", "imitation": {"learning_rate": 100.0}}
    run = create_run("il", override(TINY, wild), tmp_path / "il")
    with pytest.raises(ConfigError, match="learning-rate 100 is likely too high for SGD"):
        run_imitation(run, no_progress, StopSignal())
    assert not finished(run.folder)
    assert all(np.isfinite(value).all() for value in run.load_checkpoint()["fit"]["network"].values())
    reinforcement = {"episodes": 20, "parallel": 5, "learning_rate": 1000.0}
    reinforcement |= {"validation_episodes": 1, "environment": "5", "test_environment": "5"}
    run = start_run(override(TINY, {"optimizer": "sgd", "reinforcement": reinforcement}), whole, False, tmp_path / "rl")
    monkeypatch.setattr("sfmrl.runs.training.CHECKPOINT_EVERY", 0.0)
    with pytest.raises(ConfigError, match="learning-rate 1000 is likely too high for SGD"):
        run_reinforcement(run, no_progress, StopSignal(), lambda text: None)
    assert not finished(run.folder)
    assert run.load_checkpoint() is None  # there was none yet


def test_a_run_goes_on_from_the_checkpoint_before_to_the_same_bits(interrupted, whole):
    run = open_run(interrupted)
    assert run.load_checkpoint()["fit"]["epoch"] == 3
    assert not finished(run.folder)
    run.checkpoints()[-1].unlink()
    run_imitation(run, no_progress, StopSignal())
    assert_same_results(run.folder, whole, [WEIGHTS, "metrics.csv"])


def test_demonstrations_that_are_stopped_leave_nothing(tmp_path):
    run, stop = create_run("il", TINY, tmp_path / "run"), StopSignal()
    stop.requested = True
    with pytest.raises(Interrupted):
        run_imitation(run, no_progress, stop)
    assert run.load_checkpoint() is None
    assert not (run.folder / DEMONSTRATIONS).exists()


def test_new_runs_are_named_by_kind_variant_and_seed_and_never_reused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = [create_run("rl", make_config(variant="sarl-sfm6", seed=4), None, imitation=None).folder for _ in range(3)]
    assert [str(name) for name in names] == [f"runs/rl-sarl-sfm6-seed4{end}" for end in ("", "-2", "-3")]
    Path("my.py").write_text("def hurry(transition, settings):\n    return 0 * transition.time\n")
    own = make_config(reward={"reward": "my.py:hurry"}, forces=True)
    assert create_run("il", own, None).folder.name == "il-custom-hurry-forces-seed0"
    assert set(run_folders("rl")) == set(names)
    assert len(run_folders()) == 4


@pytest.mark.parametrize("damage", [(b"created", b"creatad"), (b"{", b"")])
def test_the_newest_run_is_the_newest_finished_one_and_a_damaged_one_is_skipped_and_named(
    tmp_path, monkeypatch, damage
):
    monkeypatch.chdir(tmp_path)
    said = []
    old, new, newest = (create_run("il", Config(), None).folder for _ in range(3))
    with pytest.raises(ConfigError, match=r"no finished run.*sfmrl il"):
        newest_run(said.append)
    for folder in (old, new):
        (folder / WEIGHTS).touch()
        (newest / "run.json").write_bytes((newest / "run.json").read_bytes().replace(*damage))
        assert newest_run(said.append) == folder
    assert said == []
    (newest / WEIGHTS).touch()
    assert newest_run(said.append) == new
    assert len(said) == 1
    assert said[0].startswith(f"{newest} is skipped: {newest / 'run.json'} is damaged")


def test_an_empty_folder_is_taken_and_a_run_replaced_only_with_overwrite(tmp_path):
    empty, run = tmp_path / "empty", tmp_path / "run"
    empty.mkdir()
    assert create_run("il", Config(), empty).folder == empty
    create_run("il", Config(), run)
    (run / "weights.npz").write_bytes(b"trained")
    with pytest.raises(ConfigError, match=r"already exists.*--overwrite"):
        create_run("il", Config(), run)
    assert (run / "weights.npz").exists()
    create_run("il", Config(), run, overwrite=True)
    assert not (run / "weights.npz").exists()
    (run / SUMS).write_bytes(b"\xff")
    create_run("il", Config(), run, overwrite=True)
    assert open_run(run).config == Config()


def test_a_damaged_run_does_not_keep_the_next_one_from_its_own_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    damaged = create_run("il", Config(), None).folder
    (damaged / SUMS).write_bytes(b"\xff")
    assert create_run("il", Config(), None).folder == Path(f"{damaged}-2")


def test_the_same_command_opens_its_run_whatever_became_of_its_imitation(whole, tmp_path):
    source, folder = tmp_path / "il", tmp_path / "rl"
    shutil.copytree(whole, source)
    begun = start_run(TINY, source, False, folder)
    shutil.rmtree(source)
    assert start_run(TINY, source, False, folder, go_on=True) == begun
    assert start_run(TINY, None, False, folder, go_on=True) == begun
    with pytest.raises(ConfigError, match=r"was begun from .*il, not from .*name another --run"):
        start_run(TINY, whole, False, folder, go_on=True)
    with pytest.raises(ConfigError, match=r"was begun from .*il, not from scratch; name another --run"):
        start_run(TINY, None, True, folder, go_on=True)
    with pytest.raises(ConfigError, match=r"was begun with \"seed\": 0"):
        start_run(override(TINY, {"seed": 1}), source, False, folder, go_on=True)
    alone = start_run(TINY, None, True, tmp_path / "alone")
    assert start_run(TINY, None, True, tmp_path / "alone", go_on=True) == alone
    with pytest.raises(ConfigError, match=r"was begun from scratch, not from .*il"):
        start_run(TINY, source, False, tmp_path / "alone", go_on=True)


FOREIGN = {
    "a thesis": {"thesis.tex": "years of work"},
    "a run.json": {"run.json": '{"pipeline": "not ours"}', "data.csv": "1,2,3"},
    "a config.json": {"config.json": "{}"},
    "sums": {SUMS: f"{'0' * 64}  thesis.tex\n"},
}


@pytest.mark.parametrize("what", FOREIGN)
@pytest.mark.parametrize("overwrite", [False, True])
def test_a_folder_or_file_of_somebody_else_is_never_replaced(tmp_path, what, overwrite):
    for name, text in FOREIGN[what].items():
        (tmp_path / name).write_text(text)
    for place in (tmp_path, tmp_path / next(iter(FOREIGN[what]))):
        with pytest.raises(ConfigError, match="not a run folder"):
            create_run("il", Config(), place, overwrite=overwrite)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == FOREIGN[what]


def test_overwriting_removes_only_what_a_run_writes(tmp_path, whole):
    run = Path(shutil.copytree(whole, tmp_path / "run"))
    (run / "checkpoint-000009.npz").touch()
    for name in ("thesis.tex", "map.txt", ".notes.tmp", "checkpoint-best.pt"):
        (run / name).write_text("years of work")
    create_run("il", Config(), run, overwrite=True)
    theirs = {path.name for path in run.iterdir() if not path.is_dir() and path.read_bytes() == b"years of work"}
    assert theirs == {"thesis.tex", "map.txt", ".notes.tmp", "checkpoint-best.pt"}
    assert {path.name for path in run.iterdir()} - theirs == {"config.json", "run.json", SUMS, ".lock"}
    drawn = make_config(reinforcement={"environment": "map:R....G"})
    with pytest.raises(ConfigError, match=r"map\.txt does not belong to the run"):
        create_run("rl", drawn, run, overwrite=True)


def test_a_run_in_training_is_neither_overwritten_nor_trained_twice(tmp_path):
    run = create_run("il", Config(), tmp_path / "run")
    before = {path: path.read_bytes() for path in run.folder.iterdir()}
    with sole_use(run):
        assert in_training(run.folder)
        for overwrite in (False, True):
            with pytest.raises(ConfigError, match="is being trained"):
                create_run("il", Config(seed=1), run.folder, overwrite=overwrite)
        with pytest.raises(ConfigError, match="is being trained"), sole_use(open_run(run.folder)):
            pass
        with pytest.raises(ConfigError, match="is being trained now; wait"):
            load_policy(run.folder)
    assert not in_training(run.folder)
    assert {path: path.read_bytes() for path in run.folder.iterdir()} == before


def test_of_two_trainings_on_one_new_folder_one_is_made_and_the_other_refused(tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    with locked(folder), pytest.raises(ConfigError, match="is being trained by another process"):  # it is being made
        create_run("il", Config(), folder)
    assert {path.name for path in folder.iterdir()} == {".lock"}
    run = create_run("il", Config(), folder)
    create_run("il", Config(seed=1), folder, overwrite=True)  # before the first one's training has begun
    with pytest.raises(ConfigError, match="has just been replaced"), sole_use(run):
        pass


def test_opening_a_run_to_train_it_tidies_what_killed_processes_left(interrupted):
    run = open_run(interrupted)
    names = {path.name for path in run.folder.iterdir()}
    (run.folder / ".checkpoint-000009.npz.12.tmp").write_bytes(b"half")
    with open(run.folder / SUMS, "a") as file:  # as an earlier version left it, which removed files first
        file.write(f"{'0' * 64}  checkpoint-000001.npz\n{'0' * 64}  weights.npz\n")
    with sole_use(run):
        pass
    assert {path.name for path in run.folder.iterdir()} == names | {".lock"}
    assert set(read_sums(run.folder)) == names - {"metrics.csv", SUMS, ".lock"}


def test_a_run_that_trains_on_a_map_keeps_the_drawing(tmp_path):
    config = make_config(reinforcement={"environment": "map:R..1.G/......"})
    run = create_run("rl", config, tmp_path / "run")
    assert (run.folder / "map.txt").read_text() == "R..1.G\n......\n"
    assert load_map(run.folder / "map.txt") == config.reinforcement.environment
    assert "map.txt" in read_sums(run.folder)


def test_opening_what_is_no_run_names_those_that_are(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    known = create_run("il", Config(), None).folder
    with pytest.raises(ConfigError, match=f"nothing does not exist; known runs: {known}"):
        open_run(Path("nothing"))
    (tmp_path / "empty").mkdir()
    (tmp_path / "part").mkdir()
    (tmp_path / "part" / "run.json").write_text("{}")
    with pytest.raises(DamagedFile, match=r"part/config.json is missing; put back a copy"):
        open_run(tmp_path / "part")
    with pytest.raises(ConfigError, match="empty is not a run folder"):
        open_run(Path("empty"))
    with pytest.raises(ConfigError, match="is a run of sfmrl il; name a run of sfmrl rl"):
        open_run(known, "rl")
    (known.parent / "broken").mkdir()
    (known.parent / "broken" / "run.json").write_text("{")
    assert run_folders() == [known]


def test_checkpoints_number_on_and_only_two_are_kept(tmp_path):
    run: Run = create_run("il", Config(), tmp_path / "run")
    assert run.load_checkpoint() is None
    for number in range(4):
        run.save_checkpoint({"number": number})
    assert [path.name for path in run.checkpoints()] == ["checkpoint-000003.npz", "checkpoint-000004.npz"]
    assert run.load_checkpoint() == {"number": 3}


# Trainings as real processes, killed at several moments: they must end in the bits of one that never was.

IL = "--time-limit 14 --episodes 30 --epochs 14 --batch-size 20"
RL = "--time-limit 14 --reward sfm --forces --episodes 24 --parallel 4 --batches 10 --batch-size 40 "
RL += "--validation-interval 12 --validation-episodes 3 --test-episodes 4"


def command(*words: object) -> list[str]:
    return [sys.executable, "-m", "sfmrl", *map(str, words)]


def complete(cwd: Path, *words: object) -> None:
    done = subprocess.run(command(*words), cwd=cwd, env=environment(), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def interrupt(cwd: Path, number: signal.Signals, moment: Callable[[], bool], *words: object) -> None:
    """Start a training, send it a signal once `moment` has come, and wait for its end."""
    process = subprocess.Popen(command(*words), cwd=cwd, env=environment(), stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 120
    while not moment():
        assert process.poll() is None, process.communicate()[1]
        assert time.monotonic() < deadline
        time.sleep(0.005)
    process.send_signal(number)
    said = process.communicate(timeout=120)[1]
    if number == signal.SIGKILL:
        assert process.returncode == -signal.SIGKILL
    else:
        assert process.returncode == 130, said
        assert f"--resume {words[words.index('--run' if '--run' in words else '--resume') + 1]}" in said


def checkpoint_of_at_least(folder: Path, number: int) -> Callable[[], bool]:
    return lambda: any(int(path.stem[-6:]) >= number for path in folder.glob("checkpoint-*.npz"))


def lines_of_at_least(path: Path, lines: int) -> Callable[[], bool]:
    return lambda: path.exists() and len(path.read_text().splitlines()) >= lines


def assert_same_results(one: Path, other: Path, names: list[str]) -> None:
    for name in names:
        assert (one / name).read_bytes() == (other / name).read_bytes(), name


@pytest.fixture(scope="module")
def workshop(tmp_path_factory) -> Path:
    """A folder with an imitation run `il` that was never interrupted."""
    folder = tmp_path_factory.mktemp("workshop")
    complete(folder, "il", *IL.split(), "--run", "il")
    return folder


def test_a_killed_imitation_goes_on_to_the_same_bits(workshop):
    killed = workshop / "il-killed"
    start, go_on = ("il", *IL.split(), "--run", "il-killed"), ("il", "--resume", "il-killed")
    interrupt(workshop, signal.SIGKILL, (killed / "run.json").exists, *start)
    interrupt(workshop, signal.SIGTERM, (killed / DEMONSTRATIONS).exists, *go_on)
    interrupt(workshop, signal.SIGINT, checkpoint_of_at_least(killed, 3), *go_on)
    interrupt(workshop, signal.SIGKILL, checkpoint_of_at_least(killed, 6), *go_on)
    complete(workshop, *go_on)
    assert_same_results(workshop / "il", killed, [WEIGHTS, DEMONSTRATIONS, "metrics.csv", "config.json"])


def test_a_killed_reinforcement_goes_on_to_the_same_bits(workshop):
    whole, killed = workshop / "rl", workshop / "rl-killed"
    complete(workshop, "rl", *RL.split(), "--from", "il", "--run", "rl", "--threads", 1)
    start, go_on = ("rl", *RL.split(), "--from", "il", "--run", "rl-killed"), ("rl", "--resume", "rl-killed")
    metrics = killed / "metrics.csv"
    interrupt(workshop, signal.SIGINT, checkpoint_of_at_least(killed, 2), *start)  # while it repeats imitation
    interrupt(workshop, signal.SIGKILL, checkpoint_of_at_least(killed, 6), *go_on)
    interrupt(workshop, signal.SIGTERM, lines_of_at_least(metrics, 5), *go_on)
    interrupt(workshop, signal.SIGKILL, lines_of_at_least(killed / "validation.csv", 3), *go_on)
    complete(workshop, *go_on)
    assert_same_results(whole, killed, [WEIGHTS, "metrics.csv", "validation.csv", "result.json", "config.json"])
    assert len(metrics.read_text().splitlines()) == 25
    assert len((killed / "validation.csv").read_text().splitlines()) == 4
    facts = json.loads((killed / "run.json").read_text())
    assert (facts["kind"], facts["imitation"]) == ("rl", "../il")


def test_a_training_starts_from_the_newest_finished_imitation_of_its_preset_seed_and_simulation(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def imitation(changes: dict, done: bool = True) -> Path:
        folder = create_run("il", override(TINY, changes), None).folder
        write_atomically(folder / DEMONSTRATIONS, b"some")
        if done:
            write_atomically(folder / WEIGHTS, b"trained")
        return folder

    imitation({})
    fits = imitation({"forces": True, "reward": {"reward": "sfm"}})  # these may differ
    for other in ({"seed": 4}, {"preset": "paper"}, {"simulation": {"time_limit": 15.0}}):
        imitation(other)
    imitation({}, done=False)
    assert start_run(TINY, None, False, None).imitation == fits


def test_a_training_does_not_begin_with_other_demonstrations_than_its_own(folder, tmp_path):
    source = Path(shutil.copytree(folder, tmp_path / "il"))
    run = start_run(TINY, source, False, tmp_path / "rl")
    write_atomically(source / DEMONSTRATIONS, (source / DEMONSTRATIONS).read_bytes() + b"x")
    with pytest.raises(DamagedFile, match="has changed or gone since this run began"):
        run_reinforcement(run, no_progress, StopSignal(), lambda text: None)


@pytest.mark.skipif(os.name != "posix", reason="folders are synced on POSIX")
def test_renames_are_synced_too(tmp_path, monkeypatch):
    done, fsync, move = [], os.fsync, os.replace

    def noting_fsync(descriptor: int) -> None:
        done.append("folder" if stat.S_ISDIR(os.fstat(descriptor).st_mode) else "file")
        fsync(descriptor)

    def noting_move(*places: Path) -> None:
        done.append("rename")
        move(*places)

    monkeypatch.setattr(os, "fsync", noting_fsync)
    monkeypatch.setattr(os, "replace", noting_move)
    write_atomically(tmp_path / "numbers", b"one")
    renames = [number for number, what in enumerate(done) if what == "rename"]
    assert len(renames) == 2  # the file's, and that of SHA256SUMS
    assert all(done[number + 1] == "folder" for number in renames)
    assert done.index("file") < renames[0]
    assert done.count("file") == 2


@pytest.mark.parametrize("windows", [True, False])
def test_a_file_that_a_scanner_has_open_is_waited_for_on_windows_alone(monkeypatch, windows):
    monkeypatch.setattr("sfmrl.runs.files.WINDOWS", windows)
    tries = iter([PermissionError(), PermissionError(), None])

    def move(*_) -> None:
        if error := next(tries):
            raise error

    if windows:
        retried(move, "here", "there")
        assert next(tries, "none") == "none"
    else:
        with pytest.raises(PermissionError):
            retried(move, "here", "there")


def test_a_run_finds_its_imitation_on_every_system(folder, tmp_path, monkeypatch):
    source = Path(shutil.copytree(folder, tmp_path / "il"))
    run = start_run(TINY, source, False, tmp_path / "rl")
    assert (run.facts["imitation"], run.imitation) == ("../il", source)

    def fail(*_) -> str:
        raise ValueError("path is on mount 'D:', start on mount 'C:'")

    monkeypatch.setattr("os.path.relpath", fail)
    assert start_run(TINY, source, False, tmp_path / "far").imitation == source
