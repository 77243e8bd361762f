"""Many trainings on this machine: as processes side by side, each a plain command that can be given again.

What is finished is never repeated, and what was killed goes on from its checkpoint. Each writes what it says to a file
of its own under logs/ beside its run folder.
"""

import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path

from sfmrl.config import counted
from sfmrl.files import read_regular, regular
from sfmrl.folders import finished
from sfmrl.progress import Progress
from sfmrl.stopping import Interrupted, StopSignal
from sfmrl.study.tables import Job

LOOK_EVERY = 0.5  # seconds


class Failed(Exception):
    """Some trainings did not come to their end."""


def run_jobs(jobs: list[Job], side_by_side: int, progress: Progress, stop: StopSignal, say: Callable) -> None:
    """Run the jobs that are not finished, `side_by_side` at a time, each after what it needs.

    Raises Interrupted once `stop` has been requested and all have kept what they need to go on; Failed, naming them,
    where some failed: all that do not need these are run nevertheless.
    """
    waiting = [job for job in jobs if not job.finished]
    running: dict[Job, subprocess.Popen] = {}
    failed: list[Job] = []
    before = sum(map(_played, waiting))
    told_of = before
    with progress("trainings", sum(job.episodes for job in waiting) - before) as told:
        try:
            while running or waiting:
                for job, process in list(running.items()):
                    if process.poll() is None:
                        continue
                    del running[job]
                    if not job.finished and not stop.requested:
                        say(f"{job.name} failed: {_last_line(_log(job))} (see {_log(job)})")
                        failed.append(job)
                if stop.requested:
                    _wait_for(running.values())
                    raise Interrupted
                waiting = without_blocked(waiting, failed)
                for job in [job for job in waiting if job.needs is None or finished(job.needs)]:
                    if len(running) == side_by_side:
                        break
                    waiting.remove(job)
                    running[job] = _start(job)
                now = sum(_played(job) for job in jobs if job not in waiting)
                told(max(0, now - told_of))
                told_of = max(told_of, now)
                time.sleep(LOOK_EVERY)
        except BaseException:
            for process in running.values():
                process.kill()
            raise
    report(failed)


def without_blocked(waiting: list[Job], failed: list[Job]) -> list[Job]:
    """Those that wait for nothing that failed; the others are added to `failed`."""
    lost = {job.folder for job in failed}
    failed += [job for job in waiting if job.needs in lost]
    return [job for job in waiting if job.needs not in lost]


def report(failed: list[Job]) -> None:
    """Raises Failed, naming them, where there are any."""
    if failed:
        raise Failed(f"{counted(len(failed), 'training')} failed: {', '.join(job.name for job in failed)}")


def _start(job: Job) -> subprocess.Popen:
    """Its process, which a Ctrl-C in this terminal does not reach."""
    _log(job).parent.mkdir(parents=True, exist_ok=True)
    with open(regular(_log(job)), "a") as log:
        words = [sys.executable, "-m", "sfmrl", *job.words]
        return subprocess.Popen(
            words, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT, start_new_session=True
        )


def _wait_for(processes: Iterable[subprocess.Popen]) -> None:
    """Ask trainings to stop, and wait until they have kept what they need."""
    processes = list(processes)
    for process in processes:
        with suppress(ProcessLookupError):
            process.terminate()
    for process in processes:
        process.wait()


def _log(job: Job) -> Path:
    return job.folder.parent / "logs" / f"{job.name}.txt"


def _last_line(path: Path) -> str:
    lines = read_regular(path).decode(errors="replace").strip().splitlines() if path.exists() else []
    return lines[-1].strip() if lines else "it said nothing"


def _played(job: Job) -> int:
    """Training episodes that a run has behind it."""
    path = job.folder / "metrics.csv"
    if not job.episodes or not path.exists():
        return 0
    with open(regular(path), "rb") as file:
        return max(0, sum(1 for _ in file) - 1)
