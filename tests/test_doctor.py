"""The doctor: all is well here, and what is not is found, named, and given a remedy."""

import sys
from types import SimpleNamespace

import pytest
import torch
from rich.console import Console
from sfmrl.self_test import TESTS, Failure

from sfmrl import doctor, self_test, teaching_commands
from sfmrl.config import Config
from sfmrl.gradients import loss_and_gradients
from sfmrl.network import ValueNetwork
from sfmrl.policies import linear_policy
from sfmrl.scenarios import sample_scenes
from sfmrl.weights import save_weights


def console(**how) -> Console:
    return Console(**({"force_terminal": True, "width": 120, "height": 40, "color_system": "256"} | how))


def looked_at(**how) -> dict[str, doctor.Check]:
    return {check.what: check for check in doctor.examine(console(**how))}


def test_all_is_well_here_and_nothing_is_written(sfmrl, tmp_path):
    done = sfmrl("doctor")
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stderr.splitlines()[-1] == "all is well"
    lines = done.stdout.splitlines()
    assert not any(line.startswith("not ok") for line in lines)
    assert all(any(line.startswith(f"ok     {what} ") for line in lines) for what in TESTS)
    assert list(tmp_path.iterdir()) == []


def test_versions_and_precision_are_those_of_this_place():
    found = looked_at()
    assert found["torch"].said == torch.__version__
    assert f"auto is {ValueNetwork(precision='auto').precision}" in found["processor"].said
    assert found["runs"].good is True


def test_a_package_that_is_missing_is_named_with_what_to_type(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    found = looked_at()
    assert found["torch"].good is False
    assert found["torch"].remedy == "pip install --force-reinstall torch"
    assert found["numpy"].good is True
    monkeypatch.delitem(sys.modules, "sfmrl.self_test")
    monkeypatch.delitem(sys.modules, "sfmrl.network")
    (check,) = doctor.self_test()
    assert check.good is False
    assert "cannot begin" in check.said


def test_the_terminal_s_limits_are_told_and_are_no_failure():
    plain = looked_at(force_terminal=False)
    assert plain["terminal"].good is None
    narrow = looked_at(width=60)
    assert narrow["terminal"].good is None
    assert "80 x 24" in narrow["terminal"].remedy
    assert looked_at()["terminal"].good is True
    ascii_only = SimpleNamespace(
        is_terminal=True, is_dumb_terminal=False, width=80, height=24, color_system=None, encoding="ascii"
    )
    found = {check.what: check for check in doctor.examine(ascii_only)}
    assert found["characters"].good is None
    assert "--ascii" in found["characters"].remedy
    assert found["colours"].said == "none"


def test_a_place_where_nothing_can_be_written_and_a_full_disk_are_not_well(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(doctor.os, "access", lambda *_: False)
    monkeypatch.setattr(doctor.shutil, "disk_usage", lambda _: SimpleNamespace(free=1e7))
    found = looked_at()
    assert found["runs"].good is False
    assert found["space"].good is False
    assert "--run" in found["runs"].remedy


def test_what_runs_there_are_is_told(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    for name, kind in (("a", "il"), ("b", "il"), ("c", "rl")):
        (tmp_path / "runs" / name).mkdir(parents=True)
        (tmp_path / "runs" / name / "run.json").write_text(f'{{"kind": "{kind}"}}')
    (tmp_path / "runs" / "a" / "weights.pt").touch()
    said = looked_at()["trained"].said
    assert said == "2 of sfmrl il, 1 of them finished; 1 of sfmrl rl, 0 of them finished"


def wrong_gradient(network, states, values):
    loss, found = loss_and_gradients(network, states, values)
    return loss, found | {"mlp3.0.bias": found["mlp3.0.bias"] + 0.1}


def save_another(network, config, path):
    return save_weights(ValueNetwork(seed=8), Config(), path)


BROKEN = {
    "ORCA": ("orca_policy", linear_policy),
    "gradient": ("loss_and_gradients", wrong_gradient),
    "learning": ("learn", lambda network, *_: torch.tensor(1.0)),
    "files": ("save_weights", save_another),
    "same bits": ("played_digest", lambda threads, batch: f"{threads}"),
}


@pytest.mark.parametrize("what", BROKEN)
def test_what_computes_wrongly_is_found_by_the_self_test(monkeypatch, what):
    name, broken = BROKEN[what]
    monkeypatch.setattr(self_test, name, broken)
    if what == "ORCA":
        monkeypatch.setattr(self_test, "sample_scenes", lambda _, count: sample_scenes("2", count))
    with pytest.raises(Failure):
        TESTS[what][0]()


def test_a_failure_is_a_line_with_its_remedy_and_exit_code_1(monkeypatch, capsys):
    def fails() -> str:
        raise Failure("it is broken")

    def breaks() -> str:
        return str(1 / 0)

    monkeypatch.setattr(self_test, "TESTS", {"one": (fails, "mend it"), "two": (breaks, "pray"), "three": (str, "")})
    with pytest.raises(teaching_commands.typer.Exit) as end:
        teaching_commands.doctor(test=True)
    assert end.value.exit_code == 1
    told = capsys.readouterr()
    assert "not ok one             it is broken; mend it" in told.out
    assert "not ok two             ZeroDivisionError: division by zero; pray" in told.out
    assert "not ok: one, two" in told.err
