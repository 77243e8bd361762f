"""The doctor: all is well here, and what is not is found, named, and given a remedy."""

import itertools
import sys
from importlib.metadata import version
from types import SimpleNamespace

import pytest
import torch
from rich.console import Console

import sfmrl as package
from sfmrl import episodes
from sfmrl.cli import teach
from sfmrl.lessons import Finding, doctor
from sfmrl.runs import bits


def looked_at(**how) -> dict[str, Finding]:
    console = Console(**({"force_terminal": True, "width": 120, "height": 40, "color_system": "256"} | how))
    return {check.what: check for check in doctor.examine(console)}


def test_all_is_well_here_and_nothing_is_written(sfmrl, tmp_path):
    done = sfmrl("doctor")
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stderr.splitlines()[-1] == "all is well"
    lines = done.stdout.splitlines()
    assert not any(line.startswith("not ok") for line in lines)
    assert all(any(line.startswith(f"ok     {what} ") for line in lines) for what in ("ORCA", "two threads"))
    assert f"ok     torch           {version('torch')}" in lines
    assert lines[-1].endswith(f"bits {bits.machine_bits()}")
    assert list(tmp_path.iterdir()) == []


def test_a_package_that_is_missing_is_named_with_what_to_type(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.delitem(sys.modules, "sfmrl.network", raising=False)
    found = looked_at()
    assert found["torch"].ok is False
    assert found["torch"].remedy == "pip install --force-reinstall torch"
    monkeypatch.setattr(doctor, "INTEL_MAC", True)
    assert looked_at()["torch"].ok is None
    assert found["numpy"].ok is True
    assert found["two threads"].ok is True  # all that plays does without


def test_the_terminal_s_limits_are_told_and_are_no_failure():
    assert looked_at(force_terminal=False)["terminal"].ok is None
    narrow = looked_at(width=60)["terminal"]
    assert narrow.ok is None
    assert "80 x 24" in narrow.remedy
    assert looked_at()["terminal"].ok is True
    ascii_only = SimpleNamespace(
        is_terminal=True, is_dumb_terminal=False, width=80, height=24, color_system=None, encoding="ascii"
    )
    found = doctor._terminal(ascii_only)
    assert found.ok is None
    assert "ASCII" in found.remedy
    assert "colours: none" in found.said


def test_orca_that_steers_badly_and_bits_that_depend_on_threads_are_found(monkeypatch):
    play, number = episodes.play_episodes, itertools.count()

    def play_otherwise(*args, **how):
        record = play(*args, **how)
        record.position[0, 0, 0, 0] += next(number)
        return record

    monkeypatch.setattr(episodes, "play_episodes", play_otherwise)
    monkeypatch.setattr(package, "play", lambda scenes, policy: SimpleNamespace(outcome=torch.zeros(16).numpy()))
    found = looked_at()
    assert (found["ORCA"].ok, found["two threads"].ok) == (False, False)
    assert "--threads 1" in found["two threads"].remedy


def test_a_failure_is_a_line_with_its_remedy_and_exit_code_1(monkeypatch, capsys):
    def breaks() -> Finding:
        return str(1 / 0)

    monkeypatch.setattr(doctor, "_orca", lambda: Finding("ORCA", False, "it is broken", "mend it"))
    monkeypatch.setattr(doctor, "_processor", breaks)
    with pytest.raises(teach.typer.Exit) as end:
        teach.doctor()
    assert end.value.exit_code == 1
    told = capsys.readouterr()
    assert "not ok ORCA            it is broken; mend it" in told.out
    assert "not ok processor       ZeroDivisionError: division by zero; pip install" in told.out
    assert "not ok: ORCA, processor" in told.err
