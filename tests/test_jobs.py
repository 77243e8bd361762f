"""Many trainings side by side: each in its turn, none twice, on from where they were stopped; here and on a cluster."""

import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import pytest
from conftest import environment

from sfmrl.runs.folders import WEIGHTS, finished
from sfmrl.runs.progress import Interrupted, StopSignal
from sfmrl.study.jobs import Failed, Job, Processes, RayWorkers, pack, run_jobs, unpack

TINY_IL = ("--episodes", "12", "--epochs", "1")
TINY_RL = ("--episodes", "16", "--validation-episodes", "4", "--test-episodes", "4", "--no-recover", "--threads", "1")


@pytest.fixture(autouse=True)
def _surroundings(monkeypatch):
    for name, value in environment().items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr("sfmrl.study.jobs.POLL_INTERVAL", 0.05)


def il_job(folder: Path, seed: int = 0, *more: str) -> Job:
    words = ("il", "--seed", str(seed), "--run", str(folder), "--continue", *TINY_IL, *more)
    return Job(folder, words)


def rl_job(folder: Path, source: Path, *more: str) -> Job:
    words = ("rl", "--from", str(source), "--run", str(folder), "--continue", *TINY_RL, *more)
    return Job(folder, words, source, 16)


class Told:
    """A progress display that records its titles and counts."""

    done = total = 0

    @contextmanager
    def __call__(self, title, total):
        self.total = total
        yield self.advance

    def advance(self, count):
        self.done += count


def test_each_job_waits_for_what_it_needs_and_is_run_once(sfmrl, tmp_path):
    jobs = [rl_job(tmp_path / "b", tmp_path / "a"), il_job(tmp_path / "a")]
    told, said = Told(), []
    run_jobs(jobs, Processes(2), told, StopSignal(), said.append)
    assert all(finished(job.folder) for job in jobs)
    assert (told.done, told.total, said) == (16, 16, [])
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*") if path.is_file()}
    run_jobs(jobs, Processes(2), told, StopSignal(), said.append)
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*") if path.is_file()} == before
    # Given by hand, a command that has nothing left to do says so and is no failure.
    done = sfmrl(*jobs[0].words)
    assert (done.returncode, done.stderr) == (0, f"{jobs[0].folder} is finished already\n")


def test_a_failure_is_named_and_keeps_nobody_else_from_running(tmp_path):
    bad = il_job(tmp_path / "bad", 0, "--environment", "nowhere")
    jobs = [bad, rl_job(tmp_path / "after", bad.folder), il_job(tmp_path / "good", 1)]
    said = []
    with pytest.raises(Failed, match="2 trainings failed: bad, after"):
        run_jobs(jobs, Processes(1), Told(), StopSignal(), said.append)
    assert finished(tmp_path / "good")
    assert len(said) == 1
    assert "bad failed: sfmrl: there is no environment 'nowhere'" in said[0]


def test_a_stop_lets_trainings_keep_what_they_need_to_go_on(tmp_path):
    # Long enough to be seen in the middle: `run_jobs` looks every POLL_INTERVAL.
    whole = il_job(tmp_path / "whole", 0, "--epochs", "100")
    stopped = il_job(tmp_path / "stopped", 0, "--epochs", "100")
    run_jobs([whole], Processes(1), Told(), StopSignal(), print)
    stop = StopSignal()

    class StopsIt(Told):
        def advance(self, count):
            metrics = stopped.folder / "metrics.csv"
            stop.requested = metrics.exists() and len(metrics.read_text().splitlines()) > 2

    with pytest.raises(Interrupted):
        run_jobs([stopped], Processes(1), StopsIt(), stop, print)
    assert not finished(stopped.folder)
    assert list(stopped.folder.glob("checkpoint-*.npz"))
    run_jobs([stopped], Processes(1), Told(), StopSignal(), print)
    assert (stopped.folder / WEIGHTS).read_bytes() == (whole.folder / WEIGHTS).read_bytes()


