"""A run that was handed in: what sfmrl left is found to agree, and whatever is changed in it is found out."""

import hashlib
import json
import re
import shutil
import tarfile
import zipfile
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from sfmrl.config import WINDOWS, Config, ConfigError
from sfmrl.evaluation import RATES
from sfmrl.lessons import Finding
from sfmrl.lessons.handed_in import runs_in, same_weights
from sfmrl.lessons.rerun import Disagreement, Rerun
from sfmrl.lessons.verify import TOLERANCE, verify
from sfmrl.network import ValueNetwork
from sfmrl.runs.create import create_run, start_run
from sfmrl.runs.files import csv_text, read_table, remove_checked, unlist
from sfmrl.runs.progress import StopSignal, no_progress
from sfmrl.runs.training import run_imitation, run_reinforcement
from sfmrl.runs.weights import load_weights, save_weights
from sfmrl.variants import make_config


@pytest.fixture(scope="module")
def handed_in(tmp_path_factory) -> Path:
    """A folder with an imitation run, "il", and a reinforcement that went on from it, "rl"; not to be changed."""
    folder = tmp_path_factory.mktemp("handed")
    config = make_config(
        simulation={"time_limit": 12.0},
        imitation={"episodes": 6, "epochs": 2, "environment": "circle5"},
        reinforcement={"episodes": 8, "parallel": 4, "batches": 1, "validation_interval": 4}
        | {"validation_episodes": 2, "test_episodes": 6},
    )
    il = create_run("il", config, folder / "il")
    run_imitation(il, no_progress, StopSignal())
    rl = start_run(config, folder / "il", False, folder / "rl")
    run_reinforcement(rl, no_progress, StopSignal(), lambda text: None)
    return folder


@pytest.fixture
def copy(handed_in: Path, tmp_path: Path) -> Path:
    """The same, to be changed."""
    return Path(shutil.copytree(handed_in, tmp_path / "copy"))


def findings(folder: Path, episodes: int = 6, tolerance: float | None = None, **how) -> dict[str, Finding]:
    return {found.what: found for found in verify(folder, episodes, tolerance, 1, no_progress, **how)}


def wrong(folder: Path, **how) -> set[str]:
    return {name for name, finding in findings(folder, **how).items() if finding.ok is False}


def rewrite(path: Path, change: Callable[[str], str]) -> None:
    text = path.read_text()
    changed = change(text)
    assert changed != text
    path.write_text(changed)


def forge_sums(folder: Path) -> None:
    """Digests anew of all that was listed, as a forger would."""
    names = [line.split("  ")[1] for line in (folder / "SHA256SUMS").read_text().splitlines()]
    lines = [f"{hashlib.sha256((folder / name).read_bytes()).hexdigest()}  {name}\n" for name in names]
    (folder / "SHA256SUMS").write_text("".join(lines))


def test_what_sfmrl_left_agrees(handed_in):
    found = findings(handed_in / "rl")
    assert {name for name, finding in found.items() if not finding.ok} == set()
    assert {"replay", "recovery", "tables", "imitation"} <= set(found)
    assert "with the same numbers" in found["replay"].said
    assert wrong(handed_in / "il") == set()
    assert "with the same numbers" in findings(handed_in / "il")["demonstrations"].said


def test_fewer_episodes_leave_the_recovery_s_test_untold(handed_in):
    found = findings(handed_in / "rl", episodes=3)
    assert found["replay"].said.startswith("3 of 6 test episodes")
    assert found["recovery"].ok is None
    assert "--episodes 6" in found["recovery"].said


def flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


