"""SARL in NumPy, float32: what `sfmrl.network` defines, forward and gradient, layer by layer under the same names.

Two things are arranged for speed. Attention's first layer reads [element, mean]: the mean's half is the same for all
elements of a state, so it is computed once. And mlp2's last layer is linear, so it may follow the weighted sum. Arrays
are kept from call to call, one set a thread.

A state's value does not depend on the rest of its batch. OpenBLAS computes a row of a product to the same bits wherever
the row is, with two exceptions: its AVX2 kernels take twelve rows at a time and treat the second six, and a remainder,
in other ways; its AVX-512 kernels leave small products to another kernel. So the rows of each episode begin at a
multiple of twelve, products are filled up with rows of zeros past that size, and products with a vector are taken one
state at a time.
"""

import math
import threading
from collections.abc import Mapping

import numpy as np

from sfmrl.fast.layers import Parameters, Sizes
from sfmrl.states import OWN

# Of `value_prior`: the fall-off per metre, the distance at which the goal counts as reached (m), and the value there.
PER_METRE, AT_GOAL, PRIOR = np.float32(0.9), np.float32(0.3), np.float32(0.8)

BY_ELEMENT = ("rows", "mlp1.0", "mlp1.2", "mlp2.0", "attention.0", "attention.2")  # arrays with a row an element
BY_STATE = ("mean", "pooled", "joint", "mlp3.0", "mlp3.2", "mlp3.4")  # arrays with a row a state

ROWS = 12  # that AVX2 kernels take at a time
SMALL = 1_000_000  # rows x columns x depth of the largest product that AVX-512 kernels leave to another kernel
LEAST, TINY = np.float32(-1e30), np.float32(1e-30)  # a score below all, and a number that makes 0 of 0 / 0

DIVERGED = np.errstate(over="ignore", invalid="ignore")  # those who call find what is not finite

_arrays = threading.local()


