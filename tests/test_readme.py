"""What the README shows works as printed: its Python, its own reward, and the commands it names."""

import re
import shlex

import numpy as np
import pytest
import typer
from conftest import ROOT, Interpreter

from sfmrl.cli import app
from sfmrl.episodes import play
from sfmrl.replay.picture import episode_svg
from sfmrl.scenes import sample_scenes

README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w*)\n(.*?)^```$", README, flags=re.MULTILINE | re.DOTALL)


def test_the_python_blocks_run_as_they_are_pasted(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    blocks = [code for language, code in BLOCKS if language == "python"]
    assert len(blocks) >= 2
    for code in blocks:
        Interpreter().paste(code)
    assert "success" in capsys.readouterr().out


def test_the_own_reward_runs_under_the_command_that_is_shown(sfmrl, tmp_path):
    code = next(code for language, code in BLOCKS if code.startswith("# my_reward.py: sfmrl rl"))
    (tmp_path / "my_reward.py").write_text(code)
    name = re.search(r"--reward (\S+)", code)[1]
    done = sfmrl("eval", "orca", "--episodes", "3", "--reward", name)
    assert done.returncode == 0, done.stderr


def test_the_own_policy_succeeds_as_often_as_the_readme_says():
    code = next(code for language, code in BLOCKS if code.startswith("# my_policy.py"))
    names: dict = {}
    exec(code, names)
    said = re.search(r"succeeds in (\d+) of 200 episodes, `\"orca\"` in (\d+);", README)
    scenes = sample_scenes("table1", 200)
    found = [(play(scenes, policy).outcome == "success").sum() for policy in (names["detour"], "orca")]
    assert found == pytest.approx([int(number) for number in said.groups()], abs=4)  # the last bits may differ


def test_the_film_and_the_frame_are_of_the_same_episode_and_the_first_tutorial_shows_the_frame():
    film = (ROOT / "tutorials" / "episode.svg").read_text(encoding="utf-8")
    made = episode_svg(play(sample_scenes("2", 1), "sarl-sfm2", reward="sfm"))
    ways = [[place.split(",") for place in re.findall(r'points="([^"]+)"', svg)[0].split()] for svg in (film, made)]
    np.testing.assert_allclose(np.array(ways[0], dtype=float), np.array(ways[1], dtype=float), atol=4)  # pixels
    (frame,) = (code for _, code in BLOCKS if code.startswith("╭─ sarl-sfm2 · environment 2 · episode 0"))
    assert frame in (ROOT / "tutorials" / "01-first-steps.md").read_text(encoding="utf-8")


def test_every_command_and_flag_it_names_exists():
    commands = typer.main.get_command(app).commands
    named = re.findall(rf"sfmrl (?:{'|'.join(commands)})[^`\n#|&]*", README)
    for line in named:
        words = shlex.split(line.replace("...", ""), posix=True)
        known = {flag for option in commands[words[1]].params for flag in (*option.opts, *option.secondary_opts)}
        assert {word for word in words if word.startswith("--")} <= known, line
    assert {line.split()[1] for line in named} == set(commands)


def test_the_table_of_the_code_names_every_core_file_and_about_how_long_it_is():
    listed = re.findall(r"^\| \[`(\w+)\.py`\]\(sfmrl/\w+\.py\) \| (\d+) \|", README, flags=re.MULTILINE)
    core = {
        path.stem: len(path.read_text(encoding="utf-8").splitlines()) for path in (ROOT / "sfmrl").glob("[a-z]*.py")
    }
    assert dict(listed).keys() == core.keys()
    (whole,) = re.findall(r"are the algorithm, ([\d,]+) lines", README)
    assert abs(int(whole.replace(",", "")) - sum(core.values())) <= 100
    for name, lines in listed:
        assert abs(int(lines) - core[name]) <= max(5, core[name] / 10), name