TAMPERED = {
    "a bit of the weights": (
        lambda run: flip(run / "weights.npz"),
        {"SHA256SUMS", "weights.npz", "replay", "recovery"},
    ),
    "a bit of the config": (lambda run: flip(run / "config.json"), {"SHA256SUMS", "run.json"}),
    "no weights": (lambda run: (run / "weights.npz").unlink(), {"SHA256SUMS", "training", "weights.npz", "replay"}),
    "no tests": (lambda run: (run / "test.csv").write_text(""), {"SHA256SUMS", "result.json", "replay"}),
    "a lost table": (lambda run: (run / "validation.csv").unlink(), {"SHA256SUMS"}),
    "a validation": (
        lambda run: rewrite(run / "validation.csv", lambda text: re.sub(r"^8,[^,]*", "8,0.99", text, flags=re.M)),
        {"SHA256SUMS"},
    ),
    "a rate": (
        lambda run: rewrite(run / "result.json", lambda text: re.sub('("success": )', r"\g<1>1", text, count=1)),
        {"SHA256SUMS", "result.json", "recovery"},
    ),
    "no JSON": (lambda run: (run / "result.json").write_text("{"), {"SHA256SUMS", "result.json", "recovery"}),
    "not an object": (lambda run: (run / "result.json").write_text("[]"), {"SHA256SUMS", "result.json", "recovery"}),
}


@pytest.mark.parametrize("what", TAMPERED)
def test_what_was_changed_is_found_out(copy, what):
    tamper, names = TAMPERED[what]
    tamper(copy / "rl")
    assert names <= wrong(copy / "rl")


@pytest.mark.parametrize("everywhere", [False, True])
def test_forged_total_rewards_are_found_out(copy, everywhere):
    run = copy / "rl"
    rows, kept = read_table(run / "test.csv"), json.loads((run / "result.json").read_text())
    rows = [row | {"total_reward": float(row["total_reward"]) + 0.1} for row in rows]
    (run / "test.csv").write_text(csv_text(rows))
    if everywhere:
        kept["total_reward"] = float(np.mean([row["total_reward"] for row in rows]))
        (run / "result.json").write_text(json.dumps(kept))
    forge_sums(run)
    assert wrong(run) == ({"replay"} if everywhere else {"result.json", "replay"})


def test_tables_and_digests_forged_together_are_found_out_by_playing_again(copy):
    """One more success (or one less), in test.csv, or everywhere, with the digests computed anew."""
    run = copy / "rl"
    rows, kept = read_table(run / "test.csv"), json.loads((run / "result.json").read_text())
    k = next((k for k, row in enumerate(rows) if row["outcome"] != "success"), 0)
    rows[k]["outcome"] = "success" if rows[k]["outcome"] != "success" else "collision"
    (run / "test.csv").write_text(csv_text(rows))
    forge_sums(run)
    assert wrong(run) == {"result.json", "replay"}
    ends = [row["outcome"] for row in rows]
    kept |= {name: ends.count(name) / 6 for name in RATES}
    kept["total_reward"] = float(np.mean([float(row["total_reward"]) for row in rows]))
    times = [float(row["time"]) for row in rows if row["outcome"] == "success"]
    kept["navigation_time"] = float(np.mean(times)) if times else None
    kept["failures"] = [{"episode": n, "outcome": end} for n, end in enumerate(ends) if end != "success"]
    kept.pop("environments", None)
    (run / "result.json").write_text(json.dumps(kept))
    forge_sums(run)
    assert wrong(run) == {"replay"}
    assert f"({k})" in findings(run)["replay"].said
    assert wrong(run, tolerance=0.2) == set()


def test_other_weights_than_those_of_the_test_are_found_out_by_playing_again(copy):
    run = copy / "rl"
    _, config = load_weights(run / "weights.npz")
    save_weights(ValueNetwork(value_prior=True, seed=9), config, run / "weights.npz")
    assert "replay" in wrong(run)
    save_weights(ValueNetwork(value_prior=True), Config(value_prior=True), run / "weights.npz")
    assert "weights.npz" in wrong(run)


def test_demonstrations_that_orca_did_not_give_are_found_out(copy):
    run = copy / "il"
    rewrite(run / "config.json", lambda text: text.replace('"seed": 0', '"seed": 1'))
    forge_sums(run)
    assert wrong(run) == {"weights.npz", "demonstrations"}


