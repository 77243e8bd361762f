"""Make the folder of a new run; it replaces nothing but a run, and only if `overwrite` is set."""

import json
import os
import shlex
import sys
from dataclasses import asdict, replace
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from sfmrl.config import Config, ConfigError, Untrusted, as_typed
from sfmrl.own_code.trust import code_digest
from sfmrl.rewards import reward_terms
from sfmrl.runs.bits import versions
from sfmrl.runs.files import SUMS, DamagedFile, digest_of, read_checked, read_sums, remove, write_together
from sfmrl.runs.folders import (
    DEMONSTRATIONS,
    FIRST,
    LOCK,
    MAP,
    RUNS,
    WEIGHTS,
    as_options,
    as_words,
    files_of_run,
    finished,
    in_training,
    kind_of,
    leftovers,
    locked,
    run_folders,
    why_unfinished,
)
from sfmrl.runs.run import Run, open_run
from sfmrl.runs.weights import find_weights, load_weights, model_names
from sfmrl.scenes import DRAWN, parse_mix, sample_scenes
from sfmrl.states import column_names
from sfmrl.variants import VARIANTS, make_config
from sfmrl.world import reset, transition


def create_run(  # type: ignore[return]  # its loop over count(1) ends by a return alone
    kind: str,
    config: Config,
    folder: Path | None,
    imitation: Path | None = None,
    *,
    overwrite: bool = False,
    go_on: bool = False,
    **facts: Any,
) -> Run:
    """Make a run folder: `folder`, or a new one under runs/ named after kind, variant and seed.

    If `folder` holds a run, `overwrite` replaces it, and `go_on` opens it if it has the same config. `imitation` is the
    run that this one starts from; its path is stored relative to the new folder, so that both can be moved together.
    `facts` go into run.json. Raises ConfigError if the folder cannot be used, or the config names an unknown
    environment, or a reward that is unknown or fails.
    """
    check_names(config)
    if go_on and folder is not None and kind_of(folder):
        return open_same(folder, kind, config)
    facts = {
        "kind": kind,
        "variant": variant_name(config),
        "created": datetime.now(UTC).isoformat(),
        "command": shlex.join(["sfmrl", *sys.argv[1:]]),
        "versions": versions(),
        "own_reward": code_digest(config.reward.reward),
        **facts,
    }
    files = {"config.json": config.to_json()}
    if (environment := config.reinforcement.environment).startswith(DRAWN):
        files[MAP] = environment.removeprefix(DRAWN).replace("/", "\n") + "\n"
    name = f"{kind}-{variant_name(config)}-seed{config.seed}"
    for number in count(1):
        place = folder or RUNS / (name if number == 1 else f"{name}-{number}")
        facts["imitation"] = imitation and _from(place, imitation)
        try:
            _make(place, files | {"run.json": json.dumps(facts, indent=2)}, overwrite)
        except ConfigError:
            if folder:
                raise
            continue  # another run has this name
        return replace(open_run(place), config=config)  # the user named this config's reward: it is trusted


def variant_name(config: Config) -> str:
    """The paper's name for a config's reward, state and environments, or a description if it has none."""

    def chosen(config: Config) -> tuple:
        return config.reward, config.forces, config.reinforcement.environment

    for name in VARIANTS:
        if chosen(config) == chosen(make_config(config.preset, name)):
            return name
    reward = config.reward.reward.rpartition(":")[2]
    return f"custom-{reward}{'-forces' if config.forces else ''}"


def _from(folder: Path, path: Path) -> str:
    """The path as seen from a folder, with slashes on every system."""
    try:
        return Path(os.path.relpath(path, folder)).as_posix()
    except ValueError:  # on Windows, on another drive
        return path.resolve().as_posix()


def check_names(config: Config) -> None:
    """Raise ConfigError if the config names an environment or a reward that does not exist, or a reward that fails."""
    schedule = config.reinforcement
    for environment in (config.imitation.environment, schedule.environment, schedule.test_environment):
        parse_mix(environment)
    reward_terms(config.reward)(transition(reset(sample_scenes("1", 2), config.simulation), np.zeros((2, 2))))


