"""The modes of a group's fields: how a field is coded is searched for once, and kept while that pays.

A search codes a field in every form, which takes three times as long as coding it. A decoder reads the mode in each record and
needs none of this.
"""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from salpcc.stages.residual_code.message.field_coder import Points, encode_field, encode_like

_MORE, _SLACK = 1.05, 0.05  # times as many bits a value as when it was searched for; bits a value


class FieldModes:
    """The record of each field as it was last searched for, by topic and name."""

    def __init__(self) -> None:
        self._found: dict[tuple[str, str], tuple[bytes, int]] = {}

    def encode(
        self, name: tuple[str, str], values: NDArray[Any], points: Points, base: NDArray[Any] | None = None
    ) -> bytes:
        """Encode a field ``(N,)`` as :func:`~.field_coder.encode_field` does, but in the mode that the one of this name had."""
        record, of = self._found.get(name, (b"", 0))
        if record and len(values) and not (values[1:] == values[:-1]).all():
            coded = encode_like(record, values, points, base)
            if coded is not None and self._pays(len(coded), len(values), len(record), of):
                return coded
        coded = encode_field(values, points, base)
        self._found[name] = coded, len(values)
        return coded

    @staticmethod
    def _pays(size: int, of: int, before: int, of_before: int) -> bool:
        return 8 * size / of <= max(_MORE * 8 * before / of_before, 8 * before / of_before + _SLACK)