def test_a_reward_in_a_python_file_is_run_only_if_trusted_and_unchanged(copy, tmp_path):
    """Without trust nothing runs, and what that leaves unchecked is not judged."""
    run, own, mark = copy / "rl", tmp_path / "own.py", tmp_path / "it-was-run"
    own.write_text(
        f"open({str(mark)!r}, 'a').close()\nfrom sfmrl.rewards import crowd_terms, total\n"
        "def same(transition, settings):\n    return total(crowd_terms(transition, settings))\n"
    )
    rewrite(run / "config.json", lambda text: text.replace('"reward": "crowd"', f'"reward": "{own}:same"'))
    digest = hashlib.sha256(own.read_bytes()).hexdigest()
    rewrite(run / "run.json", lambda text: text.replace('"own_reward": null', f'"own_reward": "{digest}"'))
    forge_sums(run)
    found = findings(run)
    assert not mark.exists()
    unjudged = {name for name, finding in found.items() if finding.ok is None}
    assert unjudged == {"reward", "replay", "recovery"}
    assert "was not run, which leaves unchecked that the network does what test.csv" in found["reward"].said
    trusting = findings(run, trust_reward=True)
    assert mark.exists()
    assert {trusting[name].ok for name in unjudged} == {True}
    mark.unlink()
    own.write_text(own.read_text() + "# changed\n")
    changed = findings(run, trust_reward=True)
    assert (changed["reward"].ok, changed["replay"].ok) == (False, None)
    assert not mark.exists()
    rewrite(run / "run.json", lambda text: text.replace(f'"own_reward": "{digest}"', '"own_reward": null'))
    forge_sums(run)
    assert findings(run, trust_reward=True)["reward"].ok is False
    assert not mark.exists()
    own.rename(tmp_path / "moved.py")
    gone = findings(run)
    assert {name for name, finding in gone.items() if finding.ok is None} == unjudged
    assert "put it back, then add --trust-reward" in gone["reward"].said


def remade(run: Path, change: Callable[[dict], object], tested: bool = True) -> dict[str, Finding]:
    """Findings on a run whose versions, and `tested` the bits of its test, are changed, with digests anew."""
    facts, result = (json.loads((run / name).read_text()) for name in ("run.json", "result.json"))
    change(facts["versions"])
    if tested:
        del result["bits"]
        result |= {name: value for name, value in facts["versions"].items() if name == "bits"}
    (run / "run.json").write_text(json.dumps(facts))
    (run / "result.json").write_text(json.dumps(result))
    forge_sums(run)
    return findings(run)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda made: made.update(bits="0123456789ab", numpy="1.0"), f"numpy 1.0, here {np.__version__}"),
        (lambda made: made.pop("bits"), "bits unknown, here "),
        (lambda made: made.update(sfmrl="0.0.1"), "sfmrl 0.0.1, here "),
    ],
    ids=["other bits", "from before bits were recorded", "another sfmrl"],
)
def test_a_run_from_a_machine_of_other_bits_is_told_and_allowed_for(copy, change, named):
    found = remade(copy / "rl", change)
    assert {name for name, finding in found.items() if finding.ok is False} == set()
    assert found["versions"].ok is None
    assert named in found["versions"].said


def test_equal_bits_make_the_numbers_equal_whatever_the_versions_and_wherever_the_training_began(copy):
    found = remade(copy / "rl", lambda made: made.update(numpy="1.0", processor="another"))
    assert found["versions"].ok is True
    found = remade(copy / "rl", lambda made: made.update(bits="0123456789ab"), tested=False)
    assert found["versions"].ok is True


