"""Update the tutorials: run every block and write what it prints into the page.

    python tests/make_pages.py 02 05

Without numbers, all pages. A line of "..." stays where it was, with as many lines before and after it as the page
showed. Read what has changed (git diff) and correct the text around it; then write this machine's bits, of which
`sfmrl doctor` tells, into tutorials/README.md.
"""

import contextlib
import io
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from conftest import Interpreter, environment
from test_tutorials import FENCE, PAGES, same


def shortened(printed: str, shown: str) -> str:
    """What was printed, cut as the page cuts it."""
    lines, old = [line.rstrip() for line in printed.rstrip().splitlines()], shown.rstrip().splitlines()
    if "..." in old:
        at = old.index("...")
        lines = [*lines[:at], "...", *lines[len(lines) - (len(old) - at - 1) :]]
    return "".join(f"{line}\n" for line in lines)


def renew(page: Path) -> None:
    """Run a page's blocks in the folder that this process is in, and write the page if their output has changed."""
    text, python = page.read_text(encoding="utf-8"), Interpreter()
    blocks = list(FENCE.finditer(text))
    pieces, end = [], 0
    for block, following in zip(blocks, [*blocks[1:], None], strict=True):
        long, language, code = block.groups()
        if language not in ("python", "sh") or long:
            continue
        if language == "python":
            if saved := re.match(r"# (\w+\.py)\n", code):
                Path(saved[1]).write_text(code)
            with contextlib.redirect_stdout(io.StringIO()) as output:
                python.paste(code)
            printed = output.getvalue()
        else:
            printed = subprocess.run(["bash", "-e", "-c", code], capture_output=True, text=True, check=True).stdout
        if following and following[2] == "text" and not same(following[3], printed):
            pieces += [text[end : following.start(3)], shortened(printed, following[3])]
            end = following.end(3)
    page.write_text("".join(pieces) + text[end:], encoding="utf-8")


def main(numbers: list[str]) -> None:
    """Renew the pages whose names begin with the numbers, or all."""
    with tempfile.TemporaryDirectory() as folder:
        command = Path(folder) / "bin" / "sfmrl"
        command.parent.mkdir()
        command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m sfmrl "$@"\n')
        command.chmod(0o755)
        os.environ |= environment() | {"PATH": f"{command.parent}{os.pathsep}{os.environ['PATH']}", "COLUMNS": "80"}
        for page in PAGES:
            if not numbers or page.name.startswith(tuple(numbers)):
                work = Path(folder) / page.stem
                work.mkdir()
                os.chdir(work)
                print(page.name, flush=True)
                renew(page)


if __name__ == "__main__":
    main(sys.argv[1:])
