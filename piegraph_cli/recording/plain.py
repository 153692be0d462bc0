"""Numbers in files of others, `.npy` and `.pkl`, of which nothing is run: a pickle may build arrays, lists and numbers only."""

import pickle
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from piegraph_cli.errors import DataError

LARGEST = 1 << 16
"""Bytes of a file of intrinsics or poses."""
LARGEST_PICKLE = 1 << 20
"""Bytes of a pickle."""
MOST = 10_000
"""Things in a pickle; a list that is in itself many times over has more than it has bytes."""
LARGEST_IMAGE = 1 << 26
"""Bytes of an image."""


def load_numbers(path: Path, shape: tuple[int, ...]) -> np.ndarray:
    """Finite numbers of that shape, -1 for any length, from a `.npy` file. Raises `DataError` naming it."""
    values = _loaded(path, LARGEST, str(path), f"expected a plain array {shape}")
    if values.dtype.kind not in "fiu":
        raise DataError(f"holds {values.dtype}", str(path), f"expected finite numbers {shape}")
    fits = len(values.shape) == len(shape) and all(w in (-1, n) for n, w in zip(values.shape, shape, strict=True))
    if not fits or not np.isfinite(values).all():
        raise DataError(f"holds an array {values.shape}", str(path), f"expected finite numbers {shape}")
    return values.astype(float)


def load_depth(path: Path, camera: str, shape: tuple[int, int]) -> np.ndarray:
    """Depth uint16 [H, W] from a `.npy` file of whole numbers in either byte order. Raises `DataError` naming it."""
    where = f"{path}, camera {camera}, frame {path.stem}"
    values = _loaded(path, LARGEST_IMAGE, where, "export this frame again")
    if values.dtype.kind not in "iu":
        hint = "write whole millimetres as uint16: of metres, 1000 times as many"
        raise DataError(f"depth is {values.dtype}", where, hint)
    if values.shape != shape:
        message = f"depth is {' x '.join(map(str, values.shape[::-1]))}, colour {shape[1]} x {shape[0]}"
        raise DataError(message, where, "align depth to colour when recording")
    if values.size and (values.min() < 0 or values.max() > np.iinfo(np.uint16).max):
        raise DataError(f"depth goes from {values.min()} to {values.max()}", where, "write millimetres as uint16")
    return values.astype(np.uint16)


def _loaded(path: Path, largest: int, where: str, hint: str) -> np.ndarray:
    try:
        if not path.is_file():
            raise ValueError("no regular file")
        if path.stat().st_size > largest:
            raise ValueError(f"too large, more than {largest} bytes")
        return np.asarray(np.load(path, allow_pickle=False))
    except Exception as error:  # a damaged header can raise anything
        raise DataError(f"cannot be read: {error}", where, hint) from None


def load_pickle(path: Path) -> Any:
    """What a pickle of numpy arrays, lists, tuples, dicts, texts and numbers holds.

    Raises `DataError` naming what else it wants to make; nothing of that is looked up, imported or called.
    """
    try:
        if not path.is_file():
            raise ValueError("no regular file")
        if path.stat().st_size > LARGEST_PICKLE:
            raise ValueError(f"too large, more than {LARGEST_PICKLE} bytes")
        with path.open("rb") as file:
            return _plain(_Unpickler(file).load(), iter(range(MOST)))
    except DataError as error:
        raise DataError(error.message, str(path), "save it again as plain arrays; do not open it elsewhere") from None
    except Exception as error:  # a damaged pickle can raise anything
        message = f"cannot be read: {type(error).__name__}: {error}"
        raise DataError(message, str(path), "copy it again; it may be cut") from None


class _Type:
    """Stands in for a numpy dtype."""

    def __init__(self, name: str, *_: object):
        self.name, self.order = str(name), "<"

    def __setstate__(self, state: Any) -> None:
        self.order = state[1] if state[1] in ("<", ">") else "|"

    def dtype(self) -> np.dtype:
        if self.name[:1] not in ("f", "i", "u", "b"):
            raise DataError(f"holds an array of {self.name!r}")
        return np.dtype(self.order + self.name)


class _Array:
    """Stands in for a numpy array while it is unpickled."""

    def __init__(self, *_: object):
        self.value = np.zeros(0)

    def __setstate__(self, state: Any) -> None:
        _, shape, kind, by_column, data = state
        if not isinstance(data, bytes):
            raise DataError("holds an array of Python objects")
        flat = np.frombuffer(data, kind.dtype())
        self.value = flat.reshape(shape, order="F" if by_column else "C")


class _Class:
    """Stands in for numpy's array type, which is only ever named."""


def _from_buffer(data: bytes, kind: _Type, shape: tuple[int, ...], order: str) -> np.ndarray:
    return np.frombuffer(data, kind.dtype()).reshape(shape, order="F" if order == "F" else "C")


def _scalar(kind: _Type, data: bytes) -> np.generic:
    return np.frombuffer(data, kind.dtype())[0]


def _bytes(text: str, coding: str) -> bytes:
    """How pickles of old protocols hold bytes."""
    if coding != "latin1":
        raise DataError(f"wants the coding {coding}")
    return text.encode("latin1")


_NUMPY: dict[tuple[str, str], Callable] = {
    ("numpy", "ndarray"): _Class,
    ("numpy", "dtype"): _Type,
    ("multiarray", "_reconstruct"): _Array,
    ("multiarray", "scalar"): _scalar,
    ("numeric", "_frombuffer"): _from_buffer,
    ("_codecs", "encode"): _bytes,
}
"""What pickled arrays name, and what is called in its place."""


class _Unpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        short = module.rpartition(".")[2] if module.startswith(("numpy.core.", "numpy._core.")) else module
        if (short, name) not in _NUMPY:
            raise DataError(f"refused: it wants {module}.{name}, and only arrays, lists and numbers are read")
        return _NUMPY[short, name]


def _plain(value: Any, left: Iterator[int]) -> Any:
    """The same with arrays in place of what stood in for them; no more things than are `left`."""
    if next(left, None) is None:
        raise DataError(f"holds more than {MOST} things")
    if isinstance(value, list | tuple):
        return [_plain(one, left) for one in value]
    if isinstance(value, dict):
        return {key: _plain(one, left) for key, one in value.items()}
    if isinstance(value, _Array):
        return value.value
    if value is None or isinstance(value, np.ndarray | np.generic | int | float | str):
        return value
    raise DataError(f"holds {type(value).__name__}, and only arrays, lists and numbers are read")
