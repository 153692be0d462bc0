"""Reading and writing one artifact: an HDF5 file that is complete or absent, checked when read."""

import contextlib
import datetime
import json
import os
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from piegraph_cli import __version__
from piegraph_cli.errors import DataError
from piegraph_cli.files import atomic_file
from piegraph_cli.workspace.probe import probe
from piegraph_cli.workspace.schema import LONG_TEXT, SCHEMA_VERSION, SCHEMAS, TEXT, Field, field_of
from piegraph_cli.workspace.sealed import check_seal, sealed
from piegraph_cli.workspace.spent import machine
from piegraph_cli.workspace.structure import Found, attribute, datasets_in, opened
from piegraph_cli.workspace.values import check_arrays, check_shapes, check_values, groups_of

if TYPE_CHECKING:  # imported where data is read or written: a look at what is known needs neither
    import h5py
    import numpy as np

CHUNK_BYTES = 1 << 20
CHECKED_FROM = 2
"""The first schema version whose artifacts have a checksum."""


@dataclass(frozen=True)
class Artifact:
    """One artifact in memory: `arrays` by dataset name, and the root attributes that say where it came from."""

    path: Path
    name: str
    key: str
    params: dict[str, Any]
    inputs: dict[str, Any]
    quality: str
    arrays: "dict[str, np.ndarray]"
    checked: bool = True
    """Whether it has a checksum."""
    made: dict[str, Any] = field(default_factory=dict)
    """`created`, `software`, `machine`, and milliseconds that it took (`wall_ms`, `cpu_ms`), as far as the file says."""

    def __getitem__(self, dataset: str) -> "np.ndarray":
        return self.arrays[dataset]

    def __contains__(self, dataset: str) -> bool:
        return dataset in self.arrays

    def field(self, dataset: str) -> Field:
        """Axes by name, units and type of a dataset. Raises `DataError` where there is no such dataset."""
        found = field_of(self.name, dataset)
        if found is None or dataset not in self.arrays:
            known = ", ".join(sorted(self.arrays))
            raise DataError(f"has no dataset {dataset}", str(self.path), f"one of {known}")
        return found

    def texts(self, dataset: str) -> list[str]:
        """A text dataset as Python strings."""
        return [value.decode() for value in self.arrays[dataset]]


def write_artifact(
    path: Path,
    name: str,
    arrays: "Mapping[str, np.ndarray]",
    *,
    stage: str,
    stage_version: int,
    key: str,
    params: Mapping[str, Any],
    inputs: Mapping[str, Any],
    quality: str = "",
    spent: Mapping[str, int] | None = None,
) -> None:
    """Write an artifact so that `path` is at every moment absent, the old file, or the whole new one.

    Raises `DataError` for arrays that do not fit the schema (with `path` untouched) and for a full or read-only disk.
    """
    arrays = {dataset: _cast(name, dataset, value, path) for dataset, value in arrays.items()}
    check_arrays(path, name, arrays)
    attributes = {
        "artifact": name,
        "schema_version": SCHEMA_VERSION,
        "stage": stage,
        "stage_version": stage_version,
        "key": key,
        "params": json.dumps(params, sort_keys=True),
        "inputs": json.dumps(inputs, sort_keys=True),
        "quality": quality,
        "created": datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds"),
        "software": f"piegraph {__version__}",
        "machine": machine(),
        **(spent or {}),
    }
    image = _image(path, name, attributes, arrays)
    with atomic_file(path) as temporary, temporary.open("wb") as file:
        file.writelines(sealed(image))


def _image(path: Path, name: str, attributes: Mapping[str, Any], arrays: "Mapping[str, np.ndarray]") -> bytes:
    """The file's bytes, made in memory: HDF5 itself ends the process when the disk is full."""
    import h5py

    with h5py.File(str(path), "w", driver="core", backing_store=False) as file:
        file.attrs.update(attributes)
        for dataset, value in arrays.items():
            _write_dataset(file, dataset, value, field_of(name, dataset))
        file.flush()
        return file.id.get_file_image()