def test_where_bits_differ_outcomes_and_times_are_held_to_a_tolerance():
    ends, steps = np.array(["success"] * 38 + ["timeout"] * 2), np.full(40, 40)
    other = Rerun(40, 0.05, 1, no_progress, alike=False)
    later = steps + 30 * (np.arange(40) < 15), steps + 3
    some_later, all_later = (SimpleNamespace(outcome=ends, steps=again) for again in later)
    with pytest.raises(Disagreement, match="15 of the first 40"):
        replace(other, tolerance=0.0, alike=True).judged("episodes", some_later, ends, steps)
    assert other.judged("episodes", some_later, ends, steps) == "40 episodes end as they did"
    with pytest.raises(Disagreement, match="a time that differs"):
        other.judged("episodes", all_later, ends, steps)


@pytest.mark.parametrize(
    ("bad", "tolerance", "right"), [(0, 0, True), (1, 0, False), (2, 0.05, True), (3, 0.05, False)]
)
def test_the_tolerance_is_a_share_of_the_episodes(bad, tolerance, right):
    rerun = Rerun(40, tolerance, 1, no_progress)
    again = SimpleNamespace(outcome=np.where(np.arange(40) < bad, "timeout", "success"))
    with nullcontext() if right else pytest.raises(Disagreement, match=f"{bad} of the first 40"):
        assert "40" in rerun.judged("episodes", again, np.array(["success"] * 40))


def test_tables_that_are_neither_there_nor_listed_are_missed(copy):
    run = copy / "rl"
    remove_checked([run / "test.csv"])
    unlist({"metrics.csv"}, run)
    found = findings(run)
    assert {name for name, finding in found.items() if finding.ok is False} == {"tables", "result.json", "replay"}
    assert found["tables"].said == "not listed in SHA256SUMS: metrics.csv, test.csv"
    assert found["replay"].said == "there is no test.csv"


def test_a_success_that_is_a_failure_on_file_is_found_out(copy):
    run = copy / "rl"
    whole = json.loads((run / "result.json").read_text())
    failures = whole["with_recovery"]["failures"]
    succeeded = min(set(range(6)) - {failure["episode"] for failure in failures})
    failures.append({"episode": succeeded, "environment": "1", "outcome": "collision"})
    (run / "result.json").write_text(json.dumps(whole))
    forge_sums(run)
    assert wrong(run) == {"result.json", "recovery"}


@pytest.mark.parametrize("name", ["SHA256SUMS", "run.json", "config.json", "metrics.csv", "validation.csv", "test.csv"])
@pytest.mark.parametrize("content", [b"", b"\xff\xfe\x00", b"null"], ids=repr)
def test_no_file_s_content_is_too_odd_to_be_told(copy, name, content):
    run = copy / "rl"
    (run / name).write_bytes(content)
    assert wrong(run, episodes=1)
    if name in ("run.json", "config.json"):
        forge_sums(run)
        assert wrong(run, episodes=1)


def test_a_sum_s_name_leads_nowhere_else(copy):
    run = copy / "rl"
    digest = hashlib.sha256((copy / "il" / "run.json").read_bytes()).hexdigest()
    with open(run / "SHA256SUMS", "a") as file:
        file.write(f"{digest}  ../il/run.json\n")
    assert "SHA256SUMS" in wrong(run)


def test_a_folder_that_is_no_run_is_an_error(tmp_path):
    with pytest.raises(ConfigError, match="does not exist"):
        list(verify(tmp_path / "none", 1, None, 1, no_progress))
    with pytest.raises(ConfigError, match="not a run folder"):
        list(verify(tmp_path, 1, None, 1, no_progress))


def test_the_command_says_what_agrees_and_exits_with_1_when_something_does_not(sfmrl, copy):
    done = sfmrl("verify", copy / "rl", "--episodes", 6)
    assert done.returncode == 0, done.stdout
    lines = done.stdout.splitlines()
    assert all(line.startswith("ok ") for line in lines[:-1])
    assert lines[-1].endswith(f"all {len(lines) - 1} agree")
    rates = json.loads((copy / "rl" / "result.json").read_text())
    assert all(f"{name} {rates[name]:.3f}" in done.stdout for name in RATES)

    (copy / "rl" / "metrics.csv").unlink()
    done = sfmrl("verify", copy / "rl", "--episodes", 1)
    assert done.returncode == 1
    assert "not ok SHA256SUMS      metrics.csv is listed but missing" in done.stdout
    assert "1 of" in done.stdout.splitlines()[-1]


