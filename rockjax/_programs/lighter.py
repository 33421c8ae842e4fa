"""Kept programs without what only the compiler needs.

What XLA writes out of a program for the CPU is its machine code, the calls of it in their order, its buffers,
and the whole of the optimised program that these were made from. Nine tenths of the time to load it go into
building that program again, and most of it is the inside of fused kernels, whose code is there already. Here
every fusion that is called as a plain kernel becomes an opaque call with the same operands and shape:
programs are a quarter as large and load ten times as fast. Code, calls and buffers stay as they are, so
answers do as well.

The numbers of fields are those of OpenXLA's `hlo.proto` and `thunk.proto`. Where an executable is not as
expected, or comes from a version with which this has not been tried, it is left as it is.
"""

from __future__ import annotations

import logging
import pickletools
from collections.abc import Callable, Iterator, Sequence
from importlib.metadata import version
from typing import Any, NamedTuple

_LOG = logging.getLogger("rockjax")
TRIED = ("0.12",)  # versions of jaxlib
# An executable is a header and a message. Its first field has the program, within a first field of its own,
# and the calls.
_COMPILED, _PROGRAM, _CALLED = 1, (1, 1), 6
_KERNEL = b"\n\x06kernel\x12"  # how the call of a plain kernel begins: its kind; its name comes next
_COMPUTATIONS = 3  # of a program
_INSTRUCTIONS, _COMPUTATION_ID, _IS_FUSED = 2, 5, 7  # of a computation
# Of an instruction.
_NAME, _OPCODE, _SHAPE, _TARGET, _ID, _OPERANDS, _AFTER, _CALLS, _ALIASES = 1, 2, 3, 28, 35, 36, 37, 38, 74
_OPAQUE = (_NAME, _OPCODE, _SHAPE, _ID, _OPERANDS, _AFTER)  # what an opaque call has as well
# Kernels with one of these may write to their operands in place, or have several results: buffers depend on
# them. As the field of an opcode is written.
_NEEDED = [
    bytes([_OPCODE << 3 | 2, len(opcode)]) + opcode
    for opcode in (
        *(b"dynamic-update-slice", b"scatter", b"tuple"),
        *(b"while", b"call", b"conditional", b"custom-call"),
    )
]
_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5  # how a field is written

Field = tuple[int, int, int | bytes]  # number, how it is written, value


class Unexpected(ValueError):
    """An executable that is not as expected."""


def lighter(payload: bytes) -> bytes:
    """A pickled executable, as `serialize` of `jax.experimental.serialize_executable` gives it, with opaque
    kernels; the same where that cannot be."""
    if ".".join(version("jaxlib").split(".")[:2]) not in TRIED:
        return payload
    try:
        start, end = _executable(payload)
        slim = _lighter(payload[start:end])
    except (ValueError, IndexError) as error:
        _LOG.debug("a program is kept as it is: %s", error)
        return payload
    return payload[: start - 4] + len(slim).to_bytes(4, "little") + slim + payload[end:]


def _executable(payload: bytes) -> tuple[int, int]:
    """Where the executable is in the pickle: bytes of a length in four bytes, outside of frames."""
    operations = list(pickletools.genops(payload))
    inside = 0  # of a frame that ends here
    for operation, value, position in operations:
        if operation.name == "FRAME":
            inside = (position or 0) + 9 + int(value or 0)
        elif operation.name == "BINBYTES" and isinstance(value, bytes) and (position or 0) >= inside:
            start = (position or 0) + 5
            return start, start + len(value)
    raise Unexpected("it is so small that it is in a frame")


def _lighter(executable: bytes) -> bytes:
    length, start = _varint(executable, 0)
    start += length
    return executable[:start] + _at(executable[start:], (_COMPILED,), _compiled)


def _compiled(result: bytes) -> bytes:
    kernels = _kernels(_text(_one(_fields(result), _CALLED) or b""))
    return _at(result, _PROGRAM, lambda program: _opaque(program, kernels))


def _kernels(calls: bytes) -> set[bytes]:
    """The names of what is called as a plain kernel, inside of loops as well."""
    found, at = set(), calls.find(_KERNEL)
    while at >= 0:
        _, name = _varint(calls, at + len(_KERNEL))
        if calls[name] == _NAME << 3 | _BYTES:
            length, start = _varint(calls, name + 1)
            found.add(calls[start : start + length])
        at = calls.find(_KERNEL, at + 1)
    return found


class _Computation(NamedTuple):
    """A part of the program: its number, whether it is the inside of a fusion, and what it consists of."""

    number: int | bytes | None
    fused: bool
    fields: list[Field]

    @property
    def instructions(self) -> Iterator[list[Field]]:
        return (_fields(_text(value)) for number, _, value in self.fields if number == _INSTRUCTIONS)

    @property
    def is_simple(self) -> bool:
        """Whether none of the opcodes that are needed is in it; what looks like one counts as one."""
        texts = [_text(value) for number, _, value in self.fields if number == _INSTRUCTIONS]
        return not any(opcode in text for text in texts for opcode in _NEEDED)


def _computation(text: bytes) -> _Computation:
    fields = _fields(text)
    return _Computation(_one(fields, _COMPUTATION_ID), bool(_one(fields, _IS_FUSED)), fields)


