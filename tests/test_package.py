"""What is built, and how the package is put together: the wheel, its dependencies, who imports whom."""

import ast
import dataclasses
import importlib
import pydoc
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from conftest import ROOT, environment

import sfmrl

# The core, in reading order: a file imports only those above it, and own_code/, orca/ and fast/.
CORE = (
    *("config", "variants", "geometry", "batch", "sfm", "rewards", "placement", "scenes"),
    *("world", "actions", "states", "network", "traps", "lookahead", "policies", "episodes", "evaluation", "learning"),
    *("exploration", "imitation", "reinforcement"),
)
# The wings: a folder imports the core and the wings before it.
WINGS = ("own_code", "orca", "fast", "recovery", "maps", "runs", "replay", "envs", "study", "lessons", "cli")
# The three that the core uses import these of its files alone.
KERNELS = {"own_code": {"config"}, "orca": {"geometry"}, "fast": {"config", "states"}}
# Inside a function: where a name may be that of a map or of a trained network, for recovery, and for notebooks.
LATER = {
    "scenes": {"maps", "replay.picture"},
    "policies": {"recovery", "runs.weights"},
    "evaluation": {"recovery", "replay.picture"},
    "episodes": {"replay.picture"},
}
EXTRAS = {  # what optional extras install, and the files that use it
    "jobs": {"ray"},
    "plots": {"matplotlib"},
    "environments": {"gymnasium"},
    "sb3": {"stable_baselines3"},
}
WITH_TORCH = {"network"}
PACKAGE = sorted((ROOT / "sfmrl").rglob("*.py"))
MODELS = sorted((ROOT / "sfmrl" / "models").iterdir())
DATA = [ROOT / "sfmrl" / name for name in ("__init__.pyi", "maps/layouts.txt", "py.typed")]
FILES = [path for path in PACKAGE if path.parent.name != "sfmrl" or path.stem not in ("__init__", "__main__")]


def name_of(path: Path) -> str:
    """A file's name as it is imported, without "sfmrl."."""
    return ".".join(path.relative_to(ROOT / "sfmrl").with_suffix("").parts).removesuffix(".__init__")


def imports(path: Path, top_only: bool = False) -> set[str]:
    """Full names of all that a file imports, "sfmrl.orca" for `from sfmrl import orca` too."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    found = set()
    for node in tree.body if top_only else ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name} has a relative import"
            folder = ROOT / node.module.replace(".", "/")
            inner = {f"{node.module}.{a.name}" for a in node.names if (folder / f"{a.name}.py").exists()}
            found |= inner or {node.module}
    return found


def test_the_core_is_flat_and_all_that_serves_it_stands_in_folders():
    folders = {path.name for path in (ROOT / "sfmrl").iterdir() if path.is_dir()}
    assert folders - {"__pycache__"} == {*WINGS, "models"}  # models: trained networks and their cards, no code
    assert {path.suffix for path in MODELS} == {".json", ".npz"}
    assert {path.stem for path in FILES if path.parent.name == "sfmrl"} == set(CORE)


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_a_file_imports_only_what_is_below_it(path):
    name = name_of(path)
    wing = name.partition(".")[0]
    if name in CORE:
        below = {*CORE[: CORE.index(name)], *KERNELS}
    else:
        below = {wing} | KERNELS.get(wing, {*CORE, *WINGS[: WINGS.index(wing)]})

    def above(names: set[str]) -> set[str]:
        inner = {other.removeprefix("sfmrl.") for other in names if other.startswith("sfmrl.")}
        return {other for other in inner if not {other, other.partition(".")[0]} & below}

    assert above(imports(path, top_only=True)) == set()
    assert above(imports(path)) <= LATER.get(name, set())


@pytest.mark.parametrize("path", PACKAGE, ids=name_of)
def test_only_few_files_import_torch_and_none_click(path):
    outer = {name.partition(".")[0] for name in imports(path, top_only=True)}
    assert ("torch" in outer) == (name_of(path) in WITH_TORCH)
    allowed = set(sys.stdlib_module_names) | {"sfmrl", "numpy", "torch", "typer", "rich"}
    allowed |= EXTRAS.get(path.stem, set())
    assert {name.partition(".")[0] for name in imports(path)} <= allowed


@pytest.mark.parametrize("path", PACKAGE, ids=name_of)
def test_a_file_says_what_it_is(path):
    assert ast.get_docstring(ast.parse(path.read_text(encoding="utf-8")))


def test_crowdnav_is_called_by_its_name_wherever_a_user_reads():
    pages = [*PACKAGE, ROOT / "README.md", *(ROOT / "tutorials").glob("*.md")]
    assert [path.name for path in pages if re.search(r"\bCRI\b", path.read_text(encoding="utf-8"))] == []


def test_importing_sfmrl_costs_nothing_and_every_name_it_promises_is_there():
    code = (
        "import sys, sfmrl\n"
        "assert not {'numpy', 'torch', 'typer'} & set(sys.modules)\n"
        "for name in sfmrl.__all__: assert getattr(sfmrl, name) is not None, name\n"
        "try: sfmrl.nothing\n"
        "except AttributeError as error: print(error)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "module 'sfmrl' has no attribute 'nothing'"


def test_the_stub_has_the_names_that_sfmrl_promises_from_the_same_files_in_their_order():
    lines = (ROOT / "sfmrl" / "__init__.pyi").read_text(encoding="utf-8").splitlines()
    named = [f"from sfmrl.{where} import {name} as {name}" for where, names in sfmrl._HOME.items() for name in names]
    assert [line for line in lines if line][1:] == [*named, "__version__: str"]  # the first line says what it is


USER = """
from typing import Any, assert_type
import numpy as np
import sfmrl