def test_the_table_command_stops_at_a_signal_and_says_how_to_go_on(tmp_path):
    process = subprocess.Popen(
        [sys.executable, "-m", "sfmrl", "table", "1", "--seeds", "0", "--rows", "sarl", "--jobs", "1"],
        cwd=tmp_path,
        stderr=subprocess.PIPE,
        text=True,
    )
    run = tmp_path / "runs" / "tables" / "quick-il-seed0"
    deadline = time.monotonic() + 120
    while not (run / "run.json").exists():
        time.sleep(0.1)
        assert process.poll() is None
        assert time.monotonic() < deadline
    os.kill(process.pid, signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert said.splitlines()[-1] == "sfmrl: interrupted; to continue, type the same command again"
    assert not finished(run)


def test_folders_travel_whole(tmp_path):
    source, target = tmp_path / "source", tmp_path / "far" / "target"
    (source / "inner").mkdir(parents=True)
    (source / "inner" / "numbers").write_bytes(bytes(range(256)))
    for _ in range(2):
        unpack(pack(source), target)
        assert pack(target) == pack(source) == {"inner/numbers": bytes(range(256))}
        assert list(target.parent.iterdir()) == [target]
        (target / "old").touch()


def test_without_ray_the_remedy_is_named(sfmrl, tmp_path):
    (tmp_path / "ray.py").write_text("raise ImportError")
    done = sfmrl("table", "1", "--on", "ray")
    assert done.returncode == 2
    assert done.stderr == "sfmrl: --on ray needs Ray; install it with pip install ray\n"


@pytest.mark.timeout(900)  # Ray's processes are many, and slow on busy cores
def test_a_cluster_of_two_workers_loses_one_in_the_middle(tmp_path):
    """Real worker processes on this machine; the one that trains is killed, and its job is done by the other."""
    pytest.importorskip("ray")
    import ray
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
    try:
        workers = [cluster.add_node(num_cpus=1) for _ in range(2)]
        cluster.wait_for_nodes()
        ray.init(address=cluster.address, log_to_driver=False, logging_level="error")
        jobs = [il_job(tmp_path / name, seed, "--epochs", "40") for seed, name in enumerate("ab")]
        jobs.append(rl_job(tmp_path / "c", tmp_path / "a"))
        said = []

        def kill_one() -> None:
            while ray.available_resources().get("CPU", 0) > 0:  # until both are training
                time.sleep(0.1)
            time.sleep(2.0)
            cluster.remove_node(workers[1], allow_graceful=False)

        killer = threading.Thread(target=kill_one, daemon=True)
        killer.start()
        told = Told()
        run_jobs(jobs, RayWorkers(), told, StopSignal(), said.append)
        assert not killer.is_alive()  # the worker was lost while others were at work
        assert said == []
        assert all(finished(job.folder) for job in jobs)
        assert told.done == 16
        while sum(node["Alive"] for node in ray.nodes()) > 2:  # the head, and one worker: Ray takes its time to say so
            time.sleep(0.1)
    finally:
        ray.shutdown()
        cluster.shutdown()
    again = il_job(tmp_path / "again", 1, "--epochs", "40")
    run_jobs([again], Processes(1), Told(), StopSignal(), print)
    assert (again.folder / WEIGHTS).read_bytes() == (tmp_path / "b" / WEIGHTS).read_bytes()


def test_at_most_as_many_trainings_run_as_are_allowed_each_in_its_own_session(tmp_path, monkeypatch):
    sessions = []

    class Busy:
        def __init__(self, words, **how) -> None:
            sessions.append(how["start_new_session"])

        def poll(self) -> None:
            return None

    monkeypatch.setattr("sfmrl.study.jobs.subprocess.Popen", Busy)
    workers = Processes(2)
    assert [workers.start(il_job(tmp_path / name)) for name in "abc"] == [True, True, False]
    assert sessions == [True, True]  # so Ctrl-C in a terminal reaches them through the table alone
