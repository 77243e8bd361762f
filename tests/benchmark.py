"""How fast is sfmrl here: `python tests/benchmark.py`. Rates, and ratios to compiled RVO2 (pyrvo) from the same run.

Nothing is asserted: machines differ, and so do their other users. Compare the ratios, not the seconds. Sections can be
named: `python tests/benchmark.py simulator scaling network episodes evaluation training`.
"""

import platform
import resource
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np
import pyrvo
import torch
from rich.console import Console

from sfmrl import episodes
from sfmrl.actions import ACTIONS
from sfmrl.config import Config, Reward, Simulation
from sfmrl.episodes import Record, play_episodes
from sfmrl.evaluation import evaluation_record
from sfmrl.exploration import remember
from sfmrl.fast import as_fast, kernels
from sfmrl.imitation import Fit, demonstrate, fill_memory, fit_memory, make_memory
from sfmrl.learning import OPTIMIZERS, Learner, learn
from sfmrl.lookahead import SarlPolicy
from sfmrl.network import ValueNetwork
from sfmrl.placement import BARRIER
from sfmrl.policies import available_cores, orca_policy
from sfmrl.recovery import RecoveringPolicy
from sfmrl.recovery.planner import plan
from sfmrl.runs.create import create_run, start_run
from sfmrl.runs.explorer import Explorer
from sfmrl.runs.progress import StopSignal
from sfmrl.runs.training import run_imitation, run_reinforcement
from sfmrl.scenes import Scenes, sample_scenes
from sfmrl.variants import make_config
from sfmrl.world import CROWDS, advance, crowd_velocities, reset

console = Console(highlight=False, soft_wrap=True)
SCENES = ("10 humans", "10 humans, barrier", "5 humans, barrier")
CORES = available_cores()


def main() -> None:
    """Print the sections that are named on the command line, or all."""
    versions = f"numpy {np.__version__} with OpenBLAS's {kernels()} kernels, torch {torch.__version__}"
    console.print(f"{platform.machine()}, {CORES} cores, {versions}")
    torch.set_num_threads(1)
    sections = (simulator, scaling, network, episodes_of_training, evaluation, training)
    names = {section.__name__.partition("_")[0]: section for section in sections}
    for name in sys.argv[1:] or names:
        names[name]()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    console.print(f"\npeak memory {peak:.2f} GiB")


def simulator() -> None:
    """Environment steps per second, ORCA driving everybody, beside RVO2's own step on the same moments."""
    console.print(
        "\n[bold]simulator[/bold], one core; real episodes from start to end; microseconds a step and its phases"
    )
    table(
        "scene", "E", "steps/s", "step", "ORCA", "sampling", "collisions", "rewards", "RVO2", "RVO2/ORCA", "RVO2/step"
    )
    for title in SCENES:
        for batch in (1, 64, 256):
            whole, parts, record = played(lambda title=title, batch=batch: scenes_of(title, batch), batch)
            rvo2 = rvo2_microseconds(record)
            row(title, batch, 1e6 / whole, whole, *parts.values(), rvo2, rvo2 / parts["ORCA"], rvo2 / whole)


def scaling() -> None:
    """How the cost of an agent's step changes with the number of episodes and of agents."""
    console.print("\n[bold]scaling[/bold], one core; circle of 10 humans; microseconds a step")
    table("", "E", "step", "ORCA")
    for batch in (1, 4, 16, 64, 256, 1024):
        whole, parts, _ = played(lambda batch=batch: scenes_of("10 humans", batch), batch)
        row("", batch, whole, parts["ORCA"])
    console.print("\nwalkers on a square of 1.5 m each, to places drawn at random; microseconds an agent's step")
    table("humans", "E", "ORCA", "RVO2", "RVO2/ORCA", "peak, GiB")
    for humans in (5, 10, 20, 50, 100, 200):
        batch = 64 if humans < 100 else 16
        _, parts, record = played(lambda humans=humans, batch=batch: walkers(humans, batch), batch)
        rvo2 = rvo2_microseconds(record, 300)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        row(str(humans), batch, parts["ORCA"] / (humans + 1), rvo2 / (humans + 1), rvo2 / parts["ORCA"], peak)


