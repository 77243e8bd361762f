"""The tutorials do as they are printed: every block is run in order, and what it prints is what the page shows.

The blocks are run as a reader does: Python is pasted line by line into one interactive interpreter a page, commands are
typed in a shell, both in an empty folder. A block that begins with "# NAME.py" is saved under that name, too. A `text`
block after a block is its output; a line of "..." in it stands for any number of lines. Blocks under `<!-- minutes -->`
take too long to be run here. Where this machine computes other bits than the one that the pages were made on, which
tutorials/README.md names, what is printed has to be near to what is shown.
"""

import csv
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT, Interpreter, environment
from nearness import near

from sfmrl.runs.bits import machine_bits
from sfmrl.study.statistics import mean_difference

PAGES = sorted(path for path in (ROOT / "tutorials").glob("*.md") if path.name[0].isdigit())
FENCE = re.compile(r"^(<!-- minutes -->\n+)?```(\w*)\n(.*?)^```$", flags=re.MULTILINE | re.DOTALL)


def runs(page: Path) -> list[tuple[str, str, str | None]]:
    """Language, code and shown output (None where nothing is shown) of the blocks that are run."""
    blocks = FENCE.findall(page.read_text(encoding="utf-8"))
    found = []
    for number, (long, language, code) in enumerate(blocks):
        if language in ("python", "sh") and not long:
            shown = blocks[number + 1] if number + 1 < len(blocks) else ("", "", "")
            found.append((language, code, shown[2] if shown[1] == "text" else None))
    return found


def same(shown: str, printed: str) -> bool:
    """Whether a page shows what was printed, but for spaces at ends of lines."""
    shown, printed = ("\n".join(line.rstrip() for line in text.rstrip().splitlines()) for text in (shown, printed))
    pattern = re.escape(shown).replace(re.escape("\n..."), "(\n.*)*?")
    return re.fullmatch(pattern, printed) is not None


def made_alike() -> bool:
    """Whether this machine computes the bits of the one that the pages were made on."""
    (made,) = re.findall(r"`bits ([0-9a-f]{12})`", (ROOT / "tutorials" / "README.md").read_text(encoding="utf-8"))
    return machine_bits() == made


@pytest.fixture
def place(tmp_path: Path, monkeypatch) -> Path:
    """An empty folder to work in, with `sfmrl` on the path as an installation puts it there."""
    command = tmp_path / "bin" / "sfmrl"
    command.parent.mkdir()
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m sfmrl "$@"\n')
    command.chmod(0o755)
    around = environment() | {"PATH": f"{command.parent}{os.pathsep}{os.environ['PATH']}", "COLUMNS": "80"}
    for name, value in around.items():
        monkeypatch.setenv(name, value)
    folder = tmp_path / "work"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


@pytest.mark.timeout(900)  # a page takes a minute on a slow machine
@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.stem)
def test_a_page_does_what_it_shows(page, place, capsys):
    python, blocks = Interpreter(), runs(page)
    assert blocks
    for language, code, shown in blocks:
        if language == "python":
            if saved := re.match(r"# (\w+\.py)\n", code):
                Path(saved[1]).write_text(code)
            python.paste(code)
            printed = capsys.readouterr().out
        else:
            done = subprocess.run(["bash", "-e", "-c", code], capture_output=True, text=True, check=False)
            assert done.returncode == 0, f"{code}\n{done.stderr}"
            printed = done.stdout
        agrees = same if made_alike() else near
        assert shown is None or agrees(shown, printed), f"{code}\nprinted\n{printed}\ninstead of\n{shown}"


def test_what_a_page_needs_of_the_tables_is_what_they_hold():
    page = (ROOT / "tutorials" / "14-reading-results.md").read_text(encoding="utf-8")
    with open(ROOT / "tutorials" / "results" / "table1-quick.csv", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["metric"] == "success" and row["seed"] != "all"]
    for name in ("sarl", "sarl-sfm2"):
        values = [f"{float(row['value']):.3f}" for row in rows if row["row"] == name]
        assert f'"{name}": [{", ".join(values)}]' in page


