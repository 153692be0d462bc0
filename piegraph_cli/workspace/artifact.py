"""Reading and writing one artifact: an HDF5 file that is complete or absent, checked when read."""

import datetime
import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from piegraph_cli import __version__
from piegraph_cli.errors import DataError
from piegraph_cli.files import atomic_file
from piegraph_cli.workspace.schema import FIXED_AXES, SCHEMA_VERSION, SCHEMAS, Field, field_of

if TYPE_CHECKING:  # imported where data is read or written: a look at what is known needs neither
    import h5py
    import numpy as np

CHUNK_BYTES = 1 << 20


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
    }
    image = _image(path, name, attributes, arrays)
    with atomic_file(path) as temporary:
        temporary.write_bytes(image)


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
    return value if field.dtype == "*" else value.astype(field.dtype, copy=False)


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


def read_artifact(path: Path, name: str | None = None, only: Collection[str] | None = None) -> Artifact:
    """Read and check an artifact, or `only` some datasets; without a name whatever artifact the file holds.

    Raises `DataError` naming file and dataset when something is off.
    """
    with _open(path, name or "") as file:
        attributes = _attributes(file, path, name)
        name = attributes["artifact"]
        arrays: dict[str, np.ndarray] = {}
        for dataset, item in datasets_of(file, path, _remake(attributes), only).items():
            try:
                arrays[dataset] = item[()]
            except (OSError, ValueError, MemoryError) as error:
                raise DataError(f"dataset {dataset} is damaged: {error}", str(path), _remake(attributes)) from None
    check_arrays(path, name, arrays, _remake(attributes), only)
    try:
        params, inputs = json.loads(attributes["params"]), json.loads(attributes["inputs"])
    except ValueError:
        raise DataError("its params or inputs attribute is damaged", str(path), _remake(attributes)) from None
    return Artifact(path, name, attributes["key"], params, inputs, attributes["quality"], arrays)


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

    @property
    def params(self) -> dict[str, Any]:
        """The settings it was made with."""
        return json.loads(self.settings)


def read_header(path: Path, name: str) -> Header | None:
    """The header of an artifact, or None when it is absent, damaged or of another schema."""
    if not path.is_file():
        return None
    try:
        with _open(path, name) as file:
            attributes = _attributes(file, path, name)
            json.loads(attributes["params"])
            version = int(file.attrs["stage_version"])
            return Header(attributes["key"], version, attributes["params"], attributes["quality"])
    except (DataError, KeyError, ValueError):
        return None


def _open(path: Path, name: str, cache: int | None = None) -> "h5py.File":
    import h5py

    if not path.is_file():
        raise DataError(
            f"no such {name} artifact", str(path), "run the stage that writes it; `piegraph status` lists them"
        )
    try:
        # files are replaced whole, never written in place
        return h5py.File(path, "r", locking=False, rdcc_nbytes=cache)
    except OSError as error:
        raise DataError(
            f"not a readable HDF5 file: {error}", str(path), f"remove it and make the {name} again"
        ) from None


def open_file(path: Path, name: str, cache: int) -> "tuple[h5py.File, dict[str, str]]":
    """An artifact's file, to be closed by the caller, and its root attributes; `cache` bytes of each dataset are kept."""
    file = _open(path, name, cache)
    try:
        return file, _attributes(file, path, name)
    except BaseException:
        file.close()
        raise


def datasets_of(
    file: "h5py.File", path: Path, hint: str, only: Collection[str] | None = None
) -> "dict[str, h5py.Dataset]":
    """The datasets of an artifact's file by name, or `only` some, unread. Raises `DataError` for types that run code."""
    import h5py

    found: dict[str, h5py.Dataset] = {}

    def take(dataset: str, item: "h5py.Dataset | h5py.Group") -> None:
        if isinstance(item, h5py.Dataset) and (only is None or dataset in only):
            if item.dtype.hasobject:
                raise DataError(f"dataset {dataset} has a type that is not allowed", str(path), hint)
            found[dataset] = item

    file.visititems(take)
    return found


