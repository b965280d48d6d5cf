"""The modes of a group's fields: how a field is coded is searched for once, and kept while that pays.

A search codes a field in every form, which takes three times as long as coding it. A decoder reads the mode in each record and
needs none of this.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from salpcc.stages.residual_code.message.field_coder import decode_field, encode_field, encode_like
from salpcc.stages.residual_code.message.learned_values import LearnedField
from salpcc.stages.residual_code.message.multiples import holds
from salpcc.stages.residual_code.message.picture_records import learned_around
from salpcc.stages.residual_code.message.points import Points
from salpcc.stages.residual_code.message.records import LEARNED

_MOST = 64  # fields of a group that are learned; the others are coded as ``fast`` does
_MORE, _SLACK = 1.05, 0.05  # times as many bits a value as when it was searched for; bits a value

Name = tuple[str, str]


class FieldModes:
    """The record of each field as it was last searched for, by topic and name, and what was learned of it.

    Args:
        learns: a writer of an effort above ``fast``; a reader is told by the records.
    """

    def __init__(self, learns: bool = False) -> None:
        self._learns = learns
        self._found: dict[Name, tuple[bytes, int]] = {}
        self._learned: dict[Name, LearnedField] = {}

    def _of(self, name: Name) -> LearnedField | None:
        """Return what was learned of a field; None where there are too many of them."""
        if name not in self._learned and len(self._learned) < _MOST:
            self._learned[name] = LearnedField()
        return self._learned.get(name)

    def encode(
        self, name: Name, values: NDArray[Any], points: Points, base: NDArray[Any] | None = None
    ) -> bytes:
        """Encode a field ``(N,)`` as :func:`~.field_coder.encode_field` does, but in the mode that the one of this name had."""
        learned = self._of(name) if self._learns else None
        record = self._written(name, values, points, base, learned)
        if learned is not None:
            learned.settle(learned_around(record[holds(record) :]))
        return record

    def _written(
        self,
        name: Name,
        values: NDArray[Any],
        points: Points,
        base: NDArray[Any] | None,
        learned: LearnedField | None,
    ) -> bytes:
        record, of = self._found.get(name, (b"", 0))
        beside = points.beside(name[1])
        if record and len(values):
            coded = encode_like(record, values, points, base, learned, beside)
            if coded is not None and self._pays(len(coded), len(values), len(record), of):
                return coded
        coded = encode_field(values, points, base, learned, beside)
        if len(values):  # a cloud without points says nothing of those behind it
            self._found[name] = coded, len(values)
        return coded

    def decode(
        self,
        name: Name,
        data: bytes,
        at: int,
        kind: np.dtype[Any],
        points: Points,
        base: NDArray[Any] | None = None,
    ) -> tuple[NDArray[Any], int]:
        """Decode the record at ``at`` of the field of this name, as :func:`~.field_coder.decode_field` does.

        Raises:
            ArchiveError: it is damaged.
        """
        inner = holds(data, at)
        learned = self._of(name) if data[inner : inner + 1] == bytes([LEARNED]) else None
        return decode_field(data, at, kind, points, base, learned, points.beside(name[1]))

    @staticmethod
    def _pays(size: int, of: int, before: int, of_before: int) -> bool:
        return 8 * size / of <= max(_MORE * 8 * before / of_before, 8 * before / of_before + _SLACK)
