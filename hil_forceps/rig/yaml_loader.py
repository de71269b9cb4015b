"""YAML as a rig file may use it: one document of mappings, lists and scalars of the YAML 1.2 core schema.

PyYAML supplies scanner and parser (events); everything that decides about meaning stands here, because PyYAML's own
constructor follows YAML 1.1: it reads `1e-3` as a string, `012` as 10, `on` as true, and keeps the last of duplicate
keys in silence. Anchors, aliases, merge keys and tags are refused: a rig file is read by people, top to bottom.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import yaml

from hil_forceps.rig.errors import UserError
from hil_forceps.rig.validation.problems import Path, Problem, show_path, show_value

MAX_FILE_BYTES = 64 * 1024
MAX_DEPTH = 8
MAX_NUMBER_CHARACTERS = 64
MAX_PROBLEMS = 100

Scalar = None | bool | int | float | str

_INT = re.compile(r"[-+]?[0-9]+")
_OCTAL = re.compile(r"0o[0-7]+")
_HEX = re.compile(r"0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_WORDS: dict[str, Scalar] = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL"), None),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
    **dict.fromkeys((f"{sign}.{word}" for sign in ("", "+") for word in ("inf", "Inf", "INF")), float("inf")),
    **dict.fromkeys(("-.inf", "-.Inf", "-.INF"), float("-inf")),
    **dict.fromkeys((".nan", ".NaN", ".NAN"), float("nan")),
}
# YAML 1.1, and so PyYAML, ends a line at these; YAML 1.2 doesn't. Refused rather than read one way or the other.
_OLD_LINE_BREAKS = re.compile("[\x85\u2028\u2029]")


class Mark(NamedTuple):
    """A place in the file, both counted from 1."""

    line: int
    column: int


@dataclass(slots=True)
class Document:
    """What a file says and where: plain data, the mark of every key (list item) and value, and what is refused."""

    data: object = None
    key_marks: dict[Path, Mark] = field(default_factory=dict)
    value_marks: dict[Path, Mark] = field(default_factory=dict)
    problems: list[tuple[Mark, Problem]] = field(default_factory=list)
    refused: set[Path] = field(default_factory=set)  # values that can't be had: None stands in their place


class _StopError(Exception):
    """Nothing after this point can be read."""

    def __init__(self, mark: Mark, text: str) -> None:
        self.mark = mark
        self.text = text
        super().__init__(text)


def resolve_plain(text: str) -> Scalar:
    """Read a plain (unquoted) scalar by the core schema of YAML 1.2.2, section 10.3.2; ValueError when too long."""
    if text in _WORDS:
        return _WORDS[text]
    if text[0] not in "+-.0123456789" or not (
        (integer := _INT.fullmatch(text)) or _FLOAT.fullmatch(text) or _OCTAL.fullmatch(text) or _HEX.fullmatch(text)
    ):
        return text
    if len(text) > MAX_NUMBER_CHARACTERS:
        raise ValueError(f"is a number of {len(text)} characters; write at most {MAX_NUMBER_CHARACTERS}")
    if integer:
        return int(text)
    if text[:2] in {"0o", "0x"}:
        return int(text[2:], 8 if text[1] == "o" else 16)
    return float(text)


class _PyYamlMark(Protocol):
    line: int
    column: int


def load_document(text: str, name: str) -> Document:
    """Read one document; UserError with every problem found up to the first place where reading can't go on."""
    builder = _Builder()
    try:
        _check_text(text)
        for event in _events(text.removeprefix("\ufeff")):
            builder.take(event)
    except _StopError as stop:
        before = render(name, builder.document.problems)
        at = f"{name}:{stop.mark.line}:{stop.mark.column}"
        raise UserError([*before, f"{at}: {stop.text}"]) from None
    return builder.document


