"""What the README shows works as printed: its Python, its own reward, and the commands it names."""

import re
import shlex

import typer
from conftest import ROOT, Interpreter

from sfmrl.cli import app

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
    for name, lines in listed:
        assert abs(int(lines) - core[name]) <= max(5, core[name] / 10), name
