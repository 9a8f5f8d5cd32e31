"""One piece of memory for all that changes in a run, by the pattern of arrays of a template.

A template has arrays and structs of C, each where it was made. A `BlockPlan` gives each a place in
one piece of memory, with the values that it has now, and lists which words of the structs point to
which places. A `Block` is a copy of this piece, with these words set: nothing of C is called.
"""

from __future__ import annotations

import math
import mmap
from bisect import bisect_right
from collections.abc import Iterable, Iterator
from contextlib import suppress
from sys import getrefcount
from typing import Any

import numpy as np

# Size of a cache line, and size from which zeros are in pages of their own [bytes].
_LINE, _LARGE = 64, 1 << 22
# Number of memories of blocks that are looked at for another one.
_WARM = 4


def aligned_zeros(*shape: int, dtype: type = np.float64) -> np.ndarray:
    """Zeros that begin with a cache line, as vectors of the processor are faster there.

    Many are in pages of their own: those that nobody sets take no memory.
    """
    size = math.prod(shape) * np.dtype(dtype).itemsize
    if size >= _LARGE:
        pages = mmap.mmap(-1, size, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
        if hasattr(mmap, "MADV_HUGEPAGE"):
            with suppress(OSError):  # a kernel without huge pages
                pages.madvise(mmap.MADV_HUGEPAGE)
        return np.frombuffer(pages, dtype).reshape(shape)
    space = np.zeros(size + _LINE, dtype=np.int8)
    begin = -space.ctypes.data % _LINE
    return space[begin : begin + size].view(dtype).reshape(shape)


def address_of(array: np.ndarray) -> int:
    """Where an array begins."""
    return array.__array_interface__["data"][0]


def pointers_of(ffi: Any, struct: Any) -> list[int]:
    """Numbers of the words of a struct, or of an array of structs, that are pointers."""
    kind = ffi.typeof(struct)
    if kind.kind == "array":
        kind, count = kind.item, len(struct)
    else:
        kind, count = kind.item if kind.kind == "pointer" else kind, 1
    words, size = [*_words_of(ffi, kind)], ffi.sizeof(kind) // 8
    return [i * size + word for i in range(count) for word in words]


def _words_of(ffi: Any, kind: Any, first: int = 0) -> Iterator[int]:
    if kind.kind in ("pointer", "function"):
        yield first // 8
    elif kind.kind == "struct":
        for _, field in kind.fields:
            yield from _words_of(ffi, field.type, first + field.offset)
    elif kind.kind == "array" and kind.item.kind in ("pointer", "struct", "array"):
        for i in range(kind.length):
            yield from _words_of(ffi, kind.item, first + i * ffi.sizeof(kind.item))


def _first_of(memories: list[np.ndarray]) -> tuple[np.ndarray, tuple[int, int]]:
    """The first of some memories, which is taken out, and how many references it and views have."""
    memory = memories.pop(0)
    return memory, (getrefcount(memory), getrefcount(memory.base))


# References of a memory that nothing else has.
_ALONE = _first_of([aligned_zeros(_LINE, dtype=np.uint8)])[1]


class BlockPlan:
    """Places of the structs and arrays of a template in one piece of memory.

    Those that are `blank` begin as zeros. Pointers may also lead to what an `outer` plan has.
    """

    def __init__(
        self,
        ffi: Any,
        structs: Iterable[Any],
        arrays: Iterable[np.ndarray],
        blank: Iterable[np.ndarray] = (),
        outer: BlockPlan | None = None,
    ):
        structs = [*structs]
        bytes_of_structs = [np.frombuffer(ffi.buffer(part), np.uint8) for part in structs]
        pointers = [pointers_of(ffi, part) for part in structs]
        zeros = sorted((a for a in blank if a.size), key=address_of)
        copied = [*bytes_of_structs, *(a for a in arrays if a.size)]
        offset = 0
        # Where pieces of the template begin and end, and their places; by their beginnings.
        pieces: list[tuple[int, int, int]] = []
        for group in (sorted(copied, key=address_of), zeros):
            last = -1
            for array in group:
                assert array.flags.c_contiguous
                start = address_of(array)
                if start + array.nbytes <= last:
                    continue  # a part of the piece before
                assert start >= last, "pieces overlap"
                pieces.append((start, last := start + array.nbytes, offset))
                offset += -(-array.nbytes // _LINE) * _LINE
            if group is not zeros:
                self.copied = offset
        #: Places of numbers of forms by name, if each has one of its own.
        self.places: dict[str, tuple] | None = None
        # Memories of the latest blocks.
        self._memories: list[np.ndarray] = []
        #: Places of what was asked for, by id.
        self.known: dict[int, tuple] = {}
        #: Size [bytes]; behind `copied` there are zeros.
        self.size = offset
        self._pieces = sorted(pieces)
        self._starts = [start for start, _, _ in self._pieces]
        self.image = np.zeros(self.copied, np.uint8)
        for array in copied:
            place = self.place(address_of(array))
            self.image[place : place + array.nbytes] = array.reshape(-1).view(np.uint8)
        #: Words of structs that point into this block, or into the outer one, and where to.
        self.inner = self._pointers(bytes_of_structs, pointers, self)
        nowhere = np.empty(0, np.intp), np.empty(0, np.int64)
        self.outer = self._pointers(bytes_of_structs, pointers, outer) if outer else nowhere

    def place(self, address: int) -> int:
        """Place of what the template has at an address; -1 if it is not in the block."""
        i = bisect_right(self._starts, address) - 1
        if i < 0:
            return -1
        start, end, place = self._pieces[i]
        return place + address - start if address < end else -1

    def _pointers(
        self, structs: list[np.ndarray], pointers: list[list[int]], to: BlockPlan
    ) -> tuple[np.ndarray, np.ndarray]:
        words, targets = [], []
        for struct, offsets in zip(structs, pointers, strict=True):
            first, values = self.place(address_of(struct)) // 8, struct.view(np.int64)
            for i in offsets:
                if (target := to.place(int(values[i]))) >= 0:
                    words.append(first + i)
                    targets.append(target)
        return np.array(words, np.intp), np.array(targets, np.int64)

    def block(self, outer: Block | None = None) -> Block:
        """A block as the template was; pointers lead also to what the `outer` block has."""
        memory = self._unused_memory()
        if memory is None:
            memory = aligned_zeros(self.size, dtype=np.uint8)
        block = Block(self, memory, outer)
        if self.size < _LARGE:
            self._memories.append(memory)
            del self._memories[:-_WARM]
        block.reset()
        return block

    def _unused_memory(self) -> np.ndarray | None:
        """Memory of an earlier block to which nothing refers any more: it is warm."""
        for _ in range(len(self._memories)):
            with suppress(IndexError):  # another thread may take the last one
                memory, references = _first_of(self._memories)
                if references == _ALONE:
                    return memory
                self._memories.append(memory)
        return None


class Block:
    """The memory of one run."""

    def __init__(self, plan: BlockPlan, memory: np.ndarray, outer: Block | None = None):
        self.plan, self.memory, self._outer = plan, memory, outer
        self.base = address_of(memory)

    def reset(self) -> None:
        """Be as the template was, but for what begins as zeros."""
        plan = self.plan
        copied = self.memory[: plan.copied]
        copied[:] = plan.image
        words = copied.view(np.int64)
        for (at, to), block in ((plan.inner, self), (plan.outer, self._outer)):
            if block is not None:
                words[at] = block.base + to

    def view(self, array: np.ndarray) -> np.ndarray:
        """The array that has in this block the place of one of the template."""
        if array.size == 0:
            return array
        known = self.plan.known.get(id(array))
        if known is None:
            place = self.plan.place(address_of(array))
            assert place >= 0, "not in the block"
            # With the array, whose id nothing else has as long as it is there.
            known = self.plan.known[id(array)] = place, array.shape, array.dtype, array
        place, shape, kind, _ = known
        return np.ndarray(shape, kind, self.memory, place)

    def struct(self, ffi: Any, struct: Any) -> Any:
        """The struct that has the place of one of the template, which keeps the memory."""
        known = self.plan.known.get(id(struct))
        if known is None:
            place, kind = self.plan.place(int(ffi.cast("uintptr_t", struct))), ffi.typeof(struct)
            if kind.kind == "array":
                kind = ffi.typeof(ffi.getctype(kind.item, "[]"))
            end = place + len(ffi.buffer(struct))
            known = self.plan.known[id(struct)] = place, end, kind, struct
        place, end, kind, _ = known
        return ffi.from_buffer(kind, self.memory[place:end])
