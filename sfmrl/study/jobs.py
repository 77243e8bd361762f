"""Many trainings: processes side by side on this machine, or on a Ray cluster, each a command that can be given again.

A finished training is never repeated, and a killed one goes on from its checkpoint. Here, each writes its messages to
a file of its own under logs/ beside its run folder. On a cluster (the extra "ray"), run folders travel to the worker
and back: a worker needs sfmrl and no common file system. What a lost worker was training is trained again elsewhere,
to the same bits where that machine computes the same (`sfmrl doctor` shows a digest).
"""

import io
import shlex
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from sfmrl.config import ConfigError, counted
from sfmrl.runs.files import read_regular, regular
from sfmrl.runs.folders import finished
from sfmrl.runs.progress import Interrupted, Progress, StopSignal

POLL_INTERVAL = 0.5  # s


class Failed(Exception):
    """Some trainings failed; its text names them."""


@dataclass(frozen=True)
class Job:
    """A training as one plain command: `words` follow "sfmrl". Given again, it goes on where it was stopped."""

    name: str
    words: tuple[str, ...]
    folder: Path  # the run folder that it makes
    needs: Path | None  # the run folder that has to be finished before
    episodes: int  # of reinforcement

    @property
    def command(self) -> str:
        """What to type."""
        return shlex.join(["sfmrl", *self.words])


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
    with progress("trainings", sum(job.episodes for job in unfinished) - shown) as tell:
        try:
            while waiting or running:
                for job, message in workers.ended():
                    running -= 1
                    if not finished(job.folder) and not stop.requested:
                        say(f"{job.name} failed: {message}")
                        failed.append(job)
                if stop.requested:
                    workers.stop()
                    raise Interrupted
                lost = {job.folder for job in failed}
                failed += [job for job in waiting if job.needs in lost]
                waiting = [job for job in waiting if job.needs not in lost]
                for job in [job for job in waiting if job.needs is None or finished(job.needs)]:
                    if workers.start(job):
                        waiting.remove(job)
                        running += 1
                played = sum(map(_episodes_played, unfinished))
                tell(max(0, played - shown))
                shown = max(shown, played)
                time.sleep(POLL_INTERVAL)
        except BaseException:
            workers.kill()
            raise
    if failed:
        raise Failed(f"{counted(len(failed), 'training')} failed: {', '.join(job.name for job in failed)}")


def _episodes_played(job: Job) -> int:
    """Training episodes that a run has behind it."""
    path = job.folder / "metrics.csv"
    if not job.episodes or not path.exists():
        return 0
    with open(regular(path), "rb") as file:
        return max(0, sum(1 for _ in file) - 1)


