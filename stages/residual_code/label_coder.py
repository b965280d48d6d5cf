"""Labels of points as annotators left them, uint32 (of SemanticKITTI class and instance): exact, beside a decoded sweep.

A label is most often that of a neighbour. Of each return the labels of up to seven neighbours, in its ring and in the two
rings above, are asked for one after the other, the likeliest first: is it this one? How near in range a neighbour lies
weighs its vote, for labels change where ranges do. What is none of them is told by its place in the list of the scan's labels.
Labels of the scan before were tried as neighbours, too, and saved nothing.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from salpcc.schemas.errors import ArchiveError
from salpcc.schemas.sweep import Sweep
from salpcc.stages.entropy.buffer import as_array, run_encoder
from salpcc.stages.entropy.mixing import EVEN, code_learned_bit
from salpcc.stages.entropy.walks import finish_coder, start_coder
from salpcc.stages.lattice.sensor_model import SensorModel
from salpcc.stages.predict.ring_starts import ring_starts

PLAIN, BY_CLASS = 1, 2  # forms: of themselves; given the classes, which each label has one of
_HEAD = struct.Struct("<BII")  # form, CRC-32 of the labels, how many there are
_WORD = struct.Struct("<I")
_NEAREST = 500  # counts added to every range, so that near points do not look far apart
_GAP = 8  # ticks; a return before that is no neighbour in range
_NEIGHBOURS = 7
_CONTEXTS = 4
_RANKS = 2  # first, or any other
_SHARES = 16
_SHOWN = 64  # labels that contexts tell apart, the most frequent ones
_RATE = 0.02
_WEIGHT = 0.3
# Where the runs of contexts begin: by who agrees, by label and vote, by the two nearest labels, by ring; and of the list.
_BY_VOTE = _RANKS * 128 * 16
_BY_PAIR = _BY_VOTE + _RANKS * _SHOWN * _SHARES * 4
_BY_RING = _BY_PAIR + _SHOWN * _SHOWN * _RANKS * 4
_IN_LIST = _BY_RING + 64 * _SHARES * _SHOWN
_NODES = 4096

Labels = NDArray[np.uint32]
_Run = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]


@njit(cache=True)
def _apart(a: int, b: int) -> int:
    """How far two ranges lie apart, 0 (0.4 %) to 3 (6 % and more)."""
    least, off = min(a, b), abs(a - b) * 256
    return int(off >= least) + int(off >= 4 * least) + int(off >= 16 * least)


@njit(cache=True)
def _nearest(tick: NDArray[np.int64], i: int, j: int, end: int) -> int:
    """Go on from ``j`` to the return of a ring that is nearest to return ``i`` in ticks, the last of equals."""
    while j + 1 < end and abs(tick[j + 1] - tick[i]) <= abs(tick[j] - tick[i]):
        j += 1
    return j


@njit(cache=True, error_model="numpy")
def _walk(
    writing: bool,
    starts: NDArray[np.int64],
    tick: NDArray[np.int64],
    reach: NDArray[np.int64],
    of_point: NDArray[np.uint8],
    of_label: NDArray[np.uint8],
    place: NDArray[np.int64],
    bits: int,
    buffer: NDArray[np.uint8],
) -> int:
    """Code the places of labels in their list ``(M,)``, or fill them in; encoder and decoder are this one walk.

    Args:
        starts: of the rings.
        tick, reach: azimuth ticks and ranges in counts, above 0, ``(M,)``.
        of_point, of_label: the class of each point ``(M,)`` and of each label in the list; a neighbour whose label is of
            another class has no vote.
        bits: of a place.
        buffer: room for what is written, or what is read.

    Returns:
        the bytes written, or 0 where all could be read; -1 where the buffer is too small, or does not suffice.
    """
    state = start_coder(writing, buffer)
    chances = np.full(_IN_LIST + _NODES, EVEN, np.uint16)
    counts = np.zeros(len(chances), np.uint8)
    weights = np.full((_RANKS * _SHARES, 1 + _CONTEXTS), _WEIGHT)
    whole = np.ones(1)  # one context has the say
    opinions = np.empty(1 + _CONTEXTS)
    contexts, node_context = np.empty(_CONTEXTS, np.int64), np.empty(1, np.int64)
    known, agree, votes = (
        np.empty(_NEIGHBOURS, np.int64),
        np.empty(_NEIGHBOURS, np.int64),
        np.empty(_NEIGHBOURS, np.int64),
    )
    sole = np.full(256, -1)  # by class the only label that it has
    for label in range(len(of_label)):
        sole[of_label[label]] = label if sole[of_label[label]] == -1 else -2
    above = above_end = second = second_end = 0
    for ring in range(len(starts) - 1):
        begin, end = starts[ring], starts[ring + 1]
        if begin == end:
            continue
        j, h = above, second
        for i in range(begin, end):
            j, h = _nearest(tick, i, j, above_end), _nearest(tick, i, h, second_end)
            if sole[of_point[i]] >= 0:
                place[i] = sole[of_point[i]]
                continue
            n = total = left = up = 0
            apart_left = apart_up = 3
            for which in range(_NEIGHBOURS):
                if which == 0:
                    at, there = i - 1, i > begin
                elif which == 1:
                    at, there = j, above < above_end
                elif which == 2:
                    at, there = j + 1, j + 1 < above_end
                elif which == 3:
                    at, there = j - 1, j > above
                elif which == 4:
                    at, there = i - 2, i > begin + 1
                elif which == 5:
                    at, there = j + 2, j + 2 < above_end
                else:
                    at, there = h, second < second_end
                if not there:
                    continue
                apart, label = _apart(reach[i], reach[at]), place[at]
                if label >= len(of_label):
                    return -1
                if which == 0:
                    apart_left = 3 if tick[i] - tick[at] > _GAP else apart
                    left, vote = min(label + 1, _SHOWN - 1), 9 - 2 * apart_left
                elif which == 1:
                    apart_up, up, vote = apart, min(label + 1, _SHOWN - 1), 8 - 2 * apart
                elif which < 5:
                    vote = (5 if which == 2 else 4) - apart
                else:
                    vote = 3 - apart // 2
                if of_label[label] != of_point[i]:
                    continue
                total += vote
                m = 0
                while m < n and known[m] != label:
                    m += 1
                if m == n:
                    known[n], agree[n], votes[n] = label, 0, 0
                    n += 1
                agree[m] |= 1 << which
                votes[m] += vote
            hit = 0
            for rank in range(n):
                best = 0
                for m in range(1, n):
                    if votes[m] > votes[best]:
                        best = m
                label, later = known[best], min(rank, _RANKS - 1)
                share = votes[best] * (_SHARES - 1) // total
                shown = min(label, _SHOWN - 1)
                contexts[0] = (later * 128 + agree[best]) * 16 + 4 * apart_left + apart_up
                contexts[1] = _BY_VOTE + ((later * _SHOWN + shown) * _SHARES + share) * 4 + apart_left
                contexts[2] = _BY_PAIR + ((left * _SHOWN + up) * _RANKS + later) * 4 + apart_up
                contexts[3] = _BY_RING + ((ring & 63) * _SHARES + share) * _SHOWN + shown
                opinions[0] = _WEIGHT
                hit = code_learned_bit(
                    writing, state, buffer, 1 if place[i] == label else 0, opinions, 1, contexts,
                    chances, counts, weights[later * _SHARES + share], _RATE,
                )  # fmt: skip
                if hit == 1:
                    place[i] = label
                    break
                total -= votes[best]
                votes[best] = -1
            if hit == 1:
                continue
            node = 1
            for bit in range(bits - 1, -1, -1):
                node_context[0] = _IN_LIST + node % _NODES
                node = node << 1 | code_learned_bit(
                    writing, state, buffer, place[i] >> bit & 1, opinions, 0, node_context,
                    chances, counts, whole, 0.0,
                )  # fmt: skip
            place[i] = node - (1 << bits)
        second, second_end = above, above_end
        above, above_end = begin, end
    return finish_coder(writing, state, buffer)


def _runs(sweep: Sweep, sensor: SensorModel) -> list[_Run]:
    """Rings, ticks and ranges of the returns, and of the strays: those are one ring, in file order, all in one place."""
    reach = sweep.count.astype(np.int64) * sweep.step + _NEAREST
    n = len(sweep.stray_index)
    return [
        (ring_starts(sweep.laser, sensor.n_lasers), sweep.tick.astype(np.int64), reach),
        (np.array([0, n]), np.arange(n), np.ones(n, np.int64)),
    ]


def encode_labels(sweep: Sweep, sensor: SensorModel) -> bytes:
    """Encode the labels of a sweep; they decode with it alone, without those of other scans."""
    assert sweep.labels is not None and sweep.stray_labels is not None
    labels = np.concatenate([sweep.labels, sweep.stray_labels])
    listed, place, times = np.unique(labels, return_inverse=True, return_counts=True)
    order = np.argsort(-times, kind="stable")
    listed, place = listed[order], np.argsort(order)[place]
    of_label, form = np.zeros(len(listed), np.uint8), PLAIN
    if sweep.classes is not None and sweep.stray_classes is not None:
        classes = np.concatenate([sweep.classes, sweep.stray_classes])
        of_label[place] = classes
        form = BY_CLASS if (of_label[place] == classes).all() else PLAIN
    if form == PLAIN:
        of_label[:] = 0
    parts = np.split(place, [len(sweep.labels)])
    first, second = (
        _coded(run, of_point, of_label, of)
        for run, of_point, of in zip(_runs(sweep, sensor), _classes(sweep, form), parts, strict=True)
    )
    head = _HEAD.pack(form, zlib.crc32(labels.astype("<u4").tobytes()), len(listed))
    body = head + listed.astype("<u4").tobytes() + (of_label.tobytes() if form == BY_CLASS else b"")
    body += _WORD.pack(len(first)) + first + second
    return body + _WORD.pack(zlib.crc32(body))


def _classes(sweep: Sweep, form: int) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """The classes of returns and strays that the labels are coded by; zeros where by none."""
    if form == BY_CLASS and sweep.classes is not None and sweep.stray_classes is not None:
        return sweep.classes, sweep.stray_classes
    return np.zeros(len(sweep.laser), np.uint8), np.zeros(len(sweep.stray_index), np.uint8)


def _coded(
    run: _Run, of_point: NDArray[np.uint8], of_label: NDArray[np.uint8], place: NDArray[np.int64]
) -> bytes:
    if not len(place):
        return b""
    bits = _bits(len(of_label))
    return run_encoder(lambda out: int(_walk(True, *run, of_point, of_label, place, bits, out)), len(place))


def decode_labels(data: bytes, sweep: Sweep, sensor: SensorModel) -> tuple[Labels, Labels]:
    """Return the labels of the returns ``(M,)`` and strays ``(S,)`` of a decoded sweep; inverse of :func:`encode_labels`.

    Raises:
        ArchiveError: the data are damaged, or are of another scan.
    """
    form, n = check_labels(data)
    if form == BY_CLASS and sweep.classes is None:
        raise ArchiveError("labels are coded by classes, and there are none")
    at = _HEAD.size + 4 * n
    listed = np.frombuffer(data, "<u4", n, _HEAD.size).astype(np.uint32)
    of_label = np.zeros(n, np.uint8)
    if form == BY_CLASS:
        of_label = np.frombuffer(data, np.uint8, n, at).copy()
        at += n
    (length,) = _WORD.unpack_from(data, at)
    at += _WORD.size
    streams = data[at : at + length], data[at + length : -_WORD.size]
    found = []
    for run, of_point, stream in zip(_runs(sweep, sensor), _classes(sweep, form), streams, strict=True):
        place, coded = np.zeros(len(run[1]), np.int64), as_array(stream)
        sound = not len(place) or _walk(False, *run, of_point, of_label, place, _bits(n), coded) == 0
        if not sound or place.max(initial=-1) >= n:
            raise ArchiveError("labels do not decode")
        found.append(listed[place])
    if zlib.crc32(np.concatenate(found).astype("<u4").tobytes()) != _HEAD.unpack_from(data)[1]:
        raise ArchiveError("labels decode to something else than was coded (checksum differs)")
    return found[0], found[1]


def labelled(sweep: Sweep, labels: bytes, sensor: SensorModel) -> Sweep:
    """Return a decoded sweep with its coded labels, where there are some.

    Raises:
        ArchiveError: they are damaged.
    """
    if not labels:
        return sweep
    on, off = decode_labels(labels, sweep, sensor)
    return replace(sweep, labels=on, stray_labels=off)


def check_labels(data: bytes) -> tuple[int, int]:
    """Check coded labels as they lie in the file, without decoding them; return their form, and how many different ones there are.

    Raises:
        ArchiveError: they are damaged, or of a form that this version does not know.
    """
    if len(data) < _HEAD.size + 2 * _WORD.size:
        raise ArchiveError("labels are truncated")
    if zlib.crc32(data[: -_WORD.size]) != _WORD.unpack_from(data, len(data) - _WORD.size)[0]:
        raise ArchiveError("labels are damaged (checksum differs)")
    form, _, n = _HEAD.unpack_from(data)
    if form not in (PLAIN, BY_CLASS):
        raise ArchiveError(f"labels are of form {form}, this tool reads {PLAIN} and {BY_CLASS}")
    at = _HEAD.size + (5 if form == BY_CLASS else 4) * n
    if at + 2 * _WORD.size > len(data) or at + 2 * _WORD.size + _WORD.unpack_from(data, at)[0] > len(data):
        raise ArchiveError("labels have a header that cannot be")
    return int(form), int(n)


def _bits(n: int) -> int:
    """Bits of a place in a list of ``n``."""
    return max(n - 1, 0).bit_length()
