"""One run per output. In a folder the lock dies with its process, however it dies; behind a URL soon after."""

from __future__ import annotations

import json
import os
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Event, Thread
from typing import Any
from uuid import uuid4

from filelock import FileLock, Timeout

from salpcc.schemas.errors import LockedError, UsageError
from salpcc.schemas.files import atomic, create, is_url, why

LEASE = 60.0  # seconds without a sign of life after which a lock behind a URL is nobody's
_held: set[str] = set()  # tokens of the locks that this process holds
_SETTLE = 1.0  # seconds in which another run that takes over the same lock will have shown


@contextmanager
def locked(out: Path) -> Iterator[None]:
    """Hold the output folder, which is made where it is missing.

    Raises:
        LockedError: another run holds it.
        UsageError: it cannot be made.
    """
    with _leased(out) if is_url(out) else _locked_file(out):
        yield


@contextmanager
def _locked_file(out: Path) -> Iterator[None]:
    path = out / ".lock"
    lock = FileLock(path)
    try:
        out.mkdir(parents=True, exist_ok=True)
        lock.acquire(blocking=False)
    except OSError as error:  # a Timeout is one
        if not isinstance(error, Timeout):
            raise UsageError(f"{out}: cannot write there ({error.strerror}); choose another --out") from error
        raise LockedError(
            f"{out}: another run (process {_who(path)}) is using this output folder; wait for it or choose --out"
        ) from error
    try:
        with suppress(OSError):  # Windows lets nobody write into it
            path.write_text(str(os.getpid()))
        yield
    finally:
        lock.release()


def _who(path: Path) -> str:
    try:
        return path.read_text().strip() or "unknown"
    except OSError:
        return "unknown"


@contextmanager
def _leased(out: Path) -> Iterator[None]:
    """Hold an object that only one run can create, and keep saying that it is alive.

    Machines' clocks have to agree within half of ``LEASE``. Where a store ignores the condition on a put, two
    runs that begin in the same second may both go on; they write the same bytes.
    """
    path, token, over = out / ".lock", uuid4().hex, Event()
    try:
        _take(out, path, token)
    except OSError as error:
        raise UsageError(f"{out}: cannot write there ({why(error)}); choose another --out") from error
    _held.add(token)
    thread = Thread(target=_renew, args=(path, token, over), daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
        _held.discard(token)
        with suppress(Exception):  # where the way is lost, the lock has lost its holder all the same
            if _holder(path).get("token") == token:
                path.unlink(missing_ok=True)


def _take(out: Path, path: Path, token: str) -> None:
    for _ in range(3):
        try:
            create(path, _sign(token))
            return
        except FileExistsError:
            holder = _holder(path)
        alive = time.time() - holder.get("seen", 0) < LEASE
        if alive and not _died_here(holder):
            break
        path.unlink(missing_ok=True)
        with suppress(FileExistsError):
            create(path, _sign(token))
            time.sleep(_SETTLE)
            if _holder(path).get("token") == token:
                return
    raise LockedError(
        f"{out}: another run (process {holder.get('process')} on {holder.get('host')}) is using this output, or died "
        f"within the last {LEASE:.0f} s; wait for it or choose --out"
    )


def _renew(path: Path, token: str, over: Event) -> None:
    while not over.wait(LEASE / 4):
        with suppress(Exception):  # the next one may get through; the run itself will tell what is wrong
            if _holder(path).get("token") != token:
                return
            with atomic(path) as stream:
                stream.write(_sign(token))


def _sign(token: str) -> bytes:
    about = {"host": socket.gethostname(), "process": os.getpid(), "token": token, "seen": time.time()}
    return json.dumps(about).encode()


def _holder(path: Path) -> dict[str, Any]:
    try:
        return dict(json.loads(path.read_bytes()))
    except (FileNotFoundError, ValueError):
        return {}


def _died_here(holder: dict[str, Any]) -> bool:
    """Tell whether the holder was a process of this machine that is no more, or a run of this one that is over."""
    if holder.get("host") != socket.gethostname():
        return False
    if holder.get("process") == os.getpid():
        return holder.get("token") not in _held
    if os.name == "nt":  # there os.kill ends a process, whatever the signal
        return False
    try:
        os.kill(int(holder["process"]), 0)
    except OSError as error:
        return isinstance(error, ProcessLookupError)
    return False
