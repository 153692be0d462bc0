"""Small damages, drawn by a seed: of bytes, of text, of TOML and JSON, and of arrays; each says what it did."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

Rng = np.random.Generator

ODD_TEXTS = (
    "1e308",
    "-1e308",
    "nan",
    "inf",
    "-0",
    "1e-320",
    "9" * 400,
    "",
    "0x10",
    "1_000",
    "٣",
    "1,5",
    "\x00",
    "None",
    "..",
)
ODD_VALUES: tuple[Any, ...] = (
    None, True, -1, 0, 1e308, float("nan"), 10**400, 10**4000, 10**18, "", "x" * 300, "../../etc/passwd", "\ud800",
    [], {}, [[[]]], [None] * 50, {"": 1},
)  # fmt: skip


def _pick(rng: Rng, among: Any) -> Any:
    return among[int(rng.integers(len(among)))]


def flip(data: bytes, rng: Rng) -> bytes:
    """One to eight bytes are others."""
    out = bytearray(data)
    for _ in range(int(rng.integers(1, 9))):
        out[int(rng.integers(len(out)))] ^= int(rng.integers(1, 256))
    return bytes(out)


def flip_in_front(data: bytes, rng: Rng) -> bytes:
    """A byte of the header is another."""
    out = bytearray(data)
    out[int(rng.integers(min(len(out), 600)))] ^= int(rng.integers(1, 256))
    return bytes(out)


def cut(data: bytes, rng: Rng) -> bytes:
    """The end is missing."""
    return data[: int(rng.integers(len(data)))]


def grown(data: bytes, rng: Rng) -> bytes:
    """There is more behind it."""
    return data + rng.bytes(int(rng.integers(1, 4000)))


def zeroed(data: bytes, rng: Rng) -> bytes:
    """A stretch is zero, as of a block that was never written."""
    start, length = int(rng.integers(len(data))), int(rng.integers(1, 5000))
    return data[:start] + bytes(len(data[start : start + length])) + data[start + length :]


def shifted(data: bytes, rng: Rng) -> bytes:
    """A stretch is missing in the middle, or there twice."""
    start, length = int(rng.integers(len(data))), int(rng.integers(1, 600))
    return data[:start] + (data[start + length :] if rng.random() < 0.5 else data[max(0, start - length) :])


def lied(data: bytes, rng: Rng) -> bytes:
    """A small whole number, in four or eight bytes, is a huge one: lengths, counts and places."""
    places = [
        k
        for k in rng.integers(0, max(1, len(data) - 8), 400)
        if 0 < int.from_bytes(data[k : k + 4], "little") < 1 << 20
    ]
    start = int(_pick(rng, places)) if places else 0
    size = int(_pick(rng, (4, 8)))
    huge = int(_pick(rng, (2**31 - 1, 2**32 - 1, 10**8, 10**10, 2**40, 2**63 - 1, 2**16))) % 256**size
    return data[:start] + huge.to_bytes(size, "little") + data[start + size :]


BYTES: tuple[Callable[[bytes, Rng], bytes], ...] = (flip, flip, flip_in_front, cut, grown, zeroed, shifted, lied)


def mutate_bytes(data: bytes, rng: Rng) -> tuple[bytes, str]:
    """One damage of bytes, which are then others than before."""
    while True:
        how = _pick(rng, BYTES)
        found = how(data, rng) if data else b"\0"
        if found != data:
            return found, how.__name__


def mutate_text(text: str, rng: Rng) -> tuple[str, str]:
    """A number is an odd one, a word is gone or there twice, lines are exchanged, or the text ends early."""
    lines, words = text.splitlines(keepends=True), list(re.finditer(r"[^\s,=\[\]\"]+", text))
    numbers = list(re.finditer(r"-?\d+\.?\d*(e-?\d+)?", text))
    how = _pick(rng, ("number", "number", "word", "word", "line", "end", "byte"))
    if how == "number" and numbers:
        at = _pick(rng, numbers)
        return text[: at.start()] + _pick(rng, ODD_TEXTS) + text[at.end() :], "odd number"
    if how == "word" and words:
        at, new = _pick(rng, words), _pick(rng, ("", "", None, *ODD_TEXTS))
        return text[: at.start()] + (2 * at.group() if new is None else new) + text[at.end() :], "odd word"
    if how == "line" and len(lines) > 1:
        a, b = (int(k) for k in rng.integers(0, len(lines), 2))
        lines[a], lines[b] = _pick(rng, (("", lines[b]), (lines[b], lines[a]), (lines[a] * 3, lines[b])))
        return "".join(lines), "odd lines"
    if how == "end":
        return text[: int(rng.integers(len(text) + 1))], "cut text"
    data, what = mutate_bytes(text.encode(), rng)
    return data.decode("utf-8", "surrogateescape"), what


def mutate_json(value: Any, rng: Rng) -> Any:
    """The same with one thing, somewhere in it, odd, gone, or called otherwise."""
    if isinstance(value, dict) and value and rng.random() < 0.9:
        key = _pick(rng, list(value))
        how = rng.random()
        if how < 0.1:
            return {k: v for k, v in value.items() if k != key}
        if how < 0.2:
            return {(_pick(rng, ODD_TEXTS) if k == key else k): v for k, v in value.items()}
        return value | {key: mutate_json(value[key], rng)}
    if isinstance(value, list) and value and rng.random() < 0.8:
        k = int(rng.integers(len(value)))
        rest = _pick(rng, ([], [mutate_json(value[k], rng)], [mutate_json(value[k], rng)], [value[k]] * 3))
        return value[:k] + rest + value[k + 1 :]
    return _pick(rng, ODD_VALUES)


def mutate_json_text(text: str, rng: Rng) -> tuple[str, str]:
    """JSON with one odd thing, or damaged as text."""
    if rng.random() < 0.3:
        return mutate_text(text, rng)
    return json.dumps(mutate_json(json.loads(text), rng)), "odd JSON"


def bytes_of(path: Path, rng: np.random.Generator) -> str:
    """Damage the bytes of a file."""
    data, how = mutate_bytes(path.read_bytes(), rng)
    path.write_bytes(data)
    return how


def text_of(path: Path, rng: np.random.Generator) -> str:
    """Damage a file as what it is: JSON, or text."""
    change = mutate_json_text if path.suffix == ".json" else mutate_text
    text, how = change(path.read_text(), rng)
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    return how


def mutate_array(value: np.ndarray, rng: Rng) -> tuple[np.ndarray, str]:
    """An array with one value, or all of them, odd; or of another shape or type."""
    value, how = np.array(value), _pick(rng, ("one", "one", "all", "zero", "shape", "type", "axis"))
    odd = _pick(rng, (np.nan, np.inf, -np.inf, 1e30, -1e30, 1e6, -1, 2, 255, 2**31))
    if value.dtype.kind in "fiub" and value.size and how in ("one", "all", "zero"):
        with np.errstate(all="ignore"):
            new = np.float64(0 if how == "zero" else odd).astype(value.dtype)
        if how == "one":
            value.flat[int(rng.integers(value.size))] = new
        else:
            value[...] = new
        return value, f"{how} {odd}"
    if how == "shape" and value.ndim:
        return value[: int(rng.integers(len(value) + 1))], "shorter"
    if how == "axis":
        return value[None], "an axis more"
    return (
        value.astype(_pick(rng, ("<f8", ">f4", "i2", "u1"))) if value.dtype.kind in "fiub" else value.reshape(-1)[:0]
    ), "another type"


def mutate_file_of(folder: Path, rng: Rng) -> str:
    """Damage one file of a folder, its bytes or what its kind can have, or put something odd in its place."""
    files = sorted(path for path in folder.rglob("*") if path.is_file() and not path.is_symlink())
    weights = np.array([1.0 if path.suffix in (".png", ".jpg") else 12.0 for path in files])
    path = files[int(rng.choice(len(files), p=weights / weights.sum()))]
    name = path.relative_to(folder)
    if rng.random() < 0.12:
        return f"{name}: {_in_its_place(path, rng)}"
    data = path.read_bytes()
    if path.suffix in (".txt", ".csv", ".json", ".toml", ".yaml") and rng.random() < 0.8:
        change = mutate_json_text if path.suffix == ".json" else mutate_text
        text, how = change(data.decode(), rng)
        path.write_bytes(text.encode("utf-8", "surrogatepass"))
    elif path.suffix == ".npy" and rng.random() < 0.7:
        value, how = mutate_array(np.load(path), rng)
        np.save(path, value)
    else:
        new, how = mutate_bytes(data, rng)
        path.write_bytes(new)
    return f"{name}: {how}"


def _in_its_place(path: Path, rng: Rng) -> str:
    """Something that is no file, or no such file, where one was."""
    import os

    path.unlink()
    how = _pick(rng, ("pipe", "device", "folder", "itself", "nothing", "empty", "beside"))
    if how == "pipe":
        os.mkfifo(path)
    elif how == "device":
        path.symlink_to("/dev/zero")
    elif how == "folder":
        path.mkdir()
    elif how == "itself":
        path.symlink_to(path.name)
    elif how == "empty":
        path.write_bytes(b"")
    elif how == "beside":
        path.with_name(f"._{path.name}").write_bytes(b"\0")
    return how