def _attributes(file: "h5py.File", path: Path, name: str | None) -> dict[str, str]:
    import numpy as np

    version = file.attrs.get("schema_version")
    if isinstance(version, np.integer) and version > SCHEMA_VERSION:
        raise DataError(
            f"schema version {version} is newer than this piegraph reads ({SCHEMA_VERSION})",
            str(path),
            "update piegraph",
        )
    attributes = {k: file.attrs.get(k) for k in ("artifact", "key", "stage", "params", "inputs", "quality")}
    if version != SCHEMA_VERSION or not all(isinstance(value, str) for value in attributes.values()):
        raise DataError("not an artifact of this version", str(path), "make it again with --force")
    if attributes["artifact"] not in ([name] if name else SCHEMAS):
        expected = f", expected {name}" if name else ""
        raise DataError(f"holds {attributes['artifact']}{expected}", str(path), "give the file of the right stage")
    return attributes  # type: ignore[return-value]


def _remake(attributes: Mapping[str, str]) -> str:
    return f"make it again: `piegraph {attributes['stage']} --force`"


def check_arrays(
    path: Path, name: str, arrays: "Mapping[str, np.ndarray]", hint: str = "", only: Collection[str] | None = None
) -> None:
    """Check names, types, axes, finiteness and offsets of an artifact's arrays (all, or `only` some) against the schema."""
    check_form(path, name, arrays, hint, only)
    check_values(path, name, arrays, hint)


def check_form(
    path: Path,
    name: str,
    arrays: "Mapping[str, np.ndarray | h5py.Dataset]",
    hint: str = "",
    only: Collection[str] | None = None,
) -> dict[str, int]:
    """Check what needs no reading, names, types and axes; returns the lengths of the axes by name."""
    import numpy as np

    needed = [d for d, field in SCHEMAS[name].items() if not (d.endswith("/*") or field.optional)]
    missing = [d for d in needed if d not in arrays and (only is None or d in only)]
    if missing:
        raise DataError(f"dataset {missing[0]} is missing", str(path), hint)
    lengths = dict(FIXED_AXES)
    for dataset, value in arrays.items():
        field = field_of(name, dataset)
        where = f"{path}, dataset {dataset}"
        if field is None:
            raise DataError("not a dataset of this artifact", where, hint)
        if field.dtype != "*" and value.dtype != np.dtype(field.dtype):
            raise DataError(f"type {value.dtype}, expected {field.dtype}", where, hint)
        if field.axes != "*":
            _check_axes(value, field.axes.split(",") if field.axes else [], lengths, where, hint)
    if {"image", "frame", "camera"} <= lengths.keys() and lengths["image"] != lengths["frame"] * lengths["camera"]:
        message = f"{lengths['image']} images, expected {lengths['frame']} frames of {lengths['camera']} cameras"
        raise DataError(message, str(path), hint)
    return lengths


def check_values(path: Path, name: str, arrays: "Mapping[str, np.ndarray]", hint: str = "", part: bool = False) -> None:
    """Check finiteness, and offsets unless these are a `part` of the datasets."""
    import numpy as np

    for dataset, value in arrays.items():
        field = field_of(name, dataset)
        where = f"{path}, dataset {dataset}"
        assert field is not None
        if value.dtype.kind == "f" and not field.nan and not np.isfinite(value).all():
            row = np.argwhere(~np.isfinite(value))[0] if value.ndim else ()
            raise DataError(f"value that is not finite at index {tuple(int(i) for i in row)}", where, hint)
        if field.ends and not part:
            _check_offsets(value, arrays.get(field.ends), field.ends, where, hint)


def _check_axes(
    value: "np.ndarray | h5py.Dataset", axes: list[str], lengths: dict[str, int], where: str, hint: str
) -> None:
    if value.ndim != len(axes):
        raise DataError(f"shape {value.shape}, expected axes {','.join(axes)}", where, hint)
    for axis, length in zip(axes, value.shape, strict=True):
        edge = int(axis.endswith("_edge"))
        expected = int(axis) if axis.isdigit() else lengths.setdefault(axis.removesuffix("_edge"), length - edge) + edge
        if length != expected:
            raise DataError(f"axis {axis} has length {length}, expected {expected}", where, hint)


def _check_offsets(offsets: "np.ndarray", parts: "np.ndarray | None", name: str, where: str, hint: str) -> None:
    """Check offsets [n + 1] against the dataset they cut; where that was not read, alone."""
    rises = len(offsets) > 0 and offsets[0] == 0 and (offsets[1:] >= offsets[:-1]).all()
    if not rises or (parts is not None and parts.shape[:1] != (offsets[-1],)):
        length = "" if parts is None else f" to its end: {name} is {parts.shape}"
        raise DataError(f"offsets into {name} do not rise from 0{length}", where, hint)
