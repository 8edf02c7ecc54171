"""Damaged and hostile files of results: each is refused by one ValueError that names the file."""

import functools
import io
import json
import os
import pickle
import struct
import zipfile
from pathlib import Path

import numpy as np
from hostile_table import Hostile, each

import adaptmg as am
from adaptmg.solver import store

FILE = "damaged.npz"


@functools.cache
def whole() -> tuple[bytes, dict[str, np.ndarray], str]:
    """A good file, its arrays, and its JSON text."""
    from made import result_on, square

    result_on(square(2)).save("good.npz")
    data = Path("good.npz").read_bytes()
    with np.load(io.BytesIO(data)) as arrays:
        parts = {name: arrays[name] for name in arrays.files}
    am.Result.load("good.npz")
    return data, parts, parts.pop("meta").tobytes().decode()


def load(data: bytes) -> None:
    Path(FILE).write_bytes(data)
    am.Result.load(FILE)


def packed(arrays: dict[str, np.ndarray], meta: bytes | None) -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer, **arrays, **({} if meta is None else {"meta": np.frombuffer(meta, dtype=np.uint8)})
    )
    return buffer.getvalue()


def zipped(method: int = zipfile.ZIP_DEFLATED, **entries: bytes) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as archive:
        for name, content in entries.items():
            archive.writestr(name.replace("_npy", ".npy"), content)
    return buffer.getvalue()


def refused(name: str, make) -> Hostile:
    """A file with the content ``make(file, arrays, text)``, made of those of a good one."""
    return Hostile(name, lambda: load(make(*whole())), FILE, ValueError, writes=True)


