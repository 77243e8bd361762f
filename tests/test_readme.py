"""What the README shows works as printed: its Python, its own reward, and the commands it names."""

import re
import shlex

from conftest import ROOT, Interpreter

README = (ROOT / "README.md").read_text(encoding="utf-8")
COMMANDS = "il|rl|eval|compare|ascii-render|explain|models|table|figure|verify|doctor"
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


def test_every_command_and_flag_it_names_exists(sfmrl):
    helps = {command: sfmrl(command, "--help").stdout for command in COMMANDS.split("|")}
    named = re.findall(rf"sfmrl (?:{COMMANDS})[^`\n#|&]*", README)
    for line in named:
        words = shlex.split(line.replace("...", ""), posix=True)
        for flag in (word for word in words if word.startswith("--")):
            assert flag in helps[words[1]], line
    assert {line.split()[1] for line in named} == set(helps)


def test_the_table_of_the_code_names_every_core_file_and_about_how_long_it_is():
    listed = re.findall(r"^\| \[`(\w+)\.py`\]\(sfmrl/\w+\.py\) \| (\d+) \|", README, flags=re.MULTILINE)
    core = {
        path.stem: len(path.read_text(encoding="utf-8").splitlines()) for path in (ROOT / "sfmrl").glob("[a-z]*.py")
    }
    assert dict(listed).keys() == core.keys()
    for name, lines in listed:
        assert abs(int(lines) - core[name]) <= max(5, core[name] / 10), name
