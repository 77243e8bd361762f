"""Runs killed at their file operations go on to the same bits, and flipped bits in their files never go unnoticed."""

import json
import os
import random
import shutil
import signal
import stat
import sys
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sfmrl.cli import main
from sfmrl.config import Config, ConfigError
from sfmrl.lessons.verify import verify
from sfmrl.policies import load_policy
from sfmrl.runs.create import create_run
from sfmrl.runs.demonstrations import load_demonstrations
from sfmrl.runs.files import SUMS, DamagedFile, read_sums, write_atomically
from sfmrl.runs.folders import DEMONSTRATIONS, LOCK, TABLES, WEIGHTS, kind_of
from sfmrl.runs.progress import StopSignal, no_progress
from sfmrl.runs.run import open_run
from sfmrl.runs.training import run_imitation
from sfmrl.study.jobs import pack, restore, unpack
from sfmrl.study.tables import figures, read_row, run_folder
from sfmrl.variants import make_config

resource = pytest.importorskip("resource")  # where there is none, there is no os.fork, either
pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs os.fork")

IL = "il --episodes 3 --epochs 3 --batch-size 40 --time-limit 12 --run il --continue"
RL = "rl --from il --map lane.txt --reward sfm --time-limit 12 --threads 1 --no-recover --episodes 4 --parallel 2"
RL += " --batches 1 --batch-size 10 --validation-interval 2 --validation-episodes 1 --test-episodes 2"
RL += " --run rl --continue"
WRITING = os.O_WRONLY | os.O_RDWR


def forked(folder: Path, work: Callable[[], Any], kill_at: int | None = None) -> tuple[int, list[str]]:
    """Do some work in a process of its own, in `folder`, that is killed before its file operation number `kill_at`.

    Returns its exit code and its file operations. A file that it was writing is left half written.
    """
    log = folder.parent / f"{folder.name}.operations"
    if not (process := os.fork()):
        code = 99
        try:
            os.chdir(folder)
            sys.stdout = sys.stderr = open(folder.parent / f"{folder.name}.said", "w")  # noqa: SIM115
            _count_operations(log, kill_at)
            work()
            code = 0
        except SystemExit as end:
            code = end.code or 0
        finally:
            sys.stdout.flush()
            os._exit(code)
    _, status = os.waitpid(process, 0)
    return os.waitstatus_to_exitcode(status), log.read_text().splitlines()


def _count_operations(log: Path, kill_at: int | None) -> None:
    """Write every file operation to `log`, and end this process before number `kill_at`."""
    lines = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    inside, done, fsync = False, 0, os.fsync

    def operation(name: str, path: object) -> None:
        nonlocal inside, done
        if inside or str(path).startswith("/"):  # run folders are relative
            return
        inside = True
        if done == kill_at:
            if name == "fsync" and stat.S_ISREG(os.fstat(path).st_mode):
                os.truncate(path, os.fstat(path).st_size // 2)
            if name == "append":
                with open(path, "ab") as file:
                    file.write(b"0,0.12")
            os._exit(137)
        done += 1
        os.write(lines, f"{name} {path}\n".encode())
        inside = False

    def hook(event: str, given: tuple) -> None:
        if event == "open" and given[2] & WRITING:
            operation("append" if given[2] & os.O_APPEND and not str(given[0]).endswith(LOCK) else "open", given[0])
        elif event in ("os.rename", "os.remove", "os.mkdir", "os.rmdir"):
            operation(event, given[0])

    def counted_fsync(descriptor: int) -> None:
        operation("fsync", descriptor)
        fsync(descriptor)

    sys.addaudithook(hook)
    os.fsync = counted_fsync


def command(words: str) -> Callable[[], None]:
    def work() -> None:
        sys.argv = ["sfmrl", *words.split()]
        main()

    return work


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    """A folder with the runs "il" and "rl", which were never interrupted, and their operations beside it."""
    place = tmp_path_factory.mktemp("faults") / "whole"
    place.mkdir()
    (place / "lane.txt").write_text("R..1..G\n")
    config = make_config(imitation={"episodes": 1, "epochs": 1, "environment": "circle5"})
    warm = create_run("il", config, place.parent / "warm")  # imports what forks then share
    run_imitation(warm, no_progress, StopSignal())
    for name, words in (("il", IL), ("rl", RL)):
        code, operations = forked(place, command(words))
        assert code == 0, place.with_name("whole.said").read_text()
        (place.parent / f"{name}.operations").write_text("\n".join(operations))
    return place


def contents(folder: Path) -> dict[str, bytes]:
    """All files of a folder but those that hold the time."""
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name not in ("run.json", SUMS)}


