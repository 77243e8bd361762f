"""Files of networks: those of sfmrl and CrowdNav are read; foreign, damaged and evil ones are refused in one line."""

import io
import json
import os
import pickle
import re
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from conftest import DATA
from torch import nn

from sfmrl.config import Config, ConfigError
from sfmrl.evaluation import evaluation_record, metrics
from sfmrl.fast import Sizes, as_fast
from sfmrl.network import ValueNetwork
from sfmrl.policies import load_policy
from sfmrl.runs.crowdnav import differing_settings, export_weights
from sfmrl.runs.files import DamagedFile
from sfmrl.runs.weights import load_weights, save_weights
from sfmrl.variants import make_config

OTHER_SIZES = Sizes((50, 30), (70, 20), (40, 25, 1), (60, 80, 35, 1))


@pytest.fixture(scope="module")
def crowdnav_weights() -> dict[str, torch.Tensor]:
    with np.load(DATA / "crowdnav_sarl.npz") as data:
        return {n.removeprefix("weights/"): torch.from_numpy(data[n]) for n in data if n.startswith("weights/")}


def test_a_weights_file_gives_back_network_and_config(tmp_path):
    config = make_config("paper", "sarl-sfm6", seed=9)
    network = ValueNetwork(config.forces, config.value_prior, seed=9)
    save_weights(network, config, tmp_path / "weights.npz")
    loaded, read = load_weights(tmp_path / "weights.npz")
    assert read == config
    states = np.random.default_rng(0).normal(size=(5, 4, 17)).astype(np.float32)
    np.testing.assert_array_equal(loaded.evaluate(states)[0], as_fast(network).evaluate(states)[0])


def test_a_weights_file_of_an_older_version_is_refused_with_its_version(tmp_path):
    older = json.dumps(json.loads(make_config("paper").to_json()) | {"precision": "bf16", "shaping": "none"})
    torch.save({"weights": ValueNetwork().state_dict(), "config": older}, tmp_path / "weights.pt")
    with pytest.raises(ConfigError, match=r"weights.pt cannot be used: it was made by a version of sfmrl before 0.3.0"):
        load_policy(tmp_path / "weights.pt")


def test_an_exported_network_is_a_checkpoint_that_torch_and_sfmrl_load(tmp_path):
    definition = ValueNetwork(forces=True, seed=6)
    network = as_fast(definition)
    for given in (network, definition):
        export_weights(given, tmp_path / "rl_model.pth")
        module = ValueNetwork(forces=True)
        module.load_state_dict(torch.load(tmp_path / "rl_model.pth", weights_only=True))
        np.testing.assert_array_equal(as_fast(module).flat, network.flat)
        np.testing.assert_array_equal(load_weights(tmp_path / "rl_model.pth")[0].flat, network.flat)


def test_a_plain_crowdnav_checkpoint_is_a_policy(tmp_path, crowdnav_weights):
    path = tmp_path / "rl_model.pth"
    torch.save(crowdnav_weights, path)
    policy = load_policy(path)
    assert policy.config.reward.reward == "crowd"
    assert not policy.config.forces
    record = evaluation_record(policy, environment="circle", episodes=2)
    result = metrics(record)
    assert result["episodes"] == 2
    assert result["success"] + result["collision"] + result["timeout"] == 1
    assert (record.scenes.environment == "circle").all()


