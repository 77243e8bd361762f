"""The network in NumPy, which plays and learns, as `sfmrl.network` defines it. OpenBLAS is set to one thread."""

from typing import Any

from sfmrl.config import Config
from sfmrl.fast.blas import kernels as kernels
from sfmrl.fast.network import FastNetwork
from sfmrl.fast.parameters import Sizes as Sizes
from sfmrl.fast.parameters import drawn_parameters


def new_network(config: Config, seed: int = 0) -> FastNetwork:
    """The network that a config asks for, drawn from `seed`."""
    return FastNetwork(drawn_parameters(config.forces, seed), config.value_prior)


def as_fast(network: Any) -> FastNetwork:
    """A `FastNetwork` as it is; a `ValueNetwork` as a `FastNetwork` with a copy of its parameters."""
    return network if isinstance(network, FastNetwork) else FastNetwork(network.state_dict(), network.value_prior)
