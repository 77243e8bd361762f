"""Run many trainings, each a command that can be repeated: as processes on this machine, or on a Ray cluster.

A finished training is never repeated, and a killed one resumes from its checkpoint. On this machine, each writes its
messages to a file of its own under logs/ beside its run folder. On a cluster (the extra "ray"), run folders are sent to
the worker and back: a worker needs sfmrl, but no common file system. If a worker is lost, its training is repeated on
another, to the same bits if that machine computes the same (`sfmrl doctor` shows a digest).
"""

import logging
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from sfmrl.config import ConfigError, as_typed, counted
from sfmrl.runs.files import read_regular, regular
from sfmrl.runs.folders import finished
from sfmrl.runs.progress import Interrupted, Progress, StopSignal

POLL_INTERVAL = 0.5  # s
SFMRL = (sys.executable, "-m", "sfmrl")


class Failed(Exception):
    """Some trainings failed; its text names them."""


@dataclass(frozen=True)
class Job:
    """A training as one plain command, "sfmrl" and `words`; repeated, it goes on where it was stopped."""

    folder: Path  # the run folder that it makes
    words: tuple[str, ...]
    needs: Path | None = None  # the run folder that must be finished first
    episodes: int = 0  # of reinforcement

    @property
    def command(self) -> str:
        """What to type."""
        return as_typed(["sfmrl", *self.words])


def run_jobs(
    jobs: list[Job], workers: "Processes | RayWorkers", progress: Progress, stop: StopSignal, say: Callable
) -> None:
    """Run the jobs that are not finished on `workers`, each after the job that it needs.

    Raises Interrupted once `stop` has been requested and the jobs have stopped. Raises Failed, naming them, when some
    jobs failed; all jobs that do not need these are run nevertheless.
    """
    unfinished = [job for job in jobs if not finished(job.folder)]
    waiting, running, failed = list(unfinished), 0, []
    shown = sum(map(_episodes_played, unfinished))
    with progress("trainings", sum(job.episodes for job in unfinished) - shown) as advance:
        try:
            while waiting or running:
                for job, message in workers.ended():
                    running -= 1
                    if not finished(job.folder) and not stop.requested:
                        say(f"{job.folder.name} failed: {message}")
                        failed.append(job)
                if stop.requested:
                    workers.stop()
                    raise Interrupted
                for job in list(waiting):
                    if any(job.needs == other.folder for other in failed):
                        failed.append(job)
                        waiting.remove(job)
                    elif (job.needs is None or finished(job.needs)) and workers.start(job):
                        running += 1
                        waiting.remove(job)
                # A training that goes on from a checkpoint has fewer episodes than it had before.
                played = max(shown, sum(map(_episodes_played, unfinished)))
                advance(played - shown)
                shown = played
                time.sleep(POLL_INTERVAL)
        except BaseException:
            workers.kill()
            raise
    if failed:
        raise Failed(f"{counted(len(failed), 'training')} failed: {', '.join(job.folder.name for job in failed)}")


def _episodes_played(job: Job) -> int:
    """Return the training episodes in a run's metrics, which are read only while they grow."""
    path = job.folder / "metrics.csv"
    if not job.episodes or not path.exists():
        return 0
    return job.episodes if finished(job.folder) else max(0, read_regular(path).count(b"\n") - 1)


