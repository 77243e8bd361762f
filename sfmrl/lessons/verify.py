"""Check a run folder: its files by their digests, and its weights by playing test episodes again.

Forged digests can pass the first check, but not the second.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from statistics import fmean
from typing import Any

from sfmrl.config import ConfigError, counted
from sfmrl.evaluation import RATES
from sfmrl.fast import kernels
from sfmrl.lessons import Finding
from sfmrl.lessons.rerun import Disagreement, Rerun, outcomes, result_of
from sfmrl.own_code import UntrustedReward
from sfmrl.own_code.trust import code_digest, trusted
from sfmrl.runs.bits import versions
from sfmrl.runs.files import SUMS, DamagedFile, digest_of, read_regular, read_sums, read_table
from sfmrl.runs.folders import BEST, CHECKPOINT, DEMONSTRATIONS, MAP, WEIGHTS, finished, why_unfinished
from sfmrl.runs.progress import Progress
from sfmrl.runs.run import Run, open_run
from sfmrl.runs.weights import load_weights
from sfmrl.scenes import DRAWN

TOLERANCE = 0.05  # share of episodes that may end differently where this machine does not compute the bits of the run
MALFORMED = (ValueError, TypeError, AttributeError, LookupError, ArithmeticError)  # errors on unexpected content


def verify(
    folder: Path,
    episodes: int,
    tolerance: float | None,
    threads: int,
    progress: Progress,
    *,
    trust_reward: bool = False,
) -> Iterator[Finding]:
    """Yield findings on a run folder; at most `episodes` test episodes, or demonstrations, are played again.

    `tolerance` is the share of them that may end differently: by default none, or `TOLERANCE` where this machine does
    not compute the bits of the run. A reward that is Python code is run only with `trust_reward`, and if it is the file
    that the run was trained with. Raises ConfigError where there is no run folder.
    """
    require_run(folder)
    yield _finding(SUMS, _sums, folder)
    try:
        run = open_run(folder)
    except (ConfigError, DamagedFile, *MALFORMED, OSError) as error:
        yield Finding("run.json", False, f"the run cannot be opened, so no more is checked: {error}")
        return
    yield _finding("training", _finished, run)
    yield _finding("tables", _tables, run)
    yield _finding(WEIGHTS, _weights, run)
    if ":" in run.config.reward.reward:
        own = _finding("reward", _own_reward, run, trust_reward)
        yield own
        run = replace(run, config=trusted(run.config, own.ok is True))
    here = _finding("versions", _versions, run)
    yield here
    if tolerance is None:
        tolerance = 0.0 if here.ok else TOLERANCE
    rerun = Rerun(episodes, tolerance, threads, progress, here.ok is True)
    if run.kind == "il":
        yield _finding("demonstrations", rerun.demonstrations, run)
    else:
        yield from _reinforcement(run, rerun)


def require_run(folder: Path) -> None:
    """Raise ConfigError if a folder holds no run, not even a damaged one."""
    if not (folder / "run.json").exists() and not (folder / SUMS).exists():
        open_run(folder)  # raises ConfigError, which says what it is instead


def _reinforcement(run: Run, rerun: Rerun) -> Iterator[Finding]:
    """Yield findings on what only a reinforcement run has."""
    yield _finding("imitation", _began, run)
    yield _finding("result.json", _rates, run)
    yield _finding("replay", rerun.tests, run)
    whole = run.config.reinforcement.test_episodes
    if run.config.planner.recover and rerun.episodes >= whole:
        yield _finding("recovery", rerun.recovery, run)
    elif run.config.planner.recover:
        yield Finding("recovery", None, f"its test was not played again; add --episodes {whole} for that")


def _finding(what: str, check: Callable[..., str | Finding], *given: Any) -> Finding:
    """Run a check and return its finding; an error in the check is a finding that the run does not agree."""
    try:
        said = check(*given)
        return said if isinstance(said, Finding) else Finding(what, True, said)
    except FileNotFoundError as error:
        return Finding(what, False, f"there is no {Path(error.filename or what).name}")
    except UntrustedReward:
        return Finding(what, None, "not checked: the network chooses by its reward, which was not run")
    except (Disagreement, ConfigError, DamagedFile, OSError) as error:
        return Finding(what, False, str(error))
    except MALFORMED as error:
        return Finding(what, False, f"not as sfmrl writes it: {type(error).__name__}: {error}")


def _sums(folder: Path) -> str:
    """Every listed file is what was written, and those that must be listed are."""
    sums, bad = read_sums(folder), []
    for name, digest in sums.items():
        path = folder / name
        if Path(name).name != name or not path.is_file():
            if not CHECKPOINT.fullmatch(name):  # a training may have been killed while it removed its checkpoints
                bad.append(f"{name} is listed but missing")
        elif digest_of(path) != digest:
            bad.append(f"{name} is not what was written")
    must = ("config.json", "run.json", WEIGHTS, BEST, DEMONSTRATIONS)
    bad += [f"{name} is not listed" for name in must if (folder / name).exists() and name not in sums]
    if read_regular(folder / SUMS).count(b"\n") != len(sums):
        bad.append("it has lines that list no file")
    if bad:
        raise Disagreement("; ".join(bad))
    return f"all {len(sums)} files are what was written"


def _finished(run: Run) -> str:
    if not finished(run.folder):
        raise Disagreement(why_unfinished(run.folder))
    return f"sfmrl {run.kind}, variant {run.facts['variant']}, begun {run.facts['created'][:16]}, is finished"


def _tables(run: Run) -> str:
    """Every table that the run must have is listed in SHA256SUMS."""
    must, listed = ["metrics.csv"], read_sums(run.folder)
    if run.kind == "rl":
        settings = run.config.reinforcement
        must += ["validation.csv", "test.csv", "result.json"]
        must += [MAP] if settings.environment.startswith(DRAWN) else []
    if missing := [name for name in must if name not in listed]:
        raise Disagreement(f"not listed in {SUMS}: {', '.join(missing)}")
    return f"{', '.join(must)} are listed in {SUMS}"


def _weights(run: Run) -> str:
    network, config = load_weights(run.folder / WEIGHTS)  # which holds only finite numbers
    if config != run.config:
        raise Disagreement("the config in it differs from config.json")
    return f"{len(network.flat):,} parameters, all finite, trained under config.json"


def _own_reward(run: Run, trust: bool) -> str | Finding:
    """A user's reward exists and has not changed; without `trust`, it is not judged and must not be run."""
    name, digest = run.config.reward.reward, run.facts["own_reward"]
    file = name.rpartition(":")[0]
    missing = not Path(file).is_file() if file.endswith(".py") else digest and code_digest(name) is None
    if missing and not trust:
        said = f"{file} was not found, so the network was not played; put it back, then add --trust-reward"
        return Finding("reward", None, said)
    if digest is None and file.endswith(".py"):
        raise Disagreement(f"run.json has no SHA-256 of {name}, so it is not run")
    if digest != code_digest(name):
        raise Disagreement(f"{name} is not the file that the run was trained with; put that one there")
    if not trust:
        said = f"{name} was not run"
        if run.kind == "rl":
            said += ", which leaves unchecked that the network does what test.csv and result.json say"
        return Finding("reward", None, f"{said}; read that code, then add --trust-reward")
    return f"{name} is what the run was trained with" if digest else f"{name} is in no file, and was not compared"


