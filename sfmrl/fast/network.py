"""SARL in NumPy, float32: what `sfmrl.network` defines, forward and gradient, under the names of its `forward`.

Two things make it fast. Attention's first layer reads [element, mean], and the mean's half is the same for all elements
of a state, so it is computed once. mlp2's last layer is linear, so it may follow the weighted sum over the elements.
Arrays are reused from call to call, one set for each thread.

A state's value does not depend on the rest of its batch. OpenBLAS computes a row of a product to the same bits wherever
the row is, with two exceptions: its AVX2 kernels take twelve rows at a time and treat the second six, and a remainder,
differently; its AVX-512 kernels leave small products to another kernel. So the rows of each episode begin at a multiple
of twelve, rows of zeros make every product too large for the other kernel, and products with a vector are taken one
state at a time.
"""

from collections.abc import Mapping

import numpy as np

from sfmrl.fast.arrays import Layers, array, outer, relu, relu_back
from sfmrl.fast.parameters import Parameters
from sfmrl.states import OWN

# Of `value_prior`: the fall-off per metre, the distance at which the goal counts as reached (m), and the value there.
PER_METRE, AT_GOAL, PRIOR = np.float32(0.9), np.float32(0.3), np.float32(0.8)

BY_ELEMENT = ("rows", "mlp1.0", "mlp1.2", "mlp2.0", "attention.0", "attention.2")  # layers with a row per element
BY_STATE = ("mean", "pooled", "joint", "mlp3.0", "mlp3.2", "mlp3.4")  # layers with a row per state

SMALL = 1_000_000  # rows x columns x depth of the largest product that AVX-512 kernels leave to another kernel
LEAST, TINY = np.float32(-1e30), np.float32(1e-30)  # a score below all, and a divisor that makes 0 / 0 a 0

DIVERGED = np.errstate(over="ignore", invalid="ignore")  # callers check that values and losses are finite