class Evil:
    """Pickled, this would create a file when it is loaded."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


def saved(content: object) -> bytes:
    file = io.BytesIO()
    torch.save(content, file)
    return file.getvalue()


PLAIN = ValueNetwork(seed=3, sizes=OTHER_SIZES).state_dict()
WRAPPED = {
    "as CrowdNav saves it": PLAIN,
    "of DataParallel": {f"module.{name}": value for name, value in PLAIN.items()},
    "in a larger model": {f"model.{name}": value for name, value in PLAIN.items()},
    "with an epoch": {"state_dict": PLAIN, "epoch": 3},
    "with an optimizer": {"model": {f"module.{name}": value for name, value in PLAIN.items()}, "optimizer": {}},
    "in double precision": {"model_state_dict": {name: value.double() for name, value in PLAIN.items()}},
}


@pytest.mark.parametrize("how", WRAPPED)
def test_a_network_of_any_size_is_read_however_it_is_wrapped(tmp_path, how):
    torch.save(WRAPPED[how], tmp_path / "some.pth")
    network, config = load_weights(tmp_path / "some.pth")
    assert (network.forces, config.forces) == (False, False)
    assert network.state_dict().keys() == PLAIN.keys()
    assert all(np.array_equal(value, PLAIN[name]) for name, value in network.state_dict().items())


def test_crowdnav_s_output_folder_plays_its_network_and_says_what_it_was_trained_for(tmp_path):
    torch.save(PLAIN, tmp_path / "rl_model.pth")
    path = tmp_path / "rl_model.pth"
    assert np.array_equal(load_policy(tmp_path).network.flat, as_fast(ValueNetwork(seed=3, sizes=OTHER_SIZES)).flat)
    assert differing_settings(path, robot_visible=True) == []
    (tmp_path / "policy.config").write_text("[action_space]\nkinematics = unicycle\n")
    (tmp_path / "env.config").write_text("[robot]\nvisible = false\n")
    moves, seen = differing_settings(path, robot_visible=True)
    assert "unicycle" in moves
    assert "--no-robot-visible" in seen
    assert differing_settings(path, robot_visible=False) == [moves]
    assert differing_settings(path, robot_visible=False, kinematics="unicycle") == []
    (tmp_path / "policy.config").write_bytes(b"\xff[")
    (tmp_path / "env.config").write_text("no section")
    assert differing_settings(path, robot_visible=True) == []


LAYERS = ValueNetwork().state_dict()
GOOD = {"weights": LAYERS, "config": Config().to_json()}
ENDLESS = {}
ENDLESS["state_dict"] = ENDLESS


def altered(**layers: object) -> bytes:
    """A good network with some parameters replaced; "mlp3_6_bias" is mlp3.6.bias."""
    return saved(LAYERS | {name.replace("_", "."): value for name, value in layers.items()})


def ours(config: object = Config().to_json(), **layers: object) -> bytes:
    """The same as a weights file of sfmrl's."""
    file = io.BytesIO()
    np.savez(file, config=config, **LAYERS | {name.replace("_", "."): value for name, value in layers.items()})
    return file.getvalue()