def _opaque(program: bytes, kernels: set[bytes]) -> bytes:
    """The program with opaque calls for fusions that are kernels, or part of one."""
    fields = _fields(program)
    computations = {k: _computation(_text(y)) for k, (n, _, y) in enumerate(fields) if n == _COMPUTATIONS}
    gone = _not_needed(list(computations.values()), kernels)
    if not gone:
        raise Unexpected("nothing is fused")
    kept: list[Field] = []
    for k, (number, way, value) in enumerate(fields):
        if k not in computations:
            kept.append((number, way, value))
        elif computations[k].number not in gone:
            kept.append((number, way, _message([_closed(part, gone) for part in computations[k].fields])))
    return _message(kept)


def _not_needed(computations: Sequence[_Computation], kernels: set[bytes]) -> set:
    """Numbers of what is inside of fusions that are kernels, or part of one, and write to no operand."""
    gone = {one.number for one in computations if one.fused and one.is_simple}
    looked_at = [one for one in computations if one.number not in gone]
    part_of_one = _within(looked_at, kernels)
    while looked_at:
        stays: set = set()
        for one in looked_at:
            for instruction in one.instructions:
                fused = _one(instruction, _OPCODE) == b"fusion" and _one(instruction, _ALIASES) is None
                if not fused or not (one.number in part_of_one or _one(instruction, _NAME) in kernels):
                    stays |= gone & set(_numbers(instruction, _CALLS))
        gone -= stays
        looked_at = [one for one in computations if one.number in stays]
    return gone


def _within(computations: Sequence[_Computation], kernels: set[bytes]) -> set:
    """Numbers of all computations that calls which are one kernel consist of."""
    calls: dict[Any, set[int]] = {}
    new: set[int] = set()
    for one in computations:
        calls[one.number] = set()
        for instruction in one.instructions:
            called = set(_numbers(instruction, _CALLS))
            calls[one.number] |= called
            if _one(instruction, _OPCODE) == b"call" and _one(instruction, _NAME) in kernels:
                new |= called
    reached: set[int] = set()
    while new:
        reached |= new
        new = set().union(*(calls.get(number, ()) for number in new)) - reached
    return reached


def _closed(part: Field, gone: set) -> Field:
    """A part of a computation, an opaque call where it is an instruction that calls such a fusion."""
    number, way, value = part
    if number != _INSTRUCTIONS:
        return part
    instruction = _fields(_text(value))
    if not gone & set(_numbers(instruction, _CALLS)):
        return part
    kept = [field for field in instruction if field[0] in _OPAQUE]
    kept = [(_OPCODE, _BYTES, b"custom-call") if field[0] == _OPCODE else field for field in kept]
    return number, way, _message([*kept, (_TARGET, _BYTES, b"compiled")])


# ------------------------------------------------------------------------------------------ protocol buffers
def _varint(text: bytes, at: int) -> tuple[int, int]:
    """A number, and where the next field begins."""
    value = shift = 0
    while True:
        byte = text[at]
        value, shift, at = value | (byte & 127) << shift, shift + 7, at + 1
        if byte < 128:
            return value, at


def _of_varint(value: int) -> bytes:
    text = bytearray()
    while value > 127:
        text.append(value & 127 | 128)
        value >>= 7
    return bytes([*text, value])


def _fields(message: bytes) -> list[Field]:
    """The fields of a message in their order."""
    found: list[Field] = []
    at = 0
    while at < len(message):
        key, at = _varint(message, at)
        number, way = key >> 3, key & 7
        if way == _VARINT:
            value, at = _varint(message, at)
        elif way in (_BYTES, _FIXED64, _FIXED32):
            length, at = _varint(message, at) if way == _BYTES else ((8 if way == _FIXED64 else 4), at)
            value, at = message[at : at + length], at + length
        else:
            raise Unexpected(f"no field is written in the way {way}")
        if at > len(message):
            raise Unexpected("a field is longer than its message")
        found.append((number, way, value))
    return found


def _message(fields: Sequence[Field]) -> bytes:
    text = bytearray()
    for number, way, value in fields:
        text += _of_varint(number << 3 | way)
        if isinstance(value, int):
            text += _of_varint(value)
        else:
            text += (_of_varint(len(value)) if way == _BYTES else b"") + value
    return bytes(text)


def _at(message: bytes, path: Sequence[int], change: Callable[[bytes], bytes]) -> bytes:
    """The message with the one field at the end of a path of numbers changed."""
    if not path:
        return change(message)
    fields = _fields(message)
    if sum(number == path[0] for number, _, _ in fields) != 1:
        raise Unexpected(f"there is not one field {path[0]}")
    inner = lambda number, value: _at(_text(value), path[1:], change) if number == path[0] else value
    return _message([(number, way, inner(number, value)) for number, way, value in fields])


def _text(value: int | bytes) -> bytes:
    if isinstance(value, int):
        raise Unexpected("a number where a message should be")
    return value


def _one(fields: Sequence[Field], number: int) -> int | bytes | None:
    """The value of a field, None where it is not there."""
    return next((value for found, _, value in fields if found == number), None)


def _numbers(fields: Sequence[Field], number: int) -> list[int]:
    """Of a field that may be there many times, packed or not."""
    found: list[int] = []
    for which, _, value in fields:
        if which != number:
            continue
        if isinstance(value, int):
            found.append(value)
            continue
        at = 0
        while at < len(value):
            one, at = _varint(value, at)
            found.append(one)
    return found