def _make(folder: Path, files: dict[str, str], overwrite: bool) -> None:
    """Write the first files of a new run to a folder; raises ConfigError if it must not be replaced."""
    _check_replaceable(folder, overwrite)
    folder.mkdir(parents=True, exist_ok=True)
    with locked(folder):
        _check_replaceable(folder, overwrite)  # another process may have made a run in the meantime
        if MAP in _listed(folder):
            remove(folder / MAP)
        elif MAP in files and (folder / MAP).exists():
            raise ConfigError(f"{folder / MAP} does not belong to the run; move it away, or name another --run")
        # First SHA256SUMS: if this is interrupted, the old run can no longer be opened, but it can still be replaced.
        remove(folder / SUMS)
        for path in files_of_run(folder):
            if path.name not in FIRST:
                remove(path)
        write_together(folder, {name: text.encode() for name, text in files.items()})


def _check_replaceable(folder: Path, overwrite: bool) -> None:
    """Raise ConfigError if the folder holds anything but a run, or a run that must not be replaced."""
    if not folder.exists():
        return
    if kind_of(folder) is None:
        if folder.is_dir() and _counts_as_empty(folder):
            return
        spared = ", so --overwrite leaves it alone" if overwrite else ""
        raise ConfigError(f"{folder} already exists, and is not a run folder{spared}; name another --run")
    if overwrite:
        return
    if in_training(folder):
        raise ConfigError(f"{folder} is being trained by another process; name another --run")
    ways = ["name another --run", "replace it with --overwrite"]
    if not finished(folder):
        ways.append(f"resume it with --resume {as_words(folder)}")
    raise ConfigError(f"{folder} already exists; {', or '.join(ways)}")


def _counts_as_empty(folder: Path) -> bool:
    """Whether a folder holds at most the remains of a run that was killed before it wrote its run.json."""
    names = {path.name for path in folder.iterdir()} - {path.name for path in leftovers(folder)} - {LOCK}
    if not names:
        return True
    listed = _listed(folder)
    return bool(listed) and listed <= set(FIRST) and names <= {SUMS, *listed} - {"run.json"}


def _listed(folder: Path) -> set[str]:
    """The names in a folder's SHA256SUMS; none if that file is damaged."""
    try:
        return set(read_sums(folder))
    except DamagedFile:
        return set()


def open_same(folder: Path, kind: str, config: Config, remedy: str = "name another --run") -> Run:
    """Open the run in a folder; raises ConfigError, naming a setting and the `remedy`, if it has another config."""
    run = open_run(folder, kind)
    for pair in zip(run.config.to_json().split("\n"), config.to_json().split("\n"), strict=True):
        begun, asked = (line.strip(" ,") for line in pair)
        if begun != asked:
            raise ConfigError(f"{folder} was begun with {begun}, not {asked}; {remedy}")
    return replace(run, config=config)


def start_run(config: Config, source: Path | None, from_scratch: bool, folder: Path | None, **existing: Any) -> Run:
    """Make the folder of a reinforcement run that starts from `source`, or with `from_scratch` from nothing.

    `source` is an imitation run, by default the newest with the same preset, seed and simulation (its reward and state
    may differ), a weights file or a model's name: from these the training starts with the network's weights and its
    `value_prior`, without demonstrations. `existing` is passed to `create_run`. Raises ConfigError, with what to type,
    if no source fits.
    """
    check_names(config)  # first: the imitation run that the next error may ask for takes minutes to make
    if source is not None and not source.exists() and str(source) in model_names():
        source = find_weights(str(source))
    if existing.get("go_on") and folder is not None and kind_of(folder):
        return _started(config, source, from_scratch, folder)
    if from_scratch:
        return create_run("rl", config, folder, **existing)
    source = source or _newest_fitting(config)
    if folder is not None and folder.resolve() in (source.resolve(), source.resolve().parent):
        raise ConfigError(f"--run {folder} would replace {source}, from which the training starts; name another --run")
    if source.is_file():
        config, weights = _start_from_weights(config, source)
        return create_run("rl", config, folder, **existing, weights=weights)
    imitation = open_run(source, "il")
    if not finished(source):
        raise ConfigError(why_unfinished(source))
    if imitation.config.simulation != config.simulation:
        raise ConfigError(f"the demonstrations of {source} come from another simulation; name another --from")
    config = replace(config, imitation=imitation.config.imitation)
    for name in (DEMONSTRATIONS, WEIGHTS):
        read_checked(source / name)  # raises now, before anything is replaced
    demonstrations = read_sums(source)[DEMONSTRATIONS]
    return create_run("rl", config, folder, source, **existing, demonstrations=demonstrations)


