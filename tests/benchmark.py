"""How fast is sfmrl here: `python tests/benchmark.py`. Rates, and ratios to compiled RVO2 (pyrvo) from the same run.

Nothing is asserted: machines differ, and so do their other users. Compare the ratios, not the seconds.
"""

import platform
import resource
import time
from collections.abc import Callable

import numpy as np
import pyrvo
import torch
from rich.console import Console

from sfmrl.config import Reward, Simulation
from sfmrl.crowd import CROWDS, World
from sfmrl.episodes import Record, play_episodes
from sfmrl.exploration import explore, remember
from sfmrl.imitation import demonstrate, fill_memory, make_memory
from sfmrl.learner import Learner
from sfmrl.learning import OPTIMIZERS, learn
from sfmrl.network import ValueNetwork
from sfmrl.placement import BARRIER
from sfmrl.policies import SarlPolicy, orca_policy
from sfmrl.progress import no_progress
from sfmrl.scenarios import Scenes, sample_scenes
from sfmrl.variants import make_config

console = Console(highlight=False, soft_wrap=True)
SCENES = ("10 humans", "10 humans, barrier", "5 humans, barrier")
CORES = torch.get_num_threads()


def main() -> None:
    """Print every section."""
    versions = f"numpy {np.__version__}, torch {torch.__version__}"
    console.print(f"{platform.machine()} {torch.backends.cpu.get_cpu_capability()}, {CORES} cores, {versions}")
    torch.set_num_threads(1)
    simulator()
    learning()
    evaluation()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    console.print(f"\npeak memory {peak:.2f} GiB")


def simulator() -> None:
    """Environment steps per second, ORCA driving everybody, beside RVO2's own step on the same moments."""
    console.print(
        "\n[bold]simulator[/bold], one core; real episodes from start to end; microseconds a step of one episode"
    )
    heads = ("scene", "E", "steps/s", "step", "of it ORCA", "RVO2's step", "RVO2/ORCA", "RVO2/step")
    console.print(f"{heads[0]:18} {heads[1]:>4}" + "".join(f"{head:>12}" for head in heads[2:]))
    for title in SCENES:
        for batch in (1, 64, 256):
            whole, orca, record = played(title, batch)
            rvo2 = rvo2_microseconds(record)
            numbers = f"{1e6 / whole:12,.0f}" + "".join(f"{number:12.1f}" for number in (whole, orca, rvo2))
            console.print(f"{title:18} {batch:4}{numbers}{rvo2 / orca:12.2f}{rvo2 / whole:12.2f}")


def played(title: str, batch: int) -> tuple[float, float, Record]:
    """Microseconds of a step in all and in ORCA, the best of three, and the record."""
    inside = 0.0

    def timed(world: World, *rest: object) -> np.ndarray:
        nonlocal inside
        start = time.perf_counter()
        velocity = plain(world, *rest)
        inside += time.perf_counter() - start
        return velocity

    plain, CROWDS["orca"] = CROWDS["orca"], timed
    results = []
    for _ in range(3):
        inside, start = 0.0, time.perf_counter()
        scenes = scenes_of(title, {1: 5, 64: 200}.get(batch, 800))
        record = play_episodes(scenes, orca_policy, Reward(), Simulation(), batch=batch)
        steps = record.steps.sum()
        results.append(((time.perf_counter() - start) / steps * 1e6, inside / steps * 1e6))
    CROWDS["orca"] = plain
    return *min(results), record


def scenes_of(title: str, episodes: int) -> Scenes:
    """The paper's environment 2, or a circle crossing, on request with environment 2's barrier in the middle."""
    if title == "5 humans, barrier":
        return sample_scenes("2", episodes)
    circle = sample_scenes("circle", episodes)
    if title == "10 humans":
        return circle
    squares = np.broadcast_to(BARRIER, (episodes, 5, 2))
    start, goal = (np.concatenate((points, squares), axis=1) for points in (circle.start, circle.goal))
    return Scenes(start, goal, square=np.arange(16) > 10)


def rvo2_microseconds(record: Record, moments: int = 2000) -> float:
    """Microseconds of compiled RVO2's own step at moments of a record, without what Python does around it."""
    spent = []
    world = record.take(np.arange(min(len(record.steps), 60))).worlds()
    preferred, squares = world.preferred_velocity, record.scenes.polygons
    for moment in np.unique(np.linspace(0, len(world) - 1, moments).astype(int)):
        sim = pyrvo.RVOSimulator(0.25, 10.0, 10, 5.0, 5.0, 0.31, 1.0)
        for corners in squares[world.episode[moment]]:
            if not np.isnan(corners).any():
                sim.add_obstacle([tuple(corner) for corner in corners.tolist()])
        sim.process_obstacles()
        for row in np.flatnonzero(~world.square[moment] & ~np.isnan(world.position[moment, :, 0])):
            agent = sim.add_agent(tuple(world.position[moment, row].tolist()))
            sim.set_agent_velocity(agent, tuple(world.velocity[moment, row].tolist()))
            sim.set_agent_pref_velocity(agent, tuple(preferred[moment, row].tolist()))
        start = time.perf_counter()
        sim.do_step()
        spent.append(time.perf_counter() - start)
    return float(np.mean(spent)) * 1e6


def learning() -> None:
    """Batches a second, and an RL episode of the paper's schedule."""
    console.print("\n[bold]learning[/bold]")
    network, rng = ValueNetwork(), np.random.default_rng(0)
    states = torch.from_numpy(rng.normal(size=(100, 10, 13)).astype(np.float32))
    values = torch.from_numpy(rng.random(100, dtype=np.float32))
    optimizer = OPTIMIZERS["sgd"](network)
    batch = fastest(lambda: [learn(network, optimizer, 1e-3, states, values) for _ in range(20)]) / 20
    console.print(f"batches of 100: {1 / batch:.0f} a second")
    for parallel in (1, 10):
        config = make_config("paper", reinforcement={"environment": "circle", "parallel": parallel})
        learner = Learner(ValueNetwork(), make_memory(config), config)
        config_il = make_config("paper", imitation={"episodes": 100})
        fill_memory(learner.memory, demonstrate(config_il, no_progress), config)
        policy = SarlPolicy(learner.network, config, CORES)

        def episodes(learner: Learner = learner, policy: SarlPolicy = policy, parallel: int = parallel) -> None:
            record, random_steps = explore(policy, learner.config, range(10, 10 + parallel))
            remember(learner, record, random_steps)
            learner.learn(parallel * 100)

        took = fastest(episodes, 2) / parallel
        console.print(f"RL episode of the paper's schedule, 10 humans, {parallel} side by side: {took:.3f} s")


def evaluation() -> None:
    """Test episodes of SARL."""
    policy = SarlPolicy(ValueNetwork(), make_config("paper"), CORES)
    scenes = sample_scenes("table1", 100)
    record: list[Record] = []
    took = fastest(lambda: record.append(play_episodes(scenes, policy, Reward(), Simulation())), 2)
    steps = record[-1].steps.sum()
    console.print(
        f"\n[bold]evaluation[/bold], SARL: 100 episodes ({steps} steps) in {took:.1f} s, "
        f"{took / steps / 81 * 1e6:.1f} us a state"
    )


def fastest(work: Callable[[], object], repeat: int = 3) -> float:
    """Seconds of the fastest of some repetitions."""
    times = []
    for _ in range(repeat):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


if __name__ == "__main__":
    main()
