"""The tutorials do as they are printed: every block is run in order, and what it prints is what the page shows.

Of a page, all Python blocks share their names and all commands a folder; a block that begins with "# NAME.py" is saved
under that name, too. A `text` block after a block is its output; a line of "..." in it stands for any number of
lines. Blocks under `<!-- minutes -->` take too long to be run here. Where
processor or versions are not those that the pages were made with, rounding differs, and numbers are not compared.
"""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import ROOT, environment

from sfmrl.models import model_card
from sfmrl.network import resolved
from sfmrl.runs import versions

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


def same(shown: str, printed: str, alike: bool = True) -> bool:
    """Whether a page shows what was printed, but for spaces at ends of lines, and unless `alike` but for numbers."""
    shown, printed = ("\n".join(line.rstrip() for line in text.rstrip().splitlines()) for text in (shown, printed))
    if not alike:
        shown, printed = (re.sub(r"[\d.,-]*\d|[ ─━═]+", "", text) for text in (shown, printed))
    pattern = re.escape(shown).replace(re.escape("\n..."), "(\n.*)*?")
    return re.fullmatch(pattern, printed) is not None


def made_alike() -> bool:
    """Whether this machine computes to the same bits as the one that the pages and the models were made on."""
    made = model_card("sarl")["versions"]
    return (
        all(versions()[name] == made[name] for name in ("numpy", "torch", "processor")) and resolved("auto") == "bf16"
    )


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


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.stem)
def test_a_page_does_what_it_shows(page, place, capsys):
    names = {"__name__": page.stem, "tutorials": page.parent}
    blocks = runs(page)
    assert blocks
    for language, code, shown in blocks:
        if language == "python":
            if saved := re.match(r"# (\w+\.py)\n", code):
                Path(saved[1]).write_text(code)
            exec(compile(code, page.name, "exec"), names)
            printed = capsys.readouterr().out
        else:
            done = subprocess.run(["bash", "-e", "-c", code], capture_output=True, text=True, check=False)
            assert done.returncode == 0, f"{code}\n{done.stderr}"
            printed = done.stdout
        assert shown is None or same(shown, printed, made_alike()), f"{code}\nprinted\n{printed}\ninstead of\n{shown}"


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
    assert same("loss 0.12, -3 m", "loss  0.134, 4 m", alike=False)
    assert not same("loss 0.12", "less 0.12", alike=False)


@pytest.mark.parametrize("table", sorted((ROOT / "tutorials" / "results").glob("*.md")), ids=lambda path: path.stem)
def test_the_page_of_tables_shows_the_results_as_they_were_written(table):
    assert table.read_text(encoding="utf-8").strip() in (ROOT / "tutorials" / "tables.md").read_text(encoding="utf-8")