def played(scenes: Callable[[], Scenes], batch: int) -> tuple[float, dict[str, float], Record]:
    """Microseconds of a step in all and in its parts, the best of three, and the record."""
    spent = {}

    def timed(part: str, plain: Callable) -> Callable:
        def work(*args: object, **options: object) -> object:
            start = time.perf_counter()
            result = plain(*args, **options)
            spent[part] += time.perf_counter() - start
            return result

        return work

    plain = CROWDS["orca"], episodes.transition, episodes.rewards_of
    CROWDS["orca"] = timed("ORCA", plain[0])
    episodes.transition, episodes.rewards_of = timed("collisions", plain[1]), timed("rewards", plain[2])
    results = []
    for _ in range(3):
        spent = dict.fromkeys(("ORCA", "sampling", "collisions", "rewards"), 0.0)
        start = time.perf_counter()
        sampled = timed("sampling", scenes)()
        record = play_episodes(sampled, orca_policy, Reward(), Simulation(), batch=batch)
        whole, steps = time.perf_counter() - start, record.steps.sum()
        results.append((whole / steps * 1e6, {part: seconds / steps * 1e6 for part, seconds in spent.items()}))
    CROWDS["orca"], episodes.transition, episodes.rewards_of = plain
    return *min(results, key=lambda result: result[0]), record


def scenes_of(title: str, batch: int) -> Scenes:
    """The paper's environment 2, or a circle crossing, on request with environment 2's barrier in the middle."""
    count = {1: 5, 4: 12, 16: 48, 64: 200, 1024: 2048}.get(batch, 800)
    if title == "5 humans, barrier":
        return sample_scenes("2", count)
    circle = sample_scenes("circle", count)
    if title == "10 humans":
        return circle
    squares = np.broadcast_to(BARRIER, (count, 5, 2))
    start, goal = (np.concatenate((points, squares), axis=1) for points in (circle.start, circle.goal))
    return Scenes(start, goal, square=np.arange(16) > 10)


def walkers(humans: int, count: int) -> Scenes:
    """People and a robot on a grid, each bound for a place of another grid."""
    side = int(np.ceil(np.sqrt(humans + 1)))
    grid = 1.5 * np.stack(np.meshgrid(np.arange(side), np.arange(side)), -1).reshape(-1, 2)
    rng = np.random.default_rng(0)
    places = np.array([[rng.permutation(grid)[: humans + 1] for _ in range(2)] for _ in range(count)])
    return Scenes(places[:, 0] + rng.uniform(-0.2, 0.2, places[:, 0].shape), places[:, 1])


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
        for who in np.flatnonzero(~world.square[moment] & ~np.isnan(world.position[moment, :, 0])):
            agent = sim.add_agent(tuple(world.position[moment, who].tolist()))
            sim.set_agent_velocity(agent, tuple(world.velocity[moment, who].tolist()))
            sim.set_agent_pref_velocity(agent, tuple(preferred[moment, who].tolist()))
        start = time.perf_counter()
        sim.do_step()
        spent.append(time.perf_counter() - start)
    return float(np.mean(spent)) * 1e6