FOREIGN = {  # and what is said of some of them
    "empty": (b"", "is empty"),
    "a web page": (b"\n<!DOCTYPE html><html>404</html>", "is a web page"),
    "a git-lfs pointer": (b"version https://git-lfs.github.com/spec/v1\noid sha256:abc\n", "git lfs pull"),
    "text": (b"no weights at all\n", ""),
    "cut in half": (saved(GOOD)[: len(saved(GOOD)) // 2], ""),
    "a list": (saved([1, 2, 3]), ""),
    "another dict": (saved({"epoch": 3}), ""),
    "keys that are numbers": (saved({3: torch.zeros(3)}), ""),
    "a wrapper that holds itself": (saved(ENDLESS), ""),
    "a tensor": (saved(torch.zeros(3)), ""),
    "a module": (saved(nn.Linear(3, 3)), "state_dict"),
    "another network": (saved(nn.Linear(13, 150).state_dict()), ""),
    "a layer too few": (saved({n: v for n, v in LAYERS.items() if n != "mlp3.6.bias"}), "there is no mlp3.6.bias"),
    "a layer too many": (altered(extra_weight=torch.zeros(3, 3)), "there is extra.weight, too"),
    "CADRL": (saved({"value_network.0.weight": torch.zeros(150, 13)}), "CADRL"),
    "LSTM-RL": (saved({"mlp.0.weight": torch.zeros(150, 56), "lstm.weight_ih_l0": torch.zeros(200, 13)}), "LSTM-RL"),
    "OM-SARL": (altered(mlp1_0_weight=torch.zeros(150, 61)), "OM-SARL: mlp1.0.weight reads 61 columns"),
    "attention without the mean": (altered(attention_0_weight=torch.zeros(100, 100)), "with_global_state"),
    "layers that do not fit": (
        altered(attention_2_weight=torch.zeros(100, 90)),
        "attention.2.weight is (100, 90), not (100, 100)",
    ),
    "other columns": (altered(mlp1_0_weight=torch.zeros(150, 12)), "mlp1.0.weight is (150, 12), not (150, 13)"),
    "a sparse layer": (altered(mlp1_0_weight=torch.zeros(150, 13).to_sparse()), ""),
    "a layer without numbers": (altered(mlp1_0_weight=torch.zeros(150, 13, device="meta")), ""),
    "a layer of integers": (altered(mlp1_0_weight=torch.zeros(150, 13, dtype=torch.int8)), ""),
    "a complex layer": (altered(mlp1_0_weight=torch.zeros(150, 13, dtype=torch.complex64)), ""),
    "a layer that is endless": (altered(mlp1_0_weight=torch.zeros(1, 1).expand(2**30, 2**30)), ""),
    "layers with nothing": (altered(mlp1_0_weight=torch.zeros(0, 13), mlp1_0_bias=torch.zeros(0)), ""),
    "numbers for layers": (saved(dict.fromkeys(LAYERS, 0.5)), ""),
    "weights that are NaN": (
        altered(mlp3_6_bias=torch.full((1,), torch.nan)),
        "mlp3.6.bias holds numbers that are not",
    ),
    "weights too large for float32": (
        altered(mlp1_0_bias=torch.full((150,), 1e300, dtype=torch.float64)),
        "mlp1.0.bias holds numbers that are not finite",
    ),
    "weights that are none": (saved(GOOD | {"weights": 3}), ""),
    "a config that is no JSON": (ours("seed = 0"), "the config in"),
    "a config that is no text": (saved(GOOD | {"config": 5}), "the config in"),
    "a config that is a list": (ours("[1]"), "the config in"),
    "a config with an unknown setting": (ours('{"sede": 1}'), "did you mean seed"),
    "a config that is deep": (ours('{"a":' * 100_000), "the config in"),
    "a config of other columns": (ours(Config(forces=True).to_json()), "reads other columns"),
    "ours that is cut in half": (ours()[: len(ours()) // 2], ""),
    "ours without a config": (ours().replace(b"config.npy", b"confyg.npy"), ""),
    "ours with Python objects": (ours(np.array([{}], dtype=object)), ""),
    "ours with a layer of integers": (ours(mlp3_6_bias=np.zeros(1, int)), "mlp3.6.bias is not a plain tensor"),
    "ours that is not finite": (ours(mlp3_6_bias=np.full(1, np.nan)), "mlp3.6.bias holds numbers that are not finite"),
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("what", FOREIGN)
def test_files_that_hold_no_sarl_network_are_named_in_one_line(tmp_path, what):
    path, (data, said) = tmp_path / "some.pt", FOREIGN[what]
    path.write_bytes(data)
    with pytest.raises(ConfigError, match=r"some\.pt") as error:
        load_policy(path)
    assert "\n" not in str(error.value)
    assert said in str(error.value)


def test_a_crowdnav_checkpoint_with_a_flipped_bit_is_damaged(tmp_path):
    data = bytearray(saved(PLAIN))
    data[data.index(PLAIN["mlp1.0.weight"].numpy().tobytes()) + 100] ^= 1
    (tmp_path / "rl_model.pth").write_bytes(data)
    with pytest.raises(ConfigError, match=r"rl_model\.pth is damaged: the checksum of .* is wrong"):
        load_policy(tmp_path / "rl_model.pth")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes with names")
def test_a_pipe_is_no_weights_file_and_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "some.pt")
    with pytest.raises(DamagedFile, match=r"some\.pt is not a regular file"):
        load_policy(tmp_path / "some.pt")


def test_a_network_too_large_to_have_finite_values_is_not_played(tmp_path):
    network = as_fast(ValueNetwork())
    network.flat *= 1e30
    save_weights(network, Config(), tmp_path / "weights.npz")
    with pytest.raises(ConfigError, match="values are not finite"):
        evaluation_record(load_policy(tmp_path / "weights.npz"), environment="5", episodes=1)


@pytest.mark.filterwarnings("ignore:Detected pickle protocol")
@pytest.mark.parametrize("write", [pickle.dumps, saved], ids=["pickle", "torch"])
def test_a_file_that_would_run_code_is_refused_and_does_not_run(tmp_path, write):
    path, trace = tmp_path / "evil.pt", tmp_path / "trace"
    path.write_bytes(write({"weights": Evil(trace), "config": "{}"}))
    with pytest.raises(ConfigError, match=r"evil\.pt") as error:
        load_policy(path)
    assert not trace.exists()
    assert "weights_only" not in str(error.value)  # torch's own text tells how to load it all the same


def test_a_weights_file_that_differs_from_its_digest_is_damaged(tmp_path):
    path = tmp_path / "weights.npz"
    save_weights(ValueNetwork(), Config(), path)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    with pytest.raises(DamagedFile, match=re.escape(str(path))):
        load_policy(path)
    with pytest.raises(DamagedFile, match=re.escape(str(path))):
        load_policy(tmp_path)


def test_what_crowdnav_would_play_otherwise_is_not_exported_and_no_contradiction_is_saved(tmp_path):
    prior = as_fast(ValueNetwork(value_prior=True))
    with pytest.raises(ConfigError, match="train one with --no-value-prior"):
        export_weights(prior, tmp_path / "rl_model.pth")
    for config in (Config(), Config(value_prior=True, forces=True)):
        with pytest.raises(ConfigError, match=r"the config has (value_prior|forces)"):
            save_weights(prior, config, tmp_path / "some.npz")
    assert list(tmp_path.iterdir()) == []
    parameters = prior.state_dict()
    parameters["mlp1.0.weight"] = parameters["mlp1.0.weight"][:1]
    with pytest.raises(ValueError, match=r"mlp1.0.weight has shape \(1, 13\), not \(150, 13\)"):
        prior.load_state_dict(parameters)


def test_a_checkpoint_without_torch_is_one_error(tmp_path, monkeypatch):
    (tmp_path / "some.pth").write_bytes(saved(PLAIN))
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(ConfigError, match="to read one of CrowdNav, install torch"):
        load_weights(tmp_path / "some.pth")