def test_several_runs_and_archives_have_a_line_each_and_copies_are_named(sfmrl, copy, tmp_path):
    shutil.make_archive(str(tmp_path / "ada"), "gztar", copy)
    shutil.make_archive(str(tmp_path / "bob"), "zip", copy, "rl")
    before = sorted(tmp_path.rglob("*"))
    done = sfmrl("verify", copy / "rl", "ada.tar.gz", "bob.zip", "--episodes", 2)
    *agree, first, second = done.stdout.splitlines()
    assert [line.partition(": all ")[0] for line in agree] == [
        str(copy / "rl"),
        "ada.tar.gz: il",
        "ada.tar.gz: rl",
        "bob.zip: rl",
    ]
    assert first == f"ada.tar.gz: rl: the same weights as {copy / 'rl'}: a copy, or the same command and seed"
    assert second == f"bob.zip: rl: the same weights as {copy / 'rl'}: a copy, or the same command and seed"
    assert done.returncode == 0  # an honest run of the same command gives the same weights
    assert sorted(tmp_path.rglob("*")) == before


def test_a_copy_whose_config_was_edited_is_named(copy):
    network, config = load_weights(copy / "rl" / "weights.npz")
    shutil.copytree(copy / "rl", copy / "edited")
    save_weights(network, replace(config, seed=config.seed + 7), copy / "edited" / "weights.npz")
    assert same_weights({"first": copy / "rl", "second": copy / "edited", "il": copy / "il"}) == {"second": "first"}


def test_what_cannot_be_read_has_a_line_and_the_others_are_judged(sfmrl, copy, tmp_path):
    whole = Path(shutil.make_archive(str(tmp_path / "good"), "zip", copy / "il"))
    (tmp_path / "cut.zip").write_bytes(whole.read_bytes()[:5000])
    done = sfmrl("verify", "good.zip", "cut.zip", "nowhere", "--episodes", 1)
    assert (done.returncode, done.stderr) == (1, "")
    cut, nowhere, good = done.stdout.splitlines()
    assert cut.startswith("cut.zip is neither a run folder nor an archive")
    assert nowhere.startswith("nowhere does not exist")
    assert good.startswith("good.zip: .: all ")


@pytest.mark.skipif(WINDOWS, reason="names of files cannot have such letters")
def test_names_in_an_archive_can_neither_hide_a_verdict_nor_forge_a_line(sfmrl, copy, tmp_path):
    shutil.copytree(copy / "rl", tmp_path / "in" / "x: all 9 agree\nbob\x1b[8m\u202e")
    with open(tmp_path / "in" / "x: all 9 agree\nbob\x1b[8m\u202e" / "test.csv", "a") as file:
        file.write("0,circle5,success,,1,0.25,1.0,1.0\n")
    archive = shutil.make_archive(str(tmp_path / "forged"), "zip", tmp_path / "in")
    done = sfmrl("verify", archive, copy / "il", "--episodes", 1)
    assert done.returncode == 1
    forged, honest = done.stdout.splitlines()[:2]
    assert re.fullmatch(r".*: x: all 9 agree bob\ufffd\[8m\ufffd: \d of \d+ DO NOT AGREE: .*", forged)
    assert honest.startswith(f"{copy / 'il'}: all ")
    assert "\x1b" not in done.stdout
    listed = sfmrl("runs", "in")
    assert len(listed.stdout.splitlines()) == 2
    assert not {"\x1b", "\u202e"} & set(listed.stdout)