def moments(place: Path, name: str, all_of: str, every: int) -> list[int]:
    """Operations at which to kill: all on files whose name contains one of the words of `all_of`, `every`-th others."""
    operations = (place.parent / f"{name}.operations").read_text().splitlines()
    chosen, last = [], ""
    for number, operation in enumerate(operations):
        last = operation if "fsync" not in operation and SUMS not in operation else last
        if any(word in last for word in all_of.split()) or number % every == 0:
            chosen.append(number)
    return chosen


@pytest.mark.parametrize(
    ("name", "words", "all_of", "every"),
    [("il", IL, ".lock config run.json 000003 remove weights", 9), ("rl", RL, "", 11)],
    ids=["il", "rl"],
)
def test_a_run_killed_at_any_file_operation_goes_on_to_the_same_bits(place, tmp_path, name, words, all_of, every):
    whole = contents(place / name)
    killed = moments(place, name, all_of, every)
    assert len(killed) > 9
    for number in killed:
        folder = tmp_path / str(number)
        folder.mkdir()
        for item in ("lane.txt", "il") if name == "rl" else ():
            (folder / item).symlink_to(place / item)
        code, operations = forked(folder, command(words), number)
        assert code == 137
        code, _ = forked(folder, command(words))
        said = (tmp_path / f"{number}.said").read_text()
        assert code == 0, (number, operations[-1:], said)
        assert ".tmp" not in said
        assert contents(folder / name) == whole, (number, operations[-1:])
        found = islice(verify(folder / name, 1, None, 1, no_progress), 4)
        on_files = {finding.what: finding.ok for finding in found}  # without playing again
        assert on_files == dict.fromkeys((SUMS, "training", "tables", WEIGHTS), True), number


def full_disk() -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))


def ctrl_c_while_saving() -> None:
    write = os.fsync

    def interrupted(descriptor: int) -> None:
        if os.fstat(descriptor).st_size > 100_000:
            for _ in range(2):  # the second one acts at once
                os.kill(os.getpid(), signal.SIGINT)
        write(descriptor)

    os.fsync = interrupted


@pytest.mark.parametrize(
    ("fault", "code", "said"),
    [
        (full_disk, 1, "sfmrl: il/checkpoint-000001.npz: File too large; then resume with: sfmrl il --resume il"),
        (ctrl_c_while_saving, 130, "sfmrl: interrupted; resume with: sfmrl il --resume il"),
    ],
)
def test_a_full_disk_and_ctrl_c_inside_a_save_are_one_line_and_lose_nothing(place, tmp_path, fault, code, said):
    folder = tmp_path / "here"
    folder.mkdir()
    assert forked(folder, lambda: [fault(), command(IL)()])[0] == code
    lines = (tmp_path / "here.said").read_text().splitlines()
    assert lines[-1] == said
    assert all("Traceback" not in line and ".tmp" not in line for line in lines)
    assert forked(folder, command(IL))[0] == 0
    assert contents(folder / "il") == contents(place / "il")


def test_an_overwriting_killed_at_any_file_operation_can_be_repeated_and_spares_what_is_not_the_run_s(place, tmp_path):
    config, number, code = make_config(seed=7), 0, 137
    while code == 137:
        folder = tmp_path / str(number)
        shutil.copytree(place / "rl", folder / "rl")
        (folder / "rl" / "thesis.tex").write_text("years of work")
        old = open_run(folder / "rl")
        code, _ = forked(folder, lambda: create_run("il", config, Path("rl"), overwrite=True), number)
        try:  # never a mixture
            run = open_run(folder / "rl")
            assert run == old if run.kind == "rl" else run.config.seed == 7
        except DamagedFile:
            pass
        create_run("il", config, folder / "rl", overwrite=True)
        assert set(contents(folder / "rl")) == {"config.json", "thesis.tex", LOCK}
        number += 1
    assert number > 15


def test_a_folder_that_travels_is_whole_or_not_there(place, tmp_path):
    data, number, code = pack(place / "rl"), 0, 137
    while code == 137:
        folder = tmp_path / str(number)
        shutil.copytree(place / "il", folder / "run")
        code, _ = forked(folder, lambda: unpack(data, Path("run")), number)
        restore(folder / "run")
        assert contents(folder / "run") == contents(place / (kind_of(folder / "run") or ""))
        unpack(data, folder / "run")
        assert [path.name for path in folder.iterdir()] == ["run"]
        assert contents(folder / "run") == contents(place / "rl")
        number += 1
    assert number > 5


