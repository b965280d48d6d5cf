"""Unix time -> the GPS time of LAS."""

from __future__ import annotations

from bisect import bisect

_GPS_EPOCH = 315_964_800  # Unix seconds of 6 January 1980
_ADJUSTMENT = 1_000_000_000  # LAS takes it off, so that a float64 holds more digits of the rest
# Unix seconds from which GPS is so many leap seconds ahead of UTC.
_LEAPS = (
    (0, 13),
    (1_136_073_600, 14),
    (1_230_768_000, 15),
    (1_341_100_800, 16),
    (1_435_708_800, 17),
    (1_483_228_800, 18),
)
_CALENDAR = 1_000_000_000  # Unix seconds (2001), below which a clock counts from the start of a recording


def is_calendar_time(nanoseconds: int) -> bool:
    """Tell a clock that knows the date from one that counts from the start of a recording."""
    return nanoseconds >= _CALENDAR * 10**9


def adjusted_gps_time(nanoseconds: int) -> float:
    """Return the seconds of LAS's adjusted standard GPS time of a Unix time in nanoseconds."""
    _, leap = _LEAPS[bisect(_LEAPS, (nanoseconds // 10**9, 99)) - 1]
    return (nanoseconds + (leap - _GPS_EPOCH - _ADJUSTMENT) * 10**9) / 1e9