class FastNetwork:
    """The value of robot-centred states, F = 13 columns or, with social forces, 17, as `ValueNetwork` defines it.

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
        # mlp3 reads the robot's own columns and mlp2's output.
        self.own = len(self.parameters["mlp3.0.weight"]) - len(self.parameters["mlp2.2.bias"])
        self.forces = self.own > len(OWN)
        products = {name: array.size for name, array in arrays.items() if name.endswith("weight") and len(array.T) > 1}
        products["attention.0.weight"] //= 2  # computed in two halves
        del products["mlp1.0.weight"]  # either kernel adds up so few columns in the same order
        self._smallest = min(products.values())

    def state_dict(self) -> Parameters:
        """A copy of the parameters by CrowdNav's names, with weights (out, in)."""
        return {name: np.ascontiguousarray(value.T) for name, value in self.parameters.items()}

    def load_state_dict(self, parameters: Parameters) -> None:
        """Copy the parameters that `state_dict` returned into this network; raises ValueError for other shapes."""
        for name, value in self.parameters.items():
            if parameters[name].shape != value.T.shape:
                raise ValueError(f"{name} has shape {parameters[name].shape}, not {value.T.shape}")
        for name, value in self.parameters.items():
            value[...] = parameters[name].T

    def __reduce__(self) -> tuple:  # for pickle and copy: `parameters` must stay parts of `flat`
        return FastNetwork, (self.state_dict(), self.value_prior)

    @DIVERGED
    def evaluate(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values (B,) and attention (B, K) of states (B, K, F), K >= 1; an absent element has NaN in its own columns.

        States (E, A, K, F), A of each of E episodes, are faster: values (E, A), attention (E, A, K). In neither case do
        a state's bits depend on the other states (B) or episodes (E), nor on threads.
        """
        grouped = states if states.ndim == 4 else states[:, None]
        episodes, actions, elements, _ = grouped.shape
        if not episodes * actions:
            return np.zeros(states.shape[:-2], np.float32), np.zeros(states.shape[:-1], np.float32)
        least = SMALL // (episodes * self._smallest) + 1  # rows per episode
        layers = self._forward(grouped, max(actions * elements, least), max(actions, least))
        return layers["value"].reshape(states.shape[:-2]), layers["share"].reshape(states.shape[:-1])

    @DIVERGED
    def loss_and_gradients(self, states: np.ndarray, values: np.ndarray) -> tuple[float, Parameters]:
        """The mean squared error of the values (B,) of states (B, K, F), and its gradient by each parameter's name.

        The gradients are the parts of `gradient`, where the next call overwrites them.
        """
        batch, elements, _ = states.shape
        layers = self._forward(states[None], batch * elements, batch)
        error = layers["value"][0] - values
        self._backward(layers, (error * layers["scale"][0] * np.float32(2 / batch))[:, None])
        return float((error * error).mean()), self.gradients

    def _forward(self, states: np.ndarray, element_rows: int, state_rows: int) -> Layers:
        """All layers' outputs for states (E, A, K, F), with at least these numbers of rows for each episode."""
        p, own = self.parameters, self.own
        layers = Layers(p, states.shape[:3], element_rows, state_rows)
        here = ~np.isnan(states[..., own])  # (E, A, K)
        count = here.sum(-1, keepdims=True)
        # Weights of the elements in the mean of the crowd: equal ones, as `share` has those of attention.
        equal = layers["equal"] = np.divide(here, np.maximum(count, 1), dtype=np.float32)
        anybody = layers["anybody"] = (count > 0).astype(np.float32)  # (E, A, 1)
        rows = layers.padded("rows", states.shape[-1], layers.element_rows, here[0].size)
        layers.by_element(rows)[...] = states
        if not here.all():
            layers.by_element(rows)[~here] = 0
        hidden = layers.dense(layers.dense(rows, "mlp1.0"), "mlp1.2")
        feature = layers.dense(hidden, "mlp2.0")
        mean = layers.weighted("mean", equal, hidden)
        share = layers["share"] = self._attention(layers, hidden, mean, here)  # (E, A, K)
        pooled = layers.weighted("pooled", share, feature)
        crowd = layers.product(pooled, "mlp2.2", p["mlp2.2.weight"]) + p["mlp2.2.bias"]

        joint = layers.padded("joint", own + crowd.shape[1])
        layers.by_state(joint)[..., :own] = states[:, :, 0, :own]
        layers.by_state(joint)[..., own:] = layers.by_state(crowd) * anybody
        last = layers.by_state(layers.dense(layers.dense(layers.dense(joint, "mlp3.0"), "mlp3.2"), "mlp3.4"))
        value = layers["value"] = (last * p["mlp3.6.weight"][:, 0]).sum(-1) + p["mlp3.6.bias"]  # (E, A)
        layers["scale"] = np.ones_like(value)  # the value's derivative by mlp3's output
        if self.value_prior:
            layers["scale"] = PER_METRE ** np.maximum(layers.by_state(joint)[..., 0] - AT_GOAL, 0)
            layers["value"] = layers["scale"] * (PRIOR + value)
        return layers

    def _attention(self, layers: Layers, hidden: np.ndarray, mean: np.ndarray, here: np.ndarray) -> np.ndarray:
        """The share of attention that each element gets, (E, A, K)."""
        p = self.parameters
        by_hidden, by_mean = _halves(p["attention.0.weight"])
        score_1 = layers.product(hidden, "attention.0", by_hidden)
        from_mean = layers.by_state(np.matmul(mean, by_mean)) + p["attention.0.bias"]
        layers.by_element(score_1)[...] += from_mean[:, :, None]
        score_2 = layers.dense(relu(score_1), "attention.2")
        score = np.matmul(layers.by_element(score_2), p["attention.4.weight"][:, 0]) + p["attention.4.bias"]
        score[~here] = -np.inf
        share = np.exp(score - score.max(-1, keepdims=True, initial=LEAST))
        share /= np.maximum(share.sum(-1, keepdims=True), TINY)
        return share

    def _backward(self, layers: Layers, d_value: np.ndarray) -> None:
        """Write all gradients, given the one by mlp3's output (B, 1). d_x is the gradient by x.

        Comments say which array of the forward pass is dead: not read again, so a later gradient is written into it.
        """
        p, d_p, (batch, elements) = self.parameters, self.gradients, layers["share"][0].shape
        share, equal, anybody = (layers[name][0] for name in ("share", "equal", "anybody"))
        rows, first, hidden, feature, score_1, score_2 = (layers[name][: batch * elements] for name in BY_ELEMENT)
        mean, pooled, joint, *last = (layers[name][:batch] for name in BY_STATE)

        d = d_value
        for name, x in zip(("mlp3.6", "mlp3.4", "mlp3.2"), reversed(last), strict=True):
            d = relu_back(self._through(name, d, x), x)
        d_crowd = self._through("mlp3.0", d, joint)[:, self.own :] * anybody  # (B, 50)
        d_pooled = self._through("mlp2.2", d_crowd, pooled)  # (B, 100)
        d_share = np.matmul(feature.reshape(batch, elements, -1), d_pooled[..., None])[..., 0]  # (B, K)
        # Softmax: d share_i / d score_j = share_i ((i == j) - share_j).
        d_score = (share * (d_share - (share * d_share).sum(1, keepdims=True))).reshape(-1, 1)
        d_feature = relu_back(outer(share, d_pooled, "d_feature"), feature)  # mlp2.0 is dead now

        np.matmul(score_2.T, d_score, out=d_p["attention.4.weight"])  # the bias shifts all scores: its gradient is 0
        d_score_2 = np.multiply(d_score, p["attention.4.weight"][:, 0], out=array("mlp2.0", *score_2.shape))
        d_score_2 = relu_back(d_score_2, score_2)  # attention.2 is dead now
        d_score_1 = self._through("attention.2", d_score_2, score_1, "attention.2")
        d_score_1 = relu_back(d_score_1, score_1)  # attention.0 is dead now
        # All elements of a state read the same mean, so the gradient by it is the sum over the elements: (B, 100).
        d_from_mean = np.matmul(np.ones((1, elements), np.float32), d_score_1.reshape(batch, elements, -1))[:, 0]
        d_by_hidden, d_by_mean = _halves(d_p["attention.0.weight"])
        np.matmul(hidden.T, d_score_1, out=d_by_hidden)
        np.matmul(mean.T, d_from_mean, out=d_by_mean)
        np.matmul(np.ones(batch, np.float32), d_from_mean, out=d_p["attention.0.bias"])

        by_hidden, by_mean = _halves(p["attention.0.weight"])
        d_hidden = self._through("mlp2.0", d_feature, hidden, "attention.0")  # d_feature is dead now
        d_hidden += np.matmul(d_score_1, by_hidden.T, out=array("d_feature", *hidden.shape))
        d_hidden += outer(equal, np.matmul(d_from_mean, by_mean.T), "d_feature")
        d_first = self._through("mlp1.2", relu_back(d_hidden, hidden), first, "d_first")
        self._by_parameters("mlp1.0", relu_back(d_first, first), rows)

    def _through(self, name: str, d: np.ndarray, x: np.ndarray, into: str | None = None) -> np.ndarray:
        """Write a layer's gradients by its parameters; returns that by its inputs x, in the array `into` if given."""
        self._by_parameters(name, d, x)
        return np.matmul(d, self.parameters[name + ".weight"].T, out=array(into, *x.shape) if into else None)

    def _by_parameters(self, name: str, d: np.ndarray, x: np.ndarray) -> None:
        np.matmul(x.T, d, out=self.gradients[name + ".weight"])
        np.matmul(np.ones(len(d), np.float32), d, out=self.gradients[name + ".bias"])


def _halves(weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The rows of attention.0's weight that read an element, and those that read the mean."""
    return weight[: len(weight) // 2], weight[len(weight) // 2 :]
