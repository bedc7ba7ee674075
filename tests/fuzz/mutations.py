"""Seeded damage to files of any format: to bytes, to numbers in headers, inside of containers with right checksums."""

import bz2
import gzip
import io
import re
import sqlite3
import struct
import tempfile
import warnings
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

Random = np.random.Generator
#: Numbers at which programs go wrong, for headers.
WHOLE = (0, 1, 2, 7, 127, 128, 255, 256, 32767, 32768, 65535, 65536, 2**24, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1)
REAL = (0.0, -0.0, 1e-300, 1e300, -1.0, float("inf"), float("-inf"), float("nan"), 1e9, -9999.0, 3.4e38)
WORDS = (
    b"0", b"-1", b"1", b"2", b"99999", b"4294967296", b"999999999999", b"1e400", b"nan", b"-inf", b"0x10", b"", b"1.5",
    b"123456789012345678901234567890", b"1e-320", b",", b";", b"\xff", b"\0", b"x",
)  # fmt: skip
_HEAD = 512  # bytes, where most headers are


def damaged(content: bytes, random: Random) -> bytes:
    """Bytes after one to four edits."""
    for _ in range(1 + int(random.geometric(0.5)) % 4):
        content = _EDITS[random.integers(len(_EDITS))](content or b"?", random)
    return content


def _place(content: bytes, random: Random) -> int:
    """An offset; a half of them in the header, some near the end, where directories of archives are."""
    kind, length = random.random(), len(content)
    if kind < 0.5:
        return int(random.integers(min(_HEAD, length)))
    return int(random.integers(max(0, length - _HEAD), length)) if kind < 0.65 else int(random.integers(length))


def _flipped(content: bytes, random: Random) -> bytes:
    changed = bytearray(content)
    for _ in range(int(random.integers(1, 5))):
        changed[_place(content, random)] ^= 1 << int(random.integers(8))
    return bytes(changed)


def _random_bytes(content: bytes, random: Random) -> bytes:
    at, width = _place(content, random), int(random.integers(1, 9))
    return content[:at] + random.bytes(width) + content[at + width :]


def _cut_off(content: bytes, random: Random) -> bytes:
    return content[: _place(content, random)]


def _removed(content: bytes, random: Random) -> bytes:
    at = _place(content, random)
    return content[:at] + content[at + int(random.integers(1, 65)) :]


def _doubled(content: bytes, random: Random) -> bytes:
    at = _place(content, random)
    piece = content[at : at + int(random.integers(1, 257))]
    return content[:at] + piece * int(random.integers(2, 5)) + content[at + len(piece) :]


def _moved(content: bytes, random: Random) -> bytes:
    one, other, width = _place(content, random), _place(content, random), int(random.integers(1, 129))
    piece = content[one : one + width]
    rest = content[:one] + content[one + width :]
    return rest[:other] + piece + rest[other:]


def _whole_number(content: bytes, random: Random) -> bytes:
    width = (1, 2, 4, 8)[random.integers(4)]
    value = int(WHOLE[random.integers(len(WHOLE))]) % 256**width
    at = _place(content, random)
    at -= at % width if random.random() < 0.5 else 0
    packed = value.to_bytes(width, "little" if random.random() < 0.7 else "big")
    return content[:at] + packed + content[at + width :]


def _real_number(content: bytes, random: Random) -> bytes:
    at, form = _place(content, random), ("<d", "<f", ">d", ">f")[random.integers(4)]
    at -= at % 4 if random.random() < 0.5 else 0
    value = float(REAL[random.integers(len(REAL))])
    packed = struct.pack(form, value if form[1] == "d" or abs(value) < 3.4e38 or value != value else float("inf"))
    return content[:at] + packed + content[at + len(packed) :]


def _number_in_text(content: bytes, random: Random) -> bytes:
    found = list(re.finditer(rb"[-+]?\d+(\.\d*)?", content[:4096]))
    if not found:
        return _whole_number(content, random)
    part = found[random.integers(len(found))]
    return content[: part.start()] + WORDS[random.integers(len(WORDS))] + content[part.end() :]


def _line(content: bytes, random: Random) -> bytes:
    lines = content.split(b"\n")
    at, kind = int(random.integers(min(len(lines), 40))), random.integers(4)
    if kind == 0:
        del lines[at]
    elif kind == 1:
        lines.insert(at, lines[at])
    elif kind == 2:
        other = int(random.integers(min(len(lines), 40)))
        lines[at], lines[other] = lines[other], lines[at]
    else:
        words = lines[at].split(b" ")
        words[random.integers(len(words))] = WORDS[random.integers(len(WORDS))]
        lines[at] = b" ".join(words)
    return b"\n".join(lines)


def _grown(content: bytes, random: Random) -> bytes:
    at = _place(content, random)
    return content[:at] + content[at : at + 1] * int(random.integers(100, 20_000)) + content[at:]


