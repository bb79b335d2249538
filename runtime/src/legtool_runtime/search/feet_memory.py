"""The memory of the foothold search: its queue of transitions, its stances and its hash table, allocated once."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.motion.planning.clock import WATCH
from legtool_runtime.search.body import Scratch, scratch
from legtool_runtime.search.stances import RULES, SHAPE

Doubles = NDArray[np.float64]
Longs = NDArray[np.int64]
Ints = NDArray[np.int32]

#: Transitions that can be queued and stances that can be made in one search: more than 10 ms allow.
QUEUED, STANCES = 1 << 19, 1 << 17
#: Bits of a key for each candidate, and for the phase.
FOOT_BITS, PHASE_BITS = 12, 3
#: Candidates that one search can hold; the last four are the feet as they stand.
MOST = (1 << FOOT_BITS) - 1
#: Moves of the torso in one transition are told apart by so many steps on each side.
AHEAD = 7
#: A stance that has been made: not yet reached, reached by its cheapest way, or one that breaks a rule.
OPEN, CLOSED, INVALID = range(3)
#: Places in ``counts``: queued, stances, open entries of the heap, expanded, transitions looked at.
N_QUEUED, N_STANCES, N_HEAP, N_EXPANDED, N_VALIDATED, COUNTS = range(6)


class Queue(NamedTuple):
    """Transitions: ``f``; ``g`` cost; ``to`` key of the stance; ``come`` the stance it comes from, or -1 - the stance
    of which more is to be queued; ``heap`` of them; ``counts`` of all kinds. Apart, for it is handed on most."""

    f: Doubles
    g: Doubles
    to: Longs
    come: Ints
    heap: Ints
    counts: Longs


class FeetMemory(NamedTuple):
    """All memory of a search.

    Stances: ``key``, ``feet`` (n, 4), ``parent``, ``state``, ``cost``, ``left`` cost to go, ``shape``, ``pose``,
    ``depth``, ``pushed``: up to which f its transitions are queued. ``table`` (slots, 2) as in
    :mod:`~legtool_runtime.motion.planning.workspace`.

    Of an expansion: ``lists`` (2, MOST) of candidates by ``worth``, what they add to f at least, and ``shares`` of
    theirs in δ; ``aim`` (5,): direction to the waypoint, its distance less the tolerance, and its distance; ``ahead``:
    what f adds at least, by how far the torso moves, negative for none; ``next_feet``, ``next_shape``, ``next_old``
    of a transition at hand. ``tally`` counts what was refused by rule.
    """

    queue: Queue
    key: Longs
    feet: Ints
    parent: Ints
    state: NDArray[np.int8]
    cost: Doubles
    left: Doubles
    shape: Doubles
    pose: Doubles
    depth: Ints
    pushed: Doubles
    table: Longs
    lists: Ints
    shares: Doubles
    worth: Doubles
    aim: Doubles
    ahead: Doubles
    next_feet: Ints
    next_shape: Doubles
    next_old: NDArray[np.bool_]
    tally: Longs
    counts: Longs
    path: Ints
    watch: Longs
    scratch: Scratch


def feet_memory(queued: int = QUEUED, stances: int = STANCES) -> FeetMemory:
    """Memory for searches with so many queued transitions and stances."""
    slots = 1 << (stances.bit_length() + 1)
    counts = _zeros(COUNTS, np.int64)
    queue = Queue(
        _zeros(queued), _zeros(queued), _zeros(queued, np.int64), _zeros(queued, np.int32), _zeros(queued, np.int32),
        counts,
    )  # fmt: skip
    return FeetMemory(
        queue,
        _zeros(stances, np.int64), _zeros((stances, 4), np.int32), _zeros(stances, np.int32), _zeros(stances, np.int8),
        _zeros(stances), _zeros(stances), _zeros((stances, SHAPE)), _zeros((stances, 6)), _zeros(stances, np.int32),
        _zeros(stances),
        _zeros((slots, 2), np.int64), _zeros((2, MOST), np.int32), _zeros((2, MOST)),
        _zeros((2, MOST)), _zeros(5), _zeros((2 * AHEAD + 1, 2 * AHEAD + 1)),
        _zeros(4, np.int32), _zeros(SHAPE), _zeros(4, np.bool_), _zeros(len(RULES), np.int64),
        counts, _zeros(4096, np.int32), _zeros(WATCH, np.int64), scratch(),
    )  # fmt: skip


def _zeros(shape: int | tuple[int, ...], dtype: Any = np.float64) -> Any:
    """Zeros that are written, so that their pages exist before the first search."""
    array = np.empty(shape, dtype)
    array[...] = 0
    return array


@kernel
def pack(feet: Ints, phase: int) -> int:
    """The key of a stance: its four candidates and the gait's phase."""
    key = np.int64(0)
    for leg in range(4):
        key = (key << FOOT_BITS) | np.int64(feet[leg])
    return int((key << PHASE_BITS) | np.int64(phase))


@kernel
def unpack(key: int, feet: Ints) -> int:
    """Write the candidates (4,) of a key; returns the phase."""
    rest = key >> PHASE_BITS
    for leg in range(3, -1, -1):
        feet[leg] = rest & ((1 << FOOT_BITS) - 1)
        rest >>= FOOT_BITS
    return key & ((1 << PHASE_BITS) - 1)


@kernel
def _sooner(w: Queue, a: int, b: int) -> bool:
    """Order of the queue: least f, then greatest g, then smallest key, then first come."""
    if w.f[a] != w.f[b]:
        return w.f[a] < w.f[b]
    if w.g[a] != w.g[b]:
        return w.g[a] > w.g[b]
    if w.to[a] != w.to[b]:
        return w.to[a] < w.to[b]
    return a < b


@kernel
def enqueue(w: Queue, f: float, g: float, to: int, come: int) -> bool:
    """Queue a transition; False where there is no room."""
    e = w.counts[N_QUEUED]
    if e >= w.f.shape[0]:
        return False
    w.f[e], w.g[e], w.to[e], w.come[e] = f, g, to, come
    w.counts[N_QUEUED] = e + 1
    k = w.counts[N_HEAP]
    w.counts[N_HEAP] = k + 1
    while k > 0:
        up = (k - 1) >> 1
        if not _sooner(w, e, w.heap[up]):
            break
        w.heap[k] = w.heap[up]
        k = up
    w.heap[k] = e
    return True


@kernel
def dequeue(w: Queue) -> int:
    """Take the first transition off the queue."""
    first = w.heap[0]
    size = w.counts[N_HEAP] - 1
    w.counts[N_HEAP] = size
    if size > 0:
        last, k = w.heap[size], 0
        while True:
            down = 2 * k + 1
            if down >= size:
                break
            if down + 1 < size and _sooner(w, w.heap[down + 1], w.heap[down]):
                down += 1
            if not _sooner(w, w.heap[down], last):
                break
            w.heap[k] = w.heap[down]
            k = down
        w.heap[k] = last
    return first
