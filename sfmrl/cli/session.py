"""What commands share: the options of commands that play test episodes, and suggestions of what to type next."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from sfmrl.cli import completion, options
from sfmrl.cli.console import err, say
from sfmrl.cli.options import number_option, option
from sfmrl.config import LARGEST_SEED, Config, ConfigError, Planner, Reward, Simulation, as_typed, counted, override
from sfmrl.runs.folders import as_options, newest_run
from sfmrl.variants import MIXES

ALL_READ = ("success", "collision", "discomfort_distance")
SFM_READS = (*ALL_READ, "discomfort_amplitude", "discomfort_decay", "k", "distance_weight")
READS = {  # the settings that each reward reads
    "crowd": (*ALL_READ, "discomfort_slope"),
    "sfm": SFM_READS,
    "sfm-discount": (*SFM_READS, "discount_start", "discount_rate"),
}


def exclude(given: dict[str, Any]) -> None:
    """Raise ConfigError if more than one option is given; `given` is flag -> value, None or False where it is not."""
    flags = [flag for flag, value in given.items() if value is not None and value is not False]
    if len(flags) > 1:
        raise ConfigError(f"{' and '.join(flags)} exclude each other; leave out one of them")


def check_planner(planners: Iterable[Planner], given: Iterable[str]) -> None:
    """Raise ConfigError if a setting of recovery is `given` although none of the `planners` has recovery."""
    needless = [name for name in given if name != "recover"]
    if needless and not any(planner.recover for planner in planners):
        raise ConfigError(f"--{needless[0].replace('_', '-')} changes nothing without recovery; add --recover")


def check_read(reward: Reward, given: Iterable[str]) -> None:
    """Raise ConfigError if the reward does not read one of the settings that the user has `given`."""
    for name in given:
        if reward.reward in READS and name not in ("reward", *READS[reward.reward]):
            readers = " or ".join(other for other, read in READS.items() if name in read)
            flag = name.replace("_", "-")
            text = f"--{flag} changes nothing with --reward {reward.reward}; leave it out, or choose {readers}"
            raise ConfigError(text)


def say_differing_settings(path: Path, config: Config) -> None:
    """Say where the files beside a CrowdNav checkpoint differ from this config."""
    from sfmrl.runs.crowdnav import differing_settings

    for note in differing_settings(path, config.simulation.robot_visible, config.simulation.kinematics):
        say(note)


def named_environment(map_file: Path | None, environment: str | None) -> str | None:
    """Return the environment that --map or --environment names; None if neither is given."""
    from sfmrl.maps import load_map

    exclude({"--map": map_file, "--environment": environment})
    return load_map(map_file) if map_file else environment


@dataclass(frozen=True)
class TestOptions:
    """The options of all commands that play test episodes."""

    environment: str | None = option(
        None,
        f"1 to 5, circle, circle5, square, square5, maps, {', '.join(MIXES)} or a mix such as 1:0.7,2:0.3 "
        "(default the policy's test mix)",
        autocompletion=completion.environments,
    )
    map_file: Path | None = options.MAP
    seed: int = number_option(0, "seed of the test episodes (default 0)", 0, LARGEST_SEED)
    humans: int | None = number_option(
        None, "number of humans, on a circle that widens above 10 (default the environment's own)", 0, 200
    )
    human_speed: float | None = number_option(
        None, "preferred speed of the humans, m/s (default 1; the robot's is 1)", 0, 10
    )
    overwrite: bool = options.OVERWRITE
    threads: int | None = options.THREADS
    trust_reward: bool = options.TRUST_REWARD

    @cached_property
    def place(self) -> str | None:
        """The environment that --map or --environment names; None if neither is given."""
        return named_environment(self.map_file, self.environment)

    @property
    def crowd(self) -> dict[str, Any]:
        """Those of --humans and --human-speed that are given."""
        given = {"humans": self.humans, "human_speed": self.human_speed}
        return {name: value for name, value in given.items() if value is not None}

    def where(self, config: Config) -> str:
        """Return the environment to play in: the one that is named, or the test environment of the config."""
        return config.reinforcement.test_environment if self.place is None else self.place

    def scene(self, environment: str, episode: int, config: Config) -> Any:
        """Return the scene of one test episode."""
        from sfmrl.scenes import sample_scenes

        crowd: dict[str, Any] = {"people": self.humans, "people_speed": self.human_speed}
        crowd["random_attributes"] = config.simulation.random_attributes
        return sample_scenes(environment, [episode], self.seed, **crowd)

    def choose(self, policy: str | None, settings: dict[str, Any]) -> tuple[Any, str, Config]:
        """Return the policy, by default the newest finished run, its name, and its config with settings changed.

        The reward that a network looks ahead with is run if it is sfmrl's, if --reward names it, or with
        --trust-reward.
        """
        (chosen,), (name,), config = self.choose_all([policy], settings)
        return chosen, name, config

    def choose_all(
        self, policies: Sequence[str | None], settings: dict[str, Any]
    ) -> tuple[list[Any], list[str], Config]:
        """Return policies and their names, as `choose` does, and the first one's config, whose reward judges all."""
        parts = [self._choose(policy, settings) for policy in policies]
        config = parts[0][2]
        check_read(config.reward, settings.get("reward", {}))
        check_planner([own.planner for _, _, own in parts], settings.get("planner", {}))
        return [policy for policy, _, _ in parts], [name for _, name, _ in parts], config

    def _choose(self, policy: str | None, settings: dict[str, Any]) -> tuple[Any, str, Config]:
        from sfmrl.own_code import names_code
        from sfmrl.policies import POLICIES, config_of, load_policy
        from sfmrl.recovery import with_recovery
        from sfmrl.runs.weights import find_weights, model_names

        if policy == "":
            raise ConfigError("the name of a policy is empty; name one, or leave it out to take the newest run")
        name = policy or str(newest_run(say))
        if not policy:
            say(f"policy: {name}")
        trust = self.trust_reward or settings.get("reward", {}).get("reward", False)
        chosen = load_policy(name, self.threads, trust_reward=trust)
        config = override(config_of(chosen), settings)
        if name not in (*POLICIES, *model_names()) and not names_code(name):
            say_differing_settings(find_weights(name), config)
        return with_recovery(chosen, config.planner), name, config

    def play(self, policies: Sequence[Any], config: Config, episodes: int, settings: dict[str, Any]) -> list[Any]:
        """Return the records of policies that play the same test episodes.

        Simulation, reward and discount are this config's.
        """
        from sfmrl.evaluation import evaluation_record
        from sfmrl.runs.progress import show_progress

        how: dict[str, Any] = {"environment": self.where(config), "episodes": episodes, "seed": self.seed}
        how |= {"people": self.humans, "people_speed": self.human_speed}
        how |= {"reward": config.reward, "discount": config.discount}
        records = []
        for policy in policies:
            with show_progress(err)("test", episodes) as advance:
                simulation = simulation_for(policy, config, settings)
                records.append(evaluation_record(policy, simulation=simulation, **how, progress=advance))
        return records

    def title(self, config: Config, episodes: int, settings: dict[str, Any]) -> str:
        """Say which episodes these are, and which settings of theirs were given."""
        from sfmrl.scenes import circle_of, label

        words = [f"map {self.map_file}" if self.map_file else f"environment {label(self.where(config))}"]
        if self.humans is not None:
            words.append(f"{counted(self.humans, 'human')} on a circle of {circle_of(self.humans):g} m")
        if self.human_speed is not None:
            words.append(f"humans at {self.human_speed:g} m/s")
        given = as_typed(as_options({name: value for name, value in settings.items() if name != "planner"}))
        return ", ".join([*words, counted(episodes, "episode"), f"seed {self.seed}", *([given] if given else [])])

    def facts(self, config: Config) -> dict[str, Any]:
        """Return, for JSON, which episodes these are."""
        return {"environment": self.where(config), "seed": self.seed} | self.crowd

    def replay_command(
        self, policy: str | None, config: Config, episode: int, settings: dict[str, Any], versus: str | None = None
    ) -> str:
        """Return what to type to see a test episode."""
        from sfmrl.scenes import label

        words: list[Any] = ["sfmrl", "ascii-render", *([policy] if policy else [])]
        words += ["--versus", versus] if versus else []
        if self.map_file:
            words += ["--map", self.map_file]
        elif self.place is not None or self.where(config) == label(self.where(config)):  # else a run has its own map
            words += ["--environment", self.where(config)]
        words += ["--seed", self.seed, "--episode", episode, *as_options(self.crowd | settings)]
        words += ["--trust-reward"] if self.trust_reward else []
        return as_typed(map(str, words))


def simulation_for(policy: Any, config: Config, settings: dict[str, Any]) -> Simulation:
    """Return the config's simulation with the robot that the policy was trained to drive, unless --kinematics is given.

    So a network for a unicycle and one for a holonomic robot can be compared in the same scenes.
    """
    own = getattr(policy, "config", None)
    if not isinstance(own, Config) or "kinematics" in settings.get("simulation", {}):
        return config.simulation
    return replace(config.simulation, kinematics=own.simulation.kinematics)


def setting_facts(config: Config, settings: dict[str, Any]) -> dict[str, Any]:
    """Return, for JSON, the reward that judges the episodes, and the settings that were given."""
    return {"reward": config.reward.reward, "settings": settings}


def code_facts(policies: list[str]) -> dict[str, Any]:
    """Return, for JSON, the SHA-256 of the Python files among the policies, {} if there are none."""
    from sfmrl.own_code import names_code
    from sfmrl.own_code.trust import code_digest

    digests = {name: code_digest(name) for name in policies if names_code(name)}
    return {"sha256": digests} if digests else {}
