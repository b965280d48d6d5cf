"""Boxes as they are written on the command line."""

from __future__ import annotations

from salpcc.schemas.errors import UsageError

METAVAR = "X0,Y0,Z0,X1,Y1,Z1"


def parse_box(option: str, text: str) -> tuple[float, ...]:
    """Return the numbers of a box, metres in the frame of the poses; whoever takes them says what makes a box.

    Raises:
        UsageError: what is written are no numbers.
    """
    try:
        return tuple(float(value) for value in text.split(","))
    except ValueError as error:
        raise UsageError(f"{option} {text}: expected six numbers x0,y0,z0,x1,y1,z1 in metres") from error
