"""The same trainings on a Ray cluster (the extra "ray"): folders travel with the jobs, and come back when they end.

A worker needs sfmrl installed and nothing else, no common file system. What a lost worker was training is trained again
elsewhere, to the same bits where that machine computes the same (`sfmrl doctor` shows a digest).
"""

import io
import shutil
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Callable
from pathlib import Path

from sfmrl.config import ConfigError
from sfmrl.folders import finished
from sfmrl.progress import Progress
from sfmrl.stopping import Interrupted, StopSignal
from sfmrl.study.jobs import report, without_blocked
from sfmrl.study.tables import Job


def run_on_ray(jobs: list[Job], progress: Progress, stop: StopSignal, say: Callable) -> None:
    """Run the jobs that are not finished on a cluster: the one that RAY_ADDRESS names, or one that runs on this machine
    already, or else one made of this machine alone.

    Raises ConfigError without Ray, and Interrupted and Failed as `campaign.run_jobs` does.
    """
    try:
        import ray
    except ImportError:
        raise ConfigError("--on ray needs Ray; install it with pip install 'sfmrl[ray]'") from None
    if not ray.is_initialized():
        ray.init(log_to_driver=False, logging_level="error")
    train = ray.remote(num_cpus=1, max_retries=-1)(train_away)
    waiting = [job for job in jobs if not job.finished]
    sent: dict[ray.ObjectRef, Job] = {}
    failed: list[Job] = []
    packed: dict[Path, ray.ObjectRef] = {}
    with progress("trainings", sum(job.episodes for job in waiting)) as told:
        while waiting or sent:
            for job in [job for job in waiting if job.needs is None or finished(job.needs)]:
                waiting.remove(job)
                if job.needs and job.needs not in packed:
                    packed[job.needs] = ray.put(pack(job.needs))
                folders = str(job.folder), job.needs and str(job.needs)
                begun = pack(job.folder) if job.folder.exists() else None
                sent[train.remote(job.words, folders, begun, packed.get(job.needs))] = job
            for reference in ray.wait(list(sent), timeout=0.5)[0]:
                job = sent.pop(reference)
                try:
                    said, archive = ray.get(reference)
                except ray.exceptions.RayError as error:
                    said, archive = str(error).strip().splitlines()[-1], None
                if archive is None:
                    say(f"{job.name} failed: {said}")
                    failed.append(job)
                else:
                    unpack(archive, job.folder)
                    told(job.episodes)
            if stop.requested:
                for reference in sent:
                    ray.cancel(reference, force=True)
                raise Interrupted
            waiting = without_blocked(waiting, failed)
    report(failed)


def train_away(
    words: tuple[str, ...], folders: tuple[str, str | None], begun: bytes | None, needed: bytes | None
) -> tuple[str, bytes | None]:
    """On a worker: what the training said last, and its run folder packed, or None where it failed.

    `folders` are the run folder and the one that it needs, as `words` name them; the others are what they hold.
    """
    with tempfile.TemporaryDirectory() as place:
        here = {name: Path(place) / Path(name).name for name in folders if name}
        for name, archive in zip(folders, (begun, needed), strict=True):
            if archive is not None:
                unpack(archive, here[name])
        command = [sys.executable, "-m", "sfmrl", *(str(here.get(word, word)) for word in words)]
        done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
        said = (done.stderr or done.stdout).strip().splitlines()
        return said[-1] if said else "it said nothing", pack(here[folders[0]]) if done.returncode == 0 else None


def pack(folder: Path) -> bytes:
    """A folder's files as an archive."""
    with io.BytesIO() as buffer:
        with tarfile.open(fileobj=buffer, mode="w") as archive:
            archive.add(folder, arcname=".")
        return buffer.getvalue()


def unpack(data: bytes, folder: Path) -> None:
    """Put the files of an archive in place of a folder, whole or not at all."""
    put_right(folder)
    new, old = _beside(folder)
    with tarfile.open(fileobj=io.BytesIO(data)) as archive:
        archive.extractall(new, filter="data")
    if folder.exists():
        folder.rename(old)
    new.rename(folder)
    put_right(folder)


def put_right(folder: Path) -> None:
    """End an `unpack` of the folder that was killed: bring the new one in place of the old one, if it is whole."""
    new, old = _beside(folder)
    if old.exists() and not folder.exists():  # it was killed between its two renames
        new.rename(folder)
    for left in (new, old):
        shutil.rmtree(left, ignore_errors=True)


def _beside(folder: Path) -> tuple[Path, Path]:
    """Where the folder's new files, and the old ones, are while it is replaced."""
    return folder.with_name(f".{folder.name}.new.tmp"), folder.with_name(f".{folder.name}.old.tmp")