def test_one_archive_of_one_run_is_told_in_full(sfmrl, copy, tmp_path):
    shutil.make_archive(str(tmp_path / "il"), "tar", copy / "il")
    done = sfmrl("verify", "il.tar", "--episodes", 2)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines()[-1].startswith("il.tar: .: all ")
    assert "SHA256SUMS" in done.stdout


def test_an_archive_that_this_python_cannot_unpack_safely_is_left_packed(tmp_path, monkeypatch):
    archive = Path(shutil.make_archive(str(tmp_path / "run"), "tar", tmp_path))
    monkeypatch.delattr(tarfile, "data_filter")  # Python before 3.11.4
    with runs_in([archive]) as (runs, (error,)):
        assert runs == {}
        assert str(error) == f"unpacking {archive} safely needs Python 3.11.4; update Python, or pack a .zip"


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("text", "neither a run folder nor an archive"),
        ("empty", "holds no run folder"),
        ("climbing", "neither a run folder nor an archive that can be unpacked"),
        ("cut", "neither a run folder nor an archive"),
        ("garbled", "neither a run folder nor an archive"),
        ("huge", "would unpack to 2.0 GiB"),
    ],
)
def test_an_archive_that_cannot_be_used_is_one_line(sfmrl, copy, tmp_path, kind, said):
    path = tmp_path / "archive"
    if kind == "text":
        path.write_text("my run")
    elif kind == "cut":
        whole = Path(shutil.make_archive(str(tmp_path / "whole"), "gztar", copy))
        path.write_bytes(whole.read_bytes()[:5000])
    elif kind == "garbled":
        whole = Path(shutil.make_archive(str(tmp_path / "whole"), "xztar", copy)).read_bytes()
        path.write_bytes(whole[:3000] + b"garbled" + whole[3007:])
    else:
        with tarfile.open(path, "w") as packed:
            member = tarfile.TarInfo({"climbing": "../run.json"}.get(kind, "notes.txt"))
            if kind == "huge":
                member.size = 2**31
                packed.fileobj.write(member.tobuf())
                packed.fileobj.seek(2**31, 1)
                packed.offset += 2**31 + 512
            else:
                packed.addfile(member)
    done = sfmrl("verify", "archive")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert said in done.stderr
    assert not (tmp_path.parent / "run.json").exists()


@pytest.mark.parametrize("kind", ["zip", "tar"])
def test_an_archive_of_either_kind_may_not_unpack_to_too_much(copy, tmp_path, monkeypatch, kind):
    archive = Path(shutil.make_archive(str(tmp_path / "run"), kind, copy / "il"))
    monkeypatch.setattr("sfmrl.lessons.handed_in.LARGEST", 1000)
    with runs_in([archive]) as (runs, (error,)):
        assert runs == {}
        assert "would unpack to" in str(error)


def test_a_zip_file_of_windows_powershell_is_read(copy, tmp_path):
    with zipfile.ZipFile(tmp_path / "run.zip", "w") as packed:
        for path in (copy / "il").iterdir():
            packed.write(path, rf"run\{path.name}")
        packed.writestr("..\\..\\outside.txt", "")
    with runs_in([tmp_path / "run.zip"]) as (runs, errors):
        assert errors == []
        (folder,) = runs.values()
        assert folder.name == "run"
        assert not list(folder.parents[1].glob("outside.txt"))
        assert not list(folder.parents[2].glob("outside.txt"))


def test_without_openblas_a_few_episodes_may_end_otherwise(copy, monkeypatch):
    allowed = []

    def noting(*settings) -> Rerun:
        allowed.append(settings[1])
        return Rerun(*settings)

    monkeypatch.setattr("sfmrl.lessons.verify.Rerun", noting)
    for name, expected in (("SkylakeX", 0.0), ("unknown", TOLERANCE)):
        monkeypatch.setattr("sfmrl.lessons.verify.kernels", lambda name=name: name)
        found = findings(copy / "il")
        assert allowed.pop() == expected
        assert found["versions"].ok is (None if expected else True)