class FastNetwork:
    """The value of robot-centred states (..., K, F), F = 13 or, with social forces, 17, as `ValueNetwork` defines it.

    `parameters` are arrays by CrowdNav's names, with weights (out, in); the network keeps a copy. All are parts of one
    array, `flat`, and their gradients parts of `gradient`; in both, weights are (in, out).
    """

    def __init__(self, parameters: Mapping[str, np.ndarray], value_prior: bool = False) -> None:
        arrays = {name: np.asarray(value, dtype=np.float32).T for name, value in parameters.items()}
        self.flat = np.concatenate([array.ravel() for array in arrays.values()])
        self.gradient = np.zeros_like(self.flat)
        ends = np.cumsum([array.size for array in arrays.values()])[:-1]
        self.parameters, self.gradients = (
            {name: part.reshape(arrays[name].shape) for name, part in zip(arrays, np.split(flat, ends), strict=True)}
            for flat in (self.flat, self.gradient)
        )
        self.value_prior = value_prior
        units = {name: array.size for name, array in arrays.items() if name.endswith("bias")}
        self.sizes = Sizes(*(tuple(units[name] for name in units if name.startswith(part)) for part in Sizes._fields))
        self.own = len(self.parameters["mlp3.0.weight"]) - self.sizes.mlp2[-1]  # how many columns are the robot's own
        self.forces = self.own > len(OWN)
        sizes = {name: array.size for name, array in arrays.items() if name.endswith("weight") and len(array.T) > 1}
        sizes["attention.0.weight"] //= 2  # computed in two halves
        del sizes["mlp1.0.weight"]  # so few columns are summed up in the same order by either kernel
        self._smallest = min(sizes.values())

    def state_dict(self) -> Parameters:
        """A copy of the parameters by CrowdNav's names, with weights (out, in)."""
        return {name: np.ascontiguousarray(value.T) for name, value in self.parameters.items()}

    def load_state_dict(self, parameters: Parameters) -> None:
        """Take over parameters that `state_dict` gave."""
        for name, value in self.parameters.items():
            value[...] = parameters[name].T

    def copy(self) -> "FastNetwork":
        """The same network with parameters of its own."""
        return FastNetwork(self.state_dict(), self.value_prior)

    @DIVERGED
    def evaluate(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values (B,) and shares of attention (B, K) of states (B, K, F); an absent element has NaN in its own columns.

        States (E, A, K, F), A of each of E episodes, are faster: values (E, A), shares (E, A, K). In neither case do a
        state's bits depend on the other states (B) or episodes (E), nor on threads.
        """
        grouped = states if states.ndim == 4 else states[:, None]
        episodes, actions, elements, _ = grouped.shape
        if not episodes * actions:
            return np.zeros(states.shape[:-2], np.float32), np.zeros(states.shape[:-1], np.float32)
        least = SMALL // (episodes * self._smallest) + 1  # rows an episode
        layers = self._forward(grouped, max(actions * elements, least), max(actions, least))
        return layers["value"].reshape(states.shape[:-2]), layers["share"].reshape(states.shape[:-1])

    @DIVERGED
    def loss_and_gradients(self, states: np.ndarray, values: np.ndarray) -> tuple[float, Parameters]:
        """The mean squared error of the values (B,) of states (B, K, F), and its gradient by each parameter's name.

        The gradients are the parts of `gradient`, where the next call overwrites them. Gradients by a layer's output
        are called d_; an array of the forward pass is used again once it is dead.
        """
        batch, elements = states.shape[:2]
        layers = self._forward(states[None], batch * elements, batch)
        p, found, half = self.parameters, self.gradients, self.sizes.mlp1[-1]
        rows, first, hidden, feature, score_1, score_2 = (layers[name][: batch * elements] for name in BY_ELEMENT)
        mean, pooled, joint, last_1, last_2, last_3 = (layers[name][:batch] for name in BY_STATE)
        share, part = layers["share"][0], layers["part"][0]  # (B, K)

        def by_parameters(name: str, d: np.ndarray, x: np.ndarray) -> None:
            np.matmul(x.T, d, out=found[name + ".weight"])
            np.matmul(np.ones(len(d), np.float32), d, out=found[name + ".bias"])

        def through(name: str, d: np.ndarray, x: np.ndarray, into: str | None = None) -> np.ndarray:
            """Write a layer's gradients by its parameters, and return that by its inputs x, in the array `into`."""
            by_parameters(name, d, x)
            return np.matmul(d, p[name + ".weight"].T, out=_array(into, *x.shape) if into else None)

        error = layers["value"][0] - values
        d_value = (error * layers["scale"][0] * np.float32(2 / batch))[:, None]
        d_last = _relu_back(through("mlp3.6", d_value, last_3), last_3)
        d_last = _relu_back(through("mlp3.4", d_last, last_2), last_2)
        d_last = _relu_back(through("mlp3.2", d_last, last_1), last_1)
        d_summary = through("mlp3.0", d_last, joint)[:, self.own :] * layers["anybody"][0]
        d_pooled = through("mlp2.2", d_summary, pooled)  # (B, 100)

        d_share = np.matmul(feature.reshape(batch, elements, -1), d_pooled[..., None])[..., 0]
        d_score = (share * (d_share - (share * d_share).sum(1, keepdims=True))).reshape(-1, 1)
        d_feature = _relu_back(_outer(share, d_pooled, "d_feature"), feature)  # feature is dead now
        np.matmul(score_2.T, d_score, out=found["attention.4.weight"])
        found["attention.4.bias"][:] = 0  # softmax sees no shift
        d_score_2 = np.multiply(d_score, p["attention.4.weight"][:, 0], out=_array("mlp2.0", *score_2.shape))
        d_score_2 = _relu_back(d_score_2, score_2)  # score_2 is dead now
        d_score_1 = _relu_back(through("attention.2", d_score_2, score_1, "attention.2"), score_1)  # score_1 is, too

        # Attention's first layer: a half by element, a half by state.
        d_both = np.matmul(np.ones((1, elements), np.float32), d_score_1.reshape(batch, elements, -1))[:, 0]
        np.matmul(hidden.T, d_score_1, out=found["attention.0.weight"][:half])
        np.matmul(mean.T, d_both, out=found["attention.0.weight"][half:])
        np.matmul(np.ones(batch, np.float32), d_both, out=found["attention.0.bias"])
        d_hidden = through("mlp2.0", d_feature, hidden, "attention.0")  # d_feature is dead now
        d_hidden += np.matmul(d_score_1, p["attention.0.weight"][:half].T, out=_array("d_feature", *hidden.shape))
        d_hidden += _outer(part, np.matmul(d_both, p["attention.0.weight"][half:].T), "d_feature")
        d_first = through("mlp1.2", _relu_back(d_hidden, hidden), first, "d_first")
        by_parameters("mlp1.0", _relu_back(d_first, first), rows)
        return float((error * error).mean()), found

    def _forward(self, states: np.ndarray, element_rows: int, state_rows: int) -> dict[str, np.ndarray]:
        """All layers' outputs for states (E, A, K, F); each episode's rows are padded with zeros to these numbers."""
        (episodes, actions, elements, width), p, half = states.shape, self.parameters, self.sizes.mlp1[-1]
        element_rows, state_rows = (-(-max(rows, 1) // ROWS) * ROWS for rows in (element_rows, state_rows))
        layers: dict[str, np.ndarray] = {}

        def by_element(x: np.ndarray) -> np.ndarray:
            """The rows of elements without the filling, (E, A, K, C)."""
            kept = x.reshape(episodes, element_rows, -1)[:, : actions * elements]
            return kept.reshape(episodes, actions, elements, x.shape[1])

        def by_state(x: np.ndarray) -> np.ndarray:
            """The rows of states without the filling, (E, A, C)."""
            return x.reshape(episodes, state_rows, -1)[:, :actions]

        def filled(name: str, columns: int, rows: int = state_rows, used: int = actions) -> np.ndarray:
            layers[name] = _array(name, episodes * rows, columns)
            layers[name].reshape(episodes, rows, columns)[:, used:] = 0
            return layers[name]

        def product(x: np.ndarray, name: str, weight: np.ndarray) -> np.ndarray:
            layers[name] = np.matmul(x, weight, out=_array(name, len(x), weight.shape[1]))
            return layers[name]

        def layer(x: np.ndarray, name: str) -> np.ndarray:
            return _relu(product(x, name, p[name + ".weight"]), p[name + ".bias"])

        here = ~np.isnan(states[..., self.own])  # (E, A, K)
        there = here.sum(-1, keepdims=True)
        rows = filled("rows", width, element_rows, actions * elements)
        by_element(rows)[...] = states
        if not here.all():
            by_element(rows)[~here] = 0
        hidden = layer(layer(rows, "mlp1.0"), "mlp1.2")
        feature = layer(hidden, "mlp2.0")
        part = layers["part"] = np.divide(here, np.maximum(there, 1), dtype=np.float32)
        mean = filled("mean", half)
        np.matmul(part[..., None, :], by_element(hidden), out=by_state(mean)[..., None, :])

        score_1 = product(hidden, "attention.0", p["attention.0.weight"][:half])
        from_mean = by_state(np.matmul(mean, p["attention.0.weight"][half:])) + p["attention.0.bias"]
        by_element(score_1)[...] += from_mean[:, :, None]
        score_2 = layer(_relu(score_1), "attention.2")
        score = np.matmul(by_element(score_2), p["attention.4.weight"][:, 0]) + p["attention.4.bias"]
        score[~here] = -np.inf
        share = layers["share"] = np.exp(score - score.max(-1, keepdims=True, initial=LEAST))
        share /= np.maximum(share.sum(-1, keepdims=True), TINY)
        pooled = filled("pooled", feature.shape[1])
        np.matmul(share[..., None, :], by_element(feature), out=by_state(pooled)[..., None, :])

        summary = product(pooled, "mlp2.2", p["mlp2.2.weight"]) + p["mlp2.2.bias"]
        anybody = layers["anybody"] = (there > 0).astype(np.float32)
        joint = filled("joint", self.own + summary.shape[1])
        by_state(joint)[..., : self.own] = states[:, :, 0, : self.own] if elements else 0
        by_state(joint)[..., self.own :] = by_state(summary) * anybody
        last = by_state(layer(layer(layer(joint, "mlp3.0"), "mlp3.2"), "mlp3.4"))
        value = layers["value"] = (last * p["mlp3.6.weight"][:, 0]).sum(-1) + p["mlp3.6.bias"]
        layers["scale"] = np.ones_like(value)
        if self.value_prior:
            layers["scale"] = PER_METRE ** np.maximum(by_state(joint)[..., 0] - AT_GOAL, 0)
            layers["value"] = layers["scale"] * (PRIOR + value)
        return layers


def _relu(y: np.ndarray, bias: np.ndarray | None = None) -> np.ndarray:
    """max(y + bias, 0) in place, with many rows as one: NumPy is slow with rows as short as a layer is wide."""
    rows = ROWS if len(y) % (4 * ROWS) else 4 * ROWS
    wide = y.reshape(-1, rows * y.shape[1])
    if bias is not None:
        wide += np.repeat(bias[None], rows, axis=0).ravel()
    np.maximum(wide, np.zeros(wide.shape[1], np.float32), out=wide)
    return y


def _relu_back(d: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The gradient by a ReLU's input, in place of that by its output y."""
    return np.multiply(d, y > 0, out=d)


def _outer(by_element: np.ndarray, by_state: np.ndarray, into: str) -> np.ndarray:
    """Products of a number an element (B, K) and a row a state (B, C), (B K, C), in the array `into`."""
    out = _array(into, *by_element.shape, by_state.shape[1])
    return np.multiply(by_element[..., None], by_state[:, None], out=out).reshape(-1, by_state.shape[1])


def _array(name: str, *shape: int) -> np.ndarray:
    """This thread's array of a name, in a shape; its content is what it was left with."""
    size = math.prod(shape)
    kept = getattr(_arrays, name, None)
    if kept is None or kept.size < size:
        kept = np.empty(size + 16, np.float32)
        kept = kept[-kept.ctypes.data // 4 % 16 :]  # begins at a cache line of 64 bytes
        setattr(_arrays, name, kept)
    return kept[:size].reshape(shape)
