"""Ways to spoil a file."""

from __future__ import annotations

import io
import re
import zipfile

import numpy as np

Random = np.random.Generator

_WORDS = [
    b"-1", b"0", b"1", b"-2147483648", b"4294967296", b"9223372036854775807", b"1e308", b"-1e308",
    b"1e-320", b"nan", b"inf", b"99999999999999999999999", b"", b"x", b"\x1b[2J", b"\xff\xfe",
    b"[" * 4000, b"{}", b"[]", b"null", b"true", b'""', b"1000000000", b"\0",
]  # fmt: skip


def spoilt(data: bytes, random: Random) -> bytes:
    """Another file than it was."""
    if zipfile.is_zipfile(io.BytesIO(data)) and random.random() < 0.75:
        return _spoilt_archive(data, random)
    for _ in range(int(random.integers(1, 4))):
        data = _SPOIL[int(random.integers(len(_SPOIL)))](data, random)
    return data


def _spoilt_archive(data: bytes, random: Random) -> bytes:
    """With a member that is spoilt, gone or another's, and sums that are right."""
    with zipfile.ZipFile(io.BytesIO(data)) as file:
        members = {name: file.read(name) for name in file.namelist()}
    names = list(members)
    name, other = (names[int(random.integers(len(names)))] for _ in range(2))
    kind = random.random()
    if kind < 0.1:
        del members[name]
    elif kind < 0.2:
        members[name] = members[other]
    elif name.endswith(".npy"):
        members[name] = _spoilt_array(members[name], random)
    else:
        members[name] = spoilt(members[name], random)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as file:
        for name, content in members.items():
            file.writestr(name, content)
    return out.getvalue()


def _spoilt_array(data: bytes, random: Random) -> bytes:
    if random.random() < 0.4:
        return spoilt(data, random)
    array = np.load(io.BytesIO(data), allow_pickle=False)
    kind = int(random.integers(6))
    with np.errstate(all="ignore"):
        if kind == 0:
            array = array[:-1] if array.ndim else array.reshape(1)
        elif kind == 1:
            array = array.reshape(-1)
        elif kind == 2:
            array = np.zeros((0, *array.shape[1:]), array.dtype)
        elif kind == 3 and array.dtype.kind in "biuf":
            array = array.astype(
                [np.float32, np.int64, np.uint8, np.complex128, "S4"][int(random.integers(5))]
            )
        elif array.dtype.kind in "iuf" and array.size:
            array = array.copy()
            bad = [np.nan, np.inf, 1e308, -1.0, 0.0, 1e18][int(random.integers(6))]
            at = int(random.integers(array.size)) if random.random() < 0.5 else slice(None)
            array.reshape(-1)[at] = np.float64(bad).astype(array.dtype)
        elif array.dtype.kind == "U":
            array = np.array(spoilt(str(array).encode(), random).decode("utf-8", "replace"))
    out = io.BytesIO()
    np.save(out, array)
    return out.getvalue()


def _bytes(data: bytes, random: Random) -> bytes:
    found = bytearray(data)
    for _ in range(int(random.integers(1, 9)) if found else 0):
        found[int(random.integers(min(len(found), 4096)))] = int(random.integers(256))
    return bytes(found)


def _cut(data: bytes, random: Random) -> bytes:
    return data[: int(random.integers(len(data) + 1))]


def _without(data: bytes, random: Random) -> bytes:
    at, length = int(random.integers(len(data) + 1)), int(random.integers(1, 64))
    return data[:at] + data[at + length :]


def _twice(data: bytes, random: Random) -> bytes:
    at, length = int(random.integers(len(data) + 1)), int(random.integers(1, 512))
    return data[: at + length] + data[at:]


def _number(data: bytes, random: Random) -> bytes:
    """A number in a text becomes another; most often one near the beginning."""
    places = list(re.finditer(rb"-?\d+(\.\d+)?(e[+-]?\d+)?", data[:20000]))
    if not places:
        return _bytes(data, random)
    last = len(places) if random.random() < 0.5 else min(len(places), 12)
    place = places[int(random.integers(last))]
    word = _WORDS[int(random.integers(len(_WORDS)))]
    return data[: place.start()] + word + data[place.end() :]


def _word(data: bytes, random: Random) -> bytes:
    places = list(re.finditer(rb"[A-Za-z_]+", data[:20000]))
    if not places:
        return _bytes(data, random)
    place, other = (places[int(random.integers(len(places)))] for _ in range(2))
    word = other[0] if random.random() < 0.5 else _WORDS[int(random.integers(len(_WORDS)))]
    return data[: place.start()] + word + data[place.end() :]


def _binary(data: bytes, random: Random) -> bytes:
    """Four or eight bytes become an extreme number."""
    if len(data) < 16:
        return _bytes(data, random)
    at = int(random.integers(min(len(data) - 8, 4096)))
    words = [
        b"\xff" * 4,
        b"\x00" * 4,
        b"\xff\xff\xff\x7f",
        b"\x00\x00\x00\x80",
        b"\xff" * 8,
        b"\x7f" + b"\xff" * 7,
    ]
    word = words[int(random.integers(len(words)))]
    return data[:at] + word + data[at + len(word) :]


def _line(data: bytes, random: Random) -> bytes:
    lines = data.split(b"\n")
    at, other = (int(random.integers(len(lines))) for _ in range(2))
    lines[at] = lines[other] if random.random() < 0.7 else b""
    return b"\n".join(lines)


_SPOIL = [_bytes, _cut, _without, _twice, _number, _number, _number, _word, _binary, _line]
