"""Arrays of the network in NumPy: layers with padded rows, in memory that each thread reuses from call to call."""

import math
import threading

import numpy as np

from sfmrl.fast.parameters import Parameters

ROWS = 12  # that AVX2 kernels take at a time

_arrays = threading.local()


class Layers(dict[str, np.ndarray]):
    """Layers' outputs by name for states (E, A, K, F): arrays with a row for each element or for each state.

    An episode takes `element_rows` or `state_rows` of them, multiples of ROWS: A K elements or A states, then padding.
    """

    def __init__(self, parameters: Parameters, shape: tuple[int, ...], element_rows: int, state_rows: int) -> None:
        super().__init__()
        self.parameters, self.shape = parameters, shape
        self.element_rows, self.state_rows = (-(-rows // ROWS) * ROWS for rows in (element_rows, state_rows))

    def by_element(self, x: np.ndarray) -> np.ndarray:
        """The rows of elements without the padding, a view (E, A, K, C)."""
        episodes, actions, elements = self.shape
        return x.reshape(episodes, self.element_rows, -1)[:, : actions * elements].reshape(*self.shape, -1)

    def by_state(self, x: np.ndarray) -> np.ndarray:
        """The rows of states without the padding, a view (E, A, C)."""
        return x.reshape(self.shape[0], self.state_rows, -1)[:, : self.shape[1]]

    def padded(self, name: str, columns: int, rows: int | None = None, used: int | None = None) -> np.ndarray:
        """An array of `rows` rows per episode (default `state_rows`), those from `used` on (default A) zeros."""
        rows, used = rows or self.state_rows, used or self.shape[1]
        self[name] = array(name, self.shape[0] * rows, columns)
        self[name].reshape(-1, rows, columns)[:, used:] = 0
        return self[name]

    def weighted(self, name: str, weight: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Sums over the elements, with a `weight` (E, A, K) each, of rows x: a row for each state."""
        sums = self.padded(name, x.shape[1])
        np.matmul(weight[..., None, :], self.by_element(x), out=self.by_state(sums)[..., None, :])
        return sums

    def product(self, x: np.ndarray, name: str, weight: np.ndarray) -> np.ndarray:
        """Rows x times a weight matrix."""
        self[name] = np.matmul(x, weight, out=array(name, len(x), weight.shape[1]))
        return self[name]

    def dense(self, x: np.ndarray, name: str) -> np.ndarray:
        """The linear layer `name` of rows x, with a ReLU."""
        return relu(self.product(x, name, self.parameters[name + ".weight"]), self.parameters[name + ".bias"])


def relu(y: np.ndarray, bias: np.ndarray | None = None) -> np.ndarray:
    """max(y + bias, 0) in place, on many rows joined to one: NumPy is slow on rows as short as a layer is wide."""
    rows = ROWS if len(y) % (4 * ROWS) else 4 * ROWS
    wide = y.reshape(-1, rows * y.shape[1])
    if bias is not None:
        wide += np.tile(bias, rows)
    np.maximum(wide, np.zeros(wide.shape[1], np.float32), out=wide)
    return y


def relu_back(d: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The gradient by a ReLU's input, in place of that by its output y."""
    return np.multiply(d, y > 0, out=d)


def outer(by_element: np.ndarray, by_state: np.ndarray, into: str) -> np.ndarray:
    """Products (B K, C) of a number for each element (B, K) and a row for each state (B, C), in the array `into`."""
    out = array(into, *by_element.shape, by_state.shape[1])
    return np.multiply(by_element[..., None], by_state[:, None], out=out).reshape(-1, by_state.shape[1])


def array(name: str, *shape: int) -> np.ndarray:
    """This thread's array of this name, in this shape, with whatever was last written to it."""
    size = math.prod(shape)
    buffer = getattr(_arrays, name, None)
    if buffer is None or buffer.size < size:
        buffer = np.empty(size + 16, np.float32)
        buffer = buffer[-buffer.ctypes.data // 4 % 16 :]  # begins at a cache line of 64 bytes
        setattr(_arrays, name, buffer)
    return buffer[:size].reshape(shape)