def network() -> None:
    """Batches a second and microseconds a state: at the peak of matrix products, and by torch from the definition."""
    peak = gemm_peak()
    console.print(
        "\n[bold]network[/bold], 10 elements, 13 columns, one core; limit: its operations at the peak of matrix "
        f"products, {peak / 1e9:.0f} GFLOP/s; torch: by autograd"
    )
    module, rng = ValueNetwork(), np.random.default_rng(0)
    fast = as_fast(module)
    for size in (100, 200):
        states, values = rng.normal(size=(size, 10, 13)).astype(np.float32), rng.random(size, dtype=np.float32)
        optimizer = OPTIMIZERS["sgd"](fast)
        ours = fastest(partial(repeat_20, learn, fast, optimizer, 1e-3, states, values), 10) / 20
        tensors, plain = (torch.from_numpy(states), torch.from_numpy(values)), torch.optim.SGD(module.parameters())
        theirs = fastest(partial(repeat_20, torch_step, module, plain, *tensors), 10) / 20
        console.print(
            f"  a batch of {size}: {ours * 1e3:.2f} ms, {1 / ours:.0f} a second; limit "
            f"{size * 3 * flops() / peak * 1e3:.2f} ms; torch {theirs * 1e3:.2f} ms"
        )
    states = rng.normal(size=(4, 81, 10, 13)).astype(np.float32)
    ours = fastest(lambda: [fast.evaluate(states) for _ in range(10)], 10) / (10 * 4 * 81)
    with torch.inference_mode():
        tensor = torch.from_numpy(states.reshape(-1, 10, 13))
        theirs = fastest(lambda: [module(tensor) for _ in range(10)], 10) / (10 * 4 * 81)
    console.print(
        f"  a state's value: {ours * 1e6:.2f} us; limit {flops() / peak * 1e6:.2f} us; torch {theirs * 1e6:.2f} us"
    )
    for threads in sorted({1, CORES}):
        console.print(f"  lookahead, a state, {threads} threads: {lookahead_seconds(threads) * 1e6:.2f} us")


def repeat_20(work: Callable[..., object], *given: object) -> None:
    """Do the same twenty times."""
    for _ in range(20):
        work(*given)


def torch_step(
    module: ValueNetwork, optimizer: torch.optim.Optimizer, states: torch.Tensor, values: torch.Tensor
) -> None:
    """A step of descent by torch, from the definition."""
    optimizer.zero_grad()
    torch.nn.functional.mse_loss(module(states), values).backward()
    optimizer.step()


def flops(elements: int = 10) -> float:
    """Floating-point operations of a state's way through the network; learning from it takes three times as many."""
    parameters = {name: p.numel() for name, p in ValueNetwork().named_parameters() if name.endswith("weight")}
    state = parameters["mlp2.2.weight"] + parameters["attention.0.weight"] / 2
    state += sum(size for name, size in parameters.items() if name.startswith("mlp3"))
    element = sum(parameters.values()) - state
    return 2.0 * (state + elements * element)


def gemm_peak() -> float:
    """Floating-point operations a second of a large matrix product, on one core."""
    a = np.random.default_rng(0).random((2048, 2048), dtype=np.float32)
    return 2 * 2048**3 / fastest(lambda: a @ a, 10)


def lookahead_seconds(threads: int) -> float:
    """Seconds a state of weighing up all actions in 32 episodes, all but the crowd's own step included."""
    world = reset(sample_scenes("circle", 32))
    for _ in range(8):
        moves = crowd_velocities(world)
        world = advance(world, moves, moves[:, 0])
    moves = crowd_velocities(world)
    policy = SarlPolicy(ValueNetwork(), make_config("paper"), threads)
    return fastest(lambda: policy.lookahead(world, moves), 10) / (32 * len(ACTIONS))


