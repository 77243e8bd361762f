"""Test the shipped networks elsewhere than in training, with recovery: `python tests/make_crowds.py`.

Each line of tutorials/results/crowds.csv is one `sfmrl eval NETWORK OPTIONS`, in each single environment, on maps, and
among other crowds. It is written as soon as it is known, and kept until the network's weights change, so the same
command goes on after a stop. The rates also go to crowds.md.
"""

import json
import subprocess
import sys
from pathlib import Path

from make_ablation import read_csv

from sfmrl.runs.files import csv_text
from sfmrl.runs.weights import MODELS
from sfmrl.study.sheets import Sheet, rate

CSV = Path(__file__).parents[1] / "tutorials" / "results" / "crowds.csv"
NETWORKS = [path.stem for path in sorted(MODELS.glob("*.json"))]
PLACES = {f"--environment {name} --episodes 1000": name for name in ("1", "2", "3", "4", "5", "circle")}
PLACES["--environment maps --episodes 400"] = "maps"
VARIED = [
    *(f"--humans {number}" for number in (0, 5, 10, 15, 20)),
    *(f"--human-speed {speed}" for speed in (0.5, 0.75, 1, 1.25, 1.5)),
    "--crowd sfm",
    "--no-robot-visible",
]
CROWDED = "sarl-sfm2"  # the network that all of VARIED is tested with


def tests() -> list[tuple[str, str]]:
    """Networks and options of all tests."""
    varied = [(CROWDED, options) for options in VARIED]
    return varied + [(network, options) for options in PLACES for network in NETWORKS]


def crowds_markdown(lines: list[dict]) -> str:
    """Success and collisions, as tables; environments and networks that have not been tested yet are left out."""
    of = {(line["network"], line["options"]): line for line in lines}
    tested = [name for name in NETWORKS if any((name, options) in of for options in PLACES)]
    known = {options: place for options, place in PLACES.items() if any((name, options) in of for name in tested)}

    def rates(network: str, options: str) -> str:
        line = of.get((network, options))
        return f"{rate(float(line['success']))}, {rate(float(line['collision']))}" if line else "-"

    places = [{"network": n} | {place: rates(n, options) for options, place in known.items()} for n in tested]
    varied = [
        {"options": f"`{options}`", "success, collisions": rates(CROWDED, options)}
        for options in VARIED
        if (CROWDED, options) in of
    ]
    sheets = [Sheet(f"`sfmrl eval {CROWDED}` with further options", varied)]
    sheets += [Sheet("Success and collisions with recovery, by environment", places)] * bool(places)
    return "\n".join(sheet.markdown() for sheet in sheets)


def main() -> None:
    """Make the tests that are missing, and write both files after each."""
    digests = {name: json.loads((MODELS / f"{name}.json").read_text())["sha256"] for name in NETWORKS}
    lines = [line for line in read_csv(CSV) if digests.get(line["network"]) == line["sha256"]]
    for network, options in tests():
        if (network, options) not in {(line["network"], line["options"]) for line in lines}:
            words = [sys.executable, "-m", "sfmrl", "eval", network, *options.split(), "--json"]
            found = json.loads(subprocess.run(words, stdout=subprocess.PIPE, check=True).stdout)
            rates = {name: found[name] for name in ("episodes", "success", "collision", "timeout")}
            lines.append({"network": network, "options": options, **rates, "sha256": digests[network]})
            CSV.write_text(csv_text(lines))
            CSV.with_suffix(".md").write_text(crowds_markdown(lines))
            print(network, options, f"success {rates['success']:.3f}, collisions {rates['collision']:.3f}", flush=True)


if __name__ == "__main__":
    main()