def render(name: str, problems: list[tuple[Mark, Problem]]) -> list[str]:
    """Write problems as `name:line: key.path: text`, in the order of the file."""
    lines = [
        f"{name}:{mark.line}: " + (f"{show_path(problem.path)}: " if problem.path else "") + problem.text
        for mark, problem in sorted(problems, key=lambda item: item[0])
    ]
    different = list(dict.fromkeys(lines))
    more = len(different) - MAX_PROBLEMS
    return [*different[:MAX_PROBLEMS], f"{name}: {more} more problems; correct these first"] if more > 0 else different


def _check_text(text: str) -> None:
    size = len(text.encode("utf-8", errors="surrogatepass"))
    if size > MAX_FILE_BYTES:
        raise _StopError(Mark(1, 1), f"{size} bytes is no rig file; at most {MAX_FILE_BYTES} are read")
    if found := _OLD_LINE_BREAKS.search(text):
        raise _StopError(
            _mark_at(text, found.start()), f"character U+{ord(found[0]):04X} is refused; end lines with a newline"
        )


def _mark_at(text: str, index: int) -> Mark:
    start = text.rfind("\n", 0, index) + 1
    return Mark(text.count("\n", 0, index) + 1, index - start + 1)


def _events(text: str) -> Iterator[yaml.Event]:
    """Yield the events of PyYAML's parser; whatever it objects to becomes a `_StopError` with its place."""
    try:
        loader = yaml.SafeLoader(text)
    except yaml.reader.ReaderError as error:
        shown = f"character U+{int(error.character):04X}"
        raise _StopError(_mark_at(text, error.position), f"{shown} is refused; write the file in plain UTF-8") from None
    while True:
        try:
            event = loader.get_event()  # type: ignore[no-untyped-call]
        except yaml.MarkedYAMLError as error:
            raise _StopError(_mark(error.problem_mark or error.context_mark), _syntax_text(error)) from None
        except (ValueError, OverflowError):
            # PyYAML converts escapes such as "\UFFFFFFFF" and the digits of %YAML without a check of its own.
            where = _mark(loader.get_mark())
            raise _StopError(where, "this escape or number is out of range; write the character itself") from None
        if event is None:
            return
        yield event


def _mark(mark: _PyYamlMark | None) -> Mark:
    return Mark(mark.line + 1, mark.column + 1) if mark else Mark(1, 1)


def _syntax_text(error: yaml.MarkedYAMLError) -> str:
    problem = error.problem or "can't be read"
    if "'\\t'" in problem:
        return "a tab where YAML wants spaces; replace it by spaces"
    begun = f" (begun on line {error.context_mark.line + 1})" if error.context_mark else ""
    context = f" {error.context}{begun}:" if error.context else ""
    return f"not valid YAML:{context} {problem}; correct it here or just above"


@dataclass(slots=True)
class _Level:
    """An open mapping or list while its entries come in."""

    path: Path
    container: dict[str, object] | list[object]
    key: str | None = None  # of a mapping, read while its value is awaited
    keep: bool = True  # False inside the value of a duplicate or refused key: read, not kept
    keep_next: bool = True  # False while such a value is awaited

    def keeps(self) -> bool:
        return self.keep and self.keep_next