def _versions(run: Run) -> str | Finding:
    """This machine computes the bits of the one that the run was made on, as far as a short test can tell."""
    made, here = run.facts["versions"], versions()
    if run.kind == "rl" and "bits" in (result := result_of(run)):  # of the machine on which the training ended
        made = made | {"bits": result["bits"]}
    if all(made.get(name) == here[name] for name in ("sfmrl", "bits")):
        if kernels() == "unknown":
            return Finding("versions", None, "NumPy does not use OpenBLAS here: some episodes may end differently")
        return f"sfmrl {here['sfmrl']} and bits {here['bits']}, the run's own: episodes must end as they did"
    differ = [name for name in ("sfmrl", "bits", "numpy", "processor") if made.get(name) != here[name]]
    said = "; ".join(f"{name} {made.get(name, 'unknown')}, here {here[name]}" for name in differ)
    return Finding("versions", None, f"{said}: some episodes may end differently here")


def _began(run: Run) -> str | Finding:
    """The training began with the demonstrations of the imitation run that it names."""
    source = run.imitation
    if weights := run.facts.get("weights"):
        return f"none: it started from {Path(weights['file']).name}, SHA-256 {weights['sha256']}"
    if source is None:
        return "none: trained from scratch"
    if not (source / SUMS).exists():
        return Finding("imitation", None, f"{source.name}, from which this run started, is not beside it")
    if read_sums(source).get(DEMONSTRATIONS) != run.facts["demonstrations"]:
        raise Disagreement(f"it started from other demonstrations than {source.name} holds")
    return f"it started from the demonstrations of {source.name}"


def _rates(run: Run) -> str:
    """The rates in result.json are those of its tables and of its lists of failures."""
    result, whole = result_of(run), run.config.reinforcement.test_episodes
    rows = read_table(run.folder / "test.csv")
    tested = [row["outcome"] for row in rows]
    sources = [(result, "its failures", outcomes(result, whole)), (result, "test.csv", tested)]
    for name, part in result.get("environments", {}).items():
        there = [row["outcome"] for row in rows if row["environment"] == name]
        sources.append((part, f"environment {name} in test.csv", there))
    if recovering := result.get("with_recovery"):
        sources += [(recovering, "its failures", outcomes(recovering, whole))]
    for rates, source, ends in sources:
        count = rates["episodes"]
        if len(ends) != count or any(round(rates[rate] * count) != ends.count(rate) for rate in RATES):
            raise Disagreement(f"its rates are not those of {counted(len(ends), 'episode')} in {source}")
    means = {"navigation_time": [float(row["time"]) for row in rows if row["outcome"] == "success"]}
    means["total_reward"] = [float(row["total_reward"]) for row in rows]
    for name, values in means.items():
        equal = math.isclose(result[name], fmean(values)) if values else result[name] is None
        if not equal:
            raise Disagreement(f"its {name} is not the mean in test.csv")
    return ", ".join(f"{name} {result[name]:.3f}" for name in RATES)