def test_the_effect_of_forces_on_total_reward_is_that_of_the_table_s_seeds():
    with open(ROOT / "tutorials" / "results" / "table1-quick.csv", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["metric"] == "total_reward" and row["seed"] != "all"]
    names = ("sarl", "sarl-sfm2", "sarl-sfm5", "sarl-sfm6")
    sarl, sfm2, sfm5, sfm6 = (np.array([float(row["value"]) for row in rows if row["row"] == name]) for name in names)
    gap = mean_difference((sfm5 - sarl + sfm6 - sfm2) / 2)
    said = f"{gap['mean']:+.3f} ({gap['low']:+.3f} to {gap['high']:+.3f}"
    for page in ("README.md", "tutorials/tables.md"):
        assert f"forces change it by {said}" in " ".join((ROOT / page).read_text(encoding="utf-8").split())


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.stem)
def test_a_page_ends_with_an_exercise_and_its_solution(page):
    text = page.read_text(encoding="utf-8")
    exercise = text.index("## Exercise")
    solution = text.index("<summary>Solution</summary>", exercise)
    code = FENCE.findall(text[solution:])
    assert any(language in ("python", "sh") for _, language, _ in code)


def test_the_index_lists_every_page_and_links_lead_somewhere():
    index = (ROOT / "tutorials" / "README.md").read_text(encoding="utf-8")
    assert all(f"]({page.name})" in index for page in PAGES)
    for page in [*(ROOT / "tutorials").glob("*.md"), ROOT / "README.md"]:
        for link in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8")):
            assert link.startswith("https://") or (page.parent / link).exists(), f"{page.name}: {link}"


def test_output_is_compared_as_it_should_be():
    assert same("a\n...\nd", "a\nb\nc\nd\n")
    assert same("a \n", "a")
    assert not same("a\n...\nd", "a\nb")
    assert not same("1.0", "1x0")
    assert not same("loss 0.12", "loss 0.13")


TABLE = "│ all │ 0.900 │ 8.39 s │ 50 │\n│     │ 0.79-0.96 │    │  │"
DRAWING = "╭─ orca ──╮\n│  ⡠ @⇒ 4 │\n│    ★    │\n╰─────────╯"
COMPARED = "sarl .990 .946-.998 .010 10.24\nsarl-sfm2 .010 (-.020 to .030) 1.000"


@pytest.mark.parametrize(
    ("shown", "printed", "right"),
    [
        ("1,0.0351496041", "1,0.0351489298", True),
        ("1,0.0351496041", "1,0.0391489298", False),
        ("value 0.38, +0.0007", "value  0.41, -0.0001", True),
        ("value 0.38", "value 0.68", False),
        ("sarl-sfm2  0.986 to 1.000", "sarl-sfm2  0.986 to 1.000", True),
        ("sarl-sfm2  0.986", "sarl-sfm3  0.986", False),
        ("value 0.38", "worth 0.38", False),
        (TABLE, TABLE.replace("0.900", "0.880").replace("0.79-0.96", "0.76-0.94").replace("8.39", "8.36"), True),
        (TABLE, TABLE.replace("0.900", "0.700").replace("0.79-0.96", "0.56-0.81"), False),
        (TABLE, TABLE.replace("8.39", "9.39"), False),
        (TABLE, TABLE.replace("50", "80"), False),
        (
            COMPARED,
            COMPARED.replace(".990 .946-.998 .010", "1.000 .963-1.000 .000").replace(".010 (-.020", ".000 (-.030"),
            True,
        ),
        (COMPARED, COMPARED.replace(".990 .946-.998", ".900 .826-.945"), False),
        ("\n".join("abcdef"), "\n".join("abcde"), True),
        ("\n".join("abcdef"), "\n".join("abcd"), False),
        (DRAWING, DRAWING.replace("⡠", "⠤") + "\n\n", True),
        (DRAWING, DRAWING.replace("│  ⡠ @⇒ 4 │", "│4  ⇐@  ⠤│"), False),
    ],
)
def test_elsewhere_words_are_the_same_and_numbers_are_near(shown, printed, right):
    assert near(shown, printed) is right


@pytest.mark.parametrize("table", sorted((ROOT / "tutorials" / "results").glob("*.md")), ids=lambda path: path.stem)
def test_a_page_shows_the_results_as_they_were_written(table):
    pages = [(ROOT / "tutorials" / name).read_text(encoding="utf-8") for name in ("tables.md", "results.md")]
    assert any(table.read_text(encoding="utf-8").strip() in page for page in pages)