class _Builder:
    """Builds plain data out of parser events, one level of nesting per open container, without recursion."""

    def __init__(self) -> None:
        self.document = Document()
        self._levels: list[_Level] = []
        self._documents = 0

    def take(self, event: yaml.Event) -> None:
        """Take the next event."""
        if isinstance(event, yaml.DocumentStartEvent):
            self._start_document(event)
        elif isinstance(event, yaml.CollectionEndEvent):
            self._levels.pop()
        elif isinstance(event, yaml.NodeEvent):
            self._take_node(event)

    def _start_document(self, event: yaml.DocumentStartEvent) -> None:
        mark = _mark(event.start_mark)
        self._documents += 1
        if self._documents > 1:
            raise _StopError(mark, "a second document begins here; a rig file holds one, so remove the line `---`")
        if event.tags:
            self._refuse(mark, (), "%TAG is refused; a rig file needs no tags")
        if event.version and tuple(event.version) != (1, 2):
            self._refuse(mark, (), "only YAML 1.2 is read; remove the line %YAML")

    def _take_node(self, event: yaml.NodeEvent) -> None:
        mark = _mark(event.start_mark)
        level = self._levels[-1] if self._levels else None
        if level and isinstance(level.container, dict) and level.key is None:
            self._take_key(level, event, mark)
            return
        path = self._value_path(level)
        keep = level is None or level.keeps()
        if keep:
            self.document.key_marks.setdefault(path, mark)
            self.document.value_marks[path] = mark
            self._refuse_references(event, mark, path)
        if isinstance(event, yaml.ScalarEvent):
            self._place(level, self._scalar(event, mark, path) if keep else None)
        elif isinstance(event, yaml.CollectionStartEvent):
            self._open(level, event, mark, path)
        else:
            self._place(level, None)

    @staticmethod
    def _value_path(level: _Level | None) -> Path:
        if level is None:
            return ()
        if isinstance(level.container, list):
            return (*level.path, len(level.container))
        return (*level.path, level.key or "")

    def _take_key(self, level: _Level, event: yaml.NodeEvent, mark: Mark) -> None:
        if not isinstance(event, yaml.ScalarEvent):
            raise _StopError(
                mark, "a key must be a plain name; put quotes around text that begins with `*`, `[` or `{`"
            )
        key = str(event.value)
        path = (*level.path, key)
        level.key = key
        if not level.keep:
            return
        if key == "<<" and event.implicit[0]:
            level.keep_next = False
            self._refuse(mark, path, "merge keys are refused; write the keys out")
        elif key in level.container:
            level.keep_next = False
            first = self.document.key_marks[path].line
            self._refuse(mark, path, f"duplicate key, first given on line {first}; keep one of them")
        else:
            self.document.key_marks[path] = mark
            self._refuse_references(event, mark, path)

    def _open(self, level: _Level | None, event: yaml.CollectionStartEvent, mark: Mark, path: Path) -> None:
        if len(self._levels) >= MAX_DEPTH:
            raise _StopError(mark, f"nested deeper than {MAX_DEPTH} levels; a rig file needs four at most")
        container: dict[str, object] | list[object] = {} if isinstance(event, yaml.MappingStartEvent) else []
        keep = level is None or level.keeps()
        self._place(level, container)
        self._levels.append(_Level(path, container, keep=keep))

    def _place(self, level: _Level | None, value: object) -> None:
        if level is None:
            self.document.data = value
        elif isinstance(level.container, list):
            level.container.append(value)
        elif level.key is not None:
            if level.keep_next:
                level.container[level.key] = value
            level.key = None
            level.keep_next = True

    def _scalar(self, event: yaml.ScalarEvent, mark: Mark, path: Path) -> Scalar:
        text = str(event.value)
        if event.style:
            return text
        try:
            return resolve_plain(text)
        except ValueError as error:
            self._refuse(mark, path, str(error))
            self.document.refused.add(path)
            return None

    def _refuse_references(self, event: yaml.NodeEvent, mark: Mark, path: Path) -> None:
        if isinstance(event, yaml.AliasEvent):
            self._refuse(mark, path, f"alias *{event.anchor} is refused; write the value out")
            self.document.refused.add(path)
            return
        if event.anchor is not None:
            self._refuse(mark, path, f"anchor &{event.anchor} is refused; remove it and write values out where used")
        if isinstance(event, yaml.ScalarEvent | yaml.CollectionStartEvent) and event.tag is not None:
            self._refuse(
                mark, path, f"tag {show_value(event.tag.replace('tag:yaml.org,2002:', '!!'))} is refused; remove it"
            )

    def _refuse(self, mark: Mark, path: Path, text: str) -> None:
        self.document.problems.append((mark, Problem(path, text)))
        if len(self.document.problems) >= MAX_PROBLEMS:
            raise _StopError(mark, "too many problems; the rest isn't read")