class Processes:
    """Runs jobs as processes on this machine, at most `limit` at a time."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._running: dict[Job, subprocess.Popen] = {}

    def start(self, job: Job) -> bool:
        """Start a job if there is room, in a session of its own, so that Ctrl-C in this terminal does not reach it."""
        if len(self._running) == self._limit:
            return False
        log = _log(job)
        log.parent.mkdir(parents=True, exist_ok=True)
        with open(regular(log), "a") as out:
            words, nothing, both = [*SFMRL, *job.words], subprocess.DEVNULL, subprocess.STDOUT
            self._running[job] = subprocess.Popen(words, stdin=nothing, stdout=out, stderr=both, start_new_session=True)
        return True

    def ended(self) -> Iterator[tuple[Job, str]]:
        """Remove and yield the jobs whose process has ended, each with the last line of its log."""
        for job in [job for job, process in self._running.items() if process.poll() is not None]:
            del self._running[job]
            log = _log(job)
            text = read_regular(log).decode(errors="replace") if log.exists() else ""
            yield job, f"{_last_line(text)} (see {log})"

    def stop(self) -> None:
        """Terminate all trainings, which stop at their next checkpoint, and wait until they have."""
        for process in self._running.values():
            process.terminate()
        for process in self._running.values():
            process.wait()

    def kill(self) -> None:
        """Kill all trainings."""
        for process in self._running.values():
            process.kill()


def _log(job: Job) -> Path:
    return job.folder.parent / "logs" / f"{job.folder.name}.txt"


def _last_line(text: str) -> str:
    lines = text.strip().splitlines()
    return lines[-1].strip() if lines else "it printed nothing"


class RayWorkers:
    """Runs jobs on the cluster that RAY_ADDRESS names, else one on this machine; raises ConfigError without Ray."""

    def __init__(self) -> None:
        try:
            import ray
        except ImportError:
            raise ConfigError("--on ray needs Ray; install it with pip install ray") from None
        ray.init(log_to_driver=False, logging_level=logging.ERROR, ignore_reinit_error=True)
        self._ray = ray
        self._sent: dict[Any, Job] = {}  # references to results, and their jobs
        self._train = ray.remote(num_cpus=1, max_retries=-1)(train_away)
        self._packed = cache(lambda folder: ray.put(pack(folder)))  # sent once to all jobs that need it

    def start(self, job: Job) -> bool:
        """Send a job to the cluster, which queues it, with its run folder and the one that it needs."""
        restore(job.folder)
        self._sent[self._train.remote(job, pack(job.folder), self._packed(job.needs))] = job
        return True

    def ended(self) -> Iterator[tuple[Job, str]]:
        """Remove and yield the jobs that have ended, each with its last message, once its folder is in place."""
        for reference in self._ray.wait(list(self._sent), timeout=0)[0] if self._sent else ():
            job = self._sent.pop(reference)
            try:
                message, trained = self._ray.get(reference)
                unpack(trained, job.folder)
            except self._ray.exceptions.RayError as error:
                message = _last_line(str(error))
            yield job, message

    def stop(self) -> None:
        """Cancel all jobs; what they have trained since they were sent is lost."""
        for reference in self._sent:
            self._ray.cancel(reference, force=True)

    kill = stop


Files = dict[str, bytes]  # a folder by relative path; empty if there is no folder


def train_away(job: Job, begun: Files, needed: Files) -> tuple[str, Files]:
    """Train on a worker, given the files of both folders; returns the last message, and the files unless it failed."""
    with tempfile.TemporaryDirectory() as place:
        here = {str(folder): Path(place, folder.name) for folder in (job.folder, job.needs) if folder}
        for folder, files in zip(here.values(), (begun, needed), strict=False):
            unpack(files, folder)
        words = [str(here.get(word, word)) for word in job.words]
        done = subprocess.run([*SFMRL, *words], stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
        return _last_line(done.stderr or done.stdout), {} if done.returncode else pack(here[str(job.folder)])


def pack(folder: Path | None) -> Files:
    """Return a folder's files."""
    if folder is None:
        return {}
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def unpack(files: Files, folder: Path) -> None:
    """Replace a folder by these files, if any; after a crash, `restore` leaves the old or the new one."""
    if files:
        beside = restore(folder)
        for name, data in files.items():
            path = beside / "new" / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        if folder.exists():
            folder.rename(beside / "old")
        (beside / "new").rename(folder)
        shutil.rmtree(beside)


def restore(folder: Path) -> Path:
    """Clean up after an `unpack` that was killed; returns the path of the folder in which it works."""
    beside = folder.with_name(f".{folder.name}.tmp")
    if (beside / "old").exists() and not folder.exists():
        (beside / "old").rename(folder)
    shutil.rmtree(beside, ignore_errors=True)
    return beside
