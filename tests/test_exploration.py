"""Training episodes on a second process: the same episodes as on the first, even if the second is killed."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from conftest import environment

from sfmrl.exploration import Explored
from sfmrl.fast import FastNetwork, new_network
from sfmrl.runs.explorer import Explorer
from sfmrl.variants import make_config

CONFIG = make_config("quick", simulation={"time_limit": 6.0}, reinforcement={"environment": "1"})


def assert_same(one: Explored, other: Explored) -> None:
    for mine, theirs in ((one[0].position, other[0].position), (one[0].reward, other[0].reward), (one[1], other[1])):
        np.testing.assert_array_equal(mine, theirs)


@pytest.fixture
def actor() -> FastNetwork:
    return new_network(CONFIG, seed=5)


@pytest.fixture
def aside() -> Iterator[Explorer]:
    with Explorer(CONFIG, threads=1, aside=True) as explorer:
        yield explorer


def test_episodes_played_aside_are_those_played_here(actor, aside):
    with Explorer(CONFIG, threads=2, aside=False) as here:
        assert_same(aside.start(actor, range(4))(), here.start(actor, range(4))())
        actor.flat += 0.01
        assert_same(aside.start(actor, range(4, 6))(), here.start(actor, range(4, 6))())


@pytest.mark.parametrize("busy", [True, False])
def test_the_work_of_a_process_that_was_killed_is_done_here(actor, aside, busy):
    aside.start(actor, range(1))()
    (process,) = aside._pool._processes.values()
    if busy:
        ahead = aside.start(actor, range(3))
        process.kill()
    else:
        process.kill()
        process.join()
        ahead = aside.start(actor, range(3))
    with Explorer(CONFIG, threads=1, aside=False) as here:
        expected = here.start(actor, range(3))()
    assert_same(ahead(), expected)
    assert_same(aside.start(actor, range(3))(), expected)


TRAINING = """
from sfmrl.runs.explorer import Explorer
from sfmrl.fast import new_network
from sfmrl.variants import make_config

if __name__ == "__main__":
    config = make_config("quick")
    explorer = Explorer(config, 1, True)
    explorer.start(new_network(config), range(1))()
    print(*explorer._pool._processes, flush=True)
    input()
"""


def is_there(process: int) -> bool:
    """Whether a process is running; it may exist as a zombie after its end."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    status = Path(f"/proc/{process}/stat")
    return not status.exists() or status.read_text().rpartition(")")[2].split()[0] != "Z"


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_the_process_ignores_what_the_training_handles_and_ends_with_it(tmp_path):
    script = tmp_path / "training.py"
    script.write_text(TRAINING)
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    training = subprocess.Popen([sys.executable, script], env=environment(), **pipes)
    player = int(training.stdout.readline())
    for number in (signal.SIGINT, signal.SIGTERM):
        os.kill(player, number)
    time.sleep(0.2)
    assert is_there(player)
    training.kill()
    training.communicate()
    deadline = time.monotonic() + 30
    while is_there(player) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not is_there(player)
