"""What an HDF5 file holds, looked at before a value is read: our schema is walked, and nothing of the file that is not in it.

Of anybody's file: links are not followed, data that lies in other files or in itself again is not touched, and what would
unpack to far more than the file has is refused.
"""

import contextlib
import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from piegraph_cli.errors import DataError
from piegraph_cli.workspace.probe import probe

if TYPE_CHECKING:
    import h5py
    import numpy as np

MOST_NAMES = 10_000
"""Names in a file or a group."""
LONGEST_NAME = 1000
"""Bytes."""
MOST_DIMENSIONS = 8
MOST_PACKED = 1100
"""Times that deflate, the one packing that is read, makes bytes more."""
FREE, RATIO = 1 << 28, 100
"""Bytes that a file may unpack to whatever its size, and times its size that it may beyond."""
LARGEST_CHUNK = 1 << 24
"""Bytes of a chunk that may be, however small the dataset."""
LONGEST_TEXT = 1 << 24
"""Bytes of an attribute."""
_DEFLATE, _SHUFFLE, _FLETCHER, _LZF = 1, 2, 3, 32000
_NAME = re.compile(rb"[A-Za-z0-9_.:@ -]*[A-Za-z0-9_]")


@dataclass(frozen=True)
class Found:
    """A dataset as the file describes it."""

    shape: tuple[int, ...]
    dtype: "np.dtype"
    item: "h5py.h5d.DatasetID | None" = None
    """It, where it is in a file: h5py's own objects take longer to make than most datasets to read."""

    @property
    def nbytes(self) -> int:
        """Bytes that it unpacks to."""
        size = self.dtype.itemsize
        for length in self.shape:
            size *= length
        return size

    def values(self, where: str, hint: str) -> "np.ndarray":
        """What it holds. Raises `DataError` where that is damaged."""
        import h5py
        import numpy as np

        assert self.item is not None
        try:
            found: np.ndarray = np.empty(self.shape, self.dtype)
            if found.size:
                self.item.read(h5py.h5s.ALL, h5py.h5s.ALL, found)
            return found if self.shape else found[()]
        except (OSError, ValueError, MemoryError) as error:
            raise DataError(f"is damaged: {error}", where, hint) from None


@contextlib.contextmanager
def opened(path: Path, hint: str, cache: int | None = None) -> "Iterator[h5py.File]":
    """An HDF5 file to read from; whatever HDF5 and h5py raise for broken files is a `DataError`.

    `cache` bytes of each dataset are kept, by default as many as h5py does.
    """
    import h5py

    try:
        with h5py.File(
            path, "r", locking=False, rdcc_nbytes=cache
        ) as file:  # ours are replaced whole, never written in place
            yield file
    except DataError:
        raise
    except Exception as error:
        raise DataError(f"not a readable HDF5 file: {str(error) or type(error).__name__}", str(path), hint) from None


def read_datasets(path: Path, names: Collection[str], hint: str, probed: bool = False) -> "dict[str, np.ndarray]":
    """Those of the datasets at the root of anybody's file that are there, read after they were `probed`.

    Raises `DataError` for whatever is not plain numbers or short texts in the file itself.
    """
    if not probed:
        probe(path, hint, at=list(names))
    with opened(path, hint) as file:
        found = _datasets_at(file, names, str(path), hint)
        return {name: dataset.values(f"{path}, dataset {name}", hint) for name, dataset in found.items()}


def _datasets_at(file: "h5py.File", names: Iterable[str], where: str, hint: str) -> dict[str, Found]:
    """Those of the datasets at the root that are there; nothing else is looked at."""
    there = [name for name in names if file.id.links.exists(name.encode())]
    found = {}
    for name in there:
        if _is_group(file, name.encode(), where, hint):
            raise DataError("is a group, not a dataset", f"{where}, dataset {name}", hint)
        found[name] = _described(file, name, f"{where}, dataset {name}", hint)
    _check_amount(found, file.id.get_filesize(), where, hint)
    return found


def _names_in(group: "h5py.Group", where: str, hint: str) -> Iterator[tuple[str, bool]]:
    """Names in a group, and of each whether it is a group."""
    if group.id.get_num_objs() > MOST_NAMES:
        raise DataError(f"holds more than {MOST_NAMES} names", where, hint)
    for raw in group.id:
        if len(raw) > LONGEST_NAME or not _NAME.fullmatch(raw):
            raise DataError(f"holds the name {raw[:40]!r}", where, hint)
        yield raw.decode(), _is_group(group, raw, where, hint)


def _is_group(group: "h5py.Group", name: bytes, where: str, hint: str) -> bool:
    """Whether that is a group, or else a dataset. Raises `DataError` for links and whatever else there may be."""
    import h5py

    place = f"{where}, dataset {name.decode()}"
    if group.id.links.get_info(name).type != h5py.h5l.TYPE_HARD:
        raise DataError("is a link, which is not followed", place, hint)
    kind = h5py.h5o.get_info(group.id, name).type
    if kind not in (h5py.h5o.TYPE_DATASET, h5py.h5o.TYPE_GROUP):
        raise DataError("is neither a dataset nor a group", place, hint)
    return kind == h5py.h5o.TYPE_GROUP


