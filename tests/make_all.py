"""Train and test what has a file in tutorials/results/ or sfmrl/models/: `python tests/make_all.py FOLDER`.

It takes days of two cores, and can be stopped: the same command goes on. What is finished stays in FOLDER. After a
change of the recipe, begin with an empty FOLDER, and delete the files in tutorials/results/. Figures go there, networks
to sfmrl/models/, output to the pages. Read what has changed (git diff), and correct the text around it, also in
README.md, tutorials/results.md and tutorials/tables.md.
"""

import shlex
import subprocess
import sys
from pathlib import Path

RUN = [sys.executable, "-m", "sfmrl"]
COMMANDS = """
sfmrl table 1 --folder FOLDER
sfmrl table 2 --folder FOLDER
sfmrl il --kinematics unicycle --run FOLDER/turning-il --continue
sfmrl rl --kinematics unicycle --reward sfm --from FOLDER/turning-il --run FOLDER/turning --continue
python TESTS/make_models.py FOLDER 0-2
python TESTS/make_models.py unicycle FOLDER/turning
python TESTS/make_ablation.py FOLDER 0-4
python TESTS/make_ablation.py FOLDER 5-9 "nothing,value prior,reinforcement,all learning"
python TESTS/make_crowds.py
sfmrl table 1 --preset paper --folder FOLDER/early ROWS --seeds 0-4 --episodes 3000 --validation-interval 500
sfmrl table 1 --preset paper --folder FOLDER/paper ROWS --seeds 0-2
python TESTS/make_tables.py FOLDER
python TESTS/make_pages.py
"""
# These tell what holds of the paper's claims, under its own schedule.
ROWS = "--rows sarl,sarl-sfm2,sarl-sfm5,sarl-sfm6"


def main(folder: str) -> None:
    """Run all commands in turn, until one fails."""
    places = {"FOLDER": shlex.quote(folder), "TESTS": shlex.quote(str(Path(__file__).parent)), "ROWS": ROWS}
    for command in COMMANDS.strip().splitlines():
        for name, place in places.items():
            command = command.replace(name, place)
        print(command, flush=True)
        program, *words = shlex.split(command)
        code = subprocess.run([*(RUN if program == "sfmrl" else [sys.executable]), *words], check=False).returncode
        if code:
            sys.exit(f"make_all: this command ended with {code}; go on with python tests/make_all.py {folder}")


if __name__ == "__main__":
    main(sys.argv[1])