def flipped(path: Path, count: int) -> Iterator[tuple[int, int]]:
    """Write a file again and again with one bit flipped, yield its byte and bit, and put the file back in the end."""
    whole, draw = path.read_bytes(), random.Random(path.name)
    try:
        for _ in range(count):
            place, bit = draw.randrange(len(whole)), draw.randrange(8)
            data = bytearray(whole)
            data[place] ^= 1 << bit
            path.write_bytes(data)
            yield place, bit
    finally:
        path.write_bytes(whole)


def row(folder: Path) -> list:
    read = read_row(folder, 1, "quick", "sarl", [0])
    return [np.asarray(value).tolist() for value in vars(read).values()]


def readers(folder: Path, il: Path, name: str) -> list[Callable[[], Any]]:
    """What reads a file of a run, as functions whose values can be compared."""
    run = run_folder(folder, 1, "quick", "sarl", 0)
    if name == DEMONSTRATIONS:
        return [lambda: load_demonstrations(il / name, Config().simulation).position.tobytes()]
    found = [lambda: open_run(run)]
    if name in TABLES or name == SUMS:
        found.append(lambda: row(folder))
    if name not in TABLES:
        found.append(lambda: load_policy(run).network.flat.tobytes())
    return found


def outcome(read: Callable[[], Any]) -> Any:
    """What a reader gives, or "refused" where it says so as it should."""
    try:
        return read()
    except (ConfigError, DamagedFile):
        return "refused"


@pytest.fixture(scope="module")
def laid_out(place, tmp_path_factory) -> Iterator[tuple[Path, Path]]:
    """The folder of a table with one run, and an imitation run."""
    folder = tmp_path_factory.mktemp("flips")
    shutil.copytree(place / "rl", run_folder(folder, 1, "quick", "sarl", 0))
    config = open_run(place / "rl").config
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sfmrl.study.tables.run_config", lambda *_, **__: config)  # the table's own are too long
        yield folder, Path(shutil.copytree(place / "il", folder / "il"))


FILES = ["config.json", "run.json", "map.txt", "weights.npz", "best.npz", *TABLES, SUMS, DEMONSTRATIONS]


@pytest.mark.parametrize("name", FILES)
def test_no_flipped_bit_in_a_run_s_files_goes_unnoticed(laid_out, name):
    folder, il = laid_out
    run = il if name == DEMONSTRATIONS else run_folder(folder, 1, "quick", "sarl", 0)
    reads = readers(folder, il, name)
    right = [outcome(read) for read in reads]
    assert "refused" not in right
    assert next(verify(run, 1, None, 1, no_progress)).ok
    for flip in flipped(run / name, 200):
        assert next(verify(run, 1, None, 1, no_progress)).ok is False, flip
        for read, expected in zip(reads, right, strict=True):
            assert outcome(read) in (expected, "refused"), flip
    for _ in flipped(run / name, 1):
        list(verify(run, 1, None, 1, no_progress))  # to its end


@pytest.mark.parametrize("name", TABLES)
def test_flipped_bits_in_a_run_of_an_earlier_version_cause_no_traceback(laid_out, name, tmp_path):
    """Such runs list no table in SHA256SUMS. They are read as they are, but `verify` refuses their tables."""
    shutil.copytree(run_folder(laid_out[0], 1, "quick", "sarl", 0), run_folder(tmp_path, 1, "quick", "sarl", 0))
    run = run_folder(tmp_path, 1, "quick", "sarl", 0)
    facts = json.loads((run / "run.json").read_text())
    result = json.loads((run / "result.json").read_text())
    del facts["versions"]["bits"], result["bits"]
    for file, content in (("run.json", facts), ("result.json", result)):
        write_atomically(run / file, json.dumps(content).encode())
    sums = {key: digest for key, digest in read_sums(run).items() if key not in (*TABLES, "map.txt")}
    (run / SUMS).write_text("".join(f"{digest}  {key}\n" for key, digest in sums.items()))
    found = list(verify(run, 1, None, 1, no_progress))
    judged = {ok: {finding.what for finding in found if finding.ok is ok} for ok in (None, False)}
    assert judged == {None: {"versions", "imitation"}, False: {"tables"}}
    assert row(tmp_path) == row(laid_out[0])
    for _ in flipped(run / name, 100):
        outcome(lambda: figures(read_row(tmp_path, 1, "quick", "sarl", [0])))
