"""Text that ends where it should not: within a line, or in zero bytes that a power cut left."""


def whole_lines(data: bytes) -> tuple[bytes, str]:
    """Return the lines in front of zero bytes that have an end, and a note on what was left out; none, an empty one.

    A last line without an end may be cut within a number, and nobody can tell: -8.3 of -8.3e-06 is a number, too.
    """
    zero = data.find(b"\0")
    end = data.rfind(b"\n", 0, zero if zero >= 0 else len(data)) + 1
    kept, left = data[:end], data[end:]
    line = kept.count(b"\n") + 1
    if zero >= 0:
        return kept, zero_bytes_note(line)
    return kept, no_end_note(line) if left.strip() else ""


def zero_bytes_note(line: int) -> str:
    """Say that reading ended at zero bytes."""
    return f"line {line} contains zero bytes, as after a power cut; it and the rest of the file were left out"


def no_end_note(line: int) -> str:
    """Say that a last line was left out."""
    return f"line {line}, the last, has no line end and may be cut off: it was left out"