def _cast(name: str, dataset: str, value: "np.ndarray", path: Path) -> "np.ndarray":
    import numpy as np

    field = field_of(name, dataset)
    if field is None:
        raise DataError(f"artifact {name} has no dataset {dataset}", str(path))
    value = np.asarray(value)
    if value.dtype.kind == "U":
        value = np.char.encode(value, "utf-8")
    if value.dtype.kind == "S" and field.dtype in (TEXT, LONG_TEXT):
        value = _fitting(value, field, f"{path}, dataset {dataset}")
    return value if field.dtype == "*" else value.astype(field.dtype, copy=False)


def _fitting(texts: "np.ndarray", field: Field, where: str) -> "np.ndarray":
    """Texts that are not too long for their field: long ones are cut, between two letters; a name that is cut is another."""
    import numpy as np

    most = np.dtype(field.dtype).itemsize
    if texts.dtype.itemsize <= most:
        return texts
    whole = [text[:most].decode("utf-8", "ignore").encode() for text in texts.flat]
    if field.dtype == TEXT and whole != list(texts.flat):
        raise DataError(f"a text is longer than {most} bytes", where, "shorten the name")
    return np.array(whole, field.dtype).reshape(texts.shape)


def _write_dataset(file: "h5py.File", dataset: str, value: "np.ndarray", field: Field | None) -> None:
    assert field is not None
    options: dict[str, Any] = {}
    if value.ndim and value.size:
        rows = max(1, min(len(value), CHUNK_BYTES // max(1, value.nbytes // len(value))))
        options = {"chunks": (rows, *value.shape[1:]), "compression": "gzip", "shuffle": True, "fletcher32": True}
        if field.units == "encoded image":
            options["compression_opts"] = 1
    handle = file.create_dataset(dataset, data=value, **options)
    handle.attrs["units"], handle.attrs["axes"] = field.units, field.axes


def read_artifact(
    path: Path,
    name: str | None = None,
    only: Collection[str] | None = None,
    *,
    verified: bool = False,
    foreign: bool = False,
    probed: bool = False,
) -> Artifact:
    """Read and check an artifact, or `only` some datasets; without a name whatever artifact the file holds.

    The checksum comes first, but of a file that was `verified` before; then what the file says it holds, then values. A
    `foreign` file, and one without checksum, is read in a process of its own before, unless it was `probed`. Raises
    `DataError` naming file and dataset when something is off.
    """
    checked = _checked(path, name, verified)
    if not (verified or probed) and (foreign or not checked):
        probe(path, _copied(name), name=name)
    with _open(path, name, checked, cache=0) as (file, attributes):  # each chunk is read once
        name, remake = attributes["artifact"], _remake(path, attributes)
        found, lengths = _structure(file, path, name, remake)
        made = _made(file)
        wanted = [dataset for dataset in found if only is None or dataset in only]
        arrays = {dataset: found[dataset].values(f"{path}, dataset {dataset}", remake) for dataset in wanted}
    check_values(str(path), name, arrays, found, lengths, remake)
    params, inputs = json.loads(attributes["params"]), json.loads(attributes["inputs"])
    return Artifact(path, name, attributes["key"], params, inputs, attributes["quality"], arrays, checked, made)


def _structure(file: "h5py.File", path: Path, name: str, hint: str) -> "tuple[dict[str, Found], dict[str, int]]":
    """What a file holds, as it says, and the lengths of axes. Raises `DataError` where that does not fit the schema."""
    found = datasets_in(file, groups_of(name), str(path), hint)
    return found, check_shapes(str(path), name, found, hint)


def open_artifact(
    path: Path, name: str, cache: int
) -> "tuple[contextlib.ExitStack, dict[str, str], dict[str, Found], dict[str, int]]":
    """An artifact that stays open until the first of these is closed: that, its attributes, datasets, and lengths of axes.

    Checksum and structure are looked at as `read_artifact` does, values are not read; `cache` bytes of each dataset are kept.
    """
    checked = _checked(path, name)
    if not checked:
        probe(path, _copied(name), name=name)
    with contextlib.ExitStack() as stack:
        file, attributes = stack.enter_context(_open(path, name, checked, cache))
        found, lengths = _structure(file, path, name, _remake(path, attributes))
        return stack.pop_all(), attributes, found, lengths


def read_key(path: Path, name: str) -> str | None:
    """The key of an artifact, or None when it is absent, damaged or of another version: then it is made again."""
    header = read_header(path, name)
    return header.key if header else None


@dataclass(frozen=True)
class Header:
    """What an artifact says of itself, without its data."""

    key: str
    version: int
    settings: str
    """Its params as JSON."""
    quality: str
    checked: bool = True
    """Whether a checksum says that it is what was written."""

    @property
    def params(self) -> dict[str, Any]:
        """The settings it was made with."""
        return json.loads(self.settings)


def read_header(path: Path, name: str) -> Header | None:
    """The header of an artifact whose bytes are those that were written; None when it is absent, damaged or of another schema.

    One without checksum, which only old ones are, is read as a whole, in a process of its own.
    """
    if not path.is_file():
        return None
    try:
        checked = _checked(path, name)
        if not checked:
            probe(path, _copied(name), name=name)
        with _open(path, name, checked) as (file, attributes):
            version = attribute(file, "stage_version")
            return Header(attributes["key"], int(version), attributes["params"], attributes["quality"], checked)
    except (DataError, TypeError, ValueError):
        return None


def _checked(path: Path, name: str | None, verified: bool = False) -> bool:
    """Whether an artifact has a checksum, which then is right. Raises `DataError` for what is no file."""
    if not path.is_file():
        what = "is not a regular file" if os.path.lexists(path) else f"no such {name or ''} artifact"
        raise DataError(what, str(path), "run the stage that writes it; `piegraph status` lists them")
    return check_seal(path, verified)


def _copied(name: str | None) -> str:
    return f"make the {name} again" if name else "copy it again from where it was made"


@contextlib.contextmanager
def _open(
    path: Path, name: str | None, checked: bool, cache: int | None = None
) -> "Iterator[tuple[h5py.File, dict[str, str]]]":
    """An artifact that is opened, and its attributes; what HDF5 cannot read is a `DataError`."""
    with opened(path, _copied(name), cache) as file:
        yield file, _attributes(file, path, name, checked)


def _attributes(file: "h5py.File", path: Path, name: str | None, checked: bool) -> dict[str, str]:
    version = attribute(file, "schema_version")
    known = not isinstance(version, str | None)
    if known and version > SCHEMA_VERSION:
        message = f"schema version {version} is newer than this piegraph reads ({SCHEMA_VERSION})"
        raise DataError(message, str(path), "update piegraph")
    attributes = {k: attribute(file, k) for k in ("artifact", "key", "stage", "params", "inputs", "quality")}
    if not known and not any(attributes.values()):
        raise DataError("is no artifact of piegraph", str(path), "give one, or what holds plain points as .ply or .npz")
    if not known or version < 1 or not all(isinstance(value, str) for value in attributes.values()):
        raise DataError("not an artifact of this version", str(path), "make it again with --force")
    if checked != (version >= CHECKED_FROM):
        what = "has lost its checksum" if version >= CHECKED_FROM else "has a checksum that it cannot have"
        raise DataError(f"is not what was written: it {what}", str(path), _remake(path, attributes))
    if attributes["artifact"] not in ([name] if name else SCHEMAS):
        expected = f", expected {name}" if name else ""
        raise DataError(f"holds {attributes['artifact']}{expected}", str(path), "give the file of the right stage")
    for text in ("params", "inputs"):
        _check_json(attributes[text], path, attributes)
    return attributes


def _made(file: "h5py.File") -> dict[str, Any]:
    """When, by what, where and in what time a file was made, as far as it says so: older ones say less."""
    found: dict[str, Any] = {}
    for name in ("created", "software", "machine"):
        if isinstance(value := attribute(file, name), str):
            found[name] = value
    for name in ("wall_ms", "cpu_ms"):
        value = attribute(file, name)
        if value is not None and not isinstance(value, str) and value >= 0:
            found[name] = int(value)
    return found


def _check_json(text: str, path: Path, attributes: Mapping[str, str]) -> None:
    try:
        whole = isinstance(json.loads(text), dict)
    except (ValueError, RecursionError):
        whole = False
    if not whole:
        raise DataError("its params or inputs attribute is damaged", str(path), _remake(path, attributes))


def _remake(path: Path, attributes: Mapping[str, str]) -> str:
    return f"make it again: `piegraph {attributes['stage']} --force`"