def datasets_in(file: "h5py.File", groups: set[str], where: str, hint: str) -> dict[str, Found]:
    """All datasets at the root and in `groups`, described; raises `DataError` for whatever else there is."""
    found: dict[str, Found] = {}
    for name, is_group in _names_in(file, where, hint):
        if not is_group:
            found[name] = _described(file, name, f"{where}, dataset {name}", hint)
            continue
        if name not in groups:
            raise DataError("not a dataset of this artifact", f"{where}, group {name}", hint)
        group = file[name]
        for inner, nested in _names_in(group, f"{where}, group {name}", hint):
            place = f"{where}, dataset {name}/{inner}"
            if nested:
                raise DataError("is a group in a group", place, hint)
            found[f"{name}/{inner}"] = _described(group, inner, place, hint)
    _check_amount(found, file.id.get_filesize(), where, hint)
    return found


def _described(group: "h5py.Group", name: str, where: str, hint: str) -> Found:
    """A dataset of a group. Raises `DataError` where its values may not be read: see the module's first lines."""
    import h5py

    dataset = h5py.h5d.open(group.id, name.encode())
    kept, space = dataset.get_create_plist(), dataset.get_space()
    layout = kept.get_layout()
    if layout == h5py.h5d.VIRTUAL or kept.get_external_count():
        raise DataError("takes its data from other files", where, hint)
    if space.get_simple_extent_type() == h5py.h5s.NULL:
        raise DataError("is empty", where, hint)
    if space.get_simple_extent_ndims() > MOST_DIMENSIONS:
        raise DataError(f"has {space.get_simple_extent_ndims()} axes", where, hint)
    found = Found(
        tuple(map(int, space.get_simple_extent_dims())), dataset.dtype, dataset
    )  # each is made anew when asked
    if found.dtype.kind not in "fiubS":
        raise DataError(f"has a type that is not allowed, {found.dtype}", where, hint)
    filters = [kept.get_filter(k)[0] for k in range(kept.get_nfilters())]
    if not set(filters) <= {_DEFLATE, _SHUFFLE, _FLETCHER, _LZF} or len(set(filters)) < len(filters):
        raise DataError(f"is packed in a way that is not read (filters {filters})", where, hint)
    if layout == h5py.h5d.CHUNKED:
        _check_chunks(dataset, kept.get_chunk(), found, where, hint)
    stored = dataset.get_storage_size()
    if stored > 2 * found.nbytes + FREE // RATIO:
        raise DataError(f"has {stored} bytes for {list(found.shape)} of {found.dtype}", where, hint)
    if found.nbytes > stored * (MOST_PACKED if {_DEFLATE, _LZF} & set(filters) else 1):
        raise DataError(f"{list(found.shape)} of {found.dtype} cannot be in the {stored} bytes it has", where, hint)
    return found


def _check_chunks(dataset: "h5py.h5d.DatasetID", chunks: tuple[int, ...], found: Found, where: str, hint: str) -> None:
    """Chunks that are not much larger than the dataset, and all there: what is not would be made up of fill values."""
    size = found.dtype.itemsize
    for chunk in chunks:
        size *= chunk
    if size > max(LARGEST_CHUNK, 2 * found.nbytes):
        raise DataError(f"has chunks {list(chunks)} for {list(found.shape)}", where, hint)
    needed = 1
    for chunk, length in zip(chunks, found.shape, strict=True):
        needed *= -(-length // chunk)
    there = dataset.get_num_chunks()
    if there != needed:
        raise DataError(f"has {there} of {needed} chunks", where, hint)


def _check_amount(found: Mapping[str, Found], size: int, where: str, hint: str) -> None:
    """Refuse what unpacks to far more than a file of that size can hold."""
    total = sum(dataset.nbytes for dataset in found.values())
    if total > max(FREE, RATIO * size):
        raise DataError(f"unpacks to {total} bytes from {size}", where, hint)


def attribute(file: "h5py.File", name: str) -> Any:
    """A text or whole number among the root's attributes; None where it is not there or is anything else."""
    import h5py
    import numpy as np

    try:
        held = h5py.h5a.open(file.id, name.encode())
    except KeyError:
        return None
    kind = held.get_type()
    if held.shape != () or not isinstance(kind, h5py.h5t.TypeStringID | h5py.h5t.TypeIntegerID):
        return None
    if held.get_storage_size() > LONGEST_TEXT:
        return None
    if isinstance(kind, h5py.h5t.TypeStringID) and not kind.is_variable_str():
        return file.attrs[name]
    # as h5py does it, which looks at the type again and makes two arrays more: headers are most of what is read of a run
    text = isinstance(kind, h5py.h5t.TypeStringID)
    value: np.ndarray[tuple[()], Any] = np.zeros((), h5py.string_dtype() if text else np.int64)
    held.read(value)
    found: Any = value[()]
    return found.decode("utf-8", "surrogateescape") if text else found
