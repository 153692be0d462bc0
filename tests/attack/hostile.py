"""HDF5 files that strangers could send: each maker takes a whole file of ours that is open and makes it one of those."""

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np


def _replaced(file: h5py.File, name: str) -> tuple[tuple[int, ...], np.dtype]:
    """Remove a dataset; its shape and type."""
    shape, dtype = file[name].shape, file[name].dtype
    del file[name]
    return shape, dtype


def refers_to_itself(file: h5py.File, name: str) -> None:
    shape, dtype = _replaced(file, name)
    layout = h5py.VirtualLayout(shape, dtype)
    layout[...] = h5py.VirtualSource(".", name, shape, dtype)
    file.create_virtual_dataset(name, layout)


def of_another_file(file: h5py.File, name: str) -> None:
    shape, dtype = _replaced(file, name)
    layout = h5py.VirtualLayout(shape, dtype)
    layout[...] = h5py.VirtualSource("elsewhere.h5", "data", shape, dtype)
    file.create_virtual_dataset(name, layout)


def bytes_of_the_machine(file: h5py.File, name: str) -> None:
    shape, dtype = _replaced(file, name)
    size = int(np.prod(shape)) * dtype.itemsize
    file.create_dataset(name, shape, dtype, external=[("/etc/passwd", 0, size)])


def empty(file: h5py.File, name: str) -> None:
    _, dtype = _replaced(file, name)
    file.create_dataset(name, data=h5py.Empty(dtype))


def unpacks_without_end(file: h5py.File, name: str) -> None:
    shape, dtype = _replaced(file, name)
    file.create_dataset(name, (400_000_000, *shape[1:]), dtype, chunks=(1 << 14, *shape[1:]), compression="gzip")


def packed_twice(file: h5py.File, name: str) -> None:
    shape, dtype = _replaced(file, name)
    kept = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    kept.set_chunk(shape or (1,))
    for _ in range(3):
        kept.set_deflate(9)
    space = h5py.h5s.create_simple(shape or (1,))
    dataset = h5py.h5d.create(file.id, name.encode(), h5py.h5t.py_create(dtype), space, kept)
    dataset.write(h5py.h5s.ALL, h5py.h5s.ALL, np.zeros(shape or (1,), dtype))


def one_chunk_of_gigabytes(file: h5py.File, name: str) -> None:
    shape, dtype = _replaced(file, name)
    rows = (3 << 30) // max(1, dtype.itemsize * int(np.prod(shape[1:])))
    file.create_dataset(
        name, shape or (1,), dtype, chunks=(rows, *shape[1:]), maxshape=(None, *shape[1:]), fletcher32=True
    )


def deep(file: h5py.File, name: str) -> None:
    group = file.require_group("trust")
    for k in range(3000):
        group = group.create_group(f"deep{k % 2}")


def soft_link(file: h5py.File, name: str) -> None:
    _replaced(file, name)
    file[name] = h5py.SoftLink(f"/{name}")


def external_link(file: h5py.File, name: str) -> None:
    _replaced(file, name)
    file[name] = h5py.ExternalLink("/dev/stdin", "/")


def round_and_round(file: h5py.File, name: str) -> None:
    _replaced(file, name)
    file[name] = file["/"]


def many_names(file: h5py.File, name: str) -> None:
    for k in range(10_001):
        file[f"name{k}"] = file[name]


def texts_of_any_length(file: h5py.File, name: str) -> None:
    shape, _ = _replaced(file, name)
    file.create_dataset(name, shape or (1,), h5py.string_dtype())


def references(file: h5py.File, name: str) -> None:
    shape, _ = _replaced(file, name)
    file.create_dataset(name, shape or (1,), h5py.ref_dtype)


def records(file: h5py.File, name: str) -> None:
    shape, _ = _replaced(file, name)
    file.create_dataset(name, shape or (1,), np.dtype([("x", "f4"), ("y", "i8")]))


def a_type(file: h5py.File, name: str) -> None:
    _replaced(file, name)
    file[name] = np.dtype("f4")


def names_of_anything(file: h5py.File, name: str) -> None:
    file.copy(name, "\n\x1b[2J/../x".replace("/", ";"))


def a_header_that_is_empty(file: h5py.File, name: str) -> None:
    for attribute in ("key", "params", "quality"):
        file.attrs[attribute] = h5py.Empty("S1")


def a_header_of_numbers(file: h5py.File, name: str) -> None:
    file.attrs["params"] = np.zeros(8000)
    file.attrs["inputs"] = 3


def a_header_in_depth(file: h5py.File, name: str) -> None:
    file.attrs["params"] = "[" * 50_000 + "]" * 50_000


HOSTILE: dict[str, Callable[[h5py.File, str], None]] = {
    make.__name__: make
    for make in (
        refers_to_itself,
        of_another_file,
        bytes_of_the_machine,
        empty,
        unpacks_without_end,
        packed_twice,
        one_chunk_of_gigabytes,
        deep,
        soft_link,
        external_link,
        round_and_round,
        many_names,
        texts_of_any_length,
        references,
        records,
        a_type,
        names_of_anything,
        a_header_that_is_empty,
        a_header_of_numbers,
        a_header_in_depth,
    )
}
OF_ARTIFACTS = (
    "deep",
    "many_names",
    "names_of_anything",
    "a_header_that_is_empty",
    "a_header_of_numbers",
    "a_header_in_depth",
)
"""What an import, which looks at nothing but the datasets it knows, does not mind."""


def make_hostile(path: Path, kind: str, dataset: str) -> None:
    """Make a whole HDF5 file hostile."""
    with h5py.File(path, "a") as file:
        HOSTILE[kind](file, dataset)