def _files():
    """What is not an archive, or a broken one."""
    raw = {
        "empty": lambda d: b"",
        "half": lambda d: d[: len(d) // 2],
        "no arrays": lambda d: zipped(),
        "lzma": lambda d: zipped(zipfile.ZIP_LZMA, meta_npy=b"x"),
        "pickle": lambda d: pickle.dumps({"displacement": 1}),
        "listed twice": lambda d: d.replace(b"contact.gap.npy", b"contact.u_n.npy"),
        "an array behind a folder": lambda d: zipped(**{"../meta_npy": b"x"}),
        "zeros without end": lambda d: zipped(displacement_npy=_npy(np.zeros((5_000_000, 2)))),
        "many entries": lambda d: zipped(
            zipfile.ZIP_STORED, **{f"{k}_npy": b"" for k in range(10_001)}
        ),
    }
    yield from (
        refused(name, lambda d, arrays, text, make=make: make(d)) for name, make in raw.items()
    )
    yield Hostile("changed anywhere", _changed_anywhere, FILE, ValueError, writes=True)
    # other files that are none: tests/runtime/test_atomic.py
    yield Hostile(
        "a pipe", lambda: (os.mkfifo(FILE), am.Result.load(FILE)), FILE, ValueError, writes=True
    )
    yield Hostile("no file", lambda: am.Result.load(FILE), FILE, FileNotFoundError)
    yield from each(
        "path",
        am.Result.load,
        {"None": None, "zero byte": "a\0b", "no such user": "~nobody-here/x"},
    )


def _npy(array: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=True)
    return buffer.getvalue()


def _changed_anywhere() -> None:
    """Each byte of the directory, and some of the arrays: refused, or it does not matter."""
    data, faults = whole()[0], 0
    good = am.Result.load(FILE) if Path(FILE).write_bytes(data) else None
    for at in (*range(50, len(data) - 2000, 997), *range(len(data) - 2000, len(data), 37)):
        try:
            load(data[:at] + bytes([data[at] ^ 0xFF]) + data[at + 1 :])
            assert am.Result.load(FILE).status == good.status
        except ValueError as error:
            assert FILE in str(error), error
            faults += 1
    assert faults > 10
    raise ValueError(FILE)


def _header(
    text: str, body: bytes = b"\0" * 64, version: int = 1, length: int | None = None
) -> bytes:
    text += "\n"
    form = "<H" if version == 1 else "<I"
    return (
        b"\x93NUMPY"
        + bytes([version, 0])
        + struct.pack(form, len(text) if length is None else length)
        + text.encode()
        + body
    )


def _bombs():
    """Little that says it is much, or that would have Python run it."""
    shape = "{'descr': '<f8', 'fortran_order': False, 'shape': %s, }"
    headers = {
        "terabytes in a header": _header(shape % "(1000000000000,)"),
        "sizes that wrap": _header(shape % "(4294967296, 4294967296)"),
        "objects": _npy(np.array([{}, None], dtype=object)),
        "code in a header": _header("__import__('os').mkdir('was-here')"),
        "deep header": _header("(" * 5000 + ")" * 5000),
        "too few bytes": _header(shape % "(9,)"),
        "long header": _header(shape % "(8,)", version=2, length=2**32 - 1),
        "records": _npy(np.zeros(3, dtype=[("a", "<f8")])),
    }
    yield from (
        refused(name, lambda *good, c=content: zipped(displacement_npy=c))
        for name, content in headers.items()
    )


def _changed(
    arrays: dict[str, np.ndarray],
    text: str,
    new: dict[str, object] | None = None,
    whole: object = None,
) -> bytes:
    """A file with other fields of its result, or another value, and the hash that fits."""
    meta = json.loads(text)
    meta["value"] = {"Result": meta["value"]["Result"] | (new or {})} if whole is None else whole
    del meta["hash"]
    return packed(arrays, json.dumps(meta | {"hash": store._hash(meta, arrays)}).encode())


def _texts():
    """Wrong JSON."""
    texts = {
        "no text": None,
        "list": b"[1]",
        "bad UTF-8": b'{"format": "\xff"}',
        "deep": b"[" * 100_000 + b"]" * 100_000,
    }
    yield from (
        refused(f"meta: {name}", lambda d, arrays, text, new=new: packed(arrays, new))
        for name, new in texts.items()
    )
    yield refused(
        "meta: format",
        lambda d, arrays, text: packed(
            arrays, json.dumps(json.loads(text) | {"format": 99}).encode()
        ),
    )
    changes = {
        "status": {"Status": "FINE"},
        "mesh": {"MeshArrays": {"points": []}},
        "unknown": 3,
        "levels": {"tuple": 3},
        "displacement": {"array": 0},
    }
    for key, value in changes.items():
        yield refused(
            f"meta: {key}", lambda d, arrays, text, new={key: value}: _changed(arrays, text, new)
        )
    values = {
        "another kind": {"MeshArrays": {}},
        "an unknown kind": {"Path": {}},
        "the same": {"same": 99},
        "two kinds": {"array": "displacement", "dict": {}},
        "no array": {"array": "x"},
        "a list": [],
    }
    for label, value in values.items():
        yield refused(
            f"meta: value is {label}",
            lambda d, arrays, text, v=value: _changed(arrays, text, whole=v),
        )


def _at(index: int, value: float):
    def change(array: np.ndarray) -> np.ndarray:
        array = (
            array.astype(np.int64) if array.dtype.kind == "i" and abs(value) > 100 else array.copy()
        )
        array.reshape(-1)[index] = value
        return array

    return change


def _arrays():
    """Arrays that were changed; and those of a mesh that point outside, with the hash that fits."""
    yield refused(
        "displacement changed",
        lambda d, arrays, text: packed(
            arrays | {"displacement": 2 * arrays["displacement"]}, text.encode()
        ),
    )
    for name, change in {
        "contact.force_n": lambda a: a.astype(object),
        "mesh.elements": _at(0, 2**33),
        "mesh.facet_labels": _at(0, 4),
        "mesh.points": _at(0, float("nan")),
    }.items():
        yield refused(
            f"{name} with its hash",
            lambda d, arrays, text, n=name, c=change: _changed(arrays | {n: c(arrays[n])}, text),
        )
    yield refused(
        "without displacement",
        lambda d, arrays, text: packed(
            {k: v for k, v in arrays.items() if k != "displacement"}, text.encode()
        ),
    )


INPUTS = (*_files(), *_bombs(), *_texts(), *_arrays())