_EDITS: tuple[Callable[[bytes, Random], bytes], ...] = (
    _flipped, _random_bytes, _cut_off, _removed, _doubled, _moved, _whole_number, _whole_number, _real_number,
    _number_in_text, _number_in_text, _line, _grown,
)  # fmt: skip


def in_gzip(content: bytes, random: Random) -> bytes:
    """Damage to the unpacked contents, packed again."""
    return gzip.compress(damaged(gzip.decompress(content), random), 1)


def in_bzip2(content: bytes, random: Random) -> bytes:
    """Damage to the unpacked contents, packed again."""
    return bz2.compress(damaged(bz2.decompress(content), random), 1)


def in_archive(content: bytes, random: Random) -> bytes:
    """Damage to one member, with its new checksum; or to the list of members."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = [(info.filename, archive.read(info)) for info in archive.infolist()]
    at, kind = int(random.integers(len(members))), random.random()
    name, body = members[at]
    if kind < 0.8:
        members[at] = name, damaged(body, random)
    elif kind < 0.87:
        del members[at]
    elif kind < 0.94:
        members[at] = ("../" * int(random.integers(3)) + name, body)
    else:
        members.append((name, damaged(body, random)))
    stream, method = io.BytesIO(), zipfile.ZIP_DEFLATED if random.random() < 0.5 else zipfile.ZIP_STORED
    with warnings.catch_warnings(), zipfile.ZipFile(stream, "w", method) as archive:
        warnings.simplefilter("ignore")  # two members of one name
        for member, contents in members:
            archive.writestr(zipfile.ZipInfo(member), contents)
    return stream.getvalue()


def in_png(content: bytes, random: Random) -> bytes:
    """Damage to one chunk, or to the unpacked pixels, with its new checksum."""
    chunks, at = [], 8
    while at + 12 <= len(content):
        length = struct.unpack_from(">I", content, at)[0]
        chunks.append([content[at + 4 : at + 8], content[at + 8 : at + 8 + length]])
        at += 12 + length
    chunk = chunks[random.integers(len(chunks))]
    if chunk[0] == b"IDAT" and random.random() < 0.5:
        chunk[1] = zlib.compress(damaged(zlib.decompress(chunk[1]), random), 1)
    else:
        chunk[1] = damaged(chunk[1], random)
    if random.random() < 0.2:
        chunks.insert(int(random.integers(len(chunks))), list(chunk))
    parts = [
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body)) for kind, body in chunks
    ]
    return content[:8] + b"".join(parts)


def in_hdf5(content: bytes, random: Random) -> bytes:
    """Another shape, type, layout, value or name of one entry, written by HDF5 itself."""
    import h5py

    stream = io.BytesIO(content)
    with h5py.File(stream, "r+") as file:
        names = list(file)
        name = names[random.integers(len(names))]
        array, kind = file[name][()], random.integers(6)
        if kind == 0:
            _rewritten(
                file, name, np.resize(array, [int(random.integers(0, 5)) for _ in range(int(random.integers(4)))])
            )
        elif kind == 1:
            types = ("i1", "u8", "f2", "f8", "c16", "S3", "?", ">f4")
            with np.errstate(all="ignore"):
                _rewritten(file, name, np.zeros(np.shape(array), types[random.integers(len(types))]))
        elif kind == 2:
            file.move(name, ("heights", "origin", "resolution", "frame", "x")[random.integers(5)] + "_")
        elif kind == 3:
            del file[name]
            file[name] = h5py.SoftLink("/" + names[random.integers(len(names))])
        elif kind == 4:
            values = np.array(array, float)
            values.flat[random.integers(max(1, values.size))] = REAL[random.integers(len(REAL))]
            _rewritten(file, name, values)
        else:
            side = max(1, int(random.integers(1, 9)))
            data = np.zeros((side, side), "f4")
            del file[name]
            made = file.create_dataset(name, data=data, chunks=(side, side), compression="gzip", fletcher32=True)
            made.id.write_direct_chunk((0, 0), zlib.compress(random.bytes(int(random.integers(0, 4000)))))
    return stream.getvalue()


def _rewritten(file, name: str, values: np.ndarray) -> None:
    del file[name]
    file[name] = values


def in_database(content: bytes, random: Random) -> bytes:
    """Damage to one value of a message or topic in a bag of ROS 2, written by SQLite itself."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bag.db3"
        path.write_bytes(content)
        base = sqlite3.connect(path)
        base.text_factory = bytes
        try:
            if random.random() < 0.8:
                for number, data in base.execute("SELECT id, data FROM messages").fetchall():
                    base.execute("UPDATE messages SET data = ? WHERE id = ?", (damaged(data, random), number))
            else:
                column = ("name", "type", "serialization_format", "id")[random.integers(4)]
                value = (b"", b"x", 7, None, b"/map", -1)[random.integers(6)]
                base.execute(f"UPDATE topics SET {column} = ?", (value,))
            base.commit()
        except sqlite3.Error:
            return damaged(content, random)
        finally:
            base.close()
        return path.read_bytes()