def still(world: sfmrl.World, crowd_velocity: np.ndarray) -> np.ndarray:
    return np.zeros((len(world), 2))

record = sfmrl.play(sfmrl.sample_scenes(1, 10), still, reward="sfm")
assert_type(record, sfmrl.Record)
assert_type(sfmrl.__version__, str)
assert_type(sfmrl.evaluate("orca", episodes=10), dict[str, Any])
sfmrl.play(sfmrl.sample_scenes(1, 10), still, rewards="sfm")
"""


def test_mypy_knows_what_the_public_names_take_and_return(tmp_path):
    pytest.importorskip("mypy")
    (tmp_path / "user.py").write_text(USER, encoding="utf-8")
    # torch takes most of the time, and nothing here needs its types.
    (tmp_path / "mypy.ini").write_text("[mypy]\nstrict = True\n[mypy-torch.*]\nfollow_imports = skip\n")
    words = [sys.executable, "-m", "mypy", "--follow-imports=silent", "user.py"]
    done = subprocess.run(
        words, cwd=tmp_path, env=environment() | {"MYPYPATH": str(ROOT)}, capture_output=True, text=True, check=False
    )
    assert done.stdout.splitlines()[0].startswith(
        f"user.py:{len(USER.splitlines())}: error: Unexpected keyword argument"
    )
    assert "Found 1 error in 1 file" in done.stdout


@pytest.mark.parametrize("name", ["benchmark", *(path.stem for path in sorted((ROOT / "tests").glob("make_*.py")))])
def test_the_scripts_for_contributors_can_be_imported(name):
    importlib.import_module(name)


@pytest.mark.parametrize("name", sfmrl.__all__)
def test_help_shows_every_field_of_what_holds_data(name):
    shown = getattr(sfmrl, name)
    described = set(re.findall(r"\w+", shown.__doc__ or ""))
    fields = dataclasses.fields(shown) if dataclasses.is_dataclass(shown) else ()
    assert {item.name for item in fields} <= described


def test_help_says_what_a_policy_and_a_reward_are_given_and_return():
    shown = " ".join(pydoc.render_doc(sfmrl.play, renderer=pydoc.plaintext).split())
    for said in ("with the `World`", "velocities (E, N, 2)", "returns the robots' velocities (E, 2)", "a `Transition`"):
        assert said in shown


def test_the_wheel_holds_sfmrl_alone_and_asks_for_four_packages(tmp_path):
    pytest.importorskip("setuptools", "77")
    source = tmp_path / "source"
    source.mkdir()
    for name in ("pyproject.toml", "README.md", "LICENSE", "sfmrl.py"):
        shutil.copy(ROOT / name, source)
    for name in ("sfmrl", "tests", "tutorials"):
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__", "data"))
    words = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", tmp_path, source]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    (wheel,) = tmp_path.glob("sfmrl-*-py3-none-any.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        (metadata,) = (name for name in names if name.endswith("METADATA"))
        lines = archive.read(metadata).decode().splitlines()
    places = {name.partition("/")[0] for name in names}
    assert places == {"sfmrl", metadata.partition("/")[0]}
    inner = {f"sfmrl/{path.relative_to(ROOT / 'sfmrl')}" for path in (*PACKAGE, *MODELS, *DATA)}
    assert {name for name in names if name.startswith("sfmrl/")} == inner
    assert f"Version: {sfmrl.__version__}" in lines
    needed = [line.removeprefix("Requires-Dist: ") for line in lines if line.startswith("Requires-Dist: ")]
    assert {name.partition(">")[0] for name in needed if "extra ==" not in name} == {"numpy", "torch", "typer", "rich"}
    assert any(name.endswith("LICENSE") for name in names)