class Processes:
    """Runs jobs as processes on this machine, at most `limit` at a time."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._running: dict[Job, subprocess.Popen] = {}

    def start(self, job: Job) -> bool:
        """Start a job in a session of its own, so that a Ctrl-C in this terminal does not reach it."""
        if len(self._running) == self._limit:
            return False
        log = _log(job)
        log.parent.mkdir(parents=True, exist_ok=True)
        words = [sys.executable, "-m", "sfmrl", *job.words]
        with open(regular(log), "a") as out:
            process = subprocess.Popen(
                words, stdin=subprocess.DEVNULL, stdout=out, stderr=subprocess.STDOUT, start_new_session=True
            )
        self._running[job] = process
        return True

    def ended(self) -> Iterator[tuple[Job, str]]:
        """Remove and return the jobs whose process has ended, each with the last line of its log."""
        for job in [job for job, process in self._running.items() if process.poll() is not None]:
            del self._running[job]
            log = _log(job)
            text = read_regular(log).decode(errors="replace") if log.exists() else ""
            yield job, f"{_last_line(text)} (see {log})"

    def stop(self) -> None:
        """Ask all trainings to stop at their next checkpoint, and wait until they have."""
        for process in self._running.values():
            with suppress(ProcessLookupError):
                process.terminate()
        for process in self._running.values():
            process.wait()

    def kill(self) -> None:
        """Kill all trainings."""
        for process in self._running.values():
            process.kill()


def _log(job: Job) -> Path:
    return job.folder.parent / "logs" / f"{job.name}.txt"


def _last_line(text: str) -> str:
    lines = text.strip().splitlines()
    return lines[-1].strip() if lines else "it said nothing"


class RayWorkers:
    """Runs jobs on the cluster that RAY_ADDRESS names, else one on this machine; raises ConfigError without Ray."""

    def __init__(self) -> None:
        try:
            import ray
        except ImportError:
            raise ConfigError("--on ray needs Ray; install it with pip install 'sfmrl[ray]'") from None
        ray.init(log_to_driver=False, logging_level="error", ignore_reinit_error=True)
        self._ray = ray
        self._train = ray.remote(num_cpus=1, max_retries=-1)(train_away)
        self._packed = cache(lambda folder: folder and ray.put(pack(folder)))  # sent once, whoever needs it
        self._sent: dict[ray.ObjectRef, Job] = {}

    def start(self, job: Job) -> bool:
        """Send a job to the cluster, which queues it, with its run folder and the one that it needs."""
        restore(job.folder)
        begun = pack(job.folder) if job.folder.exists() else None
        self._sent[self._train.remote(job, begun, self._packed(job.needs))] = job
        return True

    def ended(self) -> Iterator[tuple[Job, str]]:
        """Remove and return the jobs that have ended, each with its last message, and put their folders in place."""
        for reference in self._ray.wait(list(self._sent), timeout=0)[0] if self._sent else ():
            job = self._sent.pop(reference)
            try:
                message, archive = self._ray.get(reference)
            except self._ray.exceptions.RayError as error:
                message, archive = _last_line(str(error)), None
            if archive is not None:
                unpack(archive, job.folder)
            yield job, message

    def stop(self) -> None:
        """Cancel all jobs; what they have trained since they were sent is lost."""
        for reference in self._sent:
            self._ray.cancel(reference, force=True)

    kill = stop


def train_away(job: Job, begun: bytes | None, needed: bytes | None) -> tuple[str, bytes | None]:
    """Train on a worker, with the job's run folder and the one it needs packed, None where there is none.

    Returns the training's last message, and the run folder packed, None if it failed.
    """
    with tempfile.TemporaryDirectory() as place:
        here = {str(folder): Path(place) / folder.name for folder in (job.folder, job.needs) if folder}
        for folder, archive in ((job.folder, begun), (job.needs, needed)):
            if archive is not None:
                unpack(archive, here[str(folder)])
        words = [sys.executable, "-m", "sfmrl", *(str(here.get(word, word)) for word in job.words)]
        done = subprocess.run(words, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
        return _last_line(done.stderr or done.stdout), pack(here[str(job.folder)]) if done.returncode == 0 else None


def pack(folder: Path) -> bytes:
    """Return a folder's files as an archive."""
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w") as archive:
        archive.add(folder, arcname=".")
    return buffer.getvalue()


def unpack(data: bytes, folder: Path) -> None:
    """Replace a folder by the files of an archive; after a crash `restore` gives the old one or the new one."""
    place = _beside(folder)
    restore(folder)
    shutil.rmtree(place, ignore_errors=True)  # left by an unpacking that was killed
    with tarfile.open(fileobj=io.BytesIO(data)) as archive:
        archive.extractall(place / "new", filter="data")
    if folder.exists():
        folder.rename(place / "old")
    (place / "new").rename(folder)
    shutil.rmtree(place)


def restore(folder: Path) -> None:
    """Put a folder back that `unpack` had moved away when it was killed; do nothing if none is missing."""
    old = _beside(folder) / "old"
    if old.exists() and not folder.exists():
        old.rename(folder)


def _beside(folder: Path) -> Path:
    return folder.with_name(f".{folder.name}.tmp")