def _started(config: Config, source: Path | None, from_scratch: bool, folder: Path) -> Run:
    """The run in `folder`, begun with this config and `source`, if one is named; the source may be gone by now."""
    begun = open_run(folder, "rl")
    weights = begun.facts.get("weights")
    begun_from = Path(weights["file"]) if weights else begun.imitation
    same = source is not None and begun_from is not None and source.resolve() == begun_from.resolve()
    if (source and not same) or (from_scratch and begun_from):
        asked, begun_with = source or "scratch", begun_from or "scratch"
        raise ConfigError(f"{folder} was begun from {begun_with}, not from {asked}; name another --run")
    prior = begun.config.value_prior if weights else config.value_prior
    return open_same(folder, "rl", replace(config, imitation=begun.config.imitation, value_prior=prior))


def _start_from_weights(config: Config, source: Path) -> tuple[Config, dict[str, str]]:
    """The config of a training that starts from a weights file; for run.json the file, its digest, and what differs.

    Compared are the reward and the simulation; CrowdNav's files do not state theirs.
    """
    network, trained = load_weights(source)
    if network.forces != config.forces:
        columns, here = (len(column_names(forces)) for forces in (network.forces, config.forces))
        remedy = "--forces" if network.forces else "--no-forces, and a variant without"
        raise ConfigError(f"{source} reads {columns} columns, but this training has {here}; choose {remedy}")
    config = replace(config, value_prior=network.value_prior)
    facts = {"file": str(source.resolve()), "sha256": digest_of(source)}
    theirs, ours = ({"reward": c.reward.reward} | asdict(c.simulation) for c in (trained, config))
    differ = [name for name in theirs if theirs[name] != ours[name]]
    if differ and isinstance(trained.reward.reward, Untrusted):  # else it is CrowdNav's
        tasks = {"trained_with": theirs, "goes_on_with": ours}
        facts |= {key: as_typed(as_options({name: task[name] for name in differ})) for key, task in tasks.items()}
    return config, facts


def _newest_fitting(config: Config) -> Path:
    """The newest finished imitation run that fits this config; raises ConfigError, with what to type, without one."""
    for folder in filter(finished, run_folders("il")):
        try:
            made = open_run(folder).config
        except DamagedFile as error:
            raise DamagedFile(f"{error}, or name a run with --from") from None
        except ConfigError:  # of an earlier version
            continue
        if all(getattr(made, name) == getattr(config, name) for name in ("preset", "seed", "simulation")):
            return folder
    flags = as_typed(as_options({"preset": config.preset, "seed": config.seed} | unusual_simulation(config)))
    raise ConfigError(
        f"no finished imitation run fits ({flags}): type sfmrl il {flags}, name a run with --from, or start without "
        "imitation with --from-scratch"
    )


def unusual_simulation(config: Config) -> dict[str, Any]:
    """The settings of a config's simulation that differ from those of its preset, by name."""
    usual = asdict(make_config(config.preset).simulation)
    return {name: value for name, value in asdict(config.simulation).items() if value != usual[name]}
