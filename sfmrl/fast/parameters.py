"""SARL's parameters: their names, shapes and first values, from the numbers of units in its layers."""

from typing import NamedTuple

import numpy as np

from sfmrl.states import column_names, own_columns

Parameters = dict[str, np.ndarray]  # by CrowdNav's names


class Sizes(NamedTuple):
    """Numbers of units in the layers of each part; the defaults are the paper's and CrowdNav's."""

    mlp1: tuple[int, ...] = (150, 100)
    mlp2: tuple[int, ...] = (100, 50)
    attention: tuple[int, ...] = (100, 100, 1)
    mlp3: tuple[int, ...] = (150, 100, 100, 1)


def layer_shapes(forces: bool, sizes: Sizes = Sizes()) -> dict[str, tuple[int, ...]]:
    """The shapes of the parameters by CrowdNav's names; those of weights are (out, in)."""
    hidden, own = sizes.mlp1[-1], own_columns(forces)
    inputs = len(column_names(forces)), hidden, 2 * hidden, own + sizes.mlp2[-1]
    shapes: dict[str, tuple[int, ...]] = {}
    for part, units, first in zip(Sizes._fields, sizes, inputs, strict=True):
        for number, (size, width) in enumerate(zip(units, (first, *units[:-1]), strict=True)):
            shapes |= {f"{part}.{2 * number}.weight": (size, width), f"{part}.{2 * number}.bias": (size,)}
    return shapes


def drawn_parameters(forces: bool, seed: int, sizes: Sizes = Sizes()) -> Parameters:
    """New parameters by name, drawn uniformly within 1 / sqrt(fan in) as torch's layers are."""
    rng = np.random.default_rng(seed)
    parameters, bound = {}, 1.0
    for name, shape in layer_shapes(forces, sizes).items():
        bound = shape[1] ** -0.5 if len(shape) == 2 else bound  # a bias has the bound of the weights before it
        parameters[name] = rng.uniform(-bound, bound, shape).astype(np.float32)
    return parameters