def episodes_of_training() -> None:
    """Seconds of an RL episode, with a network that imitation has taught."""
    console.print("\n[bold]episodes[/bold] of reinforcement: playing one, and the batches that follow it")
    circle = {"reinforcement": {"environment": "circle"}}
    for preset, parallel in (("paper", 1), ("paper", 10), ("quick", 32)):
        config = make_config(preset)
        if preset == "paper":
            config = make_config(preset, **circle, imitation={"episodes": 300, "epochs": 6})
        settings = config.reinforcement
        learner, aside = taught(config), settings.parallel > 1 and CORES > 1
        with Explorer(config, CORES - aside, aside) as explorer:
            ahead = explorer.start(learner.actor, range(parallel))
            times, steps = [], 0
            for number in range(1, 5 if parallel > 1 else 21):
                start = time.perf_counter()
                record, random_steps = ahead()
                remember(learner, record, random_steps)
                learner.renew_actor()
                ahead = explorer.start(learner.actor, range(number * parallel, (number + 1) * parallel))
                learner.learn(parallel * settings.batches)
                times.append((time.perf_counter() - start) / parallel)
                steps += record.steps.sum() / parallel
            ahead()
        # The first round is not counted: nothing has been played ahead of it.
        console.print(
            f"{preset} preset, {parallel} side by side, {settings.batches} batches of "
            f"{settings.batch_size}: {np.mean(times[1:]) * 1e3:.0f} ms an episode of {steps / len(times):.0f} steps"
        )


def taught(config: Config) -> Learner:
    """A learner after imitation."""
    memory, fit = make_memory(config), Fit(config)
    fill_memory(memory, demonstrate(config), config)
    list(fit_memory(fit, memory))
    return Learner(fit.network, memory, config)


def evaluation() -> None:
    """Test episodes of SARL, taught by imitation."""
    console.print("\n[bold]evaluation[/bold], SARL, 500 test episodes of table 1's mix")
    config = make_config("quick")
    alone = SarlPolicy(taught(config).network, config, CORES)
    for title, policy in (("alone", alone), ("with recovery", RecoveringPolicy(alone, config.planner))):
        start = time.perf_counter()
        record = evaluation_record(policy)
        took, steps = time.perf_counter() - start, record.steps.sum()
        console.print(f"{title}: {took:.1f} s, {steps / 500:.0f} steps an episode, {took / steps * 1e3:.2f} ms a step")
    planning = fastest(lambda: plan(record.scenes, config.planner))
    console.print(f"ways around squares: {planning * 2:.2f} ms an episode, {planning / took:.1%} of playing it")


def training() -> None:
    """Where the seconds of a quick training go."""
    console.print("\n[bold]training[/bold]: sfmrl il && sfmrl rl --reward sfm, and its parts")
    spent = {}

    @contextmanager
    def clock(title: str, total: int) -> Iterator[Callable[[int], None]]:
        start = time.perf_counter()
        yield lambda done: None
        spent[title] = spent.get(title, 0.0) + time.perf_counter() - start

    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        il = create_run("il", make_config(), Path(folder) / "il")
        with StopSignal() as stop:
            run_imitation(il, clock, stop)
            taught_after = time.perf_counter() - start
            spent_before, spent = spent, {}
            rl = start_run(make_config(variant="sarl-sfm2"), il.folder, False, Path(folder) / "rl")
            result = run_reinforcement(rl, clock, stop, lambda text: None, threads=CORES)
            whole = time.perf_counter() - start
    for title, parts, total in (("il", spent_before, taught_after), ("rl", spent, whole - taught_after)):
        rest = total - sum(parts.values())
        shown = ", ".join(f"{part} {seconds:.1f}" for part, seconds in (parts | {"the rest": rest}).items())
        console.print(f"{title}: {total:.1f} s: {shown}")
    settings = rl.config.reinforcement
    batches = settings.episodes * settings.batches * settings.batch_size * 3 * flops()
    console.print(
        f"in all {whole:.1f} s, success {result['success']:.3f}; learning is {batches / 1e12:.1f} TFLOP, "
        f"{batches / gemm_peak():.1f} s of one core at the peak of matrix products"
    )


def table(*heads: str) -> None:
    """The head of a table."""
    console.print(f"{heads[0]:18} {heads[1]:>4}" + "".join(f"{head:>11}" for head in heads[2:]))


def row(title: str, batch: int, *numbers: float) -> None:
    """A row of a table."""
    texts = (f"{number:,.0f}" if number >= 1000 else f"{number:.2f}" for number in numbers)
    console.print(f"{title:18} {batch:4}" + "".join(f"{text:>11}" for text in texts))


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
