"""Strategies that damage what is sound: bytes, lines, and what lies inside of packed containers."""

from collections.abc import Sequence

from hypothesis import strategies as st

# Sizes and counts that reach over an end, and words that formats take for something.
WORDS = (
    *(size.to_bytes(4, "little") for size in (0, 1, 15, 16, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF)),
    *(size.to_bytes(8, "little") for size in (0, 1 << 31, 1 << 40, (1 << 64) - 1)),
    *(b"\0", b"\n", b"\r\n", b"\r", b'"', b",", b";", b"#", b" ", b"\t", b"\xff", b"\xef\xbb\xbf", b"\xff\xfe"),
    *(b"nan", b"1e999", b"-", b".", b"1_0", "٣".encode(), b"\x1b[", b"x" * 5000, b"9" * 5000, b"\0" * 5000),
    *(b"LOBJ", b"LOGG", b"PAR1", b"MCAP0", b"&a ", b"*a", b"!!x ", b"<<: ", b"- " * 20),
    *(b"[" * 70, b"{" * 70, b'{"a":', b"NaN", b"Infinity"),
    *(b"timestamps relative", b"base dec", b"Begin Triggerblock", b"ErrorFrame", b"CANFD 1 Rx ", b"TxRq", b"0 f 64"),
    *(b";$FILEVERSION=9.9", b";$COLUMNS=O,T,I,l", b"##1", b"#R8", b"can1", b"DROPCOUNT:"),
    b"(2023-02-30 22:13:20.000000)",
)
_EDITS = ("set", "insert", "remove", "repeat", "zero", "cut")
Edit = tuple[str, int, bytes]

edits: st.SearchStrategy[list[Edit]] = st.lists(
    st.tuples(st.sampled_from(_EDITS), st.integers(0, (1 << 20) - 1), st.sampled_from(WORDS) | st.binary(max_size=8)),
    max_size=5,
)


def edited(data: bytes, made: Sequence[Edit]) -> bytes:
    """Return the bytes with the edits made one by one; places are taken modulo the length."""
    for kind, where, what in made:
        at = where % (len(data) + 1)
        if kind == "set":
            data = data[:at] + what + data[at + len(what) :]
        elif kind == "insert":
            data = data[:at] + what + data[at:]
        elif kind == "remove":
            data = data[:at] + data[at + len(what) :]
        elif kind == "repeat":
            data = data[:at] + data[at : at + 60] * 2 + data[at + 60 :]
        elif kind == "zero":
            data = data[:at] + bytes(len(data[at : at + 8 * len(what)])) + data[at + 8 * len(what) :]
        else:
            data = data[:at]
    return data


def edited_lines(lines: Sequence[bytes], made: Sequence[Edit]) -> bytes:
    """Return the lines joined, with the edits made to whole lines: replaced, put in, left out, twice, zeroed, cut."""
    changed = list(lines)
    for kind, where, what in made:
        at = where % (len(changed) + 1)
        if kind == "set":
            changed[at : at + 1] = [what + b"\n"]
        elif kind == "insert":
            changed.insert(at, what)
        elif kind == "remove":
            del changed[at : at + 1 + len(what)]
        elif kind == "repeat":
            changed[at:at] = changed[at : at + 2]
        elif kind == "zero":
            changed[at : at + 1] = [bytes(len(line)) for line in changed[at : at + 1]]
        else:
            changed[at : at + 1] = [line[: len(line) // 2] for line in changed[at : at + 1]]
    return b"".join(changed)
