"""What an HDF5 file holds, looked at before a value is read: our schema is walked, and nothing of the file that is not in it.

Of anybody's file: links are not followed, data that lies in other files or in itself again is not touched, and what would
unpack to far more than the file has is refused.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from piegraph_cli.errors import DataError

if TYPE_CHECKING:
    import h5py
    import numpy as np

MOST_NAMES = 10_000
"""Names in a file or a group."""
LONGEST_NAME = 1000
"""Letters."""
MOST_DIMENSIONS = 8
MOST_PACKED = 1100
"""Times that deflate, the one packing that is read, makes bytes more."""
FREE, RATIO = 1 << 28, 100
"""Bytes that a file may unpack to whatever its size, and times its size that it may beyond."""
LONGEST_TEXT = 1 << 24
"""Bytes of an attribute."""
_DEFLATE, _SHUFFLE, _FLETCHER = 1, 2, 3


@dataclass(frozen=True)
class Found:
    """A dataset as the file describes it."""

    shape: tuple[int, ...]
    dtype: "np.dtype"

    @property
    def nbytes(self) -> int:
        """Bytes that it unpacks to."""
        size = self.dtype.itemsize
        for length in self.shape:
            size *= length
        return size


def names_in(group: "h5py.Group", where: str, hint: str) -> Iterator[tuple[str, bool]]:
    """Names in a group, and of each whether it is a group; links are refused."""
    import h5py

    if group.id.get_num_objs() > MOST_NAMES:
        raise DataError(f"holds more than {MOST_NAMES} names", where, hint)
    for raw in group.id:
        if len(raw) > LONGEST_NAME or b"/" in raw or raw in (b"", b"."):
            raise DataError(f"holds the name {raw[:40]!r}", where, hint)
        name = raw.decode("utf-8", "replace")
        if group.id.links.get_info(raw).type != h5py.h5l.TYPE_HARD:
            raise DataError(f"{name} is a link, which is not followed", where, hint)
        kind = h5py.h5o.get_info(group.id, raw).type
        if kind not in (h5py.h5o.TYPE_DATASET, h5py.h5o.TYPE_GROUP):
            raise DataError(f"{name} is neither a dataset nor a group", where, hint)
        yield name, kind == h5py.h5o.TYPE_GROUP


def datasets_in(file: "h5py.File", groups: set[str], where: str, hint: str) -> dict[str, Found]:
    """All datasets at the root and in `groups`, described; raises `DataError` for whatever else there is."""
    found: dict[str, Found] = {}
    for name, is_group in names_in(file, where, hint):
        if not is_group:
            found[name] = described(file[name], f"{where}, dataset {name}", hint)
            continue
        if name not in groups:
            raise DataError("not a dataset of this artifact", f"{where}, group {name}", hint)
        for inner, nested in names_in(file[name], f"{where}, group {name}", hint):
            place = f"{where}, dataset {name}/{inner}"
            if nested:
                raise DataError("is a group in a group", place, hint)
            found[f"{name}/{inner}"] = described(file[name][inner], place, hint)
    check_amount(found, file.id.get_filesize(), where, hint)
    return found


def described(dataset: "h5py.Dataset", where: str, hint: str) -> Found:
    """Shape and type of a dataset. Raises `DataError` where its values may not be read: see the module's first lines."""
    import h5py

    kept = dataset.id.get_create_plist()
    layout = kept.get_layout()
    if layout == h5py.h5d.VIRTUAL or kept.get_external_count():
        raise DataError("takes its data from other files", where, hint)
    space = dataset.id.get_space()
    if space.get_simple_extent_type() == h5py.h5s.NULL:
        raise DataError("is empty", where, hint)
    if space.get_simple_extent_ndims() > MOST_DIMENSIONS:
        raise DataError(f"has {space.get_simple_extent_ndims()} axes", where, hint)
    if dataset.dtype.kind not in "fiubS":
        raise DataError(f"has a type that is not allowed, {dataset.dtype}", where, hint)
    found = Found(tuple(int(length) for length in dataset.shape), dataset.dtype)
    filters = [kept.get_filter(k)[0] for k in range(kept.get_nfilters())]
    if not set(filters) <= {_DEFLATE, _SHUFFLE, _FLETCHER} or len(set(filters)) < len(filters):
        raise DataError(f"is packed in a way that is not read (filters {filters})", where, hint)
    if layout == h5py.h5d.CHUNKED:
        _check_chunks(dataset, found, where, hint)
    stored = dataset.id.get_storage_size()
    if stored > 2 * found.nbytes + FREE // RATIO:
        raise DataError(f"has {stored} bytes for {list(found.shape)} of {found.dtype}", where, hint)
    if found.nbytes > stored * (MOST_PACKED if _DEFLATE in filters else 1):
        raise DataError(f"{list(found.shape)} of {found.dtype} cannot be in the {stored} bytes it has", where, hint)
    return found


def _check_chunks(dataset: "h5py.Dataset", found: Found, where: str, hint: str) -> None:
    """Chunks no larger than the dataset, and all there: what is not would be made up of fill values."""
    chunks = dataset.chunks
    if any(chunk > max(length, 1) for chunk, length in zip(chunks, found.shape, strict=True)):
        raise DataError(f"has chunks {list(chunks)} beyond its shape {list(found.shape)}", where, hint)
    needed = 1
    for chunk, length in zip(chunks, found.shape, strict=True):
        needed *= -(-length // chunk)
    if dataset.id.get_num_chunks() != needed:
        raise DataError(f"has {dataset.id.get_num_chunks()} of {needed} chunks", where, hint)


def check_amount(found: Mapping[str, Found], size: int, where: str, hint: str) -> None:
    """Refuse what unpacks to far more than a file of that size can hold."""
    total = sum(dataset.nbytes for dataset in found.values())
    if total > max(FREE, RATIO * size):
        raise DataError(f"unpacks to {total} bytes from {size}", where, hint)


def attribute(file: "h5py.File", name: str) -> Any:
    """A text or whole number among the root's attributes; None where it is not there or is anything else."""
    import h5py

    if not h5py.h5a.exists(file.id, name.encode()):
        return None
    held = h5py.h5a.open(file.id, name.encode())
    kind = held.get_type().get_class()
    single = held.get_space().get_simple_extent_type() == h5py.h5s.SCALAR
    if not single or kind not in (h5py.h5t.STRING, h5py.h5t.INTEGER) or held.get_storage_size() > LONGEST_TEXT:
        return None
    return file.attrs[name]
